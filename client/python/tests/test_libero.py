"""Tasks of LIBERO over a stand-in for its package, which counts steps as robosuite does: where an episode ends."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import gleaner
from gleaner.simulators import Camera, Simulator, SimulatorAdapter, make
from test_simulators import Far, spec_of

SUITE = SimpleNamespace(
    get_num_tasks=lambda: 1,
    get_task_bddl_file_path=lambda number: f"{number}.bddl",
    get_task_init_states=lambda number: np.zeros((2, 3)),
)


class OffScreenRenderEnv:
    """Solved in its n-th step after a reset, if at all; `done` is success, and a step beyond the horizon fails."""

    def __init__(self, *, horizon: int = 1000, solved: int = 0, ignore_done: bool = False, **options: Any) -> None:
        self.horizon, self.solved, self.ignore_done, self.options = horizon, solved, ignore_done, options

    def seed(self, seed: int) -> None:
        pass

    def reset(self) -> None:
        self.timestep, self.done = 0, False

    def set_init_state(self, state: NDArray[np.float64]) -> None:
        pass

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:
        if self.done:
            raise ValueError("executing action in terminated episode")
        self.timestep += 1
        self.done = self.timestep >= self.horizon and not self.ignore_done
        hand = {"eef_pos": np.zeros(3), "eef_quat": np.array([0.0, 0.0, 0.0, 1.0]), "gripper_qpos": np.zeros(2)}
        observed = {f"robot0_{name}": value for name, value in hand.items()}
        picture = np.zeros((24, 24, 3), np.uint8)
        return {**observed, "eye_image": picture}, 0.0, self.timestep == self.solved, {}

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def libero(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package, with one task."""
    modules: dict[str, dict[str, Any]] = {
        "libero": {},
        "libero.libero": {"benchmark": SimpleNamespace(get_benchmark_dict=lambda: {"suite": lambda: SUITE})},
        "libero.libero.envs": {},
        "libero.libero.envs.env_wrapper": {"OffScreenRenderEnv": OffScreenRenderEnv},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    own = "gleaner.simulators.libero"
    sys.modules.pop(own, None)
    yield
    sys.modules.pop(own, None)


def made(**options: Any) -> Simulator:
    return make("libero", "suite/0", [Camera("eye", 24, 24)], **options)


class Still(Far):
    """Does not move."""

    def __call__(self, observation: gleaner.Observation, /) -> NDArray[np.float32]:
        return np.zeros(7, np.float32)


def evaluated(sim: Simulator, max_steps: int | None = None) -> list[tuple[bool, int]]:
    """Success and steps of two episodes."""
    policy = Still(spec_of("libero", "eye", {"state": 8}, 7, depth=False))
    trials = gleaner.evaluate(sim, policy, SimulatorAdapter(), episodes=2, max_steps=max_steps)
    return [(trial.success, trial.steps) for trial in trials.trials]


@pytest.mark.parametrize(("options", "steps"), [({}, 990), ({"horizon": 300}, 290), ({"horizon": 11}, 1)])
def test_an_unsolved_episode_ends_at_the_horizon(options: dict[str, Any], steps: int) -> None:
    sim = made(**options)
    assert evaluated(sim) == [(False, steps)] * 2
    assert evaluated(sim, max_steps=20) == [(False, min(steps, 20))] * 2


def test_an_episode_that_is_solved_in_its_last_step_is_solved() -> None:
    assert evaluated(made(horizon=30, solved=30)) == [(True, 20)] * 2
    assert evaluated(made(horizon=30, solved=15)) == [(True, 5)] * 2


def test_episodes_that_ignore_the_horizon_have_no_limit_of_their_own() -> None:
    sim = made(horizon=30, ignore_done=True)
    assert evaluated(sim, max_steps=50) == [(False, 50)] * 2


def test_a_horizon_within_the_settling_steps_is_refused() -> None:
    with pytest.raises(gleaner.InvalidArgument, match="horizon: must be above 10, the steps for settling, got 10"):
        made(horizon=10)
