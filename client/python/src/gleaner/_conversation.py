"""A bidirectional stream: messages out at any time, answers with a time limit. Independent of messages."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Generic, TypeVar

import grpc
from google.protobuf.message import Message

from gleaner._rpc import Rpc
from gleaner.errors import DeadlineExceeded, Rejected, Unavailable, from_rpc

Request = TypeVar("Request", bound=Message)
Reply = TypeVar("Reply", bound=Message)


class ReplyTimeout(DeadlineExceeded):
    """No answer within the time limit of the caller. The call continues."""


class Conversation(Generic[Request, Reply]):
    """One call. For one thread.

    Replies for which `aside` returns True answer no request; another thread calls it immediately.
    """

    def __init__(
        self, rpc: Rpc, method: str, reply: type[Reply], patience: float, aside: Callable[[Reply], bool]
    ) -> None:
        self._rpc, self._patience, self._aside = rpc, patience, aside
        self._requests: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply | Rejected] = queue.SimpleQueue()
        self._call = rpc.converse(method, self._outgoing(), reply)
        # grpc's own iterator blocks without a time limit, so a thread reads and this one waits for it.
        threading.Thread(target=self._read, name="gleaner-conversation", daemon=True).start()

    def send(self, request: Request) -> None:
        """Sends, without waiting."""
        self._requests.put(request)

    def withdraw(self) -> list[Request]:
        """Returns the requests that wait to be sent, which are then not sent."""
        waiting = []
        with suppress(queue.Empty):
            while (request := self._requests.get_nowait()) is not None:
                waiting.append(request)
            # The sending side is closed, and stays so.
            self._requests.put(None)
        return waiting

    def no_more(self) -> None:
        """Closes the sending side."""
        self._requests.put(None)

    def receive(self, within: float | None = None) -> Reply:
        """Returns the next answer. Raises the error that ended the call, at every call.

        Raises `ReplyTimeout` without one within this time, or within the patience of the conversation.
        """
        if within is None:
            within = self._patience
        try:
            reply = self._replies.get(timeout=max(within, 0.0))
        except queue.Empty:
            raise ReplyTimeout(f"the server did not answer within {within:g} s") from None
        if isinstance(reply, Rejected):
            # Raised again by later calls.
            self._replies.put(reply)
            raise reply
        return reply

    def end(self) -> None:
        """Cancels the call."""
        self._requests.put(None)
        self._call.cancel()

    def _outgoing(self) -> Iterator[Request]:
        while (request := self._requests.get()) is not None:
            yield request

    def _read(self) -> None:
        begun = False
        try:
            for reply in self._call:
                begun = True
                if not self._aside(reply):
                    self._replies.put(reply)
        except grpc.RpcError as error:
            # A call with an answer was connected: its error needs no diagnosis, for which a robot would wait.
            self._replies.put(from_rpc(error) if begun else self._rpc.failure(error))
        else:
            self._replies.put(Unavailable("the server ended the stream"))
