//! Rewriting the sidecars of changed rows, which database triggers queue.

use std::time::Duration;

use tokio::sync::Mutex;

use crate::{
    blobs::Blobs,
    domain::description::Description,
    error::{Error, Result},
    store::{Described, Store},
};

/// The interval of reading the queue.
const POLL_INTERVAL: Duration = Duration::from_secs(1);
/// Rows described in one transaction of the queue.
const AT_ONCE: u32 = 256;

/// Held while queued rows are described: of two at once, the slower one would replace a newer sidecar by an older one.
static DESCRIBING: Mutex<()> = Mutex::const_new(());

/// Describes queued rows until it is dropped. After an interruption it resumes at the next start.
pub(super) async fn keep_described(store: Store, blobs: Blobs) {
    if let Err(error) = queue_missing(&store, &blobs).await {
        tracing::error!(%error, "looking for missing sidecars failed");
    }
    let mut failing = false;
    loop {
        match describe_queued(&store, &blobs).await {
            Ok(_) => failing = false,
            Err(error) if failing => tracing::debug!(%error, "sidecars still cannot be written"),
            Err(error) => {
                tracing::error!(%error, "sidecars cannot be written; the server retries each second");
                failing = true;
            }
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}

/// Writes the sidecars of all queued rows and returns the number of rows. A row whose sidecar cannot be written stays
/// in the queue and does not block others.
///
/// # Errors
/// When the database fails; the last row's error, when one could not be described.
pub(super) async fn describe_queued(store: &Store, blobs: &Blobs) -> Result<usize> {
    let _alone = DESCRIBING.lock().await;
    let (mut all, mut failed, mut last) = (0, None, None);
    loop {
        let rows = store.undescribed(last.as_ref(), AT_ONCE).await?;
        let Some(newest) = rows.last() else { return failed.map_or(Ok(all), Err) };
        last = Some(newest.clone());
        let mut done = Vec::with_capacity(rows.len());
        for row in rows {
            match describe(store, blobs, &row.id).await {
                Ok(()) => done.push(row),
                Err(error) => failed = Some(error),
            }
        }
        store.note_described(&done).await?;
        all += done.len();
    }
}

async fn describe(store: &Store, blobs: &Blobs, id: &str) -> Result<()> {
    let described = store.description(id).await?;
    let (blobs, id) = (blobs.clone(), id.to_owned());
    let writing = tokio::task::spawn_blocking(move || write(&blobs, &id, &described));
    writing.await.map_err(|error| Error::internal("writing a sidecar", error))?
}

/// Queues the episodes whose sidecars are missing, and logs an error when recordings are.
///
/// # Errors
/// When the database or the disk fails.
pub(super) async fn queue_missing(store: &Store, blobs: &Blobs) -> Result<()> {
    let (all, blobs) = (store.kept_recordings().await?, blobs.clone());
    let looking = tokio::task::spawn_blocking(move || {
        let undescribed = all.iter().filter(|(id, blob)| !blobs.is_described(blob, id.as_str()));
        let missing: Vec<_> = undescribed.map(|(id, _)| id.clone()).collect();
        (missing, blobs.count_missing(all.iter().map(|(_, blob)| blob)))
    });
    let (missing, lost) = looking.await.map_err(|error| Error::internal("looking for sidecars", error))?;
    // The count is a warning only: a store that fails does not keep the server from starting.
    let lost = lost.unwrap_or_else(|error| {
        tracing::error!(%error, "recordings that are missing could not be counted");
        0
    });
    if lost > 0 {
        tracing::error!(
            recordings.missing = lost,
            "recordings named by the database are missing: `gleaner-server check` lists them. Put the blobs \
             back, or push the recordings again"
        );
    }
    if missing.is_empty() { Ok(()) } else { store.queue_sidecars(&missing).await }
}

fn write(blobs: &Blobs, id: &str, described: &Described) -> Result<()> {
    match described {
        Described::Task(description) => blobs.describe_task(id, &description.to_json()?),
        // A missing blob is reported by `check`.
        Described::Beside(blob, description) if blobs.size(blob)?.is_some() => {
            blobs.describe(blob, id, &description.to_json()?)?;
            forget_superseded(blobs, description)
        }
        Described::Beside(..) | Described::Gone => Ok(()),
    }
}

/// Removes descriptions of the same recording as another episode of the same task, left by finishes that a crash
/// interrupted before their row.
fn forget_superseded(blobs: &Blobs, description: &Description) -> Result<()> {
    let Description::Recording(row) = description else { return Ok(()) };
    let row = &row.episode;
    for json in blobs.descriptions(&row.recording)? {
        if let Some(Description::Recording(other)) = Description::read(&json)
            && other.episode.task_id == row.task_id
            && other.episode.id != row.id
        {
            blobs.forget_description(&row.recording, other.episode.id.as_str())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing;

    #[tokio::test]
    async fn queued_rows_are_described_by_one_at_a_time() {
        let (dir, store) = testing::store().await;
        let (blobs, task) = (Blobs::open(dir.path()).unwrap(), testing::task(&store).await);
        let other = DESCRIBING.lock().await;
        let describing = describe_queued(&store, &blobs);
        tokio::pin!(describing);
        assert!(futures::poll!(&mut describing).is_pending());
        assert!(store.undescribed(None, 9).await.unwrap().iter().any(|row| row.id == task.id.as_str()));
        drop(other);
        assert_eq!(describing.await.unwrap(), 1);
    }
}
