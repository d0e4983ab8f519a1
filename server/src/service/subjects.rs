//! The names and ids in the messages of each audited rpc, which the audit log records as the subjects of a change.
//!
//! Lists fields only: `access::Subjects` limits and formats them. An audited rpc whose messages have no row here does not
//! build, and a test compares the rows with the field names of the protos.

use gleaner_proto::v1::{
    self, evaluate_spec, import_scores_request, job_spec, session_request, session_response, train_spec,
};

use crate::access::{Named, Subjects};

/// Rows of messages: `message { fields; oneof }`.
macro_rules! messages {
    ($($message:ident { $($field:ident),* $(; $oneof:ident)? })*) => {$(
        impl Named for v1::$message {
            #[allow(unused_variables, reason = "some messages have neither names nor ids")]
            fn name_in(&self, path: &str, subjects: &mut Subjects) {
                $(self.$field.name_in(&within(path, stringify!($field)), subjects);)*
                $(self.$oneof.name_in(path, subjects);)?
            }
        }
    )*};
}

/// Rows of oneofs: `oneof { Variant field, …; variants without names }`.
macro_rules! oneofs {
    ($($oneof:path { $($variant:ident $field:ident),*; $($unnamed:ident),* })*) => {$(
        impl Named for $oneof {
            fn name_in(&self, path: &str, subjects: &mut Subjects) {
                match self {
                    $(Self::$variant(named) => named.name_in(&within(path, stringify!($field)), subjects),)*
                    $(Self::$unnamed(_) => {})*
                }
            }
        }
    )*};
}

messages! {
    CreateTaskRequest { spec }
    CreateTaskResponse { task }
    UpdateTaskRequest { task, spec }
    UpdateTaskResponse { task }
    DeleteTaskRequest { task }
    DeleteTaskResponse {}
    Task { id, spec }
    TaskSpec { name }

    StartUploadRequest { task }
    StartUploadResponse { upload_id, existing }
    WriteUploadRequest { upload_id }
    WriteUploadResponse {}
    FinishUploadRequest { upload_id }
    FinishUploadResponse { episode }
    Episode { id, task_id }
    LabelEpisodesRequest { episode_ids }
    LabelEpisodesResponse {}
    DeleteEpisodesRequest { episode_ids }
    DeleteEpisodesResponse {}
    UndeleteEpisodesRequest { episode_ids }
    UndeleteEpisodesResponse {}

    CreateSnapshotRequest { task }
    CreateSnapshotResponse { snapshot }
    Snapshot { id, task_id }
    ImportScoresRequest { ; message }
    ImportScoresOpen { snapshot_id, encoder_id }
    ImportScoresResponse { score_run }
    ScoreRun { id, task_id, encoder_id, snapshot_id }
    CreateDatasetRequest { score_run_id }
    CreateDatasetResponse { dataset }
    Dataset { id, task_id, score_run_id }

    SubmitJobRequest { task, spec }
    SubmitJobResponse { job }
    SubmitPipelineRequest { task, pipeline }
    SubmitPipelineResponse { dataset_id }
    CancelJobRequest { job_id }
    CancelJobResponse { job }
    Job { id, task_id, spec, result_id, engine_id }
    JobSpec { ; spec }
    PretrainSpec { snapshot_id }
    ScoreSpec { encoder_id, snapshot_id }
    TrainSpec { ; data }
    ExportSpec { dataset_id }
    EvaluateSpec { ; subject }
    PipelineSpec { pretrain, train, scoring, evaluate }

    CreateScheduleRequest { task, name, pipeline }
    CreateScheduleResponse { schedule }
    PauseScheduleRequest { schedule_id }
    PauseScheduleResponse { schedule }
    DeleteScheduleRequest { schedule_id }
    DeleteScheduleResponse {}
    Schedule { id, task_id, name, pipeline }

    RegisterPolicyRequest { task }
    RegisterPolicyResponse { policy }
    Policy { id, task_id, encoder_id, dataset_id, job_id }
    DeployRequest { name, policy_id, score_run_id }
    DeployResponse { deployment }
    RollBackRequest { name }
    RollBackResponse { deployment }
    DeleteDeploymentRequest { name }
    DeleteDeploymentResponse {}
    Deployment { name, task_id, policy_id, score_run_id }
    ReportEvaluationRequest { policy_id }
    ReportEvaluationResponse { evaluation }
    Evaluation { id, policy_id, job_id }

    SessionRequest { ; message }
    SessionOpen { deployment }
    SessionResponse { ; message }
    SessionOpened { session_id, policy_id, task_id }
    SessionAction { score }
    LiveScore { match_episode_id }
    SessionClosed { episode_id }
}

oneofs! {
    job_spec::Spec { Pretrain pretrain, Score score, Train train, Export export, Evaluate evaluate; }
    train_spec::Data { DatasetId dataset_id; ExpertsOf, ExpertsIn }
    evaluate_spec::Subject { PolicyId policy_id, Deployment deployment; }
    import_scores_request::Message { Open open; Batch }
    session_request::Message { Open open; Observation, Close }
    session_response::Message { Opened opened, Action action, Closed closed; Missed, Draining }
}

/// The path of a field within the message at `path`.
fn within(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { format!("{path}.{field}") }
}
