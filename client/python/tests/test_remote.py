"""Policies that other servers run: one in Python behind openpi's messages, and the shared server by both protocols."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import tritonclient.grpc as triton
from numpy.typing import NDArray
from openpi_client import msgpack_numpy
from openpi_client.action_chunk_broker import ActionChunkBroker
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server as WebsocketServer
from websockets.sync.server import ServerConnection, serve

import gleaner
from conftest import DEPLOYMENT, Lab
from gleaner.observation import size
from gleaner.types import TaskSpec
from programs import Server, cli
from test_openpi import as_sent
from test_policy import observation
from test_tritonclient import tensors

TASK = "pick_small"


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A second server, which may connect to servers of policies on this machine."""
    flags = ["--workers", "0", "--policy-servers", "127.0.0.1", "--openpi-listen", "127.0.0.1:0"]
    process = Server(tmp_path_factory.mktemp("other"), *flags)
    yield process
    process.stop()


@pytest.fixture(scope="module")
def here(other: Server, client: gleaner.Client, task: str) -> Iterator[gleaner.Client]:
    """A client of the second server, which has the task of the first."""
    with gleaner.connect(other.address) as connected:
        connected.tasks.create(client.tasks.get(task).spec)
        yield connected


class OwnPolicy:
    """A policy of a lab in numpy: its actions depend on every value that it is sent."""

    def __init__(self, spec: TaskSpec) -> None:
        self.width = size(spec.action)
        self.seen: list[dict[str, Any]] = []
        self.connections = 0

    def actions(self, seen: dict[str, Any]) -> NDArray[np.float32]:
        """A chunk of four: the mean of the picture and the first value of the state, then one more each step."""
        first = float(np.mean(seen["observation/image"])) / 255 + float(seen["observation/state"][0])
        return (np.tile(np.arange(4)[:, None], (1, self.width)) * 0.01 + first * 0.1).astype(np.float32)

    def session(self, socket: ServerConnection) -> None:
        """One connection, as openpi's server handles it."""
        self.connections += 1
        socket.send(msgpack_numpy.packb({"name": "own"}))
        try:
            for message in socket:
                seen = msgpack_numpy.unpackb(message)
                self.seen.append(seen)
                socket.send(msgpack_numpy.packb({"actions": self.actions(seen)}))
        except ConnectionClosed:
            pass


@dataclass
class Running:
    policy: OwnPolicy
    server: WebsocketServer
    address: str


@pytest.fixture
def own(client: gleaner.Client, task: str) -> Iterator[Running]:
    """The policy, served."""
    policy = OwnPolicy(client.tasks.get(task).spec)
    with serve(policy.session, "127.0.0.1", 0, max_size=None) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield Running(policy, server, f"ws://127.0.0.1:{server.socket.getsockname()[1]}")


def registered(here: gleaner.Client, address: str) -> str:
    """The id of the policy with names as DROID's and LIBERO's servers have them."""
    camera = here.tasks.get(TASK).spec.cameras[0].name
    policy = here.policies.register(
        TASK,
        "openpi",
        address,
        inputs={
            "observation/image": {"camera": camera},
            "observation/state": {"proprioception": True},
            "prompt": {"text": "pick the cube"},
        },
        chunk_length=4,
        execute_length=2,
        source="numpy",
    )
    assert (policy.kind, policy.remote.source, policy.remote.output) == ("remote", "numpy", "actions")
    return policy.id


def test_a_policy_in_python_gets_sessions(here: gleaner.Client, own: Running) -> None:
    here.deploy("own@test", registered(here, own.address))
    spec = here.tasks.get(TASK).spec
    own.policy.seen.clear()
    with gleaner.Policy(here, "own@test") as policy:
        steps = [observation(spec, seed) for seed in range(4)]
        chunks = [policy.chunk(step) for step in steps]
    assert len(own.policy.seen) == 2, "two actions of each chunk are executed"
    sent = own.policy.seen[0]
    np.testing.assert_array_equal(sent["observation/image"], steps[0]["images"][spec.cameras[0].name])
    np.testing.assert_allclose(sent["observation/state"], steps[0]["proprioception"], rtol=1e-6)
    assert sent["prompt"] == "pick the cube"
    ranges = [(field.minimum, field.maximum) for field in spec.action for _ in range(field.size)]
    low, high = np.array(ranges).T
    for at, chunk in enumerate(chunks):
        predicted = own.policy.actions(own.policy.seen[at // 2])[at % 2 :]
        # The last value is the gripper's, which is open or closed.
        np.testing.assert_allclose(chunk.actions[:, :-1], np.clip(predicted, low, high)[:, :-1], atol=1e-6)
        assert set(np.abs(chunk.actions[:, -1])) == {1.0}


def test_clients_of_other_protocols_execute_as_many_actions_of_a_chunk_as_they_like(
    here: gleaner.Client, other: Server, own: Running
) -> None:
    here.deploy("chunks@test", registered(here, own.address))
    spec = here.tasks.get(TASK).spec
    seen = [observation(spec, seed) for seed in range(10)]
    ranges = [(field.minimum, field.maximum) for field in spec.action for _ in range(field.size)][:-1]
    low, high = np.array(ranges).T
    for horizon in (4, 3, 1):
        own.policy.seen.clear()
        broker = ActionChunkBroker(WebsocketClientPolicy(f"{other.openpi}/chunks@test"), action_horizon=horizon)
        acted = [broker.infer(as_sent(step))["actions"] for step in seen]
        assert len(own.policy.seen) == -(-len(seen) // horizon)
        expected = [own.policy.actions(own.policy.seen[at // horizon])[at % horizon] for at in range(len(seen))]
        np.testing.assert_allclose(np.array(acted)[:, :-1], np.clip(np.array(expected)[:, :-1], low, high), atol=1e-6)
    own.policy.seen.clear()
    client = triton.InferenceServerClient(other.address.rpartition("//")[2])
    for at, step in enumerate(seen[:3]):
        arrays = {**step["images"], **{f"{name}.depth": depth for name, depth in step["depth"].items()}}
        arrays["proprioception"] = step["proprioception"].astype(np.float32)
        answer = client.infer("chunks@test", tensors(arrays), sequence_id="robot", sequence_start=at == 0)
        assert (answer.as_numpy("action").shape, len(own.policy.seen)) == ((4, own.policy.width), at + 1)
    client.close()


def test_a_policy_in_python_is_evaluated_and_its_rollouts_are_episodes(here: gleaner.Client, own: Running) -> None:
    policy_id = registered(here, own.address)
    here.deploy("tried@test", policy_id)

    class Simulator:
        """A line on which the policy moves forward."""

        def reset(self, *, seed: int | None = None) -> tuple[int, dict[str, Any]]:
            self.at = seed or 0
            return self.at, {}

        def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
            self.at += 1
            assert np.isfinite(action).all()
            return self.at, 0.0, False, False, {}

    class Line(gleaner.Adapter):
        """Pictures and values that depend on the place."""

        def seen(self, observed: int) -> dict[str, Any]:
            return observation(here.tasks.get(TASK).spec, observed)

        def cameras(self, env: Any, observation: Any) -> Any:
            return self.seen(observation)["images"]

        def depth(self, env: Any, observation: Any) -> Any:
            return self.seen(observation)["depth"]

        def proprioception(self, env: Any, observation: Any) -> Any:
            return self.seen(observation)["proprioception"]

        def success(self, env: Any, info: Any) -> bool:
            return bool(env.at % 2 == 0 and env.at > 4)

    with gleaner.Policy(here, "tried@test", record=True, cohort="tried") as policy:
        trials = gleaner.evaluate(Simulator(), policy, Line(), episodes=2, max_steps=8)
    evaluation = trials.report(here, "a line")
    assert (evaluation.episodes, evaluation.successes) == (2, trials.successes)
    kept = [episode for episode in here.episodes.list(TASK) if episode.cohort == "tried"]
    assert len(kept) == 2


def test_a_dead_server_is_named_and_does_not_keep_a_robot_waiting(here: gleaner.Client, own: Running) -> None:
    policy_id = registered(here, own.address)
    here.deploy("dead@test", policy_id)
    own.server.shutdown()
    spec = here.tasks.get(TASK).spec
    with pytest.raises(gleaner.Rejected, match=r"ws://127.0.0.1:\d+ does not answer"):
        here.deploy("dead2@test", policy_id)
    with gleaner.Policy(here, "dead@test", deadline=30.0) as policy:
        for seed in range(3):
            with pytest.raises(gleaner.Missed, match=r"ws://127.0.0.1:\d+ does not answer"):
                policy(observation(spec, seed))


def test_wrong_answers_are_refused_with_a_sentence(here: gleaner.Client, own: Running) -> None:
    policy_id = registered(here, own.address)
    for answer, words in [
        (np.zeros((4, own.policy.width + 1), np.float32), "has shape"),
        (np.full((4, own.policy.width), np.nan), "is NaN, must be finite"),
        (np.zeros((9, own.policy.width)), "has 9 actions"),
        (np.array(["x"], dtype=object), "does not answer"),
    ]:
        own.policy.actions = lambda seen, answer=answer: answer  # type: ignore[method-assign,misc]
        with pytest.raises(gleaner.Rejected, match=words):
            here.deploy("wrong@test", policy_id)


@pytest.mark.parametrize("protocol", ["open-inference", "openpi"])
def test_another_gleaner_server_gives_its_actions(
    here: gleaner.Client, client: gleaner.Client, running: Server, lab: Lab, protocol: str
) -> None:
    del lab
    address, model = (
        (running.address, DEPLOYMENT) if protocol == "open-inference" else (f"{running.openpi}/{DEPLOYMENT}", "")
    )
    policy = here.policies.register(TASK, protocol, address, model=model, sequences=bool(model))
    here.deploy(f"{protocol}@test", policy.id)
    spec = client.tasks.get(TASK).spec
    steps = [observation(spec, seed) for seed in range(5)]
    with gleaner.Policy(client, DEPLOYMENT) as expected, gleaner.Policy(here, f"{protocol}@test") as found:
        for step in steps:
            np.testing.assert_allclose(found(step), expected(step), atol=1e-5)


def test_the_command_registers_a_policy(here: gleaner.Client, other: Server, own: Running) -> None:
    camera = here.tasks.get(TASK).spec.cameras[0].name
    words = ["--protocol", "openpi", "--address", own.address, "--input", f"images->top=planes:{camera}"]
    words += ["--input", "state=proprioception", "--chunk-length", "4", "--source", "by command"]
    cli("--server", other.address, "register-policy", "--task", TASK, *words)
    (found,) = [policy for policy in here.policies.list(TASK) if policy.remote.source == "by command"]
    names = [value.name for value in found.remote.inputs]
    assert names == ["images->top", "state"]
    with pytest.raises(gleaner.InvalidArgument, match=r"remote\.inputs"):
        here.policies.register(TASK, "openpi", own.address, inputs={"x": {"camera": "absent"}})
    with pytest.raises(gleaner.Rejected, match="--policy-servers"):
        here.policies.register(TASK, "openpi", "ws://10.0.0.5:8000")
