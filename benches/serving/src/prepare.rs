//! A server with a deployed policy, made as anybody would: a task, recordings, a pretraining, a training.

use std::fs::File;
use std::path::Path;

use gleaner_client::{Client, PushItem, UploadLabel};
use gleaner_core::Preset;
use gleaner_learn::CheckpointKind;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{CreateTaskRequest, DeployRequest, Job, Outcome, TrainSpec};
use gleaner_recording::{EpisodeWriter, StepRef, TaskSpec};
use tokio::process::Command;

use crate::cli::Options;
use crate::door::Address;
use crate::process::Program;
use crate::scene::{self, Step};
use crate::train::{self, settings, submit};
use crate::{Result, report};

const DEPLOYMENT: &str = "serving@bench";
/// Of each outcome.
const EPISODES: u64 = 2;
const STEPS: usize = 30;
/// Enough for weights that are not those of the beginning; what an inference costs does not depend on them.
const OPTIMISER_STEPS: u32 = 4;
/// The first recorded stamp: some time after 1970.
const BEGIN_NS: i64 = 1_700_000_000_000_000_000;

/// What there is to measure.
pub struct Prepared {
    pub spec: TaskSpec,
    /// Steps as they are sent, over and over.
    pub steps: Vec<Step>,
    pub client: Client,
    /// Where sessions of the policy are opened.
    pub address: Address,
    pub preset: Preset,
    /// The policy's checkpoint.
    pub checkpoint: Vec<u8>,
}

/// Starts a server on a data folder, with further flags.
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

/// Where a server has sessions of the policy that was deployed.
pub fn address(url: &str) -> Address {
    Address::Session { url: url.to_owned(), deployment: DEPLOYMENT.to_owned() }
}

/// A server with a policy deployed.
pub async fn prepare(options: &Options, folder: &Path) -> Result<(Program, Prepared)> {
    let server = serve(options, folder, &[]).await?;
    let prepared = furnish(&server, options.preset.into(), folder).await?;
    Ok((server, prepared))
}

/// Has a server that has nothing yet train a policy and deploy it; its data are in `folder`.
pub async fn furnish(server: &Program, preset: Preset, folder: &Path) -> Result<Prepared> {
    let client = Client::connect(server.url(), None).await?;
    let spec = scene::task();
    client
        .tasks()
        .create_task(CreateTaskRequest { spec: Some(gleaner_core::proto::task::spec_to_proto(spec.clone())) })
        .await?;
    push(&client, &spec, folder).await?;
    let encoder = succeed(&client, &spec, train::pretraining(preset, OPTIMISER_STEPS)).await?;
    let policy_id = succeed(&client, &spec, finetuning(encoder)).await?;
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
        items.push(PushItem { path, task: spec.name.clone(), label });
    }
    let pushed = client.push(items, 1, |_| ()).await;
    match pushed.failures().next() {
        Some((item, error)) => Err(format!("{}: {error}", item.path.display()).into()),
        None => Ok(()),
    }
}

/// Writes a recording of steps.
pub fn record(spec: &TaskSpec, steps: &[Step], path: &Path) -> Result<()> {
    let mut writer = EpisodeWriter::create(File::create(path)?, spec)?;
    for (stamp, step) in (BEGIN_NS..).step_by(50_000_000).zip(steps) {
        let Step { frames, proprioception, action } = step;
        writer.step(stamp, StepRef { frames, proprioception, action })?;
    }
    writer.finish()?;
    Ok(())
}

fn finetuning(encoder: String) -> Spec {
    Spec::Train(TrainSpec {
        data: Some(Data::ExpertsOf(encoder)),
        settings: settings(&[("steps", OPTIMISER_STEPS.into()), ("batch", 8.into())]),
    })
}

/// Runs a job and gives what it made.
async fn succeed(client: &Client, task: &TaskSpec, spec: Spec) -> Result<String> {
    let Job { id, kind, .. } = submit(client, task, spec).await?;
    report::say(&format!("running job {id} of kind {kind} ..."));
    Ok(client.wait(&id, |_| ()).await?.result_id)
}

/// The one policy among the blobs.
fn checkpoint(blobs: &Path) -> Result<Vec<u8>> {
    for folder in blobs.read_dir()? {
        let folder = folder?.path();
        // Beside the folders lies the stamp.
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
    Err("the server keeps no policy".into())
}
