//! The scorer `deminf`, a rival that uses no expert labels: the information that the action of a step carries about its
//! state, after DemInf (Hejna et al. 2025).
//!
//! I(s; a) of one step among B others, estimated from nearest neighbours: with r the distance to the k-th neighbour in
//! (s, a), larger of both parts, and n_s, n_a the steps that are nearer than r in each part, the score is
//! −(ψ(n_s) + ψ(n_a)), averaged over k = 5, 6, 7. Here s is whitened principal components of the image embedding, taken
//! before attention, and of proprioception: features after attention contain the actions. The w of a segment is the mean
//! of its steps.

mod estimate;

use std::collections::HashMap;

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use gleaner_core::snapshot::Role;
use rand::seq::SliceRandom as _;
use tch::{Tensor, no_grad_guard};

use super::recordings::check_ids;
use super::{ScorerKind, SeedSpec, seeded, unmatched};
use crate::batch::{int, rows, values};
use crate::error::LearnError;
use crate::model::Network;
use crate::progress::Progress;
use crate::random::{Purpose, generator};
use crate::score::EpisodeScores;
use crate::score::count;
use crate::score::features::{states, too_far};
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use estimate::{estimate, standardised, whitened, windows};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "deminf",
    title: "DemInf",
    about: "A rival without expert labels: the mutual information of states and actions, estimated from neighbours.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: true },
    settings: SeedSpec::schema,
    open: |chosen| seeded(chosen, scores),
};

/// Steps that are compared with each other at a time.
const BATCH: usize = 1024;
/// Passes over all steps, each in an order of its own.
const PASSES: u64 = 4;
/// Values of an action that are compared, the first ones.
const ACTION: i64 = 8;

/// The scores of the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
fn scores(
    network: &Network,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    seed: u64,
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    let _no_grad = no_grad_guard();
    let mut sorted: Vec<&Trajectory> = imperfect.iter().chain(experts).collect();
    sorted.sort_by(|a, b| a.id.cmp(&b.id));
    check_ids(experts, imperfect)?;
    sorted.dedup_by(|a, b| a.id == b.id);
    let steps = count(sorted.iter().copied());
    let mut progress =
        Progress::of_segments(monitor, steps * (1 + passes(usize::try_from(steps).unwrap_or(usize::MAX))));
    let (mut observed, mut actions) = (Vec::with_capacity(sorted.len()), Vec::with_capacity(sorted.len()));
    for episode in &sorted {
        observed.push(states(network, episode)?);
        actions.push(first_actions(network, episode)?);
        progress.advance(episode.steps())?;
    }
    let state = whitened(&observed).to_device(network.device());
    drop(observed);
    let of_steps = standardised(information(&state, &Tensor::cat(&actions, 0), seed, &mut progress)?);
    let mut begin = 0;
    let mut of_episodes = HashMap::new();
    for episode in &sorted {
        let end = begin + episode.steps();
        of_episodes.insert(episode.id.as_str(), windows(&of_steps[begin..end], network.spec.window()));
        begin = end;
    }
    let describe = |episodes: &[Trajectory], role: Role| -> Vec<EpisodeScores> {
        let of = |episode: &Trajectory| {
            unmatched(&episode.id, role, of_episodes.get(episode.id.as_str()).cloned().unwrap_or_default())
        };
        episodes.iter().map(of).collect()
    };
    Ok((describe(imperfect, Role::Imperfect), describe(experts, Role::Expert)))
}

/// The first values of every step's standardised action, within the task's ranges as every other scorer sees it,
/// `[T, ≤ 8]`.
fn first_actions(network: &Network, episode: &Trajectory) -> Result<Tensor, LearnError> {
    let width = network.shape.action;
    let mut actions = episode.actions()?;
    actions.chunks_exact_mut(width).for_each(|action| network.shape.ranges.apply(action));
    let action = network.statistics.action.apply(&rows(&actions, width, network.device()));
    let first = action.narrow(1, 0, ACTION.min(int(width)));
    if values(&first).iter().all(|value| value.is_finite()) { Ok(first) } else { Err(too_far(&episode.id)) }
}

/// Passes over this many steps: a single batch is the same in every order.
fn passes(steps: usize) -> u64 {
    if steps < 2 * BATCH { 1 } else { PASSES }
}

/// The estimate for each of the N steps, the mean of the passes.
fn information(
    state: &Tensor,
    action: &Tensor,
    seed: u64,
    progress: &mut Progress<'_>,
) -> Result<Vec<f64>, LearnError> {
    let steps = usize::try_from(state.size()[0]).unwrap_or(0);
    // Batches of one size: an estimate depends on the number of steps that it is made among.
    let batches = (steps / BATCH).max(1);
    let mut sums = vec![0.0; steps];
    let mut order: Vec<i64> = (0..int(steps)).collect();
    let passes = passes(steps);
    for pass in 0..passes {
        order.shuffle(&mut generator(seed, Purpose::Batch, pass));
        for batch in 0..batches {
            let places = &order[batch * steps / batches..(batch + 1) * steps / batches];
            let index = Tensor::from_slice(places).to_device(state.device());
            let found = estimate(&state.index_select(0, &index), &action.index_select(0, &index));
            for (place, value) in places.iter().zip(values(&found)) {
                sums[usize::try_from(*place).unwrap_or(0)] += f64::from(value);
            }
            progress.advance(places.len())?;
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let passes = passes as f64;
    Ok(sums.into_iter().map(|sum| sum / passes).collect())
}

#[cfg(test)]
mod tests {
    use gleaner_core::action::ActionRange;

    use super::*;
    use crate::checkpoint::{self, CheckpointKind};
    use crate::random::normal;
    use crate::score::Scores;
    use crate::score::tests::{encoder, score_anew, spec_of};
    use crate::toy;
    use crate::train::Silent;

    /// More steps than a batch holds: correlated normal numbers, with one value to each part.
    #[test]
    fn steps_are_compared_in_batches_that_the_seed_draws() {
        let drawn = normal(&mut generator(4, Purpose::Style, 0), 2 * 3000);
        let (state, action): (Vec<f32>, Vec<f32>) =
            drawn.chunks(2).map(|pair| (pair[0], 0.9 * pair[0] + 0.19f32.sqrt() * pair[1])).unzip();
        let column = |values: &[f32]| Tensor::from_slice(values).view([-1, 1]);
        let found = |seed: u64| {
            let mut silent = Silent;
            let mut progress = Progress::of_segments(&mut silent, 3000 * PASSES);
            information(&column(&state), &column(&action), seed, &mut progress).unwrap()
        };
        let first = found(1);
        assert_eq!((first.len(), &first), (3000, &found(1)));
        assert_ne!(first, found(2));
        // Of batches of 1500: ψ(1500) is 7.313, ψ(5 … 7) are 1.506, 1.706, 1.873.
        let mean = windows(&first, 3000)[2999] + 1.695 + 7.313;
        assert!((mean - 0.830).abs() < 0.06, "{mean}");
        assert!(first.iter().all(|score| score.is_finite()));
    }

    #[test]
    fn an_id_with_two_contents_and_steps_that_are_not_finite_are_refused() {
        let experts = toy::experts(3, 8);
        let message = |imperfect: Trajectory| {
            let spec = spec_of("deminf", &[]);
            score_anew(&experts, &[imperfect], &spec, &mut Silent).unwrap_err().to_string()
        };
        let twin = Trajectory { id: experts[1].id.clone(), ..toy::episode("failure", 5, 9, false) };
        assert!(message(twin).starts_with("episode expert 1: is an expert and imperfect"), "two contents");
        let far = toy::episode("far", 5, 9, false).changed(|arrays| arrays.proprioception[4] = f32::MAX);
        assert!(message(far).starts_with("episode far: is too far from the encoder's data"), "not finite");
    }

    #[test]
    fn actions_beyond_their_ranges_are_those_that_the_task_allows() {
        let (info, named) = checkpoint::read(&encoder(), CheckpointKind::Encoder).unwrap();
        let mut network = Network::from_named(&info.shape, info.model, &named, tch::Device::Cpu).unwrap();
        network.shape.ranges = [ActionRange::Within(-0.01, 0.01), ActionRange::Binary(-0.3, 0.3)].into_iter().collect();
        let recorded = toy::episode("e", 1, 6, true);
        let mut actions = recorded.actions().unwrap();
        actions.chunks_exact_mut(2).for_each(|action| network.shape.ranges.apply(action));
        assert_ne!(actions, recorded.actions().unwrap());
        let seen = |episode: &Trajectory| first_actions(&network, episode).unwrap();
        assert_eq!(seen(&recorded), seen(&recorded.with_actions(actions)));
    }

    fn run(experts: &[Trajectory], imperfect: &[Trajectory], seed: u64) -> Scores {
        score_anew(experts, imperfect, &spec_of("deminf", &[("seed", seed.into())]), &mut Silent).unwrap()
    }

    /// In the toy task an expert's action follows from the state; random actions carry no information about it.
    #[test]
    fn random_actions_score_below_those_that_follow_from_the_state() {
        let experts = toy::experts(12, 12);
        let mut random = toy::experts(12, 12);
        for (place, episode) in (0u64..).zip(&mut random) {
            let actions = normal(&mut generator(place, Purpose::Style, 9), 2 * episode.steps());
            *episode = episode.with_actions(actions.into_iter().map(|action| 0.3 * action).collect());
            episode.id = format!("random {place}");
        }
        let scores = run(&experts, &random, 1);
        let mean = |episodes: &[EpisodeScores]| {
            let all: Vec<f64> = episodes.iter().flat_map(|episode| episode.w.clone()).collect();
            windows(&all, all.len())[all.len() - 1]
        };
        let (good, bad) = (mean(&scores.experts), mean(&scores.imperfect));
        assert!(good > bad + 0.3, "{good} {bad}");
        assert!(scores.imperfect.iter().all(|episode| episode.match_episode.is_empty() && episode.q.len() == 12));
    }
}
