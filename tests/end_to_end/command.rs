//! The `gleaner` command against a real server, as people and scripts use it.

use std::path::Path;

use serde_json::Value;

use crate::support::{
    command::{gleaner, json},
    lab::{self, RECORDINGS},
    process::SERVER,
    server::TestServer,
};

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
async fn push_of_a_folder_names_the_files_that_fail() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let (url, dir) = (server.url(), tempfile::tempdir().unwrap());
    write_recordings(dir.path());
    let task = dir.path().join("task.json");
    std::fs::write(&task, serde_json::to_vec(&lab::spec()).unwrap()).unwrap();
    json(url, &["task", "create", task.to_str().unwrap()]).await;

    let labels = dir.path().join("labels.csv");
    let push = ["push", dir.path().to_str().unwrap(), "--labels", labels.to_str().unwrap()];
    let output = gleaner(url, &push).await;
    assert!(!output.success && output.errors.contains("1 of 4"), "{}", output.errors);
    assert!(output.out.contains("broken.mcap") && output.out.contains("MCAP"), "{}", output.out);

    let episodes = json(url, &["episodes", "--outcome", "failure"]).await;
    let failed = episodes["episodes"].as_array().unwrap();
    assert_eq!(failed.len(), 2, "the valid recordings are stored: {episodes}");
    let id = failed[0]["id"].as_str().unwrap();
    json(url, &["label", id, "--outcome", "success", "--reason", "the cube stood"]).await;
    assert_eq!(json(url, &["episodes", "--outcome", "failure"]).await["episodes"].as_array().unwrap().len(), 1);

    // The same folder without its labels: the recordings keep theirs.
    for file in ["broken.mcap", "labels.csv"] {
        std::fs::remove_file(dir.path().join(file)).unwrap();
    }
    let again = gleaner(url, &["push", dir.path().to_str().unwrap()]).await;
    assert!(again.success, "{}", again.text());
    assert!(again.out.contains("0 recordings pushed, 3 already stored (2 as success, 1 as failure)"), "{}", again.out);

    let output = gleaner(url, &["label", "ep_7", "--outcome", "success"]).await;
    assert!(!output.success && output.errors.contains("episode_ids[0]"), "{}", output.errors);
}

#[tokio::test]
async fn a_table_of_a_labs_own_labels_recordings_and_stored_episodes() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let (url, dir) = (server.url(), tempfile::tempdir().unwrap());
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (recordings, task, table) = (at("recordings"), at("task.json"), at("results.csv"));
    std::fs::create_dir(&recordings).unwrap();
    for (name, recording) in ["a", "b", "c"].iter().zip(&RECORDINGS[5..8]) {
        std::fs::write(format!("{recordings}/{name}.mcap"), &recording.bytes).unwrap();
    }
    std::fs::write(&task, serde_json::to_vec(&lab::spec()).unwrap()).unwrap();
    json(url, &["task", "create", &task]).await;
    let results = "run;by;end;trouble\na;Pekka;Stood;\nb;Jonna;no good;fell, twice\nc;Jonna;;\n";
    std::fs::write(&table, results).unwrap();
    let own = |rest: &[&str]| {
        let columns = ["--label-columns", "file=run,outcome=end,cohort=trouble", "--success-value", "stood"];
        rest.iter().chain(&columns).map(|&word| word.to_owned()).collect::<Vec<_>>()
    };

    let pushed = gleaner(url, &own(&["push", &recordings, "--labels", &table])).await;
    assert!(pushed.out.contains("3 recordings pushed (1 as success, 1 as failure, 1 as unknown)"), "{}", pushed.text());
    let failed = json(url, &["episodes", "--outcome", "failure"]).await;
    assert_eq!(
        (&failed["episodes"][0]["file_name"], &failed["episodes"][0]["cohort"]),
        (&"b.mcap".into(), &"fell, twice".into())
    );

    std::fs::write(&table, results.replace("Jonna;;", "Jonna;Stood;")).unwrap();
    let labelled = gleaner(url, &own(&["label", "--from", &table])).await;
    assert!(labelled.errors.contains("1 of 3 labels"), "{}", labelled.text());
    assert_eq!(json(url, &["episodes", "--outcome", "success"]).await["episodes"].as_array().unwrap().len(), 2);

    // Without a file of labels, and without the words of the table.
    for (words, part) in [
        (own(&["push", &recordings]), "--label-columns applies only to a file of labels: add --labels"),
        (own(&["label", "a.mcap", "--outcome", "success"]), "add --from"),
        (["push", &recordings, "--labels", &table].map(str::to_owned).to_vec(), "missing among run, by, end, trouble"),
    ] {
        let refused = gleaner(url, &words).await;
        assert!(!refused.success && refused.errors.contains(part), "{part}: {}", refused.text());
        assert!(refused.errors.contains("--label-columns"), "{}", refused.text());
    }
}

#[tokio::test]
async fn push_skips_and_names_files_that_are_not_regular() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let (url, dir) = (server.url(), tempfile::tempdir().unwrap());
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("good.mcap"), &RECORDINGS[5].bytes).unwrap();
    rustix::fs::mknodat(rustix::fs::CWD, at("fifo.mcap"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
    let _socket = std::os::unix::net::UnixListener::bind(at("socket.mcap")).unwrap();
    std::os::unix::fs::symlink("nowhere.mcap", at("dangling.mcap")).unwrap();
    std::fs::create_dir(at("folder.mcap")).unwrap();
    std::fs::write(at("task.json"), serde_json::to_vec(&lab::spec()).unwrap()).unwrap();
    json(url, &["task", "create", at("task.json").to_str().unwrap()]).await;

    // Opening a FIFO would block until there is a writer.
    let folder = dir.path().to_owned();
    let output = gleaner(url, &["push".as_ref(), folder.as_os_str(), "--outcome".as_ref(), "success".as_ref()]).await;
    assert!(output.success, "{}", output.errors);
    for part in [
        "1 recordings pushed",
        "4 skipped",
        "fifo.mcap: is a FIFO",
        "socket.mcap: is a socket",
        "dangling.mcap: is a link to a file that is not there",
        "folder.mcap: is a folder without recordings",
    ] {
        assert!(output.out.contains(part), "{part}: {}", output.out);
    }
    let output = gleaner(url, &["push".as_ref(), at("fifo.mcap").as_os_str()]).await;
    assert!(!output.success, "{}", output.out);
    assert!(output.errors.contains("is a FIFO; only regular files can be sent"), "{}", output.errors);
    // Files in a list of labels are checked when they are opened.
    std::fs::write(
        at("labels.csv"),
        "file,outcome
fifo.mcap,success
",
    )
    .unwrap();
    let output = gleaner(url, &["push".as_ref(), "--labels".as_ref(), at("labels.csv").as_os_str()]).await;
    assert!(!output.success && output.out.contains("fifo.mcap: is a FIFO"), "{}", output.out);
}

/// `make demo` at its smallest: every stage with a real server, and the report.
#[tokio::test]
async fn demo_runs_every_stage() {
    let dir = tempfile::tempdir().unwrap();
    let place = dir.path().join("demo");
    let words = ["demo", "--quick", "--server-bin", SERVER, "--dir", place.to_str().unwrap()];
    let output = gleaner("http://127.0.0.1:1", &words).await;
    assert!(output.success, "{}", output.errors);
    assert!(output.out.contains("AUROC"), "{}", output.out);
    let report: Value = serde_json::from_slice(&std::fs::read(place.join("report.json")).unwrap()).unwrap();
    for policy in report["policies"].as_array().unwrap() {
        assert_eq!(policy["result"]["episodes"], 4);
    }
    assert!(std::fs::read_to_string(place.join("report.md")).unwrap().contains("precision"));
}
