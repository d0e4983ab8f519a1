"""Datasets: a score run and a selection, as a stream of weighted segments."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gleaner._download import Downloads, below, part_name
from gleaner._messages import build, word
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import dataset_pb2 as pb
from gleaner._proto.v1 import task_pb2
from gleaner._proto.v1.selection_pb2 import Selection
from gleaner._rpc import Rpc
from gleaner.errors import invalid
from gleaner.types import Dataset, ExportFile, TaskSpec

if TYPE_CHECKING:
    from gleaner.torch import SegmentDataset


@dataclass(frozen=True)
class Segment:
    """The window of at most l + 1 steps that ends at `end_step`; shorter at an episode's beginning."""

    episode_id: str
    first_step: int
    end_step: int  # inclusive
    role: str  # expert or imperfect
    weight: float  # 1 for experts, q for kept segments
    proprioception: NDArray[np.float32]  # steps × values
    action: NDArray[np.float32]  # steps × values
    images: dict[str, NDArray[np.uint8]] = field(default_factory=dict)  # camera → steps × height × width × RGB
    depth: dict[str, NDArray[np.uint16]] = field(default_factory=dict)  # camera → steps × height × width, mm


class Datasets:
    """`client.datasets`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc, self._downloads = rpc, Downloads(encrypted=rpc.encrypted)

    def create(
        self,
        run: str,
        *,
        beta: float | None = None,
        top_fraction: float | None = None,
        shape: Mapping[str, Any] | None = None,
    ) -> Dataset:
        """Creates a dataset: a run's experts, and the imperfect segments with q > β or the best part of them.

        Give at most one of `beta` and `top_fraction`; without either, the run's `default_beta` holds. `shape` is like
        `{"min_run": 5, "max_per_phase": 200}`; its names are those of the message `SelectionShape`. The same arguments
        return the same dataset.
        """
        if beta is not None and top_fraction is not None:
            raise ValueError("beta, top_fraction: give one of the two")
        selection = build(Selection, {"beta": beta, "top_fraction": top_fraction, "shape": shape})
        request = pb.CreateDatasetRequest(score_run_id=run, selection=selection)
        return self._rpc.safe("DatasetService/CreateDataset", request, pb.CreateDatasetResponse).dataset

    def get(self, dataset_id: str) -> Dataset:
        """Returns a dataset; its counts are set once its score run is finished."""
        request = pb.GetDatasetRequest(dataset_id=dataset_id)
        return self._rpc.safe("DatasetService/GetDataset", request, pb.GetDatasetResponse).dataset

    def task_of(self, dataset: Dataset) -> TaskSpec:
        """The specification of a dataset's task."""
        task = task_pb2.GetTaskRequest(task=dataset.task_id)
        return self._rpc.safe("TaskService/GetTask", task, task_pb2.GetTaskResponse).task.spec

    def stream(self, dataset_id: str, *, frames: bool = False, kept_only: bool = False) -> Iterator[Segment]:
        """Every segment with its weight, experts first; with `frames` the cameras' images too.

        `kept_only` leaves the experts out. A connection that breaks ends the stream with `Unavailable`.
        """
        spec = self.task_of(self.get(dataset_id))
        request = pb.StreamSegmentsRequest(dataset_id=dataset_id, include_frames=frames, kept_only=kept_only)
        for reply in self._rpc.stream("DatasetService/StreamSegments", request, pb.StreamSegmentsResponse):
            yield _segment(reply.segment, spec)

    def torch_dataset(
        self,
        dataset_id: str,
        *,
        steps: int | None = None,
        frames: bool = False,
        kept_only: bool = False,
        cache: str | os.PathLike[str] | None = None,
        progress: Callable[[int, int], object] = lambda done, total: None,
    ) -> SegmentDataset:
        """The same segments as a PyTorch dataset with random access; `gleaner.torch.SegmentLoader` makes its batches.

        The first use fetches them into a folder of `cache`, each step once and with `frames` uncompressed; later uses
        and other processes read it from there. Without `cache` it is the user's (`$XDG_CACHE_HOME/gleaner/datasets`).
        `progress` is called with the segments fetched so far and their number.

        With `steps` every item has this many: steps before an episode's beginning repeat its first step, and
        `mask` is false there; batches need that. Needs `torch`. Raises `ResourceExhausted` when the disk has no room.
        """
        from gleaner._segment_cache import default_folder, fetch
        from gleaner.torch import SegmentDataset

        folder = default_folder() if cache is None else Path(cache)
        found = fetch(self, dataset_id, frames=frames, kept_only=kept_only, folder=folder, progress=progress)
        return SegmentDataset(found, steps=steps)

    def export_files(self, export_id: str) -> Sequence[ExportFile]:
        """The files of a finished export; `client.jobs.submit` makes one. Raises `FailedPrecondition` before, and
        once the server no longer keeps them (`--keep-exports-days`).
        """
        request = pb.ListExportFilesRequest(export_id=export_id, page_size=PAGE)
        found = pages(self._rpc, "DatasetService/ListExportFiles", request, pb.ListExportFilesResponse)
        return [file for page in found for file in page.files]

    def download_export(self, export_id: str, folder: str | os.PathLike[str]) -> Sequence[Path]:
        """Fetches every file of a finished export into a folder, which must be new or empty.

        Files appear in it once all of them are there. Raises `InvalidArgument` when it has files
        already, since readers would take those for a part of the export, and `Damaged` when a digest differs.
        """
        folder = Path(folder).resolve()
        if folder.exists() and not (folder.is_dir() and next(folder.iterdir(), None) is None):
            raise invalid("folder", f"{folder} is not an empty folder; name a new one, or empty it first")
        files = self.export_files(export_id)
        # In a folder that exists, because it may be a mount, out of which nothing can be renamed.
        part = (folder if folder.exists() else folder.parent) / part_name()
        part.mkdir(parents=True)
        try:
            found = [self._download(export_id, file, part) for file in files]
            folder.mkdir(exist_ok=True)
            for entry in part.iterdir():
                entry.replace(folder / entry.name)
        finally:
            shutil.rmtree(part, ignore_errors=True)
        return [folder / path.relative_to(part) for path in found]

    def _download(self, export_id: str, file: ExportFile, folder: Path) -> Path:
        def start(accept_url: bool) -> Iterator[pb.DownloadExportFileResponse]:
            request = pb.DownloadExportFileRequest(export_id=export_id, name=file.name, accept_url=accept_url)
            return self._rpc.stream("DatasetService/DownloadExportFile", request, pb.DownloadExportFileResponse)

        path = below(folder, file.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        return self._downloads.save(start, path, file)

    def list(self, task: str) -> list[Dataset]:
        """A task's datasets, newest first."""
        request = pb.ListDatasetsRequest(task=task, page_size=PAGE)
        found = pages(self._rpc, "DatasetService/ListDatasets", request, pb.ListDatasetsResponse)
        return [dataset for page in found for dataset in page.datasets]


def _segment(segment: pb.Segment, spec: TaskSpec) -> Segment:
    steps = segment.end_step - segment.first_step + 1
    images, depth = _frames(segment.frames, spec, steps) if segment.frames else ({}, {})
    return Segment(
        episode_id=segment.episode_id,
        first_step=segment.first_step,
        end_step=segment.end_step,
        role=word(segment, "role"),
        weight=segment.weight,
        proprioception=np.array(segment.proprioception, np.float32).reshape(steps, -1),
        action=np.array(segment.action, np.float32).reshape(steps, -1),
        images=images,
        depth=depth,
    )


def _frames(
    data: bytes, spec: TaskSpec, steps: int
) -> tuple[dict[str, NDArray[np.uint8]], dict[str, NDArray[np.uint16]]]:
    rows = np.frombuffer(data, np.uint8).reshape(steps, -1)
    images: dict[str, NDArray[np.uint8]] = {}
    depth: dict[str, NDArray[np.uint16]] = {}
    at = 0
    for camera in spec.cameras:
        size = (steps, camera.height, camera.width)
        pixels = camera.height * camera.width
        # Copies, so that the arrays are writable.
        images[camera.name] = rows[:, at : at + 3 * pixels].reshape(*size, 3).copy()
        at += 3 * pixels
        if camera.depth:
            depth[camera.name] = rows[:, at : at + 2 * pixels].copy().view("<u2").reshape(size)
            at += 2 * pixels
    return images, depth
