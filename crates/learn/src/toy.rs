//! A toy task for tests: a bright square somewhere in a small image, a hand somewhere on the same plane, and an action
//! that moves the hand towards the square. The action cannot be predicted without the image.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use std::collections::BTreeMap;

use rand::RngExt;

use crate::random::{Purpose, generator, normal};
use crate::shape::{CameraShape, TaskShape};
use crate::trajectory::Trajectory;
use gleaner_core::kinds::Family;
use gleaner_core::{Chosen, ModelSpec, OptimSpec, PretrainSpec, RunSpec, TrainSpec};

pub(crate) const SIDE: u32 = 16;

pub(crate) fn shape() -> TaskShape {
    TaskShape {
        cameras: vec![CameraShape { name: "top".into(), height: SIDE, width: SIDE, depth: true, recorded: None }],
        proprioception: 3,
        action: 2,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}

/// One frame with the square at `(x, y)` in 0 … 1.
pub(crate) fn frame(x: f32, y: f32) -> Vec<u8> {
    let place = |at: f32| (at * (SIDE - 4) as f32).round() as u32;
    let (left, top) = (place(x), place(y));
    let mut colour = Vec::new();
    let mut depth = Vec::new();
    for row in 0..SIDE {
        for column in 0..SIDE {
            let inside = (left..left + 4).contains(&column) && (top..top + 4).contains(&row);
            colour.extend(if inside { [230, 40, 30] } else { [60, 60, 70] });
            let millimetres: u16 = if inside { 450 } else { 500 };
            depth.extend(millimetres.to_le_bytes());
        }
    }
    colour.extend(depth);
    colour
}

/// An episode whose hand moves to the square, or (`expert` false) away from it. The last
/// proprioception value never changes.
pub(crate) fn episode(id: &str, seed: u64, steps: usize, expert: bool) -> Trajectory {
    let mut rng = generator(seed, Purpose::Batch, 1 << 40);
    let square: [f32; 2] = [rng.random_range(0.0..1.0), rng.random_range(0.0..1.0)];
    let mut hand: [f32; 2] = [rng.random_range(0.0..1.0), rng.random_range(0.0..1.0)];
    let (mut frames, mut proprioception, mut action) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..steps {
        frames.extend(frame(square[0], square[1]));
        proprioception.extend([hand[0], hand[1], 5.0]);
        let sign = if expert { 0.3 } else { -0.3 };
        for axis in 0..2 {
            let go = sign * (square[axis] - hand[axis]);
            action.push(go);
            hand[axis] += go;
        }
    }
    Trajectory::new(&shape(), id, frames, proprioception, action).unwrap()
}

pub(crate) fn experts(count: u64, steps: usize) -> Vec<Trajectory> {
    (0..count).map(|seed| episode(&format!("expert {seed}"), seed, steps, true)).collect()
}

/// N(0, 1) of this size.
pub(crate) fn numbers(size: &[i64], seed: u64) -> tch::Tensor {
    let count = usize::try_from(size.iter().product::<i64>()).unwrap();
    tch::Tensor::from_slice(&normal(&mut generator(seed, Purpose::Batch, 0), count)).view(size)
}

pub(crate) fn optim(steps: u64) -> OptimSpec {
    OptimSpec { steps, batch: 16, stretch: 4, learning_rate: 2e-3, warmup_steps: 5, ..OptimSpec::default() }
}

pub(crate) fn pretrain_spec(steps: u64) -> PretrainSpec {
    PretrainSpec {
        model: ModelSpec { segment_length: 3, ..ModelSpec::default() },
        optim: optim(steps),
        run: RunSpec { seed: 11, ..RunSpec::default() },
        ..PretrainSpec::default()
    }
}

pub(crate) fn train_spec(steps: u64) -> TrainSpec {
    TrainSpec {
        policy: Chosen::new(Family::Policy, "finetune").unwrap(),
        optim: optim(steps),
        run: RunSpec { seed: 12, ..RunSpec::default() },
        ..TrainSpec::default()
    }
}

/// The same settings with a checkpoint every `steps` steps.
pub(crate) fn every(steps: u32, mut spec: PretrainSpec) -> PretrainSpec {
    spec.run.checkpoint_every = steps;
    spec
}

/// Stores all reports of a job, and may stop it after some steps.
#[derive(Default)]
pub(crate) struct Recorder {
    pub(crate) losses: Vec<(u64, f64)>,
    /// Every metric of every step.
    pub(crate) metrics: Vec<BTreeMap<&'static str, f64>>,
    pub(crate) checkpoints: Vec<(u64, Vec<u8>)>,
    pub(crate) stop_after: Option<usize>,
}

impl Recorder {
    /// The values of a metric at the steps that have it.
    pub(crate) fn metric(&self, name: &str) -> Vec<f64> {
        self.metrics.iter().filter_map(|metrics| metrics.get(name).copied()).collect()
    }
}

impl crate::train::Monitor for Recorder {
    fn progress(&mut self, step: u64, _: u64, metrics: &[(&'static str, f64)]) {
        let loss = metrics.iter().find(|(name, _)| *name == "loss");
        self.losses.push((step, loss.map_or(0.0, |(_, loss)| *loss)));
        self.metrics.push(metrics.iter().copied().collect());
    }

    fn checkpoint(&mut self, step: u64, bytes: &[u8]) -> Result<(), String> {
        self.checkpoints.push((step, bytes.to_vec()));
        Ok(())
    }

    fn cancelled(&self) -> bool {
        self.stop_after.is_some_and(|after| self.losses.len() >= after)
    }
}
