//! The worker: a program that runs one job and ends. It is a client of the server that starts it, and reads and writes
//! that server's data folder. It has no credentials of a bucket: it reads objects at URLs that the server signs, and hands
//! its blobs over to the server.
//!
//! The work itself runs on a thread of its own; the runtime only calls the server. A call that fails ends the process,
//! and the server then starts another attempt. Must not depend on the database, on pages or on any other part of the
//! server.

mod client;
mod config;
mod episodes;
mod failure;
mod features;
mod kinds;
mod monitor;
mod process;
mod ranks;
mod reporter;

use std::sync::Arc;

pub use self::config::WorkerConfig;
use self::{
    client::{BlobCalls, Client},
    failure::Failure,
    kinds::{Base, Work},
    ranks::Ranks,
};
use gleaner_core::error::{Error, Result};
use gleaner_data_folder::{blobs::Blobs, file_limit};
use tokio::runtime::Handle;
use tokio_util::task::AbortOnDropHandle;

/// Runs one job to its end.
///
/// # Errors
/// When the server cannot be reached or rejects a call. A failed job is not an error: its reason was sent to the
/// server.
pub fn run(config: WorkerConfig) -> Result<()> {
    process::adopt_priority(&config)?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Error::internal("starting the worker", error))?;
    let result = runtime.block_on(serve(config));
    // The job's thread may be in the middle of a step; the process ends without waiting for it.
    runtime.shutdown_background();
    result
}

async fn serve(config: WorkerConfig) -> Result<()> {
    if let Err(error) = file_limit::survive_limit() {
        tracing::warn!(%error, "a write beyond the file size limit would end the worker");
    }
    let mut client = Client::new(&config)?;
    let calls = BlobCalls::new(client.clone(), Handle::current());
    let blobs = Blobs::open_by(&config.data_dir, Arc::new(calls))?;
    let blobs = match config.cache_dir.as_deref().map(|folder| blobs.caching_in(folder)) {
        Some(Ok(caching)) => caching,
        Some(Err(error)) => {
            tracing::warn!(%error, "the folder of --slurm-cache-dir cannot be used; the data folder is");
            blobs
        }
        None => blobs,
    };
    let blobs = blobs.sparing(config.min_free_bytes).limiting_caches(config.max_cache_bytes)?;
    let (job_id, order, inputs) = client.assignment().await?;
    tracing::info!(job.id = %job_id, "working");
    let (monitor, events) = monitor::channel(blobs.clone());
    let stop = monitor.stop();
    // A worker of the server's own machine is stopped by the server.
    let _stopping =
        config.parent.is_none().then(|| AbortOnDropHandle::new(tokio::spawn(process::stop_at_signal(stop.clone()))));
    let base = match &inputs.base {
        Some(frozen) => Some(Base { frozen: frozen.clone(), scores: client.base_scores().await? }),
        None => None,
    };
    let ranks = Ranks::meet(&config, &mut client, &job_id, &order).await?;
    let lead = ranks.lead();
    let work = Work { ranks, data_dir: config.data_dir, threads: config.threads, blobs, inputs, base, monitor };
    let working = tokio::task::spawn_blocking(move || {
        // This thread alone: the other one must keep reporting that the worker is alive.
        if config.idle {
            process::set_idle_priority();
        }
        work.perform(order)
    });
    if lead {
        reporter::report(&mut client, events, &stop).await?;
    } else {
        reporter::discard(events).await;
    }
    let made = match working.await {
        Ok(made) => made,
        Err(error) => Err(Failure::Retryable(format!("the job's code panicked: {error}"))),
    };
    match made {
        Err(Failure::Lost(error)) => Err(Error::unavailable(error)),
        // Rank 0 reports, and meets the same permanent failure.
        Ok(_) if !lead => Ok(()),
        Err(Failure::Permanent(error)) if !lead => {
            tracing::error!(%error, "the job cannot succeed");
            Ok(())
        }
        Err(Failure::Retryable(error)) if !lead => Err(Error::internal("working as a rank above 0", error)),
        Ok(None) => Err(Error::internal("completing a job", "rank 0 has no result")),
        Ok(Some(made)) => {
            tracing::info!("handing the result over");
            client.complete(made).await
        }
        Err(Failure::Cancelled) => {
            tracing::info!("stopped on request");
            Ok(())
        }
        Err(Failure::Permanent(error)) => {
            tracing::error!(%error, "the job cannot succeed");
            client.fail(error, false).await
        }
        Err(Failure::Retryable(error)) => {
            tracing::error!(%error, "the attempt failed");
            client.fail(error, true).await
        }
    }
}
