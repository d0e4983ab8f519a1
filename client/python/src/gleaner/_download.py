"""Download: a file appears only complete and with the expected digest."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from blake3 import blake3

from gleaner.errors import Damaged


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


def save(pieces: Iterable[bytes], path: Path, expected: str) -> Path:
    """Writes the pieces to a file. Raises `Damaged` when their BLAKE3 (hex) is not the expected one."""
    part = path.with_name(f"{path.name}.{expected[:16]}.part")
    hasher = blake3()
    try:
        with part.open("wb") as file:
            for piece in pieces:
                hasher.update(piece)
                file.write(piece)
        found = hasher.hexdigest()
        if found != expected:
            raise Damaged(f"{path}: expected BLAKE3 {expected}, got {found}; the file is damaged, download it again")
        part.replace(path)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()
    return path
