"""What a user would load the same steps with: PyTorch's DataLoader over JPEG files, over LeRobot's datasets of videos
and of images, and gleaner's `torch_dataset`.

A program of its own, so that nothing of it runs beside gleaner: prints one line of JSON with the samples a second of one
worker process. A sample is a window of steps with the pictures of all cameras as floats of 128 × 128.
"""

import argparse
import json
import pathlib
import time
from collections.abc import Iterable

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from torchvision.io import ImageReadMode, decode_jpeg, read_file
from torchvision.transforms import v2

from scenes import CAMERAS, RATE_HZ, SIDE

BATCH = 64
# One process that prepares batches, on one thread.
WORKER = {"num_workers": 1, "persistent_workers": True, "worker_init_fn": lambda _: torch.set_num_threads(1)}
# Batches before the clock runs: those that the worker assembles ahead.
WARM_UP = 2


class Files(Dataset):
    """Windows of steps from JPEG files, decoded by torchvision."""

    def __init__(self, folder: pathlib.Path, window: int, small: bool):
        numbers = np.load(folder / "numbers.npz")
        self.state, self.action = torch.from_numpy(numbers["state"]), torch.from_numpy(numbers["action"])
        self.folder, self.window, self.ending = folder, window, "-small.jpg" if small else ".jpg"
        self.resize = v2.Resize((SIDE, SIDE), antialias=True)

    def __len__(self) -> int:
        return self.state.shape[0] * self.state.shape[1]

    def __getitem__(self, at: int) -> dict[str, torch.Tensor]:
        episode, last = divmod(at, self.state.shape[1])
        steps = torch.arange(last - self.window + 1, last + 1).clamp(min=0)
        found = {camera: self.pictures(episode, camera, steps) for camera in CAMERAS}
        return {**found, "state": self.state[episode, steps], "action": self.action[episode, steps]}

    def pictures(self, episode: int, camera: str, steps: torch.Tensor) -> torch.Tensor:
        read = lambda step: read_file(str(self.folder / str(episode) / f"{camera}-{step}{self.ending}"))
        decoded = [self.resize(decode_jpeg(read(int(step)), ImageReadMode.RGB)) for step in steps]
        return torch.stack(decoded).float() / 255


def recorded(folder: pathlib.Path, window: int) -> Dataset:
    """Windows of steps from LeRobot's dataset, resized by its own hook where they are not of that size."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    before = [step / RATE_HZ for step in range(1 - window, 1)]
    names = [*(f"observation.images.{camera}" for camera in CAMERAS), "observation.state", "action"]
    wanted = {name: before for name in names} if window > 1 else None
    resize = v2.Resize((SIDE, SIDE), antialias=True)
    return LeRobotDataset("loading/scenes", root=folder, delta_timestamps=wanted, image_transforms=resize)


def segments(folder: pathlib.Path, window: int) -> Iterable[dict[str, torch.Tensor]]:
    """Batches of gleaner's segments from their cache, converted by the worker as the others' are."""
    from gleaner._segment_cache import SegmentCache
    from gleaner.torch import SegmentDataset, SegmentLoader

    dataset = SegmentDataset(SegmentCache(folder), steps=window)
    return SegmentLoader(dataset, BATCH, drop_last=True, collate_fn=floats, **WORKER)


def floats(batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    planes = lambda images: images.permute(0, 1, 4, 2, 3).float() / 255
    return {name: planes(values) if name.startswith("images.") else values for name, values in batch.items()}


def samples(dataset: Dataset) -> Iterable[dict[str, torch.Tensor]]:
    """Batches of a dataset's items at random."""
    generator = torch.Generator().manual_seed(0)
    return DataLoader(dataset, BATCH, shuffle=True, drop_last=True, generator=generator, **WORKER)


def rate(loader: Iterable[dict[str, torch.Tensor]], seconds: float) -> float:
    """Samples a second, over at least two batches."""
    count, begun = -WARM_UP, time.perf_counter()
    while True:
        for _ in loader:
            count += 1
            if count == 0:
                begun = time.perf_counter()
            elif count >= 2 and time.perf_counter() - begun >= seconds:
                return count * BATCH / (time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=["files", "small-files", "videos", "images", "segments"])
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--window", type=int, required=True, help="steps of a sample")
    parser.add_argument("--seconds", type=float, default=10, help="to measure")
    given = parser.parse_args()
    torch.set_num_threads(1)
    match given.kind:
        case "segments":
            loader = segments(given.folder, given.window)
        case "videos" | "images":
            loader = samples(recorded(given.folder, given.window))
        case _:
            loader = samples(Files(given.folder, given.window, given.kind == "small-files"))
    print(json.dumps({"samples_per_second": rate(loader, given.seconds)}))


if __name__ == "__main__":
    main()
