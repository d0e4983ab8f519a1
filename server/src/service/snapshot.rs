//! SnapshotService: the episodes that jobs use, fixed.

use gleaner_proto::v1::{self, snapshot_service_server::SnapshotService};
use tonic::Request;

use super::{
    Services,
    answer::{Reply, answer, change},
};
use crate::{
    domain::snapshot::Snapshot,
    error::{Error, Result},
    wire,
};

/// The most episodes in one reply of `GetSnapshot`: 8 MB.
const MOST_EPISODES: u64 = 100_000;

/// Serves snapshots.
pub(crate) struct SnapshotApi(pub(crate) Services);

impl SnapshotApi {
    /// All episodes of a snapshot.
    async fn episodes(&self, snapshot: &Snapshot) -> Result<Vec<v1::SnapshotEpisode>> {
        expect_one_reply(snapshot)?;
        let (_, episodes) = self.0.store.snapshot(&snapshot.id).await?;
        Ok(episodes.into_iter().map(wire::snapshot::snapshot_episode).collect())
    }
}

/// Checks that the episodes of a snapshot fit into one reply.
fn expect_one_reply(snapshot: &Snapshot) -> Result<()> {
    let episodes = snapshot.expert_episodes + snapshot.imperfect_episodes;
    if episodes <= MOST_EPISODES {
        return Ok(());
    }
    Err(Error::precondition(format!(
        "{} has {episodes} episodes, and one reply at most {MOST_EPISODES}: set omit_episodes, and list them with \
         ListSnapshotEpisodes",
        snapshot.id
    )))
}

#[tonic::async_trait]
impl SnapshotService for SnapshotApi {
    async fn create_snapshot(&self, request: Request<v1::CreateSnapshotRequest>) -> Reply<v1::CreateSnapshotResponse> {
        change(request, async |request| {
            let (task, rule) = wire::snapshot::create_request(request)?;
            let task = self.0.store.task(&task).await?;
            let snapshot = self.0.store.create_snapshot(&task.id, &rule).await?;
            Ok(v1::CreateSnapshotResponse { snapshot: Some(wire::snapshot::snapshot(snapshot)) })
        })
        .await
    }

    async fn get_snapshot(&self, request: Request<v1::GetSnapshotRequest>) -> Reply<v1::GetSnapshotResponse> {
        answer(async {
            let v1::GetSnapshotRequest { snapshot_id, omit_episodes } = request.into_inner();
            let snapshot = self.0.store.frozen(&wire::snapshot::snapshot_id(&snapshot_id)?).await?;
            let episodes = if omit_episodes { Vec::new() } else { self.episodes(&snapshot).await? };
            Ok(v1::GetSnapshotResponse { snapshot: Some(wire::snapshot::snapshot(snapshot)), episodes })
        })
        .await
    }

    async fn list_snapshot_episodes(
        &self,
        request: Request<v1::ListSnapshotEpisodesRequest>,
    ) -> Reply<v1::ListSnapshotEpisodesResponse> {
        answer(async {
            let (id, behind, size) = wire::snapshot::episodes_request(request.into_inner())?;
            let (episodes, next) = self.0.store.snapshot_episodes(&id, behind, size).await?;
            Ok(v1::ListSnapshotEpisodesResponse {
                episodes: episodes.into_iter().map(wire::snapshot::snapshot_episode).collect(),
                next_page_token: next.map(|place| place.to_string()).unwrap_or_default(),
            })
        })
        .await
    }

    async fn list_snapshots(&self, request: Request<v1::ListSnapshotsRequest>) -> Reply<v1::ListSnapshotsResponse> {
        answer(async {
            let (task, page) = wire::snapshot::list_request(request.into_inner())?;
            let task = self.0.store.task(&task).await?;
            let (snapshots, next) = self.0.store.snapshots_page(&task.id, &page).await?;
            let snapshots = snapshots.into_iter().map(wire::snapshot::snapshot).collect();
            Ok(v1::ListSnapshotsResponse { snapshots, next_page_token: wire::page::token(next) })
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::{
        id::{SnapshotId, TaskId},
        snapshot::RoleRule,
        time::Millis,
    };

    #[test]
    fn a_snapshot_of_a_large_lab_is_listed_by_pages() {
        let snapshot = |imperfect_episodes| Snapshot {
            id: SnapshotId::new(),
            task_id: TaskId::new(),
            rule: RoleRule::default(),
            expert_episodes: 40,
            imperfect_episodes,
            created_at: Millis(0),
        };
        assert!(expect_one_reply(&snapshot(MOST_EPISODES - 40)).is_ok());
        let refusal = expect_one_reply(&snapshot(MOST_EPISODES - 39)).unwrap_err();
        assert!(refusal.message().contains("100001 episodes") && refusal.message().contains("ListSnapshotEpisodes"));
    }
}
