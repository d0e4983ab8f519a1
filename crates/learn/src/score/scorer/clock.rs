//! The scorer `clock`, a control that looks at nothing but the time: w is the number of the step at which a segment ends, less
//! than 0, so that the best part is the first steps of every episode. Most failures are good at first, so a scorer is worth
//! what it brings beyond this one.

use gleaner_core::kinds::Needs;

use super::{Scorer, ScorerKind, Trained, unmatched_each};
use crate::trajectory::Trajectory;

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "clock",
    title: "Clock",
    about: "A control: early segments first, so that the best part is the first steps of every episode.",
    needs: Needs { encoder: false, history: false, images: false, all_episodes: true },
    settings: Vec::new,
    open: |_| {
        Ok(Scorer::Trained(Trained {
            feature_scale: None,
            scores: Box::new(|_, episodes, monitor| unmatched_each(episodes, monitor, w)),
        }))
    },
};

#[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^52")]
fn w(episode: &Trajectory) -> Vec<f64> {
    (0..episode.steps()).map(|step| -(step as f64)).collect()
}

#[cfg(test)]
mod tests {
    use crate::score::tests::{score_anew, spec_of};
    use crate::toy;
    use crate::train::Silent;

    #[test]
    fn an_earlier_segment_of_any_episode_is_better() {
        let imperfect = [toy::episode("a", 7, 40, false), toy::episode("b", 9, 25, false)];
        let found = score_anew(&toy::experts(3, 8), &imperfect, &spec_of("clock", &[]), &mut Silent).unwrap();
        let [long, short] = &found.imperfect[..] else { panic!("{found:?}") };
        assert_eq!((long.w.len(), short.w.len()), (40, 25));
        assert_eq!(long.w[..25], short.w[..], "whatever they show");
        assert!(long.w.is_sorted_by(|earlier, later| earlier > later), "{:?}", long.w);
        assert!(long.q.is_sorted_by(|earlier, later| earlier >= later), "{:?}", long.q);
    }
}
