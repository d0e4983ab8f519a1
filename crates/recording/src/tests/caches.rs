//! Caches of recordings: the same bytes with any number of threads, and a full disk.

use std::io::ErrorKind;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::json;

use super::scene::{Scene, numbers_only, read_bytes};
use super::video::{Film, task};
use crate::{
    CameraSource, CameraSpec, FindingCode, ImageThreads, Limits, RecordingError, Report, TaskSpec, cache_episode,
    encode_jpeg,
};

/// The task of a camera with video, one with JPEG, and one that shows the same video.
fn cameras() -> TaskSpec {
    let mut spec = task();
    for (name, topic) in [("wrist", "/wrist/color"), ("again", "/front/color")] {
        spec.cameras.push(CameraSpec { name: name.into(), ..spec.cameras[0].clone() });
        spec.mappings[0].cameras.push(CameraSource { camera: name.into(), color: topic.into(), depth: None });
    }
    spec
}

/// A picture for each step of both topics; the JPEG camera repeats some, and two of its pictures are broken.
fn scene(name: &str, broken: &[usize]) -> Scene {
    let film = Film::read(name);
    let mut scene = film.scene();
    for step in 0..film.messages.len() {
        let rgb = [u8::try_from(step / 2 * 20).unwrap(), 90, 30].repeat(48 * 64);
        let mut jpeg = encode_jpeg(&rgb, 48, 64, 90).unwrap();
        if broken.contains(&step) {
            jpeg.truncate(40);
        }
        let ms = 1000 + i64::try_from(step).unwrap() * 100;
        scene.add("/wrist/color", ms, json!({"format": "jpeg", "data": STANDARD.encode(jpeg)}));
    }
    scene
}

fn cached(path: &Path, threads: ImageThreads) -> Result<(Vec<u8>, Report), RecordingError> {
    let cache = path.with_extension("frames");
    let report = cache_episode(path, &cameras(), (&Limits::default(), threads), &cache)?;
    Ok((std::fs::read(&cache).unwrap(), report))
}

#[test]
fn a_cache_has_the_same_bytes_with_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for name in ["h264_baseline", "h264_b_frames", "h265_low_delay", "av1_aom"] {
        std::fs::write(&path, scene(name, &[]).mcap()).unwrap();
        let (bytes, report) = cached(&path, ImageThreads::NONE).unwrap();
        // Without room for a second picture, with room for some, and with room for all.
        for (count, room) in [(2, 0), (3, 300_000), (5, 1 << 30)] {
            let (again, found) = cached(&path, ImageThreads { count, bytes: room }).unwrap();
            assert!(bytes == again, "{name}, {count} threads");
            assert_eq!(found, report, "{name}, {count} threads");
        }
    }
}

#[test]
fn findings_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, scene("h264_baseline", &[3, 7]).mcap()).unwrap();
    let refused = |threads| {
        let Err(RecordingError::Rejected(report)) = cached(&path, threads) else { panic!("accepted") };
        *report
    };
    let report = refused(ImageThreads::NONE);
    assert_eq!((report.findings[0].code, report.findings[0].first_step), (FindingCode::BrokenImage, Some(3)));
    for count in [2, 4] {
        assert_eq!(refused(ImageThreads { count, bytes: 1 << 30 }), report);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no cache is left");
}

/// A device of the system on which every write fails as on a full disk stands for the file that is written.
#[test]
#[cfg(target_os = "linux")]
fn a_disk_that_fills_while_a_cache_is_written_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, scene("h264_baseline", &[]).mcap()).unwrap();
    // Other tests of this process write files too, so the number in the name of the partial file is not known.
    for number in 0..20_000 {
        let partial = folder.path().join(format!("a.frames.{}-{number}.partial", std::process::id()));
        std::os::unix::fs::symlink("/dev/full", partial).unwrap();
    }
    for threads in [ImageThreads::NONE, ImageThreads { count: 3, bytes: 1 << 30 }] {
        let Err(RecordingError::Io { source, .. }) = cached(&path, threads) else { panic!("written") };
        assert_eq!(source.kind(), ErrorKind::StorageFull);
        assert!(!path.with_extension("frames").exists());
    }
}

#[test]
fn messages_larger_than_a_chunk_are_read() {
    let scene = Scene::steps(6);
    let whole = read_bytes(&scene.mcap(), &numbers_only()).unwrap();
    for size in [1, 100, 1 << 20] {
        for compression in [None, Some(mcap::Compression::Zstd), Some(mcap::Compression::Lz4)] {
            let options = mcap::WriteOptions::new().chunk_size(Some(size)).compression(compression);
            let reading = read_bytes(&scene.written(options), &numbers_only()).unwrap();
            assert_eq!(reading.episode.stamps(), whole.episode.stamps());
            assert_eq!(reading.episode.proprioception(), whole.episode.proprioception());
            assert_eq!(reading.report.findings, []);
        }
    }
}
