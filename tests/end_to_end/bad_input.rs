//! Bad input: each is rejected with a status whose message names the field and the fix, and no data is lost.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_error},
    lab::{self, RECORDINGS, Recording},
};

fn with_bytes(bytes: Vec<u8>) -> Recording {
    Recording { bytes: bytes.into(), ..RECORDINGS[0].clone() }
}

async fn episode_count(api: &mut Api) -> usize {
    api.episodes().await.len()
}

#[tokio::test]
async fn files_that_are_not_recordings_are_rejected() {
    let (_server, mut api) = lab::idle().await;
    let not_mcap =
        lab::push(&mut api, lab::TASK, &with_bytes(b"ply\nformat ascii 1.0\n".repeat(50))).await.unwrap_err();
    expect_error(&not_mcap, Code::InvalidArgument, &["MCAP"]);
    let empty = lab::push(&mut api, lab::TASK, &with_bytes(vec![])).await.unwrap_err();
    expect_error(&empty, Code::InvalidArgument, &["empty"]);
    let cut_in_the_header =
        lab::push(&mut api, lab::TASK, &with_bytes(RECORDINGS[0].bytes[..40].to_vec())).await.unwrap_err();
    expect_error(&cut_in_the_header, Code::InvalidArgument, &[]);
    assert_eq!(episode_count(&mut api).await, 0, "no partial episode is visible");
}

#[tokio::test]
async fn truncated_recording_is_salvaged_with_a_finding() {
    let (_server, mut api) = lab::idle().await;
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
async fn recordings_that_do_not_match_their_task_are_rejected() {
    let (_server, mut api) = lab::idle().await;
    let spec = lab::spec_message();

    // Under other names, because gleaner reads its own recordings of a task without its mappings.
    let mut missing_topic = spec.clone();
    missing_topic.name = "missing_topic".into();
    missing_topic.cameras[0].name = "another".into();
    missing_topic.mappings[0].cameras[0].camera = "another".into();
    missing_topic.mappings[0].cameras[0].color = "/no/such/topic".into();
    let mut missing_field = spec.clone();
    missing_field.name = "missing_field".into();
    missing_field.proprioception[0].name = "another".into();
    missing_field.mappings[0].fields[0].field = "another".into();
    missing_field.mappings[0].fields[0].paths = vec!["no_such_field".into()];
    let mut other_size = spec;
    other_size.name = "other_size".into();
    other_size.cameras[0].height = 48;

    for (spec, words) in
        [(missing_topic, ["/no/such/topic", ""]), (missing_field, ["no_such_field", ""]), (other_size, ["48", "16"])]
    {
        let task = spec.name.clone();
        api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
        let error = lab::push(&mut api, &task, &RECORDINGS[0]).await.unwrap_err();
        expect_error(&error, Code::InvalidArgument, &words);
    }
}

#[tokio::test]
async fn recording_with_nan_is_rejected_with_its_step() {
    let (_server, mut api) = lab::idle().await;
    let spec = lab::spec();
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
    expect_error(&error, Code::InvalidArgument, &["5"]);
}

#[tokio::test]
async fn same_content_with_another_label_is_rejected() {
    let (_server, mut api) = lab::idle().await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert_eq!(lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap(), episode);

    let relabelled = Recording { outcome: Outcome::Failure, ..RECORDINGS[0].clone() };
    let error = lab::push(&mut api, lab::TASK, &relabelled).await.unwrap_err();
    expect_error(&error, Code::AlreadyExists, &[&episode.id, "success", "label"]);
    // An upload that states no label finds the episode with its own.
    let unlabelled = Recording { outcome: Outcome::Unknown, cohort: String::new(), ..RECORDINGS[0].clone() };
    assert_eq!(lab::push(&mut api, lab::TASK, &unlabelled).await.unwrap(), episode);
    let other_cohort = Recording { cohort: "other".into(), ..unlabelled };
    let error = lab::push(&mut api, lab::TASK, &other_cohort).await.unwrap_err();
    expect_error(&error, Code::AlreadyExists, &[&episode.id]);
    assert_eq!(episode_count(&mut api).await, 1);
}

#[tokio::test]
async fn uploads_with_a_wrong_size_or_digest_are_rejected() {
    let (_server, mut api) = lab::idle().await;
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
    expect_error(&lab::finish(&mut api, &upload).await.unwrap_err(), Code::InvalidArgument, &["blake3"]);

    let no_digest = StartUploadRequest { blake3: "sha256:…".into(), ..wrong_digest.clone() };
    expect_error(&api.episodes.start_upload(no_digest).await.unwrap_err(), Code::InvalidArgument, &["blake3", "64"]);
    let no_task = StartUploadRequest { task: "absent".into(), ..wrong_digest.clone() };
    expect_error(&api.episodes.start_upload(no_task).await.unwrap_err(), Code::NotFound, &["absent"]);
    let no_outcome = StartUploadRequest { outcome: 0, ..wrong_digest.clone() };
    expect_error(&api.episodes.start_upload(no_outcome).await.unwrap_err(), Code::InvalidArgument, &["outcome"]);
    let too_large = StartUploadRequest { size_bytes: u64::MAX, ..wrong_digest };
    expect_error(&api.episodes.start_upload(too_large).await.unwrap_err(), Code::ResourceExhausted, &["limit"]);

    let too_much = lab::start(&mut api, lab::TASK, &with_bytes(b"abcd".to_vec())).await.unwrap().upload_id;
    let error = lab::write(&mut api, &too_much, 0, b"abcdefgh".as_slice().into()).await.unwrap_err();
    expect_error(&error, Code::InvalidArgument, &["declared size of 4 bytes"]);
}

#[tokio::test]
async fn message_over_the_limit_is_rejected() {
    let (_server, mut api) = lab::with_task(&["--workers", "0", "--max-message-bytes", "4194304"]).await;
    let upload = lab::start(&mut api, lab::TASK, &with_bytes(vec![7; 6 << 20])).await.unwrap().upload_id;
    let message = WriteUploadRequest { upload_id: upload.clone(), offset: 0, data: vec![7; 5 << 20].into() };
    let error = api.episodes.write_upload(tokio_stream::iter([message])).await.unwrap_err();
    assert!(matches!(error.code(), Code::OutOfRange | Code::ResourceExhausted), "{error}");
    assert_eq!(api.committed_size(&upload).await.unwrap(), 0);
}

#[tokio::test]
async fn jobs_without_their_inputs_are_rejected() {
    let (_server, mut api) = lab::idle().await;
    let nothing = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap_err();
    expect_error(&nothing, Code::FailedPrecondition, &["expert"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let no_imperfect = api.submit(lab::TASK, lab::pretrain(2)).await.unwrap_err();
    expect_error(&no_imperfect, Code::FailedPrecondition, &["imperfect"]);

    expect_error(&api.submit("absent", lab::pretrain(2)).await.unwrap_err(), Code::NotFound, &["absent"]);
    let wrong_id = api.submit(lab::TASK, lab::score("enc_7")).await.unwrap_err();
    expect_error(&wrong_id, Code::InvalidArgument, &["encoder_id"]);
    let no_encoder = api.submit(lab::TASK, lab::score("enc_01ARZ3NDEKTSV4RRFFQ69G5FAV")).await.unwrap_err();
    expect_error(&no_encoder, Code::NotFound, &["enc_01ARZ3NDEKTSV4RRFFQ69G5FAV"]);
    lab::push(&mut api, lab::TASK, &RECORDINGS[6]).await.unwrap();
    let job_spec::Spec::Pretrain(mut spec) = lab::pretrain(2) else { unreachable!() };
    let number = prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(f64::NAN)) };
    spec.settings.as_mut().unwrap().fields.insert("learning_rate".into(), number);
    let error = api.submit(lab::TASK, job_spec::Spec::Pretrain(spec)).await.unwrap_err();
    expect_error(&error, Code::InvalidArgument, &["learning_rate"]);
    let request = WatchJobRequest { job_id: absent_id("job") };
    expect_error(&api.jobs.watch_job(request).await.unwrap_err(), Code::NotFound, &[&absent_id("job")]);
}

#[tokio::test]
async fn invalid_tasks_are_rejected() {
    let (_server, mut api) = lab::idle().await;
    let good = lab::spec_message();
    let again = api.tasks.create_task(CreateTaskRequest { spec: Some(good.clone()) }).await.unwrap_err();
    expect_error(&again, Code::AlreadyExists, &[lab::TASK]);
    let other = TaskSpec { name: "other".into(), ..good };
    let mut no_rate = other.clone();
    no_rate.rate_hz = 0.0;
    let mut no_action = other.clone();
    no_action.action.clear();
    let mut huge = other.clone();
    huge.cameras[0].width = u32::MAX;
    for (spec, word) in [(no_rate, "rate_hz"), (no_action, "action"), (huge, "cameras[0]")] {
        let error = api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap_err();
        expect_error(&error, Code::InvalidArgument, &[word]);
    }
    let error = api.tasks.create_task(CreateTaskRequest { spec: None }).await.unwrap_err();
    expect_error(&error, Code::InvalidArgument, &["spec"]);
}

/// Record lengths of 2⁶² and chunks that claim terabytes may end the inspector but not the server.
#[tokio::test]
async fn recordings_with_huge_lengths_do_not_stop_the_server() {
    let (_server, mut api) = lab::idle().await;
    for at in (8..400).step_by(13) {
        let mut bytes = RECORDINGS[0].bytes.to_vec();
        bytes[at..at + 8].copy_from_slice(&(1_u64 << 62).to_le_bytes());
        match lab::push(&mut api, lab::TASK, &with_bytes(bytes)).await {
            Ok(episode) => assert!(episode.steps > 0),
            Err(status) => expect_error(&status, Code::InvalidArgument, &[]),
        }
    }
    assert!(lab::push(&mut api, lab::TASK, &RECORDINGS[1]).await.is_ok(), "the server is still running");
}
