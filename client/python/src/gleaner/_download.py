"""Download: a file appears only complete and with the expected digest."""

from __future__ import annotations

import math
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from http.client import HTTPException
from itertools import chain
from pathlib import Path
from typing import Protocol
from urllib.request import HTTPErrorProcessor, build_opener

from blake3 import blake3

from gleaner._upload import digest
from gleaner.errors import Damaged

# Seconds without a byte from the bucket after which the server is asked.
_SILENCE = 10.0
_PIECE = 1 << 20
# Seconds after a failure for which the server is asked at once: a bucket of another network costs a silence each time.
_REST = 300.0


class Reply(Protocol):
    """A message of a download: the next bytes, or the URL of all of them in the server's bucket."""

    data: bytes
    url: str


class Expected(Protocol):
    """What a file must be: an episode, or a file of an export."""

    blake3: str  # hex
    size_bytes: int  # more bytes are not read


class Downloads:
    """Files of one server: from its bucket where it gives a URL and the bucket can be reached, or else through it."""

    def __init__(self, *, encrypted: bool = False, rest: float = _REST) -> None:
        """`encrypted`: the server is reached by TLS, so that what its bucket sends must be encrypted too."""
        self._schemes = ("https://",) if encrypted else ("http://", "https://")
        self._rest, self._closed_until = rest, -math.inf

    def save(
        self, start: Callable[[bool], Iterable[Reply]], path: Path, expected: Expected, *, replace: bool = True
    ) -> Path:
        """Saves what `start` begins to download, given whether a URL is accepted. Raises as `save` does."""
        keep = partial(save, path=path, expected=expected, replace=replace)
        replies = iter(start(time.monotonic() >= self._closed_until))
        first = next(replies, None)
        if first is None:
            return keep(())
        if not first.url:
            return keep(reply.data for reply in chain((first,), replies))
        with suppress(_Unread, Damaged):
            return keep(_pieces(first.url, self._schemes))
        self._closed_until = time.monotonic() + self._rest
        return keep(reply.data for reply in start(False))


class _Unread(Exception):
    """The bucket did not give the file."""


class _NoRedirects(HTTPErrorProcessor):
    """A signed URL is of its host alone."""

    def http_response(self, request, response):  # type: ignore[no-untyped-def]
        """Lets a whole file pass."""
        if response.status != HTTPStatus.OK:
            raise _Unread
        return response

    https_response = http_response


def _pieces(url: str, schemes: tuple[str, ...]) -> Iterator[bytes]:
    """The bytes at a URL. Raises `_Unread`, without the URL, which is a secret."""
    if not url.startswith(schemes):
        raise _Unread
    try:
        with build_opener(_NoRedirects).open(url, timeout=_SILENCE) as response:
            while piece := response.read(_PIECE):
                yield piece
    except (OSError, HTTPException, ValueError):
        raise _Unread from None


def inside(folder: Path, name: str, otherwise: str) -> Path:
    """A path in a folder for a received name, which must not lead out of it."""
    last = Path(name).name
    return folder / (otherwise if last in ("", "..") else last)


def below(folder: Path, name: str) -> Path:
    """A path below a folder for a received name, which may have folders. Raises `Damaged` when it leads out of it."""
    parts = name.split("/")
    if any(part in ("", ".", "..") or "\0" in part for part in parts):
        raise Damaged(f"the export contains a file named {name!r}, which is outside the folder; it was not written")
    return folder.joinpath(*parts)


def part_name() -> str:
    """The name of a file or folder until it is complete: a new one for each download, which may have the same path."""
    return f".gleaner-{secrets.token_hex(8)}.part"


def holds(path: Path, expected: Expected) -> bool:
    """Whether the expected file is at a path. Raises `FileExistsError` when another one is there."""
    if not os.path.lexists(path):
        return False
    if path.is_file() and path.stat().st_size == expected.size_bytes and digest(path) == expected.blake3:
        return True
    raise FileExistsError(f"{path} exists with another content; name a new file in place of the folder")


def save(pieces: Iterable[bytes], path: Path, expected: Expected, *, replace: bool = True) -> Path:
    """Writes the pieces to a file. Raises `Damaged` when their BLAKE3 is not the expected one.

    Without `replace` a file that is there stays. Raises `FileExistsError` when it is another one.
    """
    part, left = path.with_name(part_name()), expected.size_bytes
    hasher = blake3()
    try:
        with part.open("xb") as file:
            for piece in pieces:
                hasher.update(piece)
                left -= len(piece)
                if left < 0:
                    break
                file.write(piece)
        found = hasher.hexdigest()
        if found != expected.blake3:
            wanted = f"expected BLAKE3 {expected.blake3}, got {found}"
            raise Damaged(f"{path}: {wanted}; the file is damaged, download it again")
        if replace:
            part.replace(path)
        else:
            _publish(part, path, expected)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()
    return path


def _publish(part: Path, path: Path, expected: Expected) -> None:
    # A link fails where a file is already, also one that came during the download; a disk may not have links at all.
    with suppress(OSError):
        os.link(part, path)
        return
    if not holds(path, expected):
        part.replace(path)
