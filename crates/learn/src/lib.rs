//! SSDF: pretraining, quality scores and policies, on tensors.
//!
//! Inputs and outputs are plain data: no tensor leaves this crate, and it must not depend on servers, files, recordings
//! or databases. Checkpoints are bytes, which the caller stores.
//!
//! The three steps of the method are [`pretrain`], [`score`](fn@score) and [`train_policy`];
//! [`Policy`] runs their result.

mod batch;
mod checkpoint;
mod device;
mod error;
mod history;
mod kinds;
mod model;
mod normalize;
mod objective;
mod optimizer;
mod policy;
mod pretrain;
mod random;
mod score;
mod shape;
#[cfg(test)]
mod toy;
mod train;
mod trajectory;

pub use checkpoint::{CheckpointInfo, CheckpointKind, FORMAT_VERSION, inspect};
pub use device::set_threads;
pub use error::LearnError;
pub use history::{Embedding, History};
pub use kinds::kinds;
pub use policy::{Ensemble, Policy, train_policy};
pub use pretrain::pretrain;
pub use score::{
    EpisodeScores, FeatureScale, FeatureStore, Forgetful, LiveScorer, Normaliser, ScoreBase, ScoreInputs, Scores,
    SegmentScore, Similarity, extend_scores, features_kind, score,
};
pub use shape::{CameraShape, TaskShape};
pub use train::{Monitor, Silent};
pub use trajectory::{FrameBytes, Trajectory, WeightedSegments};
