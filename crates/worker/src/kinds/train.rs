//! Training: a policy by behaviour cloning of experts and kept segments.

use gleaner_core::{TrainSpec, order::needs_encoder, work::Made};
use gleaner_learn::{LearnError, Participant, Peers, Pretrained};

use super::Work;
use crate::failure::Failure;

/// L = E_{D_e}[loss] + λ · E_{D_i}[q · loss].
pub(super) fn perform(work: &mut Work, spec: TrainSpec, mut peers: Peers) -> Result<Option<Made>, Failure> {
    let spec = TrainSpec { threads: Some(work.threads), ..spec };
    let (shape, resume) = (work.episodes().shape(), work.resume()?);
    let encoder = if needs_encoder(&spec) { Some(work.input("encoder", work.inputs.encoder.as_ref())?) } else { None };
    let named = spec.image_weights().map_err(LearnError::from)?;
    let weights = work.image_weights(&named)?;
    let experts = work.episodes().trajectories(&work.inputs.experts)?;
    // There may be millions of kept segments: one copy of them is enough.
    let kept = std::mem::take(&mut work.inputs.kept);
    let kept = work.episodes().weighted(kept)?;
    work.monitor.phase("training");
    let (resume, monitor) = (resume.as_deref(), &mut work.monitor);
    let participant = Participant { resume, peers: &mut peers, monitor };
    let pretrained = Pretrained { encoder: encoder.as_deref(), image_weights: weights.as_deref() };
    let made = gleaner_learn::train_policy_with(&shape, pretrained, &experts, &kept, &spec, participant)?;
    made.map(|bytes| Ok(Made::Policy { checkpoint: work.keep(&bytes)?, kind: spec.policy.name.clone() })).transpose()
}
