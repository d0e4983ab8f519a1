//! Datasets of LeRobot and robomimic from their first look to episodes of a server.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tokio::process::Command;

use crate::support::command::{Output, gleaner, json as shown, run};
use crate::support::files::root;
use crate::support::process::GLEANER;
use crate::support::server::TestServer;

/// No server is there: commands that ask one fail.
const NOWHERE: &str = "http://127.0.0.1:9";

fn fixture(name: &str) -> PathBuf {
    root().join("crates/formats/fixtures").join(name)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Outcome, cohort and steps of each pushed episode.
fn labels(pushed: &Value) -> Vec<(String, String, u64)> {
    let of = |entry: &Value| {
        let (episode, word) = (&entry["episode"], |name: &str| entry["episode"][name].as_str().unwrap().to_owned());
        let steps = episode["steps"].as_u64().or_else(|| episode["steps"].as_str()?.parse().ok());
        (word("outcome"), word("cohort"), steps.unwrap())
    };
    pushed["episodes"].as_array().unwrap().iter().map(of).collect()
}

#[tokio::test]
async fn a_lerobot_dataset_is_pushed_and_drafts_its_task() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let dataset = fixture("lerobot_v30_video");
    let pushed = shown(server.url(), &["push", text(&dataset)]).await;
    assert_eq!(pushed["failures"], json!([]), "{pushed}");
    let found = labels(&pushed);
    assert!(
        found[0].0.to_lowercase().contains("success") && found[1].0.to_lowercase().contains("failure"),
        "{found:?}"
    );
    assert!(found.iter().all(|(_, cohort, _)| cohort == "lerobot_v30_video"), "{found:?}");
    assert_eq!(found.iter().map(|(_, _, steps)| *steps).collect::<Vec<_>>(), [12, 9]);
    let task = shown(server.url(), &["task", "show", "lerobot_v30_video"]).await;
    assert_eq!((&task["rate_hz"], &task["action"].as_array().unwrap().len()), (&json!(10.0), &3));

    let again = shown(server.url(), &["push", text(&dataset)]).await;
    assert!(again["episodes"].as_array().unwrap().iter().all(|entry| entry["existed"] == json!(true)), "{again}");
    // The pictures of this one are files of images, and its features are the same.
    let images = gleaner(server.url(), &["push", text(&fixture("lerobot_v30_images")), "--outcome", "success"]).await;
    assert!(images.success && images.text().contains("fits the task lerobot_v30_video"), "{}", images.text());
    let images = shown(server.url(), &["push", text(&fixture("lerobot_v30_images")), "--outcome", "success"]).await;
    let found = labels(&images);
    assert!(found.iter().all(|(outcome, ..)| outcome.to_lowercase().contains("success")), "{found:?}");
    // The tables count frames from 0, so that the last number is above it in both.
    let dataset = fixture("lerobot_v30_images");
    let words = ["push", text(&dataset), "--success-column"];
    let pushed = shown(server.url(), &[&words[..], &["frame_index"]].concat()).await;
    assert!(labels(&pushed).iter().all(|(outcome, ..)| outcome.to_lowercase().contains("success")), "{pushed}");
    let refused = gleaner(server.url(), &[&words[..], &["reward"]].concat()).await;
    assert!(!refused.success && refused.text().contains("next.success"), "{}", refused.text());
    // Another robot's features do not fit this task, and each episode is refused by name.
    let other = fixture("robomimic.hdf5");
    let refused = gleaner(server.url(), &["push", text(&other), "--task", "lerobot_v30_video"]).await;
    assert!(!refused.success && refused.text().contains("robomimic_000000"), "{}", refused.text());
    // Without a name they become another task, and every dataset finds its own.
    let created = gleaner(server.url(), &["push", text(&other)]).await;
    assert!(created.success && created.text().contains("created task Lift"), "{}", created.text());
    for (dataset, task) in [("lerobot_v30_video", "lerobot_v30_video"), ("robomimic.hdf5", "Lift")] {
        let again = gleaner(server.url(), &["push", text(&fixture(dataset))]).await;
        assert!(again.success && !again.text().contains("created"), "{}", again.text());
        let episodes = shown(server.url(), &["episodes", "--task", task]).await;
        assert!(!episodes["episodes"].as_array().unwrap().is_empty(), "{episodes}");
    }
    // The environment's name decides among tasks alike, whatever the name of the file.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("task.toml");
    let drafted = gleaner(NOWHERE, &["task", "draft", text(&other), "--name", "alike"]).await;
    std::fs::write(&file, &drafted.out).unwrap();
    assert!(gleaner(server.url(), &["task", "create", text(&file)]).await.success);
    assert!(gleaner(server.url(), &["push", text(&other)]).await.success);
    let renamed = folder.path().join("renamed.hdf5");
    std::fs::copy(&other, &renamed).unwrap();
    let added = gleaner(server.url(), &["push", text(&renamed), "--cohort", "robomimic"]).await;
    assert!(added.success && added.text().contains("added to the existing task Lift"), "{}", added.text());
}

#[tokio::test]
async fn datasets_are_inspected_drafted_and_checked_without_a_server() {
    for (name, format) in [("lerobot_v21", "LeRobot v2.1"), ("robomimic.hdf5", "robomimic HDF5")] {
        let dataset = fixture(name);
        let inspected = gleaner(NOWHERE, &["inspect", text(&dataset)]).await;
        let seen = inspected.text();
        assert!(inspected.success && seen.contains(format) && seen.contains("2 episodes, 21 steps at 10 Hz"), "{seen}");
        assert!(inspected.errors.contains("next: gleaner push DATASET"), "{}", inspected.errors);
        let named = |episode| format!("{}_00000{episode}", name.trim_end_matches(".hdf5"));
        assert!(seen.contains(&named(0)) && seen.contains("/robot/action"), "{seen}");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("task.toml");
        let drafted = gleaner(NOWHERE, &["task", "draft", text(&dataset), "--name", "drafted"]).await;
        assert!(drafted.success, "{}", drafted.text());
        std::fs::write(&file, &drafted.out).unwrap();
        let checked = gleaner(NOWHERE, &["task", "check", text(&file), text(&dataset)]).await;
        assert!(checked.success && checked.text().contains(&named(1)), "{}", checked.text());
    }
}

#[tokio::test]
async fn a_dataset_with_a_missing_video_is_refused_before_anything_is_sent() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = folder.path().join("pick");
    for file in ["meta/info.json", "meta/tasks.jsonl", "meta/episodes.jsonl"] {
        std::fs::create_dir_all(dataset.join("meta")).unwrap();
        std::fs::copy(fixture("lerobot_v21").join(file), dataset.join(file)).unwrap();
    }
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let refused = gleaner(server.url(), &["push", text(&dataset)]).await;
    let message = refused.text();
    assert!(
        !refused.success && message.contains("is missing") && message.contains("download the whole dataset"),
        "{message}"
    );
    let tasks = shown(server.url(), &["task", "list"]).await;
    assert!(tasks["tasks"].as_array().is_none_or(Vec::is_empty), "no task was made either: {tasks}");
    for words in [&["push", "--check"][..], &["push", "--join"]] {
        let refused = gleaner(server.url(), &[words, &[text(&fixture("robomimic.hdf5"))]].concat()).await;
        assert!(!refused.success && refused.text().contains("does not apply"), "{}", refused.text());
    }
}

const INFO: &str = "meta/info.json";
const DATA: &str = "data/chunk-000/file-000.parquet";
const VIDEO: &str = "videos/observation.images.top/chunk-000/file-000.mp4";

fn copy(from: &Path, to: &Path) {
    if from.is_file() {
        std::fs::copy(from, to).unwrap();
        return;
    }
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        copy(&path, &to.join(path.file_name().unwrap()));
    }
}

/// Replaces the last occurrence of bytes in a file by as many or fewer.
fn replace(path: &Path, from: &[u8], to: &[u8]) {
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes.windows(from.len()).rposition(|window| window == from).unwrap();
    bytes.splice(at..at + from.len(), to.iter().copied());
    std::fs::write(path, bytes).unwrap();
}

/// Pushes with a folder of its own for temporary files, in which nothing may remain.
async fn push(server: &TestServer, dataset: &Path) -> Output {
    let temporary = tempfile::tempdir().unwrap();
    let mut command = Command::new(GLEANER);
    command.args(["push", text(dataset)]).env("GLEANER_SERVER", server.url()).env("TMPDIR", temporary.path());
    let output = run(&mut command).await;
    let left = std::fs::read_dir(temporary.path()).unwrap().count();
    assert_eq!(left, 0, "files remain: {}", output.text());
    output
}

#[tokio::test]
async fn damaged_datasets_are_refused_before_a_task_is_made_and_accepted_when_corrected() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let cut = |path: &Path| {
        let bytes = std::fs::read(path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    };
    type Damage<'a> = &'a dyn Fn(&Path);
    let cases: [(&str, &str, Damage, &[&str]); 6] = [
        (
            "lerobot_v30_video",
            "rate",
            &|at| replace(&at.join(INFO), b"\"fps\": 10,", b"\"fps\": 30,"),
            &["correct `fps`"],
        ),
        ("lerobot_v30_video", "codec", &|at| replace(&at.join(VIDEO), b"av01", b"mp4v"), &["AV1, H.264 or H.265"]),
        ("lerobot_v30_video", "video", &|at| cut(&at.join(VIDEO)), &["file-000.mp4", "damaged"]),
        ("lerobot_v30_images", "table", &|at| cut(&at.join(DATA)), &["file-000.parquet", "damaged"]),
        (
            "lerobot_v30_images",
            "dtype",
            &|at| replace(&at.join(INFO), b"\"dtype\": \"bool\"", b"\"dtype\": \"audio\""),
            &["\"audio\"", "remove it"],
        ),
        ("robomimic.hdf5", "demos.hdf5", &cut, &["demos.hdf5"]),
    ];
    for (from, name, damage, parts) in cases {
        let dataset = folder.path().join(name);
        copy(&fixture(from), &dataset);
        damage(&dataset);
        let refused = push(&server, &dataset).await;
        let message = refused.text();
        assert!(!refused.success && parts.iter().all(|part| message.contains(part)), "{name}: {message}");
        assert!(message.len() < 1500, "{name}: {message}");
    }
    let tasks = shown(server.url(), &["task", "list"]).await;
    assert!(tasks["tasks"].as_array().is_none_or(Vec::is_empty), "no task was made: {tasks}");

    let dataset = folder.path().join("rate");
    replace(&dataset.join(INFO), b"\"fps\": 30,", b"\"fps\": 10,");
    let accepted = push(&server, &dataset).await;
    assert!(accepted.success && accepted.text().contains("created task rate"), "{}", accepted.text());
    // The task of a dataset's name does not sample it at another rate without a word.
    replace(&dataset.join(INFO), b"\"fps\": 10,", b"\"fps\": 30,");
    let refused = push(&server, &dataset).await;
    let message = refused.text();
    assert!(!refused.success && message.contains("has 30 steps per second and the task rate 10"), "{message}");
}

#[tokio::test]
async fn a_dataset_of_another_instruction_is_added_to_a_task_on_purpose_only() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, instruction: &str| {
        let dataset = folder.path().join(name);
        copy(&fixture("lerobot_v21"), &dataset);
        let line = |number: u32| json!({ "task_index": number, "task": instruction }).to_string();
        std::fs::write(dataset.join("meta/tasks.jsonl"), format!("{}\n{}\n", line(0), line(1))).unwrap();
        dataset
    };
    let created = gleaner(server.url(), &["push", text(&at("kitchen", "stack"))]).await;
    assert!(created.success && created.text().contains("created task kitchen"), "{}", created.text());
    let again = gleaner(server.url(), &["push", text(&at("kitchen", "stack"))]).await;
    let note = "is added to the existing task kitchen, which has its name and 2 episodes already";
    assert!(again.success && again.text().contains(note), "{}", again.text());
    let dataset = at("kitchen", "wash up");
    let refused = gleaner(server.url(), &["push", text(&dataset)]).await;
    let message = refused.text();
    assert!(!refused.success && message.contains("--task kitchen to add it on purpose"), "{message}");
    assert!(message.contains("\"wash up\"") && message.contains("\"stack\""), "{message}");
    let added = gleaner(server.url(), &["push", text(&dataset), "--task", "kitchen"]).await;
    assert!(added.success, "{}", added.text());
    // Equal features are no reason to add it: two tasks of one robot have them.
    let apart = gleaner(server.url(), &["push", text(&at("sink", "wash up"))]).await;
    assert!(apart.success && apart.text().contains("created task sink"), "{}", apart.text());
}

#[tokio::test]
async fn a_folder_stands_for_the_datasets_in_it() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("lift/ph")).unwrap();
    copy(&fixture("robomimic.hdf5"), &folder.path().join("lift/ph/demos.hdf5"));
    let inspected = gleaner(NOWHERE, &["inspect", text(folder.path())]).await;
    assert!(inspected.success && inspected.text().contains("robomimic HDF5"), "{}", inspected.text());
    let pushed = gleaner(server.url(), &["push", text(folder.path()), "--rate", "10"]).await;
    assert!(pushed.success && pushed.text().contains("created task Lift"), "{}", pushed.text());
    let refused = gleaner(server.url(), &["push", text(folder.path()), "--rate", "25"]).await;
    assert!(!refused.success && refused.text().contains("the task Lift 10"), "{}", refused.text());

    // A bad dataset stops the push before a task is made for the good one, and two of one name are not mixed.
    let mixed = tempfile::tempdir().unwrap();
    copy(&fixture("lerobot_v21"), &mixed.path().join("a_good"));
    copy(&fixture("lerobot_v30_video"), &mixed.path().join("bad"));
    replace(&mixed.path().join("bad").join(INFO), b"\"fps\": 10,", b"\"fps\": 30,");
    let refused = gleaner(server.url(), &["push", text(mixed.path())]).await;
    assert!(!refused.success && refused.text().contains("no task was created"), "{}", refused.text());
    let tasks = shown(server.url(), &["task", "list"]).await;
    assert_eq!(tasks["tasks"].as_array().unwrap().len(), 1, "{tasks}");
    let same = [mixed.path().join("x/good"), mixed.path().join("y/good")];
    for place in &same {
        copy(&fixture("lerobot_v21"), place);
    }
    let refused = gleaner(server.url(), &["push", text(&same[0]), text(&same[1])]).await;
    assert!(!refused.success && refused.text().contains("are both named good"), "{}", refused.text());

    // Two new datasets of one robot are one task, as they are if they are pushed one after the other.
    let alike = tempfile::tempdir().unwrap();
    for (from, to) in [("lerobot_v30_video", "first"), ("lerobot_v30_images", "second")] {
        copy(&fixture(from), &alike.path().join(to));
    }
    let other = TestServer::start_with(&["--workers", "0"]).await;
    let pushed = gleaner(other.url(), &["push", text(alike.path())]).await;
    let message = pushed.text();
    assert!(pushed.success && message.contains("created task first"), "{message}");
    assert!(message.contains("second fits the task first"), "{message}");

    // The file of an export here has the name of its environment, which is the task's.
    let export = mixed.path().join("lift");
    std::fs::create_dir(&export).unwrap();
    copy(&fixture("robomimic.hdf5"), &export.join("dataset.hdf5"));
    let drafted = gleaner(NOWHERE, &["task", "draft", text(&export)]).await;
    assert!(drafted.success && drafted.out.contains("name = \"Lift\""), "{}", drafted.text());

    copy(&fixture("lerobot_v21"), &folder.path().join("kitchen"));
    let both = gleaner(server.url(), &["push", text(folder.path()), "--rate", "10"]).await;
    assert!(both.success && both.text().contains("2 already stored"), "{}", both.text());
    assert!(both.text().contains("2 recordings pushed"), "{}", both.text());
}
