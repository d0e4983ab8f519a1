//! Training of any policy by weighted behaviour cloning. Independent of the policy.
//!
//! L_full = E_{τ∼D_e}[−log P_θ′(a | τ)] + λ E_{τ∼D_f}[−w(q(τ)) log P_θ′(a | τ)]; the chosen weighting gives λ and w,
//! in the paper w(q) = q.

use gleaner_core::TrainSpec;
use tch::Tensor;

use super::find;
use super::kind::{PolicyInit, PolicyModel, Pretrained};
use super::shares::shares;
use super::source::{Assembled, Assembly, Draw, Source, mean_loss};
use super::switching::{self, SWITCHES_FOLLOWED, switches_followed};
use crate::batch::Segments;
use crate::checkpoint::{CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::device;
use crate::error::{LearnError, guard};
use crate::normalize::Sample;
use crate::peers::Peers;
use crate::random::{Purpose, generator};
use crate::shape::{self, TaskShape};
use crate::train::{LOSS_VALIDATION, Loss, Metrics, Monitor, Participant, Resumed, Training};
use crate::trajectory::{Trajectory, WeightedSegments};
use crate::validation;
use crate::weighting::{self, Weighting};

type Policy = Box<dyn PolicyModel>;

/// Trains a policy on the `experts` (D_e) and the `kept` segments (D_f) and returns its checkpoint.
/// `finetune` starts from the `pretrained` encoder, and without kept segments it is SSDF-base; the other policies start
/// from scratch, unless their `initial_weights` are the encoder's or their image encoder has given weights.
///
/// Each step takes the mean over a batch of expert segments and λ times the mean of weight · loss over a batch of kept
/// ones. `resume` as in [`pretrain`](crate::pretrain). Metrics: `loss`, `loss_expert`, `loss_kept` (before λ; only with
/// kept segments), for ACT `loss_l1` and `loss_kl` (of the expert batch), `grad_norm`, `learning_rate`, `ms_per_step`,
/// `ms_per_batch` (that assembling a batch took on one of the threads that assemble), `waited_share` (of the step's time, waiting
/// for its batches); twenty times `loss_validation`, if a share of the experts is held out; of the last step also what
/// the policy looks at: `share_images`, `share_camera_N`, `share_proprioception`, `share_history`, and, where an action has
/// a binary value, `switches_followed`: of the steps at which it changes in the experts, the share at which the policy
/// gives the new value.
///
/// # Errors
/// [`LearnError::Invalid`] for bad input, [`LearnError::Checkpoint`] or [`LearnError::Version`] for an encoder that
/// cannot be used, [`LearnError::Cancelled`], [`LearnError::Diverged`], and errors of the tensor library.
pub fn train_policy(
    shape: &TaskShape,
    pretrained: Pretrained<'_>,
    experts: &[Trajectory],
    kept: &[WeightedSegments],
    spec: &TrainSpec,
    resume: Option<&[u8]>,
    monitor: &mut dyn Monitor,
) -> Result<Vec<u8>, LearnError> {
    let alone = Participant { resume, peers: &mut Peers::alone(), monitor };
    // A process alone leads, so it has a result.
    Ok(train_policy_with(shape, pretrained, experts, kept, spec, alone)?.unwrap_or_default())
}

/// As [`train_policy`], as one of the ranks that share each batch, as in [`pretrain_with`](crate::pretrain_with).
///
/// # Errors
/// As [`train_policy`]; [`LearnError::Group`] when another rank is lost.
pub fn train_policy_with(
    shape: &TaskShape,
    pretrained: Pretrained<'_>,
    experts: &[Trajectory],
    kept: &[WeightedSegments],
    spec: &TrainSpec,
    participant: Participant<'_>,
) -> Result<Option<Vec<u8>>, LearnError> {
    let Participant { resume, peers, monitor } = participant;
    shape.validate()?;
    peers.can_share(spec.optim.batch)?;
    shape::augmentation_fits(&spec.augmentation()?, shape)?;
    if experts.is_empty() {
        return Err(LearnError::invalid("experts", "has no episode to learn from"));
    }
    for trajectory in experts {
        trajectory.validate(shape)?;
    }
    for segments in kept {
        segments.validate(shape)?;
    }
    guard(|| {
        let sources = Sources::new(shape, (experts, kept), spec)?;
        let sample = sources.sample();
        let device = device::open(spec.run.device, spec.threads)?;
        let from = PolicyInit { shape, pretrained, sample: &sample, spec, device };
        let training = match begin(&from, resume)? {
            Resumed::Finished(bytes) => return Ok(peers.lead().then_some(bytes)),
            Resumed::Unfinished(training) => training,
        };
        let (sources, policy) = (&sources, training.network().as_ref());
        let assembler = |_| {
            let assembly = Assembly::new(policy, shape, spec, peers.part())?;
            Ok(move |number| sources.assemble(&assembly, spec.run.seed, number))
        };
        let threads = 0..device::assembling_threads(policy.info().device);
        let assemblers: Vec<_> = threads.map(assembler).collect::<Result<_, LearnError>>()?;
        let loss = |policy: &Policy, batches| sources.loss(policy.as_ref(), batches);
        let report = |policy: &Policy, done| sources.report(policy.as_ref(), spec, done);
        training.run(spec.run.checkpoint_every, assemblers, &loss, &report, (peers, monitor))
    })
}

fn begin(from: &PolicyInit<'_>, resume: Option<&[u8]>) -> Result<Resumed<Policy>, LearnError> {
    let spec = from.spec;
    let kind = find(&spec.policy.name)?;
    let info = CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Policy,
        step: 0,
        finished: false,
        shape: from.shape.clone(),
        model: (kind.model)(from)?,
        policy: Some(kind.name.to_owned()),
        settings: spec.policy.settings.clone(),
        spec: spec.identity(),
    };
    if let Some(bytes) = resume {
        return Training::resume(bytes, &info, &spec.optim, from.device);
    }
    Ok(Resumed::Unfinished(Box::new(Training::start((kind.init)(from, &info)?, info, &spec.optim))))
}

/// The sources of the two batches of a step.
struct Sources<'a> {
    experts: Source<'a>,
    kept: Source<'a>,
    /// Experts that training does not see.
    held_out: Source<'a>,
    weighting: Weighting,
}

const EXPERT: [Purpose; 4] = [Purpose::Batch, Purpose::Augmentation, Purpose::Style, Purpose::Dropout];
const KEPT: [Purpose; 4] = [Purpose::KeptBatch, Purpose::KeptAugmentation, Purpose::KeptStyle, Purpose::KeptDropout];

impl<'a> Sources<'a> {
    fn new(
        shape: &TaskShape,
        (experts, kept): (&'a [Trajectory], &'a [WeightedSegments]),
        spec: &TrainSpec,
    ) -> Result<Self, LearnError> {
        let weighting = weighting::open(&spec.weighting)?;
        let share = (spec.validation_share, spec.run.seed);
        let (experts, held_out) = validation::split(experts, share, (spec.optim.finished_weights, "experts"))?;
        let kept = if weighting.ignores_segments() { &[] } else { kept };
        Ok(Self {
            experts: Source { segments: switching::weighted(shape, &experts, spec.switch_weight)?, data: experts },
            held_out: Source { segments: Segments::every(&held_out), data: held_out },
            kept: Source {
                data: kept.iter().map(|segments| &segments.trajectory).collect(),
                segments: Segments::kept(kept),
            },
            weighting,
        })
    }

    /// Metrics beside those of each step: now and then the loss on experts that are held out, and in the end what the
    /// policy looks at.
    fn report(&self, policy: &dyn PolicyModel, spec: &TrainSpec, done: u64) -> Result<Metrics, LearnError> {
        let mut metrics = Vec::new();
        if validation::due(done, spec.optim.steps) {
            let loss = self.loss_validation(policy, spec.run.seed)?;
            metrics.extend(loss.map(|loss| (LOSS_VALIDATION, loss)));
        }
        if done == spec.optim.steps {
            let hides = policy.history().always_hides();
            metrics.extend(shares(policy, &self.experts, hides, spec.run.seed)?);
            let followed = switches_followed(policy, &self.experts, hides, spec.run.seed)?;
            metrics.extend(followed.map(|share| (SWITCHES_FOLLOWED, share)));
        }
        Ok(metrics)
    }

    /// The mean loss on the experts that are held out, without changes to their inputs and with the same random parts
    /// every time, and with their history unless training never shows one; `None` if no expert is held out.
    fn loss_validation(&self, policy: &dyn PolicyModel, seed: u64) -> Result<Option<f64>, LearnError> {
        let mut rng = generator(seed, Purpose::Validation, 1);
        validation::mean(&self.held_out.segments, |_, chunk| {
            let (batch, wanted) = self.held_out.collect(&policy.info().form(), chunk)?;
            let history = policy.history();
            let hidden = history.hidden(&batch.windows, &vec![history.always_hides(); chunk.len()]);
            Ok(mean_loss(policy, batch, hidden, &wanted, &mut rng).0.double_value(&[]))
        })
    }

    /// All steps of experts and the kept steps.
    fn sample(&self) -> Sample<'_> {
        let sources = [&self.experts, &self.kept].map(|source| (source.data.as_slice(), &source.segments));
        Sample::of_segments(&sources)
    }

    /// The batch of experts of this number, and that of kept segments if there are any.
    fn assemble(
        &self,
        assembly: &Assembly<'_>,
        seed: u64,
        batch: u64,
    ) -> Result<(Assembled, Option<Assembled>), LearnError> {
        let of = |source: &Source<'_>, purposes| source.assemble(assembly, &Draw { seed, batch, purposes });
        let kept = (!self.kept.segments.is_empty()).then(|| of(&self.kept, KEPT)).transpose()?;
        Ok((of(&self.experts, EXPERT)?, kept))
    }

    fn loss(&self, policy: &dyn PolicyModel, (expert, kept): (Assembled, Option<Assembled>)) -> Loss {
        let Loss { total: expert, parts: terms } = expert.loss(policy, Tensor::shallow_clone);
        let mut parts = vec![("loss_expert", expert.shallow_clone())];
        parts.extend(terms);
        let Some(kept) = kept else { return Loss { total: expert, parts } };
        let kept = kept.loss(policy, |qualities| self.weighting.weights(qualities)).total;
        parts.push(("loss_kept", kept.shallow_clone()));
        Loss { total: expert + kept * self.weighting.lambda, parts }
    }
}
