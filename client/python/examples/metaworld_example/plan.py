"""Everything that can be chosen about a run, with defaults that take about an hour on two processor cores."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path

SAID = {
    "task": "a task of Meta-World",
    "server": "address of a gleaner server",
    "out": "folder for recordings, trials, pictures and the report",
    "size": "height and width of the cameras' pictures",
    "experts": "demonstrations of the expert",
    "imperfect": "demonstrations of each imperfect agent",
    "pretrain_steps": "optimiser steps of the pretraining",
    "pretrain_batch": "segments a step",
    "train_steps": "optimiser steps of each policy",
    "train_batch": "segments a step, of experts and of kept segments each",
    "keep": "part of the imperfect segments to keep: the best",
    "weight": "λ, the weight of the kept segments' loss",
    "seed": "of the trainings",
    "episodes": "closed-loop episodes of each policy",
    "token": "of the server, if it asks for one",
}


@dataclass(frozen=True)
class Plan:
    """A run."""

    task: str = "pick-place-v3"
    server: str = "127.0.0.1:7400"
    out: Path = Path("metaworld-runs")
    size: int = 64
    experts: int = 60
    imperfect: int = 50
    pretrain_steps: int = 2000
    pretrain_batch: int = 32
    train_steps: int = 2000
    train_batch: int = 32
    keep: float = 0.2
    weight: float = 1.0
    seed: int = 0
    episodes: int = 50
    token: str = ""

    @property
    def folder(self) -> Path:
        """Of this task."""
        return self.out / self.task


def parse(stages: tuple[str, ...], about: str) -> tuple[str, Plan]:
    """The stage and the plan from the command line."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("stage", choices=stages, nargs="?", default=stages[-1], help="what to do")
    for field in fields(Plan):
        flag = f"--{field.name.replace('_', '-')}"
        parser.add_argument(flag, type=type(field.default), default=field.default, help=SAID[field.name])
    given = vars(parser.parse_args())
    return given.pop("stage"), Plan(**given)
