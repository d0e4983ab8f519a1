//! A small lab: a task of the embedded simulator at 16 × 16 pixels, recordings of it, their uploads, and jobs that take
//! seconds.

use std::{path::Path, sync::LazyLock};

use bytes::Bytes;
use gleaner_proto::v1::*;
use gleaner_sim::{AgentSpec, SimConfig, Task as SimTask, demonstrate};
use serde_json::json;
use tonic::Status;

use super::{api::Api, server::TestServer};

/// The task's name on the server.
pub const TASK: &str = "pick_cube";

/// A recording with its label.
#[derive(Clone)]
pub struct Recording {
    pub name: String,
    pub bytes: Bytes,
    pub outcome: Outcome,
    pub cohort: String,
}

/// The settings of the simulator.
pub fn sim_config() -> SimConfig {
    SimConfig { image: 16, ..SimConfig::default() }
}

/// The task's spec.
pub fn spec() -> gleaner_recording::TaskSpec {
    gleaner_sim::task_spec(SimTask::PickCube, &sim_config())
}

/// The task's spec as a message.
pub fn spec_message() -> TaskSpec {
    gleaner_core::proto::task::spec_to_proto(spec())
}

/// Six experts and six failures; the simulator runs once.
pub static RECORDINGS: LazyLock<Vec<Recording>> = LazyLock::new(|| {
    let agents =
        [("expert", Outcome::Success), ("wrong_goal:1.0", Outcome::Failure), ("early_release:1.0", Outcome::Failure)];
    let counts = [6, 3, 3];
    let mut seed = 0;
    let mut recordings = Vec::new();
    for ((agent, outcome), count) in agents.into_iter().zip(counts) {
        let agent: AgentSpec = agent.parse().unwrap();
        for _ in 0..count {
            seed += 1;
            recordings.push(record(agent, outcome, seed));
        }
    }
    recordings
});

/// One recording of the simulator.
pub fn record(agent: AgentSpec, outcome: Outcome, seed: u64) -> Recording {
    let demonstration = demonstrate(SimTask::PickCube, sim_config(), agent, seed);
    let bytes = demonstration.write_mcap(std::io::Cursor::new(Vec::new())).unwrap().into_inner();
    let cohort = if outcome == Outcome::Success { "expert" } else { "failed" };
    Recording { name: format!("{seed:04}.mcap"), bytes: bytes.into(), outcome, cohort: cohort.to_owned() }
}

/// A server with these flags that has the task.
pub async fn with_task(flags: &[&str]) -> (TestServer, Api) {
    let server = TestServer::start_with(flags).await;
    let mut api = Api::connect(&server).await;
    create_task(&mut api).await;
    (server, api)
}

/// A server with the task and no workers, so that jobs stay queued.
pub async fn idle() -> (TestServer, Api) {
    with_task(&["--workers", "0"]).await
}

/// A server with these flags that has the task and every recording; the episodes are in the order of [`RECORDINGS`].
pub async fn with_episodes(flags: &[&str]) -> (TestServer, Api, Vec<Episode>) {
    let server = TestServer::start_with(flags).await;
    let mut api = Api::connect(&server).await;
    let episodes = set_up(&mut api).await;
    (server, api, episodes)
}

/// As [`with_episodes`] without flags, over a data folder that outlives the server.
pub async fn over(data: &Path) -> (TestServer, Api, Vec<Episode>) {
    let server = TestServer::start_over(data, &[]).await;
    let mut api = Api::connect(&server).await;
    let episodes = set_up(&mut api).await;
    (server, api, episodes)
}

/// Creates the task and pushes every recording; returns the episodes in order.
pub async fn set_up(api: &mut Api) -> Vec<Episode> {
    create_task(api).await;
    let mut episodes = Vec::new();
    for recording in RECORDINGS.iter() {
        episodes.push(push(api, TASK, recording).await.unwrap());
    }
    episodes
}

/// Creates the simulator's task.
pub async fn create_task(api: &mut Api) -> Task {
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec_message()) }).await.unwrap().into_inner().task.unwrap()
}

/// Uploads a recording; returns the existing episode if the server has its content.
pub async fn push(api: &mut Api, task: &str, recording: &Recording) -> Result<Episode, Status> {
    let started = start(api, task, recording).await?;
    if let Some(episode) = started.existing {
        return Ok(episode);
    }
    write(api, &started.upload_id, 0, recording.bytes.clone()).await?;
    finish(api, &started.upload_id).await
}

pub async fn start(api: &mut Api, task: &str, recording: &Recording) -> Result<StartUploadResponse, Status> {
    Ok(api.episodes.start_upload(upload(task, recording)).await?.into_inner())
}

/// The request that starts an upload.
pub fn upload(task: &str, recording: &Recording) -> StartUploadRequest {
    StartUploadRequest {
        task: task.to_owned(),
        file_name: recording.name.clone(),
        size_bytes: recording.bytes.len().try_into().unwrap(),
        blake3: blake3::hash(&recording.bytes).to_hex().to_string(),
        outcome: recording.outcome.into(),
        cohort: recording.cohort.clone(),
        author: "tests".to_owned(),
        ..StartUploadRequest::default()
    }
}

/// Writes bytes from an offset on; returns the committed size.
pub async fn write(api: &mut Api, upload_id: &str, offset: u64, bytes: Bytes) -> Result<u64, Status> {
    let messages: Vec<WriteUploadRequest> = (0..bytes.len())
        .step_by(64 << 10)
        .map(|at| WriteUploadRequest {
            upload_id: upload_id.to_owned(),
            offset: offset + u64::try_from(at).unwrap(),
            data: bytes.slice(at..bytes.len().min(at + (64 << 10))),
        })
        .collect();
    Ok(api.episodes.write_upload(tokio_stream::iter(messages)).await?.into_inner().committed_size)
}

pub async fn finish(api: &mut Api, upload_id: &str) -> Result<Episode, Status> {
    let request = FinishUploadRequest { upload_id: upload_id.to_owned() };
    Ok(api.episodes.finish_upload(request).await?.into_inner().episode.unwrap())
}

/// Settings of a job; missing ones have their default.
pub fn settings(given: serde_json::Value) -> Option<prost_types::Struct> {
    given.as_object().map(gleaner_core::proto::to_struct)
}

/// The settings of a message as JSON.
pub fn given(settings: &Option<prost_types::Struct>) -> serde_json::Value {
    serde_json::Value::Object(gleaner_core::proto::from_struct(settings.clone()))
}

/// A job with some of its settings changed.
pub fn with(mut spec: job_spec::Spec, changed: serde_json::Value) -> job_spec::Spec {
    let settings = match &mut spec {
        job_spec::Spec::Pretrain(spec) => &mut spec.settings,
        job_spec::Spec::Score(spec) => &mut spec.settings,
        job_spec::Spec::Train(spec) => &mut spec.settings,
        job_spec::Spec::Evaluate(spec) => &mut spec.settings,
        job_spec::Spec::Export(_) => panic!("an export has no settings"),
    };
    let mut all = gleaner_core::proto::from_struct(settings.take());
    all.extend(changed.as_object().unwrap().clone());
    *settings = Some(gleaner_core::proto::to_struct(&all));
    spec
}

/// A pretraining job that takes a few seconds.
pub fn pretrain(steps: u32) -> job_spec::Spec {
    let settings = settings(json!({
        "segment_length": 3, "steps": steps, "batch": 8, "warmup_steps": 2, "seed": 7, "checkpoint_every": 5,
    }));
    job_spec::Spec::Pretrain(PretrainSpec { settings, ..PretrainSpec::default() })
}

pub fn score(encoder_id: &str) -> job_spec::Spec {
    job_spec::Spec::Score(ScoreSpec { encoder_id: encoder_id.to_owned(), ..ScoreSpec::default() })
}

/// An evaluation of a policy in the simulator.
pub fn evaluate(policy: &str, given: serde_json::Value) -> job_spec::Spec {
    let subject = Some(evaluate_spec::Subject::PolicyId(policy.to_owned()));
    job_spec::Spec::Evaluate(EvaluateSpec { subject, settings: settings(given) })
}

pub fn train(data: train_spec::Data, steps: u32) -> job_spec::Spec {
    let settings = settings(json!({
        "policy": "finetune", "steps": steps, "batch": 8, "warmup_steps": 2, "seed": 7, "checkpoint_every": 5,
    }));
    job_spec::Spec::Train(TrainSpec { data: Some(data), settings })
}

/// The messages that import a q of 0.5 for every step of a snapshot's imperfect episodes.
pub async fn import(api: &mut Api, snapshot: &str, source: &str) -> Vec<ImportScoresRequest> {
    let request = GetSnapshotRequest { snapshot_id: snapshot.to_owned(), omit_episodes: false };
    let members = api.snapshots.get_snapshot(request).await.unwrap().into_inner().episodes;
    let imperfect = members.into_iter().filter(|episode| episode.role() == Role::Imperfect);
    let episodes = imperfect.map(|episode| ImportedEpisode {
        q: vec![0.5; usize::try_from(episode.steps).unwrap()],
        episode_id: episode.episode_id,
    });
    let open = ImportScoresOpen { snapshot_id: snapshot.into(), source: source.into(), ..ImportScoresOpen::default() };
    let batch = ImportedEpisodes { episodes: episodes.collect() };
    let messages = [import_scores_request::Message::Open(open), import_scores_request::Message::Batch(batch)];
    messages.map(|message| ImportScoresRequest { message: Some(message) }).into()
}

/// Selects segments whose q is above β.
pub fn above(beta: f64) -> Selection {
    Selection { rule: Some(selection::Rule::Beta(beta)), shape: None }
}

/// Selects the best part by w.
pub fn top(fraction: f64) -> Selection {
    Selection { rule: Some(selection::Rule::TopFraction(fraction)), shape: None }
}
