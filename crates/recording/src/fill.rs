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
    };
    if step_bytes > 0 {
        scan(path, limits, &mut |record| {
            if let Record::Message { header, data } = record {
                filler.message(channels.next(header.channel_id), data);
            }
            Ok(())
        })?;
    }
    let Filler { frames, problems, offsets, .. } = filler;
    for (at, problem) in problems.into_iter().enumerate() {
        let Some(Problem { step, error, count }) = problem else {
            continue;
        };
        let wrong_size = matches!(error, RecordingError::WrongSize { .. });
        let code = if wrong_size { FindingCode::WrongSize } else { FindingCode::BrokenImage };
        let detail = format!("{error} ({count} images alike)");
        plan.report.add(Severity::Error, code, &plan.images[at].topic, Some(step), detail);
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
        let Some(places) = self.places.get_mut(topic).and_then(|messages| messages.remove(&at)) else {
            return;
        };
        // A message that can't be decoded was found in the first pass.
        let Ok(message) = decoder.decode(data) else {
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
        match picture::decode(message, stream.channel, &self.spec.cameras[stream.camera]) {
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
