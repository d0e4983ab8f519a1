//! The distribution of q in a run, and what thresholds keep of it: filled episode by episode.

use std::collections::BTreeMap;

use crate::selection::Filter;

/// The counts of segments and episodes that one threshold keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeptCount {
    /// The threshold; q > β is kept.
    pub beta: f64,
    /// Imperfect segments kept.
    pub segments: u64,
    /// Imperfect episodes that contribute at least one.
    pub episodes: u64,
    /// Expert segments whose q is above the threshold too.
    pub expert_segments: u64,
}

/// The distributions of q over a run's imperfect segments and over its experts' own, and the counts kept by thresholds:
/// filled episode by episode in one pass.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    counts: Vec<u64>,
    expert_counts: Vec<u64>,
    /// As `counts`, of each cohort of imperfect episodes.
    cohorts: BTreeMap<String, Vec<u64>>,
    segments: u64,
    /// Thresholds from low to high, each with its index in the caller's order.
    ordered: Vec<(f64, usize)>,
    /// At index n, the segments that exactly the first n of `ordered` keep.
    kept_segments: Vec<u64>,
    /// At index n, the episodes whose best segment exactly the first n of `ordered` keep.
    kept_episodes: Vec<u64>,
    /// At index n, the expert segments that exactly the first n of `ordered` would keep.
    kept_experts: Vec<u64>,
}

impl Histogram {
    /// An empty histogram of `bins` equal bins over [0, 1] (at least one), with these thresholds.
    pub fn new(bins: usize, betas: &[f64]) -> Self {
        let mut ordered: Vec<_> = betas.iter().copied().zip(0..).collect();
        ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            counts: vec![0; bins.max(1)],
            expert_counts: vec![0; bins.max(1)],
            cohorts: BTreeMap::new(),
            segments: 0,
            ordered,
            kept_segments: vec![0; betas.len() + 1],
            kept_episodes: vec![0; betas.len() + 1],
            kept_experts: vec![0; betas.len() + 1],
        }
    }

    /// Adds the q of one imperfect episode of a cohort.
    pub fn add(&mut self, cohort: &str, q: impl Iterator<Item = f32>) {
        let bins = self.counts.len();
        // Looked up once an episode, because a run has millions of segments.
        let known = self.cohorts.get_mut(cohort).map(std::mem::take);
        let mut of_cohort = known.unwrap_or_else(|| vec![0; bins]);
        let (mut best, mut any) = (f32::NEG_INFINITY, false);
        for q in q {
            let place = bin(q, bins);
            self.counts[place] += 1;
            of_cohort[place] += 1;
            self.segments += 1;
            let keeping = self.keeping(q);
            self.kept_segments[keeping] += 1;
            (best, any) = (best.max(q), true);
        }
        if any {
            let keeping = self.keeping(best);
            self.kept_episodes[keeping] += 1;
        }
        match self.cohorts.get_mut(cohort) {
            Some(counts) => *counts = of_cohort,
            None => {
                self.cohorts.insert(cohort.to_owned(), of_cohort);
            }
        }
    }

    /// Adds one expert's q.
    pub fn add_expert(&mut self, q: impl Iterator<Item = f32>) {
        for q in q {
            let place = bin(q, self.expert_counts.len());
            self.expert_counts[place] += 1;
            let keeping = self.keeping(q);
            self.kept_experts[keeping] += 1;
        }
    }

    /// Imperfect segments in each bin; the last bin includes q = 1.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Expert segments in each bin, as [`Histogram::counts`].
    pub fn expert_counts(&self) -> &[u64] {
        &self.expert_counts
    }

    /// Imperfect segments in each bin of the largest cohorts, at most this many, by name.
    pub fn cohorts(&self, most: usize) -> Vec<(&str, &[u64])> {
        let mut cohorts: Vec<_> =
            self.cohorts.iter().map(|(cohort, counts)| (cohort.as_str(), counts.as_slice())).collect();
        if cohorts.len() > most {
            cohorts.sort_by_key(|(_, counts)| std::cmp::Reverse(counts.iter().sum::<u64>()));
            cohorts.truncate(most);
            cohorts.sort_by_key(|(cohort, _)| *cohort);
        }
        cohorts
    }

    /// Number of imperfect segments.
    pub fn segments(&self) -> u64 {
        self.segments
    }

    /// The counts kept by each threshold, in the caller's order.
    pub fn kept(&self) -> Vec<KeptCount> {
        let none = KeptCount { beta: 0.0, segments: 0, episodes: 0, expert_segments: 0 };
        let mut kept = vec![none; self.ordered.len()];
        let (mut segments, mut episodes, mut expert_segments) = (0, 0, 0);
        for (rank, &(beta, place)) in self.ordered.iter().enumerate().rev() {
            segments += self.kept_segments[rank + 1];
            episodes += self.kept_episodes[rank + 1];
            expert_segments += self.kept_experts[rank + 1];
            kept[place] = KeptCount { beta, segments, episodes, expert_segments };
        }
        kept
    }

    /// The number of ordered thresholds that keep this q: those below it, which come first.
    fn keeping(&self, q: f32) -> usize {
        self.ordered.partition_point(|&(beta, _)| Filter::Above(beta).keeps(0.0, q))
    }
}

/// The bin of q among `bins` equal ones.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a float cast saturates; then clamped")]
fn bin(q: f32, bins: usize) -> usize {
    #[expect(clippy::cast_precision_loss, reason = "at most 1000 bins")]
    let place = q * bins as f32;
    (place as usize).min(bins - 1)
}

/// The highest bar is cut off above this many times the height that nine of ten bars do not reach, and shows this many of it.
const FAR: f64 = 8.0;
const ROOM: f64 = 4.0;

/// The height above which a picture cuts off bars, because the others could not be seen beside them: a calibrated q has most
/// segments at 0. `None` where the highest are not far above most.
#[must_use]
pub fn legible_height(heights: &[f64]) -> Option<f64> {
    let mut sorted = heights.to_vec();
    sorted.sort_by(f64::total_cmp);
    let usual = *sorted.get(sorted.len() * 9 / 10)?;
    (usual > 0.0 && *sorted.last()? > FAR * usual).then_some(ROOM * usual)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experts_have_counts_of_their_own() {
        let mut histogram = Histogram::new(4, &[0.5]);
        histogram.add("late", [0.1].into_iter());
        histogram.add_expert([0.1, 0.9, 1.0].into_iter());
        assert_eq!((histogram.counts(), histogram.expert_counts()), (&[1, 0, 0, 0][..], &[1, 0, 0, 2][..]));
        let kept = histogram.kept()[0];
        assert_eq!((histogram.segments(), kept.segments, kept.expert_segments), (1, 0, 2));
    }

    #[test]
    fn counts_what_each_threshold_keeps_strictly() {
        // A threshold without an exact binary form, met exactly: 0.6 as f32 lies above 0.6 as f64.
        let mut histogram = Histogram::new(4, &[0.9, 0.0, 0.6, 1.0, 0.6]);
        histogram.add("wrong", [0.0, 0.6, 0.25, 1.0].into_iter());
        histogram.add("late", [0.6, 0.1].into_iter());
        histogram.add("wrong", [0.95].into_iter());
        histogram.add("none", std::iter::empty());

        assert_eq!(histogram.segments(), 7);
        assert_eq!(histogram.counts(), [2, 1, 2, 2]);
        let [late, none, wrong] =
            [("late", &[1, 0, 1, 0][..]), ("none", &[0, 0, 0, 0][..]), ("wrong", &[1, 1, 1, 2][..])];
        assert_eq!(histogram.cohorts(3), [late, none, wrong]);
        assert_eq!(histogram.cohorts(2), [late, wrong]);
        assert_eq!(histogram.cohorts(1), [wrong]);
        let kept: Vec<_> = histogram.kept().iter().map(|k| (k.beta, k.segments, k.episodes)).collect();
        assert_eq!(kept, [(0.9, 2, 2), (0.0, 6, 3), (0.6, 2, 2), (1.0, 0, 0), (0.6, 2, 2)]);
    }

    #[test]
    fn agrees_with_counting_one_by_one() {
        let q: Vec<f32> = (0u16..1000).map(|i| f32::from(i * 37 % 1000) / 999.0).collect();
        let betas = [0.5, 0.7, 0.8, 0.9, 0.95];
        let mut histogram = Histogram::new(20, &betas);
        for episode in q.chunks(10) {
            histogram.add("", episode.iter().copied());
        }
        for (kept, beta) in histogram.kept().iter().zip(betas) {
            let segments = q.iter().filter(|&&q| Filter::Above(beta).keeps(0.0, q)).count();
            let episodes =
                q.chunks(10).filter(|episode| episode.iter().any(|&q| Filter::Above(beta).keeps(0.0, q))).count();
            assert_eq!((kept.segments, kept.episodes), (segments as u64, episodes as u64));
        }
        assert_eq!(histogram.counts().iter().sum::<u64>(), 1000);
    }

    #[test]
    fn the_highest_bars_are_cut_off_where_they_would_hide_the_others() {
        let bars = |highest: f64| [vec![3.0; 19], vec![highest]].concat();
        assert_eq!((legible_height(&bars(24.0)), legible_height(&bars(25.0))), (None, Some(12.0)));
        assert_eq!((legible_height(&[]), legible_height(&[0.0, 0.0, 9.0])), (None, None));
    }
}
