//! Work: the input of a job and its result. The calls of workers have these on both sides.

use std::collections::BTreeMap;

use crate::TaskSpec;

use super::{
    dataset::{ExportFile, KeptSegment},
    episode::Outcome,
    evaluation::SeedResult,
    id::{BlobId, EpisodeId},
    score::EpisodeScores,
};

/// The input of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct Inputs {
    /// The task's spec.
    pub task: TaskSpec,
    /// D_e.
    pub experts: Vec<InputEpisode>,
    /// D_i; for pretraining and scoring.
    pub imperfect: Vec<InputEpisode>,
    /// The kept part of D_i; for training and export.
    pub kept: Vec<KeptInput>,
    /// The encoder's checkpoint; for scoring and training.
    pub encoder: Option<BlobId>,
    /// The checkpoint to resume from.
    pub checkpoint: Option<BlobId>,
    /// l of the encoder; for export.
    pub segment_length: u32,
    /// Where the dataset comes from, for people: names with values; for export.
    pub origin: BTreeMap<String, String>,
    /// The policy's checkpoint; for evaluation.
    pub policy: Option<BlobId>,
    /// The frozen values of the run to extend; for scoring.
    pub base: Option<FrozenRun>,
}

/// Some episodes of a job's input, as many as one message carries.
#[derive(Debug, Clone, PartialEq)]
pub enum InputPart {
    /// Of D_e.
    Experts(Vec<InputEpisode>),
    /// Of D_i; for pretraining and scoring.
    Imperfect(Vec<InputEpisode>),
    /// Of the kept part of D_i; for training and export.
    Kept(Vec<KeptInput>),
}

impl Inputs {
    /// Adds the next episodes.
    pub fn add(&mut self, part: InputPart) {
        match part {
            InputPart::Experts(episodes) => self.experts.extend(episodes),
            InputPart::Imperfect(episodes) => self.imperfect.extend(episodes),
            InputPart::Kept(episodes) => self.kept.extend(episodes),
        }
    }
}

/// The values that an extending score run takes over, besides scores.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenRun {
    /// w that maps to q = 0.
    pub lo: f64,
    /// w that maps to q = 1.
    pub hi: f64,
    /// Quantiles of the quantile and calibrated normalisers.
    pub quantiles: Vec<f64>,
    /// The experts, to which `match_episode` refers by index.
    pub expert_ids: Vec<EpisodeId>,
}

/// One episode of a job's input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputEpisode {
    /// The episode.
    pub id: EpisodeId,
    /// The blob that holds its MCAP.
    pub recording: BlobId,
    /// T, its number of steps.
    pub steps: u64,
    /// The name it was uploaded under; for people only, never a path.
    pub file_name: String,
    /// Its outcome when the snapshot was created.
    pub outcome: Outcome,
    /// Its cohort when the snapshot was created, or empty.
    pub cohort: String,
}

/// The kept segments of one imperfect episode, by end step.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptInput {
    /// The episode.
    pub episode: InputEpisode,
    /// Its kept segments.
    pub segments: Vec<KeptSegment>,
    /// w of every step of the episode; for export.
    pub similarities: Vec<f64>,
    /// q of every step of the episode; for export.
    pub qualities: Vec<f32>,
}

/// Progress of a worker.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Progress {
    /// Units done, out of `total`.
    pub done: u64,
    /// Final value of `done`; 0 while unknown.
    pub total: u64,
    /// Present activity.
    pub message: String,
    /// New values as (step, name, value).
    pub metrics: Vec<(u64, String, f64)>,
    /// Most memory held so far, in bytes.
    pub peak_memory_bytes: u64,
}

/// The result of a job.
#[derive(Debug, Clone, PartialEq)]
pub enum Made {
    /// Result of a pretrain job.
    Encoder {
        /// Its checkpoint.
        checkpoint: BlobId,
    },
    /// Result of a score job.
    Scores {
        /// w that maps to q = 0.
        lo: f64,
        /// w that maps to q = 1.
        hi: f64,
        /// Quantiles of the quantile and calibrated normalisers.
        quantiles: Vec<f64>,
        /// The experts, to which `match_episode` refers by index.
        expert_ids: Vec<EpisodeId>,
        /// The scores, in the snapshot's order.
        episodes: Vec<EpisodeScores>,
    },
    /// Result of a train job.
    Policy {
        /// Its checkpoint.
        checkpoint: BlobId,
        /// For example `finetune`.
        kind: String,
    },
    /// Result of an export job.
    Files(Vec<ExportFile>),
    /// Results of an evaluate job, in the order of its seeds.
    Trials(Vec<SeedResult>),
}
