"""The exceptions of this package, made from gRPC statuses with the server's own message."""

from __future__ import annotations

from typing import TYPE_CHECKING

import grpc

from gleaner._printable import printable

if TYPE_CHECKING:
    from gleaner._proto.v1.job_pb2 import Job


class GleanerError(Exception):
    """The base of all exceptions of this package."""


class Rejected(GleanerError):
    """The server rejected the call. The text is the server's and names the fix; `code` is the gRPC status."""

    code = grpc.StatusCode.UNKNOWN

    def __init__(self, message: str, code: grpc.StatusCode | None = None) -> None:
        # Messages contain names from recordings, and tracebacks go to terminals.
        super().__init__(printable(message))
        if code is not None:
            self.code = code


class InvalidArgument(Rejected, ValueError):
    """A field of the request is invalid."""

    code = grpc.StatusCode.INVALID_ARGUMENT


class NotFound(Rejected, LookupError):
    """An object named by the request does not exist."""

    code = grpc.StatusCode.NOT_FOUND


class AlreadyExists(Rejected):
    """The object to create exists already."""

    code = grpc.StatusCode.ALREADY_EXISTS


class FailedPrecondition(Rejected):
    """The request is valid, but another step must come first."""

    code = grpc.StatusCode.FAILED_PRECONDITION


class ResourceExhausted(Rejected):
    """A limit is reached: a size, a queue."""

    code = grpc.StatusCode.RESOURCE_EXHAUSTED


class Unauthorized(Rejected, PermissionError):
    """The token is missing, invalid or lacks the role."""

    code = grpc.StatusCode.UNAUTHENTICATED


class DeadlineExceeded(Rejected, TimeoutError):
    """No answer within the time limit."""

    code = grpc.StatusCode.DEADLINE_EXCEEDED


class Unavailable(Rejected, ConnectionError):
    """The server is unreachable, the connection broke, or the server is stopping. A retry may succeed later."""

    code = grpc.StatusCode.UNAVAILABLE


class HandshakeFailed(Unavailable):
    """The handshake failed: one side does not trust the other, or only one encrypts. Retrying does not help."""


class Cancelled(Rejected):
    """The call was cancelled."""

    code = grpc.StatusCode.CANCELLED


class ServerError(Rejected):
    """An internal error of the server, for which see its log, or a damaged stored file, which the message names."""

    code = grpc.StatusCode.INTERNAL


class Missed(GleanerError):
    """The policy did not answer an observation by its deadline, and no earlier chunk covers its step."""


class Damaged(GleanerError):
    """Received bytes differ from the announced digest; fetch them again."""


class JobFailed(GleanerError):
    """A job ended without success; `job` is its final state."""

    def __init__(self, message: str, job: Job) -> None:
        super().__init__(message)
        self.job = job


_BY_CODE: dict[grpc.StatusCode, type[Rejected]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgument,
    grpc.StatusCode.OUT_OF_RANGE: InvalidArgument,
    grpc.StatusCode.NOT_FOUND: NotFound,
    grpc.StatusCode.ALREADY_EXISTS: AlreadyExists,
    grpc.StatusCode.FAILED_PRECONDITION: FailedPrecondition,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhausted,
    grpc.StatusCode.UNAUTHENTICATED: Unauthorized,
    grpc.StatusCode.PERMISSION_DENIED: Unauthorized,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceeded,
    grpc.StatusCode.UNAVAILABLE: Unavailable,
    grpc.StatusCode.CANCELLED: Cancelled,
    grpc.StatusCode.INTERNAL: ServerError,
    grpc.StatusCode.DATA_LOSS: ServerError,
}


def from_rpc(error: grpc.RpcError) -> Rejected:
    """The exception for a failed call."""
    if not isinstance(error, grpc.Call):
        return Rejected(str(error))
    code = error.code()
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return Rejected("the server does not know this call; is it older than this client?", code)
    return _BY_CODE.get(code, Rejected)(error.details() or f"the server rejected the call: {code.value[1]}", code)


def invalid(field: str, fix: str) -> InvalidArgument:
    """The exception for an invalid argument, in the server's format."""
    return InvalidArgument(f"{field}: {fix}")
