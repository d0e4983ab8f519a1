//! The scorer `progress`, a rival: how far the next steps bring the task forward, after ReWiND (Zhang et al. 2025) and
//! the weights of SARM (Chen et al. 2025).
//!
//! A small network learns from experts how much of the task is done at each frame, also of clips that are rewound, so
//! that time alone is no progress. With p its estimate and Δ a setting, w_t = p_{t+Δ} − p_t; after the episode's end p
//! keeps its last value. Experts are split into two folds and each is scored by the network that was trained on the
//! other; any other episode is scored by the mean of both networks.

mod clip;
mod net;

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use gleaner_core::schema::integer_in;
use gleaner_core::snapshot::Role;
use tch::Tensor;

use super::recordings::{Recordings, check_ids};
use super::{Scorer, ScorerKind, SeedSpec, Trained, unmatched};
use crate::error::LearnError;
use crate::model::Network;
use crate::progress::Progress;
use crate::score::EpisodeScores;
use crate::score::count;
use crate::score::features::states;
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use clip::SHORTEST;
use net::{BATCH, Net};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "progress",
    title: "Progress",
    about: "A rival: the progress that the next steps make, by a small network that learns from experts how much of \
            the task is done.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: true },
    settings: || [SeedSpec::schema(), ProgressSpec::schema()].concat(),
    open: |chosen| {
        let (SeedSpec { seed }, spec): (_, ProgressSpec) = (chosen.read()?, chosen.read()?);
        Ok(Scorer::Trained(Trained {
            feature_scale: None,
            scores: Box::new(move |encoder, episodes, monitor| {
                scores(encoder.network, episodes, (&spec, seed), monitor)
            }),
        }))
    },
};

gleaner_core::settings! {
    /// Settings of the scorer `progress`.
    struct ProgressSpec {
        /// Gradient steps of each of the two networks of `progress`. More steps fit the experts closer and take longer.
        progress_steps: u64 = 400, integer_in(1, 1_000_000);
        /// Steps ahead at which `progress` is compared with the present. More steps average over pauses; fewer locate a
        /// fault more precisely.
        progress_delta: u32 = 10, integer_in(1, 10_000);
    }
}

/// The scores of the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
fn scores(
    network: &Network,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    (spec, seed): (&ProgressSpec, u64),
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    check_ids(experts, imperfect)?;
    let long = experts.iter().filter(|expert| expert.steps() >= SHORTEST);
    let recordings = Recordings::new(long)?;
    let learned = recordings.experts();
    if learned.len() < 2 {
        let message = format!(
            "has too few different episodes of at least {SHORTEST} steps for progress, which is trained on one half to \
             score the other; give at least two, or use another scorer"
        );
        return Err(LearnError::invalid("experts", message));
    }
    let steps = count(learned.iter().copied()) + count(experts.iter().chain(imperfect));
    let mut progress = Progress::of_segments(monitor, steps + 2 * spec.progress_steps * u64::from(BATCH));
    let mut observed = Vec::with_capacity(learned.len());
    for expert in learned {
        observed.push(states(network, expert)?);
        progress.advance(expert.steps())?;
    }
    let mut networks = Vec::with_capacity(2);
    for fold in 0..2 {
        let other: Vec<&Tensor> = observed.iter().skip(1 - fold).step_by(2).collect();
        networks.push(Net::train(&other, (spec, seed), fold as u64, network.device(), &mut progress)?);
    }
    let mut describe = |episodes: &[Trajectory], role| -> Result<Vec<EpisodeScores>, LearnError> {
        let mut all = Vec::with_capacity(episodes.len());
        for episode in episodes {
            let number = recordings.number(episode)?;
            let known = number.map(|number| observed[number].shallow_clone());
            let states = known.map_or_else(|| states(network, episode), Ok)?;
            let judges = number.map_or(&networks[..], |number| &networks[number % 2..=number % 2]);
            let w = gains(&estimate(judges, &states, &episode.id)?, spec.progress_delta as usize);
            all.push(unmatched(&episode.id, role, w));
            progress.advance(episode.steps())?;
        }
        Ok(all)
    };
    Ok((describe(imperfect, Role::Imperfect)?, describe(experts, Role::Expert)?))
}

/// The mean of the networks' progress at every step of `states`, `[T, D]`.
fn estimate(networks: &[Net], states: &Tensor, episode: &str) -> Result<Vec<f64>, LearnError> {
    let mut sums = vec![0.0; usize::try_from(states.size()[0]).unwrap_or(0)];
    for network in networks {
        sums.iter_mut().zip(network.progress(states)).for_each(|(sum, progress)| *sum += progress);
    }
    if !sums.iter().all(|sum| sum.is_finite()) {
        let message =
            "has a progress that is not finite: it is too far from the experts; correct it or use another scorer";
        return Err(LearnError::invalid(format!("episode {episode}"), message));
    }
    #[expect(clippy::cast_precision_loss, reason = "one or two")]
    let count = networks.len() as f64;
    Ok(sums.into_iter().map(|sum| sum / count).collect())
}

/// p_{t+Δ} − p_t at every step, where p keeps its last value after the end.
fn gains(progress: &[f64], delta: usize) -> Vec<f64> {
    let Some(last) = progress.len().checked_sub(1) else { return Vec::new() };
    (0..progress.len()).map(|step| progress[last.min(step + delta)] - progress[step]).collect()
}

#[cfg(test)]
mod tests;
