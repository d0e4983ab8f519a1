//! Datasets of other programs that a search in folders finds: which files are one, and their names.

use std::path::Path;

use serde_json::Value;

use crate::support::command::{gleaner, json};
use crate::support::files::root;
use crate::support::server::TestServer;

/// No server is there: commands that ask one fail.
const NOWHERE: &str = "http://127.0.0.1:9";

fn fixture(name: &str) -> std::path::PathBuf {
    root().join("crates/formats/fixtures").join(name)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A file in HDF5 of another program: robomimic's with another name for the group of its demonstrations.
fn weights(path: &Path) {
    let mut bytes = std::fs::read(fixture("robomimic.hdf5")).unwrap();
    let at = bytes.windows(5).position(|window| window == b"data\0").unwrap();
    bytes[at..at + 4].copy_from_slice(b"dato");
    std::fs::write(path, bytes).unwrap();
}

fn cohorts(pushed: &Value) -> Vec<&str> {
    let episodes = pushed["episodes"].as_array().unwrap().iter();
    episodes.map(|entry| entry["episode"]["cohort"].as_str().unwrap()).collect()
}

#[tokio::test]
async fn files_of_other_programs_do_not_stop_a_push() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("lift/ph")).unwrap();
    std::fs::copy(fixture("robomimic.hdf5"), at("lift/ph/low_dim_v15.hdf5")).unwrap();
    weights(&at("lift/weights.h5"));
    let whole = std::fs::read(fixture("robomimic.hdf5")).unwrap();
    let damaged: [(&str, &[u8]); 3] =
        [("cut.hdf5", &whole[..whole.len() / 2]), ("empty.hdf5", &[]), ("notes.hdf5", b"none")];
    let damaged = damaged.map(|(name, bytes)| (at("lift").join(name), bytes));
    for (file, bytes) in &damaged {
        std::fs::write(file, bytes).unwrap();
    }

    let pushed = gleaner(server.url(), &["push", text(folder.path())]).await;
    let message = pushed.text();
    assert!(!pushed.success && message.contains("2 recordings pushed"), "a damaged dataset is an error: {message}");
    assert!(message.contains("3 of 5 recordings were rejected"), "{message}");
    let line = |begin: String| message.lines().filter(|line| line.starts_with(&begin)).collect::<Vec<_>>();
    let skipped = line(format!("skipped: {}: ", text(&at("lift/weights.h5"))));
    assert!(skipped.len() == 1 && skipped[0].contains("it is no HDF5 file of robomimic"), "{message}");
    assert_eq!(line("skipped: ".to_owned()).len(), 1, "{message}");
    let [cut, empty, foreign] = damaged.each_ref().map(|(file, _)| text(file));
    assert_eq!(line(format!("rejected: {cut}: the file is cut")).len(), 1, "{message}");
    // Equal refusals are one line.
    assert_eq!(line(format!("rejected: 2 recordings ({empty}, {foreign}): ")).len(), 1, "{message}");

    for (file, _) in &damaged {
        std::fs::remove_file(file).unwrap();
    }
    let again = json(server.url(), &["push", text(folder.path())]).await;
    assert_eq!(cohorts(&again), ["lift_ph_low_dim_v15"; 2], "{again}");
    assert!(again["episodes"].as_array().unwrap().iter().all(|entry| entry["existed"] == true), "{again}");
    assert_eq!(again["skipped"][0]["file"], text(&at("lift/weights.h5")), "{again}");
    let inspected = gleaner(NOWHERE, &["inspect", text(folder.path())]).await;
    assert!(inspected.success && inspected.out.contains("skipped: "), "{}", inspected.text());
    let drafted = gleaner(NOWHERE, &["task", "draft", text(folder.path()), "--name", "mine"]).await;
    assert!(drafted.success && drafted.out.contains("name = \"mine\""), "{}", drafted.text());
    assert!(drafted.errors.contains("weights.h5"), "{}", drafted.errors);
    // Given by its own path, the file is refused.
    let refused = gleaner(server.url(), &["push", text(&at("lift/weights.h5"))]).await;
    assert!(!refused.success && refused.errors.contains("no HDF5 file of robomimic"), "{}", refused.errors);
}

#[tokio::test]
async fn a_folder_with_files_of_other_programs_alone_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    weights(&folder.path().join("model.h5"));
    std::fs::write(folder.path().join("notes.hdf5"), "none").unwrap();
    for command in ["push", "inspect"] {
        let refused = gleaner(NOWHERE, &[command, text(folder.path())]).await;
        let message = refused.errors;
        let first = format!("cannot be used (2), such as {}: ", text(&folder.path().join("notes.hdf5")));
        assert!(!refused.success && message.contains(&first), "{command}: {message}");
        for file in ["model.h5", "notes.hdf5"] {
            assert_eq!(message.lines().filter(|line| line.contains(file)).count(), 1, "{command}: {message}");
        }
    }
}

#[tokio::test]
async fn a_dataset_in_the_cache_of_the_hub_has_the_name_of_its_repository() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let commit = folder.path().join("hub/datasets--lab--kitchen/snapshots/87ad4b2a1d2c9aef");
    std::fs::create_dir_all(&commit).unwrap();
    for entry in std::fs::read_dir(fixture("lerobot_v21")).unwrap() {
        let path = entry.unwrap().path();
        std::os::unix::fs::symlink(&path, commit.join(path.file_name().unwrap())).unwrap();
    }
    let pushed = gleaner(server.url(), &["push", text(&commit)]).await;
    assert!(pushed.success && pushed.text().contains("created task kitchen"), "{}", pushed.text());
    let again = json(server.url(), &["push", text(&commit)]).await;
    assert_eq!(cohorts(&again), ["kitchen"; 2], "{again}");
    // A task that is named takes it in any case.
    let named = gleaner(server.url(), &["push", text(&commit), "--task", "absent"]).await;
    assert!(!named.success && named.errors.contains("no task \"absent\""), "{}", named.errors);
}

#[tokio::test]
async fn files_of_one_environment_are_pushed_to_the_task_that_the_push_creates() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one.hdf5", "two.hdf5"].map(|name| folder.path().join(name));
    for file in [&one, &two] {
        std::fs::copy(fixture("robomimic.hdf5"), file).unwrap();
    }
    // The recordings of the two are the same.
    let words = ["push", text(&one), text(&two), "--cohort", "lift", "--jobs", "1"];
    let pushed = gleaner(server.url(), &words).await;
    let message = pushed.text();
    assert!(pushed.success && message.contains("created task Lift"), "{message}");
    let added = format!("{} is added to the task Lift that this push creates, which has the name of", text(&two));
    assert!(message.contains(&added) && !message.contains("existing task"), "{message}");
    let again = gleaner(server.url(), &words).await;
    let message = again.text();
    assert!(again.success, "{message}");
    for file in [&one, &two] {
        let added =
            format!("{} is added to the existing task Lift, which has the name of its environment and 2", text(file));
        assert!(message.contains(&added), "{message}");
    }
}
