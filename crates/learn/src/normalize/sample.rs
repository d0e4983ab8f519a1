//! The steps over which statistics are measured. A pass reads one episode after the other and keeps none.

use std::borrow::Cow;
use std::ops::Range;
use std::panic::resume_unwind;
use std::thread::{Builder, scope};

use crate::batch::{Segments, allowed, spread};
use crate::error::LearnError;
use crate::shape::TaskShape;
use crate::steps::Numbers;
use crate::trajectory::Trajectory;

/// Steps whose numbers are read at once, and are in memory together; or one longer episode.
const AT_ONCE: usize = 1 << 16;
/// Threads that read them: where the files are not in memory, most of their time they wait for the disk.
const READING: usize = 8;

/// Steps of episodes.
pub(crate) struct Sample<'a> {
    sources: Vec<(Vec<&'a Trajectory>, Cow<'a, Segments>)>,
}

impl<'a> Sample<'a> {
    /// Every step of every episode.
    pub(crate) fn every(data: &[&'a Trajectory]) -> Self {
        Self { sources: vec![(data.to_vec(), Cow::Owned(Segments::every(data)))] }
    }

    /// The newest steps of the segments of each source, so that a rejected step has no influence.
    pub(crate) fn of_segments(sources: &[(&[&'a Trajectory], &'a Segments)]) -> Self {
        let each = sources.iter().map(|(data, segments)| (data.to_vec(), Cow::Borrowed(*segments)));
        Self { sources: each.collect() }
    }

    /// An even part of the sample: at most `most` steps.
    pub(super) fn some_steps(&self, most: usize) -> Vec<(&'a Trajectory, usize)> {
        let count: usize = self.sources.iter().map(|(_, segments)| segments.count()).sum();
        let (mut places, mut begin, mut steps) = (spread(count, most).peekable(), 0, Vec::new());
        for (data, segments) in &self.sources {
            let end = begin + segments.count();
            while let Some(place) = places.next_if(|place| *place < end) {
                let segment = segments.at(place - begin);
                steps.push((data[segment.trajectory], segment.step));
            }
            begin = end;
        }
        steps
    }

    /// Calls `visit` with the proprioception and the action of every step, in the same order each time. An action is the
    /// one that a robot of this shape executes, which batches and sessions have too.
    ///
    /// # Errors
    /// [`LearnError::Steps`].
    pub(crate) fn each(&self, shape: &TaskShape, visit: &mut dyn FnMut(&[f32], &[f32])) -> Result<(), LearnError> {
        for (data, segments) in &self.sources {
            let listed = data.iter().enumerate().filter_map(|(at, episode)| {
                let (first, last) = (segments.steps(at).next()?, segments.steps(at).next_back()?);
                Some(Part { at, episode, steps: first..last + 1 })
            });
            let (mut parts, mut steps) = (Vec::new(), 0);
            for part in listed {
                if steps + part.steps.len() > AT_ONCE {
                    visit_all(shape, (&std::mem::take(&mut parts), segments), visit)?;
                    steps = 0;
                }
                steps += part.steps.len();
                parts.push(part);
            }
            visit_all(shape, (&parts, segments), visit)?;
        }
        Ok(())
    }
}

/// The steps of one episode from the first to the last of the sample.
struct Part<'a> {
    at: usize,
    episode: &'a Trajectory,
    steps: Range<usize>,
}

/// Visits the steps of these parts that the segments have, in order.
fn visit_all(
    shape: &TaskShape,
    (parts, segments): (&[Part<'_>], &Segments),
    visit: &mut dyn FnMut(&[f32], &[f32]),
) -> Result<(), LearnError> {
    for (part, numbers) in parts.iter().zip(read_all(parts)?) {
        let Numbers { proprioception, mut action } = numbers?;
        allowed(shape, &mut action);
        let (m, a) = (proprioception.len() / part.steps.len(), action.len() / part.steps.len());
        for step in segments.steps(part.at).map(|step| step - part.steps.start) {
            visit(&proprioception[step * m..(step + 1) * m], &action[step * a..(step + 1) * a]);
        }
    }
    Ok(())
}

/// The numbers of each part, read on several threads, which have no effect on a value.
fn read_all(parts: &[Part<'_>]) -> Result<Vec<Result<Numbers, LearnError>>, LearnError> {
    let read =
        |parts: &[Part<'_>]| -> Vec<_> { parts.iter().map(|part| part.episode.numbers(part.steps.clone())).collect() };
    if parts.len() < READING {
        return Ok(read(parts));
    }
    scope(|scope| {
        let begin = |parts| Builder::new().name("numbers".to_owned()).spawn_scoped(scope, move || read(parts));
        let running = parts.chunks(parts.len().div_ceil(READING)).map(begin);
        let running = running.collect::<Result<Vec<_>, _>>().map_err(LearnError::Thread)?;
        Ok(running.into_iter().flat_map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic))).collect())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    #[test]
    fn steps_are_visited_in_order_however_many_threads_read_them() {
        let data = toy::experts(24, 5);
        assert!(data.len() > READING);
        let listed: Vec<&Trajectory> = data.iter().collect();
        let mut found = Vec::new();
        Sample::every(&listed).each(&toy::shape(), &mut |m, a| found.push([m, a].concat())).unwrap();
        let expected = data.iter().flat_map(|episode| {
            let arrays = episode.arrays();
            let (m, a) = (arrays.widths.proprioception, arrays.widths.action);
            let steps = arrays.proprioception.chunks(m).zip(arrays.action.chunks(a));
            steps.map(|(m, a)| [m, a].concat()).collect::<Vec<_>>()
        });
        assert_eq!(found, expected.collect::<Vec<_>>());
    }

    /// Every fifth step of eight episodes of five steps would be the first step of each.
    #[test]
    fn an_even_part_of_two_sources_has_every_part_of_episodes_of_one_length() {
        let data = toy::experts(8, 5);
        let (ours, theirs): (Vec<&Trajectory>, Vec<&Trajectory>) =
            (data[..3].iter().collect(), data[3..].iter().collect());
        let segments = [&ours, &theirs].map(|data| Segments::every(data));
        let sample = Sample::of_segments(&[(&ours, &segments[0]), (&theirs, &segments[1])]);
        let found = sample.some_steps(8);
        let ids: Vec<&str> = found.iter().map(|(episode, _)| episode.id.as_str()).collect();
        assert_eq!(ids, data.iter().map(|episode| episode.id.as_str()).collect::<Vec<_>>());
        let steps: std::collections::BTreeSet<usize> = found.iter().map(|(_, step)| *step).collect();
        assert_eq!(steps, (0..5).collect());
        assert_eq!(sample.some_steps(100).len(), 40);
    }
}
