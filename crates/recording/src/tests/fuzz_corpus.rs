//! Every file of the container fuzzer's corpus, read on the stable toolchain: reading does not panic, limits hold, and
//! each file has the outcome that the differential suite recorded.

use std::path::{Path, PathBuf};

use crate::container::{Ending, scan};
use crate::{Limits, RecordingError, TaskSpec, read_episode, read_episode_within, salvage};

/// The corpus, sorted by name.
fn corpus() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/container");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn task() -> TaskSpec {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("differential/task.json");
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The differential suite names its files DAMAGE-OUTCOME; the fuzzer names its own files by digest.
#[test]
fn each_file_is_read_with_the_outcome_in_its_name() {
    let (spec, mut named) = (task(), 0);
    for path in corpus() {
        let reading = read_episode(&path, &spec);
        let name = path.file_name().unwrap().to_str().unwrap();
        let Some((_, outcome)) = name.split_once('-') else { continue };
        named += 1;
        let as_named = match (outcome, &reading) {
            ("refused", Err(_)) => true,
            ("finding", Ok(reading)) => !reading.report.findings.is_empty(),
            ("equal", Ok(reading)) => reading.report.findings.is_empty(),
            _ => false,
        };
        assert!(as_named, "{name}: {:?}", reading.map(|reading| reading.report.findings));
    }
    assert!(named > 40, "{named}");
}

#[test]
fn each_file_is_salvaged_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("whole");
    for path in corpus() {
        if salvage(&path, &out).is_ok() {
            let scanned = scan(&out, &Limits::default(), &mut |_| Ok(())).unwrap();
            assert_eq!((scanned.ending, scanned.problems.as_slice()), (Ending::Whole, &[][..]), "{}", path.display());
        }
    }
}

#[test]
fn limits_hold_for_each_file() {
    let spec = task();
    let narrow = Limits { chunk_bytes: 512, record_bytes: 256, records: 60, channels: 3, ..Limits::default() };
    for path in corpus() {
        let error = read_episode_within(&path, &spec, &narrow).unwrap_err();
        let known = matches!(
            error,
            RecordingError::TooLarge { .. }
                | RecordingError::Damaged { .. }
                | RecordingError::Rejected(_)
                | RecordingError::Empty { .. }
                | RecordingError::NotMcap { .. }
        );
        assert!(known, "{}: {error}", path.display());
    }
}
