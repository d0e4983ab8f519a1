//! Retries on a queue without workers.

use gleaner_core::{EvaluateSpec, PretrainSpec};

use super::*;
use crate::{
    domain::{
        attempt::AttemptEnd,
        job::JobSpec,
        order::{JobFilter, JobOrder, PipelineQueueing, Queueing, Subject, TrainData},
        schedule::PipelineSpec,
        selection::Selection,
        snapshot::RoleRule,
    },
    error::Kind,
    jobs::testing::{self, Bench},
    store::testing::results,
};

fn pipeline() -> PipelineSpec {
    PipelineSpec { beta: Some(0.75), ..testing::pipeline() }
}

fn pretrain(seed: u64) -> JobOrder {
    let mut spec = PretrainSpec::default();
    spec.run.seed = seed;
    JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec }
}

impl Bench {
    async fn pretrain(&self, seed: u64, needs: &[&Job]) -> Job {
        let needs = needs.iter().map(|job| job.id.clone()).collect();
        let queueing = Queueing { needs, ..Queueing::default() };
        self.jobs.submit(&self.task.id, pretrain(seed), queueing).await.unwrap()
    }

    /// The queued jobs, oldest first.
    async fn queued(&self) -> Vec<Job> {
        let filter = JobFilter { state: Some(JobState::Queued), ..JobFilter::default() };
        let (mut jobs, _) = self.store.jobs(&filter, None, 100).await.unwrap();
        jobs.reverse();
        jobs
    }
}

#[tokio::test]
async fn dependents_of_a_failed_job_follow_its_retry() {
    let bench = Bench::new().await;
    let (old, dataset) = bench
        .jobs
        .submit_pipeline(
            &bench.task.id,
            &pipeline(),
            PipelineQueueing { priority: 3, ..PipelineQueueing::default() },
            None,
        )
        .await
        .unwrap();
    let refused = bench.jobs.retry(&old[0].id).await.unwrap_err();
    assert!(refused.kind() == Kind::Precondition && refused.message().contains("queued"), "{refused}");
    let (attempt, _) = bench.claim().await;
    bench.store.end_attempt(&attempt, &AttemptEnd::Permanent("no such device".into())).await.unwrap();
    assert!(old.len() == 3 && bench.store.job(&old[2].id).await.unwrap().state == JobState::Failed);

    let first = bench.jobs.retry(&old[0].id).await.unwrap();
    let (mut all, _) = bench.store.jobs(&JobFilter::default(), None, 10).await.unwrap();
    all.reverse();
    let [pretrain, score, train] = &all[3..] else { panic!("not three new jobs") };
    assert_eq!((&pretrain.id, &pretrain.spec, pretrain.priority), (&first.id, &old[0].spec, 3));
    assert_eq!((&score.needs, &train.needs), (&vec![pretrain.id.clone()], &vec![score.id.clone()]));
    let JobSpec::Score { encoder_id, .. } = &score.spec else { panic!("no scoring") };
    assert_eq!(encoder_id.as_str(), pretrain.result_id);
    let JobSpec::Train { encoder_id, dataset_id: Some(new), .. } = &train.spec else { panic!("no training") };
    assert_eq!(encoder_id.as_ref().unwrap().as_str(), pretrain.result_id);
    let new = bench.store.dataset(new).await.unwrap();
    assert_eq!((new.score_run_id.as_str(), new.selection), (score.result_id.as_str(), Selection::beta(0.75)));
    assert_ne!(Some(new.id), dataset);
}

#[tokio::test]
async fn a_key_finds_the_retry_of_its_job() {
    let bench = Bench::new().await;
    let order = pretrain(0);
    let queueing = || Queueing { key: "cell 7".into(), max_attempts: Some(2), ..Queueing::default() };
    let job = bench.jobs.submit(&bench.task.id, order.clone(), queueing()).await.unwrap();
    bench.jobs.cancel(&job.id).await.unwrap();
    let again = bench.jobs.retry(&job.id).await.unwrap();
    assert!(again.id != job.id && (again.key.as_str(), again.max_attempts) == ("cell 7", 2));
    let repeated = bench.jobs.submit(&bench.task.id, order, queueing()).await.unwrap();
    assert_eq!(repeated, again, "a repeated submission returns the retry");
    assert_eq!(bench.jobs.retry(&JobId::new()).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_repeated_retry_queues_one_job() {
    let bench = Bench::new().await;
    let job = bench.jobs.submit(&bench.task.id, pretrain(0), Queueing::default()).await.unwrap();
    bench.jobs.cancel(&job.id).await.unwrap();
    let both = tokio::join!(bench.jobs.retry(&job.id), bench.jobs.retry(&job.id));
    let (Ok(again), Err(refused)) = (if both.0.is_ok() { both } else { (both.1, both.0) }) else { panic!("not once") };
    assert!(refused.kind() == Kind::Exists && refused.message().starts_with(again.id.as_str()), "{refused}");
    assert_eq!((again.spec, bench.queued().await.len()), (job.spec.clone(), 1));
    bench.jobs.cancel(&again.id).await.unwrap();
    assert!(bench.jobs.retry(&job.id).await.is_ok(), "it has ended");
}

#[tokio::test]
async fn dependents_of_another_failed_job_are_left_out() {
    let bench = Bench::new().await;
    let [a, c] = [bench.pretrain(1, &[]).await, bench.pretrain(2, &[]).await];
    let of_a = bench.pretrain(3, &[&a]).await;
    let of_both = bench.pretrain(4, &[&a, &c]).await;
    bench.pretrain(5, &[&of_both]).await;
    for _ in 0..2 {
        let (attempt, _) = bench.claim().await;
        bench.store.end_attempt(&attempt, &AttemptEnd::Permanent("no such device".into())).await.unwrap();
    }
    let again = bench.jobs.retry(&a.id).await.unwrap();
    let [first, second] = bench.queued().await.try_into().unwrap();
    assert_eq!((&first.id, &first.spec, &second.spec), (&again.id, &a.spec, &of_a.spec));
    assert_eq!(second.needs, [again.id]);
    let refused = bench.jobs.retry(&of_both.id).await.unwrap_err();
    assert!(refused.kind() == Kind::Precondition && refused.message().contains("submit that again"), "{refused}");
}

#[tokio::test]
async fn a_chain_that_cannot_be_queued_whole_is_not_queued_at_all() {
    let bench = Bench::new().await;
    let first = bench.pretrain(1, &[]).await;
    let keyed = |needs| Queueing { key: "mine".into(), needs, ..Queueing::default() };
    bench.jobs.submit(&bench.task.id, pretrain(2), keyed(vec![first.id.clone()])).await.unwrap();
    bench.jobs.cancel(&first.id).await.unwrap();
    let other = bench.jobs.submit(&bench.task.id, pretrain(3), keyed(Vec::new())).await.unwrap();
    let refused = bench.jobs.retry(&first.id).await.unwrap_err();
    assert!(refused.kind() == Kind::Exists && refused.message().contains("mine"), "{refused}");
    assert_eq!(bench.queued().await, [other]);
}

#[test]
fn every_spec_can_be_ordered_again() {
    use crate::domain::id::{DatasetId, EncoderId, PolicyId, SnapshotId};
    let (encoder, snapshot, dataset) = (EncoderId::new(), SnapshotId::new(), DatasetId::new());
    let train = |encoder_id, dataset_id| {
        JobOrder::from(JobSpec::Train {
            encoder_id,
            snapshot_id: snapshot.clone(),
            dataset_id,
            spec: results::finetune(),
        })
    };
    let data = |order| {
        let JobOrder::Train { data, .. } = order else { panic!("no training") };
        data
    };
    assert_eq!(data(train(Some(encoder.clone()), Some(dataset.clone()))), TrainData::Dataset(dataset));
    assert_eq!(data(train(Some(encoder.clone()), None)), TrainData::ExpertsOf(encoder));
    assert_eq!(data(train(None, None)), TrainData::ExpertsIn(snapshot.clone()));
    let policy = PolicyId::new();
    let spec = EvaluateSpec {
        simulation: "pick_cube".into(),
        episodes: 1,
        seeds: vec![4],
        max_steps: 9,
        ..EvaluateSpec::default()
    };
    let order = JobOrder::from(JobSpec::Evaluate { policy_id: policy.clone(), spec: spec.clone() });
    assert_eq!(order, JobOrder::Evaluate { subject: Subject::Policy(policy.clone()), spec });
    let other = PolicyId::new();
    let renamed = Renamed::from([(policy.to_string(), other.to_string())]);
    let JobOrder::Evaluate { subject, .. } = with_names(&order, &renamed).unwrap() else { panic!("no evaluation") };
    assert_eq!(subject, Subject::Policy(other));
}
