//! The episodes of a snapshot, read page by page.

use gleaner_proto::v1::{GetSnapshotRequest, ListSnapshotEpisodesRequest, Snapshot, SnapshotEpisode};

use crate::connection::Client;
use crate::error::{ClientError, Result};

/// The episodes of one page.
const PAGE: u32 = 1000;

impl Client {
    /// A snapshot without its episodes.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] for an id that the server does not have, or when it cannot be reached.
    pub async fn snapshot(&self, id: &str) -> Result<Snapshot> {
        let request = GetSnapshotRequest { snapshot_id: id.to_owned(), omit_episodes: true };
        let reply = self.snapshots().get_snapshot(request).await?.into_inner();
        reply.snapshot.ok_or(ClientError::Contract { missing: "a snapshot" })
    }

    /// The episodes of a snapshot of any size, in its order: experts and imperfect ones.
    ///
    /// # Errors
    /// As [`Client::snapshot`].
    pub async fn snapshot_episodes(&self, id: &str) -> Result<Vec<SnapshotEpisode>> {
        let mut request =
            ListSnapshotEpisodesRequest { snapshot_id: id.to_owned(), page_size: PAGE, page_token: String::new() };
        let mut episodes = Vec::new();
        loop {
            let page = self.snapshots().list_snapshot_episodes(request.clone()).await?.into_inner();
            episodes.extend(page.episodes);
            if page.next_page_token.is_empty() {
                return Ok(episodes);
            }
            request.page_token = page.next_page_token;
        }
    }
}
