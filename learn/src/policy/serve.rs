//! A trained policy that acts: embeds each frame once, acts for many sessions in one pass. Knows
//! nothing of sessions themselves.

use std::fmt;

use tch::{Device, no_grad_guard};

use super::history::{Embedding, History, Step};
use crate::batch::{Windows, images, rows, values};
use crate::checkpoint::{self, CheckpointKind};
use crate::error::{LearnError, guard};
use crate::model::{Network, View};
use crate::objective::action_autoregression;
use crate::spec::TaskShape;

/// Frames encoded in one pass; bounds memory, whatever is asked.
const CHUNK: usize = 64;

/// A policy ready to act, on the CPU. `Send`: give it a thread of its own.
pub struct Policy {
    network: Network,
}

impl fmt::Debug for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Policy").field("shape", &self.network.shape).field("model", &self.network.spec).finish()
    }
}

impl Policy {
    /// Loads a policy checkpoint.
    ///
    /// # Errors
    /// [`LearnError::Checkpoint`] or [`LearnError::Version`] if `bytes` are no usable policy.
    pub fn load(bytes: &[u8]) -> Result<Self, LearnError> {
        guard(|| {
            let (info, named) = checkpoint::read(bytes, CheckpointKind::Policy)?;
            let network = Network::from_named(&info.shape, info.model, &named, Device::Cpu)?;
            Ok(Self { network })
        })
    }

    /// The task's shape.
    pub fn shape(&self) -> &TaskShape {
        &self.network.shape
    }

    /// The segment length l; make a [`History`] with it.
    pub fn segment_length(&self) -> u32 {
        self.network.spec.segment_length
    }

    /// Actions that [`Policy::act`] gives at once, k; 1 but for ACT.
    pub fn chunk_length(&self) -> u32 {
        1
    }

    /// Encodes frames, each laid out as one step of [`FrameBytes`](crate::FrameBytes).
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a frame's length does not fit the shape.
    pub fn embed(&self, frames: &[&[u8]]) -> Result<Vec<Embedding>, LearnError> {
        let expected = self.network.shape.frame_bytes();
        for (i, frame) in frames.iter().enumerate() {
            expect_length(&format!("frames[{i}]"), frame.len(), expected)?;
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let mut embeddings = Vec::with_capacity(frames.len());
            for chunk in frames.chunks(CHUNK) {
                let images = images(&self.network.shape, chunk, self.network.device());
                let embedded = values(&self.network.embed_images(&images));
                let each = embedded.chunks(self.network.width());
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
        for (i, history) in histories.iter().enumerate() {
            self.check(&format!("histories[{i}]"), history)?;
        }
        if histories.is_empty() {
            return Ok(Vec::new());
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let (steps, windows) = self.lay_out(histories);
            let features = self.network.features(&steps, &windows, View::CAUSAL, 1);
            let action = action_autoregression::predict(&self.network, &features);
            let action = values(&self.network.statistics.action.invert(&action));
            let each = action.chunks(self.network.shape.action);
            Ok(each.map(|action| vec![action.to_vec()]).collect())
        })
    }

    /// All histories padded on the left to full windows, `[W * L, 3, d]`, and their layout.
    fn lay_out(&self, histories: &[&History]) -> (tch::Tensor, Windows) {
        let (shape, length) = (&self.network.shape, self.network.spec.window());
        let width = self.network.width();
        let device = self.network.device();
        let (mut o, mut m, mut a, mut valid) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for history in histories {
            let padding = length - history.len();
            o.resize(o.len() + padding * width, 0.0);
            m.resize(m.len() + padding * shape.proprioception, 0.0);
            a.resize(a.len() + padding * shape.action, 0.0);
            valid.resize(valid.len() + padding, false);
            for step in history.steps() {
                o.extend_from_slice(&step.embedding.0);
                m.extend_from_slice(&step.proprioception);
                // The newest action is not known yet, and m_t cannot see it.
                let end = a.len() + shape.action;
                a.extend_from_slice(step.executed.as_deref().unwrap_or_default());
                a.resize(end, 0.0);
                valid.push(true);
            }
        }
        let m = rows(&m, shape.proprioception, device);
        let a = rows(&a, shape.action, device);
        let steps = self.network.steps(&rows(&o, width, device), &m, &a);
        (steps, Windows::in_order(valid, length, device))
    }

    fn check(&self, field: &str, history: &History) -> Result<(), LearnError> {
        let window = self.network.spec.window();
        if history.window() != window {
            return Err(LearnError::invalid(
                field,
                format!(
                    "keeps {} steps, this policy needs {window}; make it with its segment length",
                    history.window()
                ),
            ));
        }
        if history.is_empty() {
            return Err(LearnError::invalid(field, "is empty; push an observation"));
        }
        history.steps().try_for_each(|step| self.check_step(field, step))
    }

    fn check_step(&self, field: &str, step: &Step) -> Result<(), LearnError> {
        let shape = &self.network.shape;
        let width = self.network.width();
        expect_length(&format!("{field}.embedding"), step.embedding.0.len(), width)?;
        let mut parts = vec![("proprioception", &step.proprioception, shape.proprioception)];
        if let Some(executed) = &step.executed {
            parts.push(("executed", executed, shape.action));
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
}

fn expect_length(field: &str, found: usize, expected: usize) -> Result<(), LearnError> {
    if found == expected {
        return Ok(());
    }
    Err(LearnError::invalid(field, format!("has length {found}, the policy's shape asks for {expected}")))
}
