//! Fixtures for the tests of this module: a queue without workers over a fresh database.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::Path,
    pin::pin,
    sync::{Arc, atomic::AtomicU64},
};

use clap::Parser as _;
use futures::TryStreamExt as _;
use gleaner_core::PretrainSpec;
use tempfile::TempDir;

use super::{Jobs, engine::Engine};
use crate::{
    blobs::Blobs,
    config::{Cli, Command, ServeConfig},
    domain::{
        attempt::Attempt, episode::Outcome, job::Job, schedule::PipelineSpec, selection::SelectionShape,
        snapshot::RoleRule, task::Task, work::Inputs,
    },
    error::Result,
    store::{Store, testing},
};

/// A pipeline up to a finetuned policy.
pub(super) fn pipeline() -> PipelineSpec {
    PipelineSpec {
        snapshot_id: None,
        rule: RoleRule::default(),
        pretrain: PretrainSpec::default(),
        score: true,
        scoring: None,
        beta: Some(0.5),
        top_fraction: None,
        shape: SelectionShape::default(),
        train: Some(testing::results::finetune()),
        evaluate: None,
    }
}

/// The address of a server, which no worker calls.
const SERVER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 1);

/// A queue that claims no job on its own, a task, and their folder.
pub(super) struct Bench {
    pub(super) dir: TempDir,
    pub(super) store: Store,
    pub(super) jobs: Jobs,
    pub(super) task: Task,
}

impl Bench {
    /// A task with an expert and an imperfect episode.
    pub(super) async fn new() -> Self {
        let bench = Self::empty().await;
        testing::episode(&bench.store, &bench.task, Outcome::Success, "").await;
        testing::episode(&bench.store, &bench.task, Outcome::Failure, "").await;
        bench
    }

    /// A task without episodes.
    pub(super) async fn empty() -> Self {
        let (dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let jobs = start(&dir, &store).await;
        Self { dir, store, jobs, task }
    }

    /// A task with both episodes, on a disk with `free` bytes of free space, of which 100 are reserved.
    pub(super) async fn on_a_small_disk(free: &Arc<AtomicU64>) -> Self {
        let bench = Self::new().await;
        bench.jobs.stop().await;
        let blobs = bench.blobs().sparing(100).playing(free);
        let jobs = start_with(&bench.dir, &bench.store, blobs, &[]).await;
        Self { jobs, ..bench }
    }

    /// A task with both episodes, on a server with this folder of image weights.
    pub(super) async fn with_image_weights(folder: &Path) -> Self {
        let bench = Self::new().await;
        bench.jobs.stop().await;
        let folder = ["--image-weights-dir", folder.to_str().unwrap()];
        let jobs = start_with(&bench.dir, &bench.store, bench.blobs(), &folder).await;
        Self { jobs, ..bench }
    }

    /// Claims the next job; returns it with the attempt that a worker would prove.
    pub(super) async fn claim(&self) -> (Attempt, Job) {
        let issuer = super::token::Issuer::new();
        let job = self.store.claim_job(&issuer.hash, "local").await.unwrap().expect("a job is ready");
        (issuer.attempt(&job.id), job)
    }

    /// A queue of this folder on another engine, which claims no job and has no scheduler.
    pub(super) fn with_engine(&self, engine: Box<dyn Engine>) -> Jobs {
        let mut jobs = Jobs::new(&config(&self.dir, &[]), self.store.clone(), self.blobs(), SERVER).unwrap();
        Arc::get_mut(&mut jobs.0).unwrap().engine = engine;
        jobs
    }

    /// The whole input of a job, as its worker collects it.
    pub(super) async fn inputs(&self, job: &Job) -> Result<Inputs> {
        let mut inputs = self.jobs.inputs(job).await?;
        let mut parts = pin!(self.jobs.input_parts(job).await?);
        while let Some(part) = parts.try_next().await? {
            inputs.add(part);
        }
        Ok(inputs)
    }

    /// The blobs of the same folder.
    pub(super) fn blobs(&self) -> Blobs {
        Blobs::open(self.dir.path()).unwrap()
    }
}

/// A queue over this folder and database.
pub(super) async fn start(dir: &TempDir, store: &Store) -> Jobs {
    start_with(dir, store, Blobs::open(dir.path()).unwrap(), &[]).await
}

async fn start_with(dir: &TempDir, store: &Store, blobs: Blobs, flags: &[&str]) -> Jobs {
    Jobs::start(&config(dir, flags), store.clone(), blobs, SERVER).await.unwrap()
}

fn config(dir: &TempDir, flags: &[&str]) -> Arc<ServeConfig> {
    let data = dir.path().to_str().unwrap();
    let serve = ["gleaner-server", "serve", "--workers", "0", "--data-dir", data];
    let cli = Cli::try_parse_from(serve.iter().chain(flags)).unwrap();
    let Command::Serve(config) = cli.command else { panic!("not serve") };
    Arc::new(*config)
}
