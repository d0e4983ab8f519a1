//! Datasets that are damaged, incomplete, or contradict themselves: a clear error, and no recording.

use std::fs;
use std::sync::Arc;

use arrow_array::{Array as _, FixedSizeListArray, Float32Array, RecordBatch};
use arrow_schema::DataType;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::*;

/// Copies a dataset.
pub(super) fn copy(from: &Path, to: &Path) {
    if from.is_file() {
        fs::copy(from, to).unwrap();
        return;
    }
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        copy(&path, &to.join(path.file_name().unwrap()));
    }
}

/// A copy of a fixture to be damaged.
struct Copy {
    folder: tempfile::TempDir,
}

impl Copy {
    fn of(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&fixture(name), &folder.path().join("dataset"));
        Self { folder }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("dataset")
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    fn replace(self, name: &str, from: &str, to: &str) -> Self {
        let text = fs::read_to_string(self.file(name)).unwrap();
        assert!(text.contains(from), "{from}");
        fs::write(self.file(name), text.replace(from, to)).unwrap();
        self
    }

    /// The error of the first episode; nothing of it may remain.
    fn refused(&self) -> String {
        let out = self.folder.path().join("out.mcap");
        let described = describe(&self.path(), &Assumed::default()).map(|_| ());
        let converted = convert(&self.path(), &Assumed::default(), 0, &out).map(|_| ());
        assert!(!out.exists());
        described.and(converted.map_err(Undescribed::from)).unwrap_err().to_string()
    }
}

const INFO: &str = "meta/info.json";
const VIDEO: &str = "videos/observation.images.top/chunk-000/file-000.mp4";
const DATA: &str = "data/chunk-000/file-000.parquet";

#[test]
fn contradictions_are_named_with_their_fix() {
    let video = || Copy::of("lerobot_v30_video");
    let images = || Copy::of("lerobot_v30_images");
    let old = || Copy::of("lerobot_v21");
    let cases: [(Copy, &[&str]); 11] = [
        (video().replace(INFO, "\"fps\": 10,", "\"fps\": 30,"), &["30 fps", "correct `fps`"]),
        (old().replace(INFO, "\"fps\": 10,", "\"fps\": 20,"), &["20 fps", "correct `fps`"]),
        (
            images().replace(INFO, "\"dtype\": \"bool\"", "\"dtype\": \"audio\""),
            &["next.success", "\"audio\"", "remove it"],
        ),
        (images().replace(INFO, "v3.0", "v1.6"), &["\"v1.6\"", "v3.0, v2.1, v2.0"]),
        (images().replace(INFO, "\"total_episodes\": 2", "\"total_episodes\": 3"), &["3 episodes", "has 2"]),
        (images().replace(INFO, "data/chunk-", "../data/chunk-"), &["not one within the dataset"]),
        (images().replace(INFO, "\"next.success\"", "\"next.reward\""), &["next.reward", "column is missing"]),
        (images().replace(INFO, "\"action\"", "\"command\""), &["no feature `action`"]),
        (video().replace(INFO, "            48,\n", "            24,\n"), &["48×64", "24×64", "correct its shape"]),
        (old().replace("meta/episodes.jsonl", "\"length\": 12", "\"length\": 11"), &[]),
        (old().replace("meta/episodes.jsonl", "\"length\": 12", "\"length\": 13"), &["step 12", "picture"]),
    ];
    for (at, (copy, parts)) in cases.iter().enumerate() {
        if parts.is_empty() {
            // An episode may use a part of its table's rows, as after a cut of its end.
            assert_eq!(convert(&copy.path(), &Assumed::default(), 0, &copy.file("out.mcap")).unwrap().steps, 11);
            continue;
        }
        let error = copy.refused();
        assert!(parts.iter().all(|part| error.contains(part)), "{at}: {error}");
    }
}

#[test]
fn missing_files_are_named_before_anything_is_converted() {
    for name in [VIDEO, DATA, INFO, "meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"] {
        let copy = Copy::of("lerobot_v30_video");
        fs::remove_file(copy.file(name)).unwrap();
        let error = describe(&copy.path(), &Assumed::default()).unwrap_err().to_string();
        let named = name.rsplit('/').next().unwrap();
        assert!(error.contains(named) || error.contains("meta/episodes"), "{name}: {error}");
    }
}

#[test]
fn cut_and_damaged_files_are_errors_at_every_place() {
    for (name, file) in [
        ("lerobot_v30_video", VIDEO),
        ("lerobot_v30_video", DATA),
        ("lerobot_v30_images", DATA),
        ("lerobot_v30_images", "meta/tasks.parquet"),
        ("robomimic.hdf5", ""),
    ] {
        let copy = Copy::of(name);
        let path = if file.is_empty() { copy.path() } else { copy.file(file) };
        let bytes = fs::read(&path).unwrap();
        for part in 0..40 {
            let mut damaged = bytes[..bytes.len() * part / 40].to_vec();
            fs::write(&path, &damaged).unwrap();
            let error = copy.refused();
            assert!(!error.is_empty() && error.len() < 1000, "{error}");
            // Damage in the middle is an error, or gives other values; it is no panic.
            damaged.extend(bytes[damaged.len()..].iter().map(|byte| byte ^ if part % 2 == 0 { 0xff } else { 0 }));
            let place = bytes.len() * part / 40;
            damaged[place..].copy_from_slice(&bytes[place..]);
            damaged[place] ^= 0x5a;
            fs::write(&path, &damaged).unwrap();
            convert(&copy.path(), &Assumed::default(), 0, &copy.folder.path().join("out.mcap")).ok();
        }
    }
}

#[test]
fn numbers_that_are_not_finite_are_named_by_their_step() {
    let copy = Copy::of("robomimic.hdf5");
    let path = copy.path();
    let bytes = fs::read(&path).unwrap();
    // The exact bytes of the second row of actions of the first demonstration: its numbers in double precision.
    let row: Vec<u8> = [0.025_f32, 0.5, -0.5].iter().flat_map(|value| f64::from(*value).to_le_bytes()).collect();
    let at = bytes.windows(row.len()).position(|window| window == row).unwrap();
    let mut damaged = bytes.clone();
    damaged[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    fs::write(&path, damaged).unwrap();
    let error = copy.refused();
    assert!(error.contains("demo_0") && error.contains("step 1") && error.contains("NaN"), "{error}");
}

/// A file of robosuite has the actions and the simulator's states of a demonstration alone.
fn write_raw(path: &Path) {
    let file = hdf5_pure::File::create(path).unwrap();
    let root = file.root();
    for group in ["data", "data/demo_1"] {
        root.create_group(group).unwrap();
    }
    for name in ["actions", "states"] {
        let made = root.create_dataset(&format!("data/demo_1/{name}"), |dataset| {
            dataset.with_f32_data(&[0.5; 6]).with_shape(&[3, 2]);
        });
        made.unwrap();
    }
    drop(root);
    file.close().unwrap();
}

#[test]
fn a_demonstration_without_observations_is_not_reported_as_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("raw.hdf5");
    write_raw(&path);
    let error = describe(&path, &Assumed::default()).unwrap_err().to_string();
    for part in ["raw.hdf5", "demo_1/obs", "has no observations", "dataset_states_to_obs.py"] {
        assert!(error.contains(part), "{part}: {error}");
    }
    assert!(!error.contains("damaged"), "{error}");
}

#[test]
fn a_table_with_a_number_that_is_not_finite_is_named_by_its_step() {
    let copy = Copy::of("lerobot_v30_images");
    let path = copy.file(DATA);
    let tables = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(&path).unwrap()).unwrap().build().unwrap();
    let tables: Vec<RecordBatch> = tables.map(Result::unwrap).collect();
    let mut writer = ArrowWriter::try_new(fs::File::create(&path).unwrap(), tables[0].schema(), None).unwrap();
    let at = tables[0].schema().index_of("action").unwrap();
    let lists = tables[0].column(at).as_any().downcast_ref::<FixedSizeListArray>().unwrap();
    let mut values = lists.values().as_any().downcast_ref::<Float32Array>().unwrap().values().to_vec();
    values[2 * 3 + 1] = f32::NAN;
    let (field, values) = (arrow_schema::Field::new("element", DataType::Float32, true), Float32Array::from(values));
    let lists = FixedSizeListArray::new(Arc::new(field), 3, Arc::new(values), None);
    let mut columns = tables[0].columns().to_vec();
    columns[at] = Arc::new(lists);
    writer.write(&RecordBatch::try_new(tables[0].schema(), columns).unwrap()).unwrap();
    writer.close().unwrap();

    let error = copy.refused();
    assert!(error.contains("action") && error.contains("step 2") && error.contains("NaN"), "{error}");
}

#[test]
fn other_codecs_are_named() {
    let copy = Copy::of("lerobot_v30_video");
    let bytes = fs::read(copy.file(VIDEO)).unwrap();
    let at = bytes.windows(4).rposition(|window| window == b"av01").unwrap();
    let mut other = bytes.clone();
    other[at..at + 4].copy_from_slice(b"mp4v");
    fs::write(copy.file(VIDEO), other).unwrap();
    let error = copy.refused();
    assert!(error.contains("file-000.mp4") && error.contains("AV1, H.264 or H.265"), "{error}");
}

/// Found by fuzzing: the reader of MP4 stays at a part without a length.
#[test]
fn a_table_without_a_length_ends() {
    let copy = Copy::of("lerobot_v30_video");
    let mut bytes = fs::read(copy.file(VIDEO)).unwrap();
    let at = bytes.windows(4).position(|window| window == b"stsd").unwrap();
    bytes[at - 4..at].fill(0);
    fs::write(copy.file(VIDEO), bytes).unwrap();
    let error = copy.refused();
    assert!(error.contains("file-000.mp4") && error.contains("the video is damaged"), "{error}");
}

/// Found by fuzzing: the reader of parquet skips the values that a page states, also where none is left.
#[test]
fn a_page_of_billions_of_values_ends() {
    let copy = Copy::of("lerobot_v30_video");
    let mut bytes = fs::read(copy.file(DATA)).unwrap();
    // The header of the first page, after the magic number: an unknown field that is a list of 2³¹ − 1 doubles.
    let list = [0xf9, 0xf7, 0xff, 0xff, 0xff, 0xff, 0x07];
    bytes[4..4 + list.len()].copy_from_slice(&list);
    fs::write(copy.file(DATA), bytes).unwrap();
    let error = copy.refused();
    assert!(error.contains("file-000.parquet") && error.contains("the table is damaged"), "{error}");
}
