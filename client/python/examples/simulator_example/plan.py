"""The settings of a run, with defaults that take half an hour on two processor cores."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path

from simulator_example.simulator import SIMULATORS

SAID = {
    "simulator": "simulator: " + " or ".join(SIMULATORS),
    "task": "task of the simulator",
    "label": "distinguishes runs of one task with different demonstrations",
    "server": "address of a gleaner server that runs; GLEANER_TOKEN, GLEANER_CA, GLEANER_CLIENT_CERT and _KEY are read",
    "server_bin": "gleaner-server to start for this run instead, over OUT/server; empty: none",
    "out": "folder for recordings, trials, pictures and the report",
    "size": "height and width of the cameras' pictures",
    "experts": "demonstrations of the expert",
    "imperfect": "demonstrations of each imperfect agent",
    "after_success": "seconds for which recordings continue after the success, so that experts stand at the goal too",
    "train_steps": "optimiser steps of each policy",
    "train_batch": "segments a step, of experts and of kept segments each",
    "keep": "part of the imperfect segments to keep, the best; 0: those whose q is above the default β",
    "seed": "of the trainings",
    "episodes": "closed-loop episodes of each policy",
    "deployment": "deployment to evaluate, of the stage attempt",
    "cohort": "of the server's recordings of these attempts, of the stage attempt; empty: none are made",
}


@dataclass(frozen=True)
class Plan:
    """The settings of a run."""

    simulator: str = "metaworld"
    task: str = "pick-place-v3"
    label: str = ""
    server: str = "127.0.0.1:7400"
    server_bin: str = ""
    out: Path = Path("simulator-runs")
    size: int = 64
    experts: int = 20
    imperfect: int = 50
    after_success: float = 0.0
    train_steps: int = 1500
    train_batch: int = 32
    keep: float = 0.0
    seed: int = 0
    episodes: int = 100
    deployment: str = ""
    cohort: str = ""

    @property
    def name(self) -> str:
        """The name of the run: the task and the label."""
        return "-".join(filter(None, (self.task, self.label)))

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return self.out / self.name

    @property
    def server_task(self) -> str:
        """The task's name on the server: `pick-place-v3` is `metaworld_pick_place_v3`."""
        return f"{self.simulator}_{self.name.replace('-', '_')}"


def parse(stages: tuple[str, ...], about: str) -> tuple[str, Plan]:
    """The stage and the plan from the command line."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("stage", choices=stages, nargs="?", default="all", help="what to do")
    for field in fields(Plan):
        flag = f"--{field.name.replace('_', '-')}"
        parser.add_argument(flag, type=type(field.default), default=field.default, help=SAID[field.name])
    given = vars(parser.parse_args())
    return given.pop("stage"), Plan(**given)
