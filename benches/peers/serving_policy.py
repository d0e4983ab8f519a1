"""A policy in eager PyTorch as a policy server runs it: each request of a finetuned policy encodes its whole window.

Does not depend on the protocol of requests. Frames are made tensors once, when they come; as in LeRobot's policies, the
window is a queue of them, and the network sees all of it each time.
"""

import argparse
import json
from collections import deque
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor

from batches import Batch
from model import SIZES, Shape, attention_mask
from objective import Learner
from serving_chunks import ChunkEpisode, ChunkPolicy

PROPRIOCEPTION = 1


class Policy:
    """The network of a checkpoint, in its names."""

    def __init__(self, checkpoint: Path):
        with safe_open(checkpoint, "pt") as opened:
            header = json.loads(opened.metadata()["gleaner"])
        task, model, tensors = header["shape"], header["model"], load_file(checkpoint)
        self.cameras = [camera["name"] for camera in task["cameras"]]
        camera, size = task["cameras"][0], SIZES[model["preset"]]
        self.shape = Shape(camera["height"], camera["depth"], len(self.cameras), task["proprioception"], task["action"])
        self.window = model["segment_length"] + 1
        match header["policy"]:
            case "finetune":
                self.chunks = None
                self.learner = Learner(self.shape, size, self.window).eval()
                self.learner.load_state_dict(tensors, strict=True)
            case "flow" | "diffusion":
                self.chunks = ChunkPolicy(header, tensors, self.shape, size)
            case other:
                raise SystemExit(f"{checkpoint} holds a policy of kind {other}; it must be finetune, flow or diffusion")

    def episode(self) -> "Episode | ChunkEpisode":
        """A session at the start of an episode."""
        return ChunkEpisode(self.chunks) if self.chunks else Episode(self)

    @torch.inference_mode()
    def act(self, images: list[Tensor], proprioception: Tensor, action: Tensor) -> Tensor:
        """The action [A] after n steps, oldest first: images of each camera [n, C, H, W], m [n, M], a [n, A]."""
        learner, steps = self.learner, len(proprioception)
        # Padded on the left to a whole window; what is there is hidden from all others.
        index = (torch.arange(self.window) - (self.window - steps)).clamp_min(0)
        valid = (torch.arange(self.window) >= self.window - steps)[None]
        embedded = learner.steps(Batch(images, proprioception, action, index, valid, None))
        tokens = learner.model.token(embedded, index, None)
        z = learner.model.transformer(tokens, attention_mask(valid, causal=True))
        return learner.statistics.action.invert(learner.model.head["action"](z[0, -1, PROPRIOCEPTION]))


class Episode:
    """One session: the newest steps, whose actions are taken as executed."""

    def __init__(self, policy: Policy):
        self.policy = policy
        self.images = [deque(maxlen=policy.window) for _ in policy.cameras]
        self.proprioception: deque[Tensor] = deque(maxlen=policy.window)
        self.action: deque[Tensor] = deque(maxlen=policy.window)

    def act(self, frames: list[bytes], proprioception: Tensor) -> Tensor:
        """Answers an observation: RGB of each camera, row by row, and m [M]."""
        side = self.policy.shape.side
        for queue, frame in zip(self.images, frames):
            pixels = torch.frombuffer(bytearray(frame), dtype=torch.uint8).view(side, side, 3)
            queue.append((pixels.permute(2, 0, 1).float() / 255).contiguous())
        self.proprioception.append(proprioception)
        # What the newest step's action is to be is the question.
        self.action.append(torch.zeros(self.policy.shape.action))
        images = [torch.stack(list(queue)) for queue in self.images]
        m, a = (torch.stack(list(queue)) for queue in (self.proprioception, self.action))
        self.action[-1] = self.policy.act(images, m, a)
        return self.action[-1]


def from_command_line(description: str) -> Policy:
    """The policy of --checkpoint, on --threads threads."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    policy = Policy(options.checkpoint)
    episode = policy.episode()
    blank = [bytes(policy.shape.side**2 * 3) for _ in policy.cameras]
    for _ in range(policy.window + 1):
        episode.act(blank, torch.zeros(policy.shape.proprioception))
    return policy
