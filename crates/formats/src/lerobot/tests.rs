//! Tests of the parent module: what it writes, read by the parquet crate.

use std::collections::BTreeMap;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use gleaner_core::dataset::{ExportFormat, ExportSpec};
use gleaner_recording::{PixelFormat, decode_color, decode_depth};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::arrow::parquet_to_arrow_schema;
use serde_json::Value;

use crate::export::Export as _;
use crate::problem::Problem;
use crate::testing::{Lab, Stop};

const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";

fn exported(depth: bool) -> Lab {
    let mut lab = Lab::new();
    crate::write(ExportSpec { format: ExportFormat::Lerobot, depth, ..ExportSpec::default() }, &mut lab).unwrap();
    lab
}

fn table(lab: &Lab, name: &str) -> Vec<RecordBatch> {
    let file = std::fs::File::open(lab.out.path().join(name)).unwrap();
    ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap().map(Result::unwrap).collect()
}

fn whole(batches: &[RecordBatch], name: &str) -> Vec<i64> {
    let column =
        |batch: &RecordBatch| batch.column_by_name(name).unwrap().as_primitive::<Int64Type>().values().to_vec();
    batches.iter().flat_map(column).collect()
}

fn real(batches: &[RecordBatch], name: &str) -> Vec<f32> {
    let column =
        |batch: &RecordBatch| batch.column_by_name(name).unwrap().as_primitive::<Float32Type>().values().to_vec();
    batches.iter().flat_map(column).collect()
}

fn texts(batches: &[RecordBatch], name: &str) -> Vec<String> {
    let column = |batch: &RecordBatch| {
        let column = batch.column_by_name(name).unwrap().as_string::<i32>().clone();
        column.iter().map(|text| text.unwrap().to_owned()).collect::<Vec<_>>()
    };
    batches.iter().flat_map(column).collect()
}

#[test]
fn experts_are_whole_and_each_stretch_is_an_episode() {
    let lab = exported(false);
    assert_eq!(lab.files, [DATA, EPISODES, "meta/tasks.parquet", "meta/info.json", "meta/stats.json", "README.md"]);
    let episodes = table(&lab, EPISODES);
    assert_eq!(whole(&episodes, "length"), [8, 6, 3, 2]);
    assert_eq!(whole(&episodes, "dataset_from_index"), [0, 8, 14, 17]);
    assert_eq!(whole(&episodes, "dataset_to_index"), [8, 14, 17, 19]);
    assert_eq!(whole(&episodes, "gleaner.first_step"), [0, 0, 2, 6]);
    assert_eq!(texts(&episodes, "gleaner.role"), ["expert", "expert", "imperfect", "imperfect"]);
    assert_eq!(texts(&episodes, "gleaner.outcome"), ["success", "success", "failure", "failure"]);
    assert_eq!(texts(&episodes, "gleaner.cohort"), ["clean", "clean", "noisy", "noisy"]);

    let frames = table(&lab, DATA);
    assert_eq!(whole(&frames, "index"), (0..19).collect::<Vec<_>>());
    assert_eq!(whole(&frames, "frame_index")[14..], [0, 1, 2, 0, 1]);
    assert_eq!(whole(&frames, "gleaner.step")[14..], [2, 3, 4, 6, 7]);
    assert_eq!(real(&frames, "gleaner.q")[13..], [1.0, 0.9, 0.8, 0.95, 0.25, 0.7]);
    assert_eq!(real(&frames, "gleaner.weight")[13..], [1.0, 0.9, 0.8, 0.95, 0.0, 0.7]);
    assert_eq!(real(&frames, "gleaner.w")[13..], [0.0, -2.0, -3.0, -4.0, -6.0, -7.0]);
    assert_eq!(real(&frames, "timestamp")[14..17], [0.0, 0.1, 0.2]);
    // The match is a frame of the second expert, which is episode 1.
    assert_eq!(whole(&frames, "gleaner.match_episode")[13..], [-1, 1, 1, 1, -1, 1]);
    assert_eq!(whole(&frames, "gleaner.match_step")[13..], [-1, 3, 4, 5, -1, 8]);
    let success: Vec<bool> = frames
        .iter()
        .flat_map(|batch| {
            batch.column_by_name("next.success").unwrap().as_boolean().iter().flatten().collect::<Vec<_>>()
        })
        .collect();
    assert_eq!(success.iter().filter(|success| **success).count(), 2);
    assert!(success[7] && success[13]);
}

#[test]
fn videos_state_the_times_of_each_episode() {
    let mut lab = Lab::smooth();
    let spec = ExportSpec { format: ExportFormat::Lerobot, video: true, ..ExportSpec::default() };
    crate::write(spec, &mut lab).unwrap();
    let episodes = table(&lab, EPISODES);
    let times = |name: &str| -> Vec<f64> {
        let column = episodes[0].column_by_name(name).unwrap().clone();
        column.as_primitive::<Float64Type>().values().to_vec()
    };
    for camera in ["front", "hand"] {
        let name = |what: &str| format!("videos/observation.images.{camera}/{what}");
        assert_eq!(times(&name("from_timestamp")), [0.0, 0.8, 1.4, 1.7]);
        assert_eq!(times(&name("to_timestamp")), [0.8, 1.4, 1.7, 1.9]);
        assert_eq!(whole(&episodes, &name("file_index")), [0; 4]);
        let file = format!("videos/observation.images.{camera}/chunk-000/file-000.mp4");
        assert!(lab.files.contains(&file), "{:?}", lab.files);
    }
    let info: Value = serde_json::from_slice(&lab.read("meta/info.json")).unwrap();
    assert_eq!(info["features"]["observation.images.hand"]["dtype"], "video");
    assert_eq!(info["video_path"], "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4");
    assert!(table(&lab, DATA).iter().all(|batch| batch.column_by_name("observation.images.hand").is_none()));
    let stats: Value = serde_json::from_slice(&lab.read("meta/stats.json")).unwrap();
    assert_eq!(stats["observation.images.hand"]["count"], serde_json::json!([19]));

    // The small pictures of the other lab are below the least size of a video.
    let refused = crate::write(spec, &mut Lab::new());
    assert!(matches!(refused, Err(Stop::Problem(Problem::Unfit(problem))) if problem.contains("12×16 pixels")));
}

#[test]
fn numbers_and_pictures_are_those_of_the_recording() {
    let lab = exported(true);
    let frames = table(&lab, DATA);
    let (mut action, mut colors, mut depths) = (Vec::new(), Vec::new(), Vec::new());
    let bytes = |batch: &RecordBatch, name: &str| {
        let column = batch.column_by_name(name).unwrap().as_struct().column_by_name("bytes").unwrap().clone();
        column.as_binary::<i32>().iter().map(|bytes| bytes.unwrap().to_vec()).collect::<Vec<_>>()
    };
    for batch in &frames {
        let lists = batch.column_by_name("action").unwrap().as_fixed_size_list();
        action.extend_from_slice(lists.values().as_primitive::<Float32Type>().values());
        colors.extend(bytes(batch, "observation.images.front"));
        depths.extend(bytes(batch, "observation.images.front_depth"));
    }
    // The first stretch begins with step 2 of the third episode.
    let episode = lab.episode(2);
    assert_eq!(action[28..34], episode.action()[4..10]);
    let camera = lab.task().cameras[0].clone();
    let (color, step) = (12 * 16 * 3, gleaner_recording::frame_bytes_per_step(lab.task()));
    let frame = &episode.frames().as_ref().to_vec()[2 * step..3 * step];
    assert!(colors[14].starts_with(&[0xff, 0xd8]), "the recording's own JPEG");
    assert!(decode_color(&colors[14], PixelFormat::Jpeg, &camera.sizes()).unwrap() == frame[..color]);
    assert!(decode_depth(&depths[14], PixelFormat::Png, &camera.sizes()).unwrap() == frame[color..color + 12 * 16 * 2]);
}

#[test]
fn every_declared_feature_is_a_column_with_statistics() {
    for depth in [false, true] {
        let lab = exported(depth);
        let info: Value = serde_json::from_slice(&lab.read("meta/info.json")).unwrap();
        let stats: BTreeMap<String, Value> = serde_json::from_slice(&lab.read("meta/stats.json")).unwrap();
        let declared: Vec<&str> = info["features"].as_object().unwrap().keys().map(String::as_str).collect();
        let frames = table(&lab, DATA);
        let schema = frames[0].schema();
        let mut columns: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
        columns.sort_unstable();
        assert_eq!(columns, declared);
        assert_eq!(stats.keys().map(String::as_str).collect::<Vec<_>>(), declared);
        assert_eq!(declared.contains(&"observation.images.front_depth"), depth);
        assert_eq!(info["features"]["action"]["names"], serde_json::json!(["command.0", "command.1"]));
        assert_eq!((&info["fps"], &info["total_frames"]), (&Value::from(10), &Value::from(19)));
        assert_eq!(stats["observation.images.hand"]["mean"].as_array().map(Vec::len), Some(3));
        assert_eq!(stats["action"]["count"], serde_json::json!([19]));
        let mean = stats["action"]["mean"][1].as_f64().unwrap();
        assert!((mean - 1.0).abs() < 1e-12);
    }
}

#[test]
fn the_text_of_the_task_is_the_index_of_its_table() {
    let lab = exported(false);
    let file = std::fs::File::open(lab.out.path().join("meta/tasks.parquet")).unwrap();
    let reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
    let metadata = reader.metadata().file_metadata().key_value_metadata().unwrap().clone();
    let of_file = metadata.iter().filter(|pair| pair.key == "pandas").filter_map(|pair| pair.value.clone());
    // pyarrow reads the schema that Arrow's writer encodes, and then ignores the file's own metadata.
    let arrow: Vec<_> = metadata.iter().filter(|pair| pair.key == "ARROW:schema").cloned().collect();
    let schema = parquet_to_arrow_schema(reader.parquet_schema(), Some(&arrow)).unwrap();
    let of_arrow = schema.metadata()["pandas"].clone();
    for pandas in of_file.chain([of_arrow]) {
        let pandas: Value = serde_json::from_str(&pandas).unwrap();
        assert_eq!(pandas["index_columns"], serde_json::json!(["task"]));
    }
    assert_eq!(texts(&table(&lab, "meta/tasks.parquet"), "task"), ["reach the cube"]);
}

#[test]
fn the_same_dataset_gives_the_same_bytes() {
    let (one, two) = (exported(true), exported(true));
    assert_eq!(one.files, two.files);
    for name in &one.files {
        assert!(one.read(name) == two.read(name), "{name}");
    }
    let card = String::from_utf8(one.read("README.md")).unwrap();
    assert!(card.contains("dataset: `ds_1`") && card.contains("2 expert episodes"), "{card}");
}

#[test]
fn a_stop_between_episodes_ends_the_export() {
    let mut lab = Lab::new();
    lab.stop_after = 1;
    let stopped = crate::write(ExportSpec { format: ExportFormat::Lerobot, ..ExportSpec::default() }, &mut lab);
    assert!(matches!(stopped, Err(Stop::Asked)));
    assert!(lab.files.is_empty(), "{:?}", lab.files);
}

#[test]
fn a_damaged_recording_is_named() {
    let mut lab = Lab::new();
    std::fs::write(lab.recording(2).unwrap(), b"damaged").unwrap();
    let spec = ExportSpec { format: ExportFormat::Mcap, ..ExportSpec::default() };
    let Err(Stop::Problem(problem)) = crate::write(spec, &mut lab) else { panic!("written") };
    assert!(problem.to_string().contains(lab.pieces()[2].episode().id.as_str()), "{problem}");
}

#[test]
fn a_full_disk_is_reported_with_the_file() {
    let path = std::path::PathBuf::from("/dev/full");
    let begun = super::Begun { file: std::fs::File::options().write(true).open(&path).unwrap(), path };
    let problem = super::tasks::write(begun, "reach").unwrap_err();
    let crate::Problem::Io { path, source } = &problem else { panic!("{problem}") };
    assert_eq!((path.as_path(), source.kind()), (std::path::Path::new("/dev/full"), std::io::ErrorKind::StorageFull));
}
