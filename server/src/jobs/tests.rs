//! The queue through its public functions: orders resolved, pipelines linked, results stored, watchers notified.

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_core::{PretrainSpec, ScoreSpec};

use super::{
    Jobs,
    chain::chain,
    testing::{self, Bench, pipeline},
};
use crate::{
    domain::{
        attempt::AttemptEnd,
        id::{BlobId, DatasetId, EncoderId, EpisodeId, JobId, ScoreRunId, SnapshotId, TaskId},
        job::{Job, JobSpec, JobState},
        order::{JobOrder, PipelineQueueing, Queueing, TrainData},
        schedule::PipelineSpec,
        score::EpisodeScores,
        selection::Selection,
        snapshot::{Role, RoleRule},
        work::{Made, Progress},
    },
    error::{Kind, Result},
    store::testing::results,
};

fn pretrain() -> JobOrder {
    JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() }
}

fn score_with(encoder: EncoderId) -> JobOrder {
    JobOrder::Score { encoder_id: Some(encoder), snapshot_id: None, extends: None, spec: ScoreSpec::default() }
}

async fn submit(bench: &Bench, order: JobOrder) -> Result<Job> {
    bench.jobs.submit(&bench.task.id, order, Queueing::default()).await
}

fn encoder(job: &Job) -> EncoderId {
    EncoderId::try_from(job.result_id.clone()).unwrap()
}

fn scores(episode: EpisodeId, role: Role, q: f32) -> EpisodeScores {
    EpisodeScores {
        episode_id: episode,
        role,
        w: vec![-1.0; 20],
        q: vec![q; 20],
        match_episode: vec![0; 20],
        match_step: vec![0; 20],
        distances: vec![[0.5, 0.25, 0.25]; 20],
    }
}

#[tokio::test]
async fn an_order_gets_a_snapshot_a_result_id_and_its_needs() {
    let bench = Bench::new().await;
    let first = submit(&bench, pretrain()).await.unwrap();
    let JobSpec::Pretrain { snapshot_id, .. } = &first.spec else { panic!("not pretrain") };
    assert_eq!((first.state, first.max_attempts, first.needs.len()), (JobState::Queued, 3, 0));

    let encoder_id = encoder(&first);
    let order = score_with(encoder_id.clone());
    let score = submit(&bench, order).await.unwrap();
    assert_eq!(score.needs, std::slice::from_ref(&first.id));
    assert!(matches!(&score.spec, JobSpec::Score { snapshot_id: own, .. } if own == snapshot_id));

    let order = JobOrder::Train { data: TrainData::ExpertsOf(encoder_id), spec: results::finetune() };
    let queueing =
        Queueing { priority: 7, needs: vec![score.id.clone()], max_attempts: Some(1), ..Queueing::default() };
    let base = bench.jobs.submit(&bench.task.id, order, queueing).await.unwrap();
    assert_eq!((base.priority, base.max_attempts, base.needs.len()), (7, 1, 2));
    assert!(matches!(&base.spec, JobSpec::Train { dataset_id: None, snapshot_id: own, .. } if own == snapshot_id));
}

#[tokio::test]
async fn missing_and_unfinished_inputs_are_rejected() {
    let bench = Bench::empty().await;
    assert_eq!(submit(&bench, pretrain()).await.unwrap_err().kind(), Kind::Precondition, "no episodes");
    let order = score_with(EncoderId::new());
    assert_eq!(submit(&bench, order).await.unwrap_err().kind(), Kind::NotFound);
    let order = JobOrder::Export { dataset_id: DatasetId::new(), spec: Default::default() };
    assert_eq!(submit(&bench, order).await.unwrap_err().kind(), Kind::NotFound);

    let bench = Bench::new().await;
    let first = submit(&bench, pretrain()).await.unwrap();
    let order = || score_with(encoder(&first));
    let error = bench.jobs.submit(&TaskId::new(), order(), Queueing::default()).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Invalid, "{error}");
    assert!(error.message().starts_with("spec.score.encoder_id: "), "{error}");
    bench.jobs.cancel(&first.id).await.unwrap();
    assert_eq!(submit(&bench, order()).await.unwrap_err().kind(), Kind::Precondition, "its job was cancelled");
}

#[tokio::test]
async fn a_pipeline_links_all_its_jobs() {
    let bench = Bench::new().await;
    let queueing = PipelineQueueing { priority: 4, ..PipelineQueueing::default() };
    let (jobs, dataset) = bench.jobs.submit_pipeline(&bench.task.id, &pipeline(), queueing, None).await.unwrap();
    let [first, score, train] = jobs.as_slice() else { panic!("{} jobs", jobs.len()) };
    assert_eq!((&score.needs, &train.needs), (&vec![first.id.clone()], &vec![score.id.clone()]));
    assert!(jobs.iter().all(|job| job.priority == 4));
    let dataset = bench.store.dataset(&dataset.unwrap()).await.unwrap();
    assert_eq!(
        (dataset.selection, String::from(dataset.score_run_id)),
        (Selection::beta(0.5), score.result_id.clone())
    );
    assert!(matches!(&train.spec, JobSpec::Train { dataset_id: Some(id), .. } if *id == dataset.id));

    let short = PipelineSpec { score: false, beta: None, train: None, ..pipeline() };
    let (jobs, dataset) =
        bench.jobs.submit_pipeline(&bench.task.id, &short, PipelineQueueing::default(), None).await.unwrap();
    assert_eq!((jobs.len(), dataset), (1, None));

    let queueing = || PipelineQueueing { engine_options: "--partition=gpu".into(), ..PipelineQueueing::default() };
    let refused = bench.jobs.submit_pipeline(&bench.task.id, &pipeline(), queueing(), None).await.unwrap_err();
    assert!(refused.message().starts_with("engine_options: this server runs jobs by the engine local"), "{refused}");
    let plan = chain(&bench.task.id, pipeline(), &SnapshotId::new(), queueing());
    assert!(plan.jobs.len() == 3 && plan.jobs.iter().all(|job| job.engine_options == "--partition=gpu"));
}

#[tokio::test]
async fn results_end_jobs_and_are_inputs_of_the_next() {
    let bench = Bench::new().await;
    let (jobs, dataset) =
        bench.jobs.submit_pipeline(&bench.task.id, &pipeline(), PipelineQueueing::default(), None).await.unwrap();
    let (attempt, job) = bench.claim().await;
    let inputs = bench.inputs(&job).await.unwrap();
    assert_eq!((inputs.experts.len(), inputs.imperfect.len(), inputs.encoder), (1, 1, None));
    let absent = BlobId::from(blake3::hash(b"absent"));
    let refused = bench.jobs.complete(&attempt, &job, Made::Encoder { checkpoint: absent }).await.unwrap_err();
    assert_eq!(refused.kind(), Kind::NotFound);
    let checkpoint = bench.blobs().put(b"encoder").unwrap();
    let wrong = Made::Policy { checkpoint: checkpoint.clone(), kind: "finetune".into() };
    assert_eq!(bench.jobs.complete(&attempt, &job, wrong).await.unwrap_err().kind(), Kind::Invalid);
    bench.jobs.complete(&attempt, &job, Made::Encoder { checkpoint: checkpoint.clone() }).await.unwrap();
    assert_eq!(bench.store.encoder(&encoder(&jobs[0])).await.unwrap().checkpoint, checkpoint);

    let (attempt, job) = bench.claim().await;
    let inputs = bench.inputs(&job).await.unwrap();
    assert_eq!(inputs.encoder, Some(checkpoint));
    let (expert, imperfect) = (inputs.experts[0].id.clone(), inputs.imperfect[0].id.clone());
    let made = |episodes| Made::Scores {
        lo: -2.0,
        hi: -0.5,
        quantiles: Vec::new(),
        expert_ids: vec![expert.clone()],
        episodes,
    };
    let mut short = scores(imperfect.clone(), Role::Imperfect, 0.8);
    short.q.pop();
    let stranger = scores(EpisodeId::new(), Role::Imperfect, 0.8);
    for wrong in [vec![], vec![short], vec![stranger], vec![scores(imperfect.clone(), Role::Imperfect, 1.5)]] {
        assert_eq!(bench.jobs.complete(&attempt, &job, made(wrong)).await.unwrap_err().kind(), Kind::Invalid);
    }
    let mut whole = scores(imperfect.clone(), Role::Imperfect, 0.2);
    whole.q[7] = 0.8;
    bench.jobs.complete(&attempt, &job, made(vec![whole])).await.unwrap();
    let run = ScoreRunId::try_from(job.result_id).unwrap();
    assert_eq!(bench.store.score_run(&run).await.unwrap().expert_ids, [expert]);

    let (_, job) = bench.claim().await;
    let inputs = bench.inputs(&job).await.unwrap();
    assert_eq!((inputs.experts.len(), inputs.imperfect.len(), inputs.kept.len()), (1, 0, 1));
    assert_eq!(inputs.kept[0].episode.id, imperfect);
    assert_eq!(inputs.kept[0].segments.iter().map(|kept| (kept.end_step, kept.weight)).collect::<Vec<_>>(), [(7, 0.8)]);

    let export =
        submit(&bench, JobOrder::Export { dataset_id: dataset.unwrap(), spec: Default::default() }).await.unwrap();
    let inputs = bench.inputs(&export).await.unwrap();
    assert_eq!((inputs.segment_length, inputs.kept[0].segments.len()), (6, 1));
    assert_eq!((inputs.kept[0].similarities.len(), inputs.kept[0].qualities[7]), (20, 0.8));
}

#[tokio::test]
async fn a_new_checkpoint_removes_the_old_one_unless_another_row_names_it() {
    let bench = Bench::new().await;
    let blobs = bench.blobs();
    submit(&bench, pretrain()).await.unwrap();
    submit(&bench, pretrain()).await.unwrap();
    let (one, job) = bench.claim().await;
    let (other, _) = bench.claim().await;
    let (first, second) = (blobs.put(b"first").unwrap(), blobs.put(b"second").unwrap());
    bench.jobs.checkpoint(&one, 10, &first).await.unwrap();
    bench.jobs.checkpoint(&other, 10, &first).await.unwrap();
    bench.jobs.checkpoint(&one, 20, &second).await.unwrap();
    assert!(blobs.contains(&first), "the other job resumes from it");
    bench.jobs.checkpoint(&other, 20, &second).await.unwrap();
    assert!(!blobs.contains(&first) && blobs.contains(&second));
    let absent = BlobId::from(blake3::hash(b"absent"));
    assert_eq!(bench.jobs.checkpoint(&one, 30, &absent).await.unwrap_err().kind(), Kind::NotFound);

    bench.jobs.complete(&one, &job, Made::Encoder { checkpoint: second.clone() }).await.unwrap();
    bench.jobs.fail(&other, "the loss is not finite".into(), false).await.unwrap();
    assert!(blobs.contains(&second), "it is an encoder now");
    assert_eq!(bench.store.job(&other.job_id).await.unwrap().error, "the loss is not finite");
}

#[tokio::test]
async fn a_watcher_sees_every_metric_and_the_end() {
    let bench = Bench::new().await;
    let id = submit(&bench, pretrain()).await.unwrap().id;
    let mut watched = Box::pin(bench.jobs.watch(&id).await.unwrap());
    let (job, metrics) = watched.next().await.unwrap().unwrap();
    assert_eq!((job.state, metrics.len()), (JobState::Queued, 0));

    let (attempt, job) = bench.claim().await;
    let metrics = (1..=5000).map(|step| (step, "loss".to_owned(), 0.5)).collect();
    bench.jobs.progress(&attempt, &Progress { done: 5000, total: 5000, metrics, ..Progress::default() }).await.unwrap();
    let checkpoint = bench.blobs().put(b"encoder").unwrap();
    bench.jobs.complete(&attempt, &job, Made::Encoder { checkpoint }).await.unwrap();
    let rest: Vec<_> = watched.try_collect().await.unwrap();
    let steps: Vec<u64> = rest.iter().flat_map(|(_, metrics)| metrics.iter().map(|metric| metric.step)).collect();
    assert_eq!(steps, (1..=5000).collect::<Vec<_>>());
    assert_eq!(rest.last().unwrap().0.state, JobState::Succeeded);
    assert_eq!(bench.jobs.watch(&JobId::new()).await.err().unwrap().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_stopping_server_ends_its_watchers() {
    let bench = Bench::new().await;
    let id = submit(&bench, pretrain()).await.unwrap().id;
    let watched = Box::pin(bench.jobs.watch(&id).await.unwrap());
    bench.jobs.stop().await;
    let error = watched.try_collect::<Vec<_>>().await.unwrap_err();
    assert_eq!(error.kind(), Kind::Unavailable);
}

#[tokio::test]
async fn a_new_server_resumes_the_jobs_of_a_dead_one() {
    let bench = Bench::new().await;
    let id = submit(&bench, pretrain()).await.unwrap().id;
    bench.claim().await;
    let next = testing::start(&bench.dir, &bench.store).await;
    assert_eq!(until_queued(&next, &id).await.attempt, 0);
    next.stop().await;
}

/// The start succeeds without that write, and no restart is needed once the disk works again.
#[tokio::test]
async fn the_end_of_an_attempt_is_stored_once_the_disk_accepts_it() {
    let bench = Bench::new().await;
    let id = submit(&bench, pretrain()).await.unwrap().id;
    bench.claim().await;
    crate::store::testing::set_read_only(&bench.store, true).await;
    let next = testing::start(&bench.dir, &bench.store).await;
    let (attempt, end) = (bench.store.running_attempts().await.unwrap().remove(0).attempt, AttemptEnd::Stopped);
    assert_eq!(bench.store.end_attempt(&attempt, &end).await.unwrap_err().kind(), Kind::Exhausted);
    crate::store::testing::set_read_only(&bench.store, false).await;
    assert_eq!(until_queued(&next, &id).await.attempt, 0);
    next.stop().await;
}

async fn until_queued(jobs: &Jobs, id: &JobId) -> Job {
    let watched = jobs.watch(id).await.unwrap().map(|seen| seen.unwrap().0);
    let queued = watched.filter(|job| std::future::ready(job.state == JobState::Queued));
    Box::pin(queued).next().await.unwrap()
}

/// On a full disk no job is claimed, and a failed attempt does not count.
#[tokio::test]
async fn a_nearly_full_disk_stops_the_queue_and_fails_no_job() {
    let free = std::sync::Arc::new(std::sync::atomic::AtomicU64::new(u64::MAX));
    let bench = Bench::on_a_small_disk(&free).await;
    let job = submit(&bench, pretrain()).await.unwrap();
    let (attempt, _) = bench.claim().await;
    free.store(0, std::sync::atomic::Ordering::Relaxed);
    for refused in [
        submit(&bench, pretrain()).await.map(drop),
        bench.jobs.submit_pipeline(&bench.task.id, &pipeline(), PipelineQueueing::default(), None).await.map(drop),
    ] {
        assert_eq!(refused.unwrap_err().kind(), Kind::Exhausted);
    }
    bench.jobs.fail(&attempt, "no space left on device".into(), true).await.unwrap();
    let waiting = bench.store.job(&job.id).await.unwrap();
    assert_eq!((waiting.state, waiting.attempt), (JobState::Queued, 0), "the queue resumes once there is room");
}
