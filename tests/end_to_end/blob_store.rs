//! Blobs in a bucket: what a folder does, a bucket does, and a store that fails loses nothing that was acknowledged.

mod outages;
mod sweep;
mod workers;

use std::fs;

use gleaner_bucket::testing::TestStore;
use gleaner_proto::v1::*;
use tokio::task::JoinSet;
use tonic::{Code, Status};

use crate::support::{
    api::Api,
    blob_store::{copies, flags, forget_copies, start},
    command::{expect_sound, gleaner, server_text},
    lab::{self, RECORDINGS},
    process::{Signal, signal},
    server::TestServer,
    skipped::skipped,
    wait::until,
};

/// The recordings are fetched by the server, and the encoder and the recordings by a worker.
#[tokio::test]
async fn jobs_backup_and_check_work_with_a_bucket() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let mut server = start(&store, "one", &[]).await;
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
    let words = flags(&store, "two");
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let moved = TestServer::start_over(&new, &[&words[..], &["--workers", "0"]].concat()).await;
    let mut other = Api::connect(&moved).await;
    assert_eq!(other.episodes().await.len(), episodes.len(), "the move is over once a call is answered");
    forget_copies(&new);
    assert!(other.download(&episodes[0].id).await == RECORDINGS[0].bytes);
}

/// Repeats a call for which a busy store takes longer than the short limit of its test.
async fn repeated<T>(event: &str, mut call: impl AsyncFnMut() -> Result<T, Status>) -> T {
    let once = async || match call().await {
        Ok(value) => Some(value),
        Err(error) => {
            assert_eq!(error.code(), Code::Unavailable, "{error}");
            None
        }
    };
    until(event, once).await
}

#[tokio::test]
async fn a_store_that_hangs_keeps_uploads_and_the_server() {
    let Some(store) = TestStore::moto().unwrap() else { return };
    let flags = flags(&store, "one");
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let flags = [&flags[..], &["--workers", "0", "--blob-store-timeout-seconds", "1"]].concat();
    let server = until("the store answers in time", async || TestServer::try_start_with(&flags).await).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let uploaded = async |recording| {
        let mut api = api.clone();
        let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
        lab::write(&mut api, &upload, 0, recording.bytes.clone()).await.unwrap();
        upload
    };
    let (first, second) = (uploaded(&RECORDINGS[0]).await, uploaded(&RECORDINGS[1]).await);
    let first = repeated("the first is stored", async || lab::finish(&mut api, &first).await).await;

    signal(store.pid().unwrap(), Signal::STOP);
    let error = lab::finish(&mut api, &second).await.unwrap_err();
    assert!(error.code() == Code::Unavailable && error.message().contains("--blob-store-endpoint"), "{error}");
    assert_eq!(api.episodes().await, std::slice::from_ref(&first), "the server answers, and shows only what is stored");
    assert!(api.download(&first.id).await == RECORDINGS[0].bytes, "copies are read without the store");
    signal(store.pid().unwrap(), Signal::CONT);

    let second = repeated("the second is stored", async || lab::finish(&mut api, &second).await).await;
    forget_copies(server.data_dir());
    let sent = repeated("the second is sent", async || api.try_download(&second.id).await).await;
    assert!(sent == RECORDINGS[1].bytes);
}

/// A server whose only recording is in the bucket alone, without a copy.
async fn one_in_the_bucket(store: &TestStore) -> (TestServer, Api, Episode) {
    let server = start(store, "one", &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    forget_copies(server.data_dir());
    (server, api, episode)
}

#[tokio::test]
async fn an_altered_cut_or_lost_object_is_never_sent_and_is_named_with_the_remedy() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let (server, mut api, episode) = one_in_the_bucket(&store).await;
    let bucket = store.bucket("one").unwrap();
    let name = bucket.list("blobs").unwrap().remove(0).name;
    let content = &*RECORDINGS[0].bytes;
    let mut altered = content.to_vec();
    *altered.last_mut().unwrap() ^= 1;
    let file = server.data_dir().join("damaged");
    for (damaged, found) in [
        (Some(altered.as_slice()), "is damaged"),
        (content.get(..content.len() / 2), "is damaged"),
        (None, "is not there"),
    ] {
        match damaged {
            Some(bytes) => {
                fs::write(&file, bytes).unwrap();
                bucket.put(&name, &file).unwrap();
            }
            None => bucket.remove(&name).unwrap(),
        }
        let error = api.try_download(&episode.id).await.unwrap_err();
        assert_eq!(error.code(), Code::DataLoss, "{error}");
        for part in [name.as_str(), "--blob-store", "gleaner-server check"] {
            assert!(error.message().contains(part), "{found}: {error}");
        }
        assert_eq!(api.episodes().await, std::slice::from_ref(&episode), "the server answers");
        let (sound, text) = server_text(&["check"], server.data_dir()).await;
        assert!(!sound && text.contains(found), "{text}");
    }
    fs::write(&file, content).unwrap();
    bucket.put(&name, &file).unwrap();
    assert!(api.download(&episode.id).await == content, "the restored object is sent");
}

/// Proved by the server's folder, which has a copy of what the server has sent.
#[tokio::test]
async fn clients_download_from_the_bucket_and_from_the_server_without_it() {
    let Some(store) = TestStore::moto().unwrap() else { return };
    let (server, mut api, episode) = one_in_the_bucket(&store).await;
    let out = tempfile::tempdir().unwrap();
    let download = async |name: &str| {
        let file = out.path().join(name);
        let output = gleaner(server.url(), &["download", &episode.id, "--out", file.to_str().unwrap()]).await;
        assert!(output.success, "{}", output.errors);
        assert!(fs::read(file).unwrap() == RECORDINGS[0].bytes, "{name}");
    };
    download("from_the_bucket").await;
    assert_eq!(copies(server.data_dir()), 0);
    assert!(api.download(&episode.id).await == RECORDINGS[0].bytes, "a client that accepts no URL");
    assert_eq!(copies(server.data_dir()), 1);
    drop(store);
    download("from_the_server").await;
}

/// A URL reads one file, for as long as the flag says; the log has none.
#[tokio::test]
async fn urls_of_a_bucket_expire_and_are_given_only_when_wanted() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let bucket = flags(&store, "one");
    let lasting = |seconds| bucket.iter().map(String::as_str).chain(["--blob-store-url-seconds", seconds]).collect();
    let words: Vec<&str> = lasting("77");
    let mut server = TestServer::start_logged(&words, "debug").await;
    lab::create_task(&mut Api::connect(&server).await).await;
    let episode = lab::push(&mut Api::connect(&server).await, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let urls = async |server: &TestServer| {
        let request = DownloadEpisodeRequest { episode_id: episode.id.clone(), accept_url: true };
        let mut messages = Api::connect(server).await.episodes.download_episode(request).await.unwrap().into_inner();
        let (mut urls, mut bytes) = (Vec::new(), Vec::new());
        while let Some(message) = messages.message().await.unwrap() {
            urls.extend(Some(message.url).filter(|url| !url.is_empty()));
            bytes.extend(message.data);
        }
        assert!(bytes == RECORDINGS[0].bytes || (bytes.is_empty() && urls.len() == 1));
        urls
    };
    let [url] = <[String; 1]>::try_from(urls(&server).await).unwrap();
    assert!(url.contains("X-Amz-Expires=77") && url.contains("X-Amz-Signature="), "{url}");
    assert!(!server.log().contains("X-Amz-Signature"));
    server.stop().await;
    let server = TestServer::start_over(server.data_dir(), &lasting("0")).await;
    assert_eq!(urls(&server).await, Vec::<String>::new());
}

/// Each wrong setting ends the start with a sentence that names it.
#[tokio::test]
async fn wrong_settings_of_a_bucket_end_the_start() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let server = start(&store, "one", &["--workers", "0"]).await;
    let config = store.config("one");
    let (taken, endpoint) = (config.url, config.endpoint.unwrap());
    let new = tempfile::tempdir().unwrap();
    let cases = [
        (vec!["--blob-store", "s3://absent", "--blob-store-http"], "bucket does not exist"),
        (vec!["--blob-store", &taken, "--blob-store-http"], "another data folder"),
        (vec!["--blob-store", "s3://lab/two"], "--blob-store-http"),
        (vec!["--blob-store", "lab"], "s3://BUCKET"),
        (vec!["--blob-store", &taken, "--blob-store-url-seconds", "604801"], "--blob-store-url-seconds"),
    ];
    for (words, reason) in cases {
        let words = [&["serve", "--listen", "127.0.0.1:0", "--blob-store-endpoint", &endpoint], &words[..]].concat();
        let (started, text) = server_text(&words, &new.path().join("lab")).await;
        assert!(!started && text.contains(reason), "{words:?}: {text}");
    }
    drop(server);
}

/// The server dies when the bucket has the recording and the folder does not.
#[tokio::test]
async fn an_upload_that_a_crash_interrupts_between_bucket_and_folder_is_finished() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let mut server = start(&store, "one", &["--workers", "0"]).await;
    lab::create_task(&mut Api::connect(&server).await).await;
    server.kill().await;
    assert!(server.start_where_it_was(Some("blob.in_bucket")).await);
    let mut api = Api::connect(&server).await;
    let recording = &RECORDINGS[0];
    let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
    lab::write(&mut api, &upload, 0, recording.bytes.clone()).await.unwrap();
    lab::finish(&mut api, &upload).await.unwrap_err();
    assert!(!server.ended().await);
    assert_eq!(store.bucket("one").unwrap().list("blobs").unwrap().len(), 1);

    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(&server).await;
    let episode = lab::finish(&mut api, &upload).await.unwrap();
    forget_copies(server.data_dir());
    assert!(api.download(&episode.id).await == recording.bytes);
    assert_eq!(store.bucket("one").unwrap().list("blobs").unwrap().len(), 1);
    expect_sound(server.data_dir()).await;
}

/// One of three storage daemons of Ceph is killed amid uploads.
#[tokio::test]
async fn a_killed_storage_daemon_loses_nothing_and_stops_nothing() {
    let Ok(daemon) = std::env::var("GLEANER_TEST_CEPH_DAEMON") else {
        return skipped("no Ceph here (make test-ceph)");
    };
    let store = TestStore::start().unwrap().unwrap();
    let server = start(&store, "one", &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let agent: gleaner_sim::AgentSpec = "noise:0.5".parse().unwrap();
    let recordings: Vec<_> = (1000..1040).map(|seed| lab::record(agent, Outcome::Failure, seed)).collect();
    let (mut pushing, mut pushed) = (JoinSet::new(), Vec::new());
    for (number, recording) in recordings.iter().enumerate() {
        if pushing.len() == 4 {
            pushed.push(pushing.join_next().await.unwrap().unwrap());
        }
        if number == 12 {
            signal(fs::read_to_string(&daemon).unwrap().trim().parse().unwrap(), Signal::KILL);
        }
        let (mut api, recording) = (api.clone(), recording.clone());
        pushing.spawn(async move { (number, lab::push(&mut api, lab::TASK, &recording).await.unwrap()) });
    }
    pushed.extend(pushing.join_all().await);
    forget_copies(server.data_dir());
    for (number, episode) in pushed {
        assert!(api.download(&episode.id).await == recordings[number].bytes);
    }
    expect_sound(server.data_dir()).await;
}
