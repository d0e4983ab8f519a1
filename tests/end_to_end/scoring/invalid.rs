//! Recordings and steps that cannot be scored are rejected with the field, and before they are sent where they state it.

use std::io::Cursor;

use gleaner_client::Client;
use gleaner_proto::v1::{
    score_recording_request::Message as Part, score_steps_request::Message as StepMessage,
    score_steps_response::Message as StepReply, *,
};
use gleaner_recording::EpisodeWriter;
use serde_json::json;
use tokio_stream::StreamExt as _;
use tonic::{Code, Status};

use super::{FAILURE, random_run, recording_file, steps};
use crate::support::{
    api::Api,
    errors::{absent_id, expect_error},
    lab::{self, RECORDINGS},
    shared::shared,
};

async fn send(api: &mut Api, parts: Vec<Part>) -> Result<ScoreRecordingResponse, Status> {
    let requests: Vec<_> = parts.into_iter().map(|part| ScoreRecordingRequest { message: Some(part) }).collect();
    Ok(api.scores.score_recording(tokio_stream::iter(requests)).await?.into_inner())
}

fn open(run: &str, size_bytes: u64) -> Part {
    let file_name = "attempt.mcap".into();
    Part::Open(ScoreRecordingOpen { score_run_id: run.into(), file_name, size_bytes, summary: None })
}

#[tokio::test]
async fn invalid_recordings_are_not_scored() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let run = shared.run.as_str();
    let random = random_run(&mut api, &shared.encoder).await;
    let whole = || Part::Data(RECORDINGS[FAILURE].bytes.clone());
    let no_steps = EpisodeWriter::create(Cursor::new(Vec::new()), &lab::spec()).unwrap().finish().unwrap().into_inner();
    let cases: [(Vec<Part>, Code, &[&str]); 11] = [
        (vec![], Code::InvalidArgument, &["open: "]),
        (vec![whole()], Code::InvalidArgument, &["open: "]),
        (vec![open("x", 0)], Code::InvalidArgument, &["open.score_run_id: "]),
        (vec![open(&absent_id("run"), 0)], Code::NotFound, &[&absent_id("run")]),
        (vec![open(&random, 0), whole()], Code::FailedPrecondition, &["random", "raw or ssdf"]),
        (vec![open(run, 0), open(run, 0)], Code::InvalidArgument, &["open: ", "already"]),
        (vec![open(run, 0)], Code::InvalidArgument, &["attempt.mcap", "empty"]),
        (vec![open(run, 7), whole()], Code::InvalidArgument, &["open.size_bytes: ", "more"]),
        (vec![open(run, 1 << 60), whole()], Code::ResourceExhausted, &["--max-upload-bytes"]),
        (vec![open(run, 0), Part::Data("ply\nformat ascii".repeat(50).into())], Code::InvalidArgument, &["MCAP"]),
        (vec![open(run, 0), Part::Data(no_steps.into())], Code::InvalidArgument, &["recording: "]),
    ];
    for (parts, code, words) in cases {
        expect_error(&send(&mut api, parts).await.unwrap_err(), code, words);
    }
    let empty = ScoreRecordingRequest { message: None };
    let status = api.scores.score_recording(tokio_stream::iter([empty])).await.unwrap_err();
    expect_error(&status, Code::InvalidArgument, &["open: "]);
}

#[tokio::test]
async fn a_recording_that_states_too_much_is_rejected_before_it_is_sent_to_be_scored() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let summary = Some(RecordingSummary { messages: u64::MAX, ..RecordingSummary::default() });
    let declared = ScoreRecordingOpen { score_run_id: shared.run.clone(), summary, ..ScoreRecordingOpen::default() };
    // The stream stays open and has no data.
    let first = ScoreRecordingRequest { message: Some(Part::Open(declared)) };
    let requests = tokio_stream::iter([first]).chain(tokio_stream::pending());
    let words = ["open.summary.messages: ", "--max-records"];
    expect_error(&api.scores.score_recording(requests).await.unwrap_err(), Code::ResourceExhausted, &words);

    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &lab::spec()).unwrap();
    writer.annotate(&"x".repeat(1025), 1, &json!({})).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = recording_file(folder.path(), &writer.finish().unwrap().into_inner());
    let client = Client::connect(shared.server.url(), None).await.unwrap();
    let rejected = client.score_recording(&shared.run, &path, |_| {}).await.unwrap_err().to_string();
    for part in ["open.summary.topics: ", "1025", "--max-name-bytes"] {
        assert!(rejected.contains(part), "{rejected}");
    }
}

async fn score_steps(api: &mut Api, messages: Vec<StepMessage>) -> Result<Vec<LiveScore>, Status> {
    let requests: Vec<_> = messages.into_iter().map(|message| ScoreStepsRequest { message: Some(message) }).collect();
    let mut responses = api.scores.score_steps(tokio_stream::iter(requests)).await?.into_inner();
    let mut scores = Vec::new();
    while let Some(response) = responses.message().await? {
        match response.message.unwrap() {
            StepReply::Score(score) => scores.push(score),
            StepReply::Draining(draining) => panic!("{draining:?}"),
        }
    }
    Ok(scores)
}

#[tokio::test]
async fn invalid_steps_are_not_scored() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let folder = tempfile::tempdir().unwrap();
    let good = steps(folder.path(), &RECORDINGS[FAILURE].bytes).swap_remove(0);
    let open = |run: &str| StepMessage::Open(ScoreStepsOpen { score_run_id: run.into() });
    let step = |change: fn(&mut ScoreStep)| {
        let (seen, action) = good.clone();
        let mut step = ScoreStep { observation: Some(seen), action };
        change(&mut step);
        StepMessage::Step(step)
    };
    fn seen(step: &mut ScoreStep) -> &mut Observation {
        step.observation.as_mut().unwrap()
    }
    let valid = || step(|_| {});
    assert_eq!(score_steps(&mut api, vec![open(&shared.run), valid(), valid()]).await.unwrap().len(), 2);

    for (messages, code, words) in [
        (vec![], Code::InvalidArgument, "open: "),
        (vec![valid()], Code::InvalidArgument, "open: "),
        (vec![open(&absent_id("run")), valid()], Code::NotFound, &absent_id("run")),
        (vec![open(&shared.run), open(&shared.run)], Code::InvalidArgument, "open: "),
        (vec![open(&shared.run)], Code::InvalidArgument, "step: at least one is required"),
    ] {
        expect_error(&score_steps(&mut api, messages).await.unwrap_err(), code, &[words]);
    }
    type Change = fn(&mut ScoreStep);
    let cases: [(Change, &str); 10] = [
        (|step| step.observation = None, "step.observation: "),
        (|step| step.action.truncate(1), "step.action: "),
        (|step| step.action[0] = f32::NAN, "step.action[0]: "),
        (|step| seen(step).proprioception.truncate(1), "step.observation.proprioception: "),
        (|step| seen(step).cameras.truncate(1), "step.observation.cameras: "),
        (|step| seen(step).executed_action = vec![0.0], "step.observation.executed_action: "),
        (|step| seen(step).deadline_us = 5, "step.observation.deadline_us: "),
        (|step| seen(step).skipped_steps = 1, "step.observation.skipped_steps: "),
        (|step| seen(step).stamp_ns = -1, "step.observation.stamp_ns: "),
        (
            |step| {
                let data = vec![0xFF, 0xD8, 0xFF, 0xE0, 1, 2, 3].into();
                seen(step).cameras[0].color = Some(Image { format: ImageFormat::Jpeg.into(), data });
            },
            "step.observation.cameras[0].color: ",
        ),
    ];
    for (change, field) in cases {
        let messages = vec![open(&shared.run), valid(), step(change)];
        expect_error(&score_steps(&mut api, messages).await.unwrap_err(), Code::InvalidArgument, &[field]);
    }
}
