//! The ids that a server has, each with its task.

use gleaner_client::Client;
use gleaner_core::PretrainSpec;
use gleaner_core::proto::from_struct;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{
    Deployment, Episode, GetEpisodeRequest, Job, JobKind, JobState, ListEpisodesRequest, ListEpisodesResponse,
    ListJobsRequest, Task,
};
use tonic::Code;

use super::choice::Entry;
use super::{Kind, LATEST};
use crate::failure::Result;

const PAGE: u32 = 1000;

/// The tasks that are searched.
#[derive(Clone, Debug, Default)]
pub(super) struct Tasks {
    /// The one that the command line names, by its name or id.
    named: Option<String>,
    /// Ids with names; the named one alone if there is one.
    all: Vec<(String, String)>,
}

impl Tasks {
    /// The named task, or every task of the server.
    pub(super) async fn of(client: &Client, named: Option<&str>) -> Result<Self> {
        if let Some(named) = named {
            return Ok(Self::one(named));
        }
        let tasks = client.every_task().await?.tasks;
        let name = |task: Task| {
            let name = task.spec.map_or_else(|| task.id.clone(), |spec| spec.name);
            (task.id, name)
        };
        Ok(Self { named: None, all: tasks.into_iter().map(name).collect() })
    }

    pub(super) fn one(named: &str) -> Self {
        Self { named: Some(named.to_owned()), all: vec![(named.to_owned(), named.to_owned())] }
    }

    #[cfg(test)]
    pub(super) fn test(all: &[(&str, &str)]) -> Self {
        Self { named: None, all: all.iter().map(|(id, name)| ((*id).to_owned(), (*name).to_owned())).collect() }
    }

    pub(super) fn named(&self) -> Option<&str> {
        self.named.as_deref()
    }

    fn ids(&self) -> impl Iterator<Item = String> {
        self.all.iter().map(|(id, _)| id.clone())
    }

    /// The name of a task for a list of candidates; `None` if one task alone is searched.
    pub(super) fn name<'a>(&'a self, id: &'a str) -> Option<&'a str> {
        if self.all.len() < 2 {
            return None;
        }
        // A task of the last moments has only its id here.
        Some(self.all.iter().find(|(known, _)| known == id).map_or(id, |(_, name)| name))
    }

    fn entry(&self, id: String, task: &str) -> Entry {
        Entry { id, task: self.name(task).map(str::to_owned) }
    }
}

/// The task of an episode; `None` for an episode that the server does not have, which the command then rejects.
pub(super) async fn task_of(client: &Client, episode: &str) -> Result<Option<Tasks>> {
    let request = GetEpisodeRequest { episode_id: episode.to_owned() };
    match client.episodes().get_episode(request).await {
        Ok(reply) => Ok(reply.into_inner().episode.map(|episode| Tasks::one(&episode.task_id))),
        Err(status) if matches!(status.code(), Code::NotFound | Code::InvalidArgument) => Ok(None),
        Err(status) => Err(status.into()),
    }
}

/// What there is of a kind in these tasks.
pub(super) async fn ids(client: &Client, kind: Kind, tasks: &Tasks, text: &str) -> Result<Vec<Entry>> {
    match kind {
        Kind::Job => {
            let found = jobs(client, tasks.named()).await?.into_iter();
            Ok(found.map(|job| tasks.entry(job.id, &job.task_id)).collect())
        }
        Kind::Encoder => {
            let found = encoders(client, tasks.named()).await?.into_iter();
            let found = found.filter(|encoder| encoder.is_trained || text != LATEST);
            Ok(found.map(|encoder| tasks.entry(encoder.id, &encoder.task_id)).collect())
        }
        Kind::Policy => policies(client, tasks, text == LATEST).await,
        Kind::Schedule => {
            let reply = client.every_schedule(tasks.named().unwrap_or_default()).await?;
            Ok(reply.schedules.into_iter().map(|schedule| tasks.entry(schedule.id, &schedule.task_id)).collect())
        }
        Kind::Evaluation => {
            let mut found = results(client, tasks, JobKind::Evaluate).await?;
            for Entry { id: policy_id, task } in policies(client, tasks, true).await? {
                let reply = client.every_evaluation(&policy_id).await?;
                let evaluations = reply.evaluations.into_iter();
                found.extend(evaluations.map(|evaluation| Entry { id: evaluation.id, task: task.clone() }));
            }
            Ok(found)
        }
        Kind::Run => {
            let mut found = results(client, tasks, JobKind::Score).await?;
            for task in tasks.ids() {
                let reply = client.every_score_run(&task).await?;
                found.extend(reply.score_runs.into_iter().map(|run| tasks.entry(run.id, &run.task_id)));
            }
            Ok(found)
        }
        Kind::Dataset => {
            let mut found = Vec::new();
            for task in tasks.ids() {
                let reply = client.every_dataset(&task).await?;
                found.extend(reply.datasets.into_iter().map(|dataset| tasks.entry(dataset.id, &dataset.task_id)));
            }
            Ok(found)
        }
        Kind::Snapshot => {
            let mut found = Vec::new();
            for task in tasks.ids() {
                let reply = client.every_snapshot(&task).await?;
                found.extend(reply.snapshots.into_iter().map(|snapshot| tasks.entry(snapshot.id, &snapshot.task_id)));
            }
            Ok(found)
        }
        Kind::Episode | Kind::Deleted => {
            let found = episodes(client, tasks, kind == Kind::Deleted).await?;
            Ok(of_episodes(tasks, &found))
        }
    }
}

/// Episodes as candidates.
pub(super) fn of_episodes(tasks: &Tasks, episodes: &[Episode]) -> Vec<Entry> {
    episodes.iter().map(|episode| tasks.entry(episode.id.clone(), &episode.task_id)).collect()
}

/// The deployments of the named task, or of all.
pub(super) async fn deployments(client: &Client, tasks: &Tasks) -> Result<Vec<Deployment>> {
    Ok(client.every_deployment(tasks.named().unwrap_or_default()).await?.deployments)
}

/// An encoder that a job makes or has made.
pub(crate) struct Encoder {
    pub(crate) id: String,
    pub(super) task_id: String,
    /// Whether it has more than the single step of one that is named and not read.
    pub(crate) is_trained: bool,
}

/// The encoders of one task, or of all.
pub(crate) async fn encoders(client: &Client, task: Option<&str>) -> Result<Vec<Encoder>> {
    let encoder = |job: Job| {
        let Some(Spec::Pretrain(spec)) = job.spec.and_then(|spec| spec.spec) else { return None };
        let steps = from_struct(spec.settings).get("steps").and_then(serde_json::Value::as_u64);
        Some(Encoder {
            id: job.result_id,
            task_id: job.task_id,
            is_trained: steps != Some(PretrainSpec::UNTRAINED_STEPS),
        })
    };
    Ok(unfailed(client, task).await?.filter_map(encoder).collect())
}

/// The policies that are there, and unless `finished` those that jobs are making.
async fn policies(client: &Client, tasks: &Tasks, finished: bool) -> Result<Vec<Entry>> {
    let mut found = Vec::new();
    for task in tasks.ids() {
        let reply = client.every_policy(&task).await?;
        found.extend(reply.policies.into_iter().map(|policy| tasks.entry(policy.id, &policy.task_id)));
    }
    if !finished {
        let made = results(client, tasks, JobKind::Train).await?;
        found.extend(made.into_iter().filter(|entry| !found.contains(entry)).collect::<Vec<_>>());
    }
    Ok(found)
}

/// The episodes of these tasks.
pub(super) async fn episodes(client: &Client, tasks: &Tasks, deleted: bool) -> Result<Vec<Episode>> {
    let mut found = Vec::new();
    for task in tasks.ids() {
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
async fn results(client: &Client, tasks: &Tasks, kind: JobKind) -> Result<Vec<Entry>> {
    let jobs = unfailed(client, tasks.named()).await?;
    Ok(jobs.filter(|job| job.kind() == kind).map(|job| tasks.entry(job.result_id, &job.task_id)).collect())
}

async fn unfailed(client: &Client, task: Option<&str>) -> Result<impl Iterator<Item = Job>> {
    let fails = |job: &Job| matches!(job.state(), JobState::Failed | JobState::Cancelled);
    Ok(jobs(client, task).await?.into_iter().filter(move |job| !fails(job)))
}
