//! SnapshotService: the episodes that jobs use, fixed.

use gleaner_proto::v1::{self, snapshot_service_server::SnapshotService};
use tonic::Request;

use super::{
    Services,
    answer::{Reply, answer, change},
};
use crate::wire;

/// Serves snapshots.
pub(crate) struct SnapshotApi(pub(crate) Services);

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
            let id = wire::snapshot::snapshot_id(&request.get_ref().snapshot_id)?;
            let (snapshot, episodes) = self.0.store.snapshot(&id).await?;
            Ok(v1::GetSnapshotResponse {
                snapshot: Some(wire::snapshot::snapshot(snapshot)),
                episodes: episodes.into_iter().map(wire::snapshot::snapshot_episode).collect(),
            })
        })
        .await
    }

    async fn list_snapshots(&self, request: Request<v1::ListSnapshotsRequest>) -> Reply<v1::ListSnapshotsResponse> {
        answer(async {
            let task = self.0.store.task(&request.get_ref().task).await?;
            let snapshots = self.0.store.snapshots(&task.id).await?;
            Ok(v1::ListSnapshotsResponse { snapshots: snapshots.into_iter().map(wire::snapshot::snapshot).collect() })
        })
        .await
    }
}
