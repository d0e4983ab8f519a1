//! What a training reports to, and the part of a process in it.

use crate::peers::Peers;

/// Receives progress and checkpoints of a job, and may request a stop.
pub trait Monitor {
    /// `step` of `total` are done; `metrics` are (name, value). Called for every step in order: after it, or on a GPU
    /// after some more.
    fn progress(&mut self, step: u64, total: u64, metrics: &[(&'static str, f64)]);

    /// Stores `bytes`, from which the job can resume after `step` steps. Called at intervals, and when the job is asked
    /// to stop.
    ///
    /// # Errors
    /// The reason why storing failed; the job then fails.
    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String>;

    /// Whether to stop now; called before every step.
    fn cancelled(&self) -> bool;
}

/// A monitor that ignores all reports.
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

/// A process's part in a training.
pub struct Participant<'a> {
    /// A checkpoint that a monitor stored, the same for every rank. The number of ranks may differ from before.
    pub resume: Option<&'a [u8]>,
    /// The processes that work on each batch.
    pub peers: &'a mut Peers,
    /// That of rank 0 receives reports; any rank's may request a stop.
    pub monitor: &'a mut dyn Monitor,
}
