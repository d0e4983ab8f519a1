//! A server whose database is in PostgreSQL. Where PostgreSQL is not installed, these tests print SKIPPED.

use std::{fs, path::Path};

use gleaner_proto::v1::*;
use gleaner_test_postgres::{GUARDED_ROLE, PASSWORD};
use tonic::Code;

use crate::support::{
    api::Api,
    command::{self, server_text},
    data_folder::start,
    files::blob,
    lab::{self, RECORDINGS},
    postgres::postgres,
    server::{TestServer, serve},
    wait::until,
};

/// A job continues through a restart of PostgreSQL and a kill of the server, and another server cannot take the database.
#[tokio::test]
async fn jobs_on_postgresql_survive_its_restart_and_the_servers() {
    let Some((mut database, url)) = postgres() else { return };
    let flags = ["--database", url.as_str()];
    let (mut server, mut api, episodes) = lab::with_episodes(&flags).await;
    assert!(!server.data_dir().join("gleaner.db").exists());
    let job = api.submit(lab::TASK, lab::pretrain(40)).await.unwrap();
    api.watch_until(&job.id, |job| job.done >= 3).await;

    let other = tempfile::tempdir().unwrap();
    let output = command::run(&mut serve(other.path(), &flags, "127.0.0.1:0")).await;
    assert!(
        !output.success && output.text().contains("another gleaner-server uses this database"),
        "{}",
        output.text()
    );

    database.kill();
    let tasks = api.tasks.list_tasks(ListTasksRequest::default()).await.unwrap_err();
    assert!(tasks.code() == Code::Unavailable && tasks.message().contains("retry"), "{tasks}");
    database.serve();
    assert_eq!(api.episodes().await, episodes);

    server.kill().await;
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let ended = api.watch(&job.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    let run = api.succeed(lab::TASK, lab::score(&job.result_id)).await.result_id;
    assert!(!api.episode_scores(&run, &episodes[7].id).await.q.is_empty());
    assert!(api.download(&episodes[0].id).await == RECORDINGS[0].bytes, "the recording differs");

    // Beside the server.
    let (sound, text) = server_text(&["check", "--database", &url], server.data_dir()).await;
    assert!(sound, "{text}");
    let (made, text) =
        server_text(&["token", "create", "--role", "viewer", "--name", "eye", "--database", &url], server.data_dir())
            .await;
    assert!(made && text.starts_with("gleaner_"), "{text}");
    assert!(server.stop().await);

    // A database that is older than the blobs is not used for them.
    database.execute("test_0", "update lab set generation = 1");
    let output = command::run(&mut serve(server.data_dir(), &flags, "127.0.0.1:0")).await;
    assert!(!output.success && output.text().contains("older than the blobs"), "{}", output.text());
}

/// A backup beside the running server, restored to a new folder and a new database.
#[tokio::test]
async fn backup_of_postgresql_is_restored_to_an_empty_database() {
    let Some((database, url)) = postgres() else { return };
    let flags = ["--database", url.as_str()];
    let (mut server, mut api, _) = lab::with_episodes(&flags).await;
    let job = api.succeed(lab::TASK, lab::pretrain(2)).await;
    let folders = tempfile::tempdir().unwrap();
    let (backup, place) = (folders.path().join("backup"), folders.path().join("lab"));
    let (backup, data) = (backup.to_str().unwrap(), server.data_dir().to_owned());
    let (sound, text) = server_text(&["backup", backup, "--database", &url], &data).await;
    assert!(sound && text.contains("backed up to"), "{text}");
    // What follows a backup is not part of it, and the next one has it.
    let (all, episodes) = (api.episodes().await, api.episodes().await.len());
    let (wrong, text) = server_text(&["backup", backup, "--database", &url], folders.path()).await;
    assert!(!wrong && text.contains("--data-dir"), "{text}");
    api.label(&all[1].id, Outcome::Unknown).await.unwrap();
    let (sound, text) = server_text(&["backup", backup, "--database", &url], &data).await;
    assert!(sound && text.contains(" 0 of them new"), "{text}");
    let labelled = api.episodes().await;
    assert_ne!(labelled, all);

    let (restored, text) = server_text(&["restore", backup], &place).await;
    assert!(!restored && text.contains("--database"), "{text}");
    let (restored, text) = server_text(&["restore", backup, "--database", &url], &place).await;
    assert!(!restored && text.contains("is not empty") && text.contains("createdb"), "{text}");
    // A backup keeps the recordings of earlier ones, also those that were permanently deleted since.
    let deleted = blake3::hash(b"deleted").to_hex();
    let [kept, back] = [Path::new(backup), place.as_path()].map(|folder| blob(folder, &deleted));
    fs::create_dir_all(kept.parent().unwrap()).unwrap();
    fs::write(&kept, b"deleted").unwrap();
    let new = database.database_named("restored");
    let (restored, text) = server_text(&["restore", backup, "--database", &new], &place).await;
    assert!(restored, "{text}");
    assert!(kept.is_file() && !back.exists(), "the database does not name it");
    let (again, text) = server_text(&["restore", backup, "--database", &new], &place).await;
    assert!(!again && text.contains("not empty"), "{text}");
    assert!(server.stop().await);

    let mut server = TestServer::start_over(&place, &["--database", &new]).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(api.episodes().await, labelled);
    assert_eq!(labelled.len(), episodes);
    let request = GetJobRequest { job_id: job.id.clone() };
    assert_eq!(api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap(), job);
    assert!(api.download(&labelled[0].id).await == RECORDINGS[0].bytes, "the recording differs");
    api.label(&labelled[1].id, Outcome::Success).await.unwrap();
    let (sound, text) = server_text(&["check", "--database", &new], server.data_dir()).await;
    assert!(sound, "{text}");
    assert!(server.stop().await);

    // The restored database belongs to the restored folder alone.
    let output = command::run(&mut serve(&data, &["--database", new.as_str()], "127.0.0.1:0")).await;
    assert!(!output.success && output.text().contains("another folder"), "{}", output.text());
}

/// A lab moves from SQLite to PostgreSQL and back, while no server runs.
#[tokio::test]
async fn lab_moves_to_postgresql_and_back() {
    let Some((_database, url)) = postgres() else { return };
    let (mut server, mut api, episodes) = lab::with_episodes(&[]).await;
    let job = api.succeed(lab::TASK, lab::pretrain(2)).await;
    api.label(&episodes[1].id, Outcome::Unknown).await.unwrap();
    let episodes = api.episodes().await;
    let data = server.data_dir().to_owned();
    let there = ["migrate", "--to", &url];
    let (moved, text) = server_text(&there, &data).await;
    assert!(!moved && text.contains("another gleaner-server"), "a server runs: {text}");
    assert!(server.stop().await);
    let (moved, text) = server_text(&["migrate", "--to", "mysql://x"], &data).await;
    assert!(!moved && text.contains("--to"), "{text}");
    let (moved, text) = server_text(&there, &data).await;
    assert!(moved && text.contains("every row is equal"), "{text}");
    assert!(!data.join("gleaner.db").exists(), "it is set aside");

    let flags = ["--database", url.as_str()];
    let mut server = TestServer::start_over(&data, &flags).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(api.episodes().await, episodes);
    let request = GetJobRequest { job_id: job.id.clone() };
    assert_eq!(api.jobs.get_job(request.clone()).await.unwrap().into_inner().job.unwrap(), job);
    api.label(&episodes[1].id, Outcome::Success).await.unwrap();
    let changed = api.episodes().await;
    assert!(server.stop().await);

    let back = ["migrate", "--to", "sqlite", "--database", &url];
    let (moved, text) = server_text(&back, &data).await;
    assert!(moved && text.contains("every row is equal"), "{text}");
    let (again, text) = server_text(&back, &data).await;
    assert!(!again && text.contains("exists"), "{text}");
    command::expect_sound(&data).await;
    let mut server = TestServer::start_over(&data, &[]).await;
    assert_eq!(Api::connect(&server).await.episodes().await, changed);
    assert!(server.stop().await);
    // The database in PostgreSQL is the older one now.
    let output = command::run(&mut serve(&data, &flags, "127.0.0.1:0")).await;
    assert!(!output.success && output.text().contains("older than the blobs"), "{}", output.text());
}

/// The clock of PostgreSQL is an hour ahead: a function of the same name that is found before its own plays it.
#[tokio::test]
async fn clock_of_postgresql_that_differs_is_a_warning_at_the_start() {
    let Some((database, url)) = postgres() else { return };
    let ahead = "create function public.clock_timestamp() returns timestamptz language sql as \
                 $$ select pg_catalog.clock_timestamp() + interval '1 hour' $$";
    database.execute("test_0", ahead);
    database.execute("test_0", "alter database test_0 set search_path = public, pg_catalog");
    let folder = tempfile::tempdir().unwrap();
    let (started, text) = start(folder.path(), &["--database", &url]).await;
    assert!(started && text.contains("seconds behind that of PostgreSQL"), "{text}");
}

#[tokio::test]
async fn password_of_the_database_reaches_no_log_and_no_error() {
    let Some((database, _)) = postgres() else { return };
    let encoded = PASSWORD.replace(' ', "%20");
    let url = database.url_as(&format!("{GUARDED_ROLE}:{encoded}"), "postgres");
    let server = TestServer::start_logged(&["--database", &url, "--workers", "0"], "trace").await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    until("the server logs", async || server.log().contains("postgres://guarded@").then_some(())).await;
    let log = server.log();
    assert!(!log.contains(PASSWORD) && !log.contains(&encoded), "the log has the password");

    let wrong = database.url_as(&format!("{GUARDED_ROLE}:hunter2"), "postgres");
    let folder = tempfile::tempdir().unwrap();
    for url in [wrong.as_str(), "mysql://gleaner:hunter2@localhost/lab", "postgres://gleaner:hunter2@127.0.0.1:1/lab"] {
        let output = command::run(&mut serve(folder.path(), &["--database", url], "127.0.0.1:0")).await;
        let text = output.text();
        assert!(!output.success && text.contains("--database") && !text.contains("hunter2"), "{text}");
    }
}
