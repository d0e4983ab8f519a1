"""Calls that fail in ways in which a real server rarely does: against a server of a few calls in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict

import gleaner
from gleaner._messages import build
from gleaner._proto.v1 import episode_pb2, job_pb2, task_pb2
from gleaner._proto.v1.score_pb2 import ScoreRecordingRequest
from gleaner.scoring import Scoring

Call = Callable[[Any, grpc.ServicerContext], Any]


@pytest.fixture
def served() -> Iterator[Callable[[dict[str, Call]], gleaner.Client]]:
    """A client of a server that has these calls, each `Service/Method`; what they return is sent as it is."""
    server = grpc.server(ThreadPoolExecutor(4))
    clients = []

    def serve(calls: dict[str, Call]) -> gleaner.Client:
        kinds = {"WriteUpload": grpc.stream_unary_rpc_method_handler, "WatchJob": grpc.unary_stream_rpc_method_handler}
        for path, call in calls.items():
            service, method = path.split("/")
            handler = kinds.get(method, grpc.unary_unary_rpc_method_handler)(call, response_serializer=bytes)
            generic = grpc.method_handlers_generic_handler(f"gleaner.v1.{service}", {method: handler})
            server.add_generic_rpc_handlers((generic,))
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        clients.append(gleaner.connect(f"127.0.0.1:{port}"))
        return clients[-1]

    yield serve
    for client in clients:
        client.close()
    server.stop(None)


def test_an_error_of_the_requests_is_raised_to_the_caller(
    served: Callable[[dict[str, Call]], gleaner.Client],
) -> None:
    def write(requests: Iterator[bytes], context: grpc.ServicerContext) -> bytes:
        del context
        return b"".join(requests)[:0]

    client = served({"EpisodeService/WriteUpload": write})

    def requests() -> Iterator[episode_pb2.WriteUploadRequest]:
        yield episode_pb2.WriteUploadRequest(upload_id="up_1", data=b"a")
        raise OSError(5, "the disk has failed", "episode.mcap")

    with pytest.raises(OSError, match=r"the disk has failed: 'episode\.mcap'"):
        client._rpc.upload("EpisodeService/WriteUpload", requests(), episode_pb2.WriteUploadResponse)


def test_a_time_limit_that_is_not_of_the_caller_is_raised(
    served: Callable[[dict[str, Call]], gleaner.Client],
) -> None:
    def watch(request: bytes, context: grpc.ServicerContext) -> Iterator[bytes]:
        del request
        context.abort(grpc.StatusCode.DEADLINE_EXCEEDED, "a proxy ends calls after an hour")
        yield b""

    client = served({"JobService/WatchJob": watch})
    with pytest.raises(gleaner.DeadlineExceeded, match="a proxy ends calls after an hour"):
        client.jobs.wait("job_1")


@pytest.mark.parametrize("method", ["SubmitJob", "SubmitPipeline"])
def test_a_submission_whose_response_is_lost_is_repeated_under_its_key(
    served: Callable[[dict[str, Call]], gleaner.Client], method: str
) -> None:
    keys: list[str] = []

    def submit(request: bytes, context: grpc.ServicerContext) -> bytes:
        kind: Any = getattr(job_pb2, f"{method}Request")
        keys.append(kind.FromString(request).key)
        if len(keys) == 1:
            context.abort(grpc.StatusCode.UNAVAILABLE, "going down")
        return b""

    jobs = served({f"JobService/{method}": submit}).jobs

    def call(**order: Any) -> object:
        return jobs.pretrain("lift", **order) if method == "SubmitJob" else jobs.pipeline("lift", **order)

    call()
    call()
    call(key="mine")
    first, repeated, second, given = keys
    assert first == repeated != ""
    assert second not in ("", first), "another call is another job"
    assert given == "mine"


def test_each_attempt_to_score_a_recording_sends_the_whole_file(tmp_path: Path) -> None:
    """The thread of an attempt whose connection broke may take its next message while another attempt sends."""
    path = tmp_path / "a.mcap"
    path.write_bytes(bytes(range(256)) * 10_000)

    def attempt() -> Iterator[ScoreRecordingRequest]:
        return Scoring._pieces("run_1", path, (path.stat().st_size, None), lambda sent: None)

    first, second = attempt(), attempt()
    sent = b""
    for opening, piece in zip(first, second, strict=True):
        assert opening == piece
        sent += piece.data
    assert sent == path.read_bytes()


def test_settings_may_be_numbers_of_numpy() -> None:
    settings = {"seed": np.int64(3), "rate": np.float32(0.5), "seeds": np.arange(2), "flag": np.bool_(True)}
    spec = build(job_pb2.JobSpec, {"train": {"settings": settings}})
    assert MessageToDict(spec.train.settings) == {"seed": 3.0, "rate": 0.5, "seeds": [0.0, 1.0], "flag": True}
    with pytest.raises(gleaner.InvalidArgument, match=r"train\.settings\.seed: <object .* is no number, text, flag"):
        build(job_pb2.JobSpec, {"train": {"settings": {"seed": object()}}})


def test_limits_of_an_action_are_a_number_or_a_list() -> None:
    field = build(task_pb2.FieldSpec, {"name": "joints", "size": 2, "minimum": [-1.0, -0.5], "maximum": 1.0})
    assert (list(field.minimum_each), field.HasField("minimum")) == ([-1.0, -0.5], False)
    assert (field.maximum, list(field.maximum_each)) == (1.0, [])
