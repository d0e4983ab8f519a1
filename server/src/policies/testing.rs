//! A model for tests: counts what it sees, and waits, fails or panics when told.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests only")]

use std::sync::{Arc, Mutex};

use gleaner_learn::{CameraShape, TaskShape};
use tokio::sync::mpsc;

use super::{
    engine::{Engine, Identity},
    model::{Advanced, Model, Step, Turn},
};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        observation::{CameraFrame, Image, ImageFormat, Observation},
    },
    error::{Error, Result},
};

/// A proprioception that makes the model panic, fail, or give no number.
pub(super) const PANIC: f32 = 666.0;
pub(super) const FAIL: f32 = 667.0;
pub(super) const NAN: f32 = 668.0;

/// Acts with (proprioception[0], steps remembered), and remembers each step's proprioception and executed action.
pub(super) struct Counting {
    shape: TaskShape,
    batches: Arc<Mutex<Vec<usize>>>,
    gate: Option<mpsc::UnboundedReceiver<()>>,
    gate_lock: Mutex<Option<mpsc::UnboundedReceiver<()>>>,
}

/// The test's side of a [`Counting`] model.
pub(super) struct Control {
    /// The size of every batch, the warm-up's first.
    pub(super) batches: Arc<Mutex<Vec<usize>>>,
    /// One permit a batch, if the model is gated.
    pub(super) gate: mpsc::UnboundedSender<()>,
}
