"""A dataset's segments on the local disk: each step once, however many windows contain it, in memory-mapped arrays.

Must not depend on torch. Needs a Unix-like system, for its lock.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gleaner.errors import Damaged, ResourceExhausted
from gleaner.observation import size
from gleaner.types import Dataset, TaskSpec

if TYPE_CHECKING:
    from gleaner.datasets import Datasets, Segment

# Changes with the layout of the files; folders of another layout are fetched again.
_LAYOUT = 1
# What is known of each segment.
_INDEX = np.dtype(
    [
        ("end_row", "<i8"),  # the row of its last step
        ("length", "<i8"),  # in steps, which are rows that follow each other
        ("weight", "<f4"),
        ("expert", "?"),
        ("episode", "<i8"),  # its place in `episodes`
        ("end_step", "<i8"),
    ]
)


class SegmentCache:
    """The arrays of a folder that `fetch` has written. A copy in another process maps the files again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        about = json.loads((folder / "about.json").read_text())
        self.rows: int = about["rows"]
        self.episodes: list[str] = about["episodes"]
        index = np.load(folder / "segments.npy")

        def column(name: str) -> NDArray[Any]:
            return np.ascontiguousarray(index[name])

        self.end_row: NDArray[np.int64] = column("end_row")
        self.length: NDArray[np.int64] = column("length")
        self.weight: NDArray[np.float32] = column("weight")
        self.expert: NDArray[np.bool_] = column("expert")
        self.episode: NDArray[np.int64] = column("episode")
        self.end_step: NDArray[np.int64] = column("end_step")
        self.steps = {name: self._mapped(name, *kind) for name, kind in about["arrays"].items()}

    def _mapped(self, name: str, kind: str, shape: list[int]) -> NDArray[Any]:
        path = self.folder / name
        expected = self.rows * int(np.prod(shape)) * np.dtype(kind).itemsize
        if (found := path.stat().st_size) != expected:
            raise Damaged(f"{path}: expected {expected} bytes, got {found}; delete {self.folder} and fetch it again")
        if expected == 0:
            # An empty file cannot be mapped.
            return np.empty((self.rows, *shape), kind)
        return np.memmap(path, kind, "r", shape=(self.rows, *shape))

    def __reduce__(self) -> tuple[type[SegmentCache], tuple[Path]]:
        return SegmentCache, (self.folder,)

    def __len__(self) -> int:
        return len(self.end_row)


def default_folder() -> Path:
    """Where caches are kept unless the caller names a folder: `gleaner/datasets` in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gleaner" / "datasets"


def fetch(
    datasets: Datasets,
    dataset_id: str,
    *,
    frames: bool,
    kept_only: bool,
    folder: Path,
    progress: Callable[[int, int], object],
) -> SegmentCache:
    """The cache of a dataset in `folder`, fetched if it is not there; processes that ask at once fetch it once.

    Raises `ResourceExhausted` when the disk has no room for it, and as `Datasets.stream`.
    """
    dataset = datasets.get(dataset_id)
    marks = ["frames"] * frames + ["kept"] * kept_only
    place = folder / "-".join([dataset.id, *marks])
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    with _locked(place.with_name(f"{place.name}.lock")):
        if not _complete(place):
            _write(datasets, dataset, place, frames=frames, kept_only=kept_only, progress=progress)
    return SegmentCache(place)


def _complete(place: Path) -> bool:
    try:
        layout = json.loads((place / "about.json").read_text())["layout"]
    except (OSError, ValueError, KeyError):
        return False
    return bool(layout == _LAYOUT)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _write(
    datasets: Datasets,
    dataset: Dataset,
    place: Path,
    *,
    frames: bool,
    kept_only: bool,
    progress: Callable[[int, int], object],
) -> None:
    """Fetches into a folder beside `place`, which appears only complete."""
    spec = datasets.task_of(dataset)
    segments = dataset.kept_segments + (0 if kept_only else dataset.expert_segments)
    part = place.with_name(f"{place.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        # Each segment ends at a step of its own.
        least = segments * sum(array.bytes_per_step for array in _arrays(spec, frames))
        if (free := shutil.disk_usage(part).free) < least:
            raise ResourceExhausted(
                f"cache: {part.parent} has {free >> 20} MiB free, the dataset takes at least {least >> 20} MiB; "
                "name a folder on another disk"
            )
        with ExitStack() as stack:
            writer = _Writer(part, spec, frames, stack)
            for done, segment in enumerate(datasets.stream(dataset.id, frames=frames, kept_only=kept_only), 1):
                writer.add(segment)
                progress(done, segments)
        writer.finish()
        shutil.rmtree(place, ignore_errors=True)
        part.replace(place)
    finally:
        shutil.rmtree(part, ignore_errors=True)


@dataclass(frozen=True)
class _Array:
    """One array of all steps, and the part of a segment that goes into it."""

    name: str
    kind: str
    shape: tuple[int, ...]

    @property
    def bytes_per_step(self) -> int:
        return int(np.prod(self.shape)) * np.dtype(self.kind).itemsize

    def rows(self, segment: Segment) -> NDArray[Any]:
        group, _, camera = self.name.partition(".")
        values = getattr(segment, group)
        found: NDArray[Any] = values[camera] if camera else values
        return found


def _arrays(spec: TaskSpec, frames: bool) -> list[_Array]:
    arrays = [
        _Array("proprioception", "<f4", (size(spec.proprioception),)),
        _Array("action", "<f4", (size(spec.action),)),
    ]
    for camera in spec.cameras if frames else ():
        pixels = (camera.height, camera.width)
        arrays.append(_Array(f"images.{camera.name}", "|u1", (*pixels, 3)))
        if camera.depth:
            arrays.append(_Array(f"depth.{camera.name}", "<u2", pixels))
    return arrays


class _Writer:
    """Appends the steps that no earlier segment had."""

    def __init__(self, folder: Path, spec: TaskSpec, frames: bool, stack: ExitStack) -> None:
        self.folder, self.rows, self.last = folder, 0, -1
        self.arrays = _arrays(spec, frames)
        self.files: list[BinaryIO] = [stack.enter_context((folder / array.name).open("wb")) for array in self.arrays]
        self.episodes: list[str] = []
        self.index: list[tuple[int, int, float, bool, int, int]] = []

    def add(self, segment: Segment) -> None:
        """Segments come episode by episode, each by its end: the steps of a window are rows that follow each other."""
        if not self.episodes or self.episodes[-1] != segment.episode_id:
            self.episodes.append(segment.episode_id)
            self.last = -1
        new = max(segment.first_step, self.last + 1) - segment.first_step
        for array, file in zip(self.arrays, self.files, strict=True):
            file.write(np.ascontiguousarray(array.rows(segment)[new:], array.kind).data)
        self.rows += len(segment.action) - new
        self.last = max(self.last, segment.end_step)
        end_row = self.rows - 1 - (self.last - segment.end_step)
        expert = segment.role == "expert"
        episode = len(self.episodes) - 1
        self.index.append((end_row, len(segment.action), segment.weight, expert, episode, segment.end_step))

    def finish(self) -> None:
        np.save(self.folder / "segments.npy", np.array(self.index, _INDEX))
        arrays = {array.name: [array.kind, array.shape] for array in self.arrays}
        about = {"layout": _LAYOUT, "rows": self.rows, "episodes": self.episodes, "arrays": arrays}
        (self.folder / "about.json").write_text(json.dumps(about))
