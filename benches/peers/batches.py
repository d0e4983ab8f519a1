"""Episodes and batches: segments in stretches of neighbours, each frame once or once a window."""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from model import MODALITIES, Shape

STEPS = 100
RATIOS = (0.4, 0.3, 0.2, 0.1)


@dataclass
class Layout:
    """Which steps a batch needs and where its windows find them."""

    steps: Tensor
    index: Tensor
    valid: Tensor
    hidden: Tensor


@dataclass
class Batch:
    """As a step reads it: images [N, C, H, W] in 0 ... 1, places [W L], valid [W, L], hidden [W, L, 3]."""

    images: list[Tensor]
    proprioception: Tensor
    action: Tensor
    index: Tensor
    valid: Tensor
    hidden: Tensor


class Episodes:
    """Episodes of STEPS steps, one after the other."""

    def __init__(self, shape: Shape, count: int, folder: Path | None):
        self.shape, self.count = shape, count
        total, pixels = count * STEPS, shape.side * shape.side
        if folder is None:
            frames = torch.randint(256, (total, shape.cameras, pixels * (5 if shape.depth else 3)), dtype=torch.uint8)
            self.proprioception = torch.rand(total, shape.proprioception) * 2 - 1
            self.action = torch.rand(total, shape.action) * 2 - 1
        else:
            frames = read(folder / "frames", torch.uint8).view(total, shape.cameras, -1)
            self.proprioception = read(folder / "proprioception", torch.float32).view(total, -1)
            self.action = read(folder / "action", torch.float32).view(total, -1)
        size = (total, shape.side, shape.side)
        colour, depth = frames[:, :, : 3 * pixels], frames[:, :, 3 * pixels :]
        self.colour = [x.reshape(*size, 3) for x in colour.unbind(1)]
        # Millimetres as two bytes, the low one first.
        self.depth = []
        if shape.depth:
            pairs = depth.int().unflatten(2, (-1, 2)).unbind(1)
            self.depth = [(x[..., 0] + 256 * x[..., 1]).view(size) for x in pairs]

    def draw(self, batch: int, stretch: int, window: int, every_window: bool) -> Layout:
        """Segments in stretches; a stretch that reaches the end of its episode continues at the beginning."""
        ends = torch.empty(0, dtype=torch.long)
        while len(ends) < batch:
            anchor = torch.randint(self.count * STEPS, ())
            begin = anchor // STEPS * STEPS
            ends = torch.cat([ends, begin + (anchor - begin + torch.arange(min(stretch, STEPS))) % STEPS])
        ends = ends[:batch, None]
        place = ends % STEPS + torch.arange(1 - window, 1)
        valid = place >= 0
        needed = (ends - ends % STEPS + place.clamp_min(0)).flatten()
        if every_window:
            steps, index = needed, torch.arange(len(needed))
        else:
            steps, index = needed.unique(return_inverse=True)
        ratio = torch.tensor(RATIOS)[torch.randint(len(RATIOS), (batch, 1, 1))]
        hidden = (torch.rand(batch, window, MODALITIES) < ratio) & valid.unsqueeze(-1)
        return Layout(steps, index, valid, hidden)

    def collect(self, layout: Layout) -> Batch:
        """The tensors of a layout."""
        images = [x[layout.steps].permute(0, 3, 1, 2).float() / 255 for x in self.colour]
        for camera, depth in enumerate(self.depth):
            metres = depth[layout.steps].unsqueeze(1).float() / 1000
            images[camera] = torch.cat([images[camera], metres / (1 + metres)], 1)
        return Batch(
            [x.contiguous() for x in images],
            self.proprioception[layout.steps],
            self.action[layout.steps],
            layout.index,
            layout.valid,
            layout.hidden,
        )


def read(path: Path, kind: torch.dtype) -> Tensor:
    return torch.frombuffer(bytearray(path.read_bytes()), dtype=kind)
