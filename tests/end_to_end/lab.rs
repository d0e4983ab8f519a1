//! A small lab: a task of the embedded simulator at 16 × 16 pixels, recordings of it, and how they are uploaded.

use std::sync::LazyLock;

use bytes::Bytes;
use gleaner_proto::v1::*;
use gleaner_sim::{AgentSpec, SimConfig, Task as SimTask, demonstrate, task_spec};
use serde_json::json;
use tonic::Status;

use crate::api::Api;

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

/// The simulator as these tests use it.
pub fn sim_config() -> SimConfig {
    SimConfig { image: 16, ..SimConfig::default() }
}

/// Six experts and six failures, made once.
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

/// Creates the task and pushes every recording; gives back the episodes in order.
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
    let spec = gleaner_core::proto::task::spec_to_proto(task_spec(SimTask::PickCube, &sim_config()));
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap().into_inner().task.unwrap()
}

/// Uploads a recording; an episode that is there already is given back as it is.
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

/// What begins an upload.
pub fn upload(task: &str, recording: &Recording) -> StartUploadRequest {
    StartUploadRequest {
        task: task.to_owned(),
        file_name: recording.name.clone(),
        size_bytes: recording.bytes.len().try_into().unwrap(),
        blake3: blake3::hash(&recording.bytes).to_hex().to_string(),
        outcome: recording.outcome.into(),
        cohort: recording.cohort.clone(),
        author: "tests".to_owned(),
    }
}

/// Writes bytes from an offset on; gives back the committed size.
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

/// Settings of a job; what is left out takes its default.
pub fn settings(given: serde_json::Value) -> Option<prost_types::Struct> {
    given.as_object().map(gleaner_core::proto::to_struct)
}

/// The settings of a message as JSON.
pub fn given(settings: &Option<prost_types::Struct>) -> serde_json::Value {
    serde_json::Value::Object(gleaner_core::proto::from_struct(settings.clone()))
}

/// A job with settings changed.
pub fn with(spec: job_spec::Spec, changed: serde_json::Value) -> job_spec::Spec {
    let more = |settings: Option<prost_types::Struct>| {
        let mut all = gleaner_core::proto::from_struct(settings);
        all.extend(changed.as_object().unwrap().clone());
        Some(gleaner_core::proto::to_struct(&all))
    };
    match spec {
        job_spec::Spec::Pretrain(spec) => {
            job_spec::Spec::Pretrain(PretrainSpec { settings: more(spec.settings.clone()), ..spec })
        }
        job_spec::Spec::Score(spec) => {
            job_spec::Spec::Score(ScoreSpec { settings: more(spec.settings.clone()), ..spec })
        }
        job_spec::Spec::Train(spec) => {
            job_spec::Spec::Train(TrainSpec { settings: more(spec.settings.clone()), ..spec })
        }
        job_spec::Spec::Evaluate(spec) => {
            job_spec::Spec::Evaluate(EvaluateSpec { settings: more(spec.settings.clone()), ..spec })
        }
        job_spec::Spec::Export(spec) => job_spec::Spec::Export(spec),
    }
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

pub fn train(data: train_spec::Data, steps: u32) -> job_spec::Spec {
    let settings = settings(json!({"steps": steps, "batch": 8, "warmup_steps": 2, "seed": 7, "checkpoint_every": 5}));
    job_spec::Spec::Train(TrainSpec { data: Some(data), settings })
}

/// q above β.
pub fn above(beta: f64) -> Selection {
    Selection { rule: Some(selection::Rule::Beta(beta)) }
}

/// The best part by w.
pub fn top(fraction: f64) -> Selection {
    Selection { rule: Some(selection::Rule::TopFraction(fraction)) }
}
