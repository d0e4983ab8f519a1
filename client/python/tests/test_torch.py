"""A dataset as a PyTorch dataset; only where torch is installed."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gleaner
from conftest import Lab

torch = pytest.importorskip("torch")

from gleaner.torch import SegmentDataset, SegmentLoader  # noqa: E402  (needs torch)

STEPS = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("datasets")


@pytest.fixture(scope="module")
def dataset(client: gleaner.Client, lab: Lab, folder: Path) -> SegmentDataset:
    return client.datasets.torch_dataset(lab.dataset, steps=STEPS, frames=True, cache=folder)


def drawn(loader: SegmentLoader) -> list[list[int]]:
    return [batch.tolist() for batch in loader.rest()]


def test_items_are_the_segments_padded_to_one_size(client: gleaner.Client, lab: Lab, dataset: SegmentDataset) -> None:
    segments = list(client.datasets.stream(lab.dataset, frames=True))
    assert len(dataset) == len(segments)
    assert dataset[0]["mask"].tolist() == [False, False, False, True]
    np.testing.assert_array_equal(dataset[0]["action"].numpy(), np.repeat(segments[0].action, 4, axis=0))
    camera = next(iter(segments[0].images))
    for at, segment in enumerate(segments):
        item = dataset[at]
        mask = item["mask"]
        np.testing.assert_array_equal(item["action"][mask].numpy(), segment.action)
        np.testing.assert_array_equal(item["proprioception"][mask].numpy(), segment.proprioception)
        np.testing.assert_array_equal(item[f"images.{camera}"][mask].numpy(), segment.images[camera])
        np.testing.assert_array_equal(item[f"depth.{camera}"][mask].numpy(), segment.depth[camera])
        assert item["weight"].item() == pytest.approx(segment.weight)
        assert item["expert"].item() == (segment.role == "expert")
    assert dataset[-1]["weight"] == dataset[len(dataset) - 1]["weight"]
    with pytest.raises(IndexError, match=f"segment {len(dataset)} of {len(dataset)}"):
        dataset[len(dataset)]


def test_changed_weights_do_not_change_the_items(dataset: SegmentDataset) -> None:
    before = dataset[0]["weight"].item()
    weights = dataset.weights
    weights /= 2 * weights.sum()
    assert dataset[0]["weight"].item() == before
    assert dataset.weights[0].item() == before


def test_a_step_is_stored_once_however_many_segments_contain_it(
    client: gleaner.Client, lab: Lab, dataset: SegmentDataset
) -> None:
    segments = client.datasets.stream(lab.dataset)
    steps = {(one.episode_id, step) for one in segments for step in range(one.first_step, one.end_step + 1)}
    assert dataset.cache.rows == len(steps)


def test_segments_without_a_number_of_steps_have_their_own_length(
    client: gleaner.Client, lab: Lab, folder: Path
) -> None:
    own = client.datasets.torch_dataset(lab.dataset, cache=folder, kept_only=True)
    segments = list(client.datasets.stream(lab.dataset, kept_only=True))
    assert [len(own[at]["action"]) for at in range(len(own))] == [len(segment.action) for segment in segments]
    with pytest.raises(gleaner.errors.InvalidArgument, match="steps: segments have lengths of their own"):
        SegmentLoader(own, 8)


def test_second_use_reads_the_cache(
    client: gleaner.Client, lab: Lab, dataset: SegmentDataset, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*args: Any, **options: Any) -> None:
        raise AssertionError("the segments were fetched again")

    monkeypatch.setattr(client.datasets, "stream", fail)
    again = client.datasets.torch_dataset(lab.dataset, steps=STEPS, frames=True, cache=folder)
    assert len(again) == len(dataset)


def test_interrupted_fetch_leaves_no_cache(
    client: gleaner.Client, lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(done: int, total: int) -> None:
        assert total > done
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        client.datasets.torch_dataset(lab.dataset, cache=tmp_path, progress=interrupted)
    assert [path.suffix for path in tmp_path.iterdir()] == [".lock"]
    seen: list[tuple[int, int]] = []
    dataset = client.datasets.torch_dataset(
        lab.dataset, cache=tmp_path, progress=lambda done, total: seen.append((done, total))
    )
    assert seen[-1] == (len(dataset), len(dataset))


def test_damaged_cache_and_full_disk_are_named(
    client: gleaner.Client, lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = client.datasets.torch_dataset(lab.dataset, cache=tmp_path)
    actions = dataset.cache.folder / "action"
    actions.write_bytes(actions.read_bytes()[:-4])
    with pytest.raises(gleaner.errors.Damaged, match=r"action: expected \d+ bytes, got \d+; delete"):
        client.datasets.torch_dataset(lab.dataset, cache=tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=0))
    with pytest.raises(gleaner.errors.ResourceExhausted, match="has 0 MiB free"):
        client.datasets.torch_dataset(lab.dataset, cache=tmp_path / "full")


def test_every_segment_comes_once_an_epoch_in_an_order_of_its_own(dataset: SegmentDataset) -> None:
    loader = SegmentLoader(dataset, 8, seed=1)
    first = drawn(loader)
    batches = [batch["weight"] for batch in loader]
    assert len(batches) == len(loader) == len(first)
    np.testing.assert_array_equal(torch.cat(batches), dataset.weights[[*chain(*first)]])
    assert loader.epoch == 1
    second = drawn(loader)
    assert sorted(chain(*first)) == sorted(chain(*second)) == list(range(len(dataset)))
    assert first != second
    assert drawn(SegmentLoader(dataset, 8, order="sequential"))[0] == list(range(8))


@pytest.mark.parametrize("workers", [0, 2])
def test_loader_resumes_after_the_last_batch_taken(dataset: SegmentDataset, workers: int) -> None:
    options: dict[str, Any] = {"seed": 3, "num_workers": workers}
    straight = SegmentLoader(dataset, 8, **options)
    expected = [batch["action"] for _ in range(2) for batch in straight]
    begun = SegmentLoader(dataset, 8, **options)
    found = []
    for batch in begun:
        found.append(batch["action"])
        if len(found) == 3:
            break
    state = json.loads(json.dumps(begun.state_dict()))
    resumed = SegmentLoader(dataset, 8, **options)
    resumed.load_state_dict(state)
    found += [batch["action"] for _ in range(2) for batch in resumed]
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_state_at_the_end_of_an_epoch_begins_the_next(dataset: SegmentDataset) -> None:
    loader = SegmentLoader(dataset, 8)
    for _ in loader:
        state = loader.state_dict()
    resumed = SegmentLoader(dataset, 8)
    resumed.load_state_dict(state)
    first = next(iter(resumed))
    assert resumed.epoch == 1
    np.testing.assert_array_equal(first["action"], next(iter(loader))["action"])


def test_state_of_another_order_is_refused(dataset: SegmentDataset) -> None:
    state = SegmentLoader(dataset, 8, seed=1).state_dict()
    with pytest.raises(gleaner.errors.InvalidArgument, match=r"state.seed: is 1, this loader has 2"):
        SegmentLoader(dataset, 8, seed=2).load_state_dict(state)


def test_ranks_share_an_epoch_in_equal_parts(dataset: SegmentDataset) -> None:
    ranks = [SegmentLoader(dataset, 4, rank=rank, ranks=3) for rank in range(3)]
    parts = [drawn(loader) for loader in ranks]
    assert len({len(part) for part in parts}) == 1
    counts = Counter(at for part in parts for batch in part for at in batch)
    assert set(counts) == set(range(len(dataset)))
    assert sum(counts.values()) - len(dataset) == -len(dataset) % 3
    with pytest.raises(gleaner.errors.InvalidArgument, match="rank: must be from 0 to 2"):
        SegmentLoader(dataset, 4, rank=3, ranks=3)


def test_weighted_order_draws_by_weight(dataset: SegmentDataset) -> None:
    loader = SegmentLoader(dataset, 1, order="weighted")
    counts = np.zeros(len(dataset))
    for epoch in range(200):
        loader.load_state_dict({**loader.state_dict(), "epoch": epoch, "taken": 0})
        np.add.at(counts, np.concatenate(loader.rest()), 1)
    expected = dataset.weights.numpy() / dataset.weights.sum().item() * counts.sum()
    # Six deviations of a count of this size.
    assert (np.abs(counts - expected) < 6 * np.sqrt(expected + 1)).all()


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_pytorch_loads_items_in_workers(dataset: SegmentDataset, context: str) -> None:
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=8, shuffle=True, num_workers=2, multiprocessing_context=context
    )
    weights = torch.cat([batch["weight"] for batch in loader])
    np.testing.assert_allclose(np.sort(weights), np.sort(dataset.weights), rtol=1e-6)
    sampler = torch.utils.data.WeightedRandomSampler(dataset.weights, 16)
    assert next(iter(torch.utils.data.DataLoader(dataset, 16, sampler=sampler)))["action"].shape[:2] == (16, STEPS)
