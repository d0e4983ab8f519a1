//! Uploads read by a real inspection: accepted and rejected ones, and its limits.

use super::*;
use crate::{data_folder::frames_path, ingest::testing::playing_with};

#[tokio::test]
async fn a_real_recording_is_read_and_its_frames_are_rebuilt_when_torn() {
    let f = real("none", &[]).await;
    let content = recording(&f.task, 20);
    let inspected = f.push(&content).await.unwrap();
    assert_eq!((inspected.episode.steps, inspected.episode.warnings), (20, 0), "{:?}", inspected.report);
    let blob = &inspected.episode.recording;
    let frames = f.ingest.frames(&f.task.spec, blob).await.unwrap();
    let actions = frames.numbers(0..20).await.unwrap().action;
    assert_eq!((actions.len(), actions[19]), (20, -19.0));
    let cache = frames_path(f.dir.path(), blob, &f.task.spec);
    let whole = fs::read(&cache).unwrap();
    for torn in [Some(whole.len() / 2), None] {
        match torn {
            Some(size) => fs::write(&cache, &whole[..size]).unwrap(),
            None => fs::remove_file(&cache).unwrap(),
        }
        let opened = f.ingest.frames(&f.task.spec, blob).await.unwrap();
        assert_eq!(opened.numbers(0..20).await.unwrap().action, actions);
        assert!(fs::read(&cache).unwrap() == whole);
        // Readers that opened it before go on, whatever happened to the file since.
        match torn {
            Some(at) => {
                let mut changed = whole.clone();
                changed[at] ^= 1;
                fs::write(&cache, changed).unwrap();
            }
            None => fs::remove_file(&cache).unwrap(),
        }
        assert_eq!(frames.numbers(0..20).await.unwrap().action, actions);
        assert!(fs::read(&cache).unwrap() == whole);
    }
}

#[tokio::test]
async fn a_file_that_is_not_a_recording_is_rejected_with_a_fix() {
    let f = real("none", &[]).await;
    for content in [&b"recording"[..], &recording(&f.task, 20)[..200]] {
        let error = f.push(content).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{error}");
        assert!(error.message().starts_with("recording: "), "{error}");
        assert!(!error.message().contains(f.dir.path().to_str().unwrap()), "{error}");
    }
    assert!(f.files(&["uploads", "blobs", "cache", "tmp"]).is_empty());
}

#[tokio::test]
async fn a_recording_that_exceeds_a_limit_is_rejected_and_not_kept() {
    for (misbehaviour, expected) in [
        ("memory", "more than 64 MiB of memory"),
        ("reserve", "more than 64 MiB of memory"),
        ("disk", "decoded images take more than 64 MiB"),
        ("panic", "its reader crashed"),
    ] {
        let f = real(misbehaviour, &["--inspect-memory-bytes", "67108864", "--inspect-seconds", "60"]).await;
        let error = f.push(b"recording").await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{misbehaviour}: {error}");
        assert!(error.message().contains(expected), "{misbehaviour}: {error}");
        assert!(f.store.uploads().await.unwrap().is_empty());
        assert!(f.files(&["uploads", "blobs", "cache", "tmp"]).is_empty(), "{misbehaviour}");
    }
}

#[tokio::test]
async fn an_endless_recording_is_rejected_in_time() {
    for misbehaviour in ["spin", "wait"] {
        let f = real(misbehaviour, &["--inspect-seconds", "1"]).await;
        let error = f.push(b"recording").await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{misbehaviour}: {error}");
        assert!(error.message().contains("more than 1 s"), "{misbehaviour}: {error}");
    }
}

/// One second by the flag, and the pictures that it states add 30.
#[tokio::test]
async fn an_inspection_has_the_time_that_it_states() {
    let f = playing_with(&format!("echo 31; sleep 1.5; {USABLE}"), &["--inspect-seconds", "1"]).await;
    f.push(b"recording").await.unwrap();
    let f = playing_with("echo nothing; exec sleep 30", &["--inspect-seconds", "1"]).await;
    let error = f.push(b"recording").await.unwrap_err();
    assert!(error.message().contains("more than 1 s"), "{error}");
}

#[test]
fn processor_time_is_limited_without_a_watching_parent() {
    use std::{os::unix::process::ExitStatusExt as _, process::Command};

    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let command = child("spin");
    let status = Command::new(&command[0])
        .args(&command[1..])
        .args(["--recording", &file("r"), "--spec", &file("s"), "--report", &file("p"), "--frames", &file("f")])
        .args(["--memory-bytes", "67108864", "--seconds", "1"])
        .stdout(std::process::Stdio::null())
        .status()
        .unwrap();
    assert_eq!(status.signal(), Some(rustix::process::Signal::XCPU.as_raw()), "{status}");
}

/// The decoded steps of a recording may take more than its size. Once the disk is full, those of others make room.
#[tokio::test]
async fn a_disk_that_fills_while_the_cache_is_written_is_cleared_of_other_caches() {
    let full = r#"printf '{"full":"no space left on device"}' > "$report""#;
    let others = r#"ls "${frames%/tmp/*}"/cache/*.frames > "$report" 2>&1"#;
    let f = playing(&format!("if {others}; then {full}; else {USABLE}; fi")).await;
    let other = frames_path(f.dir.path(), &blake3::hash(b"other").into(), &f.task.spec);
    fs::write(&other, b"decoded").unwrap();
    let stored = f.push(b"recording").await.unwrap().episode;
    assert!(!other.exists() && frames_path(f.dir.path(), &stored.recording, &f.task.spec).exists());

    let f = playing(full).await;
    let error = f.push(b"recording").await.unwrap_err();
    assert!(error.kind() == Kind::Exhausted && error.message().contains("disk"), "{error}");
    assert_eq!(f.store.uploads().await.unwrap().len(), 1, "it can be finished once there is room");
}
