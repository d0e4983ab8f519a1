//! `gleaner open` with stand-ins for the viewers' programs: what they are started with, and what people read without them.

use std::{os::unix::fs::PermissionsExt as _, path::Path};

use gleaner_proto::v1::Outcome;
use gleaner_recording::read_episode;
use tokio::process::Command;

use crate::support::{
    command::{self, Output},
    lab,
    process::GLEANER,
    shared::shared,
};

/// Programs on the PATH, and the folder of temporary files.
struct Place(tempfile::TempDir);

impl Place {
    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Puts a shell script on the PATH.
    fn program(&self, name: &str, script: &str) {
        let path = self.path().join(name);
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    async fn open(&self, url: &str, words: &[&str]) -> Output {
        let mut gleaner = Command::new(GLEANER);
        gleaner.arg("open").args(words).env("GLEANER_SERVER", url);
        command::run(gleaner.env("PATH", self.path()).env("TMPDIR", self.path())).await
    }
}

#[tokio::test]
async fn an_episode_is_opened_in_an_installed_viewer() {
    let shared = shared().await;
    let failed = shared.episodes.iter().find(|episode| episode.outcome() == Outcome::Failure).unwrap();
    let place = Place(tempfile::tempdir().unwrap());
    let (url, given) = (shared.server.url(), place.path().join("given"));
    let record = format!("printf '%s\\n' \"$@\" >> {}", given.display());
    place.program("rerun", &record);

    // Without the Python client there is no layout.
    let out = place.path().join("scored.mcap");
    let line = [failed.id.as_str(), "--in", "rerun", "--scores", &shared.run, "--out", out.to_str().unwrap()];
    let opened = place.open(url, &line).await;
    assert!(opened.success && opened.out.contains(&failed.id), "{}", opened.text());
    assert!(opened.errors.contains("no layout: `python3 -m gleaner.rerun"), "{}", opened.errors);
    assert_eq!(std::fs::read_to_string(&given).unwrap(), format!("{}\n", out.display()));
    let reading = read_episode(&out, &lab::spec()).unwrap();
    let quality = reading.report.topics.iter().find(|topic| topic.topic == "/gleaner/quality").unwrap();
    assert_eq!(quality.messages, failed.steps);
    let refused = place.open(url, &line).await;
    assert!(!refused.success && refused.errors.contains("exists; give another name"), "{}", refused.errors);

    // With it, the viewer gets its blueprint too; the run is the newest of the task.
    std::fs::remove_file(&given).unwrap();
    place.program("python3", &format!("{record}; file=$3; : > ${{file%.mcap}}.rbl"));
    let opened = place.open(url, &[&failed.id, "--in", "rerun"]).await;
    assert!(opened.success && opened.errors.contains("the newest of the task"), "{}", opened.text());
    let lines = std::fs::read_to_string(&given).unwrap();
    let lines: Vec<&str> = lines.lines().collect();
    let file = lines[2];
    assert_eq!(lines[..2], ["-m", "gleaner.rerun"]);
    assert_eq!(lines[3..], ["--blueprint-only", file, &file.replace(".mcap", ".rbl")]);
    assert!(Path::new(file).starts_with(place.path()) && opened.out.contains(file), "{}", opened.out);
}

#[tokio::test]
async fn a_viewer_that_is_missing_or_fails_leaves_the_file() {
    let shared = shared().await;
    let (place, url) = (Place(tempfile::tempdir().unwrap()), shared.server.url());
    let episode = shared.episodes[0].id.as_str();
    let missing = place.open(url, &[episode, "--in", "foxglove"]).await;
    assert!(!missing.success && missing.errors.contains("`foxglove-studio` is not on the PATH"), "{}", missing.errors);
    let (_, rest) = missing.errors.split_once("the episode is in ").unwrap();
    let (file, remedy) = rest.split_once(": ").unwrap();
    assert!(Path::new(file).is_file() && remedy.contains("app.foxglove.dev"), "{}", missing.errors);

    place.program("foxglove-studio", "exit 3");
    let failed = place.open(url, &[episode, "--in", "foxglove", "--scores", &shared.run]).await;
    assert!(!failed.success && failed.errors.contains("foxglove-studio failed (exit status: 3)"), "{}", failed.errors);
    let unknown = place.open(url, &["ep_01J00000000000000000000000", "--in", "rerun"]).await;
    assert!(!unknown.success && unknown.errors.contains("ep_01J00000000000000000000000"), "{}", unknown.errors);
}
