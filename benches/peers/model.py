"""The pretraining model in eager PyTorch: the same layers, names and losses as the `learn` crate's.

Does not depend on the source of batches or on the measurement of a step.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

MODALITIES = 3
PLACES, MIN_STAGES, LARGE, GROUPS = 256, 2, 64, 8


@dataclass(frozen=True)
class Size:
    """What a preset stands for."""

    width: int
    layers: int
    heads: int
    channels: tuple[int, ...]
    target: int


SIZES = {"tiny": Size(64, 2, 4, (16, 32), 8), "small": Size(128, 4, 4, (32, 64), 16)}


@dataclass(frozen=True)
class Shape:
    """Two square cameras, proprioception and action."""

    side: int
    depth: bool
    cameras: int = 2
    proprioception: int = 38
    action: int = 7

    @property
    def channels(self) -> int:
        return 4 if self.depth else 3


class Standard(nn.Module):
    """(x - mean) / deviation, with both as buffers."""

    def __init__(self, mean: tuple[int, ...], deviation: tuple[int, ...]):
        super().__init__()
        self.register_buffer("mean", torch.zeros(mean))
        self.register_buffer("deviation", torch.ones(deviation))

    def forward(self, x: Tensor) -> Tensor:
        return (x - self.mean) / self.deviation


class ActionStandard(Standard):
    """As Standard, for what is predicted: a value that never changed is held."""

    def __init__(self, size: int):
        super().__init__((size,), (size,))
        # Whether each value changed, and its value where it did not.
        self.register_buffer("held", torch.stack([torch.ones(size), torch.zeros(size)]))

    def invert(self, x: Tensor) -> Tensor:
        return (x * self.deviation + self.mean) * self.held[0] + self.held[1]


class CameraStandard(nn.Module):
    """Of what the image encoder reads, and of what its head predicts."""

    def __init__(self, channels: int, side: int):
        super().__init__()
        each = (channels, 1, 1)
        self.input = Standard(each, each)
        self.target = Standard((channels, side, side), each)

    def small(self, images: Tensor) -> Tensor:
        return self.target(F.adaptive_avg_pool2d(images, self.target.mean.shape[1:])).flatten(1)


class Statistics(nn.Module):
    def __init__(self, shape: Shape, size: Size):
        super().__init__()
        self.proprioception = Standard((shape.proprioception,), (shape.proprioception,))
        self.action = ActionStandard(shape.action)
        side = min(shape.side, size.target)
        self.camera = nn.ModuleList(CameraStandard(shape.channels, side) for _ in range(shape.cameras))


class Stage(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int):
        super().__init__()
        kernel = 5 if stride == 4 else 3
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
        self.norm = nn.GroupNorm(GROUPS, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.norm(self.conv(x)))


class CameraEncoder(nn.Module):
    """Stages, then where each channel's thing is (a spatial softmax) and how clearly it is seen."""

    def __init__(self, shape: Shape, size: Size):
        super().__init__()
        side, channels, stages = shape.side, shape.channels, []
        while len(stages) < MIN_STAGES or side * side > PLACES:
            large = not stages and shape.side > LARGE
            stride = 4 if large else 2 if side * side > PLACES else 1
            outputs = size.channels[min(len(stages), len(size.channels) - 1)]
            stages.append(Stage(channels, outputs, stride))
            side, channels = -(-side // stride), outputs
        self.stages = len(stages)
        for place, stage in enumerate(stages):
            self.add_module(str(place), stage)
        self.keypoint = nn.Conv2d(channels, channels, 1)
        line = torch.linspace(-1, 1, side)
        grid = torch.stack(torch.meshgrid(line, line, indexing="xy"), -1).view(-1, 2)
        self.register_buffer("grid", grid, persistent=False)
        self.outputs = 3 * channels

    def forward(self, x: Tensor) -> Tensor:
        for place in range(self.stages):
            x = self.get_submodule(str(place))(x)
        seen = self.keypoint(x).flatten(2)
        attention = seen.softmax(-1)
        return torch.cat([(attention @ self.grid).flatten(1), (attention * seen).sum(-1)], 1)


class ImageEncoder(nn.Module):
    def __init__(self, shape: Shape, size: Size):
        super().__init__()
        self.camera = nn.ModuleList(CameraEncoder(shape, size) for _ in range(shape.cameras))
        self.project = nn.Linear(sum(camera.outputs for camera in self.camera), size.width)

    def forward(self, images: list[Tensor]) -> Tensor:
        return self.project(torch.cat([camera(x) for camera, x in zip(self.camera, images)], 1))


class Tokens(nn.Module):
    def __init__(self, shape: Shape, width: int, window: int):
        super().__init__()
        self.proprioception = nn.Linear(shape.proprioception, width)
        self.action = nn.Linear(shape.action, width)
        self.modality_embedding = nn.Parameter(0.1 * torch.randn(MODALITIES, width))
        self.time_embedding = nn.Parameter(0.1 * torch.randn(window, 1, width))
        self.mask_embedding = nn.Parameter(0.1 * torch.randn(MODALITIES, width))

    def forward(self, steps: Tensor, index: Tensor, hidden: Tensor | None) -> Tensor:
        """Steps [N, 3, d] as windows [W, 3 L, d]; `hidden` [W, L, 3] are masked."""
        length = self.time_embedding.shape[0]
        tokens = steps[index].view(-1, length, MODALITIES, steps.shape[-1])
        if hidden is not None:
            tokens = torch.where(hidden.unsqueeze(-1), self.mask_embedding, tokens)
        return (tokens + self.modality_embedding + self.time_embedding).flatten(1, 2)


class Block(nn.Module):
    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.attention_norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)
        self.mlp_norm = nn.LayerNorm(width)
        self.up = nn.Linear(width, 4 * width)
        self.down = nn.Linear(4 * width, width)

    def split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        normed = self.attention_norm(x)
        key, value = self.key_value(normed).chunk(2, -1)
        query, key, value = self.split(self.query(normed)), self.split(key), self.split(value)
        seen = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        x = x + self.out(seen.transpose(1, 2).flatten(2))
        return x + self.down(F.gelu(self.up(self.mlp_norm(x))))


class Transformer(nn.Module):
    def __init__(self, size: Size):
        super().__init__()
        self.block = nn.ModuleList(Block(size.width, size.heads) for _ in range(size.layers))
        self.norm = nn.LayerNorm(size.width)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        for block in self.block:
            x = block(x, mask)
        return self.norm(x).unflatten(1, (-1, MODALITIES))


class Head(nn.Module):
    def __init__(self, width: int, outputs: int):
        super().__init__()
        self.hidden = nn.Linear(width, width)
        self.out = nn.Linear(width, outputs)

    def forward(self, z: Tensor) -> Tensor:
        return self.out(F.gelu(self.hidden(z)))


class Model(nn.Module):
    """Everything that learns."""

    def __init__(self, shape: Shape, size: Size, window: int):
        super().__init__()
        side = min(shape.side, size.target)
        self.image = ImageEncoder(shape, size)
        self.token = Tokens(shape, size.width, window)
        self.transformer = Transformer(size)
        outputs = {
            "image": shape.cameras * shape.channels * side * side,
            "proprioception": shape.proprioception,
            "action": shape.action,
        }
        self.head = nn.ModuleDict({name: Head(size.width, count) for name, count in outputs.items()})


def attention_mask(valid: Tensor, causal: bool) -> Tensor:
    """[W, 1, 3 L, 3 L]: the attention mask. No token attends to padding; each attends to itself."""
    keys = valid.repeat_interleave(MODALITIES, 1)[:, None, None, :]
    count = keys.shape[-1]
    own = torch.eye(count, dtype=torch.bool)
    if causal:
        keys = keys & torch.ones(count, count, dtype=torch.bool).tril()
    return keys | own
