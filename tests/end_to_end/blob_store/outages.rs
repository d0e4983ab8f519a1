//! A bucket that is full, read-only or away, or does not accept the credentials: uploads and jobs outlast that, the
//! server answers meanwhile, and a start without a usable bucket ends with the settings to check.

use gleaner_bucket::testing::{KEY, KEY_ID, TestStore};
use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    blob_store::forget_copies,
    command::{self, expect_sound},
    errors::expect_error,
    gate::{Gate, Scope},
    lab::{self, RECORDINGS},
    server::{TestServer, serve},
};

/// A server whose bucket is behind a gate, with more flags.
async fn start(gate: &Gate, store: &TestStore, more: &[&str]) -> TestServer {
    let flags = gate.flags(store, "one");
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    TestServer::start_with(&[&flags[..], more].concat()).await
}

#[tokio::test]
async fn an_upload_that_the_bucket_refuses_is_kept_and_its_error_names_the_settings() {
    let Some(store) = TestStore::moto().unwrap() else { return };
    let gate = Gate::before(&store).await;
    let server = start(&gate, &store, &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let mut stored = vec![lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap()];
    let keys = "check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY";
    let cases = [
        (Scope::Writes, "QuotaExceeded", "the bucket is full, or a quota"),
        (Scope::Writes, "AccessDenied", "may read and not write: grant them s3:PutObject"),
        (Scope::Every, "RequestTimeTooSkewed", "the clock of this machine differs"),
        (Scope::Every, "InvalidAccessKeyId", keys),
        (Scope::Every, "SignatureDoesNotMatch", keys),
    ];
    for ((scope, code, reason), recording) in cases.into_iter().zip(&RECORDINGS[1..]) {
        let upload = lab::start(&mut api, lab::TASK, recording).await.unwrap().upload_id;
        let written = lab::write(&mut api, &upload, 0, recording.bytes.clone()).await.unwrap();
        gate.refuse(scope, code);
        let error = lab::finish(&mut api, &upload).await.unwrap_err();
        expect_error(&error, Code::Unavailable, &[reason, "(--blob-store)"]);
        assert_eq!(api.episodes().await, stored, "{code}: the server answers, and shows only what is stored");
        assert!(api.download(&stored[0].id).await == RECORDINGS[0].bytes, "{code}: copies are read");
        assert_eq!(api.committed_size(&upload).await.unwrap(), written, "{code}: the upload is kept");
        gate.pass();
        stored.push(lab::finish(&mut api, &upload).await.unwrap());
    }
    forget_copies(server.data_dir());
    for (episode, recording) in stored.iter().zip(RECORDINGS.iter()) {
        assert!(api.download(&episode.id).await == recording.bytes, "{} in the bucket", recording.name);
    }
    expect_sound(server.data_dir()).await;
}

/// Moto checks no signatures, so the gate refuses in its place; another store refuses the keys itself.
#[tokio::test]
async fn a_start_with_wrong_credentials_ends_with_the_variables_to_check() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let gate = Gate::before(&store).await;
    let mut server = start(&gate, &store, &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    assert!(server.stop().await);

    let new = tempfile::tempdir().unwrap();
    let (used, unused) = (server.data_dir().to_owned(), new.path().join("lab"));
    let flags = gate.flags(&store, "one");
    for (id, secret, code) in
        [("another-id", KEY, "InvalidAccessKeyId"), (KEY_ID, "another-secret", "SignatureDoesNotMatch")]
    {
        if store.pid().is_some() {
            gate.refuse(Scope::Every, code);
        }
        for folder in [&used, &unused] {
            let mut command = serve(folder, &flags, "127.0.0.1:0");
            command.env("AWS_ACCESS_KEY_ID", id).env("AWS_SECRET_ACCESS_KEY", secret);
            let output = command::run(&mut command).await;
            let text = output.text();
            assert!(!output.success, "{code}: {text}");
            for part in ["check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY", "(--blob-store)"] {
                assert!(text.contains(part), "{code}: {part}: {text}");
            }
            assert!(!text.contains("another-secret"), "{code}: {text}");
        }
    }
    gate.pass();
    server.start_again().await;
    assert_eq!(Api::connect(&server).await.episodes().await, [episode]);
    expect_sound(&used).await;
}

/// The bucket refuses the reads of the job, then holds its first checkpoint, and then is full.
#[tokio::test]
async fn a_job_outlasts_an_outage_of_its_bucket_with_the_same_losses() {
    let Some(store) = TestStore::moto().unwrap() else { return };
    let gate = Gate::before(&store).await;
    let server = start(&gate, &store, &[]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    forget_copies(server.data_dir());

    gate.refuse(Scope::Every, "AccessDenied");
    let job = api.submit(lab::TASK, lab::pretrain(24)).await.unwrap();
    gate.stopped("HEAD", 2).await;
    gate.hold(Scope::Writes);
    gate.stopped("PUT", 1).await;
    assert_eq!(api.episodes().await, episodes, "the server answers while its bucket hangs");
    let request = GetJobRequest { job_id: job.id.clone() };
    let waiting = api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap();
    assert_eq!((waiting.state(), waiting.attempt), (JobState::Running, 1), "{}", waiting.error);
    gate.refuse(Scope::Writes, "QuotaExceeded");
    gate.stopped("PUT", 2).await;
    gate.pass();

    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    let undisturbed = api.succeed(lab::TASK, lab::pretrain(24)).await;
    let losses = api.metric(&job.id, "loss").await;
    assert_eq!(losses.len(), 24, "no step is lost or repeated");
    assert_eq!(losses, api.metric(&undisturbed.id, "loss").await);
    expect_sound(server.data_dir()).await;
}
