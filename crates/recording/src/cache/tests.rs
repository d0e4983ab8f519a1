//! Tests of whole cache files: what was written is read, and damage is found.

use super::*;
use crate::frames::{Episode, frame_bytes_per_step};
use crate::testing::arm;

/// Four steps; the second and third have the same color image.
fn episode() -> Episode {
    let spec = arm();
    let step_bytes = frame_bytes_per_step(&spec);
    let mut frames: Vec<u8> = (0..4 * step_bytes).map(|at| u8::try_from(at * at % 251).unwrap()).collect();
    frames.copy_within(step_bytes..step_bytes + 8 * 16 * 3, 2 * step_bytes);
    let action = vec![f32::MIN_POSITIVE, -1.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
    Episode::new(&spec, vec![-5, 0, 7, i64::MAX], (0..12u8).map(f32::from).collect(), action, frames).unwrap()
}

/// Six steps of a camera that stands still: 24 bytes of each step's images differ from those of the first.
fn still() -> Episode {
    let spec = arm();
    let first = episode().frames().as_ref()[..frame_bytes_per_step(&spec)].to_vec();
    let frames = (0..6u8).flat_map(|step| {
        let mut frame = first.clone();
        let moved = usize::from(step) * 24;
        frame[moved..moved + 24].fill(step);
        frame
    });
    Episode::new(&spec, (0..6).collect(), vec![0.5; 18], vec![1.0; 12], frames.collect()).unwrap()
}

fn written() -> (tempfile::TempDir, std::path::PathBuf) {
    written_of(&episode())
}

fn written_of(episode: &Episode) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.frames");
    episode.write_cache(&arm(), &path).unwrap();
    (folder, path)
}

/// Everything that a file holds, as a reader sees it.
fn read(path: &Path) -> Result<(Numbers, Vec<u8>), RecordingError> {
    let cache = FrameCache::open(path, &arm())?;
    Ok((cache.numbers(0..cache.steps())?, cache.frames(0..cache.steps())?))
}

#[test]
fn cache_preserves_every_bit() {
    let (folder, path) = written();
    let first = std::fs::read(&path).unwrap();
    episode().write_cache(&arm(), &path).unwrap();
    assert!(std::fs::read(&path).unwrap() == first, "the same steps give the same file");
    let (numbers, frames) = read(&path).unwrap();
    assert_eq!(numbers.stamps, episode().stamps());
    assert_eq!((numbers.proprioception, numbers.action), (episode().proprioception(), episode().action()));
    assert!(frames == episode().frames().as_ref());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn any_steps_are_read_without_the_others() {
    let (_folder, path) = written();
    let cache = FrameCache::open(&path, &arm()).unwrap();
    let (whole, size) = (episode().frames(), cache.frame_bytes());
    for steps in [0..1, 1..3, 2..3, 3..4, 2..2] {
        assert!(cache.frames(steps.clone()).unwrap() == whole.as_ref()[steps.start * size..steps.end * size]);
        let numbers = cache.numbers(steps.clone()).unwrap();
        assert_eq!(numbers.stamps, episode().stamps()[steps.clone()]);
        assert_eq!(numbers.action, episode().action()[2 * steps.start..2 * steps.end]);
    }
    let beyond = cache.frames(3..5).unwrap_err().to_string();
    assert!(beyond.contains("has 4 steps"), "{beyond}");
}

#[test]
fn a_picture_of_several_steps_is_stored_once() {
    let (_folder, path) = written();
    let cache = FrameCache::open(&path, &arm()).unwrap();
    let rows = cache.rows(&File::open(&path).unwrap(), 0..4).unwrap();
    assert_eq!(rows[1].places[0], rows[2].places[0]);
    assert_ne!(rows[1].places[1], rows[2].places[1]);
    assert_ne!(rows[0].places[0], rows[1].places[0]);
}

#[test]
fn pictures_of_a_still_camera_are_differences_and_each_is_read_without_the_others() {
    let (_folder, path) = written_of(&still());
    let cache = FrameCache::open(&path, &arm()).unwrap();
    let rows = cache.rows(&File::open(&path).unwrap(), 0..6).unwrap();
    let (key, difference) = (rows[0].places[0].length, rows[5].places[0].length);
    assert!(2 * difference < key, "{difference} bytes of {key}");
    let (whole, size) = (still().frames(), cache.frame_bytes());
    for begin in 0..6 {
        for end in begin..=6 {
            assert!(cache.frames(begin..end).unwrap() == whole.as_ref()[begin * size..end * size], "{begin}..{end}");
        }
    }
}

#[test]
fn a_damaged_key_is_found_by_the_pictures_that_differ_from_it() {
    let (_folder, path) = written_of(&still());
    let cache = FrameCache::open(&path, &arm()).unwrap();
    let key = cache.rows(&File::open(&path).unwrap(), 0..1).unwrap()[0].places[0];
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[usize::try_from(key.offset).unwrap() + 20] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let error = cache.frames(5..6).unwrap_err();
    assert!(error.is_of_the_cache() && error.to_string().contains("checksum"), "{error}");
}

#[test]
fn an_open_cache_holds_no_file() {
    let (_folder, path) = written();
    let cache = FrameCache::open(&path, &arm()).unwrap();
    std::fs::remove_file(&path).unwrap();
    let gone = cache.frames(0..1).unwrap_err();
    assert!(gone.is_of_the_cache(), "{gone}");
    episode().write_cache(&arm(), &path).unwrap();
    assert_eq!(cache.frames(0..1).unwrap().len(), cache.frame_bytes());
}

/// A task without cameras has steps and no pictures.
#[test]
fn steps_without_images_are_cached() {
    let mut spec = arm();
    spec.cameras.clear();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.frames");
    let numbers = Episode::new(&spec, vec![1, 2], vec![0.5; 6], vec![1.0; 4], Vec::new()).unwrap();
    numbers.write_cache(&spec, &path).unwrap();
    let cache = FrameCache::open(&path, &spec).unwrap();
    assert_eq!((cache.numbers(1..2).unwrap().proprioception, cache.frames(0..2).unwrap()), (vec![0.5; 3], vec![]));
}

#[test]
fn truncated_extended_or_foreign_file_is_refused() {
    let (_folder, path) = written();
    let whole = std::fs::read(&path).unwrap();
    let opens = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        FrameCache::open(&path, &arm()).map(|_| ()).map_err(|error| error.to_string())
    };
    for cut in [0, 7, 15, 40, 130, whole.len() - 1] {
        assert!(opens(&whole[..cut]).is_err(), "cut at {cut}");
    }
    assert!(opens(&[&whole[..], &[0]].concat()).unwrap_err().contains("length"));
    let mut old = whole.clone();
    old[8] = 1;
    assert!(opens(&old).unwrap_err().contains("version 1"));
    assert!(opens(b"something else entirely").unwrap_err().contains("not a frame cache"));
    assert!(opens(&whole).is_ok());
}

#[test]
fn a_changed_byte_anywhere_is_found() {
    for episode in [episode(), still()] {
        let (_folder, path) = written_of(&episode);
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 0x10;
            std::fs::write(&path, &changed).unwrap();
            let error = read(&path).unwrap_err();
            assert!(error.is_of_the_cache(), "byte {at}: {error}");
        }
    }
}
