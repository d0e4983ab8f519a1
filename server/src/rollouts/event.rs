//! What a session tells the task that writes it down, and the room that this may take until it is written.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::steps::Step;
use crate::{
    domain::{
        episode::Outcome,
        id::EpisodeId,
        observation::{CameraFrame, Observation},
    },
    error::Result,
};

/// Most of one session that may wait for the disk, in KiB.
const ROOM: u32 = 32 << 10;

/// The room of one session. Whatever does not fit is left out: a robot does not wait for the disk.
#[derive(Debug, Clone)]
pub(super) struct Queue(Arc<Semaphore>);

/// The room that something takes, until it is dropped.
pub(super) type Room = OwnedSemaphorePermit;

/// A step as it comes to the tape.
pub(super) type Written = Step<Room>;

/// Something beside the steps.
#[derive(Debug)]
pub(super) struct Note {
    pub(super) topic: &'static str,
    pub(super) stamp_ns: i64,
    pub(super) value: serde_json::Value,
    /// Most bytes of it as text.
    pub(super) bytes: u64,
    pub(super) _room: Room,
}

/// How a session ended.
#[derive(Debug, Clone)]
pub(super) struct Ending {
    pub(super) outcome: Outcome,
    /// In words.
    pub(super) how: String,
    pub(super) answered: u64,
    pub(super) dropped: u64,
    pub(super) missed: u64,
    /// Segments without a score; `None`: nobody counted them.
    pub(super) unscored: Option<u64>,
    /// Steps and notes there was no room for.
    pub(super) left_out: u64,
}

/// What goes to the task.
#[derive(Debug)]
pub(super) enum Event {
    Step(Box<Written>),
    Note(Note),
    /// The last. Whoever waits is told the episode, if there is one.
    End(Ending, oneshot::Sender<Result<Option<EpisodeId>>>),
}

impl Queue {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(ROOM as usize)))
    }

    /// Room for so many bytes, if there is. One thing alone always has room, however large.
    pub(super) fn room(&self, bytes: usize) -> Option<Room> {
        let kib = u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX).clamp(1, ROOM);
        Arc::clone(&self.0).try_acquire_many_owned(kib).ok()
    }
}

/// The bytes that an observation holds: its frames too, should they be without images.
pub(super) fn bytes(observation: &Observation) -> usize {
    let frame = |frame: &CameraFrame| {
        let of = |image: &Option<crate::domain::observation::Image>| image.as_ref().map_or(0, |image| image.data.len());
        size_of::<CameraFrame>() + frame.camera.len() + of(&frame.color) + of(&frame.depth)
    };
    let numbers = observation.proprioception.len() + observation.executed_action.len();
    observation.cameras.iter().map(frame).sum::<usize>() + numbers * size_of::<f32>()
}
