//! Metrics sampled on request: jobs, the disk, memory.

use gleaner_web::Disk;
use metrics::gauge;

use crate::{
    domain::{job::JobState, time::Millis},
    error::{Error, Result},
    service::Services,
    telemetry::memory,
};

/// Samples them.
#[expect(clippy::cast_precision_loss, reason = "far below 2^52 of anything")]
pub(super) async fn sample(services: &Services) -> Result<()> {
    let backlog = services.store.backlog().await?;
    for state in JobState::ALL {
        let count = backlog.jobs.iter().find(|(of, _)| *of == state).map_or(0, |(_, count)| *count);
        gauge!("gleaner_jobs", "state" => state.as_str()).set(count as f64);
    }
    let waited = backlog.oldest_queued.map_or(0, |since| (Millis::now().0 - since.0).max(0));
    gauge!("gleaner_queue_age_seconds").set(waited as f64 / 1000.0);
    let disk = disk(services).await?;
    gauge!("gleaner_disk_free_bytes").set(disk.free as f64);
    gauge!("gleaner_disk_size_bytes").set(disk.size as f64);
    gauge!("gleaner_memory_bytes").set(memory::resident(std::process::id()).unwrap_or(0) as f64);
    Ok(())
}

/// The disk of the data folder.
///
/// # Errors
/// Internal.
pub(super) async fn disk(services: &Services) -> Result<Disk> {
    let folder = services.config.data_dir.clone();
    let disk = tokio::task::spawn_blocking(move || rustix::fs::statvfs(&folder))
        .await
        .map_err(|error| Error::internal("reading the disk's free space", error))?
        .map_err(|error| Error::internal("reading the disk's free space", error))?;
    Ok(Disk { free: disk.f_bavail * disk.f_frsize, size: disk.f_blocks * disk.f_frsize })
}
