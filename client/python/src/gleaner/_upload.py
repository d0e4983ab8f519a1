"""Upload: one recording to the server, hashed, in pieces, resumed when the connection breaks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from blake3 import blake3

from gleaner._printable import printable
from gleaner._proto.v1 import episode_pb2 as pb
from gleaner._retry import Patience
from gleaner._rpc import Rpc
from gleaner.errors import InvalidArgument, NotFound, Unavailable, invalid
from gleaner.types import Episode

# Half of the server's message limit.
_PIECE = 1 << 20
_LONGEST_NAME = 255


def digest(path: Path) -> str:
    """A file's BLAKE3, hex."""
    hasher = blake3(max_threads=blake3.AUTO)
    with path.open("rb") as file:
        while piece := file.read(8 << 20):
            hasher.update(piece)
    return hasher.hexdigest()


def regular(path: Path) -> Path:
    """The path, if it is a regular file. Reading a FIFO, for example, could block without a limit."""
    if path.exists() and not path.is_file():
        raise invalid(str(path), "is not a regular file; only regular files can be sent")
    return path


def name_to_send(path: Path) -> str:
    """A file's name within the server's rules: without control characters, at most 255 bytes."""
    return printable(path.name, kept="").encode()[:_LONGEST_NAME].decode(errors="ignore")


@dataclass
class Upload:
    """The upload of one recording."""

    rpc: Rpc
    path: Path
    start: pb.StartUploadRequest
    progress: Callable[[int], object]
    upload_id: str = ""
    committed: int = 0

    def run(self) -> Episode:
        """Uploads until the server holds the episode or the retries are exhausted."""
        patience = Patience()
        while True:
            before = self.committed
            try:
                episode = self._advance()
            except Unavailable as error:
                patience.wait(error)
            except NotFound as error:
                # Not found: an earlier finish succeeded and only its answer was lost, or the server removed
                # the upload. Reopening finds the episode or starts again.
                if not self.upload_id:
                    raise
                self.upload_id = ""
                patience.wait(error)
            else:
                if episode is not None:
                    return episode
                if self.committed > before:
                    patience.restore()

    def _advance(self) -> Episode | None:
        started = self._open()
        if started is not None:
            return started
        if self.committed < self.start.size_bytes:
            self._write()
            return None
        request = pb.FinishUploadRequest(upload_id=self.upload_id)
        # The server inspects the whole recording before it answers.
        return self.rpc.unary("EpisodeService/FinishUpload", request, pb.FinishUploadResponse, hurry=False).episode

    def _open(self) -> Episode | None:
        if self.upload_id:
            request = pb.GetUploadRequest(upload_id=self.upload_id)
            self.committed = self.rpc.unary("EpisodeService/GetUpload", request, pb.GetUploadResponse).committed_size
            return None
        reply = self.rpc.unary("EpisodeService/StartUpload", self.start, pb.StartUploadResponse)
        self.upload_id, self.committed = reply.upload_id, reply.committed_size
        return reply.existing if reply.HasField("existing") else None

    def _write(self) -> None:
        before = self.committed
        try:
            reply = self.rpc.upload("EpisodeService/WriteUpload", self._pieces(), pb.WriteUploadResponse)
        except InvalidArgument as error:
            # An older stream of this client may still have been written when this one began.
            raise Unavailable(str(error), error.code) from error
        if reply.committed_size <= before:
            problem = "the file was truncated during the upload; push it again once it is complete"
            raise invalid(str(self.path), problem)
        self.committed = reply.committed_size

    def _pieces(self) -> Iterator[pb.WriteUploadRequest]:
        offset = self.committed
        with self.path.open("rb") as file:
            file.seek(offset)
            while piece := file.read(min(_PIECE, self.start.size_bytes - offset)):
                yield pb.WriteUploadRequest(upload_id=self.upload_id, offset=offset, data=piece)
                offset += len(piece)
                self.progress(offset)
