//! From a recording to an episode and its report: the plan of the steps, then the pixels.

use std::path::Path;

use crate::cache::{CacheWriter, Steps};
use crate::error::RecordingError;
use crate::fill::fill;
use crate::frames::{Episode, frame_bytes_per_step, pictures};
use crate::limits::{ImageThreads, Limits};
use crate::plan::Plan;
use crate::planner::plan;
use crate::validate::validate_within;
use crate::whole_file::write_whole;
use gleaner_core::Report;
use gleaner_core::TaskSpec;

/// Bytes that the reader keeps for one message of a stream, and for one number of a step.
const STREAM_BYTES: usize = 160;
const NUMBER_BYTES: usize = 16;

/// A recording that was read.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The aligned steps.
    pub episode: Episode,
    /// The findings.
    pub report: Report,
    /// Name of the mapping that was used.
    pub mapping: String,
}

/// Reads a recording as an episode of this task and writes it as a frame cache, which appears under its name once it is
/// whole. Memory follows the messages by a few dozen bytes each, and not their pictures. The cache has the same bytes for
/// any number of threads.
///
/// # Errors
/// [`RecordingError::Rejected`] with the whole report if a finding forbids the use; the other variants are the reasons why
/// the file cannot be read or the cache cannot be written.
pub fn cache_episode(
    path: &Path,
    spec: &TaskSpec,
    (limits, threads): (&Limits, ImageThreads),
    cache: &Path,
) -> Result<Report, RecordingError> {
    validate_within(spec, limits)?;
    let mut plan = plan(path, spec, limits)?;
    let mut report = Report::default();
    write_whole(cache, |out| {
        let mut writer = CacheWriter::begin(out, cache, spec, plan.stamps.len())?;
        let keep = &mut |stream, pixels: &[u8]| writer.picture(stream, pixels);
        let shown = fill(path, spec, (limits, threads), &mut plan, keep)?;
        report = usable(&mut plan)?;
        let Plan { stamps, proprioception, action, .. } = &plan;
        writer.finish(&Steps { stamps, proprioception, action, shown: &shown })
    })?;
    Ok(report)
}

/// Memory that [`cache_episode`] needs for each step, in bytes, if every stream has one message a step: stamps, choices
/// and places of each stream, and the numbers. An upper bound; images are not part of it.
pub fn memory_per_step(spec: &TaskSpec) -> usize {
    let streams = 1 + pictures(spec).len() + spec.proprioception.len() + spec.action.len();
    streams * STREAM_BYTES + (spec.proprioception_size() + spec.action_size()) * NUMBER_BYTES
}

/// Reads a recording as an episode of this task in memory: for short recordings.
///
/// # Errors
/// [`RecordingError::Rejected`] with the whole report if a finding forbids the use; the other variants are the reasons why
/// the file cannot be read.
pub fn read_episode(path: &Path, spec: &TaskSpec) -> Result<Reading, RecordingError> {
    read_episode_within(path, spec, &Limits::default())
}

/// Like [`read_episode`], with other limits than the default.
///
/// # Errors
/// Like [`read_episode`], and [`RecordingError::TooLarge`] if the frames do not fit into memory.
pub fn read_episode_within(path: &Path, spec: &TaskSpec, limits: &Limits) -> Result<Reading, RecordingError> {
    validate_within(spec, limits)?;
    let mut plan = plan(path, spec, limits)?;
    let mut kept = vec![Vec::new(); plan.images.len()];
    let shown = fill(path, spec, (limits, ImageThreads::NONE), &mut plan, &mut |stream, pixels| {
        kept[stream].push(pixels.to_vec());
        Ok(())
    })?;
    let report = usable(&mut plan)?;
    let frames = frames(spec, plan.stamps.len(), &kept, &shown)?;
    let episode = Episode::new(spec, plan.stamps, plan.proprioception, plan.action, frames)?;
    Ok(Reading { episode, mapping: report.mapping.clone(), report })
}

/// The sorted report of a plan whose images were read, unless it forbids the use.
fn usable(plan: &mut Plan) -> Result<Report, RecordingError> {
    let report = std::mem::take(&mut plan.report).sorted();
    if report.has_errors() {
        return Err(RecordingError::Rejected(Box::new(report)));
    }
    Ok(report)
}

/// The frames of all steps, from the pictures of each stream and the numbers of those that the steps show.
fn frames(spec: &TaskSpec, steps: usize, kept: &[Vec<Vec<u8>>], shown: &[Vec<u32>]) -> Result<Vec<u8>, RecordingError> {
    let step_bytes = frame_bytes_per_step(spec);
    let mut frames = Vec::new();
    let total = steps.checked_mul(step_bytes).filter(|total| frames.try_reserve_exact(*total).is_ok());
    let Some(total) = total else {
        let problem =
            format!("{steps} steps of {step_bytes} bytes of images do not fit into memory; read it as a cache");
        return Err(RecordingError::TooLarge { problem });
    };
    frames.resize(total, 0);
    for ((form, pictures), shown) in pictures(spec).iter().zip(kept).zip(shown) {
        for (step, number) in shown.iter().enumerate() {
            let begin = step * step_bytes + form.offset;
            let picture = (*number as usize).checked_sub(1).and_then(|at| pictures.get(at));
            frames[begin..begin + form.bytes].copy_from_slice(picture.map(Vec::as_slice).unwrap_or_default());
        }
    }
    Ok(frames)
}
