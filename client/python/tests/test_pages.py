"""Lists of many rows are read to their last page, against a fake of the calls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gleaner._pages import PAGE
from gleaner.datasets import Datasets
from gleaner.episodes import Episodes
from gleaner.policies import Policies
from gleaner.scores import Scores
from gleaner.snapshots import Snapshots
from gleaner.tasks import Tasks

ROWS = 5
SHORT = 2


class FakeRpc:
    """Answers a list with short pages of numbers; a token is the number of the next row."""

    def __init__(self, rows: str) -> None:
        self.rows = rows
        self.calls: list[tuple[str, int, str]] = []

    def safe(self, method: str, request: Any, reply: Any) -> Any:
        self.calls.append((method, request.page_size, request.page_token))
        first = int(request.page_token or 0)
        end = min(first + SHORT, ROWS)
        page = {self.rows: list(range(first, end)), "next_page_token": str(end) if end < ROWS else ""}
        return SimpleNamespace(**page)


def listed(kind: Any, rpc: FakeRpc) -> Any:
    """A client's group of calls, which has only its calls."""
    group = object.__new__(kind)
    group._rpc = rpc
    return group


@pytest.mark.parametrize(
    ("kind", "call", "arguments", "method", "rows"),
    [
        (Tasks, "list", (), "TaskService/ListTasks", "tasks"),
        (Episodes, "labels", ("ep_1",), "EpisodeService/ListLabels", "labels"),
        (Snapshots, "list", ("reach",), "SnapshotService/ListSnapshots", "snapshots"),
        (Scores, "list", ("reach",), "ScoreService/ListScoreRuns", "score_runs"),
        (Datasets, "list", ("reach",), "DatasetService/ListDatasets", "datasets"),
        (Datasets, "export_files", ("exp_1",), "DatasetService/ListExportFiles", "files"),
        (Policies, "list", ("reach",), "PolicyService/ListPolicies", "policies"),
        (Policies, "deployments", (), "PolicyService/ListDeployments", "deployments"),
        (Policies, "evaluations", ("pol_1",), "PolicyService/ListEvaluations", "evaluations"),
    ],
)
def test_a_list_is_read_to_its_last_page(
    kind: type, call: str, arguments: tuple[str, ...], method: str, rows: str
) -> None:
    rpc = FakeRpc(rows)
    assert [*getattr(listed(kind, rpc), call)(*arguments)] == [*range(ROWS)]
    assert rpc.calls == [(method, PAGE, ""), (method, PAGE, "2"), (method, PAGE, "4")]
