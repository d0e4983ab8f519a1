//! Writes the files of a large lab into a data folder: small recordings, each with its decoded steps in the cache.
//!
//! `recordings DATA_DIR SPEC SCRATCH FIRST COUNT STEPS` reads a task as JSON and prints the digest and the size of each
//! recording. Files are not synced, so that 100,000 take minutes; SCRATCH is a folder in memory for files that the
//! library syncs. Recordings are numbered from FIRST; a number always gives the same recording. `benches/lab` adds the rows.
#![allow(clippy::expect_used, reason = "a tool of a bench, which ends at the first fault")]

use std::{
    io::{BufWriter, Cursor, Write as _},
    path::Path,
};

use gleaner_data_folder::{blobs::Blobs, frames_path};
use gleaner_recording::{
    CameraRef, EpisodeWriter, ImageRef, ImageThreads, Limits, ObservationRef, PixelFormat, TaskSpec, cache_episode,
};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, data_dir, spec, scratch, first, count, steps] = arguments.as_slice() else {
        std::process::exit(2);
    };
    let spec = std::fs::read(spec).expect("SPEC can be read");
    let spec: TaskSpec = serde_json::from_slice(&spec).expect("SPEC is a task");
    let number = |text: &String| text.parse::<u64>().expect("FIRST, COUNT and STEPS are numbers");
    let (first, count, steps) = (number(first), number(count), number(steps));
    let (data_dir, scratch) = (Path::new(data_dir), Path::new(scratch));
    let blobs = Blobs::at(data_dir).expect("the settings of a bucket can be used");
    let mut out = BufWriter::new(std::io::stdout().lock());
    for episode in first..first + count {
        let recording = recording(&spec, episode, steps);
        let id = blake3::hash(&recording).into();
        let place = blobs.path(&id);
        std::fs::create_dir_all(place.parent().expect("a blob lies in a folder")).expect("the folder can be made");
        std::fs::write(&place, &recording).expect("the disk has room");
        let decoded = scratch.join("decoded");
        cache_episode(&place, &spec, (&Limits::ADMITTED, ImageThreads::NONE), &decoded)
            .expect("the recording is sound and SCRATCH has room");
        std::fs::copy(&decoded, frames_path(data_dir, &id, &spec)).expect("the disk has room");
        writeln!(out, "{id} {}", recording.len()).expect("standard output can be written");
    }
}

/// A recording whose images have one color each and whose numbers are a walk at random.
fn recording(spec: &TaskSpec, episode: u64, steps: u64) -> Vec<u8> {
    let mut chance = Chance(episode);
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), spec).expect("the task can be written");
    let mut proprioception = vec![0.0; spec.proprioception_size()];
    for step in 0..steps {
        let action: Vec<f32> = (0..spec.action_size()).map(|_| chance.next()).collect();
        let images: Vec<Vec<u8>> = spec
            .cameras
            .iter()
            .map(|camera| vec![u8::try_from(step % 251).unwrap_or(0); (camera.height * camera.width * 3) as usize])
            .collect();
        let color = |data| CameraRef { color: ImageRef { format: PixelFormat::Rgb8, data }, depth: None };
        let cameras: Vec<CameraRef<'_>> = images.iter().map(|image| color(image)).collect();
        let stamp = 1_700_000_000_000_000_000 + i64::try_from(step).unwrap_or(0) * 100_000_000;
        let observation = ObservationRef { cameras: &cameras, proprioception: &proprioception };
        writer.observe(stamp, observation).expect("the observation fits the task");
        writer.act(stamp, &action).expect("the action fits the task");
        proprioception.iter_mut().zip(action.iter().cycle()).for_each(|(state, moved)| *state += 0.1 * moved);
    }
    writer.finish().expect("a recording in memory can be written").into_inner()
}

/// Reproducible numbers between -1 and 1: `SplitMix64`.
struct Chance(u64);

impl Chance {
    #[expect(clippy::cast_precision_loss, reason = "24 bits fit")]
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D).wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }
}
