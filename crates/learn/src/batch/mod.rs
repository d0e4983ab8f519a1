//! From plain arrays to tensors: draws segments, lays out their windows so that each
//! step is there once, and moves bytes and floats into tensors. Independent of the model.

mod chunks;
mod draw;
mod images;
mod part;
mod windows;

pub(crate) use chunks::Chunks;
pub(crate) use draw::{Segment, Segments, spread};
pub(crate) use images::{images, squash};
pub(crate) use part::{Drawn, Part, Whole};
pub(crate) use windows::Windows;

use tch::{Device, Tensor};

use crate::device::send;
use crate::error::LearnError;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// The tensors of some segments. Each of their N steps is stored once.
pub(crate) struct Batch {
    /// Per camera `[N, C, H, W]`, values in 0 … 1.
    pub(crate) images: Vec<Tensor>,
    /// `[N, M]` in physical units.
    pub(crate) proprioception: Tensor,
    /// The same as the model sees it: with noise, if there is any.
    pub(crate) seen_proprioception: Tensor,
    /// `[N, A]` in physical units, as the robot executes them.
    pub(crate) action: Tensor,
    /// The step of each place of each window.
    pub(crate) windows: Windows,
    /// `[W]`, the segments' weights.
    pub(crate) weight: Tensor,
    /// The whole batch, of which this may be a part.
    pub(crate) whole: Whole,
}

impl Batch {
    /// Collects the steps of `segments` of `data`; `window` is the number of steps in a segment.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn collect(
        shape: &TaskShape,
        data: &[&Trajectory],
        segments: &[Segment],
        window: usize,
        device: Device,
    ) -> Result<Self, LearnError> {
        Self::collect_part(shape, data, Drawn { segments, alone: &[], part: Part::WHOLE }, window, device)
    }

    /// As [`Batch::collect`], of a part of the segments `drawn`, without steps that are hidden in every window.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn collect_part(
        shape: &TaskShape,
        data: &[&Trajectory],
        drawn: Drawn<'_>,
        window: usize,
        device: Device,
    ) -> Result<Self, LearnError> {
        let (whole, windows, steps) = Whole::lay_out(drawn, window, device);
        let segments = &drawn.segments[whole.windows.clone()];
        let size = shape.frame_bytes();
        let mut frames = vec![0; steps.len() * size];
        let (mut proprioception, mut action, mut rest) = (Vec::new(), Vec::new(), frames.as_mut_slice());
        // Steps in sequence are read at once.
        for run in steps.chunk_by(|a, b| a.0 == b.0 && a.1 + 1 == b.1) {
            let (trajectory, first) = run[0];
            let range = first..first + run.len();
            let (frames, next) = rest.split_at_mut(run.len() * size);
            data[trajectory].read_frames(range.clone(), frames)?;
            let numbers = data[trajectory].numbers(range)?;
            proprioception.extend(numbers.proprioception);
            action.extend(numbers.action);
            rest = next;
        }
        allowed(shape, &mut action);
        let frames: Vec<&[u8]> = frames.chunks_exact(size).collect();
        let weight: Vec<f32> = segments.iter().map(|segment| segment.weight).collect();
        let proprioception = rows(&proprioception, shape.proprioception, device);
        Ok(Self {
            images: images(shape, &frames, device),
            seen_proprioception: proprioception.shallow_clone(),
            proprioception,
            action: rows(&action, shape.action, device),
            windows,
            weight: send(&Tensor::from_slice(&weight), device),
            whole,
        })
    }
}

/// Replaces recorded actions by those that the task allows: a session remembers these as executed, and serves no others.
pub(crate) fn allowed(shape: &TaskShape, actions: &mut [f32]) {
    for action in actions.chunks_exact_mut(shape.action) {
        shape.ranges.apply(action);
    }
}

/// `values` as `[values.len() / width, width]`.
pub(crate) fn rows(values: &[f32], width: usize, device: Device) -> Tensor {
    send(&Tensor::from_slice(values).view([-1, int(width)]), device)
}

/// A tensor's values, row-major.
pub(crate) fn values(tensor: &Tensor) -> Vec<f32> {
    let tensor = tensor.detach().to_device(Device::Cpu).to_kind(tch::Kind::Float).contiguous();
    let mut values = vec![0f32; tensor.numel()];
    let count = values.len();
    tensor.copy_data(&mut values, count);
    values
}

/// A length in the tensor library's type. Lengths in memory always fit.
pub(crate) fn int(length: usize) -> i64 {
    i64::try_from(length).unwrap_or(i64::MAX)
}
