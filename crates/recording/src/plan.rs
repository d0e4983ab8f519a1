//! The plan of an episode: which messages make up each step, and the steps' numbers. Everything but the pixels.
//!
//! Plain data. This module does not depend on the planner, which fills it, or on the inspection, which reads it.

pub(crate) mod choice;
pub(crate) mod clocks;
mod steps;
pub(crate) mod streams;

use std::collections::{BTreeMap, BTreeSet};

use crate::channels::Channels;
use crate::picture::Channel;
use crate::video::Reel;
use gleaner_core::Report;

pub(crate) use steps::Steps;

/// The steps of one recording.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) profile: String,
    /// Every channel of the file, for another pass over it.
    pub(crate) channels: Channels,
    /// Whether some messages come before the declaration of their channel.
    pub(crate) declared_late: bool,
    pub(crate) clock_topic: String,
    /// The clock's message of each step, by its index in the topic.
    pub(crate) clock: Vec<usize>,
    /// Log time of the clock's message of each step.
    pub(crate) log_times: Vec<i64>,
    pub(crate) stamps: Vec<i64>,
    pub(crate) images: Vec<ImageStream>,
    /// The topics of video.
    pub(crate) reels: BTreeMap<String, Reel>,
    /// The topics of transforms, on each of whose messages all later poses may depend.
    pub(crate) cumulative: BTreeSet<String>,
    /// For each topic, the messages that the steps use, by their index in the topic: one row a stream.
    pub(crate) used: BTreeMap<String, Vec<Vec<usize>>>,
    /// T×M, row-major.
    pub(crate) proprioception: Vec<f32>,
    /// T×A, row-major.
    pub(crate) action: Vec<f32>,
    pub(crate) report: Report,
}

/// One topic of images.
#[derive(Debug)]
pub(crate) struct ImageStream {
    pub(crate) topic: String,
    /// Index of the camera in the task.
    pub(crate) camera: usize,
    pub(crate) channel: Channel,
    /// The message of each step, by its index in the topic.
    pub(crate) picks: Vec<usize>,
    /// Whether its pictures depend on messages before them.
    pub(crate) video: bool,
}
