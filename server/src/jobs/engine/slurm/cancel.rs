//! The cancellation of an attempt's Slurm jobs: in the background and repeated until Slurm lists none, because the next
//! attempt does not wait for it. A worker that survives it is rejected by the server.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::{MISSED, SlurmJob};

/// Interval of attempts to cancel a Slurm job.
#[cfg(not(test))]
const AGAIN_AFTER: Duration = Duration::from_secs(5);
#[cfg(test)]
const AGAIN_AFTER: Duration = Duration::from_millis(5);

impl SlurmJob {
    /// Cancels every Slurm job of the attempt, in the background, until Slurm lists none that has not ended.
    pub(super) fn cancel(&self) {
        let (commands, mut view, name) = (self.commands.clone(), self.poller.view(&self.name), self.name.clone());
        let id = self.placement.borrow().engine_id.clone();
        let mut ids = if id.is_empty() { Vec::new() } else { vec![id] };
        tokio::spawn(async move {
            let mut clear = 0;
            loop {
                for id in &ids {
                    if let Err(problem) = commands.cancel(id).await {
                        tracing::warn!(slurm.id = id, %problem, "a Slurm job cannot be cancelled; retrying");
                    }
                }
                let (_, snapshot) = view.after(Instant::now(), |_| ()).await;
                ids = snapshot.alive(&name);
                // A submission may be under way.
                clear = if ids.is_empty() { clear + 1 } else { 0 };
                if clear >= MISSED {
                    return;
                }
                sleep(AGAIN_AFTER).await;
            }
        });
    }
}
