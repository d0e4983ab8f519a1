"""A policy whose server is late, stops or breaks: played by a server of our own, since a real one cannot be told to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent import futures
from dataclasses import dataclass, field
from typing import Any

import grpc
import numpy as np
import pytest
from google.protobuf.message import Message

import gleaner
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._proto.v1 import task_pb2

Answer = Callable[[int, pb.Observation], pb.SessionResponse]


@dataclass
class Play:
    """A server with one deployment of a task of one value each; `answer` says what comes for the n-th observation."""

    answer: Answer
    opened: list[pb.SessionOpen] = field(default_factory=list)
    heard: list[pb.Observation] = field(default_factory=list)

    def session(
        self, requests: Iterator[pb.SessionRequest], context: grpc.ServicerContext
    ) -> Iterator[pb.SessionResponse]:
        self.opened.append(next(requests).open)
        yield pb.SessionResponse(opened=pb.SessionOpened(policy_id=f"pol_{len(self.opened)}"))
        for number, request in enumerate(requests):
            if request.HasField("close"):
                yield pb.SessionResponse(closed=pb.SessionClosed(observations=number))
                return
            self.heard.append(request.observation)
            response = self.answer(number, request.observation)
            if response.HasField("closed"):
                context.abort(grpc.StatusCode.UNAVAILABLE, "the server has stopped")
            if response.HasField("draining"):
                yield response
                response = action(1.0)(number, request.observation)
            yield response


def action(*values: float, dropped: int = 0) -> Answer:
    def answer(_: int, observation: pb.Observation) -> pb.SessionResponse:
        steps = [pb.ActionStep(values=[value]) for value in values]
        return pb.SessionResponse(
            action=pb.SessionAction(observation_stamp_ns=observation.stamp_ns, actions=steps, dropped=dropped)
        )

    return answer


def missed(_: int, observation: pb.Observation) -> pb.SessionResponse:
    return pb.SessionResponse(missed=pb.SessionMissed(observation_stamp_ns=observation.stamp_ns))


SPEC = task_pb2.TaskSpec(
    name="t",
    rate_hz=10.0,
    cameras=[task_pb2.CameraSpec(name="top", height=2, width=2)],
    proprioception=[task_pb2.FieldSpec(name="q", size=1)],
    action=[task_pb2.FieldSpec(name="dq", size=1)],
)
SEEN = {"images": {"top": np.zeros((2, 2, 3), np.uint8)}, "proprioception": [0.0]}


@pytest.fixture
def play() -> Iterator[Callable[[Answer], tuple[Play, gleaner.Client]]]:
    stack: list[Callable[[], object]] = []

    def start(answer: Answer) -> tuple[Play, gleaner.Client]:
        shown = Play(answer)
        deployments = pb.ListDeploymentsResponse(deployments=[pb.Deployment(name="d", task_id="task_1")])
        task = task_pb2.GetTaskResponse(task=task_pb2.Task(spec=SPEC))
        handlers = {
            "PolicyService/ListDeployments": _reply(pb.ListDeploymentsRequest, deployments),
            "TaskService/GetTask": _reply(task_pb2.GetTaskRequest, task),
            "PolicyService/Session": grpc.stream_stream_rpc_method_handler(
                shown.session, pb.SessionRequest.FromString, pb.SessionResponse.SerializeToString
            ),
        }
        server = grpc.server(futures.ThreadPoolExecutor(4))
        for method, handler in handlers.items():
            service, name = method.split("/")
            server.add_generic_rpc_handlers(
                (grpc.method_handlers_generic_handler(f"gleaner.v1.{service}", {name: handler}),)
            )
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        client = gleaner.connect(f"127.0.0.1:{port}")
        stack.extend((lambda: server.stop(0).wait(), client.close))
        return shown, client

    yield start
    while stack:
        stack.pop()()


def _reply(request: type[Message], reply: Message) -> Any:
    return grpc.unary_unary_rpc_method_handler(
        lambda asked, context: reply, request.FromString, lambda message: message.SerializeToString()
    )


Start = Callable[[Answer], tuple[Play, gleaner.Client]]


def test_a_missed_step_is_answered_from_the_chunk_that_reaches_it(play: Start) -> None:
    chunk = action(1.0, 2.0)
    shown, client = play(lambda number, seen: (chunk if number == 0 else missed)(number, seen))
    with gleaner.Policy(client, "d", deadline=0.05, rate_hz=20.0) as policy:
        assert policy(SEEN) == [1.0]
        assert policy(SEEN) == [2.0]
        with pytest.raises(gleaner.Missed, match="deployment d"):
            policy(SEEN)
        assert policy.missed == 2
    assert (shown.opened[0].deadline_us, shown.opened[0].control_rate_hz) == (50_000, 20.0)
    assert [seen.stamp_ns for seen in shown.heard] == [0, 50_000_000, 100_000_000]
    # What really was executed is told, also when it came out of an older chunk.
    assert [list(seen.executed_action) for seen in shown.heard] == [[], [1.0], [2.0]]


def test_dropped_and_draining_are_seen(play: Start) -> None:
    draining = pb.SessionResponse(draining=pb.SessionDraining())
    shown, client = play(lambda number, seen: draining if number == 1 else action(1.0, dropped=2)(number, seen))
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        assert (policy.dropped, policy.draining) == (2, False)
        policy(SEEN)
        assert policy.draining
        policy.reset()
        assert (policy.dropped, policy.draining) == (0, False)
        policy(SEEN)
        assert policy.policy_id == "pol_2"
    assert len(shown.opened) == 2


def test_a_lost_session_is_said_and_not_quietly_begun_anew(play: Start) -> None:
    lost = pb.SessionResponse(closed=pb.SessionClosed())
    shown, client = play(lambda number, seen: lost if number == 1 else action(1.0)(number, seen))
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        with pytest.raises(gleaner.Unavailable, match="the server has stopped"):
            policy(SEEN)
        assert len(shown.opened) == 1
        # The next call is the first of another episode.
        assert policy(SEEN) == [1.0]
        assert shown.heard[-1].stamp_ns == 0
        assert not shown.heard[-1].executed_action


def test_silence_has_an_end(play: Start) -> None:
    import threading

    silent = threading.Event()

    def answer(number: int, seen: pb.Observation) -> pb.SessionResponse:
        silent.wait(10)
        return action(1.0)(number, seen)

    _, client = play(answer)
    policy = gleaner.Policy(client, "d", timeout=0.2)
    with pytest.raises(gleaner.DeadlineExceeded, match=r"did not answer within 0\.2 s"):
        policy(SEEN)
    silent.set()
    policy.close()
