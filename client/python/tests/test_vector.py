"""Several environments at once against a real server: the same episodes as one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

import gleaner
from conftest import Lab
from gleaner.types import TaskSpec
from gleaner.vector_evaluation import info_of, row_of
from test_policy import Reach, ReachAdapter, observation

MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


class Tolerant(Reach):
    """Accepts steps after its end, which `Reach` counts on."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A reset by the vector itself has no seed."""
        return super().reset(seed=seed if seed is not None else 2**31)


def outcomes(trials: gleaner.Trials) -> list[tuple[int, bool, int]]:
    return [(trial.seed, trial.success, trial.steps) for trial in trials.trials]


@pytest.mark.parametrize("mode", MODES)
def test_episodes_of_a_vector_are_those_of_single_environments(
    client: gleaner.Client, deployment: str, lab: Lab, mode: AutoresetMode
) -> None:
    envs = SyncVectorEnv([Tolerant] * 3, autoreset_mode=mode)
    seen: list[gleaner.Trial] = []
    with gleaner.VectorPolicy(client, deployment, 3, record=True, cohort=f"vector-{mode.value}") as policy:
        trials = gleaner.evaluate_vector(envs, policy, ReachAdapter(), episodes=7, seed=10, on_trial=seen.append)
    assert outcomes(trials) == [(seed, seed % 2 == 0, 3 if seed % 2 == 0 else 5) for seed in range(10, 17)]
    assert sorted(seen, key=lambda trial: trial.seed) == list(trials.trials)
    assert trials.policy_id == lab.policy
    for trial in trials.trials:
        recorded = client.episodes.get(trial.episode_id)
        assert gleaner.word(recorded, "outcome") == ("success" if trial.success else "failure")
        assert client.episodes.report(trial.episode_id).steps == trial.steps


class Bounded(ReachAdapter):
    """Environments that execute 0.5 in place of what is above it."""

    def executed(self, env: Any, action: NDArray[np.float32]) -> NDArray[np.float32] | None:
        return np.minimum(action, 0.5) if action.max() > 0.5 else None


class Rising:
    """A policy of two rows, of which the second acts beyond the bounds; keeps what it is sent."""

    def __init__(self, spec: TaskSpec) -> None:
        self.spec, self.rows = spec, [SimpleNamespace(policy_id="")] * 2
        self.executed: list[list[Any]] = []

    def __call__(self, observations: Sequence[gleaner.Observation | None], /) -> NDArray[np.float32]:
        self.executed.append([seen and seen.executed_action for seen in observations])
        return np.array([[0.1, 0.2, 0.3], [0.1, 0.9, 0.3]], np.float32)

    def reset(self, row: int | None = None, outcome: str = "unknown") -> list[str]:
        return [""]


def test_a_row_gets_the_action_that_its_environment_executed(client: gleaner.Client, task: str) -> None:
    policy: Any = Rising(client.tasks.get(task).spec)
    gleaner.evaluate_vector(SyncVectorEnv([Tolerant] * 2), policy, Bounded(), episodes=2, max_steps=2)
    first, second = policy.executed
    assert first == [None, None]
    assert second[0] is None
    np.testing.assert_allclose(second[1], [0.1, 0.5, 0.3])


class Noted(Tolerant):
    """Keeps the actions of its episodes, by their seeds."""

    actions: ClassVar[dict[int, list[list[float]]]] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._now = Noted.actions[seed if seed is not None else 2**31] = []
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._now.append(np.asarray(action).tolist())
        return super().step(action)


def test_chunks_are_executed_open_loop_in_each_row(client: gleaner.Client, deployment: str) -> None:
    seeds = range(10, 14)
    with gleaner.Policy(client, deployment) as policy:
        alone = gleaner.evaluate(Noted(), policy, ReachAdapter(), episodes=4, seed=10, execute=2)
    expected, Noted.actions = Noted.actions, {}
    envs = SyncVectorEnv([Noted] * 3, autoreset_mode=AutoresetMode.DISABLED)
    with gleaner.VectorPolicy(client, deployment, 3) as rows:
        together = gleaner.evaluate_vector(envs, rows, ReachAdapter(), episodes=4, seed=10, execute=2)
        with pytest.raises(gleaner.InvalidArgument, match="execute"):
            gleaner.evaluate_vector(envs, rows, ReachAdapter(), execute=0)
    assert outcomes(together) == outcomes(alone)
    for seed in seeds:
        count = len(expected[seed])
        np.testing.assert_allclose(Noted.actions[seed][:count], expected[seed], rtol=1e-4, atol=1e-6)


def test_each_episode_of_a_vector_has_its_video(client: gleaner.Client, deployment: str, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    envs = SyncVectorEnv([Tolerant] * 3)
    with gleaner.VectorPolicy(client, deployment, 3) as policy:
        gleaner.evaluate_vector(envs, policy, ReachAdapter(), episodes=4, seed=10, video=tmp_path / "videos")
        names = [f"seed-{seed}-{'failure' if seed % 2 else 'success'}.mp4" for seed in range(10, 14)]
        assert sorted(path.name for path in (tmp_path / "videos").iterdir()) == names
        for name, steps in zip(names, (3, 5, 3, 5), strict=True):
            with av.open(str(tmp_path / "videos" / name)) as video:
                assert len([*video.decode(video=0)]) == steps, name

        class Failing(ReachAdapter):
            def action(self, env: Any, action: Any) -> Any:
                raise RuntimeError("the gripper is stuck")

        with pytest.raises(RuntimeError, match="stuck"):
            gleaner.evaluate_vector(envs, policy, Failing(), episodes=2, seed=20, video=tmp_path / "broken")
    assert [*(tmp_path / "broken").glob("*.mp4")] == [], "part of an episode is not taken for one"


def test_rows_are_episodes_of_their_own(client: gleaner.Client, deployment: str) -> None:
    with (
        gleaner.VectorPolicy(client, deployment, 2) as both,
        gleaner.Policy(client, deployment) as one,
        gleaner.Policy(client, deployment) as other,
    ):
        seen = [observation(one.spec, seed) for seed in range(5)]
        together = [both([seen[0], seen[1]]), both([seen[2], None]), both([seen[3], seen[4]])]
        alone = [one(seen[0]), one(seen[2]), one(seen[3])]
        beside = [other(seen[1]), other(seen[4])]
    np.testing.assert_allclose([step[0] for step in together], alone, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose([together[0][1], together[2][1]], beside, rtol=1e-4, atol=1e-6)
    assert not together[1][1].any()


def test_an_observation_that_does_not_fit_leaves_the_other_rows_in_their_episodes(
    client: gleaner.Client, deployment: str
) -> None:
    with gleaner.VectorPolicy(client, deployment, 2) as policy, gleaner.Policy(client, deployment) as alone:
        seen = [observation(policy.spec, seed) for seed in range(4)]
        policy([seen[0], seen[1]])
        broken = {**seen[1], "proprioception": [0.0]}
        with pytest.raises(gleaner.InvalidArgument, match="proprioception"):
            policy([seen[2], broken])
        actions = policy([seen[3], seen[2]])
        expected = [alone(seen[at]) for at in (0, 2, 3)]
        np.testing.assert_allclose(actions[0], expected[2], rtol=1e-4, atol=1e-6)
        with pytest.raises(gleaner.InvalidArgument, match="expected 2, one for each environment, got 1"):
            policy([seen[0]])
    with pytest.raises(gleaner.InvalidArgument, match="num_envs"):
        gleaner.VectorPolicy(client, deployment, 0)


def test_numbers_of_environments_and_of_sessions_must_match(client: gleaner.Client, deployment: str) -> None:
    envs = SyncVectorEnv([Tolerant] * 2)
    with gleaner.VectorPolicy(client, deployment, 3) as policy:
        with pytest.raises(gleaner.InvalidArgument, match="it acts in 3 environments, there are 2"):
            gleaner.evaluate_vector(envs, policy, ReachAdapter())
        with pytest.raises(gleaner.InvalidArgument, match="episodes"):
            gleaner.evaluate_vector(envs, policy, ReachAdapter(), episodes=0)


def test_rows_of_observations_and_info() -> None:
    tensor = SimpleNamespace(cpu=lambda: np.float32(3.0))
    batch = {"agent": {"qpos": np.arange(6).reshape(3, 2)}, "pair": (np.arange(3), [tensor, tensor, tensor])}
    assert row_of(batch, 1)["agent"]["qpos"].tolist() == [2, 3]
    assert row_of(batch, 2)["pair"] == (2, np.float32(3.0))
    masked = {"success": np.array([False, True]), "_success": np.array([True, False]), "name": "both"}
    assert info_of(masked, 0) == {"success": False}
    assert info_of(masked, 1) == {}
    ended = {"final_info": {"success": np.array([True, False])}, "_final_info": np.array([True, False]), "x": [1, 2]}
    assert info_of(ended, 0) == {"success": True}
    assert info_of(ended, 1) == {"x": 2}
    assert info_of({"final_info": np.array([{"success": True}, None], object), "_final_info": [True, False]}, 0) == {
        "success": True
    }
    assert info_of({"success": np.array([False, True]), "deep": {"a": np.array([1, 2])}}, 1) == {
        "success": True,
        "deep": {"a": 2},
    }
