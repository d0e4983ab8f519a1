//! Limits on recordings are flags of the server and apply in the inspector; limits on uploads and images.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command::{gleaner, json},
    errors::{expect_alive, expect_error, expect_errors},
    lab::{self, RECORDINGS},
    server::TestServer,
};

#[tokio::test]
async fn each_limit_on_recordings_is_a_flag() {
    let recording = &RECORDINGS[0];
    for (flag, value, words) in [
        ("--max-records", "20", "more than 20 records"),
        ("--max-record-bytes", "40", "may have 40"),
        ("--max-chunk-bytes", "1000", "a chunk may have 1000 bytes"),
        ("--max-channels", "2", "more than 2 "),
        ("--max-name-bytes", "5", "may have 5"),
    ] {
        let (_server, mut api) = lab::with_task(&["--workers", "0", flag, value]).await;
        expect_error(&lab::push(&mut api, lab::TASK, recording).await.unwrap_err(), Code::InvalidArgument, &[words]);
        expect_alive(&mut api).await;
    }
}

/// The client reads a recording's summary and the server refuses it before its first byte.
#[tokio::test]
async fn recordings_that_state_too_much_are_rejected_before_they_are_sent() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, &RECORDINGS[0].bytes).unwrap();
    let path = path.to_str().unwrap();
    for (flag, value, field) in [
        ("--max-records", "20", "summary.messages"),
        ("--max-channels", "2", "summary.channels"),
        ("--max-chunk-bytes", "1000", "summary.largest_chunk_bytes"),
        ("--max-name-bytes", "5", "summary.topics"),
    ] {
        let (server, mut api) = lab::with_task(&["--workers", "0", flag, value]).await;
        for check in [&["--check"][..], &[]] {
            let output = gleaner(server.url(), &[&["push", path], check].concat()).await;
            for part in [field, flag, value] {
                assert!(!output.success && output.out.contains(part), "{flag}: {} {}", output.out, output.errors);
            }
        }
        let summary = Some(RecordingSummary { messages: 21, channels: 3, largest_chunk_bytes: 1001, ..many_names() });
        let request = StartUploadRequest { summary, ..lab::upload(lab::TASK, &RECORDINGS[0]) };
        expect_error(&api.episodes.start_upload(request).await.unwrap_err(), Code::ResourceExhausted, &[field, flag]);
        expect_alive(&mut api).await;
    }
}

fn many_names() -> RecordingSummary {
    RecordingSummary { topics: [("/topic".to_owned(), 7)].into(), ..RecordingSummary::default() }
}

#[tokio::test]
async fn a_check_of_a_push_has_an_estimate_and_stores_nothing() {
    let (server, mut api) = lab::with_task(&["--workers", "0"]).await;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, &RECORDINGS[0].bytes).unwrap();
    let push = ["push", path.to_str().unwrap(), "--outcome", "success"];
    let check = [&push[..], &["--check"]].concat();
    let checked = &json(server.url(), &check).await["recordings"][0];
    let steps = checked["estimate"]["steps"].as_u64().unwrap();
    assert!(steps > 0 && checked["existing"].is_null() && checked["duration_s"].as_f64().unwrap() > 0.0, "{checked}");
    assert!(api.episodes().await.is_empty(), "a check stores nothing");
    let stored = &json(server.url(), &push).await["episodes"][0]["episode"];
    assert_eq!(stored["steps"].as_u64().unwrap(), steps);
    assert_eq!(json(server.url(), &check).await["recordings"][0]["existing"]["id"], stored["id"]);
}

#[tokio::test]
async fn uploads_beyond_the_limit_of_a_caller_are_rejected() {
    let (_server, mut api) = lab::with_task(&["--workers", "0", "--max-open-uploads-per-caller", "2"]).await;
    let first = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().upload_id;
    lab::start(&mut api, lab::TASK, &RECORDINGS[1]).await.unwrap();
    let words = ["2 uploads", "--max-open-uploads-per-caller", "--keep-uploads-days"];
    expect_error(&lab::start(&mut api, lab::TASK, &RECORDINGS[2]).await.unwrap_err(), Code::ResourceExhausted, &words);
    let renamed = StartUploadRequest { author: "another name".into(), ..lab::upload(lab::TASK, &RECORDINGS[2]) };
    expect_error(&api.episodes.start_upload(renamed).await.unwrap_err(), Code::ResourceExhausted, &words);

    lab::write(&mut api, &first, 0, RECORDINGS[0].bytes.clone()).await.unwrap();
    lab::finish(&mut api, &first).await.unwrap();
    lab::push(&mut api, lab::TASK, &RECORDINGS[2]).await.unwrap();
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn task_with_images_over_the_limit_is_rejected() {
    let server = TestServer::start_with(&["--workers", "0", "--max-image-pixels", "255"]).await;
    let mut api = Api::connect(&server).await;
    let spec = Some(lab::spec_message());
    expect_errors!(api.tasks: create_task(CreateTaskRequest { spec }) => InvalidArgument ["spec.cameras[0]: 256 pixels"];);
    expect_alive(&mut api).await;
}
