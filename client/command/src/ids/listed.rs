//! The ids that a server has.

use gleaner_client::Client;
use gleaner_core::proto::from_struct;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{
    Episode, Job, JobKind, JobState, ListDatasetsRequest, ListDeploymentsRequest, ListEpisodesRequest,
    ListEpisodesResponse, ListEvaluationsRequest, ListJobsRequest, ListPoliciesRequest, ListSchedulesRequest,
    ListScoreRunsRequest, ListSnapshotsRequest, ListTasksRequest,
};

use super::{Kind, LATEST};
use crate::failure::Result;

const PAGE: u32 = 1000;

/// The ids of a kind: of one task, or of all. For the name of a deployment, that of its policy.
pub(super) async fn ids(client: &Client, kind: Kind, task: Option<&str>, text: &str) -> Result<Vec<String>> {
    if kind == Kind::Policy && text.contains('@') {
        let reply = client.policies().list_deployments(ListDeploymentsRequest::default()).await?.into_inner();
        let named = reply.deployments.into_iter().filter(|deployment| deployment.name == text);
        return Ok(named.map(|deployment| deployment.policy_id).collect());
    }
    match kind {
        Kind::Job => Ok(jobs(client, task).await?.into_iter().map(|job| job.id).collect()),
        Kind::Encoder => {
            let found = encoders(client, task).await?.into_iter();
            Ok(found.filter(|encoder| encoder.is_trained || text != LATEST).map(|encoder| encoder.id).collect())
        }
        Kind::Policy => policies(client, task, text == LATEST).await,
        Kind::Schedule => {
            let request = ListSchedulesRequest { task: task.unwrap_or_default().to_owned() };
            let reply = client.schedules().list_schedules(request).await?.into_inner();
            Ok(reply.schedules.into_iter().map(|schedule| schedule.id).collect())
        }
        Kind::Evaluation => {
            let mut found = results(client, task, JobKind::Evaluate).await?;
            for policy_id in policies(client, task, true).await? {
                let request = ListEvaluationsRequest { policy_id };
                let reply = client.policies().list_evaluations(request).await?.into_inner();
                found.extend(reply.evaluations.into_iter().map(|evaluation| evaluation.id));
            }
            Ok(found)
        }
        Kind::Run => {
            let mut found = results(client, task, JobKind::Score).await?;
            for task in tasks(client, task).await? {
                let reply = client.scores().list_score_runs(ListScoreRunsRequest { task }).await?.into_inner();
                found.extend(reply.score_runs.into_iter().map(|run| run.id));
            }
            Ok(found)
        }
        Kind::Dataset => {
            let mut found = Vec::new();
            for task in tasks(client, task).await? {
                let reply = client.datasets().list_datasets(ListDatasetsRequest { task }).await?.into_inner();
                found.extend(reply.datasets.into_iter().map(|dataset| dataset.id));
            }
            Ok(found)
        }
        Kind::Snapshot => {
            let mut found = Vec::new();
            for task in tasks(client, task).await? {
                let reply = client.snapshots().list_snapshots(ListSnapshotsRequest { task }).await?.into_inner();
                found.extend(reply.snapshots.into_iter().map(|snapshot| snapshot.id));
            }
            Ok(found)
        }
        Kind::Episode | Kind::Deleted => {
            let found = episodes(client, task, kind == Kind::Deleted).await?;
            Ok(found.into_iter().map(|episode| episode.id).collect())
        }
    }
}

/// An encoder that a job makes or has made.
pub(crate) struct Encoder {
    pub(crate) id: String,
    /// Whether it has more than the single step of one that is named and not read.
    pub(crate) is_trained: bool,
}

/// The encoders of one task, or of all.
pub(crate) async fn encoders(client: &Client, task: Option<&str>) -> Result<Vec<Encoder>> {
    let encoder = |job: Job| {
        let Some(Spec::Pretrain(spec)) = job.spec.and_then(|spec| spec.spec) else { return None };
        let steps = from_struct(spec.settings).get("steps").and_then(serde_json::Value::as_u64);
        Some(Encoder { id: job.result_id, is_trained: steps != Some(1) })
    };
    Ok(unfailed(client, task).await?.filter_map(encoder).collect())
}

/// The policies that are there, and unless `finished` those that jobs are making.
async fn policies(client: &Client, task: Option<&str>, finished: bool) -> Result<Vec<String>> {
    let mut found = Vec::new();
    for task in tasks(client, task).await? {
        let reply = client.policies().list_policies(ListPoliciesRequest { task }).await?.into_inner();
        found.extend(reply.policies.into_iter().map(|policy| policy.id));
    }
    if !finished {
        let made = results(client, task, JobKind::Train).await?;
        found.extend(made.into_iter().filter(|id| !found.contains(id)).collect::<Vec<_>>());
    }
    Ok(found)
}

async fn tasks(client: &Client, task: Option<&str>) -> Result<Vec<String>> {
    if let Some(task) = task {
        return Ok(vec![task.to_owned()]);
    }
    let reply = client.tasks().list_tasks(ListTasksRequest {}).await?.into_inner();
    Ok(reply.tasks.into_iter().map(|task| task.id).collect())
}

/// The episodes of one task, or of all.
pub(super) async fn episodes(client: &Client, task: Option<&str>, deleted: bool) -> Result<Vec<Episode>> {
    let mut found = Vec::new();
    for task in tasks(client, task).await? {
        let request = ListEpisodesRequest { task, page_size: PAGE, deleted, ..ListEpisodesRequest::default() };
        found.extend(every_page(client, request).await?.episodes);
    }
    Ok(found)
}

/// Every page of a listing, as one.
pub(crate) async fn every_page(client: &Client, mut request: ListEpisodesRequest) -> Result<ListEpisodesResponse> {
    let mut whole = ListEpisodesResponse::default();
    loop {
        let page = client.episodes().list_episodes(request.clone()).await?.into_inner();
        whole.episodes.extend(page.episodes);
        if page.next_page_token.is_empty() {
            return Ok(whole);
        }
        request.page_token = page.next_page_token;
    }
}

async fn jobs(client: &Client, task: Option<&str>) -> Result<Vec<Job>> {
    let task = task.unwrap_or_default().to_owned();
    let mut request = ListJobsRequest { task, page_size: PAGE, ..ListJobsRequest::default() };
    let mut found = Vec::new();
    loop {
        let page = client.jobs().list_jobs(request.clone()).await?.into_inner();
        found.extend(page.jobs);
        if page.next_page_token.is_empty() {
            return Ok(found);
        }
        request.page_token = page.next_page_token;
    }
}

/// What jobs of this kind make or have made.
async fn results(client: &Client, task: Option<&str>, kind: JobKind) -> Result<Vec<String>> {
    let jobs = unfailed(client, task).await?;
    Ok(jobs.filter(|job| job.kind() == kind).map(|job| job.result_id).collect())
}

async fn unfailed(client: &Client, task: Option<&str>) -> Result<impl Iterator<Item = Job>> {
    let fails = |job: &Job| matches!(job.state(), JobState::Failed | JobState::Cancelled);
    Ok(jobs(client, task).await?.into_iter().filter(move |job| !fails(job)))
}
