//! Events from a session to the task that writes its recording, and the memory they may take until written.

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

/// The most data of one session that may wait for the disk, in KiB.
const ROOM: u32 = 32 << 10;

/// The room of one session. Events beyond it are left out: a robot does not wait for the disk.
#[derive(Debug, Clone)]
pub(super) struct Queue(Arc<Semaphore>);

/// The room of one event, released on drop.
pub(super) type QueuePermit = OwnedSemaphorePermit;

/// A complete step on its way to the writer.
pub(super) type Written = Step<QueuePermit>;

/// A message beside the steps.
#[derive(Debug)]
pub(super) struct Note {
    pub(super) topic: &'static str,
    pub(super) stamp_ns: i64,
    pub(super) value: serde_json::Value,
    /// The most bytes of it as text.
    pub(super) bytes: u64,
    pub(super) _room: QueuePermit,
}

/// The end of a session.
#[derive(Debug, Clone)]
pub(super) struct Ending {
    pub(super) outcome: Outcome,
    /// A description for the recording's metadata.
    pub(super) how: String,
    pub(super) answered: u64,
    pub(super) dropped: u64,
    pub(super) missed: u64,
    /// Segments without a score; `None`: not counted.
    pub(super) unscored: Option<u64>,
    /// Steps and notes left out for lack of room.
    pub(super) left_out: u64,
}

/// An event for the recording's task.
#[derive(Debug)]
pub(super) enum Event {
    Step(Box<Written>),
    Note(Note),
    /// The last event. The episode's id, if one is stored, is sent back.
    End(Ending, oneshot::Sender<Result<Option<EpisodeId>>>),
}

impl Queue {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(ROOM as usize)))
    }

    /// Room for this many bytes, if there is. A single event always has room, however large.
    pub(super) fn room(&self, bytes: usize) -> Option<QueuePermit> {
        let kib = u32::try_from(bytes.div_ceil(1024)).unwrap_or(u32::MAX).clamp(1, ROOM);
        Arc::clone(&self.0).try_acquire_many_owned(kib).ok()
    }
}

/// The bytes of an observation, including its frames' own when they hold no images.
pub(super) fn bytes(observation: &Observation) -> usize {
    let frame = |frame: &CameraFrame| {
        let of = |image: &Option<crate::domain::observation::Image>| image.as_ref().map_or(0, |image| image.data.len());
        size_of::<CameraFrame>() + frame.camera.len() + of(&frame.color) + of(&frame.depth)
    };
    let numbers = observation.proprioception.len() + observation.executed_action.len();
    observation.cameras.iter().map(frame).sum::<usize>() + numbers * size_of::<f32>()
}
