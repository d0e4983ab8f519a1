"""Tables of scores made elsewhere: the q of each episode, in the order of its steps. Independent of services."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

# Values in one message of several episodes: 1 MiB.
_BATCH = (1 << 20) // 8

COLUMNS = ("episode", "step", "q")


class Table(Protocol):
    """Columns by name: a dict of lists or arrays, a pandas DataFrame or a pyarrow Table."""

    def __getitem__(self, name: str, /) -> Any: ...


def by_episode(table: Table) -> dict[str, NDArray[np.float64]]:
    """Groups the rows of a table with the columns episode, step and q by episode; the rows may be in any order."""
    episode, step, q = (_column(table, name) for name in COLUMNS)
    if not len(episode) == len(step) == len(q):
        raise ValueError(
            f"episode, step, q: have {len(episode)}, {len(step)} and {len(q)} values; give as many of each"
        )
    if not len(episode):
        raise ValueError("episode, step, q: have no rows; give the q of every step")
    names, place = np.unique(episode.astype(np.str_), return_inverse=True)
    steps = step.astype(np.int64)
    if (steps != step).any():
        raise ValueError(f"step: {step[steps != step][0]} is not a whole number; count steps from 0")
    order = np.lexsort((steps, place))
    counts = np.bincount(place, minlength=len(names))
    values = np.split(q.astype(np.float64)[order], np.cumsum(counts)[:-1])
    for name, found in zip(names, np.split(steps[order], np.cumsum(counts)[:-1]), strict=True):
        _expect_all(str(name), found)
    return {str(name): of for name, of in zip(names, values, strict=True)}


def batches(episodes: Mapping[str, NDArray[np.float64]]) -> Iterator[dict[str, NDArray[np.float64]]]:
    """The episodes in groups of limited size; a longer episode is a group of its own."""
    group: dict[str, NDArray[np.float64]] = {}
    size = 0
    for name, q in episodes.items():
        if group and size + len(q) > _BATCH:
            yield group
            group, size = {}, 0
        group[name] = q
        size += len(q)
    if group:
        yield group


def _column(table: Table, name: str) -> NDArray[Any]:
    try:
        return np.asarray(table[name])
    except KeyError:
        raise ValueError(f"column {name!r} is missing; a table of scores has {', '.join(COLUMNS)}") from None


def _expect_all(episode: str, steps: NDArray[np.int64]) -> None:
    wrong = np.flatnonzero(steps != np.arange(len(steps)))
    if len(wrong) == 0:
        return
    at = int(wrong[0])
    if steps[at] < at:
        raise ValueError(f"step {steps[at]} of {episode} is listed twice or negative; keep one row for each step")
    raise ValueError(f"step {at} of {episode} is missing; give every step, counted from 0")
