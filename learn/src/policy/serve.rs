//! A trained policy that acts: embeds each frame once, acts for many sessions in one pass. Knows
//! nothing of sessions themselves, nor of which kind of policy it is.

use std::fmt;

use tch::no_grad_guard;

use super::history::{Embedding, History, Step};
use super::method::{About, Method, Seen};
use crate::batch::{Windows, images, rows, values};
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind};
use crate::device;
use crate::error::{LearnError, guard};
use crate::spec::{Device, PolicyKind, TaskShape};
use crate::train::Learner;

/// Frames encoded in one pass; bounds memory, whatever is asked.
const CHUNK: usize = 64;

/// A policy ready to act. `Send`: give it a thread of its own.
pub struct Policy {
    info: CheckpointInfo,
    method: Box<dyn Method>,
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
    /// [`LearnError::Checkpoint`] or [`LearnError::Version`] if `bytes` are no usable policy.
    pub fn load(bytes: &[u8]) -> Result<Self, LearnError> {
        Self::load_on(bytes, Device::Cpu)
    }

    /// As [`Policy::load`], on a device of choice.
    ///
    /// # Errors
    /// As [`Policy::load`], and [`LearnError::Invalid`] if there is no such device.
    pub fn load_on(bytes: &[u8], device: Device) -> Result<Self, LearnError> {
        guard(|| {
            let device = device::open(device, None)?;
            let (info, named) = checkpoint::read(bytes, CheckpointKind::Policy)?;
            Ok(Self { method: Learner::from_named(&info, &named, device)?, info })
        })
    }

    /// Which policy it is.
    pub fn kind(&self) -> PolicyKind {
        self.info.policy.unwrap_or_default()
    }

    /// The task's shape.
    pub fn shape(&self) -> &TaskShape {
        &self.info.shape
    }

    /// The segment length l; make a [`History`] with it. 0 for a policy without history.
    pub fn segment_length(&self) -> u32 {
        self.info.model.segment_length
    }

    /// Actions that [`Policy::act`] gives at once, k; 1 but for ACT.
    pub fn chunk_length(&self) -> u32 {
        self.info.act.map_or(1, |act| act.chunk_length)
    }

    /// Encodes frames, each laid out as one step of [`FrameBytes`](crate::FrameBytes).
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a frame's length does not fit the shape.
    pub fn embed(&self, frames: &[&[u8]]) -> Result<Vec<Embedding>, LearnError> {
        let about = self.method.about();
        let expected = about.shape.frame_bytes();
        for (i, frame) in frames.iter().enumerate() {
            expect_length(&format!("frames[{i}]"), frame.len(), expected)?;
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let mut embeddings = Vec::with_capacity(frames.len());
            for chunk in frames.chunks(CHUNK) {
                let images = images(about.shape, chunk, about.device);
                let embedded = values(&self.method.embed_images(&images));
                let each = embedded.chunks(about.width);
                embeddings.extend(each.map(|row| Embedding(row.to_vec())));
            }
            Ok(embeddings)
        })
    }

    /// The next k actions of each history, the first for now, in physical units; one pass for all.
    /// k is [`Policy::chunk_length`]; [`Ensemble`](crate::Ensemble) makes one action of many chunks.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a history is empty, of another segment length, or holds values
    /// that do not fit the shape or are not finite.
    pub fn act(&self, histories: &[&History]) -> Result<Vec<Vec<Vec<f32>>>, LearnError> {
        let about = self.method.about();
        for (i, history) in histories.iter().enumerate() {
            check(&about, &format!("histories[{i}]"), history)?;
        }
        if histories.is_empty() {
            return Ok(Vec::new());
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let chunks = self.method.act(&lay_out(&about, histories));
            let chunks = values(&about.statistics.action.invert(&chunks));
            let chunks = chunks.chunks(about.chunk * about.shape.action);
            Ok(chunks.map(|chunk| chunk.chunks(about.shape.action).map(<[f32]>::to_vec).collect()).collect())
        })
    }
}

/// All histories padded on the left to full windows.
fn lay_out(about: &About<'_>, histories: &[&History]) -> Seen {
    let (shape, width) = (about.shape, about.width);
    let (mut o, mut m, mut a, mut valid) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for history in histories {
        let padding = about.window - history.len();
        o.resize(o.len() + padding * width, 0.0);
        m.resize(m.len() + padding * shape.proprioception, 0.0);
        a.resize(a.len() + padding * shape.action, 0.0);
        valid.resize(valid.len() + padding, false);
        for step in history.steps() {
            o.extend_from_slice(&step.embedding.0);
            m.extend_from_slice(&step.proprioception);
            // The newest action is not known yet, and no policy looks at it.
            let end = a.len() + shape.action;
            a.extend_from_slice(step.executed.as_deref().unwrap_or_default());
            a.resize(end, 0.0);
            valid.push(true);
        }
    }
    Seen {
        embedded: rows(&o, width, about.device),
        proprioception: rows(&m, shape.proprioception, about.device),
        action: rows(&a, shape.action, about.device),
        windows: Windows::in_order(valid, about.window, about.device),
        hidden: None,
    }
}

fn check(about: &About<'_>, field: &str, history: &History) -> Result<(), LearnError> {
    if history.window() != about.window {
        return Err(LearnError::invalid(
            field,
            format!(
                "keeps {} steps, this policy needs {}; make it with its segment length",
                history.window(),
                about.window
            ),
        ));
    }
    if history.is_empty() {
        return Err(LearnError::invalid(field, "is empty; push an observation"));
    }
    history.steps().try_for_each(|step| check_step(about, field, step))
}

fn check_step(about: &About<'_>, field: &str, step: &Step) -> Result<(), LearnError> {
    expect_length(&format!("{field}.embedding"), step.embedding.0.len(), about.width)?;
    let mut parts = vec![("proprioception", &step.proprioception, about.shape.proprioception)];
    if let Some(executed) = &step.executed {
        parts.push(("executed", executed, about.shape.action));
    }
    for (name, values, width) in parts {
        let field = format!("{field}.{name}");
        expect_length(&field, values.len(), width)?;
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(LearnError::invalid(field, format!("value {at} is not finite")));
        }
    }
    Ok(())
}

fn expect_length(field: &str, found: usize, expected: usize) -> Result<(), LearnError> {
    if found == expected {
        return Ok(());
    }
    Err(LearnError::invalid(field, format!("has length {found}, the policy's shape asks for {expected}")))
}
