//! LeRobot dataset v3.0, with images in parquet, which open in lerobot 0.4 and 0.6 without any video library, or as video.
//!
//! Each piece is an episode of its own, so that a window of steps never crosses the border of a kept stretch. A recording's
//! own JPEG files are copied; other pictures are PNG. Layout and names: `docs/ecosystem.md`.

mod card;
mod episodes;
mod features;
mod films;
mod frames;
mod stats;
mod tasks;

use std::collections::HashMap;
use std::path::PathBuf;

use gleaner_core::TaskSpec;
use gleaner_core::dataset::ExportSpec;
use gleaner_core::episode::Outcome;
use gleaner_core::snapshot::Role;
use gleaner_recording::{StepJpegs, StepScore};
use serde_json::{Value, json};

use crate::export::Export;
use crate::piece::Piece;
use crate::problem::Problem;
use episodes::{Episode, Episodes};
use features::Features;
use films::Films;
use frames::{FrameRow, Frames};
use stats::Stats;

const VERSION: &str = "v3.0";
/// Files of a folder.
const FILES_IN_CHUNK: usize = 1000;
/// Those of LeRobot's own datasets.
const SIZES: FileSizes = FileSizes { data: 100 << 20, video: 200 << 20 };
/// Most steps of an episode whose pictures count for statistics.
const SAMPLED_STEPS: usize = 100;

/// The sizes in bytes after which an episode begins the next file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FileSizes {
    pub(crate) data: u64,
    pub(crate) video: u64,
}

/// The number of a file, from 0 on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct FileNumber(usize);

impl FileNumber {
    fn chunk(self) -> usize {
        self.0 / FILES_IN_CHUNK
    }

    fn file(self) -> usize {
        self.0 % FILES_IN_CHUNK
    }

    fn name(self, folder: &str, ending: &str) -> String {
        format!("{folder}/chunk-{:03}/file-{:03}.{ending}", self.chunk(), self.file())
    }

    fn table(self, folder: &str) -> String {
        self.name(folder, "parquet")
    }
}

/// Writes the folder of a dataset.
pub(crate) fn write<E: Export>(export: &mut E, spec: ExportSpec) -> Result<(), E::Error> {
    write_files(export, spec, SIZES)
}

/// The same with files of these sizes.
pub(crate) fn write_files<E: Export>(export: &mut E, spec: ExportSpec, sizes: FileSizes) -> Result<(), E::Error> {
    let task = export.task().clone();
    let features = Features::new(&task, spec);
    let experts = experts(export.pieces());
    let mut file = FileNumber::default();
    let mut frames = Frames::create(create(export, &file.table("data"))?, &features)?;
    let mut episodes = Episodes::create(create(export, &FileNumber::default().table("meta/episodes"))?, &features)?;
    let mut films = Films::new(&features, sizes.video);
    let mut whole = Stats::new(&features);
    let mut total = 0;
    for at in 0..export.pieces().len() {
        if at > 0 && frames.bytes() >= sizes.data {
            let next = FileNumber(file.0 + 1);
            let out = create(export, &next.table("data"))?;
            std::mem::replace(&mut frames, Frames::create(out, &features)?).finish()?;
            export.finished(&file.table("data"))?;
            file = next;
        }
        let piece = export.pieces()[at].clone();
        let source = Source::open(export, at, &piece, &experts, &features)?;
        let mut stats = Stats::new(&features);
        films.begin_episode(export)?;
        for within in 0..piece.len() {
            let row = source.row(export, (at, &piece), within, total, &features)?;
            let pixels = row.pixels.as_deref().unwrap_or_default();
            films.push(pixels)?;
            let pixels = if row.sampled { pixels } else { &[] };
            for stats in [&mut stats, &mut whole] {
                stats.add(&row.numbers(&features), pixels);
            }
            frames.push(row)?;
            total += 1;
        }
        frames.end_episode()?;
        let videos = films.places();
        let (index, end, task) = (at, total, task_text(&task));
        episodes.push(&Episode { piece: &piece, index, end, task, file, videos: &videos, stats: &stats })?;
        export.advance()?;
    }
    frames.finish()?;
    export.finished(&file.table("data"))?;
    films.finish(export)?;
    episodes.finish()?;
    export.finished(&FileNumber::default().table("meta/episodes"))?;
    tasks::write(create(export, "meta/tasks.parquet")?, task_text(&task))?;
    export.finished("meta/tasks.parquet")?;
    let totals = Totals { episodes: export.pieces().len(), frames: total };
    text(export, "meta/info.json", &pretty(&info(&task, &features, &totals, sizes)))?;
    text(export, "meta/stats.json", &pretty(&whole.to_json()))?;
    let card = card::card(export, &features, &totals);
    text(export, "README.md", &card)
}

struct Totals {
    episodes: usize,
    frames: usize,
}

/// The episode of each expert in the dataset: experts are whole, so a match is a frame of it.
fn experts(pieces: &[Piece]) -> HashMap<String, i64> {
    let experts = (0..).zip(pieces).filter(|(_, piece)| piece.role() == Role::Expert);
    experts.map(|(index, piece)| (piece.episode().id.to_string(), index)).collect()
}

/// What the frames of a piece are made from.
struct Source<'a> {
    scores: Vec<StepScore>,
    state: Vec<f32>,
    action: Vec<f32>,
    jpegs: Option<StepJpegs>,
    experts: &'a HashMap<String, i64>,
}

impl<'a> Source<'a> {
    fn open<E: Export>(
        export: &mut E,
        at: usize,
        piece: &Piece,
        experts: &'a HashMap<String, i64>,
        features: &Features,
    ) -> Result<Self, E::Error> {
        let numbers = export.numbers(at)?;
        let jpegs = if features.stored().next().is_none() {
            None
        } else {
            let spool = tempfile::tempfile_in(export.folder()).map_err(Problem::io(export.folder()))?;
            let read = StepJpegs::read(export.recording(at)?.as_ref(), export.task(), &piece.steps, spool);
            Some(read.map_err(Problem::recording(piece.episode().id.as_str()))?)
        };
        Ok(Self { scores: piece.scores(), state: numbers.proprioception, action: numbers.action, jpegs, experts })
    }

    /// The frame of a step, by its number within the piece.
    fn row<E: Export>(
        &self,
        export: &mut E,
        (at, piece): (usize, &Piece),
        within: usize,
        index: usize,
        features: &Features,
    ) -> Result<FrameRow, E::Error> {
        let step = piece.steps.start + within;
        let outside = || Problem::Input(format!("episode {}: step {step} is missing", piece.episode().id));
        let score = self.scores.get(within).ok_or_else(outside)?;
        let of = |values: &[f32], size: usize| {
            values.get(within * size..(within + 1) * size).map(<[f32]>::to_vec).ok_or_else(outside)
        };
        let matched = score.matched.as_ref();
        let last = within + 1 == piece.len();
        let mut row = FrameRow {
            state: of(&self.state, features.state_size())?,
            action: of(&self.action, features.action_size())?,
            done: last,
            success: last && piece.is_whole() && piece.episode().outcome == Outcome::Success,
            q: score.q,
            w: narrow(score.w),
            weight: if score.kept { score.q } else { 0.0 },
            match_episode: matched.and_then(|(expert, _)| self.experts.get(expert)).copied().unwrap_or(-1),
            match_step: matched.map_or(-1, |(_, step)| i64::from(*step)),
            step: number(step),
            frame_index: number(within),
            timestamp: number_f32(within) / features.fps_f32(),
            episode_index: number(at),
            index: number(index),
            images: Vec::new(),
            pixels: None,
            sampled: within.is_multiple_of(piece.len().div_ceil(SAMPLED_STEPS).max(1)),
        };
        if features.cameras().is_empty() {
            return Ok(row);
        }
        let mut jpegs = Vec::with_capacity(features.cameras().len());
        for camera in features.stored() {
            let jpeg = self.jpegs.as_ref().filter(|_| !camera.depth).map(|jpegs| jpegs.get(camera.camera, step));
            jpegs.push(jpeg.transpose().map_err(Problem::recording(piece.episode().id.as_str()))?.flatten());
        }
        // Videos need the pixels of every step.
        let needed = row.sampled || features.is_filmed() || jpegs.iter().any(Option::is_none);
        row.pixels = if needed { Some(export.frames(at, step)?) } else { None };
        for (camera, jpeg) in features.stored().zip(jpegs) {
            row.images.push(match (jpeg, &row.pixels) {
                (Some(jpeg), _) => jpeg,
                (None, Some(pixels)) => camera.png(pixels).map_err(Problem::recording(piece.episode().id.as_str()))?,
                (None, None) => Vec::new(),
            });
        }
        Ok(row)
    }
}

/// The text of the task: its instruction, or its name.
fn task_text(task: &TaskSpec) -> &str {
    if task.instruction.is_empty() { &task.name } else { &task.instruction }
}

fn info(task: &TaskSpec, features: &Features, totals: &Totals, sizes: FileSizes) -> Value {
    json!({
        "codebase_version": VERSION,
        "robot_type": Value::Null,
        "fps": features.fps(),
        "total_episodes": totals.episodes,
        "total_frames": totals.frames,
        "total_tasks": 1,
        "chunks_size": FILES_IN_CHUNK,
        "data_files_size_in_mb": sizes.data >> 20,
        "video_files_size_in_mb": sizes.video >> 20,
        "splits": {"train": format!("0:{}", totals.episodes)},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": features.is_filmed().then_some("videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"),
        "features": features.to_json(task),
    })
}

/// A file of the export that is begun, with its path.
struct Begun {
    file: std::fs::File,
    path: PathBuf,
}

fn create<E: Export>(export: &E, name: &str) -> Result<Begun, Problem> {
    let path = export.folder().join(name);
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(Problem::io(folder))?;
    }
    let file = std::fs::File::create(&path).map_err(Problem::io(&path))?;
    Ok(Begun { file, path })
}

fn text<E: Export>(export: &mut E, name: &str, content: &str) -> Result<(), E::Error> {
    let begun = create(export, name)?;
    std::fs::write(&begun.path, content).map_err(Problem::io(&begun.path))?;
    export.finished(name)
}

fn pretty(value: &Value) -> String {
    format!("{value:#}\n")
}

/// A count as the format holds it.
fn number(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

#[expect(clippy::cast_precision_loss, reason = "the format holds seconds in single precision")]
fn number_f32(count: usize) -> f32 {
    count as f32
}

#[expect(clippy::cast_possible_truncation, reason = "the format holds w in single precision")]
fn narrow(w: f64) -> f32 {
    w as f32
}

#[cfg(test)]
mod tests;
