//! A token that is revoked amid an upload.

use futures::{StreamExt as _, stream};
use gleaner_proto::v1::*;
use tonic::Code;

use super::{PATIENCE, guarded::Guarded, lab_task};
use crate::{
    bad_input::refused,
    lab::{self, RECORDINGS},
};

#[tokio::test]
async fn what_a_revoked_token_uploads_is_not_taken_any_more() {
    let server = Guarded::start(&["--workers", "0", "--slow-seconds", "3600"], &[]).await;
    let anna = server.client(Some(&server.token("contributor", &["--name", "anna"]).await)).await;
    lab_task(&anna).await;
    let recording = &RECORDINGS[0];
    let upload_id =
        anna.episodes().start_upload(lab::upload(lab::TASK, recording)).await.unwrap().into_inner().upload_id;
    let first = WriteUploadRequest { upload_id: upload_id.clone(), offset: 0, data: recording.bytes.slice(..100) };
    let mut episodes = anna.episodes();
    let upload = tokio::spawn(async move {
        // It never ends by itself, and nothing is answered before it does.
        episodes.write_upload(stream::iter([first]).chain(stream::pending())).await
    });
    let mut other = server.client(Some(&server.token("contributor", &["--name", "ben"]).await)).await.episodes();
    let committed = async {
        while other
            .get_upload(GetUploadRequest { upload_id: upload_id.clone() })
            .await
            .unwrap()
            .into_inner()
            .committed_size
            == 0
        {}
    };
    tokio::time::timeout(PATIENCE, committed).await.unwrap();
    server.command(&["token", "revoke", "anna"]).await.unwrap();
    let ended = tokio::time::timeout(PATIENCE, upload).await.unwrap().unwrap().unwrap_err();
    refused(&ended, Code::Unauthenticated, &["revoked"]);
    let log = server.command(&["audit", "--since", "1h"]).await.unwrap();
    let words = ["anna", "EpisodeService/WriteUpload", "Unauthenticated"];
    assert!(log.lines().any(|line| words.iter().all(|word| line.contains(word))), "{log}");
}
