//! A baseline: the certainty of a small network that a step is an expert's.
//!
//! w(τ) = log p(τ is an expert's), from the last step's observation and action alone. Episodes are split into two folds
//! and each fold is scored by a network trained on the other, so no episode is scored by a network that was trained on
//! it, or on a copy of it under another id.

mod mlp;

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use gleaner_core::snapshot::Role;
use tch::Tensor;

use super::{ScorerKind, SeedSpec, seeded, unmatched};
use crate::batch::rows;
use crate::error::LearnError;
use crate::model::Network;
use crate::progress::Progress;
use crate::score::EpisodeScores;
use crate::score::count;
use crate::score::features::{Features, raw, too_far};
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use mlp::{BATCH, Mlp, STEPS};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "classifier",
    title: "Classifier",
    about: "A baseline: a small network that separates the experts' steps from the imperfect ones.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: true },
    settings: SeedSpec::schema,
    open: |chosen| seeded(chosen, scores),
};

/// One episode's steps as inputs of the network.
struct Episode<'a> {
    id: &'a str,
    /// `[T, W]`.
    inputs: Tensor,
    fold: usize,
}

/// The scores of the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
pub(super) fn scores(
    network: &Network,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    seed: u64,
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    let steps = count(experts.iter().chain(imperfect));
    let mut progress = Progress::of_segments(monitor, steps + 2 * STEPS * u64::from(BATCH));
    let [of_experts, of_imperfect] = folds(experts, imperfect)?;
    let mut gather = |episodes, folds: &[usize]| gather(network, episodes, folds, &mut progress);
    let (experts, imperfect) = (gather(experts, &of_experts)?, gather(imperfect, &of_imperfect)?);
    let mut trained = Vec::with_capacity(2);
    for fold in 0..2 {
        let others = [class(&experts, 1 - fold), class(&imperfect, 1 - fold)];
        trained.push(Mlp::train(&others, seed, fold, &mut progress)?);
    }
    let describe = |episodes: &[Episode<'_>], role| -> Result<Vec<EpisodeScores>, LearnError> {
        episodes.iter().map(|episode| describe(episode, role, &trained[episode.fold])).collect()
    };
    Ok((describe(&imperfect, Role::Imperfect)?, describe(&experts, Role::Expert)?))
}

/// The fold of every expert and of every imperfect episode: alternating in the order of ids, separately for both. Episodes
/// with equal steps are in one fold, whatever their ids and roles.
fn folds(experts: &[Trajectory], imperfect: &[Trajectory]) -> Result<[Vec<usize>; 2], LearnError> {
    let mut of_recordings = HashMap::new();
    let mut of = |field: &str, episodes: &[Trajectory]| {
        let mut order: Vec<usize> = (0..episodes.len()).collect();
        order.sort_unstable_by_key(|place| &episodes[*place].id);
        let (mut folds, mut next) = (vec![0; episodes.len()], 0);
        for place in order {
            folds[place] = match of_recordings.entry(episodes[place].content()?) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(unknown) => {
                    next += 1;
                    *unknown.insert((next - 1) % 2)
                }
            };
        }
        if (0..2).any(|fold| !folds.contains(&fold)) {
            let message = "has too few different episodes for the classifier, which is trained on one half to score \
                           the other; give at least two, or use another scorer";
            return Err(LearnError::invalid(field, message));
        }
        Ok(folds)
    };
    Ok([of("experts", experts)?, of("imperfect", imperfect)?])
}

/// Every episode's inputs, with its fold.
fn gather<'a>(
    network: &Network,
    episodes: &'a [Trajectory],
    folds: &[usize],
    progress: &mut Progress<'_>,
) -> Result<Vec<Episode<'a>>, LearnError> {
    let mut all = Vec::with_capacity(episodes.len());
    for (trajectory, fold) in episodes.iter().zip(folds) {
        let features = raw::steps(network, trajectory)?;
        if !features.comparable() {
            return Err(too_far(&trajectory.id));
        }
        progress.advance(features.count())?;
        all.push(Episode { id: &trajectory.id, inputs: inputs(network, &features), fold: *fold });
    }
    Ok(all)
}

/// o, m and a side by side, `[T, W]`.
fn inputs(network: &Network, features: &Features) -> Tensor {
    let part = |i: usize| rows(features.values(i), features.widths()[i], network.device());
    Tensor::cat(&[0, 1, 2].map(part), 1)
}

/// All steps of the episodes in `fold`, `[N, W]`, in the order of ids.
fn class(episodes: &[Episode<'_>], fold: usize) -> Tensor {
    let mut chosen: Vec<&Episode<'_>> = episodes.iter().filter(|episode| episode.fold == fold).collect();
    chosen.sort_by_key(|episode| episode.id);
    Tensor::cat(&chosen.iter().map(|episode| &episode.inputs).collect::<Vec<_>>(), 0)
}

fn describe(episode: &Episode<'_>, role: Role, mlp: &Mlp) -> Result<EpisodeScores, LearnError> {
    let w = mlp.log_probability(&episode.inputs);
    if !w.iter().all(|w| w.is_finite()) {
        let message = "is too far from the other episodes for the classifier; correct it or use another scorer";
        return Err(LearnError::invalid(format!("episode {}", episode.id), message));
    }
    Ok(unmatched(episode.id, role, w))
}

#[cfg(test)]
mod tests;
