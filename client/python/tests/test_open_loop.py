"""Evaluations that execute several actions of a chunk, and videos of their episodes."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import gleaner
from conftest import Lab
from test_policy import Blind, Reach, ReachAdapter


class Chunks:
    """Answers each observation with a chunk that tells when it was made; some answers are late."""

    def __init__(self, late: tuple[int, ...] = ()) -> None:
        self.late, self.asked = late, 0
        self.executed: list[Any] = []

    def chunk(self, observation: gleaner.Observation) -> SimpleNamespace:
        self.executed.append(
            None if observation.executed_action is None else [*np.asarray(observation.executed_action)]
        )
        self.asked += 1
        if self.asked in self.late:
            raise gleaner.Missed("no action by the deadline")
        return SimpleNamespace(actions=np.array([[self.asked, step] for step in range(3)], np.float32))

    def __call__(self, observation: gleaner.Observation, /) -> NDArray[np.float32]:
        action: NDArray[np.float32] = self.chunk(observation).actions[0]
        return action

    def reset(self) -> None:
        self.asked = 0


class Noted(Reach):
    """Keeps the actions of its episodes."""

    def __init__(self) -> None:
        self.actions: list[list[float]] = []

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        self.actions.append(action.tolist())
        return super().step(action)


def test_chunks_are_executed_open_loop_and_every_observation_is_sent() -> None:
    policy, env = Chunks(), Noted()
    gleaner.evaluate(env, policy, Blind(), episodes=1, seed=1, execute=2)
    assert env.actions == [[1, 0], [1, 1], [3, 0], [3, 1], [5, 0]]
    assert policy.executed == [None, *env.actions[:-1]]
    # A chunk that is shorter than asked for is executed to its end, and each episode begins with a chunk of its own.
    policy, env = Chunks(), Noted()
    gleaner.evaluate(env, policy, Blind(), episodes=2, seed=1, execute=9, max_steps=4)
    assert env.actions == [[1, 0], [1, 1], [1, 2], [4, 0], [1, 0], [1, 1], [1, 2]]
    assert policy.executed[4] is None


class Bounded(Blind):
    """An environment that executes no value above 1."""

    def action(self, env: Any, action: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.minimum(action, 1)

    def executed(self, env: Any, action: NDArray[np.float32]) -> NDArray[np.float32] | None:
        return np.minimum(action, 1) if action.max() > 1 else None


@pytest.mark.parametrize("execute", [1, 2])
def test_a_policy_gets_the_actions_that_were_executed(execute: int) -> None:
    policy, env = Chunks(), Noted()
    gleaner.evaluate(env, policy, Bounded(), episodes=1, seed=1, execute=execute)
    assert max(value for action in env.actions for value in action) == 1
    reported = [None if execute == 1 and at == 1 else action for at, action in enumerate(env.actions, 1)]
    assert policy.executed == [None, *reported[:-1]]


def test_late_answers_matter_only_where_a_chunk_is_due() -> None:
    policy, env = Chunks(late=(2,)), Noted()
    gleaner.evaluate(env, policy, Blind(), episodes=1, seed=1, execute=2, max_steps=3)
    assert env.actions == [[1, 0], [1, 1], [3, 0]]
    with pytest.raises(gleaner.Missed):
        gleaner.evaluate(Noted(), Chunks(late=(3,)), Blind(), episodes=1, seed=1, execute=2)


def test_a_deployment_is_executed_open_loop(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    with gleaner.Policy(client, deployment, record=True, cohort="open loop") as policy:
        trials = gleaner.evaluate(Reach(), policy, ReachAdapter(), episodes=1, seed=11, execute=2)
    assert (trials.trials[0].steps, trials.policy_id) == (5, lab.policy)
    assert client.episodes.get(trials.trials[0].episode_id).steps == 5


def test_videos_show_the_cameras_side_by_side(tmp_path: Path) -> None:
    av = pytest.importorskip("av")

    class Seen(Blind):
        def cameras(self, env: Any, observation: Any) -> Mapping[str, NDArray[np.uint8] | bytes]:
            png = io.BytesIO()
            Image.fromarray(np.full((17, 20, 3), 200, np.uint8)).save(png, "PNG")
            return {"raw": np.full((16, 20, 3), 40, np.uint8), "png": png.getvalue()}

    folder = tmp_path / "videos"
    gleaner.evaluate(Reach(), Chunks(), Seen(), episodes=2, seed=10, video=folder)
    assert sorted(path.name for path in folder.iterdir()) == ["seed-10-success.mp4", "seed-11-failure.mp4"]
    with av.open(str(folder / "seed-11-failure.mp4")) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert [frame.shape for frame in frames] == [(18, 40, 3)] * 5
    assert abs(frames[0][8, 8].astype(int) - 40).max() < 12
    assert abs(frames[0][8, 32].astype(int) - 200).max() < 12
