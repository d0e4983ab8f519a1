//! The second pass over a recording: the pixels of the images that the steps use.
//!
//! Each image is decoded once, in the order of the file, and handed on at once: memory holds one picture a stream.

use std::collections::HashMap;
use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::dialect::Value;
use crate::error::RecordingError;
use crate::inspect;
use crate::limits::Limits;
use crate::picture;
use crate::plan::Plan;
use gleaner_core::TaskSpec;
use gleaner_core::{FindingCode, Severity};

/// Receives the next picture of a stream, by the stream's number in the plan.
pub(crate) type Keep<'a> = &'a mut dyn FnMut(usize, &[u8]) -> Result<(), RecordingError>;

/// Decodes the images of all steps; those that can't be decoded become findings. Hands on each picture that differs from
/// the one before it in its stream, and returns for each stream and step the number of its picture, from 1 on: 0 for a
/// step whose image is broken.
///
/// # Errors
/// The errors of the container and of `keep`.
pub(crate) fn fill(
    path: &Path,
    spec: &TaskSpec,
    limits: &Limits,
    plan: &mut Plan,
    keep: Keep<'_>,
) -> Result<Vec<Vec<u32>>, RecordingError> {
    let mut channels = std::mem::replace(&mut plan.channels, Channels::new(limits));
    let mut filler = Filler::new(spec, plan, keep);
    if !filler.streams.is_empty() {
        scan(path, limits, &mut |record| {
            let Record::Message { header, data } = record else { return Ok(()) };
            filler.message(channels.next(header.channel_id), data)
        })?;
    }
    let (mut problems, mut shown) = (Vec::new(), Vec::new());
    for stream in filler.streams {
        problems.push(stream.problem);
        shown.push(stream.shown);
    }
    for (at, problem) in problems.into_iter().enumerate() {
        let Some(Problem { step, error, count }) = problem else {
            continue;
        };
        let wrong_size = matches!(error, RecordingError::WrongSize { .. });
        let code = if wrong_size { FindingCode::WrongSize } else { FindingCode::BrokenImage };
        let detail = format!("{error} ({count} images alike)");
        plan.report.add(Severity::Error, code, &plan.images[at].topic, Some(step), detail);
    }
    let mut report = std::mem::take(&mut plan.report);
    inspect::frozen_cameras(plan, &shown, &mut report);
    plan.report = report;
    Ok(shown)
}

struct Filler<'a> {
    spec: &'a TaskSpec,
    plan: &'a Plan,
    /// The streams of each topic.
    topics: HashMap<&'a str, Vec<usize>>,
    streams: Vec<Stream>,
    keep: Keep<'a>,
}

/// What is known of one stream of images.
struct Stream {
    /// The steps, by the message that they use.
    steps: Vec<u32>,
    /// How many of these are done.
    done: usize,
    /// The number of the picture of each step.
    shown: Vec<u32>,
    /// The last picture and its number.
    last: Vec<u8>,
    number: u32,
    /// The first problem.
    problem: Option<Problem>,
}

struct Problem {
    step: u64,
    error: RecordingError,
    count: u64,
}

impl<'a> Filler<'a> {
    fn new(spec: &'a TaskSpec, plan: &'a Plan, keep: Keep<'a>) -> Self {
        let mut topics: HashMap<&str, Vec<usize>> = HashMap::new();
        for (at, stream) in plan.images.iter().enumerate() {
            topics.entry(&stream.topic).or_default().push(at);
        }
        let streams = plan.images.iter().map(|stream| Stream::new(&stream.picks)).collect();
        Self { spec, plan, topics, streams, keep }
    }

    fn message(
        &mut self,
        channel: Option<(&str, usize, &Result<crate::dialect::Decoder, String>)>,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let Some((topic, at, Ok(decoder))) = channel else {
            return Ok(());
        };
        let Some(streams) = self.topics.get(topic) else {
            return Ok(());
        };
        let uses =
            streams.iter().map(|&stream| (stream, self.streams[stream].take(&self.plan.images[stream].picks, at)));
        let uses: Vec<_> = uses.filter(|(_, steps)| !steps.is_empty()).collect();
        if uses.is_empty() {
            return Ok(());
        }
        // A message that can't be decoded was found in the first pass.
        let Ok(message) = decoder.decode(data) else {
            return Ok(());
        };
        uses.into_iter().try_for_each(|(stream, steps)| self.image(stream, &message, &steps))
    }

    fn image(&mut self, at: usize, message: &Value<'_>, steps: &[u32]) -> Result<(), RecordingError> {
        let stream = &mut self.streams[at];
        let image = &self.plan.images[at];
        match picture::decode(message, image.channel, &self.spec.cameras[image.camera]) {
            Ok(pixels) => {
                if stream.number == 0 || pixels != stream.last {
                    (self.keep)(at, &pixels)?;
                    (stream.last, stream.number) = (pixels, stream.number + 1);
                }
                steps.iter().for_each(|&step| stream.shown[step as usize] = stream.number);
            }
            Err(error) => {
                let step = steps.iter().min().copied().unwrap_or_default().into();
                stream.problem.get_or_insert(Problem { step, error, count: 0 }).count += 1;
            }
        }
        Ok(())
    }
}

impl Stream {
    /// `picks` is the message of each step.
    fn new(picks: &[usize]) -> Self {
        // A topic has at most ten million messages, and so an episode has as many steps.
        let mut steps: Vec<u32> = (0..u32::try_from(picks.len()).unwrap_or(u32::MAX)).collect();
        steps.sort_by_key(|&step| picks[step as usize]);
        Self { steps, done: 0, shown: vec![0; picks.len()], last: Vec::new(), number: 0, problem: None }
    }

    /// The steps that use message `at` of the topic; messages are asked for in their order.
    fn take(&mut self, picks: &[usize], at: usize) -> Vec<u32> {
        let rest = &self.steps[self.done..];
        let begin = rest.partition_point(|&step| picks[step as usize] < at);
        let count = rest[begin..].partition_point(|&step| picks[step as usize] == at);
        self.done += begin + count;
        rest[begin..begin + count].to_vec()
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn each_message_gives_its_steps_once_in_any_order() {
        let picks = [4, 2, 2, 9, 4];
        let mut stream = Stream::new(&picks);
        let taken: Vec<Vec<u32>> = [0, 2, 3, 4, 5, 9].map(|at| stream.take(&picks, at)).into();
        assert_eq!(taken, [vec![], vec![1, 2], vec![], vec![0, 4], vec![], vec![3]]);
    }
}
