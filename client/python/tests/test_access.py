"""This client, the command line and tritonclient against a real server with TLS and tokens."""

from __future__ import annotations

import os
import pickle
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
import tritonclient.grpc as triton
import trustme
import websockets.sync.client as websocket
from openpi_client import msgpack_numpy
from tritonclient.utils import InferenceServerException
from websockets.exceptions import InvalidStatus

import gleaner
from conftest import DEPLOYMENT, TASK, Lab
from gleaner._endpoint import Endpoint
from programs import Server, binary, certificates
from test_tritonclient import observation, tensors


@dataclass(frozen=True)
class Guarded:
    """A server with TLS and tokens, and the credentials of its clients."""

    server: Server
    ca: Path
    cert: Path  # a client's own, and its key
    key: Path
    admin: str
    robot: str


def token(data: Path, *flags: str) -> str:
    """Creates a token, as the operator of the server does."""
    command = [binary("gleaner-server"), "token", "create", "--data-dir", str(data), *flags]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory, running: Server, lab: Lab) -> Iterator[Guarded]:
    del lab  # it is all there, and nothing is under way
    data = tmp_path_factory.mktemp("guarded") / "data"
    shutil.copytree(running.data, data)
    # All certificates are made by `gleaner-server tls`, as SECURITY.md describes.
    certificates(data, "init")
    certificates(data, "client", "robot@lab")
    names = ("ca.pem", "server.pem", "server.key", "client-robot@lab.pem", "client-robot@lab.key")
    ca, cert, key, own, own_key = (data / "tls" / name for name in names)
    flags = ["--require-tokens", "--tls-cert", str(cert), "--tls-key", str(key), "--client-ca", str(ca)]
    server = Server(data, *flags, "--openpi-listen", "127.0.0.1:0")
    admin = token(data, "--role", "admin", "--name", "admin")
    robot = token(data, "--role", "robot", "--name", "arm", "--deployment", DEPLOYMENT)
    yield Guarded(server, ca, own, own_key, admin, robot)
    server.stop()


def connect(guarded: Guarded, token: str | None) -> gleaner.Client:
    return gleaner.connect(guarded.server.address, token, 10.0, ca=guarded.ca, cert=guarded.cert, key=guarded.key)


def test_token_permits_the_calls_of_its_role(guarded: Guarded) -> None:
    assert guarded.server.address.startswith("https://")
    with connect(guarded, guarded.admin) as client:
        assert TASK in [task.spec.name for task in client.tasks.list()]
    with connect(guarded, guarded.robot) as client:
        assert [known.name for known in client.deployments()] == [DEPLOYMENT]
        with pytest.raises(gleaner.Unauthorized, match="needs the role viewer") as refused:
            client.tasks.list()
        assert refused.value.code is grpc.StatusCode.PERMISSION_DENIED
    for shown in (None, "gleaner_unknown_token"):
        with connect(guarded, shown) as client, pytest.raises(gleaner.Unauthorized, match="token") as refused:
            client.tasks.list()
        assert refused.value.code is grpc.StatusCode.UNAUTHENTICATED
        assert "gleaner_unknown_token" not in str(refused.value)


def test_untrusted_client_does_not_connect(guarded: Guarded, tmp_path: Path) -> None:
    stranger = tmp_path / "stranger.pem"
    trustme.CA().cert_pem.write_to_path(stranger)
    own: dict[str, Any] = {"cert": guarded.cert, "key": guarded.key}
    cases: list[dict[str, Any]] = [{"ca": stranger, **own}, {"ca": guarded.ca}, own]
    for shown in cases:
        with pytest.raises(gleaner.HandshakeFailed, match="certificate"):
            gleaner.connect(guarded.server.address, guarded.admin, **shown)


def test_unusable_credentials_are_named_before_connecting(guarded: Guarded) -> None:
    for shown, said in (
        ({"ca": "no/such/file.pem"}, "ca: cannot be read"),
        ({"cert": guarded.cert}, "give both"),
        ({"key": guarded.key}, "give both"),
    ):
        with pytest.raises(gleaner.InvalidArgument, match=said):
            gleaner.connect(guarded.server.address, guarded.admin, 1.0, **shown)
    with pytest.raises(gleaner.InvalidArgument, match="https://"):
        gleaner.connect("127.0.0.1:7400", ca=guarded.ca)


def test_worker_of_a_loader_gets_the_connection_and_prints_no_secret() -> None:
    endpoint = Endpoint("https://lab:7400", "gleaner_secret", 1.0, "ca.pem", "cert.pem", "key.pem")
    assert pickle.loads(pickle.dumps(endpoint)) == endpoint
    assert "gleaner_secret" not in repr(endpoint)


def test_command_line_accepts_the_certificate(guarded: Guarded) -> None:
    own = ["--ca", str(guarded.ca), "--client-cert", str(guarded.cert), "--client-key", str(guarded.key)]
    command = [binary("gleaner"), "--server", guarded.server.address, *own]

    def run(**environment: str) -> subprocess.CompletedProcess[str]:
        there = {name: value for name, value in os.environ.items() if not name.startswith("GLEANER_")}
        arguments = [*command, "task", "list"]
        return subprocess.run(arguments, check=False, capture_output=True, text=True, env=there | environment)

    assert run(GLEANER_TOKEN=guarded.admin).returncode == 0
    refused = run()
    assert refused.returncode != 0
    assert "GLEANER_TOKEN" in refused.stderr
    command[3:] = []
    untrusted = run(GLEANER_TOKEN=guarded.admin)
    assert "--ca" in untrusted.stderr


def test_tritonclient_with_tls_and_a_token(guarded: Guarded) -> None:
    client = triton.InferenceServerClient(
        guarded.server.address.rpartition("//")[2],
        ssl=True,
        root_certificates=str(guarded.ca),
        private_key=str(guarded.key),
        certificate_chain=str(guarded.cert),
    )
    robot = {"authorization": f"Bearer {guarded.robot}"}
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.get_server_metadata(headers=robot).name == "gleaner"
    assert client.is_model_ready(DEPLOYMENT, headers=robot)
    inputs = client.get_model_metadata(DEPLOYMENT, headers=robot).inputs
    seen = tensors(observation({tensor.name: tensor for tensor in inputs}, 1))
    action = client.infer(DEPLOYMENT, seen, headers=robot).as_numpy("action")
    assert np.isfinite(action).all()

    def refused(name: str, headers: dict[str, str]) -> str:
        with pytest.raises(InferenceServerException) as caught:
            client.infer(name, seen, headers=headers)
        return str(caught.value.status())

    assert refused(DEPLOYMENT, {}) == "StatusCode.UNAUTHENTICATED"
    assert refused("another@prod", robot) == "StatusCode.PERMISSION_DENIED"
    client.close()


def test_openpi_needs_the_certificate_and_the_key_of_a_robot(guarded: Guarded) -> None:
    context = ssl.create_default_context(cafile=guarded.ca)
    context.load_cert_chain(guarded.cert, guarded.key)
    assert guarded.server.openpi.startswith("wss://127.0.0.1:")

    def metadata(key: str | None, deployment: str = DEPLOYMENT) -> dict[str, Any]:
        headers = {"Authorization": f"Api-Key {key}"} if key else None
        address = f"{guarded.server.openpi}/{deployment}"
        with websocket.connect(address, ssl=context, additional_headers=headers) as socket:
            found: dict[str, Any] = msgpack_numpy.unpackb(socket.recv())
            return found

    assert metadata(guarded.robot)["deployment"] == DEPLOYMENT
    viewer = token(guarded.server.data, "--role", "viewer", "--name", "looks")
    for key, status in [(None, "401"), ("wrong", "401"), (viewer, "403")]:
        with pytest.raises(InvalidStatus, match=status):
            metadata(key)
    # A robot learns nothing about deployments that it is not bound to.
    with pytest.raises(InvalidStatus, match="403"):
        metadata(guarded.robot, "other@prod")
    audit = subprocess.run(
        [binary("gleaner-server"), "audit", "--data-dir", str(guarded.server.data)],
        check=True,
        capture_output=True,
        text=True,
    )
    assert "openpi/Session" in audit.stdout


def test_a_robot_is_driven_with_tls_and_a_token(guarded: Guarded) -> None:
    with connect(guarded, guarded.robot) as client, gleaner.Policy(client, DEPLOYMENT) as policy:
        cameras = {camera.name: np.zeros((camera.height, camera.width, 3), np.uint8) for camera in policy.spec.cameras}
        depth = {camera.name: np.zeros((camera.height, camera.width), np.uint16) for camera in policy.spec.cameras}
        joints = np.zeros(sum(field.size for field in policy.spec.proprioception), np.float32)
        assert np.isfinite(policy(gleaner.Observation(cameras, joints, depth))).all()
