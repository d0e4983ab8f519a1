//! The values of one metric that a plot shows: those of a few stretches of equal length, each by its extremes. Must not
//! depend on rows.

use crate::domain::job::Metric;

/// The values of one metric, which arrive one by one, reduced to few.
pub(super) struct Plotted {
    /// The most stretches.
    most: usize,
    /// Values in each stretch but the last.
    length: usize,
    /// Values in the last stretch.
    filled: usize,
    first: Metric,
    newest: Metric,
    stretches: Vec<Stretch>,
}

/// Neighbouring values by the two that matter.
struct Stretch {
    /// The lowest; of equal ones the first.
    low: Metric,
    /// The highest; of equal ones the last. So two values are both kept.
    high: Metric,
}

impl Stretch {
    /// The stretch of this one and the next.
    fn with(&mut self, next: Self) {
        if next.low.value < self.low.value {
            self.low = next.low;
        }
        if next.high.value >= self.high.value {
            self.high = next.high;
        }
    }
}

impl Plotted {
    /// Of a first value, for about this many values.
    pub(super) fn new(points: u32, first: Metric) -> Self {
        let most = usize::try_from(points / 2).unwrap_or(usize::MAX).max(1);
        let stretch = Stretch { low: first.clone(), high: first.clone() };
        Self { most, length: 1, filled: 1, newest: first.clone(), first, stretches: vec![stretch] }
    }

    /// Adds the next value.
    pub(super) fn add(&mut self, metric: Metric) {
        self.newest = metric.clone();
        let next = Stretch { low: metric.clone(), high: metric };
        if self.filled == self.length && self.stretches.len() == self.most {
            self.halve();
        }
        match self.stretches.last_mut() {
            Some(last) if self.filled < self.length => {
                last.with(next);
                self.filled += 1;
            }
            Some(_) | None => {
                self.stretches.push(next);
                self.filled = 1;
            }
        }
    }

    /// Joins each two full stretches to one.
    fn halve(&mut self) {
        let odd = self.stretches.len() % 2 == 1;
        let mut all = std::mem::take(&mut self.stretches).into_iter();
        while let Some(mut stretch) = all.next() {
            all.next().into_iter().for_each(|next| stretch.with(next));
            self.stretches.push(stretch);
        }
        self.filled = if odd { self.length } else { 2 * self.length };
        self.length *= 2;
    }

    /// The first value, the newest, and the extremes of each stretch; a value that is several of these comes once.
    pub(super) fn metrics(self) -> impl Iterator<Item = Metric> {
        let Self { first, newest, stretches, .. } = self;
        let extremes = stretches.into_iter().flat_map(|Stretch { low, high }| [low, high]);
        let mut all: Vec<Metric> = [first, newest].into_iter().chain(extremes).collect();
        all.sort_by_key(|metric| metric.sequence);
        all.dedup_by_key(|metric| metric.sequence);
        all.into_iter()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn kept(points: u32, values: &[f64]) -> Vec<Metric> {
        let metric = |(sequence, &value)| Metric { sequence, step: 0, name: "loss".into(), value };
        let mut metrics = (0..).zip(values).map(metric);
        let mut plotted = Plotted::new(points, metrics.next().unwrap());
        metrics.for_each(|metric| plotted.add(metric));
        plotted.metrics().collect()
    }

    #[test]
    fn a_spike_is_kept_wherever_it_is() {
        for spike in (0..1000).step_by(7) {
            for height in [9.0, -9.0] {
                let mut values = vec![0.5; 1000];
                values[spike] = height;
                let kept = kept(20, &values);
                assert!(kept.iter().any(|metric| metric.value == height), "{height} at {spike}");
                assert!(kept.len() <= 22, "{}", kept.len());
            }
        }
    }

    proptest! {
        #[test]
        fn few_values_are_all_kept_and_many_leave_their_ends_and_extremes(
            values in proptest::collection::vec((0..5_u8).prop_map(f64::from), 1..300),
            points in 0..40_u32,
        ) {
            let kept = kept(points, &values);
            let (few, last) = (usize::try_from(points).unwrap(), i64::try_from(values.len()).unwrap() - 1);
            prop_assert!(kept.is_sorted_by(|one, next| one.sequence < next.sequence));
            prop_assert!(kept.len() <= few.max(2) + 2, "{}", kept.len());
            prop_assert!(values.len() > few / 2 * 2 || kept.len() == values.len());
            prop_assert_eq!((kept[0].sequence, kept[kept.len() - 1].sequence), (0, last));
            let range = |values: &mut dyn Iterator<Item = f64>| {
                values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)))
            };
            let all = range(&mut values.iter().copied());
            prop_assert_eq!(range(&mut kept.iter().map(|metric| metric.value)), all);
        }
    }
}
