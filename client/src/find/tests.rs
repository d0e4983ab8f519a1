//! What is found in real folders, with a FIFO, a socket, links and folders that bear a recording's name.

use std::os::unix::fs::symlink;

use rustix::fs::{CWD, FileType, mknodat};

use super::*;

#[test]
fn folders_are_searched_and_files_are_taken_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("sub/empty")).unwrap();
    for name in ["b.mcap", "sub/a.mcap", "notes.txt", "odd.bag"] {
        std::fs::write(at(name), b"x").unwrap();
    }
    let found = find_recordings(&[folder.path().to_owned(), at("b.mcap"), at("odd.bag")]).unwrap();
    assert_eq!(found.recordings, [at("b.mcap"), at("odd.bag"), at("sub/a.mcap")]);
    assert_eq!(found.skipped, []);
    assert!(find_recordings(&[at("sub/empty")]).unwrap_err().to_string().contains("no *.mcap"));
    assert!(find_recordings(&[at("nowhere")]).unwrap_err().to_string().contains("nowhere"));
}

/// As rosbag2 writes it.
const SQLITE: &str = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  \
                      relative_file_paths:\n    - run_0.db3\n";

#[test]
fn files_of_other_formats_are_refused_with_the_command_that_converts_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rlds = "is a file of an RLDS dataset";
    for (name, contents, parts) in [
        ("one/run.bag", &b"#ROSBAG V2.0\n"[..], ["run.bag is a ROS 1 bag", "--src {}/one/run.bag --dst"]),
        ("two/run_0.db3", b"SQLite format 3\0x", ["run_0.db3 is a rosbag2 recording in SQLite", "--src {}/two --dst"]),
        ("three/run-train.tfrecord-00000-of-00002", b"\x80", [rlds, "examples/port_datasets"]),
    ] {
        let path = at(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, contents).unwrap();
        for named in [path.clone(), path.parent().unwrap().to_owned()] {
            let problem = find_recordings(&[named]).unwrap_err().to_string();
            let place = folder.path().display().to_string();
            assert!(parts.iter().all(|part| problem.contains(&part.replace("{}", &place))), "{problem}");
        }
    }
    std::fs::write(at("two/metadata.yaml"), SQLITE).unwrap();
    let problem = find_recordings(&[at("two")]).unwrap_err().to_string();
    assert!(problem.contains(&format!("--src {} --dst", at("two").display())), "{problem}");
    // Beside recordings they are of no concern.
    std::fs::write(at("one/run.mcap"), b"x").unwrap();
    assert_eq!(find_recordings(&[at("one")]).unwrap().recordings, [at("one/run.mcap")]);
}

#[test]
fn what_may_be_a_dataset_of_another_program_is_skipped_beside_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("lab/pick/meta")).unwrap();
    // A folder with recordings is not a dataset, even with this file.
    std::fs::create_dir_all(at("lab/session/meta")).unwrap();
    // By their names alone: neither is what its program writes.
    let dataset = ["lab/pick/meta/info.json", "lab/lift.hdf5"];
    for name in ["lab/session/meta/info.json", "lab/session/a.mcap", "lab/notes.json"].into_iter().chain(dataset) {
        std::fs::write(at(name), b"x").unwrap();
    }
    symlink(at("lab/lift.hdf5"), at("lab/link.h5")).unwrap();
    let found = find_recordings(&[at("lab")]).unwrap();
    assert_eq!(found.recordings, [at("lab/session/a.mcap")]);
    let mut skipped: Vec<_> = found.skipped.into_iter().map(|Skipped { path, reason }| (path, reason)).collect();
    skipped.sort();
    let reason = || "may be a dataset of another program; give it by its own path".to_owned();
    assert_eq!(skipped, ["lab/lift.hdf5", "lab/link.h5", "lab/pick"].map(|name| (at(name), reason())));
}

#[test]
fn irregular_files_are_skipped_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("good.mcap"), b"x").unwrap();
    mknodat(CWD, at("fifo.mcap"), FileType::Fifo, 0o600.into(), 0).unwrap();
    let _socket = std::os::unix::net::UnixListener::bind(at("socket.mcap")).unwrap();
    std::fs::create_dir_all(at("folder.mcap/inside")).unwrap();
    std::fs::create_dir(at("bag.mcap")).unwrap();
    std::fs::write(at("bag.mcap/part.mcap"), b"x").unwrap();
    for (target, link) in [
        ("good.mcap", "link.mcap"),
        ("nowhere", "dangling.mcap"),
        ("loop.mcap", "loop.mcap"),
        ("fifo.mcap", "to_fifo.mcap"),
        ("/dev/null", "to_device.mcap"),
        (".", "above"),
        ("nowhere", "other.txt"),
    ] {
        symlink(target, at(link)).unwrap();
    }
    mknodat(CWD, at("fifo.txt"), FileType::Fifo, 0o600.into(), 0).unwrap();

    let found = find_recordings(&[folder.path().to_owned()]).unwrap();
    assert_eq!(found.recordings, [at("bag.mcap/part.mcap"), at("good.mcap"), at("link.mcap")]);
    let mut skipped: Vec<(PathBuf, String)> =
        found.skipped.into_iter().map(|Skipped { path, reason }| (path, reason)).collect();
    skipped.sort();
    let expected = [
        ("above", "is a link to a folder"),
        ("dangling.mcap", "is a link to a file that is not there"),
        ("fifo.mcap", "is a FIFO"),
        ("folder.mcap", "is a folder without recordings"),
        ("loop.mcap", "is a link that cannot be followed"),
        ("socket.mcap", "is a socket"),
        ("to_device.mcap", "is a link to something that is a device"),
        ("to_fifo.mcap", "is a link to something that is a FIFO"),
    ];
    assert_eq!(skipped.len(), expected.len(), "{skipped:?}");
    for ((path, reason), (name, part)) in skipped.iter().zip(expected) {
        assert!(*path == at(name) && reason.starts_with(part), "{path:?} {reason}");
    }
}

#[test]
fn a_named_fifo_is_rejected_and_a_folder_of_irregular_files_lists_them() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("fifo.mcap");
    mknodat(CWD, &fifo, FileType::Fifo, 0o600.into(), 0).unwrap();
    let error = find_recordings(std::slice::from_ref(&fifo)).unwrap_err().to_string();
    assert!(error.contains("fifo.mcap: is a FIFO; only regular files"), "{error}");
    let error = find_recordings(&[folder.path().to_owned()]).unwrap_err().to_string();
    assert!(
        error.contains("no *.mcap") && error.contains("skipped 1") && error.contains("fifo.mcap is a FIFO"),
        "{error}"
    );
}

#[test]
fn a_folder_of_several_rosbag2_parts_is_one_recording() {
    let folder = tempfile::tempdir().unwrap();
    let bag = |name: &str, storage: &str, parts: usize| {
        let at = folder.path().join(name);
        std::fs::create_dir(&at).unwrap();
        let names: Vec<String> = (0..parts).map(|part| format!("{name}_{part}.mcap")).collect();
        names.iter().for_each(|part| std::fs::write(at.join(part), b"x").unwrap());
        let list: String = names.iter().map(|part| format!("    - {part}\n")).collect();
        let metadata =
            format!("rosbag2_bagfile_information:\n  storage_identifier: {storage}\n  relative_file_paths:\n{list}");
        std::fs::write(at.join("metadata.yaml"), metadata).unwrap();
        at
    };
    let (split, whole, old) = (bag("split", "mcap", 3), bag("whole", "mcap", 1), bag("old", "sqlite3", 2));
    std::fs::create_dir(folder.path().join("torn")).unwrap();
    std::fs::write(folder.path().join("torn/metadata.yaml"), "rosbag2_bagfile_information: [").unwrap();
    let found = find_recordings(&[folder.path().to_owned()]).unwrap();
    assert_eq!(found.recordings, [split, folder.path().join("torn"), whole.join("whole_0.mcap")]);
    assert_eq!(found.skipped.iter().map(|skipped| &skipped.path).collect::<Vec<_>>(), [&old]);
    assert!(found.skipped[0].reason.contains("rosbags-convert --src"));
    let metadata = "rosbag2_bagfile_information:\n  storage_identifier: mcap\n  compression_mode: MESSAGE\n  \
                    relative_file_paths: [old_0.mcap]\n";
    std::fs::write(old.join("metadata.yaml"), metadata).unwrap();
    let found = find_recordings(&[folder.path().to_owned()]).unwrap();
    assert!(found.skipped[0].reason.contains("compressed each message"), "even if it is one whole file");
}
