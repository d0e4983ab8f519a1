//! Slips under a running server: it notices at the next write, acknowledges nothing more and gives the reason.

use std::{fs, path::Path, time::Duration};

use gleaner_proto::v1::*;
use tonic::Code;

use super::{folder::Folder, ids};
use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

/// A part of the refusal, and what is done to the folder.
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
async fn nothing_is_acknowledged_once_the_folder_was_changed_under_the_server() {
    for (message, mistake) in MISTAKES {
        let lab = Folder::used().await;
        let server = TestServer::start_over(lab.path(), &["--workers", "0", "--web-listen", "127.0.0.1:0"]).await;
        let mut api = Api::connect(&server).await;
        let before = ids(&mut api).await;
        mistake(lab.path());
        let label = LabelEpisodesRequest {
            episode_ids: vec![before[0].clone()],
            outcome: Outcome::Unknown.into(),
            ..Default::default()
        };
        let refused = api.episodes.label_episodes(label).await.unwrap_err();
        assert_eq!(refused.code(), Code::FailedPrecondition, "{message}: {refused}");
        assert!(refused.message().contains(message), "{message}: {refused}");
        let refused = lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap_err();
        assert!(refused.message().contains("no change is acknowledged"), "{message}: {refused}");
        // Reads go on, and the health changes for its watchers.
        assert_eq!(ids(&mut api).await, before, "{message}");
        not_serving(&server, message).await;
    }
}

async fn not_serving(server: &TestServer, message: &str) {
    let channel = tonic::transport::Endpoint::from_shared(server.url().to_owned()).unwrap().connect().await.unwrap();
    let mut health = tonic_health::pb::health_client::HealthClient::new(channel);
    let request = tonic_health::pb::HealthCheckRequest::default();
    let mut watched = health.watch(request).await.unwrap().into_inner();
    let stopped = async {
        while let Some(answer) = watched.message().await.unwrap() {
            if answer.status == 2 {
                return;
            }
        }
        panic!("{message}: the health's stream ended");
    };
    tokio::time::timeout(Duration::from_secs(30), stopped).await.expect("the health stays SERVING");
    let page = crate::telemetry::get(&format!("{}/healthz", server.pages())).await;
    assert!(page.contains(message), "{message}: {page}");
}

/// What the open database holds is saved beside it, and takes its place.
#[tokio::test]
async fn what_a_deleted_database_held_is_saved_and_taken_up_again() {
    let lab = Folder::used().await;
    let mut server = TestServer::start_over(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    let newest = lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap();
    // The log and its index stay: they belong to the database that is gone.
    fs::remove_file(lab.path().join("gleaner.db")).unwrap();
    let saved = || {
        let found = fs::read_dir(lab.path()).unwrap().map(|entry| entry.unwrap().path());
        let mut saved = found.filter(|path| path.to_str().unwrap().contains("gleaner-saved-"));
        saved.find(|path| !path.to_str().unwrap().ends_with("-journal"))
    };
    let there = async {
        while saved().is_none() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), there).await.expect("nothing is saved");
    // A server that is asked to stop ends what it has begun.
    server.stop().await;
    let saved = saved().unwrap();
    let content = fs::read(&saved).unwrap();
    fs::rename(saved, lab.path().join("gleaner.db")).unwrap();
    if lab.path().join("gleaner.db-wal").exists() {
        super::folder::refused(lab.path()).await;
        assert!(fs::read(lab.path().join("gleaner.db")).unwrap() == content, "another database's log was taken in");
        for suffix in ["-wal", "-shm"] {
            fs::remove_file(lab.path().join(format!("gleaner.db{suffix}"))).unwrap();
        }
    }
    let server = super::swept(lab.path(), &["--workers", "0"]).await;
    let found = ids(&mut Api::connect(&server).await).await;
    assert!(found.contains(&newest.id) && found.len() == lab.ids().len() + 1, "{found:?}");
    lab.nothing_is_lost();
}
