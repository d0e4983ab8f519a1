//! A server with a deployed policy, created through the public API: a task, recordings, a pretraining, a training.

use std::fs::File;
use std::path::Path;

use gleaner_client::{Client, PushItem, UploadLabel};
use gleaner_core::{Preset, Words as _};
use gleaner_learn::CheckpointKind;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{CreateTaskRequest, DeployRequest, Job, Outcome, TrainSpec};
use gleaner_recording::{EpisodeWriter, StepRef, TaskSpec};
use tokio::process::Command;

use crate::cli::{Kind, Options};
use crate::connection::Address;
use crate::process::Program;
use crate::scene::{self, Step};
use crate::train::{self, settings, submit};
use crate::{Result, report};

const DEPLOYMENT: &str = "serving@bench";
/// Recordings of each outcome.
const EPISODES: u64 = 2;
const STEPS: usize = 30;
/// The weights differ from the initial ones; the cost of an inference does not depend on them.
const OPTIMISER_STEPS: u32 = 4;
/// The longest that a server allows. Sessions are idle while others are measured, and while peers start.
const SESSION_IDLE_SECONDS: &str = "86400";
/// The stamp of the first step.
const BEGIN_NS: i64 = 1_700_000_000_000_000_000;

/// The objects of the measurements.
pub struct Prepared {
    pub spec: TaskSpec,
    /// The steps that are sent, in a cycle.
    pub steps: Vec<Step>,
    pub client: Client,
    /// The address of the policy's sessions.
    pub address: Address,
    pub preset: Preset,
    /// The checkpoint of the policy.
    pub checkpoint: Vec<u8>,
}

/// Starts a server on a data folder with these flags.
pub async fn serve(options: &Options, folder: &Path, flags: &[&str]) -> Result<Program> {
    let mut command = Command::new(&options.server_bin);
    command
        .args(["serve", "--listen", "127.0.0.1:0", "--worker-threads", &options.worker_threads.to_string()])
        .args(flags)
        .arg("--data-dir")
        .arg(folder.join("data"))
        .env("GLEANER_LOG", "warn");
    Program::start(command, &folder.join("server.log")).await
}

/// The address of sessions with the deployed policy.
pub fn address(url: &str) -> Address {
    Address::Session { url: url.to_owned(), deployment: DEPLOYMENT.to_owned() }
}

/// A server with a policy deployed.
pub async fn prepare(options: &Options, folder: &Path) -> Result<(Program, Prepared)> {
    let server = serve(options, folder, &["--session-idle-seconds", SESSION_IDLE_SECONDS]).await?;
    let prepared = set_up(&server, options.preset.into(), options.policy, folder).await?;
    Ok((server, prepared))
}

/// Trains and deploys a policy on an empty server, whose data are in `folder`.
pub async fn set_up(server: &Program, preset: Preset, policy: Kind, folder: &Path) -> Result<Prepared> {
    let client = Client::connect(server.url(), None).await?;
    let spec = scene::task();
    client
        .tasks()
        .create_task(CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(spec.clone())) })
        .await?;
    push(&client, &spec, folder).await?;
    let encoder = succeed(&client, &spec, train::pretraining(preset, OPTIMISER_STEPS)).await?;
    let policy_id = succeed(&client, &spec, training(encoder, preset, policy)).await?;
    client.policies().deploy(DeployRequest { name: DEPLOYMENT.to_owned(), policy_id, ..Default::default() }).await?;
    let checkpoint = checkpoint(&folder.join("data/blobs"))?;
    let steps = scene::steps(99, 16);
    Ok(Prepared { spec, steps, client, address: address(server.url()), preset, checkpoint })
}

async fn push(client: &Client, spec: &TaskSpec, folder: &Path) -> Result<()> {
    let mut items = Vec::new();
    for (seed, outcome) in (0..2 * EPISODES).zip([Outcome::Success, Outcome::Failure].into_iter().cycle()) {
        let path = folder.join(format!("{seed}.mcap"));
        record(spec, &scene::steps(seed, STEPS), &path)?;
        let label = UploadLabel { outcome, cohort: String::new(), author: "bench".to_owned() };
        items.push(PushItem { path, parts: Vec::new(), task: spec.name.clone(), label });
    }
    let pushed = client.push(items, 1, |_| ()).await;
    match pushed.failures().next() {
        Some((item, error)) => Err(format!("{}: {error}", item.path.display()).into()),
        None => Ok(()),
    }
}

/// Writes steps as a recording.
pub fn record(spec: &TaskSpec, steps: &[Step], path: &Path) -> Result<()> {
    let mut writer = EpisodeWriter::create(File::create(path)?, spec)?;
    for (stamp, step) in (BEGIN_NS..).step_by(50_000_000).zip(steps) {
        let Step { frames, proprioception, action } = step;
        writer.step(stamp, StepRef { frames, proprioception, action })?;
    }
    writer.finish()?;
    Ok(())
}

fn training(encoder: String, preset: Preset, policy: Kind) -> Spec {
    let mut given = vec![("policy", policy.name().into()), ("steps", OPTIMISER_STEPS.into()), ("batch", 8.into())];
    // A finetuned policy has the size of its encoder.
    if policy != Kind::Finetune {
        given.push(("preset", preset.as_str().into()));
    }
    Spec::Train(TrainSpec { data: Some(Data::ExpertsOf(encoder)), settings: settings(&given) })
}

/// Runs a job; returns the id of its result.
async fn succeed(client: &Client, task: &TaskSpec, spec: Spec) -> Result<String> {
    let Job { id, kind, .. } = submit(client, task, spec).await?;
    report::progress(&format!("running job {id} of kind {kind} ..."));
    Ok(client.wait(&id, |_| ()).await?.result_id)
}

/// The only policy among the blobs.
fn checkpoint(blobs: &Path) -> Result<Vec<u8>> {
    for folder in blobs.read_dir()? {
        let folder = folder?.path();
        // The stamp is beside the folders.
        if !folder.is_dir() {
            continue;
        }
        for blob in folder.read_dir()? {
            let bytes = std::fs::read(blob?.path())?;
            if gleaner_learn::inspect(&bytes).is_ok_and(|info| info.kind == CheckpointKind::Policy && info.finished) {
                return Ok(bytes);
            }
        }
    }
    Err("the server has no policy".into())
}
