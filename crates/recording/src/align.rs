//! Time alignment: which message of each stream belongs to which step.
//!
//! Pure numbers: stamps in, indices out. All stamps are nanoseconds.

use gleaner_core::{Alignment, TaskSpec};

/// The messages of a stream in the order of their stamps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Timeline {
    /// Ascending.
    pub(crate) stamps: Vec<i64>,
    /// Index of each in the stream's own order.
    pub(crate) order: Vec<usize>,
    /// First message whose stamp lies before the one before it.
    pub(crate) first_reversed: Option<usize>,
}

/// The choice of a step's message in a stream.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    pub(crate) period: i64,
    tolerance: i64,
    alignment: Alignment,
}

impl Timeline {
    pub(crate) fn new(stamps: impl IntoIterator<Item = i64>) -> Self {
        let stamps: Vec<i64> = stamps.into_iter().collect();
        let first_reversed = stamps.windows(2).position(|pair| pair[1] < pair[0]).map(|at| at + 1);
        let mut order: Vec<usize> = (0..stamps.len()).collect();
        order.sort_by_key(|&at| stamps[at]);
        Self { stamps: order.iter().map(|&at| stamps[at]).collect(), order, first_reversed }
    }

    /// Positions of the clock's messages that become steps: each stamp once, and, when they come faster
    /// than 1.5 × the rate, those nearest to an even grid of the rate.
    pub(crate) fn ticks(&self, rule: Rule) -> Vec<usize> {
        let mut positions: Vec<usize> = (0..self.stamps.len()).collect();
        positions.dedup_by_key(|at| self.stamps[*at]);
        let interval = self.median_interval(&positions);
        if positions.len() < 3 || interval.saturating_mul(3) >= rule.period.saturating_mul(2) {
            return positions;
        }
        let mut due = i64::MIN;
        positions.retain(|&at| {
            let stamp = self.stamps[at];
            if stamp.saturating_add(interval / 2) < due {
                return false;
            }
            // After a gap the grid starts again.
            let next = due.saturating_add(rule.period);
            due = if next <= stamp { stamp.saturating_add(rule.period) } else { next };
            true
        });
        positions
    }

    /// Median distance of neighbours among these positions; 0 with fewer than two.
    pub(crate) fn median_interval(&self, positions: &[usize]) -> i64 {
        let mut intervals: Vec<i64> =
            positions.windows(2).map(|pair| self.stamps[pair[1]].saturating_sub(self.stamps[pair[0]])).collect();
        intervals.sort_unstable();
        intervals.get(intervals.len() / 2).copied().unwrap_or_default()
    }
}

impl Rule {
    pub(crate) fn new(spec: &TaskSpec) -> Self {
        let period = 1e9 / spec.rate_hz;
        #[expect(clippy::cast_possible_truncation, reason = "the rate is at least 0.01 Hz, a period of 1e11 ns")]
        let (period, tolerance) = (period.round() as i64, (period * spec.tolerance).round() as i64);
        Self { period, tolerance, alignment: spec.alignment }
    }

    /// Position in the timeline of the message that a step at `stamp` sees; `None` before the first.
    ///
    /// Nothing later than the tolerance after the step counts. Latest-before takes a message after the step
    /// only in place of one from the tick before, that is, older than a period less the tolerance: the
    /// streams of one tick are stamped in any order, but a message that a faster stream sent after the step
    /// is the future.
    pub(crate) fn pick(self, timeline: &Timeline, stamp: i64) -> Option<usize> {
        let stamps = &timeline.stamps;
        let last = stamps.partition_point(|&at| at <= stamp.saturating_add(self.tolerance)).checked_sub(1)?;
        let before = stamps.partition_point(|&at| at <= stamp).checked_sub(1);
        let Some(before) = before else {
            return Some(0);
        };
        let first_after = (before + 1).min(last);
        let (age, ahead) = (stamp.saturating_sub(stamps[before]), stamps[first_after].saturating_sub(stamp));
        Some(match self.alignment {
            Alignment::LatestBefore if age <= self.period - self.tolerance => before,
            Alignment::Nearest if ahead <= 0 || age <= ahead => before,
            Alignment::LatestBefore | Alignment::Nearest => first_after,
        })
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::testing::arm;

    const MS: i64 = 1_000_000;

    fn rule(alignment: Alignment) -> Rule {
        // A period of 100 ms and a tolerance of 25 ms.
        Rule::new(&TaskSpec { alignment, ..arm() })
    }

    fn timeline(milliseconds: &[i64]) -> Timeline {
        Timeline::new(milliseconds.iter().map(|ms| ms * MS))
    }

    fn picks(alignment: Alignment, stream: &[i64], steps: &[i64]) -> Vec<Option<i64>> {
        let timeline = timeline(stream);
        let pick = |step: &i64| rule(alignment).pick(&timeline, step * MS).map(|at| timeline.stamps[at] / MS);
        steps.iter().map(pick).collect()
    }

    #[test]
    fn streams_of_one_tick_form_one_step_in_any_order() {
        let steps = [0, 100, 200];
        for alignment in [Alignment::LatestBefore, Alignment::Nearest] {
            let early = picks(alignment, &[-9, 92, 188], &steps);
            assert_eq!(early, [Some(-9), Some(92), Some(188)]);
            let late = picks(alignment, &[4, 109, 201], &steps);
            assert_eq!(late, [Some(4), Some(109), Some(201)]);
            let mixed = picks(alignment, &[4, 95, 210], &steps);
            assert_eq!(mixed, [Some(4), Some(95), Some(210)]);
        }
    }

    #[test]
    fn faster_stream_gives_no_later_message() {
        assert_eq!(picks(Alignment::LatestBefore, &[70, 90, 110], &[100]), [Some(90)]);
        assert_eq!(picks(Alignment::Nearest, &[70, 91, 102], &[100]), [Some(102)]);
        assert_eq!(picks(Alignment::Nearest, &[97, 103], &[100]), [Some(97)]);
    }

    #[test]
    fn slower_stream_is_held_up_to_the_tolerance() {
        assert_eq!(
            picks(Alignment::LatestBefore, &[0, 300], &[100, 200, 270, 280]),
            [Some(0), Some(0), Some(0), Some(300)]
        );
        assert_eq!(picks(Alignment::LatestBefore, &[126], &[100, 200]), [None, Some(126)]);
        assert_eq!(picks(Alignment::Nearest, &[10, 126], &[100]), [Some(10)]);
        assert_eq!(picks(Alignment::LatestBefore, &[], &[100]), [None]);
    }

    #[test]
    fn fast_clock_is_thinned_to_an_even_grid() {
        let rule = rule(Alignment::LatestBefore);
        let ticks = |clock: &[i64]| {
            let timeline = timeline(clock);
            timeline.ticks(rule).into_iter().map(|at| timeline.stamps[at] / MS).collect::<Vec<_>>()
        };
        let fast: Vec<i64> = (0..=20).map(|i| i * 20).collect();
        assert_eq!(ticks(&fast), [0, 100, 200, 300, 400]);
        let odd: Vec<i64> = (0..=10).map(|i| i * 40).collect();
        assert_eq!(ticks(&odd), [0, 80, 200, 280, 400]);
        let slightly_fast: Vec<i64> = (0..5).map(|i| i * 70).collect();
        assert_eq!(ticks(&slightly_fast), slightly_fast);
        assert_eq!(ticks(&[0, 100, 100, 200]), [0, 100, 200]);
    }

    #[test]
    fn reversed_stamps_are_sorted_and_counted() {
        let timeline = timeline(&[0, 20, 10, 30]);
        assert_eq!((timeline.order, timeline.first_reversed), (vec![0, 2, 1, 3], Some(2)));
    }

    #[test]
    fn extreme_stamps_do_not_overflow() {
        let timeline = Timeline::new([i64::MIN, 0, i64::MAX]);
        let rule = rule(Alignment::Nearest);
        assert_eq!(timeline.ticks(rule).len(), 3);
        assert_eq!(rule.pick(&timeline, i64::MAX), Some(2));
        assert_eq!(rule.pick(&timeline, i64::MIN), Some(0));
    }
}
