//! Pretraining: an encoder from all episodes of a snapshot.

use gleaner_core::{PretrainSpec, work::Made};
use gleaner_learn::{Participant, Peers};

use super::Work;
use crate::failure::Failure;

/// L = L_MTP + L_TR + L_AA over D_u = D_e ∪ D_i.
pub(super) fn perform(work: &mut Work, spec: PretrainSpec, mut peers: Peers) -> Result<Option<Made>, Failure> {
    let spec = PretrainSpec { threads: Some(work.threads), ..spec };
    let (shape, resume) = (work.episodes().shape(), work.resume()?);
    let weights = work.image_weights(&spec.image_weights)?;
    let all = [work.inputs.experts.as_slice(), work.inputs.imperfect.as_slice()].concat();
    let data = work.episodes().trajectories(&all)?;
    work.monitor.phase("pretraining");
    let (weights, resume) = (weights.as_deref(), resume.as_deref());
    let participant = Participant { resume, peers: &mut peers, monitor: &mut work.monitor };
    let made = gleaner_learn::pretrain_with(&shape, &data, &spec, weights, participant)?;
    made.map(|bytes| Ok(Made::Encoder { checkpoint: work.keep(&bytes)? })).transpose()
}
