//! Files of an export: the room that they leave, and when they become blobs.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use super::*;
use crate::monitor;

fn task() -> TaskSpec {
    serde_json::from_value(serde_json::json!({
        "name": "reach", "rate_hz": 10.0, "mappings": [], "cameras": [],
        "proprioception": [{ "name": "joints", "size": 2 }],
        "action": [{ "name": "command", "size": 1 }],
    }))
    .unwrap()
}

fn inputs() -> Inputs {
    Inputs {
        task: task(),
        experts: Vec::new(),
        imperfect: Vec::new(),
        kept: Vec::new(),
        encoder: None,
        checkpoint: None,
        segment_length: 0,
        origin: BTreeMap::new(),
        policy: None,
        base: None,
    }
}

/// An export without pieces, whose files are in the data folder itself.
fn export<'a>(dir: &'a Path, blobs: &'a Blobs, inputs: &'a Inputs, monitor: &'a mut Watcher) -> Files<'a> {
    Files {
        folder: dir,
        blobs,
        inputs,
        monitor,
        episodes: Episodes::new(blobs.clone(), task()),
        pieces: Vec::new(),
        open: None,
        files: Vec::new(),
        written: keeps_files(dir).then(Vec::new),
        done: 0,
    }
}

#[test]
fn an_export_leaves_the_room_that_must_stay_free() {
    let dir = tempfile::tempdir().unwrap();
    let free = Arc::new(AtomicU64::new(100));
    let blobs = Blobs::open(dir.path()).unwrap().sparing(100).playing(&free);
    let (inputs, (mut monitor, _events)) = (inputs(), monitor::channel(blobs.clone()));
    let mut files = export(dir.path(), &blobs, &inputs, &mut monitor);
    let derived = dir.path().join(gleaner_data_folder::CACHE);
    fs::create_dir(&derived).unwrap();
    let derived = derived.join(format!("{}-00.frames", blake3::hash(b"recording").to_hex()));
    fs::write(&derived, [0; 10]).unwrap();
    files.advance().unwrap();
    assert!(derived.exists(), "there was room");
    free.store(95, Ordering::Relaxed);
    files.advance().unwrap();
    assert_eq!((derived.exists(), free.load(Ordering::Relaxed)), (false, 105));
    free.store(99, Ordering::Relaxed);
    files.monitor.stop().cancel();
    assert_eq!(files.wait_for_room(), Err(Failure::Cancelled));
}

#[test]
fn an_export_that_does_not_end_leaves_no_blob() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let (inputs, (mut monitor, _events)) = (inputs(), monitor::channel(blobs.clone()));
    let mut files = export(dir.path(), &blobs, &inputs, &mut monitor);
    for name in ["one.mcap", "two.mcap"] {
        fs::write(dir.path().join(name), name).unwrap();
        files.finished(name).unwrap();
    }
    assert!(blobs.list().unwrap().is_empty());
    files.store().unwrap();
    let stored = files.files.iter().map(|file| (file.name.as_str(), file.size_bytes, blobs.get(&file.blob).unwrap()));
    let expected = ["one.mcap", "two.mcap"].map(|name| (name, 8, name.as_bytes().to_vec()));
    assert_eq!(stored.collect::<Vec<_>>(), expected);
    files.written = Some(Vec::new());
    fs::write(dir.path().join("three.mcap"), "three").unwrap();
    files.finished("three.mcap").unwrap();
    files.monitor.stop().cancel();
    assert_eq!(files.store(), Err(Failure::Cancelled));
    assert_eq!(blobs.list().unwrap().len(), 2);
}

/// Of a bucket or a second disk: the folder's own disk may be smaller than the export.
#[test]
fn files_that_leave_their_disk_are_stored_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let blobs = Blobs::open(dir.path()).unwrap();
    let (inputs, (mut monitor, _events)) = (inputs(), monitor::channel(blobs.clone()));
    let mut files = Files { written: None, ..export(dir.path(), &blobs, &inputs, &mut monitor) };
    fs::write(dir.path().join("one.mcap"), "one").unwrap();
    files.finished("one.mcap").unwrap();
    assert_eq!(blobs.get(&files.files[0].blob).unwrap(), b"one");
    fs::write(dir.path().join("blob-store.json"), "{}").unwrap();
    assert!(!keeps_files(dir.path()));
}
