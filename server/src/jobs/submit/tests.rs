//! Keys of pipelines: a repeat returns the chain of the first call for as long as that may succeed. And pipelines that are
//! rejected because of a later stage.

use gleaner_core::{Chosen, EvaluateSpec, PretrainSpec, TrainSpec, kinds::Family};

use super::*;
use crate::{
    domain::{order::JobFilter, snapshot::RoleRule},
    jobs::testing::{Bench, pipeline},
};

type Chain = (Vec<JobId>, Option<DatasetId>);

async fn submit(bench: &Bench, pipeline: &PipelineSpec, key: &str) -> Result<Chain> {
    let queueing = PipelineQueueing { key: key.to_owned(), ..PipelineQueueing::default() };
    let (jobs, dataset) = bench.jobs.submit_pipeline(&bench.task.id, pipeline, queueing, None).await?;
    Ok((jobs.into_iter().map(|job| job.id).collect(), dataset))
}

async fn jobs(bench: &Bench) -> usize {
    bench.store.jobs(&JobFilter::default(), None, 100).await.unwrap().0.len()
}

#[tokio::test]
async fn a_repeated_pipeline_returns_the_chain_of_the_first_call() {
    let bench = Bench::new().await;
    let scored = PipelineSpec { train: None, ..pipeline() };
    let short = PipelineSpec { score: false, beta: None, ..scored.clone() };
    for (key, spec, count) in [("a", pipeline(), 3), ("b", scored, 5), ("c", short, 6)] {
        let first = submit(&bench, &spec, key).await.unwrap();
        assert_eq!(first.1.is_some(), spec.score, "{key}");
        assert_eq!(submit(&bench, &spec, key).await.unwrap(), first, "{key}");
        assert_eq!(jobs(&bench).await, count, "{key}");
    }
    let snapshots = bench.store.snapshots(&bench.task.id).await.unwrap().len();
    assert_eq!(snapshots, 3, "a repeat takes no snapshot");
    submit(&bench, &pipeline(), "").await.unwrap();
    submit(&bench, &pipeline(), "").await.unwrap();
    assert_eq!(jobs(&bench).await, 12, "without a key every call is a chain");
}

#[tokio::test]
async fn the_dataset_of_a_repeat_is_the_pipelines_own() {
    let bench = Bench::new().await;
    let first = submit(&bench, &pipeline(), "mine").await.unwrap();
    let run = bench.store.dataset(first.1.as_ref().unwrap()).await.unwrap().score_run_id;
    let other = crate::domain::selection::Selection::beta(0.9);
    assert_ne!(bench.store.insert_dataset(&run, other).await.unwrap().id, first.1.clone().unwrap());
    assert_eq!(submit(&bench, &pipeline(), "mine").await.unwrap(), first);
}

#[tokio::test]
async fn a_key_of_another_spec_is_refused() {
    let bench = Bench::new().await;
    submit(&bench, &pipeline(), "mine").await.unwrap();
    let error = submit(&bench, &PipelineSpec { beta: Some(0.9), ..pipeline() }, "mine").await.unwrap_err();
    assert!(error.kind() == Kind::Exists && error.message().contains("\"mine\""), "{error}");

    let order = || JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    let queueing = |key: &str| Queueing { key: key.to_owned(), ..Queueing::default() };
    let error = bench.jobs.submit(&bench.task.id, order(), queueing("mine")).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Exists, "{error}");
    let job = bench.jobs.submit(&bench.task.id, order(), queueing("job")).await.unwrap();
    assert_eq!(submit(&bench, &pipeline(), "job").await.unwrap_err().kind(), Kind::Exists);
    assert_eq!(bench.jobs.submit(&bench.task.id, order(), queueing("job")).await.unwrap(), job);
    assert_eq!(jobs(&bench).await, 4);
}

#[tokio::test]
async fn two_calls_at_once_queue_one_chain() {
    let bench = Bench::new().await;
    let pipeline = pipeline();
    let (one, other) = tokio::join!(submit(&bench, &pipeline, "mine"), submit(&bench, &pipeline, "mine"));
    assert_eq!(one.unwrap(), other.unwrap());
    assert_eq!(jobs(&bench).await, 3);
}

#[tokio::test]
async fn a_chain_that_cannot_succeed_any_more_frees_its_key_and_a_retried_one_has_it() {
    let bench = Bench::new().await;
    let first = submit(&bench, &pipeline(), "mine").await.unwrap();
    let (attempt, job) = bench.claim().await;
    assert_eq!(job.id, first.0[0]);
    bench.jobs.fail(&attempt, "the loss is not finite".into(), false).await.unwrap();

    bench.jobs.retry(&first.0[0]).await.unwrap();
    let again = submit(&bench, &pipeline(), "mine").await.unwrap();
    assert_eq!((again.0.len(), jobs(&bench).await), (3, 6), "the retry has the key");
    assert!(again.0.iter().all(|id| !first.0.contains(id)));
    let run = bench.store.dataset(again.1.as_ref().unwrap()).await.unwrap().score_run_id;
    assert_eq!(run.as_str(), bench.store.job(&again.0[1]).await.unwrap().result_id);

    bench.jobs.cancel(&again.0[0]).await.unwrap();
    let third = submit(&bench, &pipeline(), "mine").await.unwrap();
    assert_eq!(jobs(&bench).await, 9);
    assert_eq!(submit(&bench, &pipeline(), "mine").await.unwrap(), third);
}

#[tokio::test]
async fn trials_that_hide_a_history_need_a_policy_with_one() {
    let bench = Bench::new().await;
    let hiding = EvaluateSpec { hide_history: true, ..EvaluateSpec::default() };
    let of = |name: &str| TrainSpec { policy: Chosen::new(Family::Policy, name).unwrap(), ..TrainSpec::default() };
    let mut without = PretrainSpec::default();
    without.model.segment_length = 0;
    let refused = [
        PipelineSpec { train: Some(of("bc")), ..pipeline() },
        PipelineSpec { train: Some(of("finetune")), pretrain: without, ..pipeline() },
    ];
    for spec in refused {
        let name = spec.train.as_ref().unwrap().policy.name.clone();
        let error = submit(&bench, &PipelineSpec { evaluate: Some(hiding.clone()), ..spec }, "").await.unwrap_err();
        let words = format!(
            "pipeline.evaluate.settings.hide_history: needs a policy with a history: the policy {name} acts on the newest \
             step alone; leave it out"
        );
        assert_eq!(error.message(), words);
    }
    // The history is no reason to refuse these; the task of this bench cannot be simulated.
    for name in ["finetune", "tf_bc"] {
        let spec = PipelineSpec { train: Some(of(name)), evaluate: Some(hiding.clone()), ..pipeline() };
        let error = submit(&bench, &spec, "").await.unwrap_err();
        assert!(error.message().starts_with("pipeline.evaluate.settings.simulation: "), "{error}");
    }
    assert_eq!(jobs(&bench).await, 0);
}
