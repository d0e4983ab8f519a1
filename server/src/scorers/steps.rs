//! Streamed scoring of one running episode: every step is scored, in order, as soon as it arrives. A client that stops
//! reading blocks its own stream only.

use std::{sync::Arc, time::Duration};

use futures::{Stream, StreamExt as _};
use tokio::{sync::mpsc, time::Instant};
use tokio_util::sync::CancellationToken;

use super::{DecodedObservation, Ready, Watch, model::Scorer};
use crate::{
    domain::{score::SegmentScored, time::Millis},
    error::{Error, Result},
};

/// Outputs that may wait to be read.
const UNREAD: usize = 16;

/// Settings that hold for the whole stream.
#[derive(Debug, Clone)]
pub(crate) struct Terms {
    /// How long its client may send nothing, or read nothing.
    pub(crate) idle: Duration,
    /// How long the stream may continue once the server begins to stop.
    pub(crate) drain: Duration,
    /// Cancelled when the server begins to stop.
    pub(crate) stopping: CancellationToken,
}

/// An output of the stream.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Output {
    /// The score of a step's segment.
    Scored(SegmentScored),
    /// The server is stopping and will end the stream.
    Draining {
        /// When it ends the stream.
        close_at: Millis,
    },
}

/// Scores the steps of one episode until they end. `start` returns the run and the stream of observations and executed
/// actions; a silent client is `start`'s to time out. An error is the last output.
pub(crate) fn score_steps<S, F, I>(
    start: impl FnOnce() -> F + Send + 'static,
    terms: Terms,
) -> mpsc::Receiver<Result<Output>>
where
    S: Scorer,
    F: Future<Output = Result<(Arc<Ready<S>>, I)>> + Send,
    I: Stream<Item = Result<(DecodedObservation, Vec<f32>)>> + Send + Unpin,
{
    // One place is reserved for the error that ends the stream.
    let (outputs, answers) = mpsc::channel(UNREAD + 1);
    tokio::spawn(async move {
        let Ok(last) = outputs.clone().reserve_owned().await else { return };
        let ended = async {
            // A run may take long to load; that does not count as the client's silence.
            let (ready, steps) = tokio::select! {
                biased;
                started = start() => started?,
                () = outputs.closed() => return Err(gone()),
                () = terms.stopping.cancelled() => {
                    return Err(Error::unavailable("the server is stopping; open the stream again"));
                }
            };
            let watch = ready.watch();
            // From here on only the watch, and the steps, which end before it, hold the run.
            drop(ready);
            Scoring { watch, terms, outputs }.run(steps).await
        };
        if let Err(error) = ended.await {
            last.send(Err(error));
        }
    });
    answers
}

/// The state of one stream.
struct Scoring<S: Scorer> {
    watch: Watch<S>,
    terms: Terms,
    outputs: mpsc::Sender<Result<Output>>,
}

impl<S: Scorer> Scoring<S> {
    async fn run(
        mut self,
        mut steps: impl Stream<Item = Result<(DecodedObservation, Vec<f32>)>> + Unpin,
    ) -> Result<()> {
        let (mut close_at, mut stamp_ns) = (None, None);
        loop {
            let next = tokio::select! {
                biased;
                () = self.outputs.closed() => return Err(gone()),
                () = self.terms.stopping.cancelled(), if close_at.is_none() => {
                    close_at = Some(Instant::now() + self.terms.drain);
                    self.send(Output::Draining { close_at: Millis::now().after(self.terms.drain) }).await?;
                    continue;
                }
                () = passed(close_at) => return Err(Error::unavailable("the server is stopping; open the stream again")),
                next = tokio::time::timeout(self.terms.idle, steps.next()) => next.map_err(|_| self.terms.silent())?,
            };
            let Some(step) = next else {
                return match stamp_ns {
                    Some(_) => Ok(()),
                    None => {
                        Err(Error::invalid("step", "at least one is required; send the episode's steps after open"))
                    }
                };
            };
            let (seen, action) = step?;
            if let Some(before) = stamp_ns.replace(seen.stamp_ns)
                && seen.stamp_ns < before
            {
                let fix = format!("is {}, before the previous {before}; stamps must not decrease", seen.stamp_ns);
                return Err(Error::invalid("step.observation.stamp_ns", fix));
            }
            self.step(seen, &action).await?;
        }
    }

    async fn step(&mut self, seen: DecodedObservation, action: &[f32]) -> Result<()> {
        self.watch.saw(seen);
        self.watch.executed(action);
        self.watch.settle().await;
        if let Some(fault) = self.watch.take_fault() {
            return Err(fault);
        }
        let scored = self.watch.take_scored();
        if scored.is_empty() {
            return Err(Error::unavailable("the server is stopping; open the stream again"));
        }
        for segment in scored {
            self.send(Output::Scored(segment)).await?;
        }
        Ok(())
    }

    async fn send(&self, output: Output) -> Result<()> {
        match self.outputs.send_timeout(Ok(output), self.terms.idle).await {
            Ok(()) => Ok(()),
            Err(mpsc::error::SendTimeoutError::Closed(_)) => Err(gone()),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => Err(Error::late(format!(
                "{UNREAD} answers were not read for {} s; open the stream again and read them",
                self.terms.idle.as_secs()
            ))),
        }
    }
}

impl Terms {
    /// The error of a client that sends nothing.
    pub(crate) fn silent(&self) -> Error {
        Error::late(format!("no message was received for {} s; open the stream again", self.idle.as_secs()))
    }
}

fn gone() -> Error {
    Error::cancelled("the client closed the connection")
}

async fn passed(time: Option<Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}
