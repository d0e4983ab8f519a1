"""Policies that draw chunks from noise, `flow` and `diffusion`, in eager PyTorch as a policy server runs them.

As in LeRobot's policies, a session keeps a queue of actions and predicts a chunk when it is empty. Does not depend on the
protocol of requests.
"""

import math

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from model import ImageEncoder, Shape, Size, Statistics, Transformer

MEMORY = 2
# Width of the perceptron's hidden layers, in widths of an embedding.
WIDER = 8
PERIODS = (4e-3, 4.0)
# The first chunks of a session, whose noise is gleaner's own, so that actions can be compared.
CHECKED = 16


class Transformers(Transformer):
    """As Transformer, whose tokens are not grouped by step."""

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        for block in self.block:
            x = block(x, mask)
        return self.norm(x)


class Time(nn.Module):
    """The layers that embed a time in 0 … 1, which a network has among its own."""

    def __init__(self, width: int):
        super().__init__()
        self.time_hidden, self.time_out = nn.Linear(width, width), nn.Linear(width, width)
        shortest, longest = (math.log(period) for period in PERIODS)
        periods = torch.linspace(shortest, longest, width // 2, dtype=torch.float64).exp()
        self.register_buffer("frequencies", (2 * math.pi / periods).float(), persistent=False)

    def embedded(self, time: float) -> Tensor:
        """[d]."""
        angle = time * self.frequencies
        waves = torch.cat([angle.sin(), angle.cos()])
        return self.time_out(F.silu(self.time_hidden(waves)))


class Numbers(Time):
    """The perceptron of a checkpoint, in its names."""

    def __init__(self, shape: Shape, size: Size, chunk: int):
        super().__init__(size.width)
        numbers, wide = chunk * shape.action, WIDER * size.width
        self.image = ImageEncoder(shape, size)
        self.hidden_0 = nn.Linear(2 * size.width + shape.proprioception + numbers, wide)
        self.hidden_1 = nn.Linear(wide, wide)
        self.out = nn.Linear(wide, numbers)

    def memory(self, images: list[Tensor], proprioception: Tensor) -> Tensor:
        """[1, d + M] of one step."""
        return torch.cat([self.image(images), proprioception], 1)

    def forward(self, memory: Tensor, noisy: Tensor, time: float) -> Tensor:
        """What the network predicts of a noisy chunk [1, k, A] at a time in 0 … 1."""
        x = torch.cat([memory, self.embedded(time)[None], noisy.flatten(1)], 1)
        return self.out(F.gelu(self.hidden_1(F.gelu(self.hidden_0(x))))).view_as(noisy)


class Tokens(Time):
    """The transformer of a checkpoint, in its names."""

    def __init__(self, shape: Shape, size: Size, chunk: int):
        width = size.width
        super().__init__(width)
        self.image = ImageEncoder(shape, size)
        self.proprioception = nn.Linear(shape.proprioception, width)
        self.action = nn.Linear(shape.action, width)
        self.memory_embedding = nn.Parameter(torch.zeros(MEMORY, width))
        self.place_embedding = nn.Parameter(torch.zeros(chunk, width))
        self.transformer = Transformers(size)
        self.out = nn.Linear(width, shape.action)
        mask = torch.ones(MEMORY + chunk, MEMORY + chunk, dtype=torch.bool)
        mask[:MEMORY, MEMORY:] = False
        self.register_buffer("mask", mask[None, None], persistent=False)

    def memory(self, images: list[Tensor], proprioception: Tensor) -> Tensor:
        """[1, 2, d] of one step."""
        return torch.stack([self.image(images), self.proprioception(proprioception)], 1) + self.memory_embedding

    def forward(self, memory: Tensor, noisy: Tensor, time: float) -> Tensor:
        """What the network predicts of a noisy chunk [1, k, A] at a time in 0 … 1."""
        tokens = torch.cat([memory, self.action(noisy) + self.embedded(time) + self.place_embedding], 1)
        return self.out(self.transformer(tokens, self.mask)[:, MEMORY:])


NETWORKS = {"perceptron": Numbers, "transformer": Tokens}


class ChunkLearner(nn.Module):
    """The network with its statistics."""

    def __init__(self, network: nn.Module, shape: Shape, size: Size):
        super().__init__()
        self.policy = network
        self.statistics = Statistics(shape, size)


class ChunkPolicy:
    """Draws chunks with the weights of a checkpoint."""

    def __init__(self, header: dict, tensors: dict[str, Tensor], shape: Shape, size: Size):
        settings = header["settings"]
        self.shape, self.passes = shape, settings["sampling_steps"]
        self.chunk, self.execute = settings["chunk_length"], settings["execute_length"]
        self.whole = settings["prediction"] == "chunk"
        self.range = tensors.pop("statistics.action.range", None)
        self.left = cosine(settings["diffusion_steps"]) if self.range is not None else None
        network = NETWORKS[settings["chunk_network"]](shape, size, self.chunk)
        self.learner = ChunkLearner(network, shape, size).eval()
        self.learner.load_state_dict(tensors, strict=True)

    @torch.inference_mode()
    def act(self, images: list[Tensor], proprioception: Tensor, noise: Tensor) -> Tensor:
        """The actions [k, A] from images [1, C, H, W] of each camera and m [1, M], with the noise [1, k, A]."""
        statistics, network = self.learner.statistics, self.learner.policy
        images = [camera.input(x) for camera, x in zip(statistics.camera, images)]
        memory = network.memory(images, statistics.proprioception(proprioception))
        if self.left is None:
            return statistics.action.invert(self.integrated(memory, noise)[0])
        actions = self.denoised(memory, noise) * self.range[1] + self.range[0]
        return statistics.action.invert(statistics.action(actions)[0])

    def integrated(self, memory: Tensor, x: Tensor) -> Tensor:
        """Euler's method from noise at t = 1 to t = 0."""
        for at in range(self.passes):
            time = 1 - at / self.passes
            found = self.learner.policy(memory, x, time)
            x = x - ((x - found) / time if self.whole else found) / self.passes
        return x

    def denoised(self, memory: Tensor, x: Tensor) -> Tensor:
        """DDIM over some of the steps, the last one first."""
        count = len(self.left)
        step = lambda at: round(count - at * count / self.passes) - 1
        left = lambda at: self.left[step(at)] if step(at) >= 0 else 1.0
        for at in range(self.passes):
            now, then = left(at), left(at + 1)
            found = self.learner.policy(memory, x, step(at) / count)
            if self.whole:
                found = (x - found * math.sqrt(now)) / math.sqrt(1 - now)
            chunk = ((x - found * math.sqrt(1 - now)) / math.sqrt(now)).clamp(-1, 1)
            x = chunk * math.sqrt(then) + found * math.sqrt(1 - then)
        return x


class ChunkEpisode:
    """One session: the newest step, and the actions that are left of the newest chunk."""

    def __init__(self, policy: ChunkPolicy):
        self.policy, self.queue, self.drawn = policy, [], 0

    def act(self, frames: list[bytes], proprioception: Tensor) -> Tensor:
        """Answers an observation: RGB of each camera, row by row, and m [M]."""
        if not self.queue:
            self.drawn += 1
            side, size = self.policy.shape.side, (1, self.policy.chunk, self.policy.shape.action)
            pixels = (torch.frombuffer(bytearray(frame), dtype=torch.uint8) for frame in frames)
            images = [each.view(1, side, side, 3).permute(0, 3, 1, 2).float() / 255 for each in pixels]
            noise = gleaner_noise(0, self.drawn, size) if self.drawn <= CHECKED else torch.randn(size)
            actions = self.policy.act(images, proprioception[None], noise)
            self.queue = list(actions[: self.policy.execute].flip(0))
        return self.queue.pop()


def cosine(steps: int) -> list[float]:
    """What is left of a chunk at each step: the squared cosine."""
    part = lambda at: math.cos((at / steps + 0.008) / 1.008 * math.pi / 2) ** 2
    left, lefts = 1.0, []
    for at in range(steps):
        left *= 1 - min(1 - part(at + 1) / part(at), 0.999)
        lefts.append(left)
    return lefts


def gleaner_noise(seed: int, number: int, size: tuple[int, ...]) -> Tensor:
    """What gleaner draws for chunk `number` (from 1) of a session with this seed: ChaCha8 and the Box-Muller transform."""
    purpose, count = 12, math.prod(size)
    key = b"".join(part.to_bytes(8, "little") for part in (seed, purpose, number, 0))
    words = np.frombuffer(chacha8(key, -(-count // 8) + 1), dtype="<u8")
    uniform = (words >> np.uint64(11)) * 2.0**-53
    radius, angle = np.sqrt(-2 * np.log(1 - uniform[::2])), 2 * math.pi * uniform[1::2]
    normal = np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1).ravel()[:count]
    return torch.from_numpy(normal.astype(np.float32)).view(size)


def chacha8(key: bytes, blocks: int) -> bytes:
    """That many blocks of 64 bytes of the stream with nonce 0."""
    mask, stream = 0xFFFFFFFF, bytearray()
    constants = [int.from_bytes(b"expand 32-byte k"[at : at + 4], "little") for at in range(0, 16, 4)]
    secret = [int.from_bytes(key[at : at + 4], "little") for at in range(0, 32, 4)]
    for block in range(blocks):
        begin = [*constants, *secret, block, 0, 0, 0]
        state = begin.copy()
        for turn in range(8):
            for column in range(4):
                shift = turn % 2
                a, b, c, d = (4 * row + (column + shift * row) % 4 for row in range(4))
                for to, by, other, bits in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
                    state[to] = (state[to] + state[by]) & mask
                    mixed = state[other] ^ state[to]
                    state[other] = (mixed << bits | mixed >> (32 - bits)) & mask
        for one, two in zip(state, begin):
            stream += ((one + two) & mask).to_bytes(4, "little")
    return bytes(stream)
