"""What a pretraining step costs in eager PyTorch on the CPU: one line of JSON.

With --paced it takes turns with another program: each line read is a number of steps to take, each line
written what they took; compare.py drives it so.
"""

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import distributed, nn

from batches import Batch, Episodes
from model import SIZES, Shape
from objective import Learner

BETAS, EPSILON, DECAY, CLIP = (0.9, 0.999), 1e-8, 0.01, 1.0
RATE, WARM_UP = 1e-3, 50


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", choices=SIZES, default="tiny")
    parser.add_argument("--side", type=int, default=32, help="pixels a side of the two cameras")
    parser.add_argument("--depth", action="store_true")
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--objectives", default="mtp,tr,aa")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--stretch", type=int, default=8)
    parser.add_argument("--segment-length", type=int, default=6, help="l: a segment is l + 1 steps")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--encode", choices=["once", "window"], default="once", help="each frame, or once a window")
    parser.add_argument("--precision", choices=["f32", "bf16"], default="f32", help="of the products, by autocast")
    parser.add_argument("--share", type=Path, help="folder with episodes and a checkpoint to begin from")
    parser.add_argument("--steps", type=int, default=20, help="steps to take the median of, after 3 to warm up")
    parser.add_argument("--paced", action="store_true")
    parser.add_argument("--ranks", type=int, default=1, help="processes that share each batch, by DistributedDataParallel")
    parser.add_argument("--rank", type=int, default=0)
    parser.add_argument("--meeting", type=Path, help="a file that does not exist, the same for every rank")
    return parser.parse_args()


class Loss(nn.Module):
    """The loss of a batch as a module's output, which is what DistributedDataParallel wraps."""

    def __init__(self, learner: Learner, objectives: tuple[str, ...]):
        super().__init__()
        self.learner, self.objectives = learner, objectives

    def forward(self, batch: Batch) -> torch.Tensor:
        return self.learner.loss(batch, self.objectives)


class Run:
    """A model, its optimiser and its data."""

    def __init__(self, options: argparse.Namespace):
        torch.manual_seed(options.rank)
        self.options, self.window = options, options.segment_length + 1
        self.objectives = tuple(options.objectives.split(","))
        shape, size = Shape(options.side, options.depth), SIZES[options.preset]
        self.episodes = Episodes(shape, options.episodes, options.share)
        self.learner = Learner(shape, size, self.window)
        named = dict(self.learner.model.named_parameters())
        decays = {name: p.dim() > 1 and not name.endswith("embedding") for name, p in named.items()}
        groups = [
            {"params": [p for name, p in named.items() if decays[name] is wanted], "weight_decay": decay}
            for wanted, decay in ((True, DECAY), (False, 0.0))
        ]
        self.optimizer = torch.optim.AdamW(groups, lr=RATE, betas=BETAS, eps=EPSILON)
        self.parameters = list(named.values())
        self.done = 0
        if options.share is not None:
            self.load(load_file(options.share / "checkpoint"), named)
        self.loss = Loss(self.learner, self.objectives)
        if options.ranks > 1:
            # Each rank draws its part of the batch; the gradients are averaged during the backward pass.
            meeting = f"file://{options.meeting}"
            distributed.init_process_group("gloo", meeting, rank=options.rank, world_size=options.ranks)
            self.loss = nn.parallel.DistributedDataParallel(self.loss)

    def load(self, stored: dict[str, torch.Tensor], named: dict[str, torch.nn.Parameter]) -> None:
        """Resumes after the first step of another program; every name and size must be equal."""
        state = {name: tensor for name, tensor in stored.items() if not name.startswith("optimizer.")}
        self.learner.load_state_dict(state, strict=True)
        for name, parameter in named.items():
            self.optimizer.state[parameter] = {
                "step": torch.tensor(1.0),
                "exp_avg": stored[f"optimizer.mean.model.{name}"],
                "exp_avg_sq": stored[f"optimizer.square.model.{name}"],
            }
        self.done = 1

    def size(self) -> int:
        return sum(parameter.numel() for parameter in self.parameters)

    def take(self, count: int) -> dict[str, list[float]]:
        """Takes steps; what each took in ms, and its loss. Segments and masks are drawn before the clock runs."""
        options = self.options
        every_window = options.encode == "window"
        batch = options.batch // options.ranks
        draw = lambda: self.episodes.draw(batch, options.stretch, self.window, every_window)
        layouts = [draw() for _ in range(count)]
        taken: dict[str, list[float]] = {"ms": [], "loss": []}
        for layout in layouts:
            begin = time.perf_counter()
            for group in self.optimizer.param_groups:
                group["lr"] = RATE * min((self.done + 1) / WARM_UP, 1.0)
            self.optimizer.zero_grad()
            with torch.autocast("cpu", torch.bfloat16, enabled=options.precision == "bf16"):
                loss = self.loss(self.episodes.collect(layout))
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.parameters, CLIP)
            self.optimizer.step()
            taken["loss"].append(loss.item())
            taken["ms"].append((time.perf_counter() - begin) * 1e3)
            self.done += 1
        return taken


def main() -> None:
    options = arguments()
    torch.set_num_threads(options.threads)
    run = Run(options)
    if not options.paced:
        run.take(3)
        ms = statistics.median(run.take(options.steps)["ms"])
        about = {"preset": options.preset, "threads": options.threads, "encode": options.encode}
        print(json.dumps({**about, "parameters": run.size(), "steps": options.steps, "median_ms": round(ms, 3)}))
        return
    print(json.dumps({"parameters": run.size()}), flush=True)
    for line in sys.stdin:
        print(json.dumps(run.take(int(line))), flush=True)


if __name__ == "__main__":
    main()
