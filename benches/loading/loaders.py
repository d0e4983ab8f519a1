"""What a user would load the same steps with: PyTorch's DataLoader over JPEG files, and over LeRobot's video dataset.

A program of its own, so that nothing of it runs beside gleaner: prints one line of JSON with the samples a second of one
worker process. A sample is a window of steps with the pictures of all cameras as floats of 128 × 128.
"""

import argparse
import json
import pathlib
import time

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from torchvision.io import ImageReadMode, decode_jpeg, read_file
from torchvision.transforms import v2

from scenes import CAMERAS, RATE_HZ, SIDE

BATCH = 64
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


def videos(folder: pathlib.Path, window: int) -> Dataset:
    """Windows of steps from LeRobot's dataset, resized by its own hook."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    before = [step / RATE_HZ for step in range(1 - window, 1)]
    names = [*(f"observation.images.{camera}" for camera in CAMERAS), "observation.state", "action"]
    wanted = {name: before for name in names} if window > 1 else None
    resize = v2.Resize((SIDE, SIDE), antialias=True)
    return LeRobotDataset("loading/scenes", root=folder, delta_timestamps=wanted, image_transforms=resize)


def rate(dataset: Dataset, seconds: float) -> float:
    """Samples a second of one worker, over at least two batches."""
    generator = torch.Generator().manual_seed(0)
    options = {"num_workers": 1, "persistent_workers": True, "drop_last": True, "generator": generator}
    loader = DataLoader(dataset, BATCH, shuffle=True, worker_init_fn=lambda _: torch.set_num_threads(1), **options)
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
    parser.add_argument("kind", choices=["files", "small-files", "videos"])
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--window", type=int, required=True, help="steps of a sample")
    parser.add_argument("--seconds", type=float, default=10, help="to measure")
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.kind == "videos":
        dataset = videos(given.folder, given.window)
    else:
        dataset = Files(given.folder, given.window, given.kind == "small-files")
    print(json.dumps({"samples_per_second": rate(dataset, given.seconds)}))


if __name__ == "__main__":
    main()
