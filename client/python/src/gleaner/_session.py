"""A session on the wire: one stream both ways. Knows messages, no arrays."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

import grpc

from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._rpc import Rpc
from gleaner.errors import DeadlineExceeded, Rejected, ServerError, Unavailable, from_rpc


class Session:
    """One episode with a deployment. For one thread."""

    def __init__(self, rpc: Rpc, opening: pb.SessionOpen, patience: float) -> None:
        self._patience = patience
        self.draining = False
        self._requests: queue.SimpleQueue[pb.SessionRequest | None] = queue.SimpleQueue()
        self._responses: queue.SimpleQueue[pb.SessionResponse | Rejected] = queue.SimpleQueue()
        self._requests.put(pb.SessionRequest(open=opening))
        self._call = rpc.converse("PolicyService/Session", self._outgoing(), pb.SessionResponse)
        # grpc's own iterator cannot stop waiting, so a thread reads and this one waits for it, for a time.
        threading.Thread(target=self._read, name="gleaner-session", daemon=True).start()
        try:
            self.opened = self._expect("opened").opened
        except Exception:
            self.abandon()
            raise

    def ask(self, observation: pb.Observation) -> pb.SessionAction | pb.SessionMissed:
        """Sends an observation and waits for what answers it."""
        self._requests.put(pb.SessionRequest(observation=observation))
        while True:
            response = self._expect("action", "missed")
            answer = response.action if response.HasField("action") else response.missed
            if answer.observation_stamp_ns == observation.stamp_ns:
                return answer

    def close(self) -> pb.SessionClosed:
        """Ends the episode as it should."""
        self._requests.put(pb.SessionRequest(close=pb.SessionClose()))
        self._requests.put(None)
        try:
            while True:
                response = self._expect("closed", "action", "missed")
                if response.HasField("closed"):
                    return response.closed
        finally:
            self._call.cancel()

    def abandon(self) -> None:
        """Ends the stream without a word."""
        self._requests.put(None)
        self._call.cancel()

    def _expect(self, *kinds: str) -> pb.SessionResponse:
        try:
            response = self._responses.get(timeout=self._patience)
        except queue.Empty:
            raise DeadlineExceeded(f"the server did not answer within {self._patience:g} s") from None
        if isinstance(response, Rejected):
            # Whoever asks again hears the same.
            self._responses.put(response)
            raise response
        kind = response.WhichOneof("message")
        if kind not in kinds:
            raise ServerError(f"the server said {kind}, not {' or '.join(kinds)}; is it of another version?")
        return response

    def _outgoing(self) -> Iterator[pb.SessionRequest]:
        while (request := self._requests.get()) is not None:
            yield request

    def _read(self) -> None:
        try:
            for response in self._call:
                if response.HasField("draining"):
                    # Answers no call, so it is seen at once, even while the robot does something else.
                    self.draining = True
                else:
                    self._responses.put(response)
        except grpc.RpcError as error:
            self._responses.put(from_rpc(error))
        else:
            self._responses.put(Unavailable("the server ended the session"))
