"""What can go wrong: one tree of exceptions, made from gRPC statuses, that keeps the server's own message."""

from __future__ import annotations

from typing import TYPE_CHECKING

import grpc

from gleaner._printable import printable

if TYPE_CHECKING:
    from gleaner._proto.v1.job_pb2 import Job


class GleanerError(Exception):
    """Anything that this package raises on purpose."""


class Rejected(GleanerError):
    """The server said no. The text is the server's and names the mend; `code` is the gRPC status."""

    code = grpc.StatusCode.UNKNOWN

    def __init__(self, message: str, code: grpc.StatusCode | None = None) -> None:
        # Servers repeat names from recordings, and tracebacks go to terminals.
        super().__init__(printable(message))
        if code is not None:
            self.code = code


class InvalidArgument(Rejected, ValueError):
    """A field of the request is wrong."""

    code = grpc.StatusCode.INVALID_ARGUMENT


class NotFound(Rejected, LookupError):
    """What the request names is not there."""

    code = grpc.StatusCode.NOT_FOUND


class AlreadyExists(Rejected):
    """What the request would make is there already."""

    code = grpc.StatusCode.ALREADY_EXISTS


class FailedPrecondition(Rejected):
    """The request is right, but something else must come first."""

    code = grpc.StatusCode.FAILED_PRECONDITION


class ResourceExhausted(Rejected):
    """A limit is reached: a size, a queue."""

    code = grpc.StatusCode.RESOURCE_EXHAUSTED


class Unauthorized(Rejected, PermissionError):
    """The token is missing, wrong or not enough."""

    code = grpc.StatusCode.UNAUTHENTICATED


class DeadlineExceeded(Rejected, TimeoutError):
    """No answer within the time allowed."""

    code = grpc.StatusCode.DEADLINE_EXCEEDED


class Unavailable(Rejected, ConnectionError):
    """No server there, the connection broke, or the server is stopping. The same call may succeed later."""

    code = grpc.StatusCode.UNAVAILABLE


class HandshakeFailed(Unavailable):
    """Server and client cannot talk: one does not trust the other, or only one encrypts. Retrying does not help."""


class Cancelled(Rejected):
    """The call was given up."""

    code = grpc.StatusCode.CANCELLED


class ServerError(Rejected):
    """Something went wrong in the server; its log tells more."""

    code = grpc.StatusCode.INTERNAL


class Missed(GleanerError):
    """The policy could not answer an observation by its deadline, and no earlier chunk covers its step."""


class Damaged(GleanerError):
    """What arrived is not what was promised; fetch it again."""


class JobFailed(GleanerError):
    """A job ended without success; `job` is how it ended."""

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
    return _BY_CODE.get(code, Rejected)(error.details() or f"the server refused: {code.value[1]}", code)


def invalid(field: str, mend: str) -> InvalidArgument:
    """Something the caller gave that cannot be used; said the way the server says it."""
    return InvalidArgument(f"{field}: {mend}")
