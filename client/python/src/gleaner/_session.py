"""A session on the wire: open, observe, close. It handles messages, not arrays."""

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
            rpc, "PolicyService/Session", pb.SessionResponse, patience, self._is_notice
        )
        self._stream.send(pb.SessionRequest(open=opening))
        try:
            self.opened = self._expect("opened").opened
        except Exception:
            self.abandon()
            raise

    def observe(self, observation: pb.Observation) -> None:
        """Sends an observation, without waiting."""
        self._stream.send(pb.SessionRequest(observation=observation))

    def answer(self, stamp_ns: int) -> pb.SessionAction | pb.SessionMissed:
        """Waits for the answer to the observation with this stamp."""
        while True:
            response = self._expect("action", "missed")
            answer = response.action if response.HasField("action") else response.missed
            if answer.observation_stamp_ns == stamp_ns:
                return answer

    def close(self, outcome: Any) -> pb.SessionClosed:
        """Closes the session with an outcome."""
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
        """Cancels the stream."""
        self._stream.end()

    def _expect(self, *kinds: str) -> pb.SessionResponse:
        response = self._stream.receive()
        kind = response.WhichOneof("message")
        if kind not in kinds:
            expected = " or ".join(kinds)
            raise ServerError(
                f"the server sent {kind}, expected {expected}; client and server may be of different versions"
            )
        return response

    def _is_notice(self, response: pb.SessionResponse) -> bool:
        # Not an answer, so it is noted at once, even between two observations.
        draining = response.HasField("draining")
        self.draining |= draining
        return draining
