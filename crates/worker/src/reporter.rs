//! The reporter: tells the server now and then how far the work is, names checkpoints, and passes on a wish to stop.

use std::time::Duration;

use tokio::{
    sync::mpsc::Receiver,
    time::{Instant, MissedTickBehavior, interval},
};
use tokio_util::sync::CancellationToken;

use super::{client::Client, monitor::Event, process};
use gleaner_core::{error::Result, work::Progress};

/// How often the server hears of progress.
const EVERY: Duration = Duration::from_millis(200);
/// How often it hears of a worker that has nothing new to say.
const AT_LEAST: Duration = Duration::from_secs(5);

/// What is not reported yet.
struct Pending {
    progress: Progress,
    news: bool,
    told: Instant,
}

/// Reports until the work is over.
///
/// # Errors
/// When the server cannot be reached or refuses.
pub(crate) async fn report(client: &mut Client, mut events: Receiver<Event>, stop: &CancellationToken) -> Result<()> {
    let mut pending = Pending { progress: Progress::default(), news: true, told: Instant::now() };
    let mut ticks = interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            event = events.recv() => match event {
                Some(Event::Checkpoint { step, blob, saved }) => {
                    // First the metrics up to this step: a resumed attempt does not report them again.
                    pending.tell(client, stop).await?;
                    let there = client.save_checkpoint(step, blob).await?;
                    // The working thread waits for this; if it is gone there is nobody to tell.
                    let _ = saved.send(there);
                }
                Some(event) => pending.take(event),
                None => return pending.tell(client, stop).await,
            },
            _ = ticks.tick() => {
                if pending.news || pending.told.elapsed() >= AT_LEAST {
                    pending.tell(client, stop).await?;
                }
            }
        }
    }
}

impl Pending {
    fn take(&mut self, event: Event) {
        self.news = true;
        match event {
            Event::Phase(doing) => self.progress.message = doing,
            Event::Progress { done, total, metrics } => {
                (self.progress.done, self.progress.total) = (done, total);
                // A value that is no number says nothing that the job's own error does not say better.
                let finite = metrics.into_iter().filter(|(_, value)| value.is_finite());
                self.progress.metrics.extend(finite.map(|(name, value)| (done, name.to_owned(), value)));
            }
            Event::Checkpoint { .. } => {}
        }
    }

    async fn tell(&mut self, client: &mut Client, stop: &CancellationToken) -> Result<()> {
        self.progress.peak_memory_bytes = process::peak_memory();
        let message = self.progress.message.clone();
        let (done, total) = (self.progress.done, self.progress.total);
        let next = Progress { done, total, message, ..Progress::default() };
        if client.report_progress(std::mem::replace(&mut self.progress, next)).await? {
            stop.cancel();
        }
        (self.news, self.told) = (false, Instant::now());
        Ok(())
    }
}
