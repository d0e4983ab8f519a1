//! Submits every stage at once, each naming the results that it works on. The stages of an earlier run are found again
//! and not submitted twice.

use gleaner_client::Client;
use gleaner_core::proto::selection::selection_to_proto;
use gleaner_proto::v1::{CreateDatasetRequest, CreateSnapshotRequest, GetSnapshotRequest, JobSpec, SubmitJobRequest};
use tonic::Code;

use super::cell::RuleSettings;
use super::file::Experiment;
use super::order::{self, Input};
use super::stage::{Graph, Stage, Work};
use super::standing::{Gap, StageResult, Submitted};
use super::state::State;
use crate::failure::{Failure, Result, present};
use gleaner_core::Device;

/// What stages that make snapshots need besides their rule.
struct Snapshots<'a> {
    state: &'a mut State,
    /// The imperfect cohorts that are recorded.
    imperfect: Vec<&'a str>,
}

/// Submits the stages of a graph.
pub(crate) struct Submitter<'a> {
    client: &'a Client,
    task: &'a str,
    /// The simulator's task.
    simulation: &'a str,
    device: Device,
    snapshots: Option<Snapshots<'a>>,
}

impl<'a> Submitter<'a> {
    /// For the stages of an experiment.
    pub(crate) fn new(client: &'a Client, state: &'a mut State, experiment: &'a Experiment, device: Device) -> Self {
        let snapshots = Snapshots { state, imperfect: experiment.imperfect_cohorts().collect() };
        let simulation = experiment.recordings.task.name();
        Self { client, task: &experiment.task, simulation, device, snapshots: Some(snapshots) }
    }

    /// For stages on results that exist.
    pub(super) fn on_results(client: &'a Client, task: &'a str, simulation: &'a str, device: Device) -> Self {
        Self { client, task, simulation, device, snapshots: None }
    }

    /// All stages, in their order. A stage whose input failed is left out.
    pub(crate) async fn submit(mut self, graph: &Graph) -> Result<Submitted> {
        let mut submitted = Submitted::with_capacity(graph.stages.len());
        for stage in &graph.stages {
            let input = stage.input.map(|index| (graph.stages[index].work.kind(), &submitted[index]));
            let result = match input {
                Some((_, Err(Gap::NotYet))) => Err(Gap::NotYet),
                Some((kind, Err(Gap::Failed(problem)))) => Err(Gap::Failed(format!("its {kind} failed: {problem}"))),
                Some((kind, Ok(result))) => self.stage(stage, Input { kind, id: &result.id }).await?,
                None => self.stage(stage, Input { kind: "", id: "" }).await?,
            };
            submitted.push(result);
        }
        Ok(submitted)
    }

    async fn stage(&mut self, stage: &Stage, input: Input<'_>) -> Result<std::result::Result<StageResult, Gap>> {
        let result = match &stage.work {
            Work::Given { origin } => Ok(StageResult { id: origin.id().to_owned(), job: None }),
            Work::Snapshot { rule, .. } => self.snapshot(&stage.key, rule).await,
            Work::Dataset { selection } => self.dataset(input.id, selection_to_proto(*selection)).await,
            Work::Pretrain { .. } | Work::Score { .. } | Work::Train { .. } | Work::Evaluate { .. } => {
                self.job(stage, input).await
            }
        };
        match result {
            Ok(result) => Ok(Ok(result)),
            // Its input failed in an earlier run, or just now.
            Err(Failure::Client(error)) if error.code() == Some(Code::FailedPrecondition) => {
                Ok(Err(Gap::Failed(error.to_string())))
            }
            Err(failure) => Err(Failure::message(format!("{} ({}): {failure}", stage.work.kind(), stage.label))),
        }
    }

    async fn snapshot(&mut self, key: &str, rule: &RuleSettings) -> Result<StageResult> {
        let Snapshots { state, imperfect } = present(self.snapshots.as_mut(), "a snapshot for these stages")?;
        if let Some(known) = known_snapshot(self.client, state, key).await? {
            return Ok(known);
        }
        let request = CreateSnapshotRequest { task: self.task.to_owned(), rule: Some(order::rule(rule, imperfect)) };
        let reply = self.client.snapshots().create_snapshot(request).await?.into_inner();
        let id = present(reply.snapshot, "a snapshot")?.id;
        state.remember(key, &id)?;
        Ok(StageResult { id, job: None })
    }

    async fn dataset(&self, run: &str, selection: gleaner_proto::v1::Selection) -> Result<StageResult> {
        let request = CreateDatasetRequest { score_run_id: run.to_owned(), selection: Some(selection) };
        let reply = self.client.datasets().create_dataset(request).await?.into_inner();
        Ok(StageResult { id: present(reply.dataset, "a dataset")?.id, job: None })
    }

    async fn job(&self, stage: &Stage, input: Input<'_>) -> Result<StageResult> {
        let spec = present(order::job(&stage.work, input, self.simulation, self.device), "a job for this stage")?;
        let request = SubmitJobRequest {
            task: self.task.to_owned(),
            spec: Some(JobSpec { spec: Some(spec) }),
            key: job_key(stage, input.id),
            ..SubmitJobRequest::default()
        };
        let job = present(self.client.jobs().submit_job(request).await?.into_inner().job, "a job")?;
        Ok(StageResult { id: job.result_id.clone(), job: Some(job) })
    }
}

/// What a stage's job is called on the server. The input's id is beside the stage: when a failed input is made again,
/// what works on it is new as well.
pub(crate) fn job_key(stage: &Stage, input: &str) -> String {
    format!("experiment/{}/{input}", stage.key)
}

/// The snapshot that an earlier run made, if this server has it.
pub(crate) async fn known_snapshot(client: &Client, state: &State, key: &str) -> Result<Option<StageResult>> {
    let Some(id) = state.snapshot(key) else { return Ok(None) };
    match client.snapshots().get_snapshot(GetSnapshotRequest { snapshot_id: id.to_owned() }).await {
        Ok(_) => Ok(Some(StageResult { id: id.to_owned(), job: None })),
        // Another server, or its data are gone.
        Err(status) if status.code() == Code::NotFound => Ok(None),
        Err(status) => Err(status.into()),
    }
}
