//! Watching a job: its present state, then each change and each new metric, until it has ended.

use std::sync::Arc;

use futures::stream::{self, Stream};
use tokio::sync::watch::Receiver;

use super::{Inner, Jobs};
use crate::{
    domain::{
        id::JobId,
        job::{Job, Metric},
    },
    error::{Error, Result},
};

/// Maximum number of metrics in one item.
const PAGE: u32 = 2000;

/// State of one watcher.
struct Watching {
    inner: Arc<Inner>,
    id: JobId,
    changed: Receiver<()>,
    sequence: i64,
    last: Option<Job>,
}

impl Jobs {
    /// A stream of a job's states from now on. The first item has every metric so far (or the first page of them).
    ///
    /// # Errors
    /// NotFound. Within the stream: Unavailable when the server stops before the job has ended.
    pub(crate) async fn watch(
        &self,
        id: &JobId,
    ) -> Result<impl Stream<Item = Result<(Job, Vec<Metric>)>> + Send + 'static + use<>> {
        self.0.store.job(id).await?;
        let watching = Watching {
            inner: Arc::clone(&self.0),
            id: id.clone(),
            changed: self.0.changed.subscribe(),
            sequence: 0,
            last: None,
        };
        Ok(stream::try_unfold(Some(watching), |watching| async move {
            match watching {
                Some(watching) => watching.next().await.map(Some),
                None => Ok(None),
            }
        }))
    }
}

impl Watching {
    /// The next item, and the watcher for the items after it.
    async fn next(mut self) -> Result<((Job, Vec<Metric>), Option<Self>)> {
        loop {
            // Marked as seen before reading, so that a change during the read is not missed.
            self.changed.mark_unchanged();
            let job = self.inner.store.job(&self.id).await?;
            let metrics = self.inner.store.metrics(&self.id, self.sequence, PAGE).await?;
            // The job was read first: once it has ended, no metric can follow those read after it.
            let whole = u32::try_from(metrics.len()).is_ok_and(|count| count < PAGE);
            if let Some(newest) = metrics.last() {
                self.sequence = newest.sequence;
            }
            if !metrics.is_empty() || self.last.as_ref() != Some(&job) {
                let ended = job.state.ended() && whole;
                self.last = Some(job.clone());
                return Ok(((job, metrics), (!ended).then_some(self)));
            }
            if job.state.ended() {
                return Ok(((job, metrics), None));
            }
            tokio::select! {
                // The sender is in the state that this watcher holds, so it is not closed.
                _ = self.changed.changed() => {}
                () = self.inner.stopping.cancelled() => {
                    return Err(Error::unavailable(format!("the server is stopping; {} resumes after its next start", self.id)));
                }
            }
        }
    }
}
