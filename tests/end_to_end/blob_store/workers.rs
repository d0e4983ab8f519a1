//! Workers whose blobs are in a bucket: they have no credentials of it, read at signed URLs or by the server, and store by
//! the server.

use std::{collections::BTreeSet, fs};

use gleaner_bucket::testing::TestStore;
use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    blob_store::{forget_copies, start},
    command, files, lab,
    process::workers,
    server::TestServer,
};

/// The names of the blobs in the bucket.
fn objects(store: &TestStore) -> BTreeSet<String> {
    let listed = store.bucket("one").unwrap().list("blobs").unwrap();
    listed.into_iter().map(|object| object.name).filter(|name| !name.contains("trash")).collect()
}

/// Watches a job succeed, and checks the environments of the workers that run meanwhile.
async fn succeed_without_credentials(server: &TestServer, api: &mut Api, spec: job_spec::Spec) -> Job {
    let job = api.submit(lab::TASK, spec).await.unwrap();
    let mut seen = 0;
    let ended = api
        .watch_until(&job.id, |job| {
            for pid in workers(server.pid()) {
                // It may have ended, or not yet have its program.
                let environment = fs::read_to_string(format!("/proc/{pid}/environ")).unwrap_or_default();
                assert!(!environment.split('\0').any(|variable| variable.starts_with("AWS_")), "{environment}");
                seen += usize::from(environment.contains("GLEANER_JOB_TOKEN="));
            }
            gleaner_client::has_ended(job.state())
        })
        .await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    assert!(seen > 0, "no worker was seen");
    ended
}

/// The server itself has the credentials in its environment. By default workers read at URLs; without URLs the server
/// fetches for them.
#[tokio::test]
async fn workers_without_credentials_read_from_the_bucket_and_their_results_are_in_it() {
    for seconds in ["300", "0"] {
        let Some(store) = TestStore::start().unwrap() else { return };
        let server = start(&store, "one", &["--blob-store-url-seconds", seconds]).await;
        let mut api = Api::connect(&server).await;
        let episodes = lab::set_up(&mut api).await;
        let before = objects(&store);
        assert_eq!(before.len(), episodes.len());
        forget_copies(server.data_dir());
        let encoder = succeed_without_credentials(&server, &mut api, lab::pretrain(6)).await.result_id;
        assert!(objects(&store).difference(&before).next().is_some(), "the encoder");

        // The next worker has the encoder from the bucket alone.
        forget_copies(server.data_dir());
        let run = succeed_without_credentials(&server, &mut api, lab::score(&encoder)).await.result_id;
        let request = CreateDatasetRequest { score_run_id: run, selection: Some(lab::above(0.5)) };
        let dataset = api.datasets.create_dataset(request).await.unwrap().into_inner().dataset.unwrap().id;
        forget_copies(server.data_dir());
        let out = tempfile::tempdir().unwrap();
        let words = ["export", &dataset, "--format", "mcap", "--out", out.path().to_str().unwrap()];
        let exported = command::json(server.url(), &words).await;
        let stored = objects(&store);
        for file in exported["files"].as_array().unwrap() {
            let (name, digest) = (file["name"].as_str().unwrap(), file["blake3"].as_str().unwrap());
            assert_eq!(blake3::hash(&fs::read(out.path().join(name)).unwrap()).to_hex().as_str(), digest, "{name}");
            assert!(stored.contains(&format!("blobs/{}/{}", &digest[..2], &digest[2..])), "{name}");
        }
        let tmp = files::files(&server.data_dir().join("tmp"));
        assert!(tmp.is_empty(), "{tmp:?}");
        command::expect_sound(server.data_dir()).await;
    }
}

/// The server dies once the id of the checkpoint is committed, and every copy is lost.
#[tokio::test]
async fn a_job_resumes_from_a_checkpoint_that_only_the_bucket_has() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let mut server = start(&store, "one", &[]).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let straight = api.succeed(lab::TASK, lab::pretrain(24)).await;
    let losses = api.metric(&straight.id, "loss").await;
    let before = objects(&store);
    let job = api.submit(lab::TASK, lab::pretrain(24)).await.unwrap();
    server.kill().await;
    assert!(server.start_where_it_was(Some("checkpoint.committed")).await);
    server.ended().await;
    assert!(objects(&store).difference(&before).next().is_some(), "the checkpoint is in the bucket");
    forget_copies(server.data_dir());

    assert!(server.start_where_it_was(None).await);
    let mut api = Api::connect(&server).await;
    let ended = api.watch(&job.id).await;
    assert_eq!(ended.state(), JobState::Succeeded, "{}", ended.error);
    assert_eq!(api.metric(&job.id, "loss").await, losses);
}

#[tokio::test]
async fn an_altered_recording_fails_its_job_with_the_reason() {
    let Some(store) = TestStore::start().unwrap() else { return };
    let server = start(&store, "one", &[]).await;
    let mut api = Api::connect(&server).await;
    let digest = lab::set_up(&mut api).await[0].blake3.clone();
    forget_copies(server.data_dir());
    let altered = server.data_dir().join("altered");
    let mut bytes = lab::RECORDINGS[0].bytes.to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&altered, bytes).unwrap();
    let name = format!("blobs/{}/{}", &digest[..2], &digest[2..]);
    store.bucket("one").unwrap().put(&name, &altered).unwrap();
    let job = api.submit(lab::TASK, lab::pretrain(4)).await.unwrap();
    let ended = api.watch(&job.id).await;
    assert_eq!(ended.state(), JobState::Failed);
    let named = format!("the object {name} in {} (--blob-store) is damaged", store.config("one").url);
    assert!(ended.error.contains(&named), "{}", ended.error);
    assert!(!files::blob(server.data_dir(), &digest).exists());
}
