//! Export: the kept stretches of a dataset as MCAP files of their own, the experts whole, and a manifest.

use std::{
    io::Write as _,
    ops::{Range, RangeInclusive},
    path::Path,
};

use gleaner_core::{
    dataset::{ExportFile, KeptSegment},
    error::Error,
    snapshot::Role,
    work::{InputEpisode, Inputs, KeptInput, Made},
};
use gleaner_data_folder::blobs::Blobs;
use gleaner_learn::Monitor as _;
use gleaner_recording::{Kept, TaskSpec};
use serde::Serialize;

use super::Work;
use crate::{failure::Failure, monitor::Watcher};

/// The file that describes every other file, one line each.
const MANIFEST: &str = "manifest.jsonl";

/// One line of the manifest. Step numbers are those of the original episode.
#[derive(Serialize)]
struct Line<'a> {
    episode: &'a str,
    source: &'a str,
    file: &'a str,
    role: Role,
    first_step: u64,
    last_step: u64,
    /// l: the segment that ends at a step begins l steps before it.
    segment_length: u32,
    /// The kept steps; empty for experts, whose steps all have weight 1.
    steps: Vec<Step<'a>>,
}

/// One kept step: the end of a kept segment.
#[derive(Serialize)]
struct Step<'a> {
    step: u32,
    q: f32,
    w: f64,
    /// `None` when the scorer has no matches.
    nearest_episode: Option<&'a str>,
    nearest_step: Option<u32>,
}

/// Writes the files of a dataset.
pub(super) fn perform(work: &mut Work) -> Result<Made, Failure> {
    work.monitor.phase("exporting");
    export(&work.data_dir, &work.blobs, &work.inputs, &mut work.monitor).map(Made::Files)
}

/// Stores every file of the export as a blob.
fn export(data_dir: &Path, blobs: &Blobs, inputs: &Inputs, monitor: &mut Watcher) -> Result<Vec<ExportFile>, Failure> {
    let folder =
        tempfile::tempdir_in(data_dir.join("tmp")).map_err(|error| Error::internal("making a folder", error))?;
    let out = Out { folder: folder.path(), blobs, task: &inputs.task, segment_length: inputs.segment_length };
    let stretches: Vec<(&KeptInput, Range<usize>)> = inputs
        .kept
        .iter()
        .flat_map(|kept| stretches(&kept.segments).into_iter().map(move |range| (kept, range)))
        .collect();
    let total = stretches.len() + inputs.experts.len();
    let (mut files, mut manifest) = (Vec::with_capacity(total + 1), Vec::new());
    let mut advance = |file: ExportFile| -> Result<(), Failure> {
        files.push(file);
        monitor.progress(count(files.len()), count(total), &[]);
        if monitor.cancelled() { Err(Failure::Cancelled) } else { Ok(()) }
    };
    for expert in &inputs.experts {
        advance(out.expert(expert, &mut manifest)?)?;
    }
    for (kept, range) in stretches {
        advance(out.stretch(kept, range, &mut manifest)?)?;
    }
    let blob = blobs.put(&manifest)?;
    files.push(ExportFile { name: MANIFEST.to_owned(), blob, size_bytes: count(manifest.len()) });
    Ok(files)
}

/// Destination of an export.
struct Out<'a> {
    folder: &'a Path,
    blobs: &'a Blobs,
    task: &'a TaskSpec,
    segment_length: u32,
}

impl Out<'_> {
    /// An expert's recording unchanged: the same blob under another name.
    fn expert(&self, expert: &InputEpisode, manifest: &mut Vec<u8>) -> Result<ExportFile, Failure> {
        let name = format!("{}.mcap", expert.id);
        let size = std::fs::metadata(self.blobs.path(&expert.recording));
        let size_bytes = size.map_err(|error| Error::internal(format!("reading {}", expert.recording), error))?.len();
        let line = Line {
            episode: expert.id.as_str(),
            source: &expert.file_name,
            file: &name,
            role: Role::Expert,
            first_step: 0,
            last_step: expert.steps.saturating_sub(1),
            segment_length: self.segment_length,
            steps: Vec::new(),
        };
        append(manifest, &line)?;
        Ok(ExportFile { blob: expert.recording.clone(), size_bytes, name })
    }

    /// The original messages of consecutive kept steps.
    fn stretch(&self, kept: &KeptInput, range: Range<usize>, manifest: &mut Vec<u8>) -> Result<ExportFile, Failure> {
        let KeptInput { episode, segments, similarities, qualities } = kept;
        let unscored = || Failure::Retryable(format!("the server sent no scores for the kept steps of {}", episode.id));
        let segments = segments.get(range).ok_or_else(unscored)?;
        let steps = file_steps(segments, qualities).ok_or_else(unscored)?;
        let (first_step, last_step) = (count(*steps.start()), count(*steps.end()));
        let (Some(q), Some(w)) = (qualities.get(steps.clone()), similarities.get(steps)) else {
            return Err(unscored());
        };
        let name = format!("{}_{first_step}-{last_step}.mcap", episode.id);
        let path = self.folder.join(&name);
        let weight = w.iter().copied().map(narrow).collect();
        let stretch = Kept { first_step, last_step, quality: q.to_vec(), weight };
        gleaner_recording::extract(&self.blobs.path(&episode.recording), self.task, &stretch, &path)
            .map_err(|error| Failure::recording(episode.id.as_str(), &error))?;
        let size_bytes =
            std::fs::metadata(&path).map_err(|error| Error::internal("reading an exported file", error))?.len();
        let blob = self.blobs.put_file(&path)?;
        let line = Line {
            episode: episode.id.as_str(),
            source: &episode.file_name,
            file: &name,
            role: Role::Imperfect,
            first_step,
            last_step,
            segment_length: self.segment_length,
            steps: segments.iter().filter_map(|segment| step(segment, similarities)).collect(),
        };
        append(manifest, &line)?;
        Ok(ExportFile { name, blob, size_bytes })
    }
}

/// The steps in the file of a stretch: its own. A single step does not make a recording, so the neighbour with the
/// higher quality is added; the manifest and the file's own qualities mark which step was kept.
fn file_steps(segments: &[KeptSegment], qualities: &[f32]) -> Option<RangeInclusive<usize>> {
    let step = |segment: &KeptSegment| usize::try_from(segment.end_step).ok();
    let (first, last) = (step(segments.first()?)?, step(segments.last()?)?);
    if first < last {
        return Some(first..=last);
    }
    let before = first.checked_sub(1).and_then(|before| qualities.get(before));
    match (before, qualities.get(first + 1)) {
        (Some(before), Some(after)) if after > before => Some(first..=first + 1),
        (Some(_), _) => Some(first - 1..=first),
        (None, Some(_)) => Some(first..=first + 1),
        (None, None) => Some(first..=first),
    }
}

fn step<'a>(segment: &'a KeptSegment, similarities: &[f64]) -> Option<Step<'a>> {
    let KeptSegment { end_step, weight, nearest } = segment;
    let w = *similarities.get(usize::try_from(*end_step).ok()?)?;
    Some(Step {
        step: *end_step,
        q: *weight,
        w,
        nearest_episode: nearest.as_ref().map(|nearest| nearest.episode_id.as_str()),
        nearest_step: nearest.as_ref().map(|nearest| nearest.end_step),
    })
}

fn append(manifest: &mut Vec<u8>, line: &Line<'_>) -> Result<(), Failure> {
    let fault = |error: std::io::Error| Failure::from(Error::internal("writing the manifest", error));
    serde_json::to_writer(&mut *manifest, line).map_err(|error| fault(error.into()))?;
    manifest.write_all(b"\n").map_err(fault)
}

/// Runs of segments with consecutive end steps.
fn stretches(segments: &[KeptSegment]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (at, segment) in segments.iter().enumerate() {
        let follows = at > 0 && segments[at - 1].end_step + 1 == segment.end_step;
        match runs.last_mut() {
            Some(run) if follows => run.end = at + 1,
            Some(_) | None => runs.push(at..at + 1),
        }
    }
    runs
}

fn count(length: usize) -> u64 {
    u64::try_from(length).unwrap_or(u64::MAX)
}

#[expect(clippy::cast_possible_truncation, reason = "the recording's format holds w in single precision")]
fn narrow(w: f64) -> f32 {
    w as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    fn kept(steps: &[u32]) -> Vec<KeptSegment> {
        let segment = |&end_step: &u32| KeptSegment { end_step, weight: 1.0, nearest: None };
        steps.iter().map(segment).collect()
    }

    #[test]
    fn consecutive_steps_are_one_stretch() {
        assert_eq!(stretches(&kept(&[0, 1, 2, 5, 6, 9])), [0..3, 3..5, 5..6]);
        assert_eq!(stretches(&kept(&[7, 9])), [0..1, 1..2]);
        assert!(stretches(&[]).is_empty());
    }

    #[test]
    fn a_single_step_is_exported_with_its_better_neighbour() {
        let q = [0.9, 0.1, 0.9, 0.3, 0.9];
        assert_eq!(file_steps(&kept(&[1, 2, 3]), &q), Some(1..=3));
        assert_eq!(file_steps(&kept(&[0]), &q), Some(0..=1));
        assert_eq!(file_steps(&kept(&[2]), &q), Some(2..=3));
        assert_eq!(file_steps(&kept(&[4]), &q), Some(3..=4));
        assert_eq!(file_steps(&kept(&[0]), &q[..1]), Some(0..=0));
        assert_eq!(file_steps(&[], &q), None);
    }
}
