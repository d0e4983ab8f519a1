//! The supervisor: as many worker processes at once as the configuration says, each for the best job that is
//! ready when it starts.

use std::{sync::Arc, time::Duration};

use tokio::sync::Semaphore;

use super::{Room, attempt, token::Mint};
use crate::domain::job::Job;

/// How long a wake-up may stay away before the queue is looked at all the same.
const FALLBACK: Duration = Duration::from_secs(30);

/// Runs attempts until the server stops.
pub(super) async fn supervise(room: Arc<Room>) {
    let slots = Arc::new(Semaphore::new(room.config.jobs.workers));
    let running = async {
        // The semaphore is never closed, so this ends only with the server.
        while let Ok(slot) = Arc::clone(&slots).acquire_owned().await {
            let (job, mint) = next_job(&room).await;
            let task = Arc::clone(&room);
            room.tasks.spawn(async move {
                attempt::run(&task, job, mint).await;
                drop(slot);
            });
        }
    };
    // Dropping `running` amid a claim is safe: a claim that was committed unseen is requeued at the next start.
    let _ = room.stopping.run_until_cancelled(running).await;
}

/// Waits for a job that may run, and claims it.
async fn next_job(room: &Room) -> (Job, Mint) {
    loop {
        // A permit is kept for us when something becomes ready between the look and the wait.
        let mint = Mint::new();
        // A job writes: it begins when there is room for what it makes.
        let claimed = if room.blobs.is_full() { Ok(None) } else { room.store.claim_job(&mint.hash).await };
        match claimed {
            Ok(Some(job)) => {
                room.changed.send_replace(());
                return (job, mint);
            }
            Ok(None) => {}
            Err(error) => tracing::error!(%error, "the queue cannot be read; trying again"),
        }
        // Which of the two ends the wait does not matter.
        let _ = tokio::time::timeout(FALLBACK, room.ready.notified()).await;
    }
}
