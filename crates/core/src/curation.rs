//! Values of the pages: task totals, the table of episodes ([`TableRow`]), labels with versions, segments, and lineage.

mod table;

use super::{
    dataset::Dataset,
    episode::{Episode, Label, Outcome},
    id::{DatasetId, EncoderId, EpisodeId, PolicyId, ScoreRunId, SnapshotId},
    job::{Job, JobSpec},
    policy::Deployment,
    snapshot::Role,
    task::{OutcomeCounts, Task},
    time::Millis,
};

pub use table::{SortKey, TableFilter, TableRow, sort, sort_ids};

/// A task at a glance; the trash is left out.
#[derive(Debug, Clone)]
pub struct TaskOverview {
    /// The task.
    pub task: Task,
    /// Its episodes by outcome.
    pub outcomes: OutcomeCounts,
    /// The recorded time, in hours.
    pub hours: f64,
    /// Size of the recordings on disk, in bytes.
    pub bytes: u64,
    /// Number of cohorts that its episodes name.
    pub cohorts: u64,
}

/// Sums over all tasks; the trash is left out.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Totals {
    /// Number of tasks.
    pub tasks: u64,
    /// Number of their episodes.
    pub episodes: u64,
    /// The recorded time, in hours.
    pub hours: f64,
    /// Size of the recordings on disk, in bytes.
    pub bytes: u64,
}

/// Result of labelling by a caller that names the label versions it has read.
#[derive(Debug, Clone)]
pub enum Labelled {
    /// All episodes have the label, each now at this version.
    Done(Vec<(Episode, i64)>),
    /// Others labelled these episodes in the meantime; no episode was labelled.
    Changed(Vec<Overtaken>),
}

/// An episode with a newer label than the caller named.
#[derive(Debug, Clone)]
pub struct Overtaken {
    /// The episode.
    pub episode_id: EpisodeId,
    /// The version to name in order to label it nevertheless.
    pub label_version: i64,
    /// The newer label.
    pub label: Label,
}

/// One imperfect segment of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentRef {
    /// The episode.
    pub episode_id: EpisodeId,
    /// The step the segment ends at.
    pub end_step: u32,
    /// Its q.
    pub q: f32,
}

/// A label as an entry of the history, with its version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LabelSeen {
    /// Outcome of the episode.
    pub outcome: Outcome,
    /// Its cohort.
    pub cohort: String,
    /// The label's version; `None` where the history does not contain it.
    pub version: Option<i64>,
}

/// Whether an episode is still available.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Available.
    Present,
    /// In the trash: available, and restorable.
    InTrash,
    /// Its recording was permanently deleted, so no job can use the episode.
    Deleted,
}

impl Standing {
    /// The word for it in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Present => "present",
            Self::InTrash => "in_trash",
            Self::Deleted => "deleted",
        }
    }
}

/// An episode as frozen in a snapshot, beside its present state.
#[derive(Debug, Clone)]
pub struct FrozenEpisode {
    /// The episode.
    pub episode_id: EpisodeId,
    /// The name it was uploaded under.
    pub file_name: String,
    /// Its role in the snapshot.
    pub role: Role,
    /// Its label when the snapshot was made.
    pub then: LabelSeen,
    /// Its label now.
    pub now: LabelSeen,
    /// Its present availability.
    pub standing: Standing,
}

/// What has become of a snapshot's episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SnapshotChanges {
    /// Episodes whose present label differs from the frozen one.
    pub relabelled: u64,
    /// Episodes whose recording was permanently deleted.
    pub deleted: u64,
}

impl FrozenEpisode {
    /// Whether its present label differs from the frozen one.
    pub fn relabelled(&self) -> bool {
        self.then.outcome != self.now.outcome || self.then.cohort != self.now.cohort
    }
}

/// A snapshot that contains an episode.
#[derive(Debug, Clone)]
pub struct SnapshotUse {
    /// The snapshot.
    pub snapshot_id: SnapshotId,
    /// When it was made.
    pub created_at: Millis,
    /// The episode's role in it.
    pub role: Role,
    /// The episode's outcome then.
    pub outcome: Outcome,
    /// The episode's cohort then.
    pub cohort: String,
}

/// An input that a job's spec names.
#[derive(Debug, Clone)]
pub enum Input {
    /// A snapshot; no job makes one.
    Snapshot(SnapshotId),
    /// An encoder.
    Encoder(EncoderId),
    /// A score run.
    ScoreRun(ScoreRunId),
    /// A dataset: its run and its selection.
    Dataset(Dataset),
    /// A policy.
    Policy(PolicyId),
}

impl Input {
    /// The results that a spec names. A dataset's id comes second, because the dataset has to be looked up.
    pub fn named(spec: &JobSpec) -> (Vec<Self>, Option<&DatasetId>) {
        match spec {
            JobSpec::Pretrain { snapshot_id, .. } => (vec![Self::Snapshot(snapshot_id.clone())], None),
            JobSpec::Score { encoder_id, snapshot_id, extends, .. } => {
                let own = [Self::Snapshot(snapshot_id.clone()), Self::Encoder(encoder_id.clone())];
                (own.into_iter().chain(extends.clone().map(Self::ScoreRun)).collect(), None)
            }
            JobSpec::Train { encoder_id, snapshot_id, dataset_id, .. } => {
                let own = [Self::Snapshot(snapshot_id.clone())];
                (own.into_iter().chain(encoder_id.clone().map(Self::Encoder)).collect(), dataset_id.as_ref())
            }
            JobSpec::Export { dataset_id, .. } => (Vec::new(), Some(dataset_id)),
            JobSpec::Evaluate { policy_id, .. } => (vec![Self::Policy(policy_id.clone())], None),
        }
    }

    /// The result that a job made as this input; `None` for a snapshot.
    pub fn result_id(&self) -> Option<&str> {
        match self {
            Self::Snapshot(_) => None,
            Self::Encoder(id) => Some(id.as_str()),
            Self::ScoreRun(id) => Some(id.as_str()),
            Self::Dataset(dataset) => Some(dataset.score_run_id.as_str()),
            Self::Policy(id) => Some(id.as_str()),
        }
    }
}

/// The inputs of a job's result, and the results made from it.
#[derive(Debug, Clone)]
pub struct Lineage {
    /// The results its spec names, each with the job that made it; for a dataset, the job that made its run.
    pub inputs: Vec<(Input, Option<Job>)>,
    /// Jobs whose specs name its result, or a dataset of its result; oldest first.
    pub jobs: Vec<Job>,
    /// Datasets of its result, if that is a score run; newest first.
    pub datasets: Vec<Dataset>,
    /// Deployments in force for its result, as the policy that acts or the run that scores.
    pub deployments: Vec<Deployment>,
}

#[cfg(test)]
mod tests;
