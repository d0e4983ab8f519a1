//! Limits on recordings are flags of the server, and reach the process that reads them.

use gleaner_proto::v1::*;
use tonic::Code;

use super::{alive, refuse};
use crate::{
    api::Api,
    bad_input::refused,
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
        let server = TestServer::start_with(&["--workers", "0", flag, value]).await;
        let mut api = Api::connect(&server).await;
        lab::create_task(&mut api).await;
        refused(&lab::push(&mut api, lab::TASK, recording).await.unwrap_err(), Code::InvalidArgument, &[words]);
        alive(&mut api).await;
    }
}

#[tokio::test]
async fn uploads_beyond_the_callers_limit_are_refused() {
    let server = TestServer::start_with(&["--workers", "0", "--max-open-uploads-per-caller", "2"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let first = lab::start(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap().upload_id;
    lab::start(&mut api, lab::TASK, &RECORDINGS[1]).await.unwrap();
    let words = ["2 uploads", "--max-open-uploads-per-caller", "--keep-uploads-days"];
    refused(&lab::start(&mut api, lab::TASK, &RECORDINGS[2]).await.unwrap_err(), Code::ResourceExhausted, &words);
    let anew = StartUploadRequest { author: "another name".into(), ..lab::upload(lab::TASK, &RECORDINGS[2]) };
    refused(&api.episodes.start_upload(anew).await.unwrap_err(), Code::ResourceExhausted, &words);

    lab::write(&mut api, &first, 0, RECORDINGS[0].bytes.clone()).await.unwrap();
    lab::finish(&mut api, &first).await.unwrap();
    lab::push(&mut api, lab::TASK, &RECORDINGS[2]).await.unwrap();
    alive(&mut api).await;
}

#[tokio::test]
async fn images_over_the_limit_make_no_task() {
    let server = TestServer::start_with(&["--workers", "0", "--max-image-pixels", "255"]).await;
    let mut api = Api::connect(&server).await;
    let sim = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &lab::sim_config());
    let spec = Some(gleaner_core::proto::task::spec_to_proto(sim.clone()));
    refuse!(api.tasks: create_task(CreateTaskRequest { spec }) => InvalidArgument ["spec.cameras[0]: 256 pixels"];);
    alive(&mut api).await;
}
