"""Calls: one channel, time limits and errors. Independent of services."""

from __future__ import annotations

import queue
import time
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any, TypeVar

import grpc
from google.protobuf.message import Message

from gleaner import _handshake
from gleaner._endpoint import Endpoint
from gleaner._retry import patiently
from gleaner.errors import HandshakeFailed, Rejected, Unavailable, from_rpc

Reply = TypeVar("Reply", bound=Message)

# A segment of large raw frames is the largest message in either direction.
_LARGEST = 256 << 20
_OPTIONS: list[tuple[str, int | str]] = [
    ("grpc.max_receive_message_length", _LARGEST),
    ("grpc.max_send_message_length", _LARGEST),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 20_000),
    # Some versions stop after two pings during a call without data, such as a long inspection.
    ("grpc.http2.max_pings_without_data", 0),
    # With grpc's default a restarted server could go unnoticed for longer than the retries last.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 2_000),
    ("grpc.primary_user_agent", f"gleaner-python/{version('gleaner-client')}"),
]

# Seconds without a connection after which its error is diagnosed.
_SILENCE = 2.0
# Seconds that the diagnosis may take.
_PROBE = 3.0


class Rpc:
    """A channel to one server. Methods are named `Service/Method`, of the package gleaner.v1."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint, self._metadata, self._timeout = endpoint, endpoint.metadata, endpoint.timeout
        self._channel = endpoint.channel(_OPTIONS)
        # Also at the program's end: an open channel that is still referenced then waits for its threads forever.
        self._closed = weakref.finalize(self, self._channel.close)
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

    @property
    def encrypted(self) -> bool:
        """Whether the connection is encrypted."""
        return self._endpoint.encrypted

    def _connect(self) -> None:
        """Waits until the channel is connected or has failed permanently."""
        states: queue.SimpleQueue[grpc.ChannelConnectivity] = queue.SimpleQueue()
        news = states.put
        self._channel.subscribe(news, try_to_connect=True)
        end = time.monotonic() + self._timeout
        try:
            while (left := end - time.monotonic()) > 0:
                try:
                    state = states.get(timeout=min(left, _SILENCE))
                except queue.Empty:
                    # grpc waits long for a server that stays silent because it expects TLS.
                    state = grpc.ChannelConnectivity.TRANSIENT_FAILURE
                if state is grpc.ChannelConnectivity.READY:
                    return
                if state is grpc.ChannelConnectivity.TRANSIENT_FAILURE:
                    self._raise_if_hopeless()
        finally:
            self._channel.unsubscribe(news)
        self._raise_if_hopeless()
        raise Unavailable(
            f"cannot reach {self._endpoint.target} within {self._timeout:g} s; is the server running there "
            "(gleaner-server serve)?"
        )

    def _raise_if_hopeless(self) -> None:
        problem = _handshake.problem(self._endpoint, min(self._timeout, _PROBE))
        if problem is not None:
            raise HandshakeFailed(f"cannot connect to {self._endpoint.target}: {problem}") from None

    def failure(self, error: grpc.RpcError) -> Rejected:
        """The exception for a failed call; with the diagnosis when the connection cannot be opened again."""
        failure = from_rpc(error)
        if isinstance(failure, Unavailable):
            try:
                self._raise_if_hopeless()
            except HandshakeFailed as hopeless:
                return hopeless
        return failure

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Converts the error of a failed call."""
        try:
            yield
        except grpc.RpcError as error:
            raise self.failure(error) from None

    def close(self) -> None:
        """Cancels every call and closes the connection."""
        self._closed()

    def unary(self, method: str, request: Message, reply: type[Reply], *, hurry: bool = True) -> Reply:
        """One request, one reply, once. Without `hurry` no time limit: the server responds or the connection breaks."""
        call = self._channel.unary_unary(_path(method), type(request).SerializeToString, reply.FromString)
        with self._translated():
            answer: Reply = call(request, timeout=self._timeout if hurry else None, metadata=self._metadata)
        return answer

    def safe(self, method: str, request: Message, reply: type[Reply]) -> Reply:
        """As `unary`, retried while there is no connection: only for calls that are safe to repeat."""
        return patiently(lambda: self.unary(method, request, reply))

    def upload(self, method: str, requests: Iterable[Message], reply: type[Reply]) -> Reply:
        """A stream of requests, one reply. No time limit: the server responds or the connection breaks.

        Raises what the requests raise.
        """
        failed: list[Exception] = []

        def outgoing() -> Iterator[Message]:
            # Another thread takes the requests: grpc would log their error there, and cancel the call.
            try:
                yield from requests
            except Exception as error:
                failed.append(error)
                raise

        call = self._channel.stream_unary(_path(method), _serialize, reply.FromString)
        try:
            with self._translated():
                answer: Reply = call(outgoing(), metadata=self._metadata)
        except Rejected:
            if failed:
                raise failed[0] from None
            raise
        return answer

    def stream(
        self, method: str, request: Message, reply: type[Reply], timeout: float | None = None
    ) -> Iterator[Reply]:
        """One request, a stream of replies. Dropping the iterator ends the call, as does `timeout` in seconds."""
        open_call = self._channel.unary_stream(_path(method), type(request).SerializeToString, reply.FromString)
        call: Any = open_call(request, timeout=timeout, metadata=self._metadata)
        try:
            with self._translated():
                yield from call
        finally:
            call.cancel()

    def converse(self, method: str, requests: Iterator[Message], reply: type[Reply]) -> Any:
        """A bidirectional stream: returns the call, to be read and cancelled."""
        return self._channel.stream_stream(_path(method), _serialize, reply.FromString)(
            requests, metadata=self._metadata
        )


def _serialize(request: Message) -> bytes:
    return request.SerializeToString()


def _path(method: str) -> str:
    service, name = method.split("/")
    return f"/gleaner.v1.{service}/{name}"
