//! Histories as tensors, after their checks, and frames as embeddings: the input of policies and live scorers.

use tch::{Device, Tensor, no_grad_guard};

use super::{Embedding, History, Step};
use crate::batch::{Windows, rows, values};
use crate::error::{LearnError, guard};
use crate::shape::TaskShape;

/// Frames encoded in one pass; bounds memory for any number of frames.
const CHUNK: usize = 64;

/// The required form of histories for one model.
pub(crate) struct Layout<'a> {
    pub(crate) shape: &'a TaskShape,
    /// Steps of history in its input, l + 1.
    pub(crate) window: usize,
    /// Values of an image embedding, d.
    pub(crate) width: usize,
    pub(crate) device: Device,
}

/// Histories padded on the left to full windows, W windows over N = W (l + 1) steps.
pub(crate) struct Stacked {
    /// `[N, d]`.
    pub(crate) embedded: Tensor,
    /// `[N, M]` in physical units.
    pub(crate) proprioception: Tensor,
    /// `[N, A]` in physical units, within the ranges of the task, as recorded ones are learned; zeros where unknown.
    pub(crate) action: Tensor,
    pub(crate) windows: Windows,
    /// Per window, the seed and the number of its draw.
    pub(crate) draws: Vec<(u64, u64)>,
}

impl Layout<'_> {
    /// Encodes frames, each with the layout of one step of [`StepSource`](crate::StepSource), by `embed`, which maps N
    /// frames to `[N, d]`.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a frame's length does not fit the shape.
    pub(crate) fn embed(
        &self,
        frames: &[&[u8]],
        embed: impl Fn(&[&[u8]]) -> Tensor,
    ) -> Result<Vec<Embedding>, LearnError> {
        let expected = self.shape.frame_bytes();
        for (i, frame) in frames.iter().enumerate() {
            expect_length(&format!("frames[{i}]"), frame.len(), expected)?;
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let mut embeddings = Vec::with_capacity(frames.len());
            for chunk in frames.chunks(CHUNK) {
                let embedded = values(&embed(chunk));
                embeddings.extend(embedded.chunks(self.width).map(|row| Embedding(row.to_vec())));
            }
            Ok(embeddings)
        })
    }

    /// # Errors
    /// [`LearnError::Invalid`] if a history is empty, of another segment length, or holds values that do not fit the
    /// shape or are not finite.
    pub(crate) fn check(&self, histories: &[&History]) -> Result<(), LearnError> {
        (histories.iter().enumerate()).try_for_each(|(i, history)| self.check_one(&format!("histories[{i}]"), history))
    }

    fn check_one(&self, field: &str, history: &History) -> Result<(), LearnError> {
        if history.window != self.window {
            let message = format!(
                "keeps {} steps, this model needs {}; make it with its segment length",
                history.window, self.window
            );
            return Err(LearnError::invalid(field, message));
        }
        if history.is_empty() {
            return Err(LearnError::invalid(field, "is empty; push an observation"));
        }
        history.steps.iter().try_for_each(|step| self.check_step(field, step))
    }

    fn check_step(&self, field: &str, step: &Step) -> Result<(), LearnError> {
        expect_length(&format!("{field}.embedding"), step.embedding.0.len(), self.width)?;
        let mut parts = vec![("proprioception", &step.proprioception, self.shape.proprioception)];
        if let Some(executed) = &step.executed {
            parts.push(("executed", executed, self.shape.action));
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

    /// Checked histories as tensors.
    pub(crate) fn stack(&self, histories: &[&History]) -> Stacked {
        let (shape, width) = (self.shape, self.width);
        let (mut o, mut m, mut a, mut valid) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for history in histories {
            let padding = self.window - history.len();
            o.resize(o.len() + padding * width, 0.0);
            m.resize(m.len() + padding * shape.proprioception, 0.0);
            a.resize(a.len() + padding * shape.action, 0.0);
            valid.resize(valid.len() + padding, false);
            for step in &history.steps {
                o.extend_from_slice(&step.embedding.0);
                m.extend_from_slice(&step.proprioception);
                let end = a.len() + shape.action;
                let begin = a.len();
                a.extend_from_slice(step.executed.as_deref().unwrap_or_default());
                shape.ranges.apply(&mut a[begin..]);
                a.resize(end, 0.0);
                valid.push(true);
            }
        }
        Stacked {
            embedded: rows(&o, width, self.device),
            proprioception: rows(&m, shape.proprioception, self.device),
            action: rows(&a, shape.action, self.device),
            windows: Windows::in_order(valid, self.window, self.device),
            draws: histories.iter().map(|history| (history.seed, history.pushed)).collect(),
        }
    }
}

fn expect_length(field: &str, found: usize, expected: usize) -> Result<(), LearnError> {
    if found == expected {
        return Ok(());
    }
    Err(LearnError::invalid(field, format!("has length {found}, the model's shape asks for {expected}")))
}

#[cfg(test)]
mod tests {
    use gleaner_core::action::ActionRange;

    use super::*;
    use crate::toy;

    #[test]
    fn executed_actions_are_read_within_their_ranges_and_unknown_ones_are_zeros() {
        let ranges = [ActionRange::Binary(-1.0, 1.0), ActionRange::Within(-0.01, 0.01)];
        let shape = TaskShape { ranges: ranges.into_iter().collect(), ..toy::shape() };
        let layout = Layout { shape: &shape, window: 3, width: 1, device: Device::Cpu };
        let mut history = History::new(2);
        for executed in [Some(vec![0.37, 5.0]), None] {
            history.push(Embedding(vec![0.5]), vec![0.0; 3]).unwrap();
            executed.map_or(Ok(()), |action| history.set_executed(action)).unwrap();
        }
        layout.check(&[&history]).unwrap();
        assert_eq!(values(&layout.stack(&[&history]).action), [0.0, 0.0, 1.0, 0.01, 0.0, 0.0]);
    }
}
