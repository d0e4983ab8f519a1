//! Tests of the parent module: folders as recorders leave them, whole and with parts missing.

use super::*;

fn folder(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        std::fs::write(folder.path().join(name), b"x").unwrap();
    }
    folder
}

fn names(parts: &[PathBuf]) -> Vec<&str> {
    parts.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect()
}

/// As rosbag2 writes it, version 9 of the format.
fn metadata(files: &[&str], storage: &str) -> String {
    let list: String = files.iter().map(|file| format!("    - {file}\n")).collect();
    let entries: String = files
        .iter()
        .map(|file| {
            format!(
                "    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: 1700000000000000000\n      \
                 duration:\n        nanoseconds: 1000000000\n      message_count: 5\n"
            )
        })
        .collect();
    format!(
        "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: {storage}\n  duration:\n    nanoseconds: 1\n  \
         starting_time:\n    nanoseconds_since_epoch: 1700000000000000000\n  message_count: 15\n  \
         topics_with_message_count:\n    - topic_metadata:\n        name: /joint_states\n        type: \
         sensor_msgs/msg/JointState\n        serialization_format: cdr\n        offered_qos_profiles:\n          - \
         history: keep_last\n            depth: 10\n      message_count: 15\n  compression_format: \"\"\n  \
         compression_mode: \"\"\n  relative_file_paths:\n{list}  files:\n{entries}  custom_data: ~\n  ros_distro: jazzy\n"
    )
}

#[test]
fn numbered_parts_are_in_the_order_of_their_numbers() {
    for (files, expected) in [
        (&["run_10.mcap", "run_9.mcap"][..], None),
        (&["run_0.mcap", "run_1.mcap", "notes.txt"][..], Some(vec!["run_0.mcap", "run_1.mcap"])),
        (&["a_b_2.mcap", "a_b_1.mcap"][..], Some(vec!["a_b_1.mcap", "a_b_2.mcap"])),
    ] {
        let folder = folder(files);
        let parts = parts_in(folder.path()).ok();
        assert_eq!(parts.as_deref().map(names), expected);
    }
    let many: Vec<String> = (0..12).map(|at| format!("run_{at}.mcap")).collect();
    let folder = folder(&many.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(names(&parts_in(folder.path()).unwrap()), many, "10 follows 9");
}

#[test]
fn missing_and_foreign_parts_are_named() {
    for (files, words) in [
        (&["run_0.mcap", "run_2.mcap"][..], ["run_1.mcap: this part is missing", "run_2.mcap is there"]),
        (&["run_2.mcap", "run_3.mcap"][..], ["run_1.mcap: this part is missing", "run_2.mcap is there"]),
        (&["run_0.mcap", "walk_1.mcap"][..], ["walk_1.mcap: it is a part of another recording", "run_0.mcap"]),
        (&["run_0.mcap", "run_00.mcap"][..], ["run_00.mcap: its number is duplicated", ""]),
        (&["run_0.mcap", "extra.mcap"][..], ["extra.mcap: parts of a recording are named", "NAME_0.mcap"]),
        (&["notes.txt"][..], ["there is no *.mcap", ""]),
    ] {
        let folder = folder(files);
        let error = parts_in(folder.path()).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn metadata_of_rosbag2_gives_parts_and_their_order() {
    // The newest versions number the other way round.
    let files = ["1_run_2026.mcap", "0_run_2026.mcap"];
    let folder = folder(&files);
    std::fs::write(folder.path().join(METADATA), metadata(&[files[1], files[0]], "mcap")).unwrap();
    assert_eq!(names(&parts_in(folder.path()).unwrap()), [files[1], files[0]]);
    assert!(!Rosbag::of(folder.path()).unwrap().unwrap().is_whole());
}

#[test]
fn parts_that_contradict_the_metadata_are_named() {
    let listed = ["run_0.mcap", "run_1.mcap", "run_2.mcap"];
    let compressed =
        |mode: &str| metadata(&listed, "mcap").replace("compression_mode: \"\"", &format!("compression_mode: {mode}"));
    for (files, metadata, words) in [
        (&["run_0.mcap", "run_2.mcap"][..], metadata(&listed, "mcap"), "run_1.mcap: this part is missing"),
        (&listed[..], metadata(&listed[..2], "mcap"), "run_2.mcap: metadata.yaml beside it does not list"),
        (&listed[..], metadata(&listed, "sqlite3"), "storage \"sqlite3\"; convert it with `rosbags-convert --src "),
        (&listed[..], compressed("FILE"), "recorder compressed each file; convert it with `ros2 bag convert`"),
        (&listed[..], compressed("message"), "recorder compressed each message; convert it with `ros2 bag convert`"),
        (&listed[..1], compressed("NONE"), "run_1.mcap: this part is missing"),
        (
            &listed[..1],
            metadata(&["../run_0.mcap", "run_0.mcap"], "mcap"),
            "run_0.mcap: metadata.yaml lists this part twice",
        ),
        (&listed[..], "rosbag2_bagfile_information: 7".into(), "metadata.yaml: "),
        (&listed[..], "a: [".into(), "metadata.yaml: "),
    ] {
        let folder = folder(files);
        std::fs::write(folder.path().join(METADATA), metadata).unwrap();
        let error = parts_in(folder.path()).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    let folder = folder(&["run_0.mcap", "run_1.mcap"]);
    std::fs::write(folder.path().join(METADATA), "title: our lab\n").unwrap();
    assert_eq!(parts_in(folder.path()).unwrap().len(), 2, "metadata of another kind does not count");
}

#[test]
fn a_part_with_fewer_messages_than_stated_is_named() {
    let folder = folder(&["run_0.mcap", "run_1.mcap"]);
    let recording = concat!(env!("CARGO_MANIFEST_DIR"), "/../crates/recording/fixtures/json_images.mcap");
    std::fs::copy(recording, folder.path().join("run_1.mcap")).unwrap();
    std::fs::write(folder.path().join(METADATA), metadata(&["run_0.mcap", "run_1.mcap"], "mcap")).unwrap();
    let error = parts_in(folder.path()).unwrap_err().to_string();
    assert!(error.contains("run_1.mcap: it has ") && error.contains("metadata.yaml states 5"), "{error}");
}
