//! The second pass over a recording: the pixels of the images that the steps use.
//!
//! Each image is decoded once, on one of several threads, and handed on in the order of the file: memory holds one picture
//! a stream and those under way.

mod look;
mod order;

use std::collections::HashMap;
use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::error::RecordingError;
use crate::inspect;
use crate::limits::{ImageThreads, Limits};
use crate::plan::Plan;
use crate::video::Shown;
use gleaner_core::TaskSpec;
use gleaner_core::{FindingCode, Severity};
use look::{Looking, Message, Uses};

/// Receives the next picture of a stream, by the stream's number in the plan.
pub(crate) type Keep<'a> = &'a mut dyn FnMut(usize, &[u8]) -> Result<(), RecordingError>;

/// Decodes the images of all steps on this many threads; those that can't be decoded become findings. Hands on each
/// picture that differs from the one before it in its stream, and returns for each stream and step the number of its
/// picture, from 1 on: 0 for a step whose image is broken. The result does not depend on the number of threads.
///
/// # Errors
/// The errors of the container and of `keep`, and of starting a thread.
pub(crate) fn fill(
    path: &Path,
    spec: &TaskSpec,
    (limits, threads): (&Limits, ImageThreads),
    plan: &mut Plan,
    keep: Keep<'_>,
) -> Result<Vec<Vec<u32>>, RecordingError> {
    let mut channels = std::mem::replace(&mut plan.channels, Channels::new(limits));
    let uses: Vec<Uses> = plan.images.iter().map(Uses::new).collect();
    let looking = Looking { spec, images: &plan.images, uses: &uses };
    let mut filler = Filler { streams: plan.images.iter().map(|image| Stream::new(image.picks.len())).collect(), keep };
    if !filler.streams.is_empty() {
        let (places, topics) = topics(plan);
        let messages = |give: order::Give<'_>| {
            scan(path, limits, &mut |record| {
                let Record::Message { header, data } = record else { return Ok(()) };
                let Some((topic, at, decoder)) = channels.next(header.channel_id) else { return Ok(()) };
                let Some(&place) = places.get(topic) else { return Ok(()) };
                let message = Message { at, streams: &topics[place], decoder, data };
                if looking.needs(&message) { give(&message) } else { Ok(()) }
            })
            .map(|_| ())
        };
        let show = &mut |stream, shown: Shown| filler.show(stream, looking.steps(stream, shown.message), shown);
        order::in_order(&looking, threads, &topics, messages, show)?;
    }
    let (mut problems, mut held, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    for stream in filler.streams {
        problems.push(stream.problem);
        held.push(stream.held);
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
    for (at, problem) in held.into_iter().enumerate() {
        let Some(Problem { step, error, count }) = problem else { continue };
        let detail = format!(
            "{error}; {count} steps have the last whole picture in place of their own. Look for a dropped connection, or \
             leave these steps out"
        );
        plan.report.add(Severity::Warning, FindingCode::BrokenImage, &plan.images[at].topic, Some(step), detail);
    }
    let mut report = std::mem::take(&mut plan.report);
    inspect::frozen_cameras(plan, &shown, &mut report);
    plan.report = report;
    Ok(shown)
}

/// The streams of each topic with images, and the place of each topic among them.
fn topics(plan: &Plan) -> (HashMap<&str, usize>, Vec<Vec<usize>>) {
    let (mut places, mut topics) = (HashMap::new(), Vec::<Vec<usize>>::new());
    for (at, stream) in plan.images.iter().enumerate() {
        let place = *places.entry(stream.topic.as_str()).or_insert(topics.len());
        if place == topics.len() {
            topics.push(Vec::new());
        }
        topics[place].push(at);
    }
    (places, topics)
}

struct Filler<'a> {
    streams: Vec<Stream>,
    keep: Keep<'a>,
}

/// What is known of one stream of images.
#[derive(Default)]
struct Stream {
    /// The number of the picture of each step.
    shown: Vec<u32>,
    /// The last picture and its number.
    last: Vec<u8>,
    number: u32,
    /// The first problem.
    problem: Option<Problem>,
    /// The first damage of video; its count is of steps.
    held: Option<Problem>,
}

struct Problem {
    step: u64,
    error: RecordingError,
    count: u64,
}

impl Filler<'_> {
    /// Puts the pixels of a message into the steps that use it.
    fn show(&mut self, at: usize, steps: &[u32], shown: Shown) -> Result<(), RecordingError> {
        let Shown { pixels, held, .. } = shown;
        let stream = &mut self.streams[at];
        let Some(first) = steps.iter().min().copied() else { return Ok(()) };
        let problem = |error| Problem { step: first.into(), error, count: 0 };
        if let Some(error) = held {
            stream.held.get_or_insert(problem(error)).count += steps.len() as u64;
        }
        match pixels {
            Ok(pixels) => {
                if stream.number == 0 || pixels != stream.last {
                    (self.keep)(at, &pixels)?;
                    (stream.last, stream.number) = (pixels, stream.number + 1);
                }
                steps.iter().for_each(|&step| stream.shown[step as usize] = stream.number);
            }
            Err(error) => stream.problem.get_or_insert(problem(error)).count += 1,
        }
        Ok(())
    }
}

impl Stream {
    fn new(steps: usize) -> Self {
        Self { shown: vec![0; steps], ..Self::default() }
    }
}
