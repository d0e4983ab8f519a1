//! Mistakes under a running server: from the next write on, changes are rejected with the reason.

use std::{fs, path::Path};

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    data_folder::{UsedFolder, expect_rejected, swept},
    errors::expect_error,
    http,
    lab::{self, RECORDINGS},
    server::TestServer,
    wait::{until, within},
};

/// A part of the error, and the effect of a mistake on a folder.
type Mistake = (&'static str, fn(&Path));

const MISTAKES: [Mistake; 6] = [
    ("gleaner.db was deleted", |data| fs::remove_file(data.join("gleaner.db")).unwrap()),
    ("gleaner.db was replaced", |data| {
        fs::copy(data.join("older.db"), data.join("copy.db")).unwrap();
        fs::rename(data.join("copy.db"), data.join("gleaner.db")).unwrap();
    }),
    ("gleaner.db-wal was deleted", |data| fs::remove_file(data.join("gleaner.db-wal")).unwrap()),
    ("lock was deleted", |data| fs::remove_file(data.join("lock")).unwrap()),
    ("stamp.json was deleted", |data| fs::rename(data.join("blobs"), data.join("elsewhere")).unwrap()),
    ("gleaner.db was deleted", |data| fs::rename(data, data.with_extension("moved")).unwrap()),
];

#[tokio::test]
async fn changed_data_folder_stops_acknowledgements() {
    for (message, mistake) in MISTAKES {
        let lab = UsedFolder::copy().await;
        let server = TestServer::start_over(lab.path(), &["--workers", "0", "--web-listen", "127.0.0.1:0"]).await;
        let mut api = Api::connect(&server).await;
        let before = api.episode_ids().await;
        mistake(lab.path());
        let rejected = api.label(&before[0], Outcome::Unknown).await.unwrap_err();
        expect_error(&rejected, Code::FailedPrecondition, &[message]);
        let rejected = lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap_err();
        assert!(rejected.message().contains("no change is acknowledged"), "{message}: {rejected}");
        // Reads continue, and watchers of the health receive the change.
        assert_eq!(api.episode_ids().await, before, "{message}");
        expect_not_serving(&server, message).await;
    }
}

async fn expect_not_serving(server: &TestServer, message: &str) {
    let channel = tonic::transport::Endpoint::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let request = tonic_health::pb::HealthCheckRequest::default();
    let mut watched = health.watch(request).await.unwrap().into_inner();
    let stopped = async {
        while let Some(response) = watched.message().await.unwrap() {
            if response.status == 2 {
                return;
            }
        }
        panic!("{message}: the stream of the health ended");
    };
    within("the health turns NOT_SERVING", stopped).await;
    let page = http::get(&format!("{}/healthz", server.pages())).await;
    assert!(page.contains(message), "{message}: {page}");
}

/// The server saves the content of the open database beside the deleted file.
#[tokio::test]
async fn content_of_a_deleted_database_is_saved_and_usable() {
    let lab = UsedFolder::copy().await;
    let mut server = TestServer::start_over(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let newest = lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap();
    // The log and its index, which belong to the deleted database, stay.
    fs::remove_file(lab.path().join("gleaner.db")).unwrap();
    let saved = || {
        let found = fs::read_dir(lab.path()).unwrap().map(|entry| entry.unwrap().path());
        let mut saved = found.filter(|path| path.to_str().unwrap().contains("gleaner-saved-"));
        saved.find(|path| !path.to_str().unwrap().ends_with("-journal"))
    };
    until("the content is saved", async || saved()).await;
    // A stop waits for the save.
    server.stop().await;
    let saved = saved().unwrap();
    let content = fs::read(&saved).unwrap();
    fs::rename(saved, lab.path().join("gleaner.db")).unwrap();
    if lab.path().join("gleaner.db-wal").exists() {
        expect_rejected(lab.path()).await;
        assert!(fs::read(lab.path().join("gleaner.db")).unwrap() == content, "the log of another database was applied");
        for suffix in ["-wal", "-shm"] {
            fs::remove_file(lab.path().join(format!("gleaner.db{suffix}"))).unwrap();
        }
    }
    let server = swept(lab.path(), &["--workers", "0"]).await;
    let found = Api::connect(&server).await.episode_ids().await;
    assert!(found.contains(&newest.id) && found.len() == lab.ids().len() + 1, "{found:?}");
    lab.expect_all_recordings();
}
