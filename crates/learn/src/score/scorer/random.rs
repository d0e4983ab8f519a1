//! The scorer `random`, a control: numbers that depend on nothing. A policy trained on its best part has as many segments
//! as with another scorer, drawn blindly; the difference is what scores are worth.

use gleaner_core::Group as _;
use gleaner_core::kinds::Needs;
use rand::RngExt;

use super::{ScorerKind, SeedSpec, seeded, unmatched_each};
use crate::error::LearnError;
use crate::model::Network;
use crate::random::{Purpose, generator};
use crate::score::EpisodeScores;
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

fn scores(
    _: &Network,
    episodes: (&[Trajectory], &[Trajectory]),
    seed: u64,
    monitor: &mut dyn Monitor,
) -> Result<(Vec<EpisodeScores>, Vec<EpisodeScores>), LearnError> {
    unmatched_each(episodes, monitor, |episode| {
        // By the id, so that other episodes and their order have no influence.
        let id = blake3::hash(episode.id.as_bytes());
        let counter = id.as_bytes().iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte));
        let mut rng = generator(seed, Purpose::RandomScore, counter);
        (0..episode.steps()).map(|_| rng.random::<f64>()).collect()
    })
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
