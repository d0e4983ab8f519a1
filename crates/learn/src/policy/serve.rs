//! A trained policy that acts: it embeds each frame once and acts for many sessions in one pass. Independent of the kind of
//! policy and of how sessions are served.

use std::fmt;

use gleaner_core::Device;
use tch::no_grad_guard;

use super::kind::{PolicyInfo, PolicyInput, PolicyModel};
use super::shares::shares;
use super::source::Source;
use crate::batch::{Segments, values};
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind};
use crate::device;
use crate::error::{LearnError, guard};
use crate::history::{Embedding, History, Layout, Stacked};
use crate::shape::TaskShape;
use crate::train::Learner;
use crate::trajectory::Trajectory;

/// A policy ready to act. `Send`, so that it can have a separate thread.
pub struct Policy {
    info: CheckpointInfo,
    model: Box<dyn PolicyModel>,
    hides_history: bool,
}

impl fmt::Debug for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Policy").field("info", &self.info).finish_non_exhaustive()
    }
}

impl Policy {
    /// Loads a policy checkpoint of any kind, on the CPU.
    ///
    /// # Errors
    /// [`LearnError::Checkpoint`] or [`LearnError::Version`] if `bytes` are not a usable policy.
    pub fn load(bytes: &[u8]) -> Result<Self, LearnError> {
        Self::load_on(bytes, Device::Cpu)
    }

    /// As [`Policy::load`], on a chosen device.
    ///
    /// # Errors
    /// As [`Policy::load`], and [`LearnError::Invalid`] if the device does not exist.
    pub fn load_on(bytes: &[u8], device: Device) -> Result<Self, LearnError> {
        guard(|| {
            let device = device::open(device, None)?;
            let (info, named) = checkpoint::read(bytes, CheckpointKind::Policy)?;
            Ok(Self { model: Learner::from_named(&info, &named, device)?, info, hides_history: false })
        })
    }

    /// The name of its kind.
    pub fn kind(&self) -> &str {
        self.info.policy.as_deref().unwrap_or_default()
    }

    /// The task's shape.
    pub fn shape(&self) -> &TaskShape {
        &self.info.shape
    }

    /// The segment length l, for a new [`History`]. 0 for a policy without history.
    pub fn segment_length(&self) -> u32 {
        self.info.model.segment_length
    }

    /// Actions that [`Policy::act`] returns for each history, k; 1 for a policy that predicts single actions.
    pub fn chunk_length(&self) -> u32 {
        u32::try_from(self.model.info().chunk).unwrap_or(u32::MAX)
    }

    /// Actions executed of each chunk before the next is predicted; 0 for a policy whose chunks are ensembled.
    pub(super) fn horizon(&self) -> u32 {
        self.model.horizon()
    }

    /// The same policy, with the past hidden as in the training windows whose past was hidden: all of it, so that it acts
    /// on the newest step alone, or its actions. A policy with a `history_dropout` of 1 always acts so.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the policy has a history and training never hid it.
    pub fn hiding_history(self) -> Result<Self, LearnError> {
        if self.segment_length() > 0 && self.model.history().history_dropout == 0.0 {
            return Err(LearnError::invalid(
                "hide_history",
                "needs a policy that was trained with its history hidden at times; train with history_dropout above 0",
            ));
        }
        Ok(Self { hides_history: true, ..self })
    }

    fn hides_history(&self) -> bool {
        self.hides_history || self.model.history().always_hides()
    }

    /// What the policy looks at in `episodes`: the share of its action that each input explains, as a training reports
    /// it, by pairs of steps that `seed` draws. Empty if fewer than two episodes are as long as its history.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if an episode does not fit the shape.
    pub fn shares(&self, episodes: &[Trajectory], seed: u64) -> Result<Vec<(&'static str, f64)>, LearnError> {
        for episode in episodes {
            episode.validate(self.shape())?;
        }
        guard(|| {
            let data: Vec<&Trajectory> = episodes.iter().collect();
            let source = Source { segments: Segments::every(&data), data };
            shares(self.model.as_ref(), &source, self.hides_history(), seed)
        })
    }

    /// Encodes frames, each with the layout of one step of [`StepSource`](crate::StepSource).
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a frame's length does not fit the shape.
    pub fn embed(&self, frames: &[&[u8]]) -> Result<Vec<Embedding>, LearnError> {
        let about = self.model.info();
        let images = |frames: &[&[u8]]| about.statistics.frames(about.shape, frames, about.device);
        layout(&about).embed(frames, |frames| self.model.encode(&images(frames)))
    }

    /// The next k actions of each history, the first for now, in physical units and within the task's ranges, so that
    /// each can be executed and remembered as it is; one pass for all. k is
    /// [`Policy::chunk_length`]; a [`PolicySession`](crate::PolicySession) executes chunks.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a history is empty, of another segment length, or holds values
    /// that do not fit the shape or are not finite.
    pub fn act(&self, histories: &[&History]) -> Result<Vec<Vec<Vec<f32>>>, LearnError> {
        let about = self.model.info();
        layout(&about).check(histories)?;
        if histories.is_empty() {
            return Ok(Vec::new());
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            // The newest action is not known yet, and no policy reads it.
            let Stacked { embedded, proprioception, action, windows, draws } = layout(&about).stack(histories);
            let hidden = self.model.history().hidden(&windows, &vec![self.hides_history(); histories.len()]);
            let input = PolicyInput { embedded, proprioception, action, windows, hidden, draws, before: 0 };
            let chunks = self.model.act(&input);
            let chunks = values(&about.statistics.actions(&chunks));
            let executed = |action: &[f32]| {
                let mut action = action.to_vec();
                about.shape.ranges.apply(&mut action);
                action
            };
            let chunks = chunks.chunks(about.chunk * about.shape.action);
            Ok(chunks.map(|chunk| chunk.chunks(about.shape.action).map(executed).collect()).collect())
        })
    }
}

/// The required form of histories for a policy.
fn layout<'a>(about: &PolicyInfo<'a>) -> Layout<'a> {
    Layout { shape: about.shape, window: about.window, width: about.width, device: about.device }
}
