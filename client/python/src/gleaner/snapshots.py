"""Snapshots: immutable lists of a task's episodes with their labels and roles, the inputs of jobs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gleaner._messages import build
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import snapshot_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.settings import RoleRule
from gleaner.types import Snapshot, SnapshotEpisode

_PAGE = 1000


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
        request = pb.GetSnapshotRequest(snapshot_id=snapshot_id, omit_episodes=True)
        return self._rpc.safe("SnapshotService/GetSnapshot", request, pb.GetSnapshotResponse).snapshot

    def episodes(self, snapshot_id: str) -> list[SnapshotEpisode]:
        """A snapshot's episodes with their labels as they were then, and their roles."""
        request = pb.ListSnapshotEpisodesRequest(snapshot_id=snapshot_id, page_size=_PAGE)
        episodes: list[SnapshotEpisode] = []
        while True:
            reply = self._rpc.safe("SnapshotService/ListSnapshotEpisodes", request, pb.ListSnapshotEpisodesResponse)
            episodes.extend(reply.episodes)
            if not reply.next_page_token:
                return episodes
            request.page_token = reply.next_page_token

    def list(self, task: str) -> list[Snapshot]:
        """A task's snapshots, newest first."""
        request = pb.ListSnapshotsRequest(task=task, page_size=PAGE)
        found = pages(self._rpc, "SnapshotService/ListSnapshots", request, pb.ListSnapshotsResponse)
        return [snapshot for page in found for snapshot in page.snapshots]
