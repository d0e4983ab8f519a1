"""Snapshots: immutable lists of a task's episodes with their labels and roles, the inputs of jobs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gleaner._messages import build
from gleaner._proto.v1 import snapshot_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.settings import RoleRule
from gleaner.types import Snapshot, SnapshotEpisode


class Snapshots:
    """`client.snapshots`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc

    def create(self, task: str, rule: RoleRule | Mapping[str, Any] | None = None) -> Snapshot:
        """Freezes a task's present episodes under a rule: without one, successes are experts, failures imperfect.

        Raises `FailedPrecondition` when that leaves no expert or no imperfect episode.
        """
        request = build(pb.CreateSnapshotRequest, {"task": task, "rule": dict(rule or {})})
        return self._rpc.unary("SnapshotService/CreateSnapshot", request, pb.CreateSnapshotResponse).snapshot

    def get(self, snapshot_id: str) -> Snapshot:
        """Returns a snapshot. Raises `NotFound`."""
        return self._get(snapshot_id).snapshot

    def episodes(self, snapshot_id: str) -> list[SnapshotEpisode]:
        """A snapshot's episodes with their labels as they were then, and their roles."""
        return [*self._get(snapshot_id).episodes]

    def list(self, task: str) -> list[Snapshot]:
        """A task's snapshots, newest first."""
        request = pb.ListSnapshotsRequest(task=task)
        return [*self._rpc.safe("SnapshotService/ListSnapshots", request, pb.ListSnapshotsResponse).snapshots]

    def _get(self, snapshot_id: str) -> pb.GetSnapshotResponse:
        request = pb.GetSnapshotRequest(snapshot_id=snapshot_id)
        return self._rpc.safe("SnapshotService/GetSnapshot", request, pb.GetSnapshotResponse)
