//! stub
#![allow(missing_docs)]
use crate::error::LearnError;
use crate::spec::{ModelSpec, TaskShape};
use serde::{Deserialize, Serialize};
pub const FORMAT_VERSION: u32 = 1;
/// What a checkpoint holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckpointKind {
    /// A pretrained transformer.
    Encoder,
    /// A trained policy.
    Policy,
}
/// The header of a checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointInfo {
    /// The file format, [`FORMAT_VERSION`] here.
    pub format_version: u32,
    /// What it holds.
    pub kind: CheckpointKind,
    /// Gradient steps done.
    pub step: u64,
    /// Whether training is done.
    pub finished: bool,
    /// The task's shape.
    pub shape: TaskShape,
    /// The model.
    pub model: ModelSpec,
    /// The job's settings, a JSON text.
    pub spec: String,
}
pub fn inspect(_bytes: &[u8]) -> Result<CheckpointInfo, LearnError> {
    Err(LearnError::Torch("not built yet".into()))
}
