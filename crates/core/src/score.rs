//! Score runs: w and q of every segment of a snapshot, from a score job or from a scorer elsewhere.

mod histogram;
mod origin;

pub use histogram::{Histogram, KeptCount, legible_height};
pub use origin::{IMPORTED, Origin};

use super::{
    id::{EncoderId, EpisodeId, JobId, ScoreRunId, SnapshotId, TaskId},
    snapshot::Role,
    time::Millis,
};

/// A pretrained encoder: its checkpoint and the snapshot it was trained on.
#[derive(Debug, Clone)]
pub struct Encoder {
    /// Its id.
    pub id: EncoderId,
    /// Its task.
    pub task_id: TaskId,
    /// The job that made it.
    pub job_id: JobId,
    /// The snapshot it was pretrained on.
    pub snapshot_id: SnapshotId,
    /// Blob of its checkpoint.
    pub checkpoint: super::id::BlobId,
    /// When it was finished.
    pub created_at: Millis,
}

/// A score run: its inputs, its origin, and the frozen values of its normaliser.
#[derive(Debug, Clone)]
pub struct ScoreRun {
    /// Its id.
    pub id: ScoreRunId,
    /// Its task.
    pub task_id: TaskId,
    /// What made it.
    pub origin: Origin,
    /// The experts and imperfect episodes.
    pub snapshot_id: SnapshotId,
    /// What maps to q = 0, frozen: w, on the local scale if the scorer has one; with a lookahead the share, 0 to 1, that joins
    /// similarity and progress.
    pub lo: f64,
    /// What maps to q = 1, likewise.
    pub hi: f64,
    /// Evenly spaced quantiles of the same, low to high; for the quantile and calibrated normalisers only.
    pub quantiles: Vec<f64>,
    /// The run that it extends, if any.
    pub extends: Option<ScoreRunId>,
    /// The experts, to which `match_episode` refers by index.
    pub expert_ids: Vec<EpisodeId>,
    /// When it was finished.
    pub created_at: Millis,
}

/// One episode's scores; every list has one entry for each step (the segment that ends there). A scorer without matches
/// leaves the last three empty. Within learning, episodes have names, which for stored ones are their ids.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeScores<Id = EpisodeId> {
    /// The episode.
    pub episode_id: Id,
    /// Its role in the run's snapshot.
    pub role: Role,
    /// The highest similarity to an expert segment, at most 0; the classifier's log p; the information of `deminf`;
    /// the gain of `progress`; the share of `vote`; the imported q before it was rounded.
    pub w: Vec<f64>,
    /// w, with a lookahead also the progress of later matches, and with a lead-in the best of those of the next segments,
    /// normalised to [0, 1].
    pub q: Vec<f32>,
    /// Index into the run's `expert_ids`.
    pub match_episode: Vec<u32>,
    /// The step at which the matched expert segment ends.
    pub match_step: Vec<u32>,
    /// ‖Δz‖₂ of o, m and a.
    pub distances: Vec<[f32; 3]>,
}

/// The score of one segment of an episode that is not stored.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentScored {
    /// The stamp of the segment's last observation.
    pub stamp_ns: i64,
    /// The highest similarity to an expert segment, at most 0.
    pub w: f64,
    /// w normalised to [0, 1].
    pub q: f32,
    /// The expert episode that matched.
    pub match_episode: EpisodeId,
    /// The step at which the matched expert segment ends.
    pub match_step: u32,
}

impl<Id> EpisodeScores<Id> {
    /// The same scores under a new episode id, the result of `rename`.
    ///
    /// # Errors
    /// The errors of `rename`.
    pub fn renamed<Other, E>(
        self,
        rename: impl FnOnce(Id) -> std::result::Result<Other, E>,
    ) -> std::result::Result<EpisodeScores<Other>, E> {
        let Self { episode_id, role, w, q, match_episode, match_step, distances } = self;
        Ok(EpisodeScores { episode_id: rename(episode_id)?, role, w, q, match_episode, match_step, distances })
    }

    /// Whether the lists have fitting lengths: one entry for each step, or an empty list where there are no matches.
    pub fn fit(&self) -> bool {
        let steps = self.w.len();
        let matches = [self.match_episode.len(), self.match_step.len(), self.distances.len()];
        self.q.len() == steps && (matches == [steps; 3] || matches == [0; 3])
    }
}

/// Coverage of a score run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RunCounts {
    /// Imperfect episodes that were scored.
    pub imperfect_episodes: u64,
    /// Their segments, one for each step.
    pub imperfect_segments: u64,
    /// Segments of the experts that were compared.
    pub expert_segments: u64,
}
