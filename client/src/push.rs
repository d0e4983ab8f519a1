//! Push: many recordings at once, each uploaded by itself; one that fails does not stop the others.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::upload::{UploadLabel, Uploaded};

/// One recording to push.
#[derive(Clone, Debug)]
pub struct PushItem {
    /// The recording.
    pub path: PathBuf,
    /// The task's name or id.
    pub task: String,
    /// Its label.
    pub label: UploadLabel,
}

/// How one item went.
#[derive(Debug)]
pub struct PushResult {
    /// The recording.
    pub path: PathBuf,
    /// What became of it.
    pub result: Result<Uploaded>,
}

/// How all items went.
#[derive(Debug)]
pub struct Pushed {
    /// One for each item, in the items' order.
    pub results: Vec<PushResult>,
    /// From the first to the last.
    pub wall: Duration,
}

impl Pushed {
    /// Bytes of the recordings that were sent, without those that were there already.
    #[must_use]
    pub fn sent_bytes(&self) -> u64 {
        self.uploaded().filter(|uploaded| !uploaded.existed).map(|uploaded| uploaded.episode.size_bytes).sum()
    }

    /// The recordings that the server now holds.
    pub fn uploaded(&self) -> impl Iterator<Item = &Uploaded> {
        self.results.iter().filter_map(|item| item.result.as_ref().ok())
    }

    /// The recordings that it does not, each with the reason.
    pub fn failures(&self) -> impl Iterator<Item = (&PushResult, &ClientError)> {
        self.results.iter().filter_map(|item| item.result.as_ref().err().map(|error| (item, error)))
    }
}

/// What happens while pushing; `item` is an index into the items.
#[derive(Clone, Copy, Debug)]
pub enum PushEvent {
    /// So many bytes of this item are sent.
    Sent {
        /// Which item.
        item: usize,
        /// Bytes from its beginning.
        bytes: u64,
    },
    /// This item is done, well or not.
    Done {
        /// Which item.
        item: usize,
    },
}

impl Client {
    /// Pushes recordings, `parallel` at a time.
    pub async fn push(
        &self,
        items: Vec<PushItem>,
        parallel: usize,
        on_event: impl Fn(PushEvent) + Send + Sync + 'static,
    ) -> Pushed {
        let started = Instant::now();
        let on_event = Arc::new(on_event);
        let uploads = items.into_iter().enumerate().map(|(index, item)| {
            let (client, on_event) = (self.clone(), Arc::clone(&on_event));
            async move {
                let sent = Arc::clone(&on_event);
                let progress = move |bytes| sent(PushEvent::Sent { item: index, bytes });
                let result = client.upload(&item.task, &item.path, &item.label, progress).await;
                on_event(PushEvent::Done { item: index });
                PushResult { path: item.path, result }
            }
        });
        let results = futures::stream::iter(uploads).buffered(parallel.max(1)).collect().await;
        Pushed { results, wall: started.elapsed() }
    }
}
