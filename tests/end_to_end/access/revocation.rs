//! A token that is revoked during an upload.

use futures::{StreamExt as _, stream};
use gleaner_proto::v1::*;
use tonic::Code;

use super::create_task;
use crate::support::{
    errors::expect_error,
    lab::{self, RECORDINGS},
    secure::SecureServer,
    wait::{until, within},
};

#[tokio::test]
async fn upload_ends_when_its_token_is_revoked() {
    let server = SecureServer::start(&["--workers", "0", "--slow-seconds", "3600"], &[]).await;
    let anna = server.client(Some(&server.token("contributor", &["--name", "anna"]).await)).await;
    create_task(&anna).await;
    let recording = &RECORDINGS[0];
    let upload_id =
        anna.episodes().start_upload(lab::upload(lab::TASK, recording)).await.unwrap().into_inner().upload_id;
    let first = WriteUploadRequest { upload_id: upload_id.clone(), offset: 0, data: recording.bytes.slice(..100) };
    let mut episodes = anna.episodes();
    let upload = tokio::spawn(async move {
        // The client never ends the stream.
        episodes.write_upload(stream::iter([first]).chain(stream::pending())).await
    });
    let other = server.client(Some(&server.token("contributor", &["--name", "ben"]).await)).await;
    until("the first bytes are committed", async || {
        let request = GetUploadRequest { upload_id: upload_id.clone() };
        let committed = other.episodes().get_upload(request).await.unwrap().into_inner().committed_size;
        (committed > 0).then_some(())
    })
    .await;
    server.command(&["token", "revoke", "anna"]).await.unwrap();
    let ended = within("the upload ends", upload).await.unwrap().unwrap_err();
    expect_error(&ended, Code::Unauthenticated, &["revoked"]);
    let log = server.command(&["audit", "--since", "1h"]).await.unwrap();
    let words = ["anna", "EpisodeService/WriteUpload", "Unauthenticated"];
    assert!(log.lines().any(|line| words.iter().all(|word| line.contains(word))), "{log}");
}
