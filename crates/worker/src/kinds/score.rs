//! Scoring: w and q of every segment of D_i, and of each expert of D_e against the others.

use gleaner_core::{
    ScoreSpec,
    id::EpisodeId,
    score::EpisodeScores,
    work::{FrozenRun, Made},
};
use gleaner_learn::{Normaliser, Peers, ScoreBase, ScoreInputs};

use super::{Base, Work};
use crate::{failure::Failure, features::KeptFeatures};

/// Scores a snapshot, or extends an earlier run; `None` for a rank that does not lead.
pub(super) fn perform(work: &mut Work, spec: ScoreSpec, mut peers: Peers) -> Result<Option<Made>, Failure> {
    let spec = ScoreSpec { threads: Some(work.threads), ..spec };
    let encoder = work.input("encoder", work.inputs.encoder.as_ref())?;
    let experts = work.episodes().trajectories(&work.inputs.experts)?;
    let imperfect = work.episodes().trajectories(&work.inputs.imperfect)?;
    work.monitor.phase("scoring");
    let kind = gleaner_learn::features_kind(&spec)?.unwrap_or_default();
    let kept = KeptFeatures::new(&work.data_dir, &work.blobs, &work.inputs, &kind);
    let inputs = ScoreInputs { encoder: &encoder, experts: &experts, imperfect: &imperfect, kept: &kept };
    let base = work.base.take().map(|base| base_of(base, &spec));
    let scores = gleaner_learn::score_with(inputs, base.as_ref(), &spec, (&mut peers, &mut work.monitor))?;
    let Some(scores) = scores else { return Ok(None) };
    let stored = |scores: EpisodeScores<String>| scores.renamed(|id| EpisodeId::parse("episode_id", &id));
    let episodes = scores.imperfect.into_iter().chain(scores.experts).map(stored);
    Ok(Some(Made::Scores {
        lo: scores.normaliser.lo,
        hi: scores.normaliser.hi,
        quantiles: scores.normaliser.quantiles,
        expert_ids: work.inputs.experts.iter().map(|expert| expert.id.clone()).collect(),
        episodes: episodes.collect::<Result<_, _>>()?,
    }))
}

fn base_of(base: Base, spec: &ScoreSpec) -> ScoreBase {
    let Base { frozen: FrozenRun { lo, hi, quantiles, expert_ids }, scores } = base;
    let named = |scores: EpisodeScores| {
        let EpisodeScores { episode_id, role, w, q, match_episode, match_step, distances } = scores;
        EpisodeScores { episode_id: episode_id.into(), role, w, q, match_episode, match_step, distances }
    };
    ScoreBase {
        normaliser: Normaliser { kind: spec.normaliser, lo, hi, quantiles },
        experts: expert_ids.into_iter().map(Into::into).collect(),
        scores: scores.into_iter().map(named).collect(),
    }
}
