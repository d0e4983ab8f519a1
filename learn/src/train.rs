//! stub
#![allow(missing_docs)]
use crate::error::LearnError;
use crate::spec::{PretrainSpec, TaskShape};
use crate::trajectory::Trajectory;
/// Whoever watches a job: takes progress and checkpoints, and may ask it to stop.
pub trait Monitor {
    /// `step` of `total` are done; `metrics` are (name, value).
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]);
    /// Keeps `bytes`, from which the job can resume after `step` steps.
    ///
    /// # Errors
    /// Why it could not; the job then fails.
    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String>;
    /// Whether to stop now; asked before every step.
    fn cancelled(&self) -> bool;
}
/// A monitor that watches nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;
impl Monitor for Silent {
    fn progress(&mut self, _: u64, _: u64, _: &[(&'static str, f64)]) {}
    fn checkpoint(&mut self, _: u64, _: &[u8]) -> Result<(), String> {
        Ok(())
    }
    fn cancelled(&self) -> bool {
        false
    }
}
pub fn pretrain(
    _shape: &TaskShape,
    _data: &[Trajectory],
    _spec: &PretrainSpec,
    _resume: Option<&[u8]>,
    _monitor: &mut dyn Monitor,
) -> Result<Vec<u8>, LearnError> {
    Err(LearnError::Torch("not built yet".into()))
}
