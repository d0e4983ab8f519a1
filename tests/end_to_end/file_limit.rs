//! A server whose process may write files up to a size only (`ulimit -f`): it names the limit, and goes on.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::{
    api::Api,
    bad_input::refused,
    full_disk,
    lab::{self, RECORDINGS, Recording},
    server::TestServer,
};

/// The database's log has room below it: it grows to 4 MiB.
const LIMIT: usize = 6 << 20;

fn of_size(bytes: usize) -> Recording {
    Recording { bytes: vec![7; bytes].into(), ..RECORDINGS[0].clone() }
}

#[tokio::test]
async fn a_recording_above_the_file_size_limit_is_refused_with_the_reason() {
    let server = TestServer::start_with_file_limit(LIMIT as u64, &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let status = lab::start(&mut api, lab::TASK, &of_size(LIMIT + 1)).await.unwrap_err();
    refused(&status, Code::ResourceExhausted, &["size_bytes: ", "6291456 bytes", "ulimit -f", "LimitFSIZE"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
}

#[tokio::test]
async fn writes_beyond_the_file_size_limit_name_it_and_resume_once_it_is_raised() {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let large = of_size(LIMIT);
    let upload = lab::start(&mut api, lab::TASK, &large).await.unwrap().upload_id;

    server.limit_files(Some(3 << 20));
    let status = lab::write(&mut api, &upload, 0, large.bytes.clone()).await.unwrap_err();
    refused(&status, Code::ResourceExhausted, &["largest file", "ulimit -f", "LimitFSIZE"]);
    // The database's log reaches the limit too.
    let status = full_disk::refused(&mut api, &episode.id).await;
    refused(&status, Code::ResourceExhausted, &["file size limit", "ulimit -f", "LimitFSIZE"]);
    let request = ListEpisodesRequest { task: lab::TASK.into(), ..Default::default() };
    assert_eq!(api.episodes.list_episodes(request).await.unwrap().into_inner().episodes.len(), 1, "reads go on");

    server.limit_files(None);
    full_disk::label(&mut api, &episode.id).await.unwrap();
    let request = GetUploadRequest { upload_id: upload.clone() };
    let committed = api.episodes.get_upload(request).await.unwrap().into_inner().committed_size;
    assert!((1..=3 << 20).contains(&committed), "{committed}");
    let rest = large.bytes.slice(usize::try_from(committed).unwrap()..);
    assert_eq!(lab::write(&mut api, &upload, committed, rest).await.unwrap(), LIMIT as u64);
    lab::push(&mut api, lab::TASK, &RECORDINGS[1]).await.unwrap();
    full_disk::sound(server.data_dir()).await;
}
