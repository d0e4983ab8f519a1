//! Reads and changes of the pages, handed to the module that does each. Must not contain a rule of its own.

use async_trait::async_trait;
use bytes::Bytes;
use futures::{StreamExt as _, stream::BoxStream};
use gleaner_web::{Artifacts, Caller, Deployments, Episodes, Jobs, Tasks};

use super::{PageBackend, live_frame};
use crate::{
    domain::{
        client::Client,
        curation::{
            FrozenEpisode, Input, Labelled, Lineage, SnapshotChanges, SnapshotUse, SortKey, TableFilter, TableRow,
            TaskOverview, Totals,
        },
        dataset::{Dataset, ExportFile},
        episode::{Episode, InspectedEpisode, Label, NewLabel},
        evaluation::Evaluation,
        id::{
            DatasetId, EncoderId, EpisodeId, EvaluationId, ExportId, JobId, PolicyId, ScoreRunId, SessionId,
            SnapshotId, TaskId,
        },
        job::{Job, Metric},
        live::{LiveSession, SessionState},
        order::JobFilter,
        policy::{Deployment, Policy},
        score::Encoder,
        selection::Selection,
        snapshot::Snapshot,
        steps::{FrameView, Numbers},
        task::Task,
    },
    error::Result,
};

#[async_trait]
impl Tasks for PageBackend {
    async fn task(&self, name: &str) -> Result<Task> {
        self.services.store.task(name).await
    }

    async fn task_by_id(&self, id: &TaskId) -> Result<Task> {
        self.services.store.task_by_id(id).await
    }

    async fn task_names(&self) -> Result<Vec<(TaskId, String)>> {
        self.services.store.task_names().await
    }

    async fn count_tasks(&self, text: &str) -> Result<u64> {
        self.services.store.count_tasks(text).await
    }

    async fn overview(&self, text: &str, skip: usize, most: usize) -> Result<Vec<TaskOverview>> {
        self.services.store.overview(text, skip, most).await
    }

    async fn totals(&self) -> Result<Totals> {
        self.services.store.totals().await
    }
}

#[async_trait]
impl Episodes for PageBackend {
    async fn episode(&self, id: &EpisodeId) -> Result<InspectedEpisode> {
        self.services.store.episode(id).await
    }

    async fn task_of_episode(&self, id: &EpisodeId) -> Result<TaskId> {
        Ok(self.services.store.recording_of(id).await?.0)
    }

    async fn count_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<u64> {
        self.services.store.count_episodes(task, filter).await
    }

    async fn episode_page(
        &self,
        task: &TaskId,
        filter: &TableFilter,
        order: (SortKey, bool),
        part: (usize, usize),
    ) -> Result<Vec<TableRow>> {
        self.services.store.episode_page(task, filter, order, part).await
    }

    async fn episode_table(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<TableRow>> {
        self.services.store.episode_table(task, filter).await
    }

    async fn matching_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<EpisodeId>> {
        self.services.store.matching_episodes(task, filter).await
    }

    async fn episode_rows(&self, ids: &[EpisodeId]) -> Result<Vec<TableRow>> {
        self.services.store.episode_rows(ids).await
    }

    async fn cohorts(&self, task: &TaskId) -> Result<Vec<String>> {
        self.services.store.cohorts(task).await
    }

    async fn labels(&self, id: &EpisodeId) -> Result<Vec<Label>> {
        self.services.store.labels(id).await
    }

    async fn label_version(&self, id: &EpisodeId) -> Result<i64> {
        self.services.store.label_version(id).await
    }

    async fn label_episodes(&self, seen: &[(EpisodeId, i64)], label: &NewLabel) -> Result<Labelled> {
        let labelled = self.services.store.label_episodes_as_seen(seen, label).await?;
        if matches!(labelled, Labelled::Done(_)) {
            self.services.jobs.labelled();
        }
        Ok(labelled)
    }

    async fn snapshots_with(&self, episode: &EpisodeId, most: u32) -> Result<(Vec<SnapshotUse>, u64)> {
        self.services.store.snapshots_with(episode, most).await
    }

    async fn frame(&self, episode: &EpisodeId, view: FrameView) -> Result<Vec<u8>> {
        self.services.curation.frame(episode, view).await
    }

    async fn numbers(&self, episode: &EpisodeId) -> Result<Numbers> {
        self.services.curation.numbers(episode).await
    }

    async fn recording(&self, episode: &Episode) -> Result<BoxStream<'static, Result<Bytes>>> {
        Ok(self.services.blobs.stream(&episode.recording).await?.boxed())
    }

    async fn scored_recording(
        &self,
        caller: &Caller,
        episode: &Episode,
        run: &ScoreRunId,
        beta: f64,
    ) -> Result<(u64, BoxStream<'static, Result<Bytes>>)> {
        let client = caller.token_id().map_or(Client::Server, Client::token);
        let copy = self.services.curation.scored_copy(&client, episode, run, beta).await?;
        Ok((copy.size_bytes, copy.bytes))
    }
}

#[async_trait]
impl Artifacts for PageBackend {
    async fn snapshot(&self, id: &SnapshotId) -> Result<Snapshot> {
        self.services.store.frozen(id).await
    }

    async fn snapshots(&self, task: &TaskId) -> Result<Vec<Snapshot>> {
        self.services.store.snapshots(task).await
    }

    async fn snapshot_episodes(&self, id: &SnapshotId, most: Option<u32>) -> Result<Vec<FrozenEpisode>> {
        self.services.store.frozen_episodes(id, most).await
    }

    async fn snapshot_changes(&self, id: &SnapshotId) -> Result<SnapshotChanges> {
        self.services.store.snapshot_changes(id).await
    }

    async fn encoder(&self, id: &EncoderId) -> Result<Encoder> {
        self.services.store.encoder(id).await
    }

    async fn dataset(&self, id: &DatasetId) -> Result<Dataset> {
        self.services.store.dataset(id).await
    }

    async fn datasets(&self, task: &TaskId) -> Result<Vec<Dataset>> {
        self.services.store.datasets(task).await
    }

    async fn insert_dataset(&self, run: &ScoreRunId, selection: Selection) -> Result<Dataset> {
        self.services.store.insert_dataset(run, selection).await
    }

    async fn policy(&self, id: &PolicyId) -> Result<Policy> {
        self.services.store.policy(id).await
    }

    async fn policies(&self, task: &TaskId) -> Result<Vec<Policy>> {
        self.services.store.policies(task).await
    }

    async fn evaluation(&self, id: &EvaluationId) -> Result<Evaluation> {
        self.services.store.evaluation(id).await
    }

    async fn evaluations(&self, policy: &PolicyId) -> Result<Vec<Evaluation>> {
        self.services.store.evaluations(policy).await
    }

    async fn export_files(&self, id: &ExportId) -> Result<Vec<ExportFile>> {
        self.services.store.export_files(id).await
    }
}

#[async_trait]
impl Jobs for PageBackend {
    async fn job(&self, id: &JobId) -> Result<Job> {
        self.services.store.job(id).await
    }

    async fn jobs(&self, filter: &JobFilter, before: Option<&JobId>, size: u32) -> Result<(Vec<Job>, Option<JobId>)> {
        self.services.store.jobs(filter, before, size).await
    }

    async fn job_of_result(&self, result_id: &str) -> Result<Option<Job>> {
        self.services.store.job_of_result(result_id).await
    }

    async fn jobs_naming(&self, task: &TaskId, ids: &[&str]) -> Result<Vec<Job>> {
        self.services.store.jobs_naming(task, ids).await
    }

    async fn inputs(&self, job: &Job) -> Result<Vec<(Input, Option<Job>)>> {
        self.services.store.inputs(job).await
    }

    async fn lineage(&self, job: &Job) -> Result<Lineage> {
        self.services.store.lineage(job).await
    }

    async fn sparse_metrics(&self, job: &JobId, points: u32) -> Result<Vec<Metric>> {
        self.services.store.plotted_metrics(job, points).await
    }

    async fn job_log(&self, job: &JobId, bytes: u64) -> Result<String> {
        self.services.jobs.log(job, bytes).await
    }

    async fn cancel_job(&self, id: &JobId) -> Result<Job> {
        self.services.jobs.cancel(id).await
    }

    async fn retry_job(&self, id: &JobId) -> Result<Job> {
        self.services.jobs.retry(id).await
    }
}

#[async_trait]
impl Deployments for PageBackend {
    async fn deployment(&self, name: &str) -> Result<Deployment> {
        self.services.store.deployment(name).await
    }

    async fn deployments(&self, task: Option<&TaskId>) -> Result<Vec<Deployment>> {
        self.services.store.deployments(task).await
    }

    async fn previous_policy(&self, deployment: &str) -> Result<PolicyId> {
        Ok(self.services.store.before(deployment).await?.policy_id)
    }

    async fn roll_back(&self, deployment: &str) -> Result<Deployment> {
        self.services.policies.roll_back(deployment).await
    }

    fn live(&self) -> Vec<(LiveSession, SessionState)> {
        self.services.policies.live()
    }

    async fn live_frame(&self, session: &SessionId, camera: &str) -> Result<(&'static str, Bytes)> {
        live_frame::read(&self.services, session, camera).await
    }
}
