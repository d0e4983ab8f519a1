//! An export in memory for tests: drawn recordings, read by the crate that reads real ones.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use gleaner_core::TaskSpec;
use gleaner_core::dataset::{KeptSegment, Nearest};
use gleaner_core::episode::Outcome;
use gleaner_core::id::{BlobId, EpisodeId};
use gleaner_core::work::{InputEpisode, KeptInput};
use gleaner_recording::{Episode, EpisodeWriter, StepRef, read_episode, written_mapping};

use crate::export::{Export, Numbers};
use crate::piece::{Piece, pieces};
use crate::problem::Problem;

/// A task with two cameras, one with depth.
pub(crate) fn task() -> TaskSpec {
    let mut task: TaskSpec = serde_json::from_value(serde_json::json!({
        "name": "reach", "instruction": "reach the cube", "rate_hz": 10.0, "mappings": [],
        "cameras": [
            { "name": "front", "height": 12, "width": 16, "depth": true },
            { "name": "hand", "height": 12, "width": 16, "depth": false },
        ],
        "proprioception": [{ "name": "joints", "size": 2 }, { "name": "gripper", "size": 1 }],
        "action": [{ "name": "command", "size": 2 }],
    }))
    .unwrap();
    task.mappings = vec![written_mapping(&task)];
    task
}

/// A fixed id, so that tests can compare bytes.
fn id(number: u8) -> EpisodeId {
    EpisodeId::parse("id", &format!("ep_01J0000000000000000000000{}", char::from(b'A' + number))).unwrap()
}

fn input(number: u8, steps: u64, outcome: Outcome) -> InputEpisode {
    InputEpisode {
        id: id(number),
        recording: BlobId::try_from(format!("{number:064x}")).unwrap(),
        steps,
        file_name: format!("{number}.mcap"),
        outcome,
        cohort: if outcome == Outcome::Success { "clean" } else { "noisy" }.to_owned(),
    }
}

/// The kept steps of an imperfect episode, each with its q.
pub(crate) fn kept_input(steps: u64, kept: &[(u32, f32)]) -> KeptInput {
    let segment = |&(end_step, weight): &(u32, f32)| KeptSegment {
        end_step,
        weight,
        nearest: Some(Nearest { episode_id: id(1), end_step: end_step + 1 }),
    };
    let count = usize::try_from(steps).unwrap();
    let mut qualities = vec![0.25; count];
    kept.iter().for_each(|&(step, q)| qualities[step as usize] = q);
    KeptInput {
        episode: input(2, steps, Outcome::Failure),
        segments: kept.iter().map(segment).collect(),
        similarities: (0..count).map(|step| -(step as f64)).collect(),
        qualities,
    }
}

/// Two experts of 8 and 6 steps, and steps 2 to 4 and 7 of a failed episode of 9.
pub(crate) struct Lab {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) out: tempfile::TempDir,
    pub(crate) files: Vec<String>,
    /// Pieces after which the work should stop.
    pub(crate) stop_after: usize,
    task: TaskSpec,
    origin: BTreeMap<String, String>,
    pieces: Vec<Piece>,
    scratch: tempfile::TempDir,
}

/// The error of the lab.
#[derive(Debug)]
pub(crate) enum Stop {
    Asked,
    Problem(Problem),
}

impl From<Problem> for Stop {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl Lab {
    /// Small pictures with sharp edges.
    pub(crate) fn new() -> Self {
        Self::of(task(), |at, step| if at % 7 < 3 { step * 20 } else { 255 - step * 20 })
    }

    /// Pictures that video takes, with even colors that grow brighter from step to step.
    pub(crate) fn smooth() -> Self {
        let mut task = task();
        for camera in &mut task.cameras {
            (camera.height, camera.width) = (32, 48);
        }
        task.mappings = vec![written_mapping(&task)];
        Self::of(task, |at, step| 30 + step * 20 + u8::try_from(at / 3 % 48 / 2).unwrap())
    }

    /// A lab whose frames have this byte at a place in a step.
    fn of(task: TaskSpec, byte: fn(usize, u8) -> u8) -> Self {
        let (folder, out, scratch) =
            (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let experts = vec![input(0, 8, Outcome::Success), input(1, 6, Outcome::Success)];
        let kept = kept_input(9, &[(2, 0.9), (3, 0.8), (4, 0.95), (7, 0.7)]);
        for episode in experts.iter().chain([&kept.episode]) {
            record(&folder.path().join(format!("{}.mcap", episode.id)), &task, episode.steps, byte);
        }
        let origin = BTreeMap::from([("dataset".to_owned(), "ds_1".to_owned())]);
        let pieces = pieces(experts, vec![kept], false).unwrap();
        Self { folder, out, files: Vec::new(), stop_after: usize::MAX, task, origin, pieces, scratch }
    }

    /// The steps of a piece's episode as the recording crate reads them.
    pub(crate) fn episode(&self, piece: usize) -> Episode {
        read_episode(&self.recording(piece).unwrap(), &self.task).unwrap().episode
    }

    pub(crate) fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.out.path().join(name)).unwrap()
    }
}

/// Writes a recording whose pictures and numbers differ from step to step.
fn record(path: &Path, task: &TaskSpec, steps: u64, byte: fn(usize, u8) -> u8) {
    let mut writer = EpisodeWriter::create(File::create(path).unwrap(), task).unwrap();
    let frame = gleaner_recording::frame_bytes_per_step(task);
    for step in 0..steps {
        let value = step as f32;
        let frames: Vec<u8> = (0..frame).map(|at| byte(at, u8::try_from(step).unwrap())).collect();
        let step_ref = StepRef { frames: &frames, proprioception: &[value, -value, 0.5], action: &[value * 0.1, 1.0] };
        writer.step(i64::try_from(step).unwrap() * 100_000_000 + 1_000_000_000, step_ref).unwrap();
    }
    writer.finish().unwrap();
}

impl Export for Lab {
    type Error = Stop;

    fn task(&self) -> &TaskSpec {
        &self.task
    }

    fn origin(&self) -> &BTreeMap<String, String> {
        &self.origin
    }

    fn segment_length(&self) -> u32 {
        3
    }

    fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    #[expect(refining_impl_trait, reason = "tests read the path")]
    fn recording(&self, piece: usize) -> Result<PathBuf, Stop> {
        Ok(self.folder.path().join(format!("{}.mcap", self.pieces[piece].episode().id)))
    }

    fn numbers(&mut self, piece: usize) -> Result<Numbers, Stop> {
        let (episode, steps) = (self.episode(piece), &self.pieces[piece].steps);
        let of = |values: Vec<f32>, size: usize| values[steps.start * size..steps.end * size].to_vec();
        Ok(Numbers { proprioception: of(episode.proprioception(), 3), action: of(episode.action(), 2) })
    }

    fn frames(&mut self, piece: usize, step: usize) -> Result<Vec<u8>, Stop> {
        let frame = gleaner_recording::frame_bytes_per_step(&self.task);
        Ok(self.episode(piece).frames().as_ref()[step * frame..(step + 1) * frame].to_vec())
    }

    fn folder(&self) -> &Path {
        self.scratch.path()
    }

    fn finished(&mut self, name: &str) -> Result<(), Stop> {
        let to = self.out.path().join(name);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::rename(self.scratch.path().join(name), to).unwrap();
        self.files.push(name.to_owned());
        Ok(())
    }

    fn finished_recording(&mut self, piece: usize, name: &str) -> Result<(), Stop> {
        std::fs::copy(self.recording(piece).unwrap(), self.out.path().join(name)).unwrap();
        self.files.push(name.to_owned());
        Ok(())
    }

    fn advance(&mut self) -> Result<(), Stop> {
        self.stop_after -= 1;
        if self.stop_after == 0 { Err(Stop::Asked) } else { Ok(()) }
    }
}
