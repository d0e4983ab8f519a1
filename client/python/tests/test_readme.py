"""The programs of the README against a real server."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import gleaner
from conftest import IMAGE, TASK, Lab
from gleaner.observation import size
from test_policy import Reach, ReachAdapter

README = Path(__file__).parents[1] / "README.md"


def block(beginning: str, server: str, deployment: str) -> str:
    """The first program of the README that contains a text, adapted to the test and shortened."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    code: str = next(code for code in blocks if beginning in code)
    return code.replace("127.0.0.1:7400", server).replace("pick_cube@prod", deployment).replace("=50", "=2")


def test_five_line_example_of_the_readme_works(
    client: gleaner.Client, server: str, deployment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = block("import gleaner\n\nwith", server, deployment)
    assert len([line for line in code.splitlines() if line]) == 4
    exec(code, {"env": Reach(), "adapter": ReachAdapter()})
    said = capsys.readouterr().out
    assert said.startswith("1 of 2 solved: 0.50")
    evaluation = client.policies.evaluation(said.split()[-1])
    assert evaluation.simulation == "mysim/pick-v0"


class MySim(gymnasium.Env[Any, NDArray[np.float32]]):
    """Has cameras and proprioception like the simulator of the README; solved on the fourth step of an even seed."""

    def __init__(self, fields: dict[str, int], actions: int) -> None:
        self.fields = fields
        spaces: dict[str, gymnasium.Space[Any]] = {
            name: gymnasium.spaces.Box(-np.inf, np.inf, (count,), np.float64) for name, count in fields.items()
        }
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self.action_space = gymnasium.spaces.Box(-0.01, 0.01, (actions,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
        super().reset(seed=seed)
        assert seed is not None
        self.solvable, self.steps = seed % 2 == 0, 0
        return self._felt(), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, NDArray[np.float64]], float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action), "the adapter has clipped it"
        self.steps += 1
        return self._felt(), 0.0, False, self.steps == 6, {"success": self.solvable and self.steps == 4}

    def render_camera(self, name: str, width: int) -> NDArray[np.uint8]:
        assert name
        return self.np_random.integers(0, 256, (width, width, 3), np.uint8)

    def render_depth(self, name: str, width: int) -> NDArray[np.uint16]:
        assert name
        return self.np_random.integers(0, 900, (width, width), np.uint16)

    def _felt(self) -> dict[str, NDArray[np.float64]]:
        return {name: self.np_random.normal(size=count) for name, count in self.fields.items()}


def test_adapter_of_a_simulator_takes_twenty_lines(
    client: gleaner.Client, server: str, deployment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = block("class MySim", server, deployment)
    adapter, _, _ = code.partition("env = gymnasium.make")
    assert len([line for line in adapter.splitlines() if line]) <= 20
    with gleaner.Policy(client, deployment) as policy:
        spec = policy.spec
    fields = {field.name: field.size for field in spec.proprioception}
    actions = size(spec.action)
    gymnasium.register("MySim-v0", f"{__name__}:MySim", kwargs={"fields": fields, "actions": actions})
    assert {(camera.height, camera.width) for camera in spec.cameras} == {(IMAGE, IMAGE)}
    exec(code, {})
    said = capsys.readouterr().out
    assert said.startswith("1 of 2 solved: 0.50")
    kept = [client.episodes.get(name) for name in re.findall(r"'(\w+)'", said)]
    assert [(gleaner.word(one, "outcome"), one.cohort, one.steps) for one in kept] == [
        ("success", "mysim", 4),
        ("failure", "mysim", 6),
    ]


class OwnSimulator:
    """Not Gymnasium's; solved on the fourth step of an even seed."""

    def __init__(self, spec: gleaner.types.TaskSpec) -> None:
        self.sizes = {field.name: field.size for field in spec.proprioception}
        self.actions = size(spec.action)

    def start(self, seed: int) -> None:
        self.seed, self.steps = seed, 0

    @property
    def solved(self) -> bool:
        return self.seed % 2 == 0 and self.steps == 4

    @property
    def over(self) -> bool:
        return self.solved or self.steps == 6

    def picture(self, name: str) -> NDArray[np.uint8]:
        assert name
        return np.full((IMAGE, IMAGE, 3), self.steps, np.uint8)

    def depth(self, name: str) -> NDArray[np.uint16]:
        assert name
        return np.full((IMAGE, IMAGE), 500, np.uint16)

    def measured(self, name: str) -> NDArray[np.float64]:
        return np.full(self.sizes[name], 0.1)

    def apply(self, action: NDArray[np.float32]) -> None:
        assert action.shape == (self.actions,)
        self.steps += 1


def test_simulator_that_is_not_of_gymnasium_needs_a_loop_only(
    client: gleaner.Client, server: str, deployment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with gleaner.Policy(client, deployment) as policy:
        simulator = OwnSimulator(policy.spec)
    code = block("def observed", server, deployment).replace("150", "102")
    exec(code, {"gleaner": gleaner, "simulator": simulator})
    kept = {seed: client.episodes.get(name) for seed, name in re.findall(r"(\d+) (ep_\w+)", capsys.readouterr().out)}
    found = {seed: (gleaner.word(one, "outcome"), one.steps) for seed, one in kept.items()}
    assert found == {"100": ("success", 4), "101": ("failure", 6)}


def test_pipeline_of_the_readme_runs_and_is_scheduled(
    client: gleaner.Client, lab: Lab, server: str, deployment: str
) -> None:
    code = block("stages =", server, deployment).replace("pick_cube", TASK).replace("2000", "2")
    found: dict[str, Any] = {"client": client}
    exec(code.replace('"evaluate": {}', '"evaluate": {"simulation": "pick_cube", "episodes": 1}'), found)
    assert [gleaner.word(client.jobs.get(job), "state") for job in found["chain"].jobs] == ["succeeded"] * 4
    made = [one for one in client.schedules.list(TASK) if one.name in ("nightly", "often")]
    assert [(one.cron, one.labelled_episodes) for one in made] == [("0 2 * * *", 0), ("", 20)]
    for one in made:
        client.schedules.delete(one)
