//! Results of jobs as fixtures: rows as those of a worker's results.

use gleaner_core::{Chosen, PretrainSpec, ScoreSpec, TrainSpec, kinds::Family};

use super::super::{Store, encoder as encoders, export as exports, policy as policies, row::Column as _, score, sql};
use crate::domain::{
    dataset::ExportFile,
    id::{BlobId, DatasetId, EncoderId, EpisodeId, ExportId, JobId, PolicyId, ScoreRunId},
    job::{JobSpec, JobState},
    order::{NewJob, Plan},
    policy::{Policy, PolicyOrigin, Training},
    score::{Encoder, EpisodeScores, Origin, ScoreRun},
    snapshot::{Role, RoleRule},
    task::Task,
    time::Millis,
};

/// A queued job whose result will be `result_id`.
pub(crate) async fn job(store: &Store, task: &Task, spec: JobSpec, result_id: &str) -> JobId {
    let job = NewJob {
        id: JobId::new(),
        task_id: task.id.clone(),
        spec,
        result_id: result_id.to_owned(),
        priority: 0,
        max_attempts: 1,
        engine_options: String::new(),
        needs: Vec::new(),
        keyed: None,
    };
    let id = job.id.clone();
    store.insert_plan(&Plan { jobs: vec![job], ..Plan::default() }).await.unwrap();
    id
}

/// Sets a job's state without a check of the transition.
pub(crate) async fn set_state(store: &Store, job: &JobId, state: JobState, error: &str) {
    let mut tx = store.write().await.unwrap();
    sql::query("update jobs set state = $1, error = $2 where id = $3")
        .bind(state.param())
        .bind(error)
        .bind(job.param())
        .execute(&mut tx)
        .await
        .unwrap();
    store.commit(tx).await.unwrap();
}

/// Gives a job a key, as that of an order that only names it.
pub(crate) async fn set_key(store: &Store, job: &JobId, key: &str) {
    let mut tx = store.write().await.unwrap();
    sql::query("update jobs set key = $1, ordered = '{}' where id = $2")
        .bind(key)
        .bind(job.param())
        .execute(&mut tx)
        .await
        .unwrap();
    store.commit(tx).await.unwrap();
}

/// An encoder of a snapshot of the task's present episodes, which must have both roles.
pub(crate) async fn encoder(store: &Store, task: &Task) -> Encoder {
    let snapshot_id = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap().id;
    let id = EncoderId::new();
    let spec = JobSpec::Pretrain { snapshot_id: snapshot_id.clone(), spec: PretrainSpec::default() };
    let encoder = Encoder {
        job_id: job(store, task, spec, id.as_str()).await,
        id,
        task_id: task.id.clone(),
        snapshot_id,
        checkpoint: blake3::hash(b"encoder").into(),
        created_at: Millis::now(),
    };
    let mut tx = store.write().await.unwrap();
    encoders::insert(&mut tx, &encoder).await.unwrap();
    store.commit(tx).await.unwrap();
    encoder
}

/// A queued scoring of the encoder's snapshot, and the id its run will have.
pub(crate) async fn scoring(store: &Store, task: &Task, encoder: &Encoder) -> (JobId, ScoreRunId) {
    scoring_with(store, task, encoder, ScoreSpec::default()).await
}

async fn scoring_with(store: &Store, task: &Task, encoder: &Encoder, spec: ScoreSpec) -> (JobId, ScoreRunId) {
    let id = ScoreRunId::new();
    let spec = JobSpec::Score {
        encoder_id: encoder.id.clone(),
        snapshot_id: encoder.snapshot_id.clone(),
        extends: None,
        spec,
    };
    (job(store, task, spec, id.as_str()).await, id)
}

/// A finished score run with these scores.
pub(crate) async fn run(store: &Store, task: &Task, encoder: &Encoder, scores: &[EpisodeScores]) -> ScoreRun {
    run_of(store, task, encoder, ScoreSpec::default(), scores).await
}

/// A finished score run of a job with this spec.
pub(crate) async fn run_of(
    store: &Store,
    task: &Task,
    encoder: &Encoder,
    spec: ScoreSpec,
    scores: &[EpisodeScores],
) -> ScoreRun {
    let (job_id, id) = scoring_with(store, task, encoder, spec.clone()).await;
    let (_, members) = store.snapshot(&encoder.snapshot_id).await.unwrap();
    let experts = members.into_iter().filter(|member| member.role == Role::Expert);
    let run = ScoreRun {
        id,
        task_id: task.id.clone(),
        origin: Origin::Job { job_id, encoder_id: encoder.id.clone(), spec },
        snapshot_id: encoder.snapshot_id.clone(),
        lo: -2.0,
        hi: -0.25,
        quantiles: vec![-2.0, -0.25],
        extends: None,
        expert_ids: experts.map(|member| member.episode_id).collect(),
        created_at: Millis::now(),
    };
    let mut tx = store.write().await.unwrap();
    score::insert_run(&mut tx, &run, None, scores).await.unwrap();
    store.commit(tx).await.unwrap();
    run
}

/// A finished export of a dataset.
pub(crate) async fn export(store: &Store, task: &Task, dataset: &DatasetId, files: &[ExportFile]) -> ExportId {
    let id = ExportId::new();
    let spec = JobSpec::Export { dataset_id: dataset.clone(), spec: Default::default() };
    let job = job(store, task, spec, id.as_str()).await;
    let mut tx = store.write().await.unwrap();
    exports::insert(&mut tx, &id, dataset, &job, files).await.unwrap();
    store.commit(tx).await.unwrap();
    set_state(store, &job, JobState::Succeeded, "").await;
    id
}

/// A run of the encoder's snapshot that was imported without scores, with an encoder or without one.
pub(crate) async fn import(store: &Store, task: &Task, of: &Encoder, encoder_id: Option<EncoderId>) -> ScoreRun {
    let id = ScoreRunId::new();
    let run = ScoreRun {
        task_id: task.id.clone(),
        origin: Origin::Import { encoder_id, source: "an oracle".into() },
        snapshot_id: of.snapshot_id.clone(),
        lo: 0.0,
        hi: 1.0,
        quantiles: Vec::new(),
        extends: None,
        expert_ids: Vec::new(),
        created_at: Millis::now(),
        id: id.clone(),
    };
    store.insert_import(&run, id.as_str(), &[]).await.unwrap()
}

/// Scores with these q; every step matches the first expert at the same step.
pub(crate) fn scores(episode: &EpisodeId, role: Role, q: &[f32]) -> EpisodeScores {
    EpisodeScores {
        episode_id: episode.clone(),
        role,
        w: q.iter().map(|&q| f64::from(q) - 1.0).collect(),
        q: q.to_vec(),
        match_episode: vec![0; q.len()],
        match_step: (0..).take(q.len()).collect(),
        distances: q.iter().map(|&q| [1.0 - q, 0.0, 0.5]).collect(),
    }
}

/// A training that begins with an encoder.
pub(crate) fn finetune() -> TrainSpec {
    let policy = Chosen::new(Family::Policy, "finetune").unwrap();
    TrainSpec { policy, ..TrainSpec::default() }
}

/// A finished policy, trained on experts alone, with this checkpoint.
pub(crate) async fn policy(store: &Store, task: &Task, encoder: &Encoder, checkpoint: BlobId) -> Policy {
    policy_of(store, task, encoder, finetune(), checkpoint).await
}

/// A finished policy of a training with this spec.
pub(crate) async fn policy_of(
    store: &Store,
    task: &Task,
    encoder: &Encoder,
    spec: TrainSpec,
    checkpoint: BlobId,
) -> Policy {
    let (id, kind) = (PolicyId::new(), spec.policy.name.clone());
    let spec = JobSpec::Train {
        encoder_id: Some(encoder.id.clone()),
        snapshot_id: encoder.snapshot_id.clone(),
        dataset_id: None,
        spec,
    };
    let training = Training {
        job_id: job(store, task, spec, id.as_str()).await,
        encoder_id: Some(encoder.id.clone()),
        dataset_id: None,
        checkpoint,
    };
    let policy = Policy {
        id,
        task_id: task.id.clone(),
        kind,
        origin: PolicyOrigin::Trained(training),
        created_at: Millis::now(),
    };
    let mut tx = store.write().await.unwrap();
    policies::insert(&mut tx, &policy).await.unwrap();
    store.commit(tx).await.unwrap();
    policy
}

/// Adds metrics of a job's first step.
pub(crate) async fn metrics(store: &Store, job: &JobId, metrics: &[(&str, f64)]) {
    let mut tx = store.write().await.unwrap();
    for (name, value) in metrics {
        let insert = sql::query("insert into job_metrics (job_id, step, name, value) values ($1, 1, $2, $3)");
        insert.bind(job.param()).bind(*name).bind(value).execute(&mut tx).await.unwrap();
    }
    store.commit(tx).await.unwrap();
}
