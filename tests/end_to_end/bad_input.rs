//! Bad input: each gets a status, a message that names the field and the mend, and loses nothing.

use gleaner_proto::v1::*;
use tonic::{Code, Status};

use crate::{
    api::Api,
    lab::{self, RECORDINGS, Recording},
    server::TestServer,
};

pub fn refused(status: &Status, code: Code, words: &[&str]) {
    assert_eq!(status.code(), code, "{status}");
    for word in words {
        assert!(status.message().contains(word), "{word:?} is not in {:?}", status.message());
    }
}

fn with_bytes(bytes: Vec<u8>) -> Recording {
    Recording { bytes: bytes.into(), ..RECORDINGS[0].clone() }
}

pub async fn quiet_lab() -> (TestServer, Api) {
    let server = TestServer::start_with(&["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    (server, api)
}

async fn episode_count(api: &mut Api) -> usize {
    let request = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
    api.episodes.list_episodes(request).await.unwrap().into_inner().episodes.len()
}

#[tokio::test]
async fn files_that_are_no_recordings() {
    let (_server, mut api) = quiet_lab().await;
    let not_mcap =
        lab::push(&mut api, lab::TASK, &with_bytes(b"ply\nformat ascii 1.0\n".repeat(50))).await.unwrap_err();
    refused(&not_mcap, Code::InvalidArgument, &["MCAP"]);
    let empty = lab::push(&mut api, lab::TASK, &with_bytes(vec![])).await.unwrap_err();
    refused(&empty, Code::InvalidArgument, &["empty"]);
    let cut_in_the_header =
        lab::push(&mut api, lab::TASK, &with_bytes(RECORDINGS[0].bytes[..40].to_vec())).await.unwrap_err();
    refused(&cut_in_the_header, Code::InvalidArgument, &[]);
    assert_eq!(episode_count(&mut api).await, 0, "nothing half-done is visible");
}

#[tokio::test]
async fn a_truncated_recording_is_salvaged_and_says_so() {
    let (_server, mut api) = quiet_lab().await;
    let long = RECORDINGS[0].bytes.len();
    let episode =
        lab::push(&mut api, lab::TASK, &with_bytes(RECORDINGS[0].bytes[..long * 7 / 10].to_vec())).await.unwrap();
    assert!(episode.warnings >= 1);
    let report = api
        .episodes
        .get_episode(GetEpisodeRequest { episode_id: episode.id })
        .await
        .unwrap()
        .into_inner()
        .report
        .unwrap();
    assert!(report.findings.iter().any(|finding| finding.code == "truncated"), "{report:?}");
    let whole = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert!(episode.steps < whole.steps);
}

#[tokio::test]
async fn recordings_that_do_not_fit_their_task() {
    let (_server, mut api) = quiet_lab().await;
    let spec = gleaner_core::proto::task::spec_to_proto(gleaner_sim::task_spec(
        gleaner_sim::Task::PickCube,
        &lab::sim_config(),
    ));

    // Under names of their own, because what gleaner itself recorded of a task is read whatever the mappings say.
    let mut lost_topic = spec.clone();
    lost_topic.name = "lost_topic".into();
    lost_topic.cameras[0].name = "another".into();
    lost_topic.mappings[0].cameras[0].camera = "another".into();
    lost_topic.mappings[0].cameras[0].color = "/no/such/topic".into();
    let mut lost_field = spec.clone();
    lost_field.name = "lost_field".into();
    lost_field.proprioception[0].name = "another".into();
    lost_field.mappings[0].fields[0].field = "another".into();
    lost_field.mappings[0].fields[0].paths = vec!["no_such_field".into()];
    let mut other_size = spec;
    other_size.name = "other_size".into();
    other_size.cameras[0].height = 48;

    for (spec, words) in
        [(lost_topic, ["/no/such/topic", ""]), (lost_field, ["no_such_field", ""]), (other_size, ["48", "16"])]
    {
        let task = spec.name.clone();
        api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
        let error = lab::push(&mut api, &task, &RECORDINGS[0]).await.unwrap_err();
        refused(&error, Code::InvalidArgument, &words);
    }
}

#[tokio::test]
async fn a_recording_with_a_value_that_is_no_number() {
    let (_server, mut api) = quiet_lab().await;
    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &lab::sim_config());
    let frames = vec![0; gleaner_recording::frame_bytes_per_step(&spec)];
    let action = vec![0.0; spec.action_size()];
    let mut writer = gleaner_recording::EpisodeWriter::create(std::io::Cursor::new(Vec::new()), &spec).unwrap();
    for step in 0..8_u16 {
        let mut proprioception = vec![f32::from(step) / 10.0; spec.proprioception_size()];
        if step == 5 {
            proprioception[1] = f32::NAN;
        }
        let stamp = i64::from(step) * 100_000_000 + 1;
        let values = gleaner_recording::StepRef { frames: &frames, proprioception: &proprioception, action: &action };
        writer.step(stamp, values).unwrap();
    }
    let error = lab::push(&mut api, lab::TASK, &with_bytes(writer.finish().unwrap().into_inner())).await.unwrap_err();
    refused(&error, Code::InvalidArgument, &["5"]);
}

#[tokio::test]
async fn the_same_content_again() {
    let (_server, mut api) = quiet_lab().await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert_eq!(lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap(), episode);

    let relabelled = Recording { outcome: Outcome::Failure, ..RECORDINGS[0].clone() };
    let error = lab::push(&mut api, lab::TASK, &relabelled).await.unwrap_err();
    refused(&error, Code::AlreadyExists, &[&episode.id, "success", "label"]);
    assert_eq!(episode_count(&mut api).await, 1);
}

#[tokio::test]
async fn uploads_that_lie() {
    let (_server, mut api) = quiet_lab().await;
    let wrong_digest = StartUploadRequest {
        task: lab::TASK.into(),
        file_name: "x.mcap".into(),
        size_bytes: 4,
        blake3: "ab".repeat(32),
        outcome: Outcome::Unknown.into(),
        ..StartUploadRequest::default()
    };
    let upload = api.episodes.start_upload(wrong_digest.clone()).await.unwrap().into_inner().upload_id;
    lab::write(&mut api, &upload, 0, b"abcd".as_slice().into()).await.unwrap();
    refused(&lab::finish(&mut api, &upload).await.unwrap_err(), Code::InvalidArgument, &["blake3"]);

    let no_digest = StartUploadRequest { blake3: "sha256:…".into(), ..wrong_digest.clone() };
    refused(&api.episodes.start_upload(no_digest).await.unwrap_err(), Code::InvalidArgument, &["blake3", "64"]);
    let no_task = StartUploadRequest { task: "unheard_of".into(), ..wrong_digest.clone() };
    refused(&api.episodes.start_upload(no_task).await.unwrap_err(), Code::NotFound, &["unheard_of"]);
    let no_outcome = StartUploadRequest { outcome: 0, ..wrong_digest.clone() };
    refused(&api.episodes.start_upload(no_outcome).await.unwrap_err(), Code::InvalidArgument, &["outcome"]);
    let too_large = StartUploadRequest { size_bytes: u64::MAX, ..wrong_digest };
    refused(&api.episodes.start_upload(too_large).await.unwrap_err(), Code::ResourceExhausted, &["limit"]);

    let too_much = lab::start(&mut api, lab::TASK, &with_bytes(b"abcd".to_vec())).await.unwrap().upload_id;
    let error = lab::write(&mut api, &too_much, 0, b"abcdefgh".as_slice().into()).await.unwrap_err();
    refused(&error, Code::InvalidArgument, &["declared size of 4 bytes"]);
}

#[tokio::test]
async fn a_message_over_the_limit() {
    let server = TestServer::start_with(&["--workers", "0", "--max-message-bytes", "4194304"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let upload = lab::start(&mut api, lab::TASK, &with_bytes(vec![7; 6 << 20])).await.unwrap().upload_id;
    let message = WriteUploadRequest { upload_id: upload.clone(), offset: 0, data: vec![7; 5 << 20].into() };
    let error = api.episodes.write_upload(tokio_stream::iter([message])).await.unwrap_err();
    assert!(matches!(error.code(), Code::OutOfRange | Code::ResourceExhausted), "{error}");
    let request = GetUploadRequest { upload_id: upload };
    assert_eq!(api.episodes.get_upload(request).await.unwrap().into_inner().committed_size, 0);
}

#[tokio::test]
async fn jobs_that_cannot_be() {
    let (_server, mut api) = quiet_lab().await;
    let nothing = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap_err();
    refused(&nothing, Code::FailedPrecondition, &["expert"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let no_imperfect = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap_err();
    refused(&no_imperfect, Code::FailedPrecondition, &["imperfect"]);

    refused(&api.submit("nobody", lab::pretrain(2)).await.unwrap_err(), Code::NotFound, &["nobody"]);
    let wrong_id = api.submit(lab::TASK, lab::score("enc_7")).await.unwrap_err();
    refused(&wrong_id, Code::InvalidArgument, &["encoder_id"]);
    let no_encoder = api.submit(lab::TASK, lab::score("enc_01ARZ3NDEKTSV4RRFFQ69G5FAV")).await.unwrap_err();
    refused(&no_encoder, Code::NotFound, &["enc_01ARZ3NDEKTSV4RRFFQ69G5FAV"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[6]).await.unwrap();
    let job_spec::Spec::Pretrain(mut spec) = lab::pretrain(2) else { unreachable!() };
    let number = prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(f64::NAN)) };
    spec.settings.as_mut().unwrap().fields.insert("learning_rate".into(), number);
    let error = api.submit(lab::TASK, job_spec::Spec::Pretrain(spec)).await.unwrap_err();
    refused(&error, Code::InvalidArgument, &["learning_rate"]);
    refused(&api.watch_unknown().await, Code::NotFound, &["job_01ARZ3NDEKTSV4RRFFQ69G5FAV"]);
}

impl Api {
    async fn watch_unknown(&mut self) -> Status {
        let request = WatchJobRequest { job_id: "job_01ARZ3NDEKTSV4RRFFQ69G5FAV".into() };
        self.jobs.watch_job(request).await.unwrap_err()
    }
}

#[tokio::test]
async fn tasks_that_make_no_sense() {
    let (_server, mut api) = quiet_lab().await;
    let good = gleaner_core::proto::task::spec_to_proto(gleaner_sim::task_spec(
        gleaner_sim::Task::PickCube,
        &lab::sim_config(),
    ));
    let again = api.tasks.create_task(CreateTaskRequest { spec: Some(good.clone()) }).await.unwrap_err();
    refused(&again, Code::AlreadyExists, &[lab::TASK]);
    let other = TaskSpec { name: "other".into(), ..good };
    let mut no_rate = other.clone();
    no_rate.rate_hz = 0.0;
    let mut no_action = other.clone();
    no_action.action.clear();
    let mut huge = other.clone();
    huge.cameras[0].width = u32::MAX;
    for (spec, word) in [(no_rate, "rate_hz"), (no_action, "action"), (huge, "cameras[0]")] {
        let error = api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap_err();
        refused(&error, Code::InvalidArgument, &[word]);
    }
    let error = api.tasks.create_task(CreateTaskRequest { spec: None }).await.unwrap_err();
    refused(&error, Code::InvalidArgument, &["spec"]);
}

/// A record length of 2⁶³ and a chunk that claims terabytes: the inspecting child may die, the server may not.
#[tokio::test]
async fn recordings_that_kill_their_reader() {
    let (_server, mut api) = quiet_lab().await;
    for at in (8..400).step_by(13) {
        let mut bytes = RECORDINGS[0].bytes.to_vec();
        bytes[at..at + 8].copy_from_slice(&(1_u64 << 62).to_le_bytes());
        match lab::push(&mut api, lab::TASK, &with_bytes(bytes)).await {
            Ok(episode) => assert!(episode.steps > 0),
            Err(status) => refused(&status, Code::InvalidArgument, &[]),
        }
    }
    assert!(lab::push(&mut api, lab::TASK, &RECORDINGS[1]).await.is_ok(), "the server still works");
}
