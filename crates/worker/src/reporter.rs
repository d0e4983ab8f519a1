//! The reporter: sends progress to the server at intervals, names checkpoints, and passes on a request to stop.

use std::time::Duration;

use tokio::{
    sync::mpsc::Receiver,
    time::{Instant, MissedTickBehavior, interval},
};
use tokio_util::sync::CancellationToken;

use super::{client::Client, monitor::Event, process};
use gleaner_core::{error::Result, work::Progress};

/// Shortest interval between reports.
const EVERY: Duration = Duration::from_millis(200);
/// Longest interval between reports, also without news.
const AT_LEAST: Duration = Duration::from_secs(5);

/// Progress and metrics that are not reported yet.
struct Pending {
    progress: Progress,
    news: bool,
    sent_at: Instant,
}

/// Reports until the work has ended.
///
/// # Errors
/// When the server cannot be reached or rejects a call.
pub(crate) async fn report(client: &mut Client, mut events: Receiver<Event>, stop: &CancellationToken) -> Result<()> {
    let mut pending = Pending { progress: Progress::default(), news: true, sent_at: Instant::now() };
    let mut ticks = interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            event = events.recv() => match event {
                Some(Event::Checkpoint { step, blob, saved }) => {
                    // Metrics up to this step come first: a resumed attempt does not report them again.
                    pending.send(client, stop).await?;
                    let there = client.save_checkpoint(step, blob).await?;
                    // The working thread waits for this value; sending fails only once that thread has ended.
                    let _ = saved.send(there);
                }
                Some(event) => pending.take(event),
                None => return pending.send(client, stop).await,
            },
            _ = ticks.tick() => {
                if pending.news || pending.sent_at.elapsed() >= AT_LEAST {
                    pending.send(client, stop).await?;
                }
            }
        }
    }
}

/// Takes the events of a rank that does not report, until its work has ended.
pub(crate) async fn discard(mut events: Receiver<Event>) {
    while events.recv().await.is_some() {}
}

impl Pending {
    fn take(&mut self, event: Event) {
        self.news = true;
        match event {
            Event::Phase(doing) => self.progress.message = doing,
            Event::Progress { done, total, metrics } => {
                (self.progress.done, self.progress.total) = (done, total);
                // A value that is not finite adds nothing to the job's own error.
                let finite = metrics.into_iter().filter(|(_, value)| value.is_finite());
                self.progress.metrics.extend(finite.map(|(name, value)| (done, name.to_owned(), value)));
            }
            Event::Checkpoint { .. } => {}
        }
    }

    async fn send(&mut self, client: &mut Client, stop: &CancellationToken) -> Result<()> {
        self.progress.peak_memory_bytes = process::peak_memory();
        let message = self.progress.message.clone();
        let (done, total) = (self.progress.done, self.progress.total);
        let next = Progress { done, total, message, ..Progress::default() };
        if client.report_progress(std::mem::replace(&mut self.progress, next)).await? {
            stop.cancel();
        }
        (self.news, self.sent_at) = (false, Instant::now());
        Ok(())
    }
}
