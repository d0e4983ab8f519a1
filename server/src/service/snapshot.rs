//! SnapshotService: what jobs see, frozen.

use gleaner_proto::v1::{self, snapshot_service_server::SnapshotService};
use tonic::{Request, Response};

use super::Services;
use crate::{
    error::Result,
    wire::{self, status::from_error},
};

/// Serves snapshots.
pub(crate) struct Snapshots(pub(crate) Services);

impl Snapshots {
    async fn create(&self, request: v1::CreateSnapshotRequest) -> Result<v1::CreateSnapshotResponse> {
        let (task, rule) = wire::snapshot::create_request(request)?;
        let task = self.0.store.task(&task).await?;
        let snapshot = self.0.store.create_snapshot(&task.id, &rule).await?;
        Ok(v1::CreateSnapshotResponse { snapshot: Some(wire::snapshot::snapshot(snapshot)) })
    }

    async fn get(&self, id: &str) -> Result<v1::GetSnapshotResponse> {
        let (snapshot, episodes) = self.0.store.snapshot(&wire::snapshot::snapshot_id(id)?).await?;
        Ok(v1::GetSnapshotResponse {
            snapshot: Some(wire::snapshot::snapshot(snapshot)),
            episodes: episodes.into_iter().map(wire::snapshot::snapshot_episode).collect(),
        })
    }

    async fn list(&self, task: &str) -> Result<v1::ListSnapshotsResponse> {
        let task = self.0.store.task(task).await?;
        let snapshots = self.0.store.snapshots(&task.id).await?;
        Ok(v1::ListSnapshotsResponse { snapshots: snapshots.into_iter().map(wire::snapshot::snapshot).collect() })
    }
}

#[tonic::async_trait]
impl SnapshotService for Snapshots {
    async fn create_snapshot(
        &self,
        request: Request<v1::CreateSnapshotRequest>,
    ) -> tonic::Result<Response<v1::CreateSnapshotResponse>> {
        self.create(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_snapshot(
        &self,
        request: Request<v1::GetSnapshotRequest>,
    ) -> tonic::Result<Response<v1::GetSnapshotResponse>> {
        self.get(&request.into_inner().snapshot_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_snapshots(
        &self,
        request: Request<v1::ListSnapshotsRequest>,
    ) -> tonic::Result<Response<v1::ListSnapshotsResponse>> {
        self.list(&request.into_inner().task).await.map(Response::new).map_err(from_error)
    }
}
