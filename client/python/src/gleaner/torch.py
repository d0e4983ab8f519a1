"""A dataset as a PyTorch `IterableDataset`. Only this module of the package needs torch."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np

try:
    import torch
    from torch.utils.data import IterableDataset, get_worker_info
except ImportError as error:
    raise ImportError("torch_dataset needs PyTorch; install torch, or read client.datasets.stream") from error

from gleaner._client import Client
from gleaner._endpoint import Endpoint
from gleaner.datasets import Segment


class SegmentDataset(IterableDataset):  # type: ignore[misc]
    """Weighted segments as dicts of tensors: proprioception, action, weight, expert, mask, images.*, depth.*.

    Each worker of a `DataLoader` has its own connection and yields every n-th segment, so that together they yield
    each once. Where `torch.distributed` runs, its ranks share them out likewise. gRPC does not survive a fork:
    with workers, give the loader `multiprocessing_context="spawn"`.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        dataset_id: str,
        *,
        steps: int | None,
        frames: bool,
        kept_only: bool,
    ) -> None:
        if steps is not None and steps < 1:
            raise ValueError("steps: must be at least 1, or None for segments of their own length")
        self._endpoint = endpoint
        self._dataset_id = dataset_id
        self._steps = steps
        self._wanted = {"frames": frames, "kept_only": kept_only}
        # Workers do not have the ranks, so they are read here, in the process that creates the loader.
        self._rank, self._ranks = _rank()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        info = get_worker_info()
        worker, workers = (0, 1) if info is None else (info.id, info.num_workers)
        share, shares = self._rank * workers + worker, self._ranks * workers
        with Client(self._endpoint) as client:
            segments = client.datasets.stream(self._dataset_id, **self._wanted)
            for segment in islice(segments, share, None, shares):
                yield self._item(segment)

    def _item(self, segment: Segment) -> dict[str, Any]:
        have = len(segment.action)
        steps = self._steps or have
        # Row i of the item is this step of the segment; earlier rows repeat the first.
        rows = np.arange(have - steps, have)
        mask, rows = rows >= 0, np.maximum(rows, 0)
        item = {
            "proprioception": torch.from_numpy(segment.proprioception[rows]),
            "action": torch.from_numpy(segment.action[rows]),
            "weight": torch.tensor(segment.weight, dtype=torch.float32),
            "expert": torch.tensor(segment.role == "expert"),
            "mask": torch.from_numpy(mask),
        }
        for camera, images in segment.images.items():
            item[f"images.{camera}"] = torch.from_numpy(images[rows])
        for camera, depth in segment.depth.items():
            # Some operations of torch do not support unsigned 16-bit integers.
            item[f"depth.{camera}"] = torch.from_numpy(depth[rows].astype(np.int32))
        return item


def _rank() -> tuple[int, int]:
    distributed = torch.distributed
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1
