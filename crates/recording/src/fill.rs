//! The second pass over a recording: the pixels of the images that the steps use.
//!
//! Each image is decoded once, straight into every step that uses it.

use std::collections::HashMap;
use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::dialect::Value;
use crate::error::RecordingError;
use crate::frames::frame_bytes_per_step;
use crate::inspect;
use crate::limits::Limits;
use crate::picture::{self, Channel};
use crate::plan::{ImageStream, Plan};
use crate::video::{self, Packet, Shown, Video};
use gleaner_core::TaskSpec;
use gleaner_core::{FindingCode, Severity};

/// Decodes the frames of all steps; images that can't be decoded become findings.
///
/// # Errors
/// The errors of the container, and [`RecordingError::TooLarge`] if the frames do not fit into memory.
pub(crate) fn fill(path: &Path, spec: &TaskSpec, limits: &Limits, plan: &mut Plan) -> Result<Vec<u8>, RecordingError> {
    let mut channels = std::mem::replace(&mut plan.channels, Channels::new(limits));
    let step_bytes = frame_bytes_per_step(spec);
    let mut filler = Filler {
        spec,
        plan,
        step_bytes,
        offsets: plan.images.iter().map(|stream| offset(spec, stream.camera, stream.channel)).collect(),
        places: places(plan),
        frames: reserve(plan.stamps.len(), step_bytes)?,
        problems: plan.images.iter().map(|_| None).collect(),
        held: plan.images.iter().map(|_| None).collect(),
        videos: plan.images.iter().map(|stream| stream.video.then(Video::default)).collect(),
    };
    if step_bytes > 0 {
        scan(path, limits, &mut |record| {
            if let Record::Message { header, data } = record {
                filler.message(channels.next(header.channel_id), data);
            }
            Ok(())
        })?;
    }
    filler.end();
    let Filler { frames, problems, held, offsets, .. } = filler;
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
    let image = |stream: usize, step: usize| {
        let ImageStream { camera, channel, .. } = plan.images[stream];
        let begin = step * step_bytes + offsets[stream];
        &frames[begin..begin + channel.bytes(&spec.cameras[camera])]
    };
    let mut report = std::mem::take(&mut plan.report);
    inspect::frozen_cameras(plan, image, &mut report);
    plan.report = report;
    Ok(frames)
}

/// For each topic and message, the (stream, step) pairs that it fills.
type Places = HashMap<String, HashMap<usize, Vec<(usize, usize)>>>;

struct Filler<'a> {
    spec: &'a TaskSpec,
    plan: &'a Plan,
    step_bytes: usize,
    /// The offset of each stream's image within a step.
    offsets: Vec<usize>,
    places: Places,
    frames: Vec<u8>,
    /// The first problem of each stream.
    problems: Vec<Option<Problem>>,
    /// The first damage of each stream of video; its count is of steps.
    held: Vec<Option<Problem>>,
    /// The decoder of each stream of video.
    videos: Vec<Option<Video>>,
}

struct Problem {
    step: u64,
    error: RecordingError,
    count: u64,
}

impl Filler<'_> {
    fn message(&mut self, channel: Option<(&str, usize, &Result<crate::dialect::Decoder, String>)>, data: &[u8]) {
        let Some((topic, at, Ok(decoder))) = channel else {
            return;
        };
        let video = self.plan.images.iter().any(|stream| stream.video && stream.topic == topic);
        if !video && !self.places.get(topic).is_some_and(|messages| messages.contains_key(&at)) {
            return;
        }
        // A message that can't be decoded was found in the first pass.
        let Ok(message) = decoder.decode(data) else {
            return;
        };
        if video && let Some(packet) = video::packet(&message) {
            self.video(topic, at, packet);
            return;
        }
        let Some(places) = self.places.get_mut(topic).and_then(|messages| messages.remove(&at)) else {
            return;
        };
        for stream in 0..self.plan.images.len() {
            let steps: Vec<usize> = places.iter().filter(|(of, _)| *of == stream).map(|(_, step)| *step).collect();
            if let Some(&first) = steps.first() {
                self.image(stream, &message, first, &steps);
            }
        }
    }

    fn image(&mut self, at: usize, message: &Value<'_>, first: usize, steps: &[usize]) {
        let stream = &self.plan.images[at];
        let pixels = picture::decode(message, stream.channel, &self.spec.cameras[stream.camera]);
        self.keep(at, pixels, first, steps);
    }

    /// Puts the pixels of a message into the steps that use it.
    fn keep(&mut self, at: usize, pixels: Result<Vec<u8>, RecordingError>, first: usize, steps: &[usize]) {
        match pixels {
            Ok(pixels) => {
                for step in steps {
                    let begin = step * self.step_bytes + self.offsets[at];
                    self.frames[begin..begin + pixels.len()].copy_from_slice(&pixels);
                }
            }
            Err(error) => {
                let step = first as u64;
                self.problems[at].get_or_insert(Problem { step, error, count: 0 }).count += 1;
            }
        }
    }

    /// Decodes a message of video for each camera that has its topic.
    fn video(&mut self, topic: &str, message: usize, packet: Result<Packet<'_>, RecordingError>) {
        let packet = packet.map_err(|error| error.to_string());
        for at in 0..self.plan.images.len() {
            let stream = &self.plan.images[at];
            let Some(video) = self.videos[at].as_mut().filter(|_| stream.topic == topic) else { continue };
            let used = |message| uses(&self.places, at, topic, message);
            let camera = &self.spec.cameras[stream.camera];
            let shown = match &packet {
                Ok(packet) => video.push(message, packet, camera, &used),
                Err(problem) => {
                    let error = RecordingError::BrokenImage { problem: problem.clone() };
                    vec![Shown { message, pixels: Err(error), held: None }]
                }
            };
            self.show(at, shown);
        }
    }

    /// Ends every stream of video.
    fn end(&mut self) {
        for at in 0..self.plan.images.len() {
            let stream = &self.plan.images[at];
            let Some(video) = self.videos[at].as_mut() else { continue };
            let used = |message| uses(&self.places, at, &stream.topic, message);
            let shown = video.end(&self.spec.cameras[stream.camera], &used);
            self.show(at, shown);
        }
    }

    fn show(&mut self, at: usize, shown: Vec<Shown>) {
        let topic = &self.plan.images[at].topic;
        for Shown { message, pixels, held } in shown {
            let places = self.places.get(topic).and_then(|messages| messages.get(&message));
            let steps: Vec<usize> =
                places.into_iter().flatten().filter(|(of, _)| *of == at).map(|(_, step)| *step).collect();
            let Some(&first) = steps.first() else { continue };
            if let Some(error) = held {
                let problem = Problem { step: first as u64, error, count: 0 };
                self.held[at].get_or_insert(problem).count += steps.len() as u64;
            }
            self.keep(at, pixels, first, &steps);
        }
    }
}

/// Whether a step of a stream uses a message.
fn uses(places: &Places, stream: usize, topic: &str, message: usize) -> bool {
    let places = places.get(topic).and_then(|messages| messages.get(&message));
    places.into_iter().flatten().any(|(of, _)| *of == stream)
}

fn places(plan: &Plan) -> Places {
    let mut places = Places::new();
    for (at, stream) in plan.images.iter().enumerate() {
        let messages = places.entry(stream.topic.clone()).or_default();
        for (step, &message) in stream.picks.iter().enumerate() {
            messages.entry(message).or_default().push((at, step));
        }
    }
    places
}

/// Zeroed memory for all frames, or an error when there is not enough.
fn reserve(steps: usize, step_bytes: usize) -> Result<Vec<u8>, RecordingError> {
    let mut frames = Vec::new();
    let total = steps.checked_mul(step_bytes);
    match total.map(|total| frames.try_reserve_exact(total).map(|()| total)) {
        Some(Ok(total)) => {
            frames.resize(total, 0);
            Ok(frames)
        }
        _ => Err(RecordingError::TooLarge {
            problem: format!(
                "{steps} steps of {step_bytes} bytes of images do not fit into memory; split the recording or use \
                 smaller images"
            ),
        }),
    }
}

/// The offset of a camera's image within a step.
fn offset(spec: &TaskSpec, camera: usize, channel: Channel) -> usize {
    let whole = |camera| Channel::Color.bytes(camera) + if camera.depth { Channel::Depth.bytes(camera) } else { 0 };
    let before: usize = spec.cameras.iter().take(camera).map(whole).sum();
    match channel {
        Channel::Color => before,
        Channel::Depth => before + spec.cameras.get(camera).map_or(0, |camera| Channel::Color.bytes(camera)),
    }
}
