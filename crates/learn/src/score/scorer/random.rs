//! The scorer `random`, a control: numbers that depend on nothing. A policy trained on its best part has as many segments
//! as with another scorer, drawn blindly; the difference is what scores are worth.

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use gleaner_core::snapshot::Role;
use rand::RngExt;

use super::{ScorerKind, SeedSpec, seeded, unmatched};
use crate::error::LearnError;
use crate::model::Network;
use crate::progress::Progress;
use crate::random::{Purpose, generator};
use crate::score::EpisodeScores;
use crate::score::count;
use crate::train::Monitor;
use crate::trajectory::Trajectory;

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "random",
    title: "Random",
    about: "A control: random numbers, so that the best part is a blind draw.",
    needs: Needs { encoder: false, history: false, images: false, all_episodes: true },
    settings: SeedSpec::schema,
    open: |chosen| seeded(chosen, scores),
};

/// The scores of the (experts, imperfect) episodes, without q, as (imperfect, experts), each in the given order.
fn scores(
    _: &Network,
    (experts, imperfect): (&[Trajectory], &[Trajectory]),
    seed: u64,
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    let mut progress = Progress::of_segments(monitor, count(experts.iter().chain(imperfect)));
    let mut draw = |episodes: &[Trajectory], role| -> Result<Vec<EpisodeScores>, LearnError> {
        let mut drawn = Vec::with_capacity(episodes.len());
        for episode in episodes {
            let steps = episode.steps();
            // By the id, so that other episodes and their order have no influence.
            let id = blake3::hash(episode.id.as_bytes());
            let counter = id.as_bytes().iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte));
            let mut rng = generator(seed, Purpose::RandomScore, counter);
            drawn.push(unmatched(&episode.id, role, (0..steps).map(|_| rng.random::<f64>()).collect()));
            progress.advance(steps)?;
        }
        Ok(drawn)
    };
    Ok((draw(imperfect, Role::Imperfect)?, draw(experts, Role::Expert)?))
}

#[cfg(test)]
mod tests {
    use crate::score::Scores;
    use crate::score::tests::{score_anew, spec_of};
    use crate::toy;
    use crate::train::Silent;
    use crate::trajectory::Trajectory;

    fn run(imperfect: &[Trajectory], seed: u64) -> Scores {
        score_anew(&toy::experts(3, 8), imperfect, &spec_of("random", &[("seed", seed.into())]), &mut Silent).unwrap()
    }

    #[test]
    fn the_seed_and_the_episode_alone_decide() {
        let both = [toy::episode("a", 7, 40, false), toy::episode("b", 7, 40, false)];
        let first = run(&both, 1);
        assert_eq!(first.imperfect[1].w, run(&both[1..], 1).imperfect[0].w);
        assert_ne!(first.imperfect[0].w, first.imperfect[1].w, "equal steps under another id");
        assert_ne!(first.imperfect[0].w, run(&both, 2).imperfect[0].w);
        let all = first.imperfect.iter().flat_map(|episode| &episode.w);
        let mean = all.sum::<f64>() / 80.0;
        // The standard error of 80 uniform numbers is 0.03.
        assert!((mean - 0.5).abs() < 0.15, "{mean}");
    }
}
