//! Blobs in a bucket: what a folder does, a bucket does, and a store that fails loses nothing that was acknowledged.

use std::{fs, path::Path};

use gleaner_bucket::testing::Moto;
use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command::{expect_sound, server_text},
    lab::{self, RECORDINGS},
    process::{Signal, signal},
    server::TestServer,
};

/// The flags of a bucket.
fn flags(moto: &Moto, prefix: &str) -> Vec<String> {
    let config = moto.config(prefix);
    ["--blob-store", &config.url, "--blob-store-endpoint", &config.endpoint.unwrap(), "--blob-store-http"]
        .map(str::to_owned)
        .into()
}

async fn start(moto: &Moto, prefix: &str, more: &[&str]) -> TestServer {
    let flags = flags(moto, prefix);
    TestServer::start_with(&[&flags.iter().map(String::as_str).collect::<Vec<_>>(), more].concat()).await
}

/// Removes the copies of blobs, and the decoded steps, from a data folder.
fn forget_copies(data: &Path) {
    for folder in fs::read_dir(data.join("blobs")).unwrap().map(|entry| entry.unwrap()) {
        if folder.file_name().len() == 2 {
            for file in fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()) {
                if file.extension().is_none() {
                    fs::remove_file(file).unwrap();
                }
            }
        }
    }
    fs::remove_dir_all(data.join("cache")).unwrap();
    fs::create_dir(data.join("cache")).unwrap();
}

/// The recordings are fetched by the server, and the encoder and the recordings by a worker.
#[tokio::test]
async fn jobs_backup_and_check_work_with_a_bucket() {
    let Some(moto) = Moto::start().unwrap() else { return };
    let mut server = start(&moto, "one", &[]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(4)).await.result_id;
    let before = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    server.kill().await;
    forget_copies(server.data_dir());
    server.start_again().await;

    let mut api = Api::connect(&server).await;
    assert_eq!(api.episodes().await, episodes);
    let again = api.succeed(lab::TASK, lab::score(&encoder)).await.result_id;
    let failure = &episodes[6].id;
    let (one, two) = (api.episode_scores(&before, failure).await, api.episode_scores(&again, failure).await);
    assert_eq!(one.q, two.q);
    for (episode, recording) in episodes.iter().zip(RECORDINGS.iter()) {
        assert!(api.download(&episode.id).await == recording.bytes);
    }

    let places = tempfile::tempdir().unwrap();
    let (backup, new) = (places.path().join("backup"), places.path().join("new"));
    expect_sound(server.data_dir()).await;
    let (sound, text) = server_text(&["backup", backup.to_str().unwrap()], server.data_dir()).await;
    assert!(sound, "{text}");
    let (sound, text) = server_text(&["restore", backup.to_str().unwrap()], &new).await;
    assert!(sound, "{text}");
    let restored = TestServer::start_over(&new, &["--workers", "0"]).await;
    let mut other = Api::connect(&restored).await;
    assert!(other.download(&episodes[0].id).await == RECORDINGS[0].bytes);
    drop(restored);

    // The blobs of a folder move to a bucket at its first start with one.
    let words = flags(&moto, "two");
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let moved = TestServer::start_over(&new, &[&words[..], &["--workers", "0"]].concat()).await;
    forget_copies(&new);
    let mut other = Api::connect(&moved).await;
    assert!(other.download(&episodes[0].id).await == RECORDINGS[0].bytes);
}

#[tokio::test]
async fn a_store_that_hangs_keeps_uploads_and_the_server() {
    let Some(moto) = Moto::start().unwrap() else { return };
    let server = start(&moto, "one", &["--workers", "0", "--blob-store-timeout-seconds", "1"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let first = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let recording = &RECORDINGS[1];
    let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    lab::write(&mut api, &upload, 0, recording.bytes.clone()).await.unwrap();

    signal(moto.pid(), Signal::STOP);
    let error = lab::finish(&mut api, &upload).await.unwrap_err();
    assert!(error.code() == Code::Unavailable && error.message().contains("--blob-store-endpoint"), "{error}");
    assert_eq!(api.episodes().await, [first.clone()], "the server answers, and shows only what is stored");
    assert!(api.download(&first.id).await == RECORDINGS[0].bytes, "copies are read without the store");
    signal(moto.pid(), Signal::CONT);

    let second = lab::finish(&mut api, &upload).await.unwrap();
    forget_copies(server.data_dir());
    assert!(api.download(&second.id).await == recording.bytes);
}

#[tokio::test]
async fn an_altered_object_is_an_error_of_check_and_is_never_sent() {
    let Some(moto) = Moto::start().unwrap() else { return };
    let server = start(&moto, "one", &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    forget_copies(server.data_dir());
    let altered = server.data_dir().join("altered");
    let mut bytes = RECORDINGS[0].bytes.to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&altered, bytes).unwrap();
    let bucket = moto.bucket("one").unwrap();
    let name = bucket.list("blobs").unwrap().remove(0).name;
    bucket.put(&name, &altered).unwrap();

    let request = DownloadEpisodeRequest { episode_id: episode.id.clone() };
    let sent = match api.episodes.download_episode(request).await {
        Ok(stream) => stream.into_inner().message().await.map(drop),
        Err(error) => Err(error),
    };
    assert_eq!(sent.unwrap_err().code(), Code::Internal);
    let (sound, text) = server_text(&["check"], server.data_dir()).await;
    assert!(!sound && text.contains("is damaged"), "{text}");
}

/// Each wrong setting ends the start with a sentence that names it.
#[tokio::test]
async fn wrong_settings_of_a_bucket_end_the_start() {
    let Some(moto) = Moto::start().unwrap() else { return };
    let server = start(&moto, "one", &["--workers", "0"]).await;
    let endpoint = moto.config("one").endpoint.unwrap();
    let new = tempfile::tempdir().unwrap();
    let cases = [
        (vec!["--blob-store", "s3://absent", "--blob-store-http"], "bucket does not exist"),
        (vec!["--blob-store", "s3://lab/one", "--blob-store-http"], "another data folder"),
        (vec!["--blob-store", "s3://lab/two"], "--blob-store-http"),
        (vec!["--blob-store", "lab"], "s3://BUCKET"),
    ];
    for (words, says) in cases {
        let words = [&["serve", "--listen", "127.0.0.1:0", "--blob-store-endpoint", &endpoint], &words[..]].concat();
        let (started, text) = server_text(&words, &new.path().join("lab")).await;
        assert!(!started && text.contains(says), "{words:?}: {text}");
    }
    drop(server);
}
