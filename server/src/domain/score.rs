//! Score runs: w and q of every segment under one encoder, one snapshot, one normaliser.

use super::{
    id::{EncoderId, EpisodeId, JobId, ScoreRunId, SnapshotId, TaskId},
    snapshot::Role,
    time::Millis,
};

/// A pretrained encoder: where its checkpoint is and what it saw.
#[derive(Debug, Clone)]
pub struct Encoder {
    /// Its id.
    pub id: EncoderId,
    /// Its task.
    pub task_id: TaskId,
    /// The job that made it.
    pub job_id: JobId,
    /// What it was pretrained on.
    pub snapshot_id: SnapshotId,
    /// Blob of its checkpoint.
    pub checkpoint: super::id::BlobId,
    /// When it was finished.
    pub created_at: Millis,
}

/// What a score run was made with and found.
#[derive(Debug, Clone)]
pub struct ScoreRun {
    /// Its id.
    pub id: ScoreRunId,
    /// Its task.
    pub task_id: TaskId,
    /// The job that made it.
    pub job_id: JobId,
    /// The encoder whose features were compared.
    pub encoder_id: EncoderId,
    /// The experts and imperfect episodes.
    pub snapshot_id: SnapshotId,
    /// For example `last_l2`.
    pub similarity: String,
    /// For example `minmax`.
    pub normaliser: String,
    /// w that maps to q = 0, frozen.
    pub lo: f64,
    /// w that maps to q = 1, frozen.
    pub hi: f64,
    /// What `match_episode` counts in.
    pub expert_ids: Vec<EpisodeId>,
    /// When it was finished.
    pub created_at: Millis,
}

/// One episode's scores; every list has one entry a step (the segment that ends there).
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeScores {
    /// The episode.
    pub episode_id: EpisodeId,
    /// Its role in the run's snapshot.
    pub role: Role,
    /// The highest similarity to an expert segment; at most 0.
    pub w: Vec<f64>,
    /// w normalised to [0, 1].
    pub q: Vec<f32>,
    /// Index into the run's `expert_ids`.
    pub match_episode: Vec<u32>,
    /// The step at which the matched expert segment ends.
    pub match_step: Vec<u32>,
    /// ‖Δz‖₂ of o, m and a.
    pub distances: Vec<[f32; 3]>,
}

/// What one threshold keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeptCount {
    /// The threshold; q > β is kept.
    pub beta: f64,
    /// Imperfect segments kept.
    pub segments: u64,
    /// Imperfect episodes that contribute at least one.
    pub episodes: u64,
}
