"""openpi's own client against a real server: actions are those of sessions, and refusals are sentences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import websockets.sync.client as websocket
from openpi_client import msgpack_numpy
from openpi_client.action_chunk_broker import ActionChunkBroker
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

import gleaner
from conftest import DEPLOYMENT, IMAGE, Lab
from gleaner.observation import size
from programs import Server
from test_policy import observation


@pytest.fixture(scope="module")
def openpi(running: Server, lab: Lab) -> str:
    """The address for clients of openpi of the shared server."""
    del lab
    assert running.openpi.startswith("ws://127.0.0.1:")
    return running.openpi


def as_sent(seen: dict[str, Any]) -> dict[str, Any]:
    """An observation with the keys of DROID's and LIBERO's clients."""
    images = {f"observation/{name}": image for name, image in seen["images"].items()}
    depths = {f"observation/{name}_depth": depth for name, depth in seen["depth"].items()}
    return {**images, **depths, "observation/state": seen["proprioception"], "prompt": "pick the cube"}


def test_client_of_openpi_gets_the_actions_of_a_session(client: gleaner.Client, openpi: str, lab: Lab) -> None:
    policy = WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}")
    metadata = policy.get_server_metadata()
    assert (metadata["deployment"], metadata["policy_id"]) == (DEPLOYMENT, lab.policy)
    with gleaner.Policy(client, DEPLOYMENT) as session:
        spec = session.spec
        assert [camera["name"] for camera in metadata["cameras"]] == [camera.name for camera in spec.cameras]
        seen = [observation(spec, seed) for seed in range(4)]
        answers = [policy.infer(as_sent(step)) for step in seen]
        np.testing.assert_allclose(
            [answer["actions"][0] for answer in answers], [session(step) for step in seen], atol=1e-6
        )
    assert answers[0]["actions"].shape == (1, size(spec.action))
    assert 0 < answers[0]["policy_timing"]["infer_ms"] <= answers[0]["server_timing"]["infer_ms"]
    assert "prev_total_ms" not in answers[0]["server_timing"]
    assert answers[1]["server_timing"]["prev_total_ms"] >= answers[0]["server_timing"]["infer_ms"]


def test_reset_begins_a_new_episode(client: gleaner.Client, openpi: str) -> None:
    # Without a path there must be one deployment alone, as in this lab.
    names = [known.name for known in client.deployments()]
    policy = WebsocketClientPolicy(openpi if len(names) == 1 else f"{openpi}/{DEPLOYMENT}")
    spec = gleaner.Policy(client, DEPLOYMENT).spec
    seen = [as_sent(observation(spec, seed)) for seed in range(3)]
    first = [policy.infer(step)["actions"] for step in seen]
    again = [policy.infer({**step, "reset": at == 0})["actions"] for at, step in enumerate(seen)]
    np.testing.assert_array_equal(first, again)
    alone = policy.infer({**seen[2], "reset": True})["actions"]
    assert not np.array_equal(first[2], alone)


def test_chunk_broker_and_images_channel_by_channel(client: gleaner.Client, openpi: str) -> None:
    spec = gleaner.Policy(client, DEPLOYMENT).spec
    seen = observation(spec)
    broker = ActionChunkBroker(WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}"), action_horizon=1)
    action = broker.infer(as_sent(seen))["actions"]
    assert action.shape == (size(spec.action),)
    planes = {name: image.transpose(2, 0, 1) for name, image in seen["images"].items()}
    aloha = {"images": planes, "state": seen["proprioception"].astype(np.float32)}
    aloha |= {f"{name}_depth": depth for name, depth in seen["depth"].items()}
    again = WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}").infer(aloha)["actions"]
    np.testing.assert_allclose(again[0], action, atol=1e-6)


def test_keys_of_another_client_are_those_of_the_task_file(client: gleaner.Client, openpi: str) -> None:
    spec = gleaner.Policy(client, DEPLOYMENT).spec
    seen = observation(spec)
    expected = WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}").infer(as_sent(seen))["actions"]
    keys = {name: f"observation/{name}_view" for name in seen["images"]}
    changed = type(spec)()
    changed.CopyFrom(spec)
    for name, key in keys.items():
        changed.openpi.add(name=name, key=key)
    sent = {"observation/state": seen["proprioception"], "prompt": "put the bowl on the plate"}
    sent |= {keys[name]: image for name, image in seen["images"].items()}
    sent |= {f"{keys[name]}_depth": depth for name, depth in seen["depth"].items()}
    with pytest.raises(RuntimeError, match=r"is missing; the message has .*_view.*\[\[openpi\]\]"):
        WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}").infer(sent)
    client.tasks.update(spec.name, changed)
    try:
        answer = WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}").infer(sent)["actions"]
    finally:
        client.tasks.update(spec.name, spec)
    np.testing.assert_allclose(answer, expected, atol=1e-6)


def test_observations_that_do_not_fit_end_the_session_with_a_sentence(client: gleaner.Client, openpi: str) -> None:
    spec = gleaner.Policy(client, DEPLOYMENT).spec
    right = as_sent(observation(spec))
    camera = spec.cameras[0].name
    cases: list[tuple[dict[str, Any], str]] = [
        (
            {key: value for key, value in right.items() if key != f"observation/{camera}"},
            f"observation/{camera}: is missing",
        ),
        (
            {**right, f"observation/{camera}": np.zeros((7, IMAGE, 3), np.uint8)},
            r"has shape \[7, 16, 3\]; send uint8 of 16×16×3",
        ),
        ({**right, "observation/state": np.zeros(3)}, "observation/state: has 3 values, the task has"),
        ({**right, "observation/state": np.full(size(spec.proprioception), np.nan)}, "must be finite"),
    ]
    for sent, words in cases:
        policy = WebsocketClientPolicy(f"{openpi}/{DEPLOYMENT}")
        with pytest.raises(RuntimeError, match=words):
            policy.infer(sent)
        with pytest.raises(ConnectionClosed) as closed:
            policy.infer(right)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1011


def send_to_the_end(raw: websocket.ClientConnection, message: bytes) -> None:
    """Sends a message and reads to the end of the connection, whose error it raises."""
    raw.send(message)
    while True:
        raw.recv()


def test_messages_that_are_not_of_the_protocol_are_refused(openpi: str) -> None:
    address = f"{openpi}/{DEPLOYMENT}"
    for message, words in [
        ("text", "is text"),
        (b"\x81", "is not msgpack"),
        (msgpack_numpy.packb([1]), "one msgpack map"),
    ]:
        with websocket.connect(address) as raw:
            raw.recv()
            raw.send(message)
            assert words in raw.recv()
    with websocket.connect(address, max_size=None) as raw:
        raw.recv()
        with pytest.raises(ConnectionClosed):
            send_to_the_end(raw, bytes(8 << 20))
    with pytest.raises(InvalidStatus, match="403"):
        websocket.connect(address, origin=Origin("https://example.org"))
    for path, status in [("/unknown@prod", 404), ("/..%2f", 400)]:
        with pytest.raises(InvalidStatus) as refused:
            websocket.connect(openpi + path)
        assert refused.value.response.status_code == status


def test_health_is_answered_and_other_requests_must_upgrade(openpi: str) -> None:
    from urllib.error import HTTPError
    from urllib.request import urlopen

    address = openpi.replace("ws://", "http://")
    with urlopen(f"{address}/healthz") as health:
        assert (health.status, health.read()) == (200, b"OK\n")
    with pytest.raises(HTTPError, match="426"):
        urlopen(address)
