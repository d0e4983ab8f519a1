//! The episodes of a snapshot as a comparison sees them: their marks, outcomes and lengths.
//!
//! Must not depend on a server.

use std::collections::BTreeMap;

use gleaner_core::statistics::quantile_bins;

use super::report::LengthBin;
use crate::quality::Mark;

/// One episode of the snapshot.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Known {
    pub(super) id: String,
    pub(super) cohort: String,
    /// The outcome's word.
    pub(super) outcome: String,
    pub(super) steps: u64,
    /// `None` without a mark; a mark may state that the episode never went wrong.
    pub(super) mark: Option<Mark>,
}

impl Known {
    pub(super) fn succeeded(&self) -> bool {
        self.outcome == "success"
    }
}

/// The episodes of a snapshot.
#[derive(Clone, Debug)]
pub(super) struct Episodes {
    /// The imperfect episodes, those with a mark first.
    pub(super) imperfect: Vec<Known>,
    pub(super) experts: Vec<Known>,
    /// The number of marked episodes.
    pub(super) marked: usize,
    /// The stratum of equal length of each imperfect episode.
    pub(super) bins: Vec<usize>,
}

impl Episodes {
    /// With the imperfect episodes in up to `bins` strata of about equally many.
    pub(super) fn new(mut imperfect: Vec<Known>, experts: Vec<Known>, bins: usize) -> Self {
        imperfect.sort_by_key(|episode| episode.mark.is_none());
        let marked = imperfect.iter().filter(|episode| episode.mark.is_some()).count();
        let lengths: Vec<u64> = imperfect.iter().map(|episode| episode.steps).collect();
        Self { bins: quantile_bins(&lengths, bins), imperfect, experts, marked }
    }

    /// The number of imperfect episodes with each outcome.
    pub(super) fn outcomes(&self) -> BTreeMap<String, usize> {
        let mut outcomes = BTreeMap::new();
        for episode in &self.imperfect {
            *outcomes.entry(episode.outcome.clone()).or_default() += 1;
        }
        outcomes
    }

    /// The strata.
    pub(super) fn length_bins(&self) -> Vec<LengthBin> {
        let mut found: Vec<LengthBin> = Vec::new();
        let last = self.bins.iter().max().map_or(0, |last| last + 1);
        for bin in 0..last {
            let of_bin = self.imperfect.iter().zip(&self.bins).filter(|(_, of)| **of == bin);
            let steps: Vec<u64> = of_bin.map(|(episode, _)| episode.steps).collect();
            let (from, to) = (steps.iter().min().copied(), steps.iter().max().copied());
            found.extend(from.zip(to).map(|(from, to)| LengthBin { from, to, episodes: steps.len() }));
        }
        found
    }

    /// Values of the imperfect episodes in the strata.
    pub(super) fn in_strata<T>(&self, values: impl IntoIterator<Item = (usize, T)>) -> Vec<Vec<T>> {
        let mut strata: Vec<Vec<T>> = Vec::new();
        strata.resize_with(self.bins.iter().max().map_or(0, |last| last + 1), Vec::new);
        for (place, value) in values {
            strata[self.bins[place]].push(value);
        }
        strata
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marked_episodes_come_first_and_lengths_fill_bins() {
        let known = |id: &str, steps, mark| Known {
            id: id.into(),
            cohort: "freeze".into(),
            outcome: "failure".into(),
            steps,
            mark,
        };
        let mark = Some(Mark { went_right: None, went_wrong: Some(1) });
        let imperfect = vec![known("a", 60, None), known("b", 20, mark), known("c", 60, mark), known("d", 30, None)];
        let episodes = Episodes::new(imperfect, Vec::new(), 2);
        let ids: Vec<&str> = episodes.imperfect.iter().map(|episode| episode.id.as_str()).collect();
        assert_eq!((ids, episodes.marked), (vec!["b", "c", "a", "d"], 2));
        assert_eq!(episodes.bins, [0, 1, 1, 0]);
        let bin = |from, to| LengthBin { from, to, episodes: 2 };
        assert_eq!(episodes.length_bins(), [bin(20, 30), bin(60, 60)]);
        assert_eq!(episodes.in_strata([(0, 'b'), (2, 'a'), (3, 'd')]), [vec!['b', 'd'], vec!['a']]);
    }
}
