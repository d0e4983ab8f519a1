//! Limits on recordings are flags of the server and apply in the inspector; limits on uploads and images.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
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
