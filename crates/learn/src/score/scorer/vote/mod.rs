//! The scorer `vote`, a rival: whether the nearest segments are those of experts or corrupted copies of them, after S2I
//! (Chen et al. 2024).
//!
//! The encoder's features of the experts' segments are good, and each segment has a bad twin: the same observations
//! with actions that are noisy, shuffled in time or another expert's, which of the three is drawn. w is the share of
//! good among the nearest, weighted by distance. Segments of the same recording have no vote, nor have their twins.

mod corrupt;
mod voters;

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use gleaner_core::schema::{integer_in, number_in};
use gleaner_core::snapshot::Role;
use rand::RngExt;
use tch::no_grad_guard;

use super::recordings::{Recordings, check_ids};
use super::{Scorer, ScorerKind, SeedSpec, Trained, unmatched};
use crate::batch::{int, rows};
use crate::error::LearnError;
use crate::progress::Progress;
use crate::random::{Purpose, generator};
use crate::score::EpisodeScores;
use crate::score::comparison::{Comparison, FeatureScale, NearestSpec, Similarity, Source};
use crate::score::count;
use crate::score::features::{Encoder, Features, episode_features};
use crate::score::matched::sound;
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use corrupt::{WAYS, copies};
use voters::Voters;

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "vote",
    title: "Vote",
    about: "A rival: the share of experts' segments, rather than copies of them with corrupted actions, among the \
            nearest in the encoder's features.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: true },
    settings: || [SeedSpec::schema(), VoteSpec::schema()].concat(),
    open: |chosen| {
        let (SeedSpec { seed }, spec): (_, VoteSpec) = (chosen.read()?, chosen.read()?);
        Ok(Scorer::Trained(Trained {
            feature_scale: Some(FeatureScale::Whitened),
            scores: Box::new(move |encoder, episodes, monitor| scores(encoder, episodes, (&spec, seed), monitor)),
        }))
    },
};

gleaner_core::settings! {
    /// Settings of the scorer `vote`.
    struct VoteSpec {
        /// Number of nearest segments that vote on a segment. More of them give a smoother but less local vote.
        neighbours: u32 = 64, integer_in(1, 65_536);
        /// Noise of a corrupted action, in standard deviations of each value. Less noise makes the vote stricter, until
        /// good and corrupted segments are alike.
        corruption_noise: f64 = 0.5, number_in(0.001, 1000.0);
    }
}

/// The scores of the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
fn scores(
    encoder: Encoder<'_>,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    (spec, seed): (&VoteSpec, u64),
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    let _no_grad = no_grad_guard();
    let network = encoder.network;
    check_ids(experts, imperfect)?;
    let recordings = Recordings::new(experts.iter())?;
    if recordings.experts().len() < 2 {
        let message = "has too few different episodes for vote, in which an episode has no vote on itself; give at \
                       least two, or use another scorer";
        return Err(LearnError::invalid("experts", message));
    }
    let of_recordings = count(recordings.experts().iter().copied());
    let of_episodes = count(experts.iter().chain(imperfect));
    let mut progress = Progress::of_segments(monitor, (1 + WAYS as u64) * of_recordings + of_episodes);
    let comparison =
        Comparison::new(Source::Features(FeatureScale::Whitened), Similarity::LastL2, [0.0; 3], NearestSpec::default());
    let features = |episode: &Trajectory| sound(episode_features(encoder, episode, &comparison)?, &episode.id);
    let mut groups = Vec::with_capacity(recordings.experts().len());
    for (number, expert) in recordings.experts().iter().enumerate() {
        let good = features(expert)?;
        progress.advance(good.count())?;
        let mut rng = generator(seed, Purpose::Corruption, number as u64);
        let others = recordings.experts().len() - 1;
        let other = recordings.experts()[(number + rng.random_range(1..=others)) % (others + 1)];
        let mut ways = Vec::with_capacity(WAYS);
        for copy in copies(network, expert, other, spec.corruption_noise, &mut rng)? {
            ways.push(features(&copy)?);
            progress.advance(good.count())?;
        }
        let mut bad = Features::empty(good.widths());
        for step in 0..good.count() {
            let way = &ways[rng.random_range(0..WAYS)];
            bad.extend([0, 1, 2].map(|part| way.row(part, step)));
        }
        groups.push((good, bad));
    }
    let voters = Voters::new(&groups, network.device());
    let mut describe = |episodes: &[Trajectory], role| -> Result<Vec<EpisodeScores>, LearnError> {
        let mut all = Vec::with_capacity(episodes.len());
        for episode in episodes {
            let own = recordings.number(episode)?;
            let known = own.map(|number| groups[number].0.clone());
            let segments = known.map_or_else(|| features(episode), Ok)?;
            let parts = [0, 1, 2].map(|part| rows(segments.values(part), segments.widths()[part], network.device()));
            let mut w = Vec::with_capacity(segments.count());
            while w.len() < segments.count() {
                let chunk = voters.chunk().min(segments.count() - w.len());
                let queries = parts.each_ref().map(|part| part.narrow(0, int(w.len()), int(chunk)));
                w.extend(voters.qualities(&queries, own, spec.neighbours as usize));
                progress.advance(chunk)?;
            }
            all.push(unmatched(&episode.id, role, w));
        }
        Ok(all)
    };
    Ok((describe(imperfect, Role::Imperfect)?, describe(experts, Role::Expert)?))
}

#[cfg(test)]
mod tests;
