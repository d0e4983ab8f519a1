//! `gleaner open` with stand-ins for the viewers' programs: what they are started with, and what people read without them.

use std::{os::unix::fs::PermissionsExt as _, path::Path};

use gleaner_proto::v1::{CreateSnapshotRequest, GetSnapshotRequest, Outcome, Role, RoleRule};
use gleaner_recording::read_episode;
use tokio::process::Command;

use crate::support::{
    api::Api,
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

/// A snapshot with at most this many imperfect episodes for each expert (0: all), and a run of imported scores over it;
/// returns the run, and the ids of its imperfect episodes.
async fn imported(api: &mut Api, imperfect_per_expert: f64) -> (String, Vec<String>) {
    let rule = Some(RoleRule { imperfect_per_expert, ..RoleRule::default() });
    let request = CreateSnapshotRequest { task: lab::TASK.to_owned(), rule };
    let snapshot = api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap().id;
    let messages = lab::import(api, &snapshot, "a test").await;
    let run = api.scores.import_scores(tokio_stream::iter(messages)).await.unwrap().into_inner().score_run.unwrap();
    let request = GetSnapshotRequest { snapshot_id: snapshot, omit_episodes: false };
    let members = api.snapshots.get_snapshot(request).await.unwrap().into_inner().episodes;
    let imperfect = members.into_iter().filter(|member| member.role() == Role::Imperfect);
    (run.id, imperfect.map(|member| member.episode_id).collect())
}

#[tokio::test]
async fn an_episode_is_opened_with_the_newest_run_that_holds_it() {
    let (server, mut api, episodes) = lab::with_episodes(&["--workers", "0"]).await;
    let (older, all) = imported(&mut api, 0.0).await;
    let (newer, some) = imported(&mut api, 0.5).await;
    assert!(some.len() < all.len(), "{some:?}");
    let place = Place(tempfile::tempdir().unwrap());
    place.program("rerun", ":");
    let opened = async |episode: &str, scored: bool, note: &str| {
        let out = place.path().join(format!("{episode}.mcap"));
        let opened = place.open(server.url(), &[episode, "--in", "rerun", "--out", out.to_str().unwrap()]).await;
        assert!(opened.success && opened.errors.contains(note), "{note}: {}", opened.text());
        let topics = read_episode(&out, &lab::spec()).unwrap().report.topics;
        assert_eq!(topics.iter().any(|topic| topic.topic == "/gleaner/quality"), scored, "{note}");
    };
    opened(&some[0], true, &format!("score run {newer} (the newest of the task)")).await;
    let left_out = all.iter().find(|id| !some.contains(id)).unwrap();
    let note = format!("score run {older} (the newest of the task that holds the episode; a newer one lacks it)");
    opened(left_out, true, &note).await;
    // Imported scores are those of imperfect episodes.
    let expert = episodes.iter().find(|episode| episode.outcome() == Outcome::Success).unwrap();
    opened(&expert.id, false, "the 2 score runs of the task lack the episode").await;
    let later = lab::record("wrong_goal:1.0".parse().unwrap(), Outcome::Failure, 99);
    let later = lab::push(&mut api, lab::TASK, &later).await.unwrap();
    opened(&later.id, false, "because it was pushed later; the recording has no scores").await;
}
