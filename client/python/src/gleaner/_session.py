"""A session on the wire: open, ask, close. Knows messages, no arrays."""

from __future__ import annotations

from typing import Any

from gleaner._conversation import Conversation
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.errors import ServerError


class Session:
    """One episode with a deployment. For one thread."""

    def __init__(self, rpc: Rpc, opening: pb.SessionOpen, patience: float) -> None:
        self.draining = False
        self._stream: Conversation[pb.SessionRequest, pb.SessionResponse] = Conversation(
            rpc, "PolicyService/Session", pb.SessionResponse, patience, self._told_aside
        )
        self._stream.send(pb.SessionRequest(open=opening))
        try:
            self.opened = self._expect("opened").opened
        except Exception:
            self.abandon()
            raise

    def ask(self, observation: pb.Observation) -> pb.SessionAction | pb.SessionMissed:
        """Sends an observation and waits for what answers it."""
        self._stream.send(pb.SessionRequest(observation=observation))
        while True:
            response = self._expect("action", "missed")
            answer = response.action if response.HasField("action") else response.missed
            if answer.observation_stamp_ns == observation.stamp_ns:
                return answer

    def close(self, outcome: Any) -> pb.SessionClosed:
        """Ends the episode as it should."""
        self._stream.send(pb.SessionRequest(close=pb.SessionClose(outcome=outcome)))
        self._stream.no_more()
        try:
            while True:
                response = self._expect("closed", "action", "missed")
                if response.HasField("closed"):
                    return response.closed
        finally:
            self._stream.end()

    def abandon(self) -> None:
        """Ends the stream without a word."""
        self._stream.end()

    def _expect(self, *kinds: str) -> pb.SessionResponse:
        response = self._stream.receive()
        kind = response.WhichOneof("message")
        if kind not in kinds:
            raise ServerError(f"the server said {kind}, not {' or '.join(kinds)}; is it of another version?")
        return response

    def _told_aside(self, response: pb.SessionResponse) -> bool:
        # Answers no call, so it is seen at once, even while the robot does something else.
        draining = response.HasField("draining")
        self.draining |= draining
        return draining
