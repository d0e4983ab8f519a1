"""The connection: what happens without a server, with a wrong address, and when the server comes back."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest

import gleaner
from conftest import Server, half_an_upload


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port: int = taken.getsockname()[1]
    return port


def test_nobody_there_is_said_with_the_mend() -> None:
    port = free_port()
    with pytest.raises(gleaner.Unavailable, match=rf"127\.0\.0\.1:{port}.*gleaner-server serve") as raised:
        gleaner.connect(f"127.0.0.1:{port}", timeout=0.3)
    assert isinstance(raised.value, ConnectionError)


@pytest.mark.parametrize("address", ["localhost", "https://lab", "127.0.0.1:", ":7400", "http://lab:7400/x"])
def test_addresses_that_are_none_are_refused(address: str) -> None:
    with pytest.raises(gleaner.InvalidArgument, match="address"):
        gleaner.connect(address, timeout=0.1)


def test_a_token_is_never_repeated() -> None:
    with pytest.raises(gleaner.InvalidArgument) as raised:
        gleaner.connect("127.0.0.1:7400", token="my secret", timeout=0.1)
    assert "secret" not in str(raised.value)


def test_what_may_be_repeated_outlives_a_restart(
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


def test_every_error_can_be_caught_as_one() -> None:
    for name in gleaner.__all__:
        kind = getattr(gleaner, name)
        if isinstance(kind, type) and issubclass(kind, BaseException):
            assert issubclass(kind, gleaner.GleanerError), name
