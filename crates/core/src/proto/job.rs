//! Jobs and metrics on the wire.

use gleaner_proto::v1;

use super::{field, order};
use crate::{
    engine_options,
    error::{Error, Result},
    id::JobId,
    job::{Job, JobKind, JobState, Metric},
    order::{JobOrder, PipelineQueueing, Queueing},
    placement::Placement,
    schedule::PipelineSpec,
};

/// Most attempts of a job; more would not help.
const MAX_ATTEMPTS: u32 = 100;
/// Most jobs that one job may wait for.
const MAX_NEEDS: usize = 100;
/// Longest key, in characters.
const LONGEST_KEY: usize = 200;

/// Reads a job's id.
pub fn job_id(text: &str) -> Result<JobId> {
    JobId::parse("job_id", text)
}

/// The task's name or id, the order, and the settings of its queueing.
///
/// # Errors
/// Invalid names the field and the remedy.
pub fn submit_request(request: v1::SubmitJobRequest) -> Result<(String, JobOrder, Queueing)> {
    let v1::SubmitJobRequest { task, spec, priority, needs, max_attempts, key, engine_options } = request;
    if needs.len() > MAX_NEEDS {
        return Err(Error::invalid("needs", format!("are {}, must be at most {MAX_NEEDS}", needs.len())));
    }
    let needs =
        needs.iter().enumerate().map(|(i, id)| JobId::parse(&format!("needs[{i}]"), id)).collect::<Result<_>>()?;
    if max_attempts.is_some_and(|attempts| attempts == 0 || attempts > MAX_ATTEMPTS) {
        return Err(Error::invalid("max_attempts", format!("must be between 1 and {MAX_ATTEMPTS}")));
    }
    let key = named_key(key)?;
    let engine_options = engine_options::engine_options("engine_options", &engine_options)?;
    let queueing = Queueing { priority, needs, max_attempts, key, engine_options };
    Ok((field::text("task", task)?, order::order(spec)?, queueing))
}

fn named_key(key: String) -> Result<String> {
    if key.chars().count() > LONGEST_KEY || key.chars().any(char::is_control) {
        return Err(Error::invalid(
            "key",
            format!("must be at most {LONGEST_KEY} characters, without control characters"),
        ));
    }
    Ok(key)
}

/// The task's name or id, the pipeline, and the settings of its queueing.
///
/// # Errors
/// Invalid names the field and the remedy.
pub fn pipeline_request(request: v1::SubmitPipelineRequest) -> Result<(String, PipelineSpec, PipelineQueueing)> {
    let v1::SubmitPipelineRequest { task, pipeline, priority, engine_options, key } = request;
    let key = named_key(key)?;
    let engine_options = engine_options::engine_options("engine_options", &engine_options)?;
    let queueing = PipelineQueueing { priority, engine_options, key };
    Ok((field::text("task", task)?, order::pipeline(pipeline)?, queueing))
}

/// Filter and page of a list of jobs.
pub struct ListRequest {
    /// The task's name or id; empty: every task.
    pub task: String,
    /// Only in this state.
    pub state: Option<JobState>,
    /// Number of jobs on the page.
    pub size: u32,
    /// The oldest job of the page before; `None` for the first page.
    pub before: Option<JobId>,
}

/// Reads the filter and page of a list of jobs.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListJobsRequest) -> Result<ListRequest> {
    let v1::ListJobsRequest { task, state, page_size, page_token } = request;
    let before = match page_token.as_str() {
        "" => None,
        token => Some(JobId::parse("page_token", token).map_err(|_| field::foreign_page_token())?),
    };
    Ok(ListRequest { task, state: state_from(state)?, size: field::page_size(page_size)?, before })
}

fn state_from(state: i32) -> Result<Option<JobState>> {
    match v1::JobState::try_from(state) {
        Ok(v1::JobState::Unspecified) => Ok(None),
        Ok(v1::JobState::Queued) => Ok(Some(JobState::Queued)),
        Ok(v1::JobState::Running) => Ok(Some(JobState::Running)),
        Ok(v1::JobState::Succeeded) => Ok(Some(JobState::Succeeded)),
        Ok(v1::JobState::Failed) => Ok(Some(JobState::Failed)),
        Ok(v1::JobState::Cancelled) => Ok(Some(JobState::Cancelled)),
        Err(_) => {
            Err(Error::invalid("state", "unknown value; supported: queued, running, succeeded, failed, cancelled"))
        }
    }
}

/// A job.
pub fn job(job: Job) -> v1::Job {
    let kind = match job.spec.kind() {
        JobKind::Pretrain => v1::JobKind::Pretrain,
        JobKind::Score => v1::JobKind::Score,
        JobKind::Train => v1::JobKind::Train,
        JobKind::Export => v1::JobKind::Export,
        JobKind::Evaluate => v1::JobKind::Evaluate,
    };
    let waiting = job.waiting();
    let Job {
        id,
        task_id,
        spec,
        state,
        priority,
        result_id,
        done,
        total,
        message,
        error,
        attempt,
        max_attempts,
        cancel_requested: _,
        checkpoint: _,
        checkpoint_step: _,
        peak_memory_bytes,
        needs,
        waits_for: _,
        created_at,
        started_at,
        ended_at,
        key,
        engine_options,
        placement: Placement { engine, engine_id, node, waiting: _ },
    } = job;
    v1::Job {
        id: id.into(),
        task_id: task_id.into(),
        spec: Some(order::spec_to_proto(spec)),
        kind: kind.into(),
        state: state_to(state).into(),
        priority,
        done,
        total,
        message,
        error,
        result_id,
        needs: needs.into_iter().map(Into::into).collect(),
        attempt,
        max_attempts,
        create_time: Some(field::timestamp(created_at)),
        start_time: started_at.map(field::timestamp),
        end_time: ended_at.map(field::timestamp),
        peak_memory_bytes,
        key,
        engine,
        engine_id,
        node,
        waiting,
        engine_options,
    }
}

fn state_to(state: JobState) -> v1::JobState {
    match state {
        JobState::Queued => v1::JobState::Queued,
        JobState::Running => v1::JobState::Running,
        JobState::Succeeded => v1::JobState::Succeeded,
        JobState::Failed => v1::JobState::Failed,
        JobState::Cancelled => v1::JobState::Cancelled,
    }
}

/// A metric.
pub fn metric(metric: Metric) -> v1::Metric {
    let Metric { sequence: _, step, name, value } = metric;
    v1::Metric { step, name, value }
}

/// A job's state, and its new metrics.
pub fn watched((now, metrics): (Job, Vec<Metric>)) -> v1::WatchJobResponse {
    v1::WatchJobResponse { job: Some(job(now)), metrics: metrics.into_iter().map(metric).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_has_its_word_on_the_wire() {
        for state in JobState::ALL {
            assert_eq!(state_from(state_to(state).into()).unwrap(), Some(state));
        }
        assert_eq!(state_from(0).unwrap(), None);
        assert!(state_from(99).unwrap_err().message().starts_with("state: "));
    }

    #[test]
    fn invalid_submission_settings_are_rejected_by_field() {
        let spec = Some(v1::JobSpec { spec: Some(v1::job_spec::Spec::Pretrain(v1::PretrainSpec::default())) });
        let request = v1::SubmitJobRequest { task: "reach".into(), spec, ..v1::SubmitJobRequest::default() };
        let (task, _, queueing) = submit_request(request.clone()).unwrap();
        assert_eq!((task.as_str(), queueing.priority, queueing.max_attempts), ("reach", 0, None));

        let refusal = |request| submit_request(request).unwrap_err().message().to_owned();
        let needs = vec![JobId::new().into(), "ep_x".into()];
        assert!(refusal(v1::SubmitJobRequest { needs, ..request.clone() }).starts_with("needs[1]: "));
        let needs = vec![JobId::new().into(); 101];
        assert!(refusal(v1::SubmitJobRequest { needs, ..request.clone() }).starts_with("needs: are 101"));
        assert!(
            refusal(v1::SubmitJobRequest { max_attempts: Some(0), ..request.clone() }).starts_with("max_attempts: ")
        );
        for key in ["ü".repeat(201), "a\nb".into()] {
            assert!(refusal(v1::SubmitJobRequest { key, ..request.clone() }).starts_with("key: "));
        }
        let longest = v1::SubmitJobRequest { key: "ü".repeat(200), ..request.clone() };
        assert_eq!(submit_request(longest).unwrap().2.key.chars().count(), 200);
        let options = |text: &str| v1::SubmitJobRequest { engine_options: text.to_owned(), ..request.clone() };
        assert_eq!(submit_request(options(" -p gpu ")).unwrap().2.engine_options, "-p gpu");
        assert!(refusal(options("--wrap=ls")).starts_with("engine_options: --wrap=ls: is set by the server"));
        assert!(refusal(v1::SubmitJobRequest { task: String::new(), ..request }).starts_with("task: "));
        let pipeline = v1::SubmitPipelineRequest {
            task: "t".into(),
            pipeline: Some(v1::PipelineSpec { pretrain: Some(v1::PretrainSpec::default()), ..Default::default() }),
            engine_options: "--wrap=ls".into(),
            ..Default::default()
        };
        let refused = pipeline_request(pipeline.clone()).unwrap_err();
        assert!(refused.message().starts_with("engine_options: --wrap=ls: is set by the server"), "{refused}");
        let refused = pipeline_request(v1::SubmitPipelineRequest { key: "a\nb".into(), ..pipeline }).unwrap_err();
        assert!(refused.message().starts_with("key: "), "{refused}");

        let list = |request| list_request(request).err().unwrap().message().to_owned();
        assert!(list(v1::ListJobsRequest { page_size: 1001, ..Default::default() }).starts_with("page_size: "));
        let foreign = list(v1::ListJobsRequest { page_token: "x".into(), ..Default::default() });
        assert!(foreign.starts_with("page_token: is not a page token"), "{foreign}");
    }
}
