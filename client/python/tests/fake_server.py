"""A server whose one policy answers as a test says: a real one cannot be made to be late, to stop or to break."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent import futures
from dataclasses import dataclass, field
from typing import Any

import grpc
import numpy as np
from google.protobuf.message import Message

import gleaner
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._proto.v1 import task_pb2

Answer = Callable[[int, pb.Observation], pb.SessionResponse]
Start = Callable[[Answer], "tuple[Play, gleaner.Client]"]


@dataclass
class Play:
    """A server with one deployment of a task with one value each; `answer` is the reply to the n-th observation."""

    answer: Answer
    opened: list[pb.SessionOpen] = field(default_factory=list)
    heard: list[pb.Observation] = field(default_factory=list)
    outcomes: list[str] = field(default_factory=list)
    # Waits before the answer to an opening and before that to a close.
    opening: Callable[[], object] = lambda: None
    closing: Callable[[], object] = lambda: None

    def serve(self) -> tuple[grpc.Server, str]:
        """Starts it; returns the server and its address."""
        deployments = pb.ListDeploymentsResponse(deployments=[pb.Deployment(name="d", task_id="task_1")])
        task = task_pb2.GetTaskResponse(task=task_pb2.Task(spec=SPEC))
        handlers = {
            "PolicyService/ListDeployments": _reply(pb.ListDeploymentsRequest, deployments),
            "TaskService/GetTask": _reply(task_pb2.GetTaskRequest, task),
            "PolicyService/Session": grpc.stream_stream_rpc_method_handler(
                self.session, pb.SessionRequest.FromString, pb.SessionResponse.SerializeToString
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
        return server, f"127.0.0.1:{port}"

    def session(
        self, requests: Iterator[pb.SessionRequest], context: grpc.ServicerContext
    ) -> Iterator[pb.SessionResponse]:
        self.opened.append(next(requests).open)
        number = len(self.opened)
        self.opening()
        yield pb.SessionResponse(opened=pb.SessionOpened(session_id=f"ses_{number}", policy_id=f"pol_{number}"))
        for number, request in enumerate(requests):
            if request.HasField("close"):
                self.outcomes.append(gleaner.word(request.close, "outcome"))
                self.closing()
                kept = f"ep_{len(self.outcomes)}" if self.opened[-1].record else ""
                yield pb.SessionResponse(closed=pb.SessionClosed(observations=number, episode_id=kept))
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


def _reply(request: type[Message], reply: Message) -> Any:
    return grpc.unary_unary_rpc_method_handler(
        lambda asked, context: reply, request.FromString, lambda message: message.SerializeToString()
    )
