//! The interface of the server to its pages: one trait for each group of pages. The server implements them; `web` calls
//! no other part of it.
//!
//! Every method returns NotFound for an id or name that does not exist, and Internal when storage fails. Lists of
//! stored values are ordered from new to old unless stated otherwise.

use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use gleaner_core::{
    Result,
    access::AuditEntry,
    curation::{
        FrozenEpisode, Input, Labelled, Lineage, SegmentRef, SnapshotChanges, SnapshotUse, SortKey, TableFilter,
        TableRow, TaskOverview, Totals,
    },
    dataset::{Dataset, ExportFile},
    episode::{Episode, InspectedEpisode, Label, NewLabel},
    evaluation::Evaluation,
    id::{
        DatasetId, EncoderId, EpisodeId, EvaluationId, ExportId, JobId, PolicyId, ScoreRunId, SessionId, SnapshotId,
        TaskId, TokenId,
    },
    job::{Job, Metric},
    live::{LiveSession, SessionState},
    order::JobFilter,
    policy::{Deployment, Policy},
    score::{Encoder, EpisodeScores, Histogram, ScoreRun},
    selection::{ExpertRanking, Selection, WhatIf},
    snapshot::Snapshot,
    steps::{FrameView, Numbers},
    task::Task,
};
use gleaner_edge::{Call, ConnectionState};

use super::Caller;

/// Everything that the pages call.
pub trait Backend: Access + Tasks + Episodes + Scores + Artifacts + Jobs + Deployments + Machine {}

/// Tokens, limits on calls, and the audit log.
#[async_trait]
pub trait Access: Send + Sync {
    /// The hash that identifies a token.
    fn token_hash(&self, token: &str) -> String;

    /// Counts a request for the client with the token of this hash, or for its address, until the call is dropped.
    ///
    /// # Errors
    /// Exhausted when the client exceeds a limit; the inner result as [`Access::authenticate`].
    async fn admit(&self, hash: Option<&str>, connection: &ConnectionState) -> Result<(Call, Result<Caller>)>;

    /// The caller with the token of this hash, or without one.
    ///
    /// # Errors
    /// Unauthenticated for an unknown token, and without a token where one is required.
    async fn authenticate(&self, hash: Option<&str>) -> Result<Caller>;

    /// Whether one more rejected change of this token is audited: their rate is limited.
    fn audits_rejection(&self, token: &TokenId) -> bool;

    /// Writes to the audit log; a failure is logged.
    async fn audit(&self, entry: AuditEntry);
}

/// Tasks and their totals.
#[async_trait]
pub trait Tasks: Send + Sync {
    /// The task with this name or id.
    async fn task(&self, name: &str) -> Result<Task>;
    /// The task with this id.
    async fn task_by_id(&self, id: &TaskId) -> Result<Task>;
    /// Ids and names of all tasks.
    async fn task_names(&self) -> Result<Vec<(TaskId, String)>>;
    /// The number of tasks whose names contain a text.
    async fn count_tasks(&self, text: &str) -> Result<u64>;
    /// Those tasks with their totals, from the `skip`-th.
    async fn overview(&self, text: &str, skip: usize, most: usize) -> Result<Vec<TaskOverview>>;
    /// Totals of all tasks.
    async fn totals(&self) -> Result<Totals>;
}

/// Episodes, their labels and their recordings.
#[async_trait]
pub trait Episodes: Send + Sync {
    /// One episode with its report.
    async fn episode(&self, id: &EpisodeId) -> Result<InspectedEpisode>;
    /// The task of an episode, which may be in the trash.
    async fn task_of_episode(&self, id: &EpisodeId) -> Result<TaskId>;
    /// The number of matching episodes of a task.
    async fn count_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<u64>;
    /// The matching episodes of a task by a key other than the mean q, and whether descending: (skipped, most).
    async fn episode_page(
        &self,
        task: &TaskId,
        filter: &TableFilter,
        order: (SortKey, bool),
        part: (usize, usize),
    ) -> Result<Vec<TableRow>>;
    /// Every matching episode of a task.
    async fn episode_table(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<TableRow>>;
    /// The ids of the matching episodes of a task, in no order.
    async fn matching_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<EpisodeId>>;
    /// These episodes, in the order of their ids in the list.
    async fn episode_rows(&self, ids: &[EpisodeId]) -> Result<Vec<TableRow>>;
    /// The cohorts of a task, in alphabetical order.
    async fn cohorts(&self, task: &TaskId) -> Result<Vec<String>>;
    /// Every label of an episode.
    async fn labels(&self, id: &EpisodeId) -> Result<Vec<Label>>;
    /// The version of its newest label.
    async fn label_version(&self, id: &EpisodeId) -> Result<i64>;
    /// Labels episodes if none has a newer label than the version beside it.
    async fn label_episodes(&self, seen: &[(EpisodeId, i64)], label: &NewLabel) -> Result<Labelled>;
    /// The newest snapshots of an episode, at most `most`, and their number.
    async fn snapshots_with(&self, episode: &EpisodeId, most: u32) -> Result<(Vec<SnapshotUse>, u64)>;
    /// One step as JPEG.
    ///
    /// # Errors
    /// NotFound, naming the missing step or camera; Invalid for a size of 0, or depth that the camera does not record.
    async fn frame(&self, episode: &EpisodeId, view: FrameView) -> Result<Vec<u8>>;
    /// The values of every step.
    async fn numbers(&self, episode: &EpisodeId) -> Result<Numbers>;
    /// The recording as uploaded.
    async fn recording(&self, episode: &Episode) -> Result<BoxStream<'static, Result<Bytes>>>;
    /// The recording of an episode with the scores of a run beside its messages, whose steps with a q above `beta` are
    /// marked as kept; and its size in bytes.
    ///
    /// # Errors
    /// Exhausted when too many are being read.
    async fn scored_recording(
        &self,
        caller: &Caller,
        episode: &Episode,
        run: &ScoreRunId,
        beta: f64,
    ) -> Result<(u64, BoxStream<'static, Result<Bytes>>)>;
}

/// Score runs.
#[async_trait]
pub trait Scores: Send + Sync {
    /// One run.
    async fn score_run(&self, id: &ScoreRunId) -> Result<ScoreRun>;
    /// The finished runs of a task.
    async fn score_runs(&self, task: &TaskId) -> Result<Vec<ScoreRun>>;
    /// The finished runs that scored an episode.
    async fn runs_that_scored(&self, task: &TaskId, episode: &EpisodeId) -> Result<Vec<ScoreRunId>>;
    /// The scores of an episode in a run.
    async fn episode_scores(&self, run: &ScoreRunId, episode: &EpisodeId) -> Result<EpisodeScores>;
    /// l of an encoder: a segment is a window of l + 1 steps. Without an encoder, 0.
    async fn segment_length(&self, encoder: Option<&EncoderId>) -> Result<u32>;
    /// The number of expert segments of a run.
    async fn expert_segments(&self, run: &ScoreRun) -> Result<u64>;
    /// The scores of a finished run's imperfect episodes.
    ///
    /// # Errors
    /// Precondition when the run's job has not succeeded.
    async fn summary(&self, run: &ScoreRunId) -> Result<Arc<dyn RunSummary>>;
}

/// The scores of a finished run's imperfect episodes, in memory.
#[async_trait]
pub trait RunSummary: Send + Sync {
    /// The run.
    fn run(&self) -> &ScoreRun;
    /// Mean q of an episode's segments; `None` when it is not an imperfect episode of the run.
    fn mean_q(&self, episode: &EpisodeId) -> Option<f64>;
    /// The counts of a selection.
    async fn what_if(&self, selection: Selection) -> Result<WhatIf>;
    /// The distributions of q over imperfect segments and over experts, in `bins` equal bins over [0, 1].
    async fn histogram(&self, bins: usize) -> Result<Histogram>;
    /// How often q ranks experts above imperfect segments.
    async fn expert_ranking(&self) -> Result<ExpertRanking>;
    /// At most `most` of the best segments, the best first.
    async fn best(&self, most: usize) -> Result<Vec<SegmentRef>>;
    /// At most `most` of the worst segments, the worst first.
    async fn worst(&self, most: usize) -> Result<Vec<SegmentRef>>;
}

/// Snapshots, and the results of jobs.
#[async_trait]
pub trait Artifacts: Send + Sync {
    /// One snapshot.
    async fn snapshot(&self, id: &SnapshotId) -> Result<Snapshot>;
    /// The snapshots of a task.
    async fn snapshots(&self, task: &TaskId) -> Result<Vec<Snapshot>>;
    /// The episodes of a snapshot, each with its label then and now.
    async fn snapshot_episodes(&self, id: &SnapshotId, most: Option<u32>) -> Result<Vec<FrozenEpisode>>;
    /// What has become of a snapshot's episodes.
    async fn snapshot_changes(&self, id: &SnapshotId) -> Result<SnapshotChanges>;
    /// One encoder.
    async fn encoder(&self, id: &EncoderId) -> Result<Encoder>;
    /// One dataset.
    async fn dataset(&self, id: &DatasetId) -> Result<Dataset>;
    /// The datasets of a task.
    async fn datasets(&self, task: &TaskId) -> Result<Vec<Dataset>>;
    /// Makes the dataset of a selection, or returns the existing one.
    async fn insert_dataset(&self, run: &ScoreRunId, selection: Selection) -> Result<Dataset>;
    /// One policy.
    async fn policy(&self, id: &PolicyId) -> Result<Policy>;
    /// The policies of a task.
    async fn policies(&self, task: &TaskId) -> Result<Vec<Policy>>;
    /// One evaluation.
    async fn evaluation(&self, id: &EvaluationId) -> Result<Evaluation>;
    /// The evaluations of a policy.
    async fn evaluations(&self, policy: &PolicyId) -> Result<Vec<Evaluation>>;
    /// The files of an export.
    async fn export_files(&self, id: &ExportId) -> Result<Vec<ExportFile>>;
}

/// Jobs, and the relations between them.
#[async_trait]
pub trait Jobs: Send + Sync {
    /// One job.
    async fn job(&self, id: &JobId) -> Result<Job>;
    /// At most `size` jobs older than `before`, and the place of the next ones.
    async fn jobs(&self, filter: &JobFilter, before: Option<&JobId>, size: u32) -> Result<(Vec<Job>, Option<JobId>)>;
    /// The job that makes a result.
    async fn job_of_result(&self, result_id: &str) -> Result<Option<Job>>;
    /// The jobs of a task whose specs name one of these ids, from old to new.
    async fn jobs_naming(&self, task: &TaskId, ids: &[&str]) -> Result<Vec<Job>>;
    /// The inputs of a job, each with the job that made it.
    async fn inputs(&self, job: &Job) -> Result<Vec<(Input, Option<Job>)>>;
    /// The results made from a job's result.
    async fn lineage(&self, job: &Job) -> Result<Lineage>;
    /// A job's metrics for a plot: about `points` of each name, with every peak, and the newest.
    async fn sparse_metrics(&self, job: &JobId, points: u32) -> Result<Vec<Metric>>;
    /// The newest lines of a job's log, at most `bytes`.
    async fn job_log(&self, job: &JobId, bytes: u64) -> Result<String>;
    /// Cancels a job and the jobs that wait for it.
    ///
    /// # Errors
    /// Precondition when it has ended.
    async fn cancel_job(&self, id: &JobId) -> Result<Job>;
    /// Submits the order of a failed or cancelled job again, with the jobs that waited for it.
    ///
    /// # Errors
    /// Precondition when it has neither failed nor been cancelled.
    async fn retry_job(&self, id: &JobId) -> Result<Job>;
}

/// Deployments and their running sessions.
#[async_trait]
pub trait Deployments: Send + Sync {
    /// One deployment.
    async fn deployment(&self, name: &str) -> Result<Deployment>;
    /// The deployments of a task, or all; by name.
    async fn deployments(&self, task: Option<&TaskId>) -> Result<Vec<Deployment>>;
    /// The policy before the current one.
    ///
    /// # Errors
    /// Precondition if the deployment has had one policy only.
    async fn previous_policy(&self, deployment: &str) -> Result<PolicyId>;
    /// Deploys the policy before the current one.
    ///
    /// # Errors
    /// Precondition if the deployment has had one policy only, or if the earlier model cannot be loaded.
    async fn roll_back(&self, deployment: &str) -> Result<Deployment>;
    /// Every running session.
    fn live(&self) -> Vec<(LiveSession, SessionState)>;
    /// The last image of a running session's camera, in a format for browsers, and its content type.
    ///
    /// # Errors
    /// NotFound, naming the missing session or camera; Invalid when the image cannot be encoded.
    async fn live_frame(&self, session: &SessionId, camera: &str) -> Result<(&'static str, Bytes)>;
}

/// The state of the server and of its machine.
#[async_trait]
pub trait Machine: Send + Sync {
    /// Checks that the server serves.
    ///
    /// # Errors
    /// Unavailable once the server stops; Internal when its files are gone.
    fn health(&self) -> Result<()>;
    /// Every metric, in the text format of Prometheus.
    async fn metrics(&self) -> Result<String>;
    /// The disk of the data folder.
    async fn disk(&self) -> Result<Disk>;
}

/// The space on a disk, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disk {
    /// Free for the server.
    pub free: u64,
    /// In total.
    pub size: u64,
}
