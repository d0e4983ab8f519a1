"""The demonstrations of the simulator example: when a recording ends, and how it is labelled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from programs import ROOT

LIMIT = 12


@pytest.fixture
def collected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Collects one episode of a task that is solved at these steps; its recording continues for `after` seconds."""
    monkeypatch.syspath_prepend(str(ROOT / "client" / "python" / "examples"))
    from simulator_example.agent import Action, Agent, Demonstrator, State
    from simulator_example.collect import collect
    from simulator_example.recorder import ACTION_TOPIC
    from simulator_example.simulator import ActionField, Fields, Frames, Simulator

    class Counting(Simulator):
        simulator, task, rate_hz, size, cameras = "counting", "count", 10.0, 4, ("front",)
        proprioception, action = {"count": 1}, {"more": ActionField(1)}
        imperfect = (Agent("lazy"),)

        def __init__(self, solved: set[int]) -> None:
            self.solved, self.steps = solved, 0

        def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[State, dict[str, Any]]:
            self.steps = 0
            return np.zeros(1), {"success": False}

        def step(self, action: Action) -> tuple[State, float, bool, bool, dict[str, Any]]:
            self.steps += 1
            success = self.steps in self.solved
            return np.full(1, self.steps), 0.0, success, self.steps >= LIMIT, {"success": success}

        def images(self) -> Frames:
            return {"front": np.zeros((4, 4, 3), np.uint8)}

        def felt(self, state: State) -> Fields:
            return {"count": state.astype(np.float32)}

        def demonstrator(self, agent: Agent, seed: int) -> Demonstrator:
            return lambda state: (np.ones(1, np.float32), np.ones(1, np.float32))

    def collect_one(solved: set[int], after: float) -> tuple[bool, int]:
        folder = tmp_path / f"{sorted(solved)}-{after}"
        [shown] = collect(Counting(solved), "count", folder, 0, 1, after_success_s=after)
        with shown.path.open("rb") as file:
            return shown.success, sum(1 for _ in make_reader(file).iter_messages([ACTION_TOPIC]))

    return collect_one


def test_recordings_continue_for_a_while_after_the_success(collected: Any) -> None:
    assert collected({3, 4, 5}, 0.0) == (True, 3)
    assert collected({3, 4, 5}, 0.5) == (True, 8)


def test_success_counts_though_it_is_lost_while_the_recording_continues(collected: Any) -> None:
    assert collected({3}, 0.5) == (True, 8)
    assert collected({3, 7}, 0.5) == (True, 8)


def test_recordings_end_at_the_limit_of_the_simulator(collected: Any) -> None:
    assert collected(set(), 0.5) == (False, LIMIT)
    assert collected({LIMIT - 1}, 0.5) == (True, LIMIT)
