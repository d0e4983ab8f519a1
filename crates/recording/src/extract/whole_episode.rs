//! A whole episode with what a score run states of its steps.

use std::collections::BTreeMap;

use gleaner_core::selection::Filter;

use super::{Kept, StepScore};

/// An episode in a score run.
#[derive(Clone, Copy, Debug)]
pub struct WholeEpisode<'a> {
    /// Its id.
    pub id: &'a str,
    /// The name of its file when it was pushed.
    pub file_name: &'a str,
    /// `success`, `failure` or `unknown`.
    pub outcome: &'a str,
    /// Its cohort; may be empty.
    pub cohort: &'a str,
    /// Id of the run.
    pub run: &'a str,
    /// A step with a higher q is marked as kept.
    pub beta: f64,
    /// q of each step.
    pub q: &'a [f32],
    /// w of each step.
    pub w: &'a [f64],
}

impl WholeEpisode<'_> {
    /// What to write beside its messages. `matched` returns the nearest expert of a step and the step there.
    pub fn kept(&self, matched: impl Fn(usize) -> Option<(String, u32)>) -> Kept {
        let Self { id, file_name, outcome, cohort, run, beta, q, w } = *self;
        let filter = Filter::Above(beta);
        let score =
            |(at, (&q, &w)): (usize, (&f32, &f64))| StepScore { q, w, kept: filter.keeps(w, q), matched: matched(at) };
        let about = [
            ("episode", id),
            ("episode_source", file_name),
            ("outcome", outcome),
            ("cohort", cohort),
            ("run", run),
            ("beta", &beta.to_string()),
        ];
        let about: BTreeMap<_, _> =
            about.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
        Kept { first_step: 0, scores: q.iter().zip(w).enumerate().map(score).collect(), about }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_has_its_score_and_its_match() {
        // As selections do, with the rounding of β: a q that equals it is not kept.
        let (q, w) = ([0.8, 0.95], [-2.0, -1.0]);
        let episode = WholeEpisode {
            id: "ep_1",
            file_name: "a.mcap",
            outcome: "failure",
            cohort: "",
            run: "run_1",
            beta: 0.8,
            q: &q,
            w: &w,
        };
        let kept = episode.kept(|at| (at == 1).then(|| ("ep_2".to_owned(), 9)));
        let expected = [
            StepScore { q: 0.8, w: -2.0, kept: false, matched: None },
            StepScore { q: 0.95, w: -1.0, kept: true, matched: Some(("ep_2".into(), 9)) },
        ];
        assert_eq!((kept.first_step, kept.scores), (0, expected.to_vec()));
        assert_eq!((kept.about["beta"].as_str(), kept.about["run"].as_str()), ("0.8", "run_1"));
    }

    #[test]
    fn scores_are_exact_as_json() {
        let scores: Vec<StepScore> = (1..2000_u32)
            .map(|at| StepScore { q: 1.0 / at as f32, w: -1.0 / f64::from(at), kept: true, matched: None })
            .collect();
        let kept = Kept { first_step: 3, scores, about: BTreeMap::new() };
        let json = serde_json::to_vec(&kept).unwrap();
        assert_eq!(serde_json::from_slice::<Kept>(&json).unwrap(), kept);
    }
}
