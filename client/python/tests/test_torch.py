"""A dataset as a PyTorch dataset; only where torch is installed."""

from __future__ import annotations

import numpy as np
import pytest

import gleaner
from conftest import Lab

torch = pytest.importorskip("torch")


def test_items_are_padded_to_one_size_and_collate(client: gleaner.Client, lab: Lab) -> None:
    segments = list(client.datasets.stream(lab.dataset))
    items = list(client.datasets.torch_dataset(lab.dataset, steps=4, frames=True))
    assert len(items) == len(segments)
    first = items[0]
    assert first["mask"].tolist() == [False, False, False, True]
    np.testing.assert_array_equal(first["action"].numpy(), np.repeat(segments[0].action, 4, axis=0))
    for item, segment in zip(items, segments, strict=True):
        np.testing.assert_array_equal(item["action"][item["mask"]].numpy(), segment.action)
    batch = next(iter(torch.utils.data.DataLoader(items, batch_size=8)))
    assert batch["weight"].shape == (8,)


def test_workers_share_the_segments(client: gleaner.Client, lab: Lab) -> None:
    dataset = client.datasets.torch_dataset(lab.dataset, kept_only=True)
    alone = sorted(item["weight"].item() for item in dataset)
    loader = torch.utils.data.DataLoader(dataset, batch_size=None, num_workers=2, multiprocessing_context="spawn")
    assert sorted(item["weight"].item() for item in loader) == alone
