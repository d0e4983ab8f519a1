//! Frame caches that a job reads: the same steps as in memory, also when a cache disappears or is damaged
//! meanwhile.

use std::{fs, path::PathBuf};

use gleaner_core::episode::Outcome;
use gleaner_core::id::{BlobId, EpisodeId};
use gleaner_core::{OptimSpec, PretrainSpec};
use gleaner_data_folder::frames_path;
use gleaner_learn::{Silent, pretrain};
use gleaner_recording::{Episode, EpisodeWriter, StepRef};

use super::*;

fn input(recording: BlobId, steps: u64) -> InputEpisode {
    let (file_name, cohort) = (String::new(), String::new());
    InputEpisode { id: EpisodeId::new(), recording, steps, file_name, outcome: Outcome::Unknown, cohort }
}

/// A task of 16 × 16 pixels, and an episode of twelve steps of it in a data directory.
struct Lab {
    folder: tempfile::TempDir,
    task: TaskSpec,
    input: InputEpisode,
}

impl Lab {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["blobs", "tmp", "cache"] {
            fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        let task: TaskSpec = serde_json::from_value(serde_json::json!({
            "name": "reach", "rate_hz": 10.0, "mappings": [],
            "cameras": [{ "name": "front", "height": 16, "width": 16, "depth": true }],
            "proprioception": [{ "name": "joints", "size": 2 }],
            "action": [{ "name": "command", "size": 1 }],
        }))
        .unwrap();
        let mut writer = EpisodeWriter::create(std::io::Cursor::new(Vec::new()), &task).unwrap();
        for step in 0..12_u8 {
            let frames: Vec<u8> = (0..200_u8).cycle().take(16 * 16 * 5).map(|at| at + step).collect();
            let value = f32::from(step);
            let step_ref = StepRef { frames: &frames, proprioception: &[value, -value], action: &[value] };
            writer.step(i64::from(step) * 100_000_000, step_ref).unwrap();
        }
        let bytes = writer.finish().unwrap().into_inner();
        let recording: BlobId = Blobs::open(folder.path()).unwrap().put(&bytes).unwrap();
        let input = input(recording, 12);
        Self { folder, task, input }
    }

    fn episodes(&self) -> Episodes {
        let blobs = Blobs::open(self.folder.path()).unwrap();
        Episodes::new(blobs, self.task.clone())
    }

    fn cache(&self) -> PathBuf {
        frames_path(self.folder.path(), &self.input.recording, &self.task)
    }
}

fn frames(of: &Stored) -> Vec<u8> {
    let mut frames = vec![0; 12 * of.widths().frame_bytes];
    of.frames(0..12, &mut frames).unwrap();
    frames
}

#[test]
fn an_episode_is_read_again_after_its_cache_is_evicted_or_damaged() {
    let lab = Lab::new();
    let stored = lab.episodes().stored(&lab.input).unwrap();
    let before = (frames(&stored), stored.numbers(0..12).unwrap());
    let whole = fs::read(lab.cache()).unwrap();
    fs::remove_file(lab.cache()).unwrap();
    assert!(frames(&stored) == before.0);
    assert!(fs::read(lab.cache()).unwrap() == whole, "the same recording gives the same file");
    for at in [whole.len() - 1, whole.len() / 2, 100] {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x40;
        fs::write(lab.cache(), damaged).unwrap();
        assert!((frames(&stored), stored.numbers(0..12).unwrap()) == before, "byte {at}");
        assert!(fs::read(lab.cache()).unwrap() == whole);
    }
    // A file of an earlier version.
    let mut earlier = whole.clone();
    earlier[8] -= 1;
    fs::write(lab.cache(), earlier).unwrap();
    assert!(frames(&lab.episodes().stored(&lab.input).unwrap()) == before.0);
    assert!(fs::read(lab.cache()).unwrap() == whole);
    fs::write(lab.cache(), &whole[..whole.len() / 3]).unwrap();
    assert!(frames(&lab.episodes().stored(&lab.input).unwrap()) == before.0);
}

/// Steps of two cameras with a slope, an edge and noise, as a cache of their own.
fn drawn(lab: &Lab, seed: u32, side: u32, steps: u32) -> (InputEpisode, Trajectory) {
    let mut state = seed + 1;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        u8::try_from(state >> 29).unwrap()
    };
    let mut frames = Vec::new();
    for step in 0..steps {
        for at in 0..2 * side * side {
            let (row, column) = (at / side % side, at % side);
            let edge = if (column + step + seed) / 9 % 2 == row / 11 % 2 { 70 } else { 0 };
            let base = 40 + edge + u8::try_from(row * 60 / side).unwrap();
            frames.extend([base + noise(), base / 2 + noise(), 90 + noise()]);
        }
    }
    let values = |width: u32| -> Vec<f32> { (0..steps * width).map(|at| ((at * 37 + seed) % 101) as f32).collect() };
    let (m, a) = (values(2), values(1));
    let stamps = (0..steps).map(|step| i64::from(step) * 100_000_000).collect();
    let recording = BlobId::from(blake3::hash(&seed.to_le_bytes()));
    let input = input(recording, steps.into());
    let episode = Episode::new(&lab.task, stamps, m.clone(), a.clone(), frames.clone()).unwrap();
    episode.write_cache(&lab.task, &frames_path(lab.folder.path(), &input.recording, &lab.task)).unwrap();
    let in_memory = Trajectory::new(&(&lab.task).into(), input.id.as_str(), frames, m, a).unwrap();
    (input, in_memory)
}

#[test]
fn a_training_from_caches_gives_the_bytes_of_one_from_memory() {
    let mut lab = Lab::new();
    let mut camera = lab.task.cameras[0].clone();
    camera.depth = false;
    lab.task.cameras = vec![camera.clone(), gleaner_recording::CameraSpec { name: "hand".into(), ..camera }];
    let (inputs, in_memory): (Vec<_>, Vec<_>) = (0..6).map(|seed| drawn(&lab, seed, 16, 40)).unzip();
    let cached = lab.episodes().trajectories(&inputs).unwrap();
    let optim = OptimSpec { steps: 2, ..OptimSpec::default() };
    let spec = PretrainSpec { optim, threads: Some(1), ..PretrainSpec::default() };
    let train = |data: &[Trajectory]| pretrain(&(&lab.task).into(), data, &spec, None, None, &mut Silent).unwrap();
    assert!(train(&in_memory) == train(&cached));
}

#[test]
fn an_episode_without_its_recording_is_named() {
    let lab = Lab::new();
    let stored = lab.episodes().stored(&lab.input).unwrap();
    fs::remove_file(lab.cache()).unwrap();
    fs::remove_dir_all(lab.folder.path().join("blobs")).unwrap();
    let error = stored.numbers(0..1).unwrap_err().to_string();
    assert!(error.contains(lab.input.id.as_str()), "{error}");
    let other = InputEpisode { steps: 11, ..Lab::new().input };
    assert!(matches!(lab.episodes().stored(&other), Err(Failure::Retryable(_))));
}

#[test]
fn many_episodes_are_opened_in_order_and_the_first_failure_is_returned() {
    let lab = Lab::new();
    let mut inputs: Vec<InputEpisode> =
        (0..3 * OPENING).map(|_| InputEpisode { id: EpisodeId::new(), ..lab.input.clone() }).collect();
    let opened = lab.episodes().trajectories(&inputs).unwrap();
    assert!(opened.iter().map(|one| one.id.as_str()).eq(inputs.iter().map(|input| input.id.as_str())));
    assert!(lab.episodes().trajectories(&[]).unwrap().is_empty());
    for (at, steps) in [(7, 11), (20, 10)] {
        inputs[at].steps = steps;
    }
    let refused = lab.episodes().trajectories(&inputs).unwrap_err();
    assert!(matches!(&refused, Failure::Permanent(why) if why.contains("it had 11")), "{refused:?}");
}

#[test]
fn an_episode_of_another_length_is_refused() {
    let lab = Lab::new();
    let other = InputEpisode { steps: 11, ..lab.input.clone() };
    let refused = lab.episodes().stored(&other).map(|_| ()).unwrap_err();
    assert!(matches!(&refused, Failure::Permanent(why) if why.contains("reads as 12 steps now")), "{refused:?}");
}

#[test]
fn steps_are_in_the_node_folder_and_those_of_the_server_are_copied() {
    let (lab, node) = (Lab::new(), tempfile::tempdir().unwrap());
    let expected = frames(&lab.episodes().stored(&lab.input).unwrap());
    let whole = fs::read(lab.cache()).unwrap();
    let blobs = || Blobs::open(lab.folder.path()).unwrap().caching_in(node.path()).unwrap();
    let read = || frames(&Episodes::new(blobs(), lab.task.clone()).stored(&lab.input).unwrap());
    let copy = frames_path(node.path(), &lab.input.recording, &lab.task);
    assert!(read() == expected && fs::read(&copy).unwrap() == whole);
    // They are made here where the server has none or damaged ones.
    let damaged = whole.get(..whole.len() / 2).unwrap();
    for of_server in [None, Some(damaged)] {
        fs::remove_file(&copy).unwrap();
        match of_server {
            Some(bytes) => fs::write(lab.cache(), bytes).unwrap(),
            None => fs::remove_file(lab.cache()).unwrap(),
        }
        assert!(read() == expected && fs::read(&copy).unwrap() == whole);
        assert_eq!(fs::read(lab.cache()).ok().as_deref(), of_server, "the server's files stay as they are");
    }
    // Without the recording only a copy can give the steps.
    fs::remove_dir_all(lab.folder.path().join("blobs")).unwrap();
    fs::create_dir(lab.folder.path().join("blobs")).unwrap();
    fs::remove_file(&copy).unwrap();
    fs::write(lab.cache(), &whole).unwrap();
    assert!(read() == expected);
}

#[test]
fn without_room_in_the_node_folder_steps_are_in_the_data_folder() {
    let (lab, node) = (Lab::new(), tempfile::tempdir().unwrap());
    let expected = frames(&lab.episodes().stored(&lab.input).unwrap());
    fs::remove_file(lab.cache()).unwrap();
    let blobs = Blobs::open(lab.folder.path()).unwrap().caching_in(node.path()).unwrap();
    // Nothing can be written there, whatever the user may do.
    fs::remove_dir(node.path().join("cache")).unwrap();
    fs::write(node.path().join("cache"), b"a file").unwrap();
    let stored = Episodes::new(blobs, lab.task.clone()).stored(&lab.input).unwrap();
    assert!(frames(&stored) == expected && lab.cache().exists());
    fs::remove_file(lab.cache()).unwrap();
    assert!(frames(&stored) == expected, "evicted meanwhile");
}

/// Links to a device of the system on which every write fails as on a full disk stand for the file that is written, and go
/// with the files that make room.
#[test]
#[cfg(target_os = "linux")]
fn a_disk_that_fills_while_steps_are_made_again_is_cleared_of_other_steps() {
    let (lab, node) = (Lab::new(), tempfile::tempdir().unwrap());
    let expected = frames(&lab.episodes().stored(&lab.input).unwrap());
    let of_data = Blobs::open(lab.folder.path()).unwrap();
    let of_node = of_data.caching_in(node.path()).unwrap();
    let other = |folder: &tempfile::TempDir| frames_path(folder.path(), &blake3::hash(b"other").into(), &lab.task);
    for (folder, blobs) in [(&lab.folder, of_data), (&node, of_node)] {
        let _ = fs::remove_file(lab.cache());
        for folder in [&lab.folder, &node] {
            fs::write(other(folder), [0; 10]).unwrap();
        }
        let cache = frames_path(folder.path(), &lab.input.recording, &lab.task);
        // Other tests of this process write files too, so the number in the name of the partial file is not known.
        for number in 0..1000 {
            let partial = format!("{}.{}-{number}.partial", cache.display(), std::process::id());
            std::os::unix::fs::symlink("/dev/full", partial).unwrap();
        }
        assert!(frames(&Episodes::new(blobs, lab.task.clone()).stored(&lab.input).unwrap()) == expected);
        let stayed = [&lab.folder, &node].map(|folder| other(folder).exists());
        assert_eq!(stayed, [folder.path() != lab.folder.path(), folder.path() != node.path()]);
        assert!(cache.exists());
    }
}
