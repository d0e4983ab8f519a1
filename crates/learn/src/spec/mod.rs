//! What a caller asks for: the task's shape, model sizes and the settings of each job, with their
//! checks. Pure values; knows nothing of tensors or of how a job runs.

mod augmentation;
mod model;
mod optim;
mod pretrain;
mod run;
mod score;
mod shape;
mod train;

pub use augmentation::Augmentation;
pub use model::{Device, ModelSpec, Preset};
pub use optim::OptimSpec;
pub use pretrain::{Objective, PretrainSpec};
pub use score::{FeatureScale, NormaliserKind, ScoreSpec, Scorer, Similarity, Yardstick};
pub use shape::{CameraShape, TaskShape};
pub use train::{ActSpec, PolicyKind, TrainSpec};

use crate::error::LearnError;

/// Fails with `field` unless `low <= value <= high`; a value that is not a number fails too.
fn within(field: &str, value: f64, low: f64, high: f64) -> Result<(), LearnError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(LearnError::invalid(field, format!("is {value}, must be between {low} and {high}")))
}
