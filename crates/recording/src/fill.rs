//! The second pass over a recording: the pixels of the images that the steps use.
//!
//! Each image is decoded once, in the order of the file, and handed on at once: memory holds one picture a stream.

use std::collections::HashMap;
use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::error::RecordingError;
use crate::inspect;
use crate::limits::Limits;
use crate::picture;
use crate::plan::{ImageStream, Plan};
use crate::video::{self, Packet, Shown, Video};
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
    filler.end()?;
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
    /// The number of the picture of each step.
    shown: Vec<u32>,
    /// The last picture and its number.
    last: Vec<u8>,
    number: u32,
    /// The first problem.
    problem: Option<Problem>,
    /// The first damage of video; its count is of steps.
    held: Option<Problem>,
    /// The decoder of video.
    video: Option<Video>,
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
        let streams = plan.images.iter().map(Stream::new).collect();
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
        let used = |at: usize, stream: &usize| !self.streams[*stream].uses(&self.plan.images[*stream], at).is_empty();
        let video = streams.iter().any(|&stream| self.streams[stream].video.is_some());
        let uses: Vec<usize> = streams.iter().copied().filter(|stream| used(at, stream)).collect();
        if !video && uses.is_empty() {
            return Ok(());
        }
        // A message that can't be decoded was found in the first pass.
        let Ok(message) = decoder.decode(data) else {
            return Ok(());
        };
        if video && let Some(packet) = video::packet(&message) {
            let streams = streams.clone();
            return self.video(&streams, at, packet);
        }
        for stream in uses {
            let image = &self.plan.images[stream];
            let pixels = picture::decode(&message, image.channel, &self.spec.cameras[image.camera]);
            self.show(stream, Shown { message: at, pixels, held: None })?;
        }
        Ok(())
    }

    /// Decodes a message of video for each camera that has its topic.
    fn video(
        &mut self,
        streams: &[usize],
        message: usize,
        packet: Result<Packet<'_>, RecordingError>,
    ) -> Result<(), RecordingError> {
        let packet = packet.map_err(|error| error.to_string());
        for &at in streams {
            let image = &self.plan.images[at];
            let stream = &mut self.streams[at];
            let Some(mut video) = stream.video.take() else { continue };
            let used = |message| !stream.uses(image, message).is_empty();
            let shown = match &packet {
                Ok(packet) => video.push(message, packet, &self.spec.cameras[image.camera], &used),
                Err(problem) => {
                    let error = RecordingError::BrokenImage { problem: problem.clone() };
                    vec![Shown { message, pixels: Err(error), held: None }]
                }
            };
            stream.video = Some(video);
            shown.into_iter().try_for_each(|shown| self.show(at, shown))?;
        }
        Ok(())
    }

    /// Ends every stream of video.
    fn end(&mut self) -> Result<(), RecordingError> {
        for at in 0..self.streams.len() {
            let image = &self.plan.images[at];
            let stream = &mut self.streams[at];
            let Some(mut video) = stream.video.take() else { continue };
            let used = |message| !stream.uses(image, message).is_empty();
            let shown = video.end(&self.spec.cameras[image.camera], &used);
            shown.into_iter().try_for_each(|shown| self.show(at, shown))?;
        }
        Ok(())
    }

    /// Puts the pixels of a message into the steps that use it.
    fn show(&mut self, at: usize, shown: Shown) -> Result<(), RecordingError> {
        let Shown { message, pixels, held } = shown;
        let stream = &mut self.streams[at];
        let steps = stream.uses(&self.plan.images[at], message).to_vec();
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
    fn new(image: &ImageStream) -> Self {
        let picks = &image.picks;
        // A topic has at most ten million messages, and so an episode has as many steps.
        let mut steps: Vec<u32> = (0..u32::try_from(picks.len()).unwrap_or(u32::MAX)).collect();
        steps.sort_by_key(|&step| picks[step as usize]);
        let video = image.video.then(Video::default);
        Self { steps, shown: vec![0; picks.len()], last: Vec::new(), number: 0, problem: None, held: None, video }
    }

    /// The steps that use message `at` of the topic of this image.
    fn uses(&self, image: &ImageStream, at: usize) -> &[u32] {
        let begin = self.steps.partition_point(|&step| image.picks[step as usize] < at);
        let count = self.steps[begin..].partition_point(|&step| image.picks[step as usize] == at);
        &self.steps[begin..begin + count]
    }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::picture::Channel;

    #[test]
    fn each_message_has_its_steps() {
        let picks = vec![4, 2, 2, 9, 4];
        let image = ImageStream { topic: "/front".into(), camera: 0, channel: Channel::Color, video: false, picks };
        let stream = Stream::new(&image);
        let found: Vec<&[u32]> = [0, 2, 3, 4, 5, 9].map(|at| stream.uses(&image, at)).into();
        let expected: [&[u32]; 6] = [&[], &[1, 2], &[], &[0, 4], &[], &[3]];
        assert_eq!(found, expected);
    }
}
