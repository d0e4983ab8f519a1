//! Loads a score run with the encoder, experts, settings and normaliser of its job.

use std::sync::{Arc, Weak};

use gleaner_core::{Device, ScoreSpec, kinds::Family};
use gleaner_learn::{LiveScorer, Normaliser, TaskShape, Trajectory};
use tokio::runtime::Handle;

use super::{Ready, engine::Engine, loaded_runs::LoadedRuns, source::Stored};
use crate::{
    blobs::Blobs,
    domain::{
        id::{JobId, ScoreRunId},
        job::JobSpec,
        score::ScoreRun,
        task::Task,
    },
    error::{Error, Kind as Fault, Result},
    ingest::Ingest,
    store::Store,
};

/// Loads a run.
///
/// # Errors
/// As [`super::Scorers::load`].
pub(super) async fn ready(
    store: &Store,
    blobs: &Blobs,
    ingest: &Ingest,
    id: &ScoreRunId,
    loaded: Weak<LoadedRuns<LiveScorer>>,
) -> Result<Ready> {
    let run = store.score_run(id).await?;
    let (job, encoder, _) = run.origin.job(id, "cannot score live")?;
    let spec = settings(store, &run, job).await?;
    let task = store.task_by_id(&run.task_id).await?;
    let experts = experts(store, ingest, &task, &run).await?;
    let checkpoint = store.encoder(encoder).await?.checkpoint;
    let (lo, hi) = (run.lo, run.hi);
    let normaliser = Normaliser { kind: spec.normaliser, lo, hi, quantiles: run.quantiles };
    let blobs = blobs.clone();
    let load = move || {
        let encoder = blobs.get(&checkpoint)?;
        LiveScorer::load(&encoder, &experts, &spec, normaliser).map_err(|error| error.during("loading a scorer"))
    };
    let engine = Engine::start(id, load).await.map_err(|error| {
        if error.kind() != Fault::Invalid {
            return error;
        }
        // The caller named a run, not the setting that is wrong in it.
        Error::precondition(format!("{id} cannot score live: {error}; submit a new score job"))
    })?;
    Ok(Ready { task, experts: run.expert_ids, engine, loaded })
}

/// The settings of a run that supports live scoring, changed to the CPU and one thread.
async fn settings(store: &Store, run: &ScoreRun, job: &JobId) -> Result<ScoreSpec> {
    let JobSpec::Score { spec, .. } = store.job(job).await?.spec else {
        return Err(Error::internal("reading a score run's settings", "its job is not a score job"));
    };
    if spec.needs_all_episodes() {
        let live = Family::Scorer.kinds().iter().filter(|kind| !kind.needs.all_episodes);
        let live: Vec<&str> = live.map(|kind| kind.name.as_str()).collect();
        return Err(Error::precondition(format!(
            "{} is a run of the {} scorer, which cannot score live; use a run of {}",
            run.id,
            spec.scorer.name,
            live.join(" or ")
        )));
    }
    Ok(ScoreSpec { device: Device::Cpu, threads: Some(1), ..spec })
}

/// The run's experts, in its order.
async fn experts(store: &Store, ingest: &Ingest, task: &Task, run: &ScoreRun) -> Result<Vec<Trajectory>> {
    store.expect_recordings(&run.snapshot_id).await?;
    let shape = TaskShape::from(&task.spec);
    let mut trajectories = Vec::with_capacity(run.expert_ids.len());
    for id in &run.expert_ids {
        let (_, recording) = store.recording_of(id).await?;
        let steps = ingest.frames(&task.spec, &recording).await?;
        let source = Stored { steps, widths: (&shape).into(), runtime: Handle::current() };
        let expert = Trajectory::read_from(&shape, id.as_str(), Arc::new(source));
        trajectories.push(expert.map_err(|error| Error::internal("loading a scorer", error))?);
    }
    Ok(trajectories)
}
