//! Step one of SSDF: self-supervised pretraining of the transformer on D_u.
//!
//! L_pretrain = L_MTP + L_TR + L_AA.

use rand::seq::SliceRandom;
use tch::{Tensor, no_grad_guard};

use crate::augment::augment;
use crate::batch::{Batch, Drawn, Part, Segments};
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::device;
use crate::error::{LearnError, guard};
use crate::model::{Network, Size, image_weights};
use crate::normalize::{FeatureScale, Sample, Standard, Statistics};
use crate::objective::{self, Objective, Passes, features_view};
use crate::peers::Peers;
use crate::random::{Purpose, generator};
use crate::score::last_steps;
use crate::shape::{self, TaskShape};
use crate::train::{LOSS_VALIDATION, Loss, Monitor, Participant, Resumed, Training};
use crate::trajectory::Trajectory;
use crate::validation;
use gleaner_core::{PretrainSpec, Values};

/// Segments on which the scale of features is measured, in whole episodes: many times the dimension of features.
const SCALE_SEGMENTS: usize = 4096;

/// Pretrains an encoder on `data` (D_u = D_e ∪ D_i) and returns its checkpoint.
///
/// `image_weights` is the safetensors file that the setting of that name names. `resume` is a checkpoint that the
/// monitor stored; on the CPU, with the same number of threads, the resumed run gives the same bytes as an
/// uninterrupted one. Metrics: `loss`, `loss_mtp`, `loss_tr`, `loss_aa`, `grad_norm`, `learning_rate`, `ms_per_step`,
/// `ms_per_batch` (that assembling a batch took on one of the threads that assemble), `waited_share` (of the step's time, waiting
/// for its batches); twenty times `loss_validation`, if a share of the episodes is held out.
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
    let alone = Participant { resume, peers: &mut Peers::alone(), monitor };
    // A process alone leads, so it has a result.
    Ok(pretrain_with(shape, data, spec, image_weights, alone)?.unwrap_or_default())
}

/// As [`pretrain`], as one of the ranks that share each batch: every rank calls this with the same input. Rank 0 returns
/// the checkpoint, the others `None`. The ranks' losses are those of one process up to rounding; the bytes are the same
/// in every run with the same number of ranks. A further metric is `summing_share`: of the step's time, summing over the
/// ranks and waiting for them.
///
/// # Errors
/// As [`pretrain`]; [`LearnError::Group`] when another rank is lost.
pub fn pretrain_with(
    shape: &TaskShape,
    data: &[Trajectory],
    spec: &PretrainSpec,
    image_weights: Option<&[u8]>,
    participant: Participant<'_>,
) -> Result<Option<Vec<u8>>, LearnError> {
    let Participant { resume, peers, monitor } = participant;
    shape.validate()?;
    peers.can_share(spec.optim.batch)?;
    let objectives = objective::find(&spec.objectives)?;
    shape::augmentation_fits(&spec.augmentation, shape)?;
    if data.is_empty() {
        return Err(LearnError::invalid("data", "has no episode to learn from"));
    }
    for trajectory in data {
        trajectory.validate(shape)?;
    }
    let share = (spec.validation_share, spec.run.seed);
    let (data, held_out) = validation::split(data, share, (spec.optim.finished_weights, "data"))?;
    guard(|| {
        let training = match begin(shape, &data, spec, (image_weights, resume))? {
            Resumed::Finished(bytes) => return Ok(peers.lead().then_some(bytes)),
            Resumed::Unfinished(training) => training,
        };
        let (network, segments) = (training.network(), Segments::every(&data));
        let standard = network.statistics.proprioception.shared();
        let (device, part, held_out_segments) = (network.device(), peers.part(), Segments::every(&held_out));
        let source = |_: usize| Source {
            shape,
            data: &data,
            segments: &segments,
            spec,
            device,
            standard: standard.shared(),
            part,
        };
        let unseen = Source { data: &held_out, segments: &held_out_segments, part: Part::WHOLE, ..source(0) };
        let draws = (0..device::assembling_threads(device)).map(source);
        let draws = draws.map(|source| move |number| Ok((source.draw(number)?, number))).collect();
        let loss = |network: &Network, (batch, number): (Batch, u64)| {
            pretrain_loss(&objectives, network, &batch, spec, number)
        };
        let report = |network: &Network, done: u64| {
            if !validation::due(done, spec.optim.steps) {
                return Ok(Vec::new());
            }
            let loss = unseen.loss_validation(network, &objectives)?;
            Ok(loss.map(|loss| (LOSS_VALIDATION, loss)).into_iter().collect())
        };
        let every = spec.run.checkpoint_every;
        let finished = training.run(every, draws, &loss, &report, (peers, monitor))?;
        finished.map(|finished| with_feature_scale(&finished, &data, spec)).transpose()
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
    /// That of each batch which this process works on.
    part: Part,
}

impl Source<'_> {
    /// The training batch of this number.
    fn draw(&self, number: u64) -> Result<Batch, LearnError> {
        let (seed, optim) = (self.spec.run.seed, &self.spec.optim);
        let drawn = self.segments.draw(&mut generator(seed, Purpose::Batch, number), optim.batch, optim.stretch);
        let drawn = Drawn { segments: &drawn, alone: &[], part: self.part };
        let mut batch = Batch::collect_part(self.shape, self.data, drawn, self.spec.model.window(), self.device)?;
        let mut rng = generator(seed, Purpose::Augmentation, number);
        augment(&mut batch, &self.spec.augmentation, &self.standard, &mut rng);
        Ok(batch)
    }

    /// The mean loss on all segments, without changes to their inputs and with the same masked elements every time;
    /// `None` without any.
    fn loss_validation(&self, network: &Network, objectives: &[&Objective]) -> Result<Option<f64>, LearnError> {
        validation::mean(self.segments, |number, chunk| {
            let batch = Batch::collect(self.shape, self.data, chunk, self.spec.model.window(), self.device)?;
            Ok(pretrain_loss(objectives, network, &batch, self.spec, number).total.double_value(&[]))
        })
    }
}

/// The sum of the objectives' losses: this part's share of the loss of the whole batch. An objective's loss is a mean over
/// the batch's steps inside their episodes.
pub(crate) fn pretrain_loss(
    objectives: &[&Objective],
    network: &Network,
    batch: &Batch,
    spec: &PretrainSpec,
    number: u64,
) -> Loss {
    let passes = Passes::new(network, batch, spec.run.seed, number);
    let share = batch.whole.share_of_places(batch.windows.length);
    let losses: Vec<(&'static str, Tensor)> =
        objectives.iter().map(|each| (each.metric, (each.loss)(&passes) * share)).collect();
    Loss { total: losses.iter().map(|(_, loss)| loss).sum(), parts: losses }
}

#[cfg(test)]
mod tests;
