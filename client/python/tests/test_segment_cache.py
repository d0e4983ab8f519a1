"""The cache of a dataset's segments on the disk, without torch."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gleaner
from conftest import Lab
from gleaner._segment_cache import SegmentCache, fetch
from gleaner.datasets import Segment, _frames
from gleaner.types import Dataset, TaskSpec


def cached(client: gleaner.Client, dataset: str, folder: Path, *, kept_only: bool = False) -> SegmentCache:
    """The cache of a dataset with its pictures."""
    return fetch(
        client.datasets, dataset, frames=True, kept_only=kept_only, folder=folder, progress=lambda done, total: None
    )


@pytest.mark.parametrize("kept_only", [False, True])
def test_windows_of_the_cache_are_the_segments_of_the_stream(
    client: gleaner.Client, lab: Lab, tmp_path: Path, kept_only: bool
) -> None:
    cache = cached(client, lab.dataset, tmp_path, kept_only=kept_only)
    segments = list(client.datasets.stream(lab.dataset, frames=True, kept_only=kept_only))
    assert len(cache) == len(segments) > 0
    for at, segment in enumerate(segments):
        rows = slice(cache.end_row[at] + 1 - cache.length[at], cache.end_row[at] + 1)
        np.testing.assert_array_equal(cache.steps["action"][rows], segment.action)
        np.testing.assert_array_equal(cache.steps["proprioception"][rows], segment.proprioception)
        for camera, images in segment.images.items():
            np.testing.assert_array_equal(cache.steps[f"images.{camera}"][rows], images)
        for camera, depth in segment.depth.items():
            np.testing.assert_array_equal(cache.steps[f"depth.{camera}"][rows], depth)
        assert cache.episodes[cache.episode[at]] == segment.episode_id
        assert (cache.end_step[at], cache.expert[at]) == (segment.end_step, segment.role == "expert")
        assert cache.weight[at] == np.float32(segment.weight)


class Offline:
    """Datasets of one task without a server."""

    def __init__(self, segments: list[Segment], values: int) -> None:
        self.segments = segments
        self.spec = TaskSpec(proprioception=[{"name": "arm", "size": values}] if values else [])
        self.spec.action.add(name="command", size=2)

    def get(self, dataset: str) -> Dataset:
        return Dataset(id=dataset, kept_segments=len(self.segments))

    def task_of(self, dataset: Dataset) -> TaskSpec:
        return self.spec

    def stream(self, dataset: str, *, frames: bool, kept_only: bool) -> Iterator[Segment]:
        yield from self.segments


@pytest.mark.parametrize(("segments", "values"), [(1, 0), (0, 3), (0, 0)])
def test_what_is_empty_is_an_empty_array(tmp_path: Path, segments: int, values: int) -> None:
    proprioception, action = np.zeros((4, values), np.float32), np.ones((4, 2), np.float32)
    segment = Segment("ep_1", 0, 3, "imperfect", 1.0, proprioception, action)
    datasets: Any = Offline([segment] * segments, values)
    cache = fetch(datasets, "ds_1", frames=False, kept_only=True, folder=tmp_path, progress=lambda done, total: None)
    for again in (cache, pickle.loads(pickle.dumps(cache))):
        assert (len(again), again.rows) == (segments, 4 * segments)
        for name, size in {"proprioception": values, "action": 2}.items():
            assert (again.steps[name].shape, again.steps[name].dtype) == ((4 * segments, size), np.float32)


@pytest.mark.parametrize("steps", [1, 2])
def test_pictures_of_any_number_of_steps_are_writable(steps: int) -> None:
    spec = TaskSpec(cameras=[{"name": "top", "height": 1, "width": 2, "depth": True}])
    images, depth = _frames(bytes(range(10)) * steps, spec, steps)
    assert (images["top"].shape, depth["top"].tolist()) == ((steps, 1, 2, 3), [[[7 << 8 | 6, 9 << 8 | 8]]] * steps)
    assert all(array.flags.writeable for array in (images["top"], depth["top"]))


def test_a_step_is_stored_once(client: gleaner.Client, lab: Lab, tmp_path: Path) -> None:
    cache = cached(client, lab.dataset, tmp_path)
    segments = client.datasets.stream(lab.dataset)
    steps = {(one.episode_id, step) for one in segments for step in range(one.first_step, one.end_step + 1)}
    assert cache.rows == len(steps)
    assert (cache.folder / "action").stat().st_size == len(steps) * cache.steps["action"][0].nbytes


def test_another_process_maps_the_files_again(client: gleaner.Client, lab: Lab, tmp_path: Path) -> None:
    cache = cached(client, lab.dataset, tmp_path)
    packed = pickle.dumps(cache)
    assert len(packed) < 1000
    np.testing.assert_array_equal(pickle.loads(packed).steps["action"], cache.steps["action"])


def fetched(address: str, dataset: str, folder: Path) -> int:
    """What one process of several does: the inode of its file shows which fetch it reads."""
    with gleaner.connect(address) as client:
        return (cached(client, dataset, folder).folder / "action").stat().st_ino


def test_processes_that_ask_at_once_fetch_once(server: str, lab: Lab, tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        inodes = pool.starmap(fetched, [(server, lab.dataset, tmp_path)] * 2)
    assert len(set(inodes)) == 1
