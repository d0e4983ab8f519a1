//! SSDF: pretraining, quality scores and policies, on tensors.
//!
//! Plain data goes in and plain data comes out: no tensor appears in the interface, and checkpoints are bytes that the
//! caller stores. The crate depends on no servers, files, recordings or databases.
//!
//! 1. [`TaskShape`] and [`Trajectory`] describe a step and an episode, whose steps a [`StepSource`] reads.
//! 2. [`pretrain`] turns episodes into an encoder; its settings are [`PretrainSpec`](gleaner_core::PretrainSpec).
//! 3. [`score`](fn@score) gives each segment of the imperfect episodes a quality; [`extend_scores`] adds to a run, and
//!    [`LiveScorer`] scores episodes that are not stored.
//! 4. [`train_policy`] trains a policy on experts and weighted segments, and [`Policy`] acts with it.
//!
//! Several processes can share one training or one score run: [`pretrain_with`], [`train_policy_with`] and [`score_with`]
//! take [`Peers`]. [`Shards`] divide other work among them.
//!
//! Each stage reports to a [`Monitor`], which stores checkpoints and cancels. [`kinds`] lists the policies,
//! weightings, objectives and scorers of the crate.
//!
//! ```no_run,standalone_crate
//! use gleaner_core::{PretrainSpec, ScoreSpec, TrainSpec};
//! use gleaner_learn::{
//!     Forgetful, LearnError, Pretrained, ScoreInputs, Silent, TaskShape, Trajectory, WeightedSegments, pretrain, score,
//!     train_policy,
//! };
//!
//! # fn stages(shape: &TaskShape, experts: &[Trajectory], imperfect: &[Trajectory]) -> Result<Vec<u8>, LearnError> {
//! let all: Vec<Trajectory> = experts.iter().chain(imperfect).cloned().collect();
//! let encoder = pretrain(shape, &all, &PretrainSpec::default(), None, None, &mut Silent)?;
//! let inputs = ScoreInputs { encoder: &encoder, experts, imperfect, kept: &Forgetful };
//! let scores = score(inputs, &ScoreSpec::default(), &mut Silent)?;
//! let good = imperfect.iter().zip(&scores.imperfect).map(|(trajectory, scores)| WeightedSegments {
//!     trajectory: trajectory.clone(),
//!     steps: (0..).zip(scores.q.iter().copied()).filter(|(_, q)| *q > 0.9).collect(),
//! });
//! let kept: Vec<WeightedSegments> = good.collect();
//! train_policy(shape, Pretrained::encoder(&encoder), experts, &kept, &TrainSpec::default(), None, &mut Silent)
//! # }
//! ```

mod ahead;
mod augment;
mod batch;
mod checkpoint;
mod device;
mod dropout;
mod error;
mod family;
mod finished;
#[cfg(test)]
mod gpu;
mod history;
mod kinds;
mod model;
mod normalize;
mod objective;
mod optimizer;
#[cfg(test)]
mod own_process;
mod peers;
mod policy;
mod precision;
mod pretrain;
mod progress;
mod random;
mod score;
mod shape;
mod shards;
mod steps;
#[cfg(test)]
mod toy;
mod train;
mod trajectory;
mod validation;
mod weighting;

pub use checkpoint::{CheckpointInfo, CheckpointKind, FORMAT_VERSION, inspect};
pub use device::set_threads;
pub use error::{LearnError, SourceError};
pub use history::{Embedding, History};
pub use kinds::kinds;
pub use peers::Peers;
pub use policy::{Observed, Policy, PolicySession, Pretrained, train_policy, train_policy_with};
pub use pretrain::{pretrain, pretrain_with};
pub use score::{
    EpisodeScores, FeatureScale, FeatureStore, Forgetful, LiveScorer, Normaliser, ScoreBase, ScoreInputs, Scores,
    SegmentScore, Similarity, extend_scores, features_kind, score, score_with,
};
pub use shape::{CameraShape, TaskShape};
pub use shards::{Form, Shards};
pub use steps::{Numbers, StepSource, StepWidths};
pub use train::{Monitor, Participant, Silent};
pub use trajectory::{Trajectory, WeightedSegments};
