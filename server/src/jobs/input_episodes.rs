//! The episodes that a worker receives: those of a snapshot by role, and those of which a dataset keeps segments. They are
//! read from the database as the worker takes them, so that no job is too large for a message or for memory.

use futures::Stream;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tracing::Instrument as _;

use super::Jobs;
use crate::{
    domain::{
        id::{DatasetId, SnapshotId},
        snapshot::Role,
        work::{InputPart, KeptInput},
    },
    error::Result,
    store::{KeptDetail, Store},
};

/// The size of the parts in which episodes are sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct PartSize {
    /// The most episodes of a part without segments.
    pub(super) episodes: u32,
    /// The number of steps with which a part of kept segments is complete.
    pub(super) steps: usize,
}

/// A few MiB at most.
pub(super) const PART: PartSize = PartSize { episodes: 1000, steps: 100_000 };
/// Parts and kept episodes that wait for the worker.
const WAITING: usize = 2;

/// Where episodes of a job's input come from.
#[derive(Debug)]
pub(super) enum Source {
    /// The episodes of a role in a snapshot.
    Snapshot(SnapshotId, Role),
    /// The kept part of a dataset.
    Kept { dataset: DatasetId, detail: KeptDetail },
}

impl Source {
    /// Both roles of a snapshot, experts first.
    pub(super) fn all(snapshot: &SnapshotId) -> Vec<Self> {
        [Role::Expert, Role::Imperfect].map(|role| Self::Snapshot(snapshot.clone(), role)).into()
    }
}

impl Jobs {
    /// The episodes of these sources, in parts of this size.
    ///
    /// # Errors
    /// Precondition when a recording was permanently deleted; when the database cannot be read.
    pub(super) async fn parts(
        &self,
        sources: Vec<Source>,
        size: PartSize,
    ) -> Result<impl Stream<Item = Result<InputPart>> + Send + use<>> {
        for source in &sources {
            if let Source::Snapshot(snapshot, _) = source {
                self.0.store.expect_recordings(snapshot).await?;
            }
        }
        let (out, parts) = mpsc::channel(WAITING);
        let store = self.0.store.clone();
        let sending = async move {
            for source in sources {
                let sent = match source {
                    Source::Snapshot(snapshot, role) => {
                        send_episodes(&store, (&snapshot, role), size.episodes, &out).await
                    }
                    Source::Kept { dataset, detail } => send_kept(&store, (&dataset, detail), size.steps, &out).await,
                };
                if let Err(error) = sent {
                    // Without a receiver the worker has ended.
                    let _ = out.send(Err(error)).await;
                    break;
                }
            }
        };
        tokio::spawn(sending.in_current_span());
        Ok(ReceiverStream::new(parts))
    }
}

type Out = mpsc::Sender<Result<InputPart>>;

async fn send_episodes(store: &Store, (snapshot, role): (&SnapshotId, Role), most: u32, out: &Out) -> Result<()> {
    let mut behind = -1;
    loop {
        let page = store.input_episodes(snapshot, role, behind, most).await?;
        let Some(last) = page.last() else { return Ok(()) };
        behind = last.position;
        let episodes = page.into_iter().map(|placed| placed.episode).collect();
        let part = if role == Role::Expert { InputPart::Experts(episodes) } else { InputPart::Imperfect(episodes) };
        if out.send(Ok(part)).await.is_err() {
            return Ok(());
        }
    }
}

async fn send_kept(
    store: &Store,
    (dataset, detail): (&DatasetId, KeptDetail),
    most_steps: usize,
    out: &Out,
) -> Result<()> {
    let dataset = store.dataset(dataset).await?;
    let run = store.score_run(&dataset.score_run_id).await?;
    let (send, mut kept) = mpsc::channel(WAITING);
    let reading = async {
        let read = store.send_kept((&run, dataset.selection), detail, &send).await;
        drop(send);
        read
    };
    let sending = async {
        let mut part: Vec<KeptInput> = Vec::new();
        let mut steps = 0;
        while let Some(episode) = kept.recv().await {
            steps += episode.segments.len().max(episode.qualities.len()) + 1;
            part.push(episode);
            if steps >= most_steps && out.send(Ok(InputPart::Kept(std::mem::take(&mut part)))).await.is_err() {
                // Closes the channel, which ends the reading.
                return;
            }
            steps = if part.is_empty() { 0 } else { steps };
        }
        if !part.is_empty() {
            // Without a receiver the worker has ended.
            let _ = out.send(Ok(InputPart::Kept(part))).await;
        }
    };
    // Both in one task: the reading ends once its receiver is dropped with the sending.
    let (read, ()) = futures::future::join(reading, sending).await;
    read
}
