//! Datasets of other programs in which an input is one of the files, or damages it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use gleaner_formats::import::{Assumed, convert, describe};

use crate::{number, stretch};

/// Files larger than this are damaged by an input, and smaller ones replaced.
pub const MOST_BYTES: u64 = 16 << 10;

/// A dataset in the temporary directory, and the one file of it that an input changes.
struct Case {
    dataset: PathBuf,
    file: PathBuf,
    whole: Vec<u8>,
}

static CASES: LazyLock<Vec<Case>> = LazyLock::new(|| cases().expect("the datasets of the tests can be copied"));

/// The datasets of the tests, and the files of each that an import reads. An input names its file by the number in this
/// list, so new files are added at the end.
const FILES: [(&str, &str); 18] = [
    ("robomimic.hdf5", ""),
    ("lerobot_v21", "data/chunk-000/episode_000000.parquet"),
    ("lerobot_v21", "meta/episodes.jsonl"),
    ("lerobot_v21", "meta/episodes_stats.jsonl"),
    ("lerobot_v21", "meta/info.json"),
    ("lerobot_v21", "meta/tasks.jsonl"),
    ("lerobot_v21", "videos/chunk-000/observation.images.front/episode_000000.mp4"),
    ("lerobot_v30_images", "data/chunk-000/file-000.parquet"),
    ("lerobot_v30_images", "meta/episodes/chunk-000/file-000.parquet"),
    ("lerobot_v30_images", "meta/info.json"),
    ("lerobot_v30_images", "meta/stats.json"),
    ("lerobot_v30_images", "meta/tasks.parquet"),
    ("lerobot_v30_video", "data/chunk-000/file-000.parquet"),
    ("lerobot_v30_video", "meta/episodes/chunk-000/file-000.parquet"),
    ("lerobot_v30_video", "meta/info.json"),
    ("lerobot_v30_video", "meta/stats.json"),
    ("lerobot_v30_video", "meta/tasks.parquet"),
    ("lerobot_v30_video", "videos/observation.images.top/chunk-000/file-000.mp4"),
];

fn dataset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/formats/fixtures").join(name)
}

/// A path within a dataset, which is the dataset where it is empty.
fn within(dataset: &Path, file: &str) -> PathBuf {
    if file.is_empty() { dataset.to_owned() } else { dataset.join(file) }
}

/// The files that inputs change, in the order of their numbers.
pub fn files() -> impl Iterator<Item = PathBuf> {
    FILES.iter().map(|(name, file)| within(&dataset(name), file))
}

/// A copy of its dataset for each file, so that the others stay whole. The copies are those of the process before in the same
/// temporary directory, in which this target therefore runs once at a time.
fn cases() -> std::io::Result<Vec<Case>> {
    let root = std::env::temp_dir().join("gleaner-fuzz-datasets");
    let copied = FILES.iter().enumerate().map(|(at, (name, file))| {
        let copy = root.join(at.to_string());
        copy_all(&dataset(name), &copy)?;
        let file = within(&copy, file);
        Ok(Case { dataset: copy, whole: fs::read(&file)?, file })
    });
    copied.collect()
}

fn copy_all(from: &Path, to: &Path) -> std::io::Result<()> {
    if from.is_file() {
        fs::create_dir_all(to.parent().unwrap_or(to))?;
        return fs::copy(from, to).map(|_| ());
    }
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        copy_all(&path, &to.join(path.file_name().unwrap_or_default()))?;
    }
    Ok(())
}

/// Describes and converts a dataset. The first byte of an input selects the file. A small one has the rest of the input as
/// its content; in a large one stretches overwrite what is at their offsets, each after three bytes of offset.
///
/// # Panics
/// When a dataset gives a recording after an error, or an error without a sentence.
pub fn read(mut input: &[u8]) {
    let case = &CASES[number(&mut input, 1) as usize % CASES.len()];
    if case.whole.len() as u64 <= MOST_BYTES {
        fs::write(&case.file, input).expect("the temporary directory is writable");
    } else {
        let mut damaged = case.whole.clone();
        while !input.is_empty() {
            let at = number(&mut input, 3) as usize % damaged.len();
            for (old, new) in damaged[at..].iter_mut().zip(stretch(&mut input)) {
                *old = *new;
            }
        }
        fs::write(&case.file, damaged).expect("the temporary directory is writable");
    }
    let assumed = Assumed::default();
    let out = std::env::temp_dir().join("gleaner-fuzz-converted.mcap");
    if let Err(error) = describe(&case.dataset, &assumed) {
        assert!(!error.to_string().is_empty());
    }
    match convert(&case.dataset, &assumed, 0, &out) {
        Ok(converted) => assert!(converted.steps > 0 && out.exists(), "{converted:?}"),
        Err(error) => assert!(!error.to_string().is_empty() && !out.exists()),
    }
}
