//! The policy `finetune`: the pretrained transformer itself, trained on by weighted behaviour
//! cloning. A causal pass; the action is read from the last m token by the head of AA.
//!
//! L_full = E_{τ∼D_e}[−log P_θ′(a_{i+l} | τ)] + λ E_{τ∼D_f}[−q(τ) log P_θ′(a_{i+l} | τ)].

use tch::{Device, Kind, Tensor};

use crate::batch::{Batch, Segments};
use crate::checkpoint::{self, CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::device;
use crate::error::{LearnError, guard};
use crate::model::{Network, View};
use crate::objective::{action_autoregression, squared_error};
use crate::random::{Purpose, generator};
use crate::spec::{TaskShape, TrainSpec};
use crate::train::{Loss, Monitor, Resumed, Training};
use crate::trajectory::{Trajectory, WeightedSegments};

/// Trains a policy from the pretrained `encoder` on the `experts` (D_e) and the `kept` segments
/// (D_f) and gives its checkpoint. With nothing kept this is SSDF-base.
///
/// Each step takes the mean over a batch of expert segments and λ times the mean of q · loss over
/// a batch of kept ones. `resume` as in [`pretrain`](crate::pretrain). Metrics: `loss`,
/// `loss_expert`, `loss_kept` (before λ; only if something is kept), `grad_norm`,
/// `learning_rate`, `ms_per_step`.
///
/// # Errors
/// [`LearnError::Invalid`] for bad input, [`LearnError::Checkpoint`] or [`LearnError::Version`] for
/// an encoder that cannot be used, [`LearnError::Cancelled`], [`LearnError::Diverged`], and what
/// the tensor library may give.
pub fn train_policy(
    shape: &TaskShape,
    encoder: Option<&[u8]>,
    experts: &[Trajectory],
    kept: &[WeightedSegments],
    spec: &TrainSpec,
    resume: Option<&[u8]>,
    monitor: &mut dyn Monitor,
) -> Result<Vec<u8>, LearnError> {
    shape.validate()?;
    spec.validate()?;
    if experts.is_empty() {
        return Err(LearnError::invalid("experts", "has no episode to learn from"));
    }
    for trajectory in experts {
        trajectory.validate(shape)?;
    }
    for segments in kept {
        segments.validate(shape)?;
    }
    let encoder = encoder.ok_or_else(|| LearnError::invalid("encoder", "is needed by the policy finetune"))?;
    guard(|| {
        let training = match begin(shape, encoder, spec, resume)? {
            Resumed::Finished(bytes) => return Ok(bytes),
            Resumed::Unfinished(training) => training,
        };
        let sources = Sources::new(shape, experts, kept, spec);
        let loss = |network: &Network, step| sources.loss(network, spec, step);
        training.run(&spec.optim, spec.checkpoint_every, &loss, monitor)
    })
}

fn begin(shape: &TaskShape, encoder: &[u8], spec: &TrainSpec, resume: Option<&[u8]>) -> Result<Resumed, LearnError> {
    let device = device::open(spec.device, spec.threads)?;
    let (stored, named) = checkpoint::read(encoder, CheckpointKind::Encoder)?;
    if stored.shape != *shape {
        return Err(LearnError::invalid(
            "shape",
            "differs from the shape the encoder was pretrained on; use that or pretrain again",
        ));
    }
    let info = CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Policy,
        step: 0,
        finished: false,
        shape: stored.shape,
        model: stored.model,
        spec: spec.identity(),
    };
    if let Some(bytes) = resume {
        return Training::resume(bytes, &info, device);
    }
    let network = Network::from_named(&info.shape, info.model, &named, device)?;
    Ok(Resumed::Unfinished(Box::new(Training::start(network, info))))
}

/// Where the two batches of a step come from.
struct Sources<'a> {
    experts: (Vec<&'a Trajectory>, Segments),
    kept: (Vec<&'a Trajectory>, Segments),
}

impl<'a> Sources<'a> {
    fn new(shape: &TaskShape, experts: &'a [Trajectory], kept: &'a [WeightedSegments], spec: &TrainSpec) -> Self {
        let experts: Vec<&Trajectory> = experts.iter().collect();
        // λ = 0 makes kept segments worth nothing, so they are not even read.
        let kept = if spec.lambda > 0.0 { kept } else { &[] };
        Self {
            experts: (experts.clone(), Segments::every(shape, &experts)),
            kept: (kept.iter().map(|segments| &segments.trajectory).collect(), Segments::kept(kept)),
        }
    }

    fn loss(&self, network: &Network, spec: &TrainSpec, step: u64) -> Loss {
        let expert = weighted_loss(network, &self.experts, spec, (Purpose::Batch, step));
        let mut parts = vec![("loss_expert", expert.double_value(&[]))];
        if self.kept.1.is_empty() {
            return Loss { total: expert, parts };
        }
        let kept = weighted_loss(network, &self.kept, spec, (Purpose::KeptBatch, step));
        parts.push(("loss_kept", kept.double_value(&[])));
        Loss { total: expert + kept * spec.lambda, parts }
    }
}

/// Mean of weight · −log P over a batch drawn from `source`.
fn weighted_loss(
    network: &Network,
    source: &(Vec<&Trajectory>, Segments),
    spec: &TrainSpec,
    (purpose, step): (Purpose, u64),
) -> Tensor {
    let mut rng = generator(spec.seed, purpose, step);
    let drawn = source.1.draw(&mut rng, spec.optim.batch, spec.optim.stretch);
    let window = network.spec.window();
    let device: Device = network.device();
    let batch = Batch::collect(&network.shape, &source.0, &drawn, window, device);
    let steps = network.batch_steps(&batch);
    let features = network.features(&steps, &batch.windows, View::CAUSAL, 1);
    let prediction = action_autoregression::predict(network, &features).squeeze_dim(1);
    let last = batch.windows.index.view([-1, crate::batch::int(window)]).select(1, -1);
    let target = batch.action.index_select(0, &last);
    let target = network.statistics.action.apply(&target);
    (squared_error(&prediction, &target) * &batch.weight).mean(Kind::Float)
}

#[cfg(test)]
mod tests;
