//! Phases: equal parts of a task, and the limit of the kept segments of each. Must not depend on the rule.

use super::{Candidate, Ranked, SelectionShape};

/// The place in the task of each segment of an episode, as a part of 2³²: the end step of its nearest expert segment out
/// of that expert's length. `lengths` has the steps of each expert by its index; without matches the result is empty.
///
/// `None` when a match names an expert without a length.
pub fn places(match_episode: &[u32], match_step: &[u32], lengths: &[u64]) -> Option<Vec<u32>> {
    let length = |expert: u32| lengths.get(usize::try_from(expert).ok()?);
    let place = |(&expert, &step): (&u32, &u32)| Some(place(step.into(), *length(expert)?));
    match_episode.iter().zip(match_step).map(place).collect()
}

/// ⌈2³² · step / length⌉. Rounded up, so that [`phase`] is exactly ⌊phases · step / length⌋ for episodes of less than four
/// million steps.
fn place(step: u64, length: u64) -> u32 {
    u32::try_from((step << 32).div_ceil(length.max(1))).unwrap_or(u32::MAX)
}

/// The phase of a place, less than `phases`.
fn phase(place: u32, phases: u32) -> usize {
    usize::try_from((u64::from(place) * u64::from(phases)) >> 32).unwrap_or(usize::MAX)
}

/// The segments of one phase: at most twice as many as are kept at any time, and all of them counted.
#[derive(Debug, Clone)]
struct Best<'a> {
    most: usize,
    found: Vec<Ranked<'a>>,
    seen: usize,
    /// The last of the best so far: a segment behind it is beyond the limit.
    bound: Option<Ranked<'a>>,
}

impl<'a> Best<'a> {
    fn add(&mut self, segment: Ranked<'a>) {
        self.seen += 1;
        if self.bound.is_some_and(|bound| segment.order(&bound).is_gt()) {
            return;
        }
        self.found.push(segment);
        if self.found.len() >= self.most.saturating_mul(2) {
            self.bound = Some(self.worst());
            self.found.truncate(self.most);
        }
    }

    /// The last of the `most` best segments, which are then the first ones.
    fn worst(&mut self) -> Ranked<'a> {
        *self.found.select_nth_unstable_by(self.most - 1, Ranked::order).1
    }

    /// The last segment that is kept; `None` when all are.
    fn cut(mut self) -> Option<Ranked<'a>> {
        (self.seen > self.most).then(|| self.worst())
    }
}

/// The last segment that each phase keeps; `None` for a phase within the limit.
#[derive(Debug)]
pub(super) struct Cuts<'a> {
    last: Vec<Option<Ranked<'a>>>,
    phases: u32,
}

impl<'a> Cuts<'a> {
    /// The cuts of a shape that limits phases, given all episodes, whose kept segments `mark` sets.
    pub(super) fn new(
        shape: &SelectionShape,
        candidates: &'a [Candidate],
        mark: impl Fn(&Candidate, &mut Vec<bool>),
    ) -> Self {
        let (phases, mut kept) = (shape.phases, Vec::new());
        let most = usize::try_from(shape.max_per_phase).unwrap_or(usize::MAX).max(1);
        let mut best: Vec<Best<'a>> =
            (0..phases).map(|_| Best { most, found: Vec::new(), seen: 0, bound: None }).collect();
        for candidate in candidates {
            mark(candidate, &mut kept);
            for step in (0..kept.len()).filter(|&step| kept[step]) {
                if let Some(best) = best.get_mut(candidate.phase(step, phases)) {
                    best.add(candidate.ranked(step));
                }
            }
        }
        Self { last: best.into_iter().map(Best::cut).collect(), phases }
    }

    /// Drops the segments of an episode beyond the cuts.
    pub(super) fn apply(&self, candidate: &Candidate, kept: &mut [bool]) {
        for (step, kept) in kept.iter_mut().enumerate().filter(|(_, kept)| **kept) {
            let last = self.last.get(candidate.phase(step, self.phases)).and_then(Option::as_ref);
            *kept = last.is_none_or(|last| candidate.ranked(step).order(last).is_le());
        }
    }
}

impl Candidate {
    /// The phase of a segment: that of its place in the task, or else in its own episode.
    fn phase(&self, end_step: usize, phases: u32) -> usize {
        let own = || place(end_step as u64, self.q.len() as u64);
        phase(self.places.get(end_step).copied().unwrap_or_else(own), phases)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_are_exact_parts_of_an_episode() {
        for length in (1..200).chain([9_999, 1_000_000, 4_000_000]) {
            for phases in [1, 2, 3, 7, 10, 29, 100, 1000] {
                for step in (0..length).step_by(1 + usize::try_from(length / 64).unwrap()).chain([length - 1]) {
                    let expected = usize::try_from(step * u64::from(phases) / length).unwrap();
                    assert_eq!(phase(place(step, length), phases), expected, "{step} of {length} in {phases}");
                }
            }
        }
        assert_eq!((phase(place(9, 9), 10), phase(place(3, 0), 10)), (9, 9), "beyond the end is the last phase");
    }

    #[test]
    fn a_match_without_a_length_has_no_place() {
        assert_eq!(places(&[0, 2], &[1, 1], &[4, 4]), None);
        assert_eq!(places(&[0, 1], &[1, 3], &[4, 4]), Some(vec![1 << 30, 3 << 30]));
        assert_eq!(places(&[], &[], &[4]), Some(Vec::new()));
    }
}
