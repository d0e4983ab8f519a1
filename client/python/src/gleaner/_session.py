"""A session on the wire: open, observe, close. It handles messages, not arrays."""

from __future__ import annotations

import time
from typing import Any

from gleaner._conversation import Conversation, ReplyTimeout
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.errors import DeadlineExceeded, ServerError


class Session:
    """One episode with a deployment. For one thread.

    `patience` is how many seconds the server may send nothing while an answer is awaited, `opens_within` how long the
    opening may take.
    """

    def __init__(self, rpc: Rpc, opening: pb.SessionOpen, patience: float, opens_within: float) -> None:
        self.draining = False
        self._patience = patience
        # The start of the first wait since the newest answer that ended without one.
        self._silent_since: float | None = None
        self._stream: Conversation[pb.SessionRequest, pb.SessionResponse] = Conversation(
            rpc, "PolicyService/Session", pb.SessionResponse, patience, self._is_notice
        )
        self._stream.send(pb.SessionRequest(open=opening))
        try:
            self.opened = self._expect(opens_within, "opened").opened
        except Exception as error:
            self.abandon()
            if isinstance(error, ReplyTimeout):
                raise DeadlineExceeded(
                    f"deployment {opening.deployment}: no session was opened within {opens_within:g} s; the server may "
                    "still load the policy, so retry later"
                ) from None
            raise

    def observe(self, observation: pb.Observation) -> None:
        """Sends an observation, without waiting.

        It replaces those that a stalled connection has not sent yet, whose steps are then skipped steps.
        """
        for unsent in self._stream.withdraw():
            observation.skipped_steps += 1 + unsent.observation.skipped_steps
        self._stream.send(pb.SessionRequest(observation=observation))

    def answer(self, stamp_ns: int, within: float) -> pb.SessionAction | pb.SessionMissed | None:
        """Waits for the answer to the observation with this stamp; skips late ones to earlier observations.

        None if it does not come within this time, after which the session continues. Raises `DeadlineExceeded` where
        the server has sent nothing for the session's patience.
        """
        begun = time.monotonic()
        while True:
            try:
                response = self._expect(begun + within - time.monotonic(), "action", "missed")
            except ReplyTimeout:
                self._silent_since = self._silent_since or begun
                if within < self._patience and time.monotonic() - self._silent_since < self._patience:
                    return None
                raise DeadlineExceeded(f"the server did not answer within {self._patience:g} s") from None
            self._silent_since = None
            answer = response.action if response.HasField("action") else response.missed
            if answer.observation_stamp_ns == stamp_ns:
                return answer

    def close(self, outcome: Any, within: float) -> pb.SessionClosed:
        """Closes the session with an outcome; the server answers once it has stored the recording, if there is one."""
        end = time.monotonic() + within
        self._stream.send(pb.SessionRequest(close=pb.SessionClose(outcome=outcome)))
        self._stream.no_more()
        try:
            while True:
                response = self._expect(end - time.monotonic(), "closed", "action", "missed")
                if response.HasField("closed"):
                    return response.closed
        except ReplyTimeout:
            known = self.opened.session_id
            raise DeadlineExceeded(
                f"session {known}: not closed within {within:g} s; the server continues to store its recording, whose "
                f"file name is {known}.mcap"
            ) from None
        finally:
            self._stream.end()

    def abandon(self) -> None:
        """Cancels the stream."""
        self._stream.end()

    def _expect(self, within: float, *kinds: str) -> pb.SessionResponse:
        response = self._stream.receive(within)
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
