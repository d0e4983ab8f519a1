//! What people look at to decide: tasks at a glance, the table of episodes, labels given under one another's eyes, single
//! segments, and where a result comes from.

use std::cmp::Ordering;

use super::{
    dataset::Dataset,
    episode::{Episode, Label, Outcome},
    id::{DatasetId, EncoderId, EpisodeId, PolicyId, ScoreRunId, SnapshotId},
    job::{Job, JobSpec},
    policy::Deployment,
    task::{OutcomeCounts, Task},
    time::Millis,
};

/// A task at a glance; the trash is left out.
#[derive(Debug, Clone)]
pub struct TaskOverview {
    /// The task.
    pub task: Task,
    /// Its episodes by outcome.
    pub outcomes: OutcomeCounts,
    /// What was recorded, in hours.
    pub hours: f64,
    /// What the recordings take on disk, in bytes.
    pub bytes: u64,
    /// How many cohorts its episodes are of; no cohort counts as one.
    pub cohorts: u64,
}

/// Which of a task's episodes a table shows; the trash never.
#[derive(Debug, Clone, Default)]
pub struct TableFilter {
    /// Only with this outcome.
    pub outcome: Option<Outcome>,
    /// Only of this cohort.
    pub cohort: Option<String>,
    /// Only those that became visible at this time or later.
    pub from: Option<Millis>,
    /// Only those that became visible before this time.
    pub before: Option<Millis>,
    /// Only those whose report has warnings, or only those whose report has none.
    pub warnings: Option<bool>,
    /// Only those with this text in their file name or id, whatever its case (of ASCII letters).
    pub text: Option<String>,
}

/// An episode with its newest label.
#[derive(Debug, Clone)]
pub struct TableRow {
    /// The episode.
    pub episode: Episode,
    /// Grows with each label of the episode: who labels says which one they saw.
    pub label_version: i64,
    /// Who labelled it last.
    pub labelled_by: String,
    /// When.
    pub labelled_at: Millis,
}

/// What a table is sorted by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SortKey {
    /// Mean q in a score run; episodes without one come last either way.
    MeanQ,
    /// Number of steps.
    Steps,
    /// When the episode became visible.
    Date,
    /// Failure, then success, then unknown.
    Outcome,
}

impl SortKey {
    /// Every key.
    pub const ALL: [Self; 4] = [Self::MeanQ, Self::Steps, Self::Date, Self::Outcome];

    /// The word for it in links.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::MeanQ => "mean_q",
            Self::Steps => "steps",
            Self::Date => "date",
            Self::Outcome => "outcome",
        }
    }

    /// Reads the word in links.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|key| key.as_str() == word)
    }
}

/// Sorts rows; equal ones by id, older first, so that pages of the same list meet.
pub fn sort(rows: &mut [TableRow], key: SortKey, descending: bool, mean_q: impl Fn(&EpisodeId) -> Option<f64>) {
    let directed = |order: Ordering| if descending { order.reverse() } else { order };
    let compare = |a: &Episode, b: &Episode| match key {
        SortKey::MeanQ => match (mean_q(&a.id), mean_q(&b.id)) {
            (Some(a), Some(b)) => directed(a.total_cmp(&b)),
            (a, b) => b.is_some().cmp(&a.is_some()),
        },
        SortKey::Steps => directed(a.steps.cmp(&b.steps)),
        SortKey::Date => directed(a.created_at.cmp(&b.created_at)),
        SortKey::Outcome => directed(a.outcome.as_str().cmp(b.outcome.as_str())),
    };
    rows.sort_by(|a, b| compare(&a.episode, &b.episode).then_with(|| a.episode.id.cmp(&b.episode.id)));
}

/// How labelling ended for one who said which labels they saw.
#[derive(Debug, Clone)]
pub enum Labelled {
    /// All episodes have the label, each now at this version.
    Done(Vec<(Episode, i64)>),
    /// Somebody labelled these meanwhile; nothing was labelled.
    Changed(Vec<Overtaken>),
}

/// An episode that somebody else labelled first.
#[derive(Debug, Clone)]
pub struct Overtaken {
    /// The episode.
    pub episode_id: EpisodeId,
    /// The version to name if one labels it all the same.
    pub label_version: i64,
    /// Who said what when.
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

/// The episodes of one cohort in a snapshot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CohortRoles {
    /// The cohort as it was then; may be empty.
    pub cohort: String,
    /// Experts.
    pub experts: u64,
    /// Imperfect episodes.
    pub imperfect: u64,
}

/// Something that a job's spec names.
#[derive(Debug, Clone)]
pub enum Input {
    /// A snapshot; no job makes one.
    Snapshot(SnapshotId),
    /// An encoder.
    Encoder(EncoderId),
    /// A score run.
    ScoreRun(ScoreRunId),
    /// A dataset: what it selects of which run.
    Dataset(Dataset),
    /// A policy.
    Policy(PolicyId),
}

impl Input {
    /// What a spec names, but for a dataset, whose id comes second: that is to be looked up.
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
            JobSpec::Export { dataset_id } => (Vec::new(), Some(dataset_id)),
            JobSpec::Evaluate { policy_id, .. } => (vec![Self::Policy(policy_id.clone())], None),
        }
    }

    /// The result that a job made for this to be there; `None` for a snapshot.
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

/// Where a job's result comes from, and what came of it.
#[derive(Debug, Clone)]
pub struct Lineage {
    /// What its spec names, each with the job that made it; of a dataset the one that made its run.
    pub inputs: Vec<(Input, Option<Job>)>,
    /// Jobs whose specs name its result, or a dataset of its result; oldest first.
    pub jobs: Vec<Job>,
    /// Datasets of its result, if that is a score run; newest first.
    pub datasets: Vec<Dataset>,
    /// Deployments that now point at its result, as the policy that acts or the run that scores.
    pub deployments: Vec<Deployment>,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use proptest::prelude::*;

    use super::*;
    use crate::domain::id::{BlobId, TaskId};

    fn row(steps: u64, created_at: i64, outcome: Outcome) -> TableRow {
        let episode = Episode {
            id: EpisodeId::new(),
            task_id: TaskId::new(),
            file_name: String::new(),
            recording: BlobId::from(blake3::hash(b"")),
            size_bytes: 0,
            steps,
            duration_s: 0.0,
            mapping: String::new(),
            warnings: 0,
            outcome,
            cohort: String::new(),
            created_at: Millis(created_at),
            deleted_at: None,
        };
        TableRow { episode, label_version: 1, labelled_by: String::new(), labelled_at: Millis(0) }
    }

    /// An episode's mean q: that of its steps, none for 0.
    fn mean_q(rows: &[TableRow]) -> impl Fn(&EpisodeId) -> Option<f64> {
        let all: std::collections::HashMap<_, _> = rows
            .iter()
            .map(|row| (row.episode.id.clone(), f64::from(u32::try_from(row.episode.steps).unwrap())))
            .collect();
        move |id| all.get(id).copied().filter(|q| *q > 0.0)
    }

    #[test]
    fn what_has_no_mean_q_comes_last_either_way() {
        let rows = [2, 0, 3, 1, 0].map(|steps| row(steps, 0, Outcome::Unknown));
        for (descending, expected) in [(false, [3, 0, 2, 1, 4]), (true, [2, 0, 3, 1, 4])] {
            let mut sorted = rows.to_vec();
            sort(&mut sorted, SortKey::MeanQ, descending, mean_q(&rows));
            let ids = |rows: &[TableRow]| rows.iter().map(|row| row.episode.id.clone()).collect::<Vec<_>>();
            assert_eq!(ids(&sorted), expected.map(|place| rows[place].episode.id.clone()), "{descending}");
        }
    }

    #[test]
    fn every_key_has_a_word() {
        for key in SortKey::ALL {
            assert_eq!(SortKey::from_word(key.as_str()), Some(key));
        }
        assert_eq!(SortKey::from_word("q"), None);
    }

    proptest! {
        /// The order does not depend on how the rows came, and the reverse is the reverse but for ties, which stay by id.
        #[test]
        fn order_is_one(values in proptest::collection::vec((0..4_u64, 0..3_i64, 0..3_usize), 0..20), key in 0..4_usize) {
            let outcomes = [Outcome::Success, Outcome::Failure, Outcome::Unknown];
            let rows: Vec<_> = values.into_iter().map(|(steps, at, outcome)| row(steps, at, outcomes[outcome])).collect();
            let (key, mean_q) = (SortKey::ALL[key], mean_q(&rows));
            for descending in [false, true] {
                let (mut one, mut other) = (rows.clone(), rows.iter().rev().cloned().collect::<Vec<_>>());
                sort(&mut one, key, descending, &mean_q);
                sort(&mut other, key, descending, &mean_q);
                let ids = |rows: &[TableRow]| rows.iter().map(|row| row.episode.id.clone()).collect::<Vec<_>>();
                prop_assert_eq!(ids(&one), ids(&other));
                for pair in one.windows(2) {
                    let (a, b) = (&pair[0].episode, &pair[1].episode);
                    let tie = match key {
                        SortKey::MeanQ | SortKey::Steps => a.steps == b.steps,
                        SortKey::Date => a.created_at == b.created_at,
                        SortKey::Outcome => a.outcome == b.outcome,
                    };
                    prop_assert!(!tie || a.id < b.id);
                }
            }
        }
    }
}
