"""A dataset as a PyTorch dataset with random access, and a loader that resumes. Only this module needs torch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

try:
    import torch
    from torch.utils.data import DataLoader, Dataset, Sampler
except ImportError as error:
    raise ImportError("torch_dataset needs PyTorch; install torch, or read client.datasets.stream") from error

from gleaner._segment_cache import SegmentCache
from gleaner.errors import invalid

Order = Literal["shuffled", "weighted", "sequential"]
ORDERS: tuple[Order, ...] = ("shuffled", "weighted", "sequential")


class SegmentDataset(Dataset):  # type: ignore[misc]
    """Weighted segments as dicts of tensors: proprioception, action, weight, expert, mask, images.*, depth.*.

    Items come from memory-mapped files, not from the server: workers of a `DataLoader` may be forked, and any sampler
    of PyTorch works. `weights` is what `WeightedRandomSampler` takes.
    """

    def __init__(self, cache: SegmentCache, *, steps: int | None) -> None:
        if steps is not None and steps < 1:
            raise invalid("steps", "must be at least 1, or None for segments of their own length")
        self.cache = cache
        self.steps = steps

    @property
    def weights(self) -> torch.Tensor:
        """The weight of each segment: 1 for experts, q for kept ones. A copy, which may be changed."""
        return torch.from_numpy(self.cache.weight.copy())

    def __len__(self) -> int:
        return len(self.cache)

    def __getitem__(self, at: int) -> dict[str, torch.Tensor]:
        if not -len(self) <= at < len(self):
            raise IndexError(f"segment {at} of {len(self)}")
        chosen = np.array([at % len(self)])
        found = self._gather(chosen, self.steps or int(self.cache.length[chosen[0]]))
        return {name: values[0] for name, values in found.items()}

    def batch(self, chosen: Sequence[int] | NDArray[np.int64]) -> dict[str, torch.Tensor]:
        """Several segments at once, `[segments, steps, …]`: faster than items that are collated afterwards."""
        if self.steps is None:
            raise invalid("steps", "segments have lengths of their own; give torch_dataset the steps of an item")
        return self._gather(np.asarray(chosen), self.steps)

    def _gather(self, chosen: NDArray[np.int64], steps: int) -> dict[str, torch.Tensor]:
        cache = self.cache
        # Column i of a row is step i of the item; earlier columns repeat the segment's first step.
        back = np.arange(steps - 1, -1, -1)
        length = cache.length[chosen, None]
        rows = cache.end_row[chosen, None] - np.minimum(back, length - 1)
        found = {name: _tensor(name, values[rows]) for name, values in cache.steps.items()}
        found["weight"] = torch.from_numpy(cache.weight[chosen])
        found["expert"] = torch.from_numpy(cache.expert[chosen])
        found["mask"] = torch.from_numpy(back < length)
        return found


def _tensor(name: str, values: NDArray[Any]) -> torch.Tensor:
    # Some operations of torch do not support unsigned 16-bit integers.
    return torch.from_numpy(values.astype(np.int32) if name.startswith("depth.") else values)


class SegmentLoader:
    """Batches of a dataset, epoch after epoch, in an order that a state of a few numbers restores.

    Iterating yields the rest of the current epoch; the next iteration yields the next one. `state_dict` names the batch
    that follows the last one taken, whatever workers have assembled ahead, and `load_state_dict` continues there.
    """

    def __init__(
        self,
        dataset: SegmentDataset,
        batch_size: int,
        *,
        order: Order = "shuffled",
        seed: int = 0,
        rank: int | None = None,
        ranks: int | None = None,
        drop_last: bool = False,
        **options: Any,
    ) -> None:
        """`order` is shuffled, weighted (drawn with replacement by weight: then the loss must not weigh again) or
        sequential.

        `rank` of `ranks` has its part of every epoch, by default those of `torch.distributed`; parts have equal
        numbers of batches, for which the first segments of an epoch may repeat. `drop_last` leaves out a smaller last
        batch. Other options are those of `DataLoader`, such as `num_workers` and `pin_memory`.
        """
        if batch_size < 1:
            raise invalid("batch_size", "must be at least 1")
        if order not in ORDERS:
            raise invalid("order", f"{order!r} is unknown; supported: {', '.join(ORDERS)}")
        if (rank is None) != (ranks is None):
            raise invalid("rank, ranks", "give both or neither")
        here, all_of_them = _rank() if rank is None or ranks is None else (rank, ranks)
        if not 0 <= here < all_of_them:
            raise invalid("rank", f"must be from 0 to {all_of_them - 1}, got {here}")
        if len(dataset) == 0:
            raise invalid("dataset", "has no segments")
        if dataset.steps is None:
            raise invalid("steps", "segments have lengths of their own; give torch_dataset the steps of an item")
        self.dataset = dataset
        self._plan = _Plan(
            dataset.cache.folder.name, len(dataset), batch_size, order, seed, here, all_of_them, drop_last
        )
        share = math.ceil(len(dataset) / all_of_them)
        self._batches = share // batch_size if drop_last else math.ceil(share / batch_size)
        if self._batches == 0:
            raise invalid("batch_size", f"{batch_size} is more than the {share} segments of a rank; set drop_last off")
        self._epoch, self._taken = 0, 0
        if options.get("num_workers", 0) > 0:
            options.setdefault("persistent_workers", True)
        self._loader = DataLoader(_Batches(dataset), batch_size=None, sampler=_Rest(self), **options)

    @property
    def epoch(self) -> int:
        """The current epoch, from 0."""
        return self._epoch

    def __len__(self) -> int:
        """The number of batches in an epoch."""
        return self._batches

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        self._turn()
        for batch in self._loader:
            self._taken += 1
            yield batch
        self._turn()

    def _turn(self) -> None:
        if self._taken >= self._batches:
            self._epoch, self._taken = self._epoch + 1, 0

    def state_dict(self) -> dict[str, Any]:
        """The place and what it depends on, as plain numbers and words."""
        return {**asdict(self._plan), "epoch": self._epoch, "taken": self._taken}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues where a state was taken. Raises `InvalidArgument` when this loader has another order."""
        for name, here in asdict(self._plan).items():
            if state.get(name) != here:
                raise invalid(
                    f"state.{name}", f"is {state.get(name)!r}, this loader has {here!r}; make it with the same"
                )
        self._epoch, self._taken = int(state["epoch"]), int(state["taken"])

    def rest(self) -> list[NDArray[np.int64]]:
        """The segments of each batch that is left of the current epoch."""
        plan = self._plan
        # All ranks draw the same order and take turns in it.
        chance = np.random.default_rng([plan.seed, self._epoch])
        match plan.order:
            case "shuffled":
                drawn = chance.permutation(plan.segments)
            case "weighted":
                weights = self.dataset.cache.weight.astype(np.float64)
                if not (total := weights.sum()) > 0:
                    raise invalid("order", "no segment has a weight above 0; use shuffled")
                drawn = chance.choice(plan.segments, plan.segments, p=weights / total)
            case _:
                drawn = np.arange(plan.segments)
        share = np.resize(drawn, math.ceil(plan.segments / plan.ranks) * plan.ranks)[plan.rank :: plan.ranks]
        size = plan.batch_size
        return [share[at * size : (at + 1) * size] for at in range(self._taken, self._batches)]


@dataclass(frozen=True)
class _Plan:
    """What the order of segments depends on."""

    dataset: str
    segments: int
    batch_size: int
    order: Order
    seed: int
    rank: int
    ranks: int
    drop_last: bool


class _Batches(Dataset):  # type: ignore[misc]
    """Items that are whole batches."""

    def __init__(self, dataset: SegmentDataset) -> None:
        self.dataset = dataset

    def __getitem__(self, chosen: NDArray[np.int64]) -> dict[str, torch.Tensor]:
        return self.dataset.batch(chosen)


class _Rest(Sampler):  # type: ignore[misc]
    """The rest of a loader's epoch at the time of its iteration."""

    def __init__(self, loader: SegmentLoader) -> None:
        self.loader = loader

    def __iter__(self) -> Iterator[NDArray[np.int64]]:
        return iter(self.loader.rest())

    def __len__(self) -> int:
        return len(self.loader)


def _rank() -> tuple[int, int]:
    distributed = torch.distributed
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1
