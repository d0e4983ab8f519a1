//! Orders of every kind in the queue: keys, extensions, policies from scratch, evaluations.

mod scoring;

use futures::TryStreamExt as _;
use gleaner_core::{Chosen, EvaluateSpec, PretrainSpec, ScoreSpec, TrainSpec, kinds::Family};
use serde_json::json;

use self::scoring::extend;
use super::*;
use crate::{
    domain::{
        evaluation::SeedResult,
        id::SnapshotId,
        order::{JobFilter, Queueing, Subject, TrainData},
        score::ScoreRun,
        selection::Selection,
        snapshot::{Role, RoleRule},
        work::{FrozenRun, InputEpisode, InputPart, KeptInput, Made},
    },
    error::Kind,
    jobs::{input_episodes::PartSize, testing::Bench},
    store::testing::{self, results},
};

fn pretrain(seed: u64) -> JobOrder {
    let mut spec = PretrainSpec::default();
    spec.run.seed = seed;
    JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec }
}

/// The settings of a scoring: a scorer with some settings changed.
fn scoring(settings: serde_json::Value) -> ScoreSpec {
    ScoreSpec::from_values(settings.as_object().unwrap()).unwrap()
}

fn scratch(data: TrainData) -> JobOrder {
    let policy = Chosen::new(Family::Policy, "bc").unwrap();
    JobOrder::Train { data, spec: TrainSpec { policy, ..TrainSpec::default() } }
}

fn evaluate(subject: Subject, simulation: &str) -> JobOrder {
    let spec = EvaluateSpec {
        simulation: simulation.into(),
        episodes: 2,
        seeds: vec![0, 1],
        max_steps: 5,
        ..EvaluateSpec::default()
    };
    JobOrder::Evaluate { subject, spec }
}

async fn submit(bench: &Bench, order: JobOrder) -> Result<Job> {
    bench.jobs.submit(&bench.task.id, order, Queueing::default()).await
}

async fn submit_as(bench: &Bench, order: JobOrder, key: &str) -> Result<Job> {
    let queueing = Queueing { key: key.into(), ..Queueing::default() };
    bench.jobs.submit(&bench.task.id, order, queueing).await
}

#[tokio::test]
async fn a_key_is_one_job_until_that_job_fails() {
    let bench = Bench::new().await;
    let first = submit_as(&bench, pretrain(1), "cell 7").await.unwrap();
    assert_eq!(first.key, "cell 7");
    assert_eq!(submit_as(&bench, pretrain(1), "cell 7").await.unwrap(), first);
    assert_ne!(submit_as(&bench, pretrain(1), "cell 8").await.unwrap().id, first.id);
    assert_ne!(submit(&bench, pretrain(1)).await.unwrap().id, submit(&bench, pretrain(1)).await.unwrap().id);

    let error = submit_as(&bench, pretrain(2), "cell 7").await.unwrap_err();
    assert!(error.kind() == Kind::Exists && error.message().contains(first.id.as_str()), "{error}");

    bench.jobs.cancel(&first.id).await.unwrap();
    let again = submit_as(&bench, pretrain(2), "cell 7").await.unwrap();
    assert_ne!(again.id, first.id, "a cancelled job holds no key");
}

#[tokio::test]
async fn concurrent_callers_share_one_job() {
    let bench = Bench::new().await;
    let (one, other) = tokio::join!(submit_as(&bench, pretrain(1), "k"), submit_as(&bench, pretrain(1), "k"));
    assert_eq!(one.unwrap().id, other.unwrap().id);
}

#[tokio::test]
async fn a_policy_from_scratch_does_not_wait_for_an_encoder() {
    let bench = Bench::new().await;
    let first = submit(&bench, pretrain(1)).await.unwrap();
    let JobSpec::Pretrain { snapshot_id, .. } = &first.spec else { panic!("not pretrain") };
    let encoder = EncoderId::try_from(first.result_id.clone()).unwrap();
    for data in [TrainData::ExpertsOf(encoder), TrainData::ExpertsIn(snapshot_id.clone())] {
        let job = submit(&bench, scratch(data)).await.unwrap();
        assert!(job.needs.is_empty());
        let JobSpec::Train { encoder_id, snapshot_id: own, .. } = &job.spec else { panic!("not train") };
        assert_eq!((encoder_id, own), (&None, snapshot_id));
        let inputs = bench.inputs(&job).await.unwrap();
        assert_eq!((inputs.experts.len(), inputs.encoder), (1, None));
    }
    let unknown = submit(&bench, scratch(TrainData::ExpertsIn(SnapshotId::new()))).await.unwrap_err();
    assert_eq!(unknown.kind(), Kind::NotFound);
}

/// The worker gets as many parts as its episodes take, in the order of the snapshot.
#[tokio::test]
async fn episodes_come_in_parts_of_a_limited_size() {
    let bench = Bench::new().await;
    for outcome in [crate::domain::episode::Outcome::Failure; 4] {
        testing::episode(&bench.store, &bench.task, outcome, "").await;
    }
    let encoder = results::encoder(&bench.store, &bench.task).await;
    let members = bench.store.snapshot(&encoder.snapshot_id).await.unwrap().1;
    let imperfect = || members.iter().filter(|member| member.role == Role::Imperfect);
    let scores: Vec<_> =
        imperfect().map(|member| results::scores(&member.episode_id, Role::Imperfect, &[0.5; 20])).collect();
    let run = results::run(&bench.store, &bench.task, &encoder, &scores).await;
    let dataset = bench.store.insert_dataset(&run.id, Selection::beta(0.1)).await.unwrap();
    let size = PartSize { episodes: 2, steps: 42 };
    let parts = async |order| {
        let job = submit(&bench, order).await.unwrap();
        let parts = bench.jobs.parts(sources(&bench.jobs, &job.spec).await.unwrap(), size).await.unwrap();
        parts.try_collect::<Vec<InputPart>>().await.unwrap()
    };
    let ids = |episodes: &[InputEpisode]| episodes.iter().map(|episode| episode.id.clone()).collect::<Vec<_>>();
    let mut found = Vec::new();
    let mut sizes = Vec::new();
    for part in parts(pretrain(3)).await {
        sizes.push(match part {
            InputPart::Experts(episodes) => ("experts", episodes.len()),
            InputPart::Imperfect(episodes) => {
                found.extend(ids(&episodes));
                ("imperfect", episodes.len())
            }
            InputPart::Kept(kept) => ("kept", kept.len()),
        });
    }
    assert_eq!(sizes, [("experts", 1), ("imperfect", 2), ("imperfect", 2), ("imperfect", 1)]);
    assert!(imperfect().map(|member| &member.episode_id).eq(&found));

    let kept: Vec<KeptInput> = parts(scratch(TrainData::Dataset(dataset.id)))
        .await
        .into_iter()
        .filter_map(|part| if let InputPart::Kept(kept) = part { Some(kept) } else { None })
        .inspect(|kept| assert!(kept.len() <= 2, "two episodes of 20 steps complete a part"))
        .flatten()
        .collect();
    assert_eq!(kept.len(), 5);
    assert!(kept.iter().all(|kept| kept.segments.len() == 20 && kept.qualities.is_empty()));
}

#[tokio::test]
async fn an_evaluation_is_of_a_task_that_can_be_simulated() {
    let bench = Bench::new().await;
    let encoder = results::encoder(&bench.store, &bench.task).await;
    let policy = results::policy(&bench.store, &bench.task, &encoder, blake3::hash(b"policy").into()).await;
    for simulation in ["", "stack_cube", "juggle"] {
        let error = submit(&bench, evaluate(Subject::Policy(policy.id.clone()), simulation)).await.unwrap_err();
        assert!(error.message().starts_with("spec.evaluate.settings.simulation: "), "{error}");
        assert!(error.message().contains("python -m gleaner.simulators"), "{error}");
    }

    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &gleaner_sim::SimConfig::default());
    let task = bench.store.insert_task(&spec).await.unwrap();
    for outcome in [crate::domain::episode::Outcome::Success, crate::domain::episode::Outcome::Failure] {
        testing::episode(&bench.store, &task, outcome, "").await;
    }
    let encoder = results::encoder(&bench.store, &task).await;
    let mine = results::policy(&bench.store, &task, &encoder, blake3::hash(b"mine").into()).await;
    bench.store.deploy("cube@prod", &task.id, &crate::domain::policy::Assignment::of(&mine.id)).await.unwrap();
    let submit = async |subject| bench.jobs.submit(&task.id, evaluate(subject, ""), Queueing::default()).await;
    let stranger = submit(Subject::Policy(policy.id)).await.unwrap_err();
    assert!(stranger.message().starts_with("spec.evaluate.policy_id: "), "{stranger}");
    assert_eq!(submit(Subject::Policy(PolicyId::new())).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(submit(Subject::Deployment("missing".into())).await.unwrap_err().kind(), Kind::NotFound);

    let job = submit(Subject::Deployment("cube@prod".into())).await.unwrap();
    assert_eq!(job.needs, [mine.job_id().unwrap().clone()]);
    let JobSpec::Evaluate { policy_id, spec } = &job.spec else { panic!("not evaluate") };
    assert_eq!((policy_id, spec.simulation.as_str()), (&mine.id, "pick_cube"));
    assert_eq!(bench.inputs(&job).await.unwrap().policy, mine.training().map(|training| training.checkpoint.clone()));

    let result = |seed, episodes| SeedResult { seed, episodes, successes: 1, mean_steps: 5.0 };
    let of = |seeds| super::accept(&bench.store, &job, Made::Trials(seeds));
    assert!(of(vec![result(0, 2), result(1, 2)]).await.is_ok());
    for wrong in [vec![result(0, 2)], vec![result(1, 2), result(0, 2)], vec![result(0, 2), result(1, 3)]] {
        assert_eq!(of(wrong).await.unwrap_err().kind(), Kind::Invalid);
    }
}

#[tokio::test]
async fn jobs_on_imported_scores_wait_for_no_job() {
    let bench = Bench::new().await;
    let encoder = results::encoder(&bench.store, &bench.task).await;
    let dataset = async |encoder_id| {
        let run = results::import(&bench.store, &bench.task, &encoder, encoder_id).await;
        (bench.store.insert_dataset(&run.id, Selection::beta(0.5)).await.unwrap().id, run)
    };
    let (plain, run) = dataset(None).await;
    let job = submit(&bench, scratch(TrainData::Dataset(plain.clone()))).await.unwrap();
    assert!(job.needs.is_empty());
    assert!(
        submit(&bench, JobOrder::Export { dataset_id: plain.clone(), spec: Default::default() })
            .await
            .unwrap()
            .needs
            .is_empty()
    );

    let finetune = |dataset| JobOrder::Train { data: TrainData::Dataset(dataset), spec: results::finetune() };
    let error = submit(&bench, finetune(plain)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("imported without an encoder"), "{error}");
    let (named, _) = dataset(Some(encoder.id.clone())).await;
    let job = submit(&bench, finetune(named)).await.unwrap();
    assert!(matches!(job.spec, JobSpec::Train { encoder_id: Some(id), .. } if id == encoder.id));

    let error = submit(&bench, extend(&run, None, ScoreSpec::default())).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("was imported"), "{error}");
}
