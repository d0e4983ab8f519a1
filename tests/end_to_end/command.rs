//! The `gleaner` command against a real server: what people and scripts use.

use std::{path::Path, process::Stdio};

use serde_json::Value;
use tokio::process::Command;

use crate::{lab::RECORDINGS, server::TestServer};

/// Runs the command; gives back whether it succeeded, its output and its errors.
pub async fn gleaner(url: &str, words: &[&str]) -> (bool, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_gleaner-under-test"))
        .args(words)
        .env("GLEANER_SERVER", url)
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .output()
        .await
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.success(), text(output.stdout), text(output.stderr))
}

pub async fn json(url: &str, words: &[&str]) -> Value {
    let (ok, out, errors) = gleaner(url, &[&["--json"], words].concat()).await;
    assert!(ok, "{words:?}: {errors}");
    serde_json::from_str(&out).unwrap_or_else(|error| panic!("{words:?}: {error}: {out}"))
}

fn write_recordings(dir: &Path) {
    let mut labels = String::from("file,task,outcome,cohort\nbroken.mcap,pick_cube,unknown,\n");
    for recording in &RECORDINGS[5..8] {
        std::fs::write(dir.join(&recording.name), &recording.bytes).unwrap();
        let outcome = recording.outcome.as_str_name().trim_start_matches("OUTCOME_").to_lowercase();
        labels += &format!("{},pick_cube,{outcome},{}\n", recording.name, recording.cohort);
    }
    std::fs::write(dir.join("broken.mcap"), b"not a recording").unwrap();
    std::fs::write(dir.join("labels.csv"), labels).unwrap();
}

#[tokio::test]
async fn a_folder_is_pushed_and_what_fails_is_told() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let (url, dir) = (server.url(), tempfile::tempdir().unwrap());
    write_recordings(dir.path());
    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &crate::lab::sim_config());
    let task = dir.path().join("task.json");
    std::fs::write(&task, serde_json::to_vec(&spec).unwrap()).unwrap();
    json(url, &["task", "create", task.to_str().unwrap()]).await;

    let labels = dir.path().join("labels.csv");
    let push = ["push", dir.path().to_str().unwrap(), "--labels", labels.to_str().unwrap()];
    let (ok, out, errors) = gleaner(url, &push).await;
    assert!(!ok && errors.contains("1 of 4"), "{errors}");
    assert!(out.contains("broken.mcap") && out.contains("MCAP"), "{out}");

    let episodes = json(url, &["episodes", "--outcome", "failure"]).await;
    let failed = episodes["episodes"].as_array().unwrap();
    assert_eq!(failed.len(), 2, "the whole recordings went in: {episodes}");
    let id = failed[0]["id"].as_str().unwrap();
    json(url, &["label", id, "--outcome", "success", "--reason", "it did stand"]).await;
    assert_eq!(json(url, &["episodes", "--outcome", "failure"]).await["episodes"].as_array().unwrap().len(), 1);

    let (ok, _, errors) = gleaner(url, &["label", "ep_7", "--outcome", "success"]).await;
    assert!(!ok && errors.contains("episode_ids[0]"), "{errors}");
}

#[tokio::test]
async fn a_push_skips_what_is_not_a_regular_file_and_names_it() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let (url, dir) = (server.url(), tempfile::tempdir().unwrap());
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("good.mcap"), &RECORDINGS[5].bytes).unwrap();
    rustix::fs::mknodat(rustix::fs::CWD, at("fifo.mcap"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
    let _socket = std::os::unix::net::UnixListener::bind(at("socket.mcap")).unwrap();
    std::os::unix::fs::symlink("nowhere.mcap", at("dangling.mcap")).unwrap();
    std::fs::create_dir(at("folder.mcap")).unwrap();
    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &crate::lab::sim_config());
    std::fs::write(at("task.json"), serde_json::to_vec(&spec).unwrap()).unwrap();
    json(url, &["task", "create", at("task.json").to_str().unwrap()]).await;

    // A FIFO that is opened waits for a writer for ever.
    let within = |words: Vec<String>| async move {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        tokio::time::timeout(std::time::Duration::from_secs(60), gleaner(url, &words)).await.expect("the push hangs")
    };
    let folder = dir.path().to_str().unwrap().to_owned();
    let (ok, out, errors) = within(vec!["push".into(), folder.clone(), "--outcome".into(), "success".into()]).await;
    assert!(ok, "{errors}");
    for part in [
        "1 recordings pushed",
        "4 skipped",
        "fifo.mcap: is a FIFO",
        "socket.mcap: is a socket",
        "dangling.mcap: is a link to a file that is not there",
        "folder.mcap: is a folder without recordings",
    ] {
        assert!(out.contains(part), "{part}: {out}");
    }
    let fifo = at("fifo.mcap").to_str().unwrap().to_owned();
    let (ok, _, errors) = within(vec!["push".into(), fifo.clone()]).await;
    assert!(!ok && errors.contains("is a FIFO; only regular files can be sent"), "{errors}");
    // What a labels file lists is not searched for, so it is looked at when it is opened.
    std::fs::write(at("labels.csv"), "file,outcome\nfifo.mcap,success\n").unwrap();
    let labels = at("labels.csv").to_str().unwrap().to_owned();
    let (ok, out, _) = within(vec!["push".into(), "--labels".into(), labels]).await;
    assert!(!ok && out.contains("fifo.mcap: is a FIFO"), "{out}");
}

/// `make demo` at its smallest: every stage with a real server, and a report at the end.
#[tokio::test]
async fn the_demo_goes_the_whole_way() {
    let dir = tempfile::tempdir().unwrap();
    let place = dir.path().join("demo");
    let server = env!("CARGO_BIN_EXE_gleaner-server-under-test");
    let words = ["demo", "--quick", "--server-bin", server, "--dir", place.to_str().unwrap()];
    let (ok, out, errors) = gleaner("http://127.0.0.1:1", &words).await;
    assert!(ok, "{errors}");
    assert!(out.contains("AUROC"), "{out}");
    let report: Value = serde_json::from_slice(&std::fs::read(place.join("report.json")).unwrap()).unwrap();
    for policy in report["policies"].as_array().unwrap() {
        assert_eq!(policy["result"]["episodes"], 4);
    }
    assert!(std::fs::read_to_string(place.join("report.md")).unwrap().contains("precision"));
}
