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
        ("--max-chunk-bytes", "1000", "may unpack to 1000"),
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
async fn images_over_the_limit_make_no_task() {
    let server = TestServer::start_with(&["--workers", "0", "--max-image-pixels", "255"]).await;
    let mut api = Api::connect(&server).await;
    let sim = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &lab::sim_config());
    let spec = Some(gleaner_client::spec::to_proto(&sim));
    refuse!(api.tasks: create_task(CreateTaskRequest { spec }) => InvalidArgument ["spec.cameras[0]: 256 pixels"];);
    alive(&mut api).await;
}
