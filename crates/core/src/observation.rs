//! Inputs and outputs of robots: observations, actions, and timings.
//!
//! Observations are raw: not yet checked against a task, and with encoded images.

use std::time::Duration;

use super::{
    action::ActionRanges,
    ensemble::Execution,
    episode::Outcome,
    id::{EpisodeId, PolicyId, SessionId, TaskId},
    score::SegmentScored,
    time::Millis,
};

/// Encoding of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// Detected from the first bytes: JPEG or PNG.
    Any,
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
    /// Rows of RGB bytes, or of little-endian 16-bit millimetres for depth.
    Raw,
}

/// One encoded image.
#[derive(Debug, Clone)]
pub struct Image {
    /// The encoding.
    pub format: ImageFormat,
    /// Its bytes.
    pub data: bytes::Bytes,
}

/// The images of one camera.
#[derive(Debug, Clone)]
pub struct CameraFrame {
    /// The task's name for the camera.
    pub camera: String,
    /// The color image.
    pub color: Option<Image>,
    /// The depth image, for cameras with depth.
    pub depth: Option<Image>,
}

/// A robot's measurements at one step.
#[derive(Debug, Clone)]
pub struct Observation {
    /// The robot's clock, in nanoseconds; returned with the actions.
    pub stamp_ns: i64,
    /// One frame for each of the task's cameras, in any order.
    pub cameras: Vec<CameraFrame>,
    /// The proprioception vector, in physical units.
    pub proprioception: Vec<f32>,
    /// The action executed since the observation before; empty: the action of the policy.
    pub executed_action: Vec<f32>,
    /// Time from the arrival of the observation until its response is useless; `None`: the session's deadline.
    pub deadline: Option<Duration>,
    /// Control steps since the observation before for which none was sent.
    pub skipped_steps: u32,
}

/// Time spent in each stage of one request, in microseconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Timings {
    /// Checking and decoding.
    pub decode_us: u64,
    /// In the queue of the model.
    pub queue_us: u64,
    /// Waiting, while the model is idle, for other requests of the same batch.
    pub batch_us: u64,
    /// In the model, for the whole batch.
    pub model_us: u64,
    /// From arrival to response.
    pub total_us: u64,
    /// Requests in the same batch; 0 for a request that did not reach the model.
    pub batch_size: u32,
}

/// The response to one observation.
#[derive(Debug, Clone)]
pub struct Acted {
    /// The stamp of the observation.
    pub stamp_ns: i64,
    /// Actions in physical units, one for each control period.
    pub actions: Vec<Vec<f32>>,
    /// The policy that computed the actions.
    pub policy_id: PolicyId,
    /// Time spent in each stage.
    pub timings: Timings,
}

/// The settings of a session, as its robot opens it.
#[derive(Debug, Clone, Default)]
pub struct SessionSettings {
    /// The deployment whose policy acts.
    pub deployment: String,
    /// Control steps per second; `None`: the task's rate.
    pub control_rate_hz: Option<f64>,
    /// The deadline of observations without one of their own.
    pub deadline: Option<Duration>,
    /// The cohort of the recorded episode; `None`: the session is not recorded.
    pub record: Option<String>,
    /// Seed of the numbers that a policy draws its actions from.
    pub seed: u64,
    /// Whether each observation gets a new chunk, and never the rest of one: for robots of protocols in which they do not
    /// state how many actions of a chunk they execute.
    pub new_chunks: bool,
}

/// Messages from a robot in a session.
#[derive(Debug, Clone)]
pub enum SessionInput {
    /// The first message, sent once.
    Open(SessionSettings),
    /// A new observation.
    Observation(Observation),
    /// The last message.
    Close {
        /// Outcome of the recorded episode.
        outcome: Outcome,
    },
}

/// Messages to a robot in a session.
#[derive(Debug, Clone)]
pub enum SessionOutput {
    /// The session is open; its policy is fixed.
    Opened {
        /// Its id.
        session_id: SessionId,
        /// The policy of the session.
        policy_id: PolicyId,
        /// The task.
        task_id: TaskId,
        /// The values that the robot executes.
        ranges: ActionRanges,
        /// How the policy's chunks are executed.
        execution: Execution,
    },
    /// Actions for an observation.
    Action {
        /// The actions.
        acted: Acted,
        /// Observations skipped since the last response.
        dropped: u64,
        /// The score of the newest scored segment.
        score: Option<SegmentScored>,
    },
    /// No action for an observation with a deadline: it passed, or the policy's own server does not answer.
    Missed {
        /// The stamp of the observation.
        stamp_ns: i64,
        /// Observations skipped since the last response.
        dropped: u64,
        /// Time spent in each stage until the deadline.
        timings: Timings,
        /// Why there is no action, where it is another cause than time; empty otherwise.
        reason: String,
    },
    /// The server is stopping, and ends the session at `close_at`.
    Draining {
        /// When the session ends.
        close_at: Millis,
    },
    /// The session has ended.
    Closed {
        /// Observations answered.
        observations: u64,
        /// Observations skipped.
        dropped: u64,
        /// Observations whose deadline passed.
        missed: u64,
        /// The recorded episode, if any.
        episode_id: Option<EpisodeId>,
    },
}
