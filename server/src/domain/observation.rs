//! What robots send and get back: observations, actions, and where the time went.
//!
//! Observations are as they came: not yet checked against a task, images not yet decoded.

use std::time::Duration;

use super::{
    episode::Outcome,
    id::{EpisodeId, PolicyId, SessionId, TaskId},
    score::SegmentScored,
    time::Millis,
};

/// How an image's bytes are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// Told from the first bytes: JPEG or PNG.
    Any,
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
    /// Rows of RGB bytes, or of little-endian 16-bit millimetres for depth.
    Raw,
}

/// One image as it came.
#[derive(Debug, Clone)]
pub struct Image {
    /// How to read it.
    pub format: ImageFormat,
    /// Its bytes.
    pub data: bytes::Bytes,
}

/// What one camera saw.
#[derive(Debug, Clone)]
pub struct CameraFrame {
    /// The task's name for the camera.
    pub camera: String,
    /// The color image.
    pub color: Option<Image>,
    /// The depth image, for cameras with depth.
    pub depth: Option<Image>,
}

/// What a robot sees and feels at one step.
#[derive(Debug, Clone)]
pub struct Observation {
    /// The robot's clock, in nanoseconds; comes back with the actions.
    pub stamp_ns: i64,
    /// One frame for each of the task's cameras, in any order.
    pub cameras: Vec<CameraFrame>,
    /// The proprioception vector, in physical units.
    pub proprioception: Vec<f32>,
    /// The action executed since the observation before; empty: the one the policy gave.
    pub executed_action: Vec<f32>,
    /// How long after its arrival an answer is of use; `None`: as the session says.
    pub deadline: Option<Duration>,
}

/// Where the time of one request went, in microseconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Timings {
    /// Checking and decoding.
    pub decode_us: u64,
    /// Waiting for the model.
    pub queue_us: u64,
    /// Waiting, with a free model, for others to share its batch.
    pub batch_us: u64,
    /// In the model, with everything that was batched.
    pub model_us: u64,
    /// From arrival to answer.
    pub total_us: u64,
    /// Requests that went through the model together; 0: it did not come so far.
    pub batch_size: u32,
}

/// The answer to one observation.
#[derive(Debug, Clone)]
pub struct Acted {
    /// The stamp of the observation that was answered.
    pub stamp_ns: i64,
    /// Actions in physical units, one a control period.
    pub actions: Vec<Vec<f32>>,
    /// The policy that answered.
    pub policy_id: PolicyId,
    /// Where the time went.
    pub timings: Timings,
}

/// The settings of a session, as its robot opens it.
#[derive(Debug, Clone, Default)]
pub struct SessionSettings {
    /// The deployment that acts.
    pub deployment: String,
    /// Control steps per second; `None`: the task's rate.
    pub control_rate_hz: Option<f64>,
    /// The deadline of observations without one of their own.
    pub deadline: Option<Duration>,
    /// The cohort of the recorded episode; `None`: the session is not recorded.
    pub record: Option<String>,
}

/// A message of a robot in a session.
#[derive(Debug, Clone)]
pub enum SessionInput {
    /// First, and only once.
    Open(SessionSettings),
    /// What it sees now.
    Observation(Observation),
    /// Last.
    Close {
        /// How it ended, for the recorded episode.
        outcome: Outcome,
    },
}

/// What a session answers.
#[derive(Debug, Clone)]
pub enum SessionOutput {
    /// The session is there; its policy will not change.
    Opened {
        /// Its id.
        session_id: SessionId,
        /// The policy it keeps.
        policy_id: PolicyId,
        /// The task.
        task_id: TaskId,
    },
    /// Actions for an observation.
    Action {
        /// The actions.
        acted: Acted,
        /// Observations passed over since the last answer.
        dropped: u64,
        /// Of the newest segment that has been scored.
        score: Option<SegmentScored>,
    },
    /// No action for an observation: it would have come too late.
    Missed {
        /// The stamp of the observation.
        stamp_ns: i64,
        /// Observations passed over since the last answer.
        dropped: u64,
        /// Where the time went until its deadline.
        timings: Timings,
    },
    /// The server is stopping and will end the session then.
    Draining {
        /// When.
        close_at: Millis,
    },
    /// The session is over.
    Closed {
        /// Observations answered.
        observations: u64,
        /// Observations passed over.
        dropped: u64,
        /// Observations that could not be answered in time.
        missed: u64,
        /// What was recorded.
        episode_id: Option<EpisodeId>,
    },
}
