//! Orders of scorings: the encoder and the episodes that the server chooses, and extensions of earlier runs.

use super::*;

/// A finished run of two experts and an imperfect episode, whose job had these settings.
async fn run(bench: &Bench, spec: ScoreSpec) -> ScoreRun {
    let encoder = results::encoder(&bench.store, &bench.task).await;
    results::run_of(&bench.store, &bench.task, &encoder, spec, &[]).await
}

pub(super) fn extend(run: &ScoreRun, snapshot_id: Option<SnapshotId>, spec: ScoreSpec) -> JobOrder {
    JobOrder::Score { encoder_id: None, snapshot_id, extends: Some(run.id.clone()), spec }
}

#[tokio::test]
async fn an_extension_has_the_settings_of_its_base() {
    let bench = Bench::new().await;
    let frozen = scoring(json!({"scorer": "ssdf", "similarity": "last_cosine", "normaliser": "quantile"}));
    let base = run(&bench, frozen.clone()).await;
    testing::episode(&bench.store, &bench.task, crate::domain::episode::Outcome::Success, "").await;
    let grown = bench.store.create_snapshot(&bench.task.id, &RoleRule::default()).await.unwrap().id;
    let unnamed = submit(&bench, extend(&base, None, ScoreSpec::default())).await.unwrap();
    let JobSpec::Score { snapshot_id: renewed, .. } = &unnamed.spec else { panic!("not score") };
    let members = async |id| {
        let members = bench.store.snapshot(id).await.unwrap().1.into_iter();
        members.map(|member| member.episode_id).collect::<Vec<_>>()
    };
    assert_eq!(members(renewed).await, members(&grown).await, "the present episodes, without a snapshot");
    let job = submit(&bench, extend(&base, Some(grown.clone()), ScoreSpec::default())).await.unwrap();
    let JobSpec::Score { encoder_id, snapshot_id, extends, spec } = &job.spec else { panic!("not score") };
    assert_eq!((Some(encoder_id), snapshot_id, extends.as_ref()), (base.origin.encoder_id(), &grown, Some(&base.id)));
    assert_eq!(*spec, frozen);
    let named = submit(&bench, extend(&base, Some(grown), scoring(json!({"scorer": "ssdf"})))).await.unwrap();
    assert!(matches!(&named.spec, JobSpec::Score { spec, .. } if *spec == frozen));

    let inputs = bench.inputs(&job).await.unwrap();
    let FrozenRun { lo, hi, quantiles, expert_ids } = inputs.base.unwrap();
    assert_eq!((lo, hi, quantiles, expert_ids), (base.lo, base.hi, base.quantiles, base.expert_ids));
    assert_eq!(inputs.experts.len(), 2);
}

#[tokio::test]
async fn an_invalid_extension_is_rejected() {
    let bench = Bench::new().await;
    let base = run(&bench, ScoreSpec::default()).await;
    let refused = async |order| submit(&bench, order).await.unwrap_err();
    let cosine = scoring(json!({"similarity": "last_cosine"}));
    let error = refused(extend(&base, None, cosine)).await;
    assert!(error.message().starts_with("spec.score.settings.similarity: "), "{error}");
    let classifier = scoring(json!({"scorer": "classifier"}));
    let error = refused(extend(&base, None, classifier)).await;
    assert!(error.message().starts_with("spec.score.extends: "), "{error}");
    let other = JobOrder::Score {
        encoder_id: Some(results::encoder(&bench.store, &bench.task).await.id),
        snapshot_id: None,
        extends: Some(base.id.clone()),
        spec: ScoreSpec::default(),
    };
    let error = refused(other).await;
    assert!(error.message().starts_with("spec.score.encoder_id: "), "{error}");

    let strangers = ["stranger", "failed"];
    testing::episode(&bench.store, &bench.task, crate::domain::episode::Outcome::Success, strangers[0]).await;
    testing::episode(&bench.store, &bench.task, crate::domain::episode::Outcome::Failure, strangers[1]).await;
    let rule = RoleRule {
        expert_cohorts: vec![strangers[0].into()],
        imperfect_cohorts: vec![strangers[1].into()],
        ..RoleRule::default()
    };
    let without = bench.store.create_snapshot(&bench.task.id, &rule).await.unwrap().id;
    let error = refused(extend(&base, Some(without), ScoreSpec::default())).await;
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains(base.expert_ids[0].as_str()), "{error}");

    let encoder = results::encoder(&bench.store, &bench.task).await;
    let (job, unfinished) = results::scoring(&bench.store, &bench.task, &encoder).await;
    let unfinished = ScoreRun { id: unfinished, ..base };
    let error = refused(extend(&unfinished, None, ScoreSpec::default())).await;
    assert!(error.kind() == Kind::Precondition && error.message().contains(job.as_str()), "{error}");
}

/// The first scoring of a task queues an untrained encoder with it, in one transaction and once for a key.
#[tokio::test]
async fn a_scorer_that_reads_no_encoder_needs_none() {
    let bench = Bench::new().await;
    let score =
        |settings| JobOrder::Score { encoder_id: None, snapshot_id: None, extends: None, spec: scoring(settings) };
    let pretrainings = async || {
        let filter = JobFilter { kind: Some(JobKind::Pretrain), ..JobFilter::default() };
        bench.store.jobs(&filter, None, 10).await.unwrap().0.len()
    };
    let error = submit(&bench, score(json!({"scorer": "ssdf"}))).await.unwrap_err();
    assert!(error.message().starts_with("spec.score.encoder_id: must be set: the scorer ssdf"), "{error}");
    assert_eq!(pretrainings().await, 0, "a refused order queues nothing");

    let first = submit_as(&bench, score(json!({})), "k").await.unwrap();
    let JobSpec::Score { encoder_id: untrained, snapshot_id, .. } = &first.spec else { panic!("not score") };
    let [maker] = &first.needs[..] else { panic!("{:?}", first.needs) };
    let maker = bench.store.job(maker).await.unwrap();
    assert!(maker.result_id == untrained.as_str() && maker.key.is_empty());
    assert!(
        matches!(&maker.spec, JobSpec::Pretrain { snapshot_id: own, spec } if own == snapshot_id && spec.is_untrained())
    );
    assert_eq!(submit_as(&bench, score(json!({})), "k").await.unwrap(), first);
    let again = submit(&bench, score(json!({}))).await.unwrap();
    assert!(matches!(&again.spec, JobSpec::Score { encoder_id, .. } if encoder_id == untrained));
    assert_eq!(pretrainings().await, 1);
    let error = submit(&bench, score(json!({"scorer": "ssdf"}))).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Invalid, "an untrained encoder is not read");

    let run = ScoreRunId::parse("result_id", &first.result_id).unwrap();
    let dataset = bench.store.insert_dataset(&run, Selection::beta(0.5)).await.unwrap().id;
    let finetune = JobOrder::Train { data: TrainData::Dataset(dataset.clone()), spec: results::finetune() };
    let error = submit(&bench, finetune).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("an encoder of one step"), "{error}");
    submit(&bench, scratch(TrainData::Dataset(dataset))).await.unwrap();

    let trained = submit(&bench, pretrain(1)).await.unwrap();
    for settings in [json!({}), json!({"scorer": "ssdf"})] {
        let job = submit(&bench, score(settings)).await.unwrap();
        assert!(matches!(&job.spec, JobSpec::Score { encoder_id, .. } if encoder_id.as_str() == trained.result_id));
        assert_eq!(job.needs, std::slice::from_ref(&trained.id));
    }
    bench.jobs.cancel(&trained.id).await.unwrap();
    let job = submit(&bench, score(json!({}))).await.unwrap();
    assert!(
        matches!(&job.spec, JobSpec::Score { encoder_id, .. } if encoder_id == untrained),
        "a cancelled pretraining makes no encoder"
    );
}
