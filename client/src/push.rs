//! Push: uploads of several recordings at a time. A failed upload does not stop the others.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::source::Source;
use crate::upload::{UploadLabel, Uploaded};

/// One recording to push.
#[derive(Clone, Debug)]
pub struct PushItem {
    /// The recording: a file, or a folder of the parts of one.
    pub path: PathBuf,
    /// The parts `NAME_0.mcap`, `NAME_1.mcap` and so on of one recording; `path` is then for messages. Empty: `path`.
    pub parts: Vec<PathBuf>,
    /// The task's name or id.
    pub task: String,
    /// Its label.
    pub label: UploadLabel,
}

/// The result of one item.
#[derive(Debug)]
pub struct PushResult {
    /// The recording.
    pub path: PathBuf,
    /// The uploaded episode or the error.
    pub result: Result<Uploaded>,
}

/// The results of all items.
#[derive(Debug)]
pub struct Pushed {
    /// One per item, in the items' order.
    pub results: Vec<PushResult>,
    /// The duration of the whole push.
    pub wall: Duration,
}

impl Pushed {
    /// Bytes of the sent recordings, without those the server already had.
    #[must_use]
    pub fn sent_bytes(&self) -> u64 {
        self.uploaded().filter(|uploaded| !uploaded.existed).map(|uploaded| uploaded.episode.size_bytes).sum()
    }

    /// The recordings that the server now holds.
    pub fn uploaded(&self) -> impl Iterator<Item = &Uploaded> {
        self.results.iter().filter_map(|item| item.result.as_ref().ok())
    }

    /// The failed recordings with their errors.
    pub fn failures(&self) -> impl Iterator<Item = (&PushResult, &ClientError)> {
        self.results.iter().filter_map(|item| item.result.as_ref().err().map(|error| (item, error)))
    }
}

/// Progress of a push; `item` is an index into the items.
#[derive(Clone, Copy, Debug)]
pub enum PushEvent {
    /// This many bytes of the item are sent.
    Sent {
        /// The item's index.
        item: usize,
        /// Bytes from its beginning.
        bytes: u64,
    },
    /// The item is done or has failed.
    Done {
        /// The item's index.
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
                let result = match Source::of(&item.path, &item.parts) {
                    Ok(source) => client.upload_source(source, &item.task, &item.label, Arc::new(progress)).await,
                    Err(error) => Err(error),
                };
                on_event(PushEvent::Done { item: index });
                PushResult { path: item.path, result }
            }
        });
        let results = futures::stream::iter(uploads).buffered(parallel.max(1)).collect().await;
        Pushed { results, wall: started.elapsed() }
    }
}
