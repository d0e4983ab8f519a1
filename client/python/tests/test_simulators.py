"""Deployments in simulators of others: the adapter with a made-up one, and each simulator where it is installed.

`make check-simulators` installs them; rendering needs OSMesa or EGL.
"""

from __future__ import annotations

import base64
import io
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from numpy.typing import NDArray
from PIL import Image

import gleaner
from gleaner.simulators import Camera, Seen, Simulator, SimulatorAdapter, SimulatorVector, make

SIDE, STEPS = 24, 8
# Of each simulator: an environment, a camera of it and values with their sizes, and the size of an action.
ROBOSUITE = ("Lift", "robot0_eye_in_hand", {"robot0_eef_pos": 3, "robot0_gripper_qpos": 2}, 7)
METAWORLD = ("reach-v3", "gripperPOV", {"hand": 3, "gripper": 1}, 4)
LIBERO = ("libero_spatial/0", "agentview", {"state": 8, "robot0_gripper_qpos": 2}, 7)
CASES = {"robosuite": ROBOSUITE, "metaworld": METAWORLD, "libero": LIBERO}


def spec_of(name: str, camera: str, values: dict[str, int], action: int, *, depth: bool) -> gleaner.types.TaskSpec:
    """A task with one camera, whose recordings are JSON."""
    sources = [{"field": field, "topic": f"/{field}", "paths": ["data"]} for field in (*values, "action")]
    cameras = [{"camera": camera, "color": f"/{camera}", "depth": f"/{camera}/depth" if depth else ""}]
    return gleaner.types.TaskSpec(
        name=name,
        rate_hz=20.0,
        cameras=[{"name": camera, "height": SIDE, "width": SIDE, "depth": depth}],
        proprioception=[{"name": field, "size": size} for field, size in values.items()],
        action=[{"name": "action", "size": action}],
        mappings=[{"name": "json", "clock": "/action", "cameras": cameras, "fields": sources}],
    )


# The properties of the messages' JSON schemas.
PICTURE = {"format": {"type": "string"}, "data": {"type": "string", "contentEncoding": "base64"}}
NUMBERS = {"data": {"type": "array", "items": {"type": "number"}}}


def record(path: Path, spec: gleaner.types.TaskSpec, seed: int) -> Path:
    """Noise as a recording of a task."""
    chance = np.random.default_rng(seed)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        picture_of, numbers_of = (
            writer.register_schema(
                name, "jsonschema", json.dumps({"type": "object", "properties": properties}).encode()
            )
            for name, properties in (("picture", PICTURE), ("numbers", NUMBERS))
        )
        mapping = spec.mappings[0]
        topics = [source.topic for source in mapping.fields] + [mapping.cameras[0].color]
        topics += [mapping.cameras[0].depth] if mapping.cameras[0].depth else []
        sizes = {f"/{field.name}": field.size for field in (*spec.proprioception, *spec.action)}
        schemas = {topic: numbers_of if topic in sizes else picture_of for topic in topics}
        channels = {topic: writer.register_channel(topic, "json", schema) for topic, schema in schemas.items()}
        for step in range(STEPS):
            stamp = 10**18 + step * 50_000_000
            for topic, channel in channels.items():
                if topic in sizes:
                    content: dict[str, Any] = {"data": chance.uniform(-1, 1, sizes[topic]).tolist()}
                else:
                    kind, shape = (np.uint16, (SIDE, SIDE)) if topic.endswith("/depth") else (np.uint8, (SIDE, SIDE, 3))
                    content = {"format": "png", "data": png(chance.integers(0, 200, shape, kind))}
                writer.add_message(channel, stamp, json.dumps(content).encode(), stamp)
        writer.finish()
    return path


def png(pixels: NDArray[Any]) -> str:
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    return base64.b64encode(data.getvalue()).decode()


def deploy(client: gleaner.Client, spec: gleaner.types.TaskSpec, folder: Path) -> str:
    """A policy of a task, trained on noise for two steps."""
    client.tasks.create(spec)
    for seed, outcome in enumerate(("success", "failure")):
        client.episodes.push(record(folder / f"{seed}.mcap", spec, seed), task=spec.name, outcome=outcome)
    encoder = client.jobs.pretrain(spec.name, steps=2, batch=4, segment_length=2)
    policy = client.jobs.train(spec.name, experts_of=encoder.result_id, steps=2, batch=4)
    client.jobs.wait(policy, timeout=300)
    client.deploy(f"{spec.name}@test", policy.result_id)
    return f"{spec.name}@test"


class Counted(Simulator):
    """Solved on the third step; its picture and values are the number of the step."""

    name = "counted/one"
    low, high = np.full(2, -0.5, np.float32), np.full(2, 0.5, np.float32)

    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        self.steps, self.actions = 0, []  # type: int, list[NDArray[np.float32]]
        return self.seen(), {"success": False}

    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        self.actions.append(action)
        return self.seen(), 0.0, False, False, {"success": self.steps == 3}

    def seen(self) -> Seen:
        picture = np.full((SIDE, SIDE, 3), self.steps, np.uint8)
        return Seen({"arm": np.full((1, 3), self.steps), "other": np.zeros(2)}, {"eye": picture}, {})

    def close(self) -> None:
        pass


class Far:
    """Answers with an action beyond every bound."""

    def __init__(self, spec: gleaner.types.TaskSpec) -> None:
        self.spec = spec
        self.seen: list[gleaner.Observation] = []

    def __call__(self, observation: gleaner.Observation, /) -> NDArray[np.float32]:
        self.seen.append(observation)
        return np.array([-9.0, 9.0], np.float32)

    def reset(self) -> None:
        pass


class Uneven(Counted):
    """Solved at the step of its seed's number, or ended in the fourth; a step after that fails, as seed 13 does."""

    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        """The seed is in every value."""
        self.seed, self.over = seed or 0, False
        seen, info = super().reset(seed=seed)
        if self.seed == 13:
            raise gleaner.InvalidArgument("seed: is unlucky")
        return seen, info

    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Ends once."""
        assert not self.over, "a step after the end"
        seen, reward, _, _, _ = super().step(action)
        self.over = self.steps == min(self.seed, 4)
        info = {"success": self.steps == self.seed, "late": True} if self.steps > 1 else {"success": False}
        return seen, reward, self.over, False, info


def test_environments_in_processes_of_their_own_are_as_one() -> None:
    with SimulatorVector(Uneven, 3) as envs:
        assert (envs.num_envs, envs.name, envs.low.tolist()) == (3, "counted/one", [-0.5, -0.5])
        seen, info = envs.reset(seed=[2, 3, 9])
        assert [one.values["arm"].max() for one in seen] == [0, 0, 0]
        assert info == {"success": [False] * 3, "_success": [True] * 3}
        solved, ended = [], []
        for _ in range(5):
            seen, _, terminated, _, info = envs.step(np.zeros((3, 2), np.float32))
            solved.append(info["success"])
            ended.append(terminated)
        # A step after the end is not taken: it would fail.
        assert ended == [[False] * 3, [True, False, False], [True, True, False], [True] * 3, [True] * 3]
        assert solved[1:3] == [[True, False, False], [True, True, False]]
        assert [one.values["arm"].max() for one in seen] == [2, 3, 4]
        with pytest.raises(gleaner.InvalidArgument, match="there are 3 environments, got 2"):
            envs.reset(seed=[1, 2])
        with pytest.raises(gleaner.InvalidArgument, match="seed: is unlucky"):
            envs.reset(seed=[13, 1, 2])
        with pytest.raises(RuntimeError, match="the environments are closed"):
            envs.reset(seed=[1, 2, 3])
    with pytest.raises(gleaner.InvalidArgument, match="envs: must be at least 1"):
        SimulatorVector(Uneven, 0)
    with pytest.raises(gleaner.InvalidArgument, match="simulator: 'gazebo' is unknown"):
        SimulatorVector(partial(make, "gazebo", "x", []), 2)
    with pytest.raises(RuntimeError, match="the process of an environment ended with 7"):
        SimulatorVector(partial(os._exit, 7), 1)
    with pytest.raises(RuntimeError, match="ForeignError: it is stuck, 3 mm"):
        SimulatorVector(stuck, 1)


class ForeignError(Exception):
    """Does not survive a pipe, as those of some libraries."""

    def __init__(self, what: str, depth: int) -> None:
        super().__init__(f"{what}, {depth} mm")


def stuck() -> Simulator:
    raise ForeignError("it is stuck", 3)


def test_a_process_that_ends_and_an_interruption_end_all() -> None:
    with SimulatorVector(Uneven, 2) as envs:
        process, _ = envs._rows[0]
        process.kill()
        process.join()
        with pytest.raises(RuntimeError, match="the process of an environment ended with -9"):
            envs.step(np.zeros((2, 2), np.float32))
    with SimulatorVector(Uneven, 2) as envs:
        _, pipe = envs._rows[0]
        receive, envs._rows[0] = pipe, (envs._rows[0][0], Interrupted())  # type: ignore[assignment]
        with pytest.raises(KeyboardInterrupt):
            envs.reset(seed=[1, 2])
        with pytest.raises(RuntimeError, match="the environments are closed"):
            envs.reset(seed=[3, 4])
        receive.close()


class Interrupted:
    """A pipe at which the user loses patience."""

    def send(self, request: Any) -> None:
        pass

    def recv(self) -> Any:
        raise KeyboardInterrupt

    def close(self) -> None:
        pass


def test_names_of_a_simulator_become_those_of_a_task() -> None:
    policy = Far(spec_of("counted", "front", {"arm_position": 3}, 2, depth=False))
    adapter = SimulatorAdapter({"front": "eye"}, {"arm_position": "arm"})
    assert adapter.wanted(policy.spec) == [Camera("eye", SIDE, SIDE)]
    sim = Counted()
    trials = gleaner.evaluate(sim, policy, adapter, episodes=1)
    assert (trials.successes, trials.mean_steps) == (1, 3.0)
    assert [np.asarray(seen.proprioception).tolist() for seen in policy.seen] == [[0] * 3, [1] * 3, [2] * 3]
    assert [int(np.asarray(seen.images["front"]).max()) for seen in policy.seen] == [0, 1, 2]
    assert [action.tolist() for action in sim.actions] == [[-0.5, 0.5]] * 3


def test_cameras_are_rendered_at_the_size_of_recordings() -> None:
    spec = spec_of("counted", "front", {"arm": 3}, 2, depth=True)
    spec.cameras[0].recorded.height, spec.cameras[0].recorded.width = 48, 64
    assert SimulatorAdapter().wanted(spec) == [Camera("front", 48, 64, depth=True)]


@pytest.mark.parametrize(
    ("fields", "values", "action", "problem"),
    [
        ({}, {"leg": 3}, 2, r"field leg: the simulator has no 'leg'; name one with --field leg=…: arm \[3\], other"),
        ({"leg": "other"}, {"leg": 3}, 2, "field leg: other has 2 values, the task has 3"),
        ({}, {"arm": 3}, 5, "action: counted/one takes 2 values, the task has 5"),
    ],
)
def test_what_does_not_fit_is_named(fields: dict[str, str], values: dict[str, int], action: int, problem: str) -> None:
    policy = Far(spec_of("counted", "eye", values, action, depth=False))
    with pytest.raises(gleaner.InvalidArgument, match=problem):
        gleaner.evaluate(Counted(), policy, SimulatorAdapter({}, fields), episodes=1)


def test_unknown_names_are_refused() -> None:
    spec = spec_of("counted", "eye", {"arm": 3}, 2, depth=False)
    with pytest.raises(gleaner.InvalidArgument, match="camera rear: the task has none of this name; it has eye"):
        SimulatorAdapter({"rear": "eye"}).wanted(spec)
    with pytest.raises(gleaner.InvalidArgument, match="field leg: the task has none of this name; it has arm"):
        SimulatorAdapter({}, {"leg": "arm"}).wanted(spec)
    with pytest.raises(gleaner.InvalidArgument, match="simulator: 'gazebo' is unknown; supported: robosuite"):
        make("gazebo", "x", [])


@pytest.mark.parametrize("simulator", CASES)
def test_a_seed_is_an_episode_of_a_real_simulator(simulator: str) -> None:
    pytest.importorskip(simulator)
    env_id, camera, values, action = CASES[simulator]
    depth = simulator == "robosuite"
    sim = make(simulator, env_id, [Camera(camera, SIDE, 2 * SIDE, depth=depth)])
    first, again, other = (sim.reset(seed=seed)[0] for seed in (3, 3, 4))
    assert first.images[camera].shape == (SIDE, 2 * SIDE, 3)
    assert first.images[camera].std() > 1
    np.testing.assert_array_equal(first.images[camera], again.images[camera])
    state = {"robosuite": "cube_pos", "metaworld": "object", "libero": "akita_black_bowl_1_pos"}[simulator]
    np.testing.assert_array_equal(first.values[state], again.values[state])
    assert not np.array_equal(first.values[state], other.values[state])
    assert {name: np.size(first.values[name]) for name in values} == values
    assert (len(sim.low), len(sim.high)) == (action, action)
    if depth:
        # The hand looks at the table from above: between a hand's width and a metre.
        assert 50 < np.median(first.depth[camera]) < 1000
    assert sim.rate_hz == {"robosuite": 20.0, "metaworld": 80.0, "libero": None}[simulator]
    sim.close()
    with pytest.raises(gleaner.InvalidArgument, match=r"env: .* has no 'Nothing'; it has "):
        make(simulator, "Nothing", [])


@pytest.mark.parametrize("simulator", CASES)
def test_the_command_evaluates_a_deployment_in_a_real_simulator(
    simulator: str, client: gleaner.Client, server: str, tmp_path: Path
) -> None:
    pytest.importorskip(simulator)
    env_id, camera, values, action = CASES[simulator]
    deployment = deploy(
        client, spec_of(f"{simulator}_task", camera, values, action, depth=simulator == "robosuite"), tmp_path
    )
    words = [sys.executable, "-m", "gleaner.simulators", simulator, env_id, "--server", server]
    # The task is at 20 Hz.
    words += ["--option", "repeat=4"] if simulator == "metaworld" else []

    def run(*more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*words, *more], check=False, capture_output=True, text=True)

    offered = run()
    assert offered.returncode == 0, offered.stderr
    assert all(f"{name}: {size}" in offered.stdout.splitlines() for name, size in values.items())
    assert f"action: {action}, from [" in offered.stdout
    video = tmp_path / "videos"
    limits = ["--episodes", "2", "--seed", "5", "--max-steps", "4", "--execute", "2"]
    done = run("--deployment", deployment, *limits, "--video", str(video), "--record", "--report")
    assert done.returncode == 0, done.stderr
    summary, evaluation = done.stdout.splitlines()[-2:]
    assert " of 2 solved: " in summary
    kept = client.policies.evaluation(evaluation)
    assert (kept.simulation, kept.episodes) == (f"{simulator}/{env_id}", 2)
    assert {path.name.split("-")[1] for path in video.iterdir()} == {"5", "6"}
    recorded = [episode for episode in client.episodes.list(f"{simulator}_task") if episode.cohort == deployment]
    assert [episode.steps for episode in recorded] == [4, 4]
    together = run("--deployment", deployment, *limits, "--envs", "2")
    assert together.returncode == 0, together.stderr
    assert together.stdout.splitlines()[-1] == summary
    refused = run("--deployment", deployment, "--field", f"{next(iter(values))}=nothing")
    assert (refused.returncode, refused.stderr.splitlines()[-1][:13]) == (1, "error: field ")
