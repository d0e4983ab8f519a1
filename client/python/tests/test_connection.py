"""Connections without a server, with a wrong address, and after a restart of the server."""

from __future__ import annotations

import math
import socket
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import pytest

import gleaner
from conftest import half_an_upload
from gleaner._proto.v1 import episode_pb2 as pb
from gleaner._upload import Upload
from programs import Server


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port: int = taken.getsockname()[1]
    return port


def test_unreachable_server_raises_with_the_fix() -> None:
    port = free_port()
    with pytest.raises(gleaner.Unavailable, match=rf"127\.0\.0\.1:{port}.*gleaner-server serve") as raised:
        gleaner.connect(f"127.0.0.1:{port}", timeout=0.3)
    assert isinstance(raised.value, ConnectionError)


@pytest.mark.parametrize("address", ["localhost", "https://lab", "127.0.0.1:", ":7400", "http://lab:7400/x"])
def test_malformed_addresses_are_rejected(address: str) -> None:
    with pytest.raises(gleaner.InvalidArgument, match="address"):
        gleaner.connect(address, timeout=0.1)


def test_an_address_alone_is_no_connection() -> None:
    client = gleaner.Client
    with pytest.raises(TypeError, match=r"gleaner\.connect"):
        client("127.0.0.1:7400")  # type: ignore[arg-type]


def test_a_token_is_never_repeated() -> None:
    with pytest.raises(gleaner.InvalidArgument) as raised:
        gleaner.connect("127.0.0.1:7400", token="my secret", timeout=0.1)
    assert "secret" not in str(raised.value)


def test_repeatable_calls_survive_a_restart(
    tmp_path: Path, client: gleaner.Client, task: str, recordings: dict[str, list[Path]]
) -> None:
    spec = client.tasks.get(task).spec
    server = Server(tmp_path, "--workers", "0")
    try:
        with gleaner.connect(server.address) as own:
            own.tasks.create(spec)
            upload = half_an_upload(own, task, recordings["expert"][0])
            server.kill()
            with pytest.raises(gleaner.Unavailable):
                own.episodes.label("ep_1", "success")
            back = threading.Thread(target=server.start)
            back.start()
            episode = upload.run()
            back.join()
            assert [known.id for known in own.episodes.list(task)] == [episode.id]
    finally:
        server.stop()


def test_the_end_of_an_upload_has_no_time_limit() -> None:
    """The server inspects the whole recording before it answers."""
    limits: dict[str, float] = {}

    def noting(name: str) -> grpc.RpcMethodHandler[bytes, bytes]:
        def note(_: bytes, context: grpc.ServicerContext) -> bytes:
            limits[name] = context.time_remaining() or math.inf
            return b""

        return grpc.unary_unary_rpc_method_handler(note)

    handlers = {name: noting(name) for name in ("StartUpload", "FinishUpload")}
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler("gleaner.v1.EpisodeService", handlers)])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    with gleaner.connect(f"127.0.0.1:{port}", timeout=20) as client:
        Upload(client._rpc, Path("of no bytes"), pb.StartUploadRequest(), progress=lambda _: None).run()
    server.stop(None).wait()
    assert limits["StartUpload"] < 60
    assert limits["FinishUpload"] > 1e9


def test_every_error_can_be_caught_as_one() -> None:
    for name in gleaner.__all__:
        kind = getattr(gleaner, name)
        if isinstance(kind, type) and issubclass(kind, BaseException):
            assert issubclass(kind, gleaner.GleanerError), name


CLIENT = """
import sys
import gleaner

client = gleaner.connect(sys.argv[1])
print(len(client.tasks.list()) > 0)
"""

POLICY = f"""{CLIENT}
import numpy as np

spec = client.tasks.get(sys.argv[2]).spec
policy = gleaner.Policy(client, sys.argv[3])
images = {{camera.name: np.zeros((camera.height, camera.width, 3), np.uint8) for camera in spec.cameras}}
depth = {{camera.name: np.zeros((camera.height, camera.width), np.uint16) for camera in spec.cameras if camera.depth}}
values = np.zeros(sum(field.size for field in spec.proprioception))
policy({{"images": images, "depth": depth, "proprioception": values}})
"""


@pytest.mark.parametrize("program", [CLIENT, POLICY], ids=["client", "policy"])
def test_a_program_ends_although_it_closes_nothing(server: str, task: str, deployment: str, program: str) -> None:
    words = [sys.executable, "-c", program, server, task, deployment]
    ended = subprocess.run(words, check=False, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (0, "True\n"), ended.stderr
