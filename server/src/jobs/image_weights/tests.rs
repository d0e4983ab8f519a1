//! Jobs that begin with weights: their content is chosen at submission, kept while it is needed, and no other is used.

use std::fs;

use gleaner_core::{PretrainSpec, TrainSpec};
use serde_json::json;
use tempfile::TempDir;

use crate::{
    domain::{
        id::BlobId,
        job::{Job, JobSpec},
        order::{JobOrder, PipelineQueueing, Queueing},
        schedule::PipelineSpec,
        selection::SelectionShape,
        snapshot::RoleRule,
    },
    error::{Kind, Result},
    jobs::testing::Bench,
};

const NAME: &str = "resnet18.safetensors";

/// A queue beside a folder that has one file of weights.
async fn bench() -> (TempDir, Bench) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join(NAME), b"weights").unwrap();
    let bench = Bench::with_image_weights(folder.path()).await;
    (folder, bench)
}

fn settings(weights: &str) -> gleaner_core::Values {
    json!({"image_encoder": "resnet18", "image_weights": weights}).as_object().unwrap().clone()
}

fn pretrain(weights: &str) -> JobOrder {
    let spec = PretrainSpec::from_values(&settings(weights)).unwrap();
    JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec }
}

async fn submit(bench: &Bench, order: JobOrder, key: &str) -> Result<Job> {
    let queueing = Queueing { key: key.into(), ..Queueing::default() };
    bench.jobs.submit(&bench.task.id, order, queueing).await
}

async fn rejected(bench: &Bench, weights: &str) -> String {
    let error = submit(bench, pretrain(weights), "").await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    error.message().to_owned()
}

fn digest(content: &[u8]) -> BlobId {
    blake3::hash(content).into()
}

fn digest_of(spec: &JobSpec) -> Option<BlobId> {
    spec.image_weights().unwrap().digest().cloned()
}

#[tokio::test]
async fn a_job_keeps_the_content_that_its_file_had_at_submission() {
    let (folder, bench) = bench().await;
    let first = submit(&bench, pretrain(NAME), "cell 7").await.unwrap();
    assert_eq!(digest_of(&first.spec), Some(digest(b"weights")));
    assert_eq!(bench.blobs().get(&digest(b"weights")).unwrap(), b"weights");

    fs::write(folder.path().join(NAME), b"others").unwrap();
    assert_eq!(submit(&bench, pretrain(NAME), "cell 7").await.unwrap(), first, "a key is one job");
    let second = submit(&bench, pretrain(NAME), "").await.unwrap();
    assert_eq!(digest_of(&second.spec), Some(digest(b"others")));
    let repeated = submit(&bench, JobOrder::from(first.spec.clone()), "").await.unwrap();
    assert_eq!(repeated.spec, first.spec);
}

#[tokio::test]
async fn weights_are_named_until_every_job_that_needs_them_has_ended() {
    let (_folder, bench) = bench().await;
    let weights = digest(b"weights");
    let jobs = [submit(&bench, pretrain(NAME), "").await.unwrap(), submit(&bench, pretrain(NAME), "").await.unwrap()];
    let named = bench.store.named_blobs().await.unwrap();
    let named: Vec<&str> = named.iter().filter(|row| row.blob == weights).map(|row| row.needed_by.as_str()).collect();
    assert_eq!(named, jobs.each_ref().map(|job| format!("{} (to begin with)", job.id)));
    for job in &jobs {
        assert!(bench.store.names_blob(&weights).await.unwrap());
        bench.jobs.cancel(&job.id).await.unwrap();
    }
    assert!(!bench.store.names_blob(&weights).await.unwrap());
}

#[tokio::test]
async fn a_retry_begins_with_the_same_content_or_is_rejected() {
    let (folder, bench) = bench().await;
    let weights = digest(b"weights");
    let job = submit(&bench, pretrain(NAME), "").await.unwrap();
    bench.jobs.cancel(&job.id).await.unwrap();
    let remove = async || {
        let removing = bench.blobs().removing().await.unwrap().unwrap();
        bench.blobs().remove(&weights, &removing).unwrap();
    };
    // The blob was swept, and the file has other content now.
    remove().await;
    fs::write(folder.path().join(NAME), b"others").unwrap();
    let error = bench.jobs.retry(&job.id).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    let parts = [digest(b"others"), weights.clone()].map(|digest| digest.as_str().to_owned());
    assert!(parts.iter().all(|part| error.message().contains(part)), "{error}");

    fs::write(folder.path().join(NAME), b"weights").unwrap();
    assert_eq!(bench.jobs.retry(&job.id).await.unwrap().spec, job.spec);
    assert!(bench.blobs().contains(&weights));
}

/// A pipeline whose pretraining and training begin with these files.
fn pipeline(encoder: &str, policy: &str) -> PipelineSpec {
    let mut of_policy = settings(policy);
    of_policy.insert("policy".into(), "bc".into());
    PipelineSpec {
        snapshot_id: None,
        rule: RoleRule::default(),
        pretrain: PretrainSpec::from_values(&settings(encoder)).unwrap(),
        score: true,
        beta: Some(0.5),
        top_fraction: None,
        shape: SelectionShape::default(),
        train: Some(TrainSpec::from_values(&of_policy).unwrap()),
        scoring: None,
        evaluate: None,
    }
}

#[tokio::test]
async fn every_job_of_a_pipeline_gets_its_content() {
    let (_folder, bench) = bench().await;
    let pipeline = pipeline(NAME, NAME);
    let (jobs, _) =
        bench.jobs.submit_pipeline(&bench.task.id, &pipeline, PipelineQueueing::default(), None).await.unwrap();
    let digests: Vec<_> = jobs.iter().map(|job| digest_of(&job.spec)).collect();
    assert_eq!(digests, [Some(digest(b"weights")), None, Some(digest(b"weights"))]);
}

#[tokio::test]
async fn files_that_the_server_lacks_are_rejected_with_those_it_has() {
    let (folder, bench) = bench().await;
    fs::write(folder.path().join("not a name"), b"x").unwrap();
    // What an order names by this text is a file without the digest in its name.
    let with_digest = format!("resnet34.safetensors@{}", digest(b"x").as_str());
    fs::write(folder.path().join(with_digest), b"x").unwrap();
    fs::create_dir(folder.path().join("inner")).unwrap();
    let large = fs::File::create(folder.path().join("large.safetensors")).unwrap();
    large.set_len(super::LARGEST + 1).unwrap();
    for absent in ["resnet34.safetensors", "inner"] {
        let message = rejected(&bench, absent).await;
        assert_eq!(
            message,
            format!(
                "image_weights: {absent} is not in the server's --image-weights-dir, which has large.safetensors, {NAME}"
            )
        );
    }
    let message = rejected(&bench, "large.safetensors").await;
    assert!(message.contains("has 268435457 bytes, weights have at most 268435456"), "{message}");
    let message = rejected(&Bench::new().await, NAME).await;
    assert!(message.contains("no folder of weights") && message.contains("--image-weights-dir"), "{message}");
    assert!(bench.store.named_blobs().await.unwrap().iter().all(|row| !row.needed_by.contains("begin with")));
}

/// A schedule tries again with each label and every ten minutes, and snapshots cannot be deleted.
#[tokio::test]
async fn orders_without_their_weights_leave_no_snapshot() {
    let (_folder, bench) = bench().await;
    rejected(&bench, "absent").await;
    for refused in [pipeline("absent", NAME), pipeline(NAME, "absent")] {
        let error = bench.jobs.submit_pipeline(&bench.task.id, &refused, PipelineQueueing::default(), None).await;
        assert_eq!(error.unwrap_err().kind(), Kind::Precondition);
    }
    assert!(bench.store.snapshots(&bench.task.id).await.unwrap().is_empty());
}
