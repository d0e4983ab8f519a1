//! A limit on the size of files (`ulimit -f`): errors name it, and the server continues.

use tonic::Code;

use crate::support::{
    api::Api,
    command::expect_sound,
    disk::{label, label_until_rejected},
    errors::expect_error,
    lab::{self, RECORDINGS, Recording},
    server::TestServer,
};

/// Above the write-ahead log of the database, which grows to 4 MiB.
const LIMIT: usize = 6 << 20;

fn of_size(bytes: usize) -> Recording {
    Recording { bytes: vec![7; bytes].into(), ..RECORDINGS[0].clone() }
}

#[tokio::test]
async fn recording_above_the_file_size_limit_is_rejected() {
    let server = TestServer::start_with_file_limit(LIMIT as u64, &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let status = lab::start(&mut api, lab::TASK, &of_size(LIMIT + 1)).await.unwrap_err();
    expect_error(&status, Code::ResourceExhausted, &["size_bytes: ", "6291456 bytes", "ulimit -f", "LimitFSIZE"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
}

#[tokio::test]
async fn writes_beyond_the_file_size_limit_name_it_and_resume_once_it_is_raised() {
    let (server, mut api) = lab::idle().await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let large = of_size(LIMIT);
    let upload = lab::start(&mut api, lab::TASK, &large).await.unwrap().upload_id;

    server.limit_files(Some(3 << 20));
    let status = lab::write(&mut api, &upload, 0, large.bytes.clone()).await.unwrap_err();
    expect_error(&status, Code::ResourceExhausted, &["largest file", "ulimit -f", "LimitFSIZE"]);
    // The write-ahead log reaches the limit too.
    let status = label_until_rejected(&mut api, &episode.id).await;
    expect_error(&status, Code::ResourceExhausted, &["file size limit", "ulimit -f", "LimitFSIZE"]);
    assert_eq!(api.episodes().await.len(), 1, "reads continue");

    server.limit_files(None);
    label(&mut api, &episode.id).await.unwrap();
    let committed = api.committed_size(&upload).await.unwrap();
    assert!((1..=3 << 20).contains(&committed), "{committed}");
    let rest = large.bytes.slice(usize::try_from(committed).unwrap()..);
    assert_eq!(lab::write(&mut api, &upload, committed, rest).await.unwrap(), LIMIT as u64);
    lab::push(&mut api, lab::TASK, &RECORDINGS[1]).await.unwrap();
    expect_sound(server.data_dir()).await;
}
