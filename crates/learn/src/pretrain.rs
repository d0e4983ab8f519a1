//! Step one of SSDF: self-supervised pretraining of the transformer on D_u.
//!
//! L_pretrain = L_MTP + L_TR + L_AA.

use rand::seq::SliceRandom;
use tch::{Tensor, no_grad_guard};

use crate::augment::augment;
use crate::batch::{Batch, Segments};
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::device;
use crate::error::{LearnError, guard};
use crate::model::{Network, Size, image_weights};
use crate::normalize::{FeatureScale, Sample, Standard, Statistics};
use crate::objective::{self, Objective, Passes, features_view};
use crate::random::{Purpose, generator};
use crate::score::last_steps;
use crate::shape::{self, TaskShape};
use crate::train::{Loss, Monitor, Resumed, Training};
use crate::trajectory::Trajectory;
use gleaner_core::{PretrainSpec, Values};

/// Segments on which the scale of features is measured, in whole episodes: many times the dimension of features.
const SCALE_SEGMENTS: usize = 4096;

/// Pretrains an encoder on `data` (D_u = D_e ∪ D_i) and returns its checkpoint.
///
/// `image_weights` is the safetensors file that the setting of that name names. `resume` is a checkpoint that the
/// monitor stored; on the CPU, with the same number of threads, the resumed run gives the same bytes as an
/// uninterrupted one. Metrics: `loss`, `loss_mtp`, `loss_tr`, `loss_aa`, `grad_norm`, `learning_rate`, `ms_per_step`,
/// `ms_per_batch` (that assembling a batch took on the batches' own thread), `waited_share` (of the step's time, waiting
/// for its batches).
///
/// # Errors
/// [`LearnError::Invalid`] for bad input, [`LearnError::Cancelled`], [`LearnError::Diverged`],
/// and errors of reading a checkpoint and of the tensor library.
pub fn pretrain(
    shape: &TaskShape,
    data: &[Trajectory],
    spec: &PretrainSpec,
    image_weights: Option<&[u8]>,
    resume: Option<&[u8]>,
    monitor: &mut dyn Monitor,
) -> Result<Vec<u8>, LearnError> {
    shape.validate()?;
    let objectives = objective::find(&spec.objectives)?;
    shape::augmentation_fits(&spec.augmentation, shape)?;
    if data.is_empty() {
        return Err(LearnError::invalid("data", "has no episode to learn from"));
    }
    for trajectory in data {
        trajectory.validate(shape)?;
    }
    let data: Vec<&Trajectory> = data.iter().collect();
    guard(|| {
        let training = match begin(shape, &data, spec, (image_weights, resume))? {
            Resumed::Finished(bytes) => return Ok(bytes),
            Resumed::Unfinished(training) => training,
        };
        let (network, segments) = (training.network(), Segments::every(&data));
        let standard = network.statistics.proprioception.shared();
        let source = Source { shape, data: &data, segments: &segments, spec, device: network.device(), standard };
        let draw = move |number| Ok((source.draw(number)?, number));
        let loss = |network: &Network, (batch, number): (Batch, u64)| {
            pretrain_loss(&objectives, network, &batch, spec, number)
        };
        let finished = training.run(spec.run.checkpoint_every, draw, &loss, &|_, _| Ok(Vec::new()), monitor)?;
        with_feature_scale(&finished, &data, spec)
    })
}

/// Adds the scale of the features over D_u, measured on some of its episodes, to a finished encoder.
fn with_feature_scale(finished: &[u8], data: &[&Trajectory], spec: &PretrainSpec) -> Result<Vec<u8>, LearnError> {
    let device = device::open(spec.run.device, spec.threads)?;
    let (info, named) = checkpoint::read(finished, CheckpointKind::Encoder)?;
    let network = Network::from_named(&info.shape, info.model, &named, device)?;
    let _no_grad = no_grad_guard();
    let mut order: Vec<usize> = (0..data.len()).collect();
    order.shuffle(&mut generator(spec.run.seed, Purpose::FeatureScale, 0));
    let (mut parts, mut segments) = ([const { Vec::new() }; 3], 0);
    for episode in order {
        if segments >= SCALE_SEGMENTS {
            break;
        }
        segments += data[episode].steps();
        for (all, part) in parts.iter_mut().zip(last_steps(&network, features_view(&spec.objectives), data[episode])?) {
            all.push(part);
        }
    }
    let [o, m, a] = parts.map(|all| Tensor::cat(&all, 0));
    let mut named = network.named();
    named.extend(FeatureScale::measure([&o, &m, &a]).named());
    checkpoint::write(&info, &named)
}

fn begin(
    shape: &TaskShape,
    data: &[&Trajectory],
    spec: &PretrainSpec,
    (image_weights, resume): (Option<&[u8]>, Option<&[u8]>),
) -> Result<Resumed, LearnError> {
    let device = device::open(spec.run.device, spec.threads)?;
    let info = CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Encoder,
        step: 0,
        finished: false,
        shape: shape.clone(),
        model: spec.model,
        policy: None,
        settings: Values::new(),
        spec: spec.identity(),
    };
    if let Some(bytes) = resume {
        return Training::resume(bytes, &info, &spec.optim, device);
    }
    let target = Size::of(spec.model.preset).target;
    let statistics = Statistics::measure(shape, &Sample::every(data), target, device)?;
    let statistics = statistics.for_image_encoder(spec.model.image_encoder);
    let network = Network::new(shape, spec.model, statistics, spec.run.seed, device);
    image_weights::give(spec.model.image_encoder, &network.parameters(), image_weights)?;
    Ok(Resumed::Unfinished(Box::new(Training::start(network, info, &spec.optim))))
}

/// The episodes that batches are drawn from, with what their thread needs to know of the network.
struct Source<'a> {
    shape: &'a TaskShape,
    data: &'a [&'a Trajectory],
    segments: &'a Segments,
    spec: &'a PretrainSpec,
    device: tch::Device,
    /// That of the proprioception.
    standard: Standard,
}

impl Source<'_> {
    /// The training batch of this number.
    fn draw(&self, number: u64) -> Result<Batch, LearnError> {
        let (seed, optim) = (self.spec.run.seed, &self.spec.optim);
        let drawn = self.segments.draw(&mut generator(seed, Purpose::Batch, number), optim.batch, optim.stretch);
        let mut batch = Batch::collect(self.shape, self.data, &drawn, self.spec.model.window(), self.device)?;
        let mut rng = generator(seed, Purpose::Augmentation, number);
        augment(&mut batch, &self.spec.augmentation, &self.standard, &mut rng);
        Ok(batch)
    }
}

/// The sum of the objectives' losses.
pub(crate) fn pretrain_loss(
    objectives: &[&Objective],
    network: &Network,
    batch: &Batch,
    spec: &PretrainSpec,
    number: u64,
) -> Loss {
    let passes = Passes::new(network, batch, spec.run.seed, number);
    let losses: Vec<(&'static str, Tensor)> =
        objectives.iter().map(|each| (each.metric, (each.loss)(&passes))).collect();
    Loss { total: losses.iter().map(|(_, loss)| loss).sum(), parts: losses }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::ahead::Assembled;
    use crate::checkpoint::inspect;
    use crate::toy::{self, Recorder};
    use crate::train::Silent;
    use gleaner_core::Augmentation;

    #[test]
    fn a_resumed_run_equals_a_straight_one_bit_for_bit() {
        let (shape, data) = (toy::shape(), toy::experts(3, 12));
        let spec = toy::every(3, toy::pretrain_spec(8));
        let mut straight = Recorder::default();
        let result = pretrain(&shape, &data, &spec, None, None, &mut straight).unwrap();
        let steps: Vec<u64> = straight.checkpoints.iter().map(|(step, _)| *step).collect();
        assert_eq!(steps, [3, 6]);

        let mut resumed = Recorder::default();
        let half = &straight.checkpoints[0].1;
        let again = pretrain(&shape, &data, &spec, None, Some(half), &mut resumed).unwrap();
        assert_eq!(straight.losses[3..], resumed.losses);
        // The checkpoint of step 6 has weights and optimiser state.
        assert_eq!(straight.checkpoints[1], resumed.checkpoints[0]);
        assert_eq!(result, again);
        let finished = pretrain(&shape, &data, &spec, None, Some(&result), &mut Silent).unwrap();
        assert_eq!(result, finished);
    }

    #[test]
    fn a_run_equals_one_whose_batches_are_assembled_when_due() {
        let (shape, data) = (toy::shape(), toy::experts(3, 12));
        let augmentation = Augmentation { shift_pixels: 2, proprioception_noise: 0.1, ..Augmentation::default() };
        let mut spec = PretrainSpec { augmentation, ..toy::pretrain_spec(4) };
        spec.optim.gradient_accumulation = 2;
        let mut ahead = Recorder::default();
        let finished = pretrain(&shape, &data, &spec, None, None, &mut ahead).unwrap();

        let data: Vec<&Trajectory> = data.iter().collect();
        let Resumed::Unfinished(training) = begin(&shape, &data, &spec, (None, None)).unwrap() else {
            panic!("finished")
        };
        let segments = Segments::every(&data);
        let standard = training.network().statistics.proprioception.shared();
        let device = tch::Device::Cpu;
        let source = Source { shape: &shape, data: &data, segments: &segments, spec: &spec, device, standard };
        let objectives = objective::find(&spec.objectives).unwrap();
        let loss = |network: &Network, number| {
            pretrain_loss(&objectives, network, &source.draw(number).unwrap(), &spec, number)
        };
        let (mut numbers, mut due) = (0.., Recorder::default());
        let mut next = || Ok(Assembled { batch: numbers.next().unwrap(), took: Duration::ZERO });
        let bytes = training.take_steps(9, &mut next, &loss, &|_, _| Ok(Vec::new()), &mut due).unwrap();
        assert_eq!((ahead.losses, finished), (due.losses, with_feature_scale(&bytes, &data, &spec).unwrap()));
    }

    #[test]
    fn a_run_that_is_stopped_keeps_every_step() {
        let (shape, data) = (toy::shape(), toy::experts(3, 12));
        let spec = toy::every(3, toy::pretrain_spec(8));
        let straight = pretrain(&shape, &data, &spec, None, None, &mut Silent).unwrap();
        for (after, kept) in [(2, vec![2]), (3, vec![3]), (5, vec![3, 5])] {
            let mut stopped = Recorder { stop_after: Some(after), ..Recorder::default() };
            let result = pretrain(&shape, &data, &spec, None, None, &mut stopped);
            assert!(matches!(result, Err(LearnError::Cancelled)));
            assert_eq!(stopped.checkpoints.iter().map(|(step, _)| *step).collect::<Vec<_>>(), kept);
            let (_, last) = stopped.checkpoints.last().unwrap();
            assert_eq!(pretrain(&shape, &data, &spec, None, Some(last), &mut Silent).unwrap(), straight);
        }
        // Stopped again before its first step, the run has no new checkpoint to store.
        let mut first = Recorder { stop_after: Some(2), ..Recorder::default() };
        assert!(pretrain(&shape, &data, &spec, None, None, &mut first).is_err());
        let mut again = Recorder { stop_after: Some(0), ..Recorder::default() };
        assert!(pretrain(&shape, &data, &spec, None, Some(&first.checkpoints[0].1), &mut again).is_err());
        assert!(again.checkpoints.is_empty());
    }

    #[test]
    fn a_checkpoint_of_another_run_is_refused() {
        let (shape, data) = (toy::shape(), toy::experts(2, 8));
        let spec = toy::pretrain_spec(2);
        let bytes = pretrain(&shape, &data, &spec, None, None, &mut Silent).unwrap();
        let other = {
            let mut other = spec.clone();
            other.run.seed = 99;
            other
        };
        let error = pretrain(&shape, &data, &other, None, Some(&bytes), &mut Silent).unwrap_err();
        assert!(error.to_string().starts_with("spec: "), "{error}");
    }

    #[test]
    fn the_loss_falls_and_the_result_describes_itself() {
        let (shape, data) = (toy::shape(), toy::experts(6, 12));
        let mut monitor = Recorder::default();
        let spec = toy::pretrain_spec(120);
        let bytes = pretrain(&shape, &data, &spec, None, None, &mut monitor).unwrap();
        let mean = |part: &[(u64, f64)]| {
            part.iter().map(|(_, loss)| loss).sum::<f64>() / f64::from(u32::try_from(part.len()).unwrap())
        };
        let (first, last) = (mean(&monitor.losses[..10]), mean(&monitor.losses[110..]));
        assert!(last < 0.5 * first, "{first} {last}");
        let info = inspect(&bytes).unwrap();
        assert_eq!((info.kind, info.step, info.finished), (CheckpointKind::Encoder, 120, true));
        assert_eq!((info.shape, info.model), (shape, spec.model));
    }

    #[test]
    fn each_objective_alone_trains() {
        let (shape, data) = (toy::shape(), toy::experts(2, 8));
        for objective in ["mtp", "tr", "aa"] {
            let spec = PretrainSpec { objectives: vec![objective.to_owned()], ..toy::pretrain_spec(2) };
            assert!(pretrain(&shape, &data, &spec, None, None, &mut Silent).is_ok());
        }
    }

    #[test]
    fn cancelling_and_diverging_differ() {
        let (shape, data) = (toy::shape(), toy::experts(2, 8));
        let mut monitor = Recorder { stop_after: Some(2), ..Recorder::default() };
        let result = pretrain(&shape, &data, &toy::pretrain_spec(9), None, None, &mut monitor);
        assert!(matches!(result, Err(LearnError::Cancelled)));
        assert_eq!(monitor.losses.len(), 2);

        let mut spec = toy::pretrain_spec(60);
        spec.optim.learning_rate = 10.0;
        spec.optim.clip_norm = 1e12;
        spec.optim.weight_decay = 10.0;
        let result = pretrain(&shape, &data, &spec, None, None, &mut Silent);
        assert!(matches!(result, Err(LearnError::Diverged { .. })), "{result:?}");
    }
}
