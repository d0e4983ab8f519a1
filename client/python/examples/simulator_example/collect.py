"""Demonstrations as files: one MCAP per episode, named by agent, seed and outcome. Existing files are kept.

Beside them are `labels.csv`, as `gleaner push` reads it, `marks.csv` with the first wrong step of each episode, and the
task's spec `task.json`: all that `gleaner experiment` needs of recordings.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from simulator_example.agent import EXPERT, Agent
from simulator_example.recorder import Recorder
from simulator_example.simulator import Simulator
from simulator_example.task import task_spec

# Each agent has its own placements, which evaluations never use (see trials).
SEEDS_APART = 100_000
LABELS, MARKS, SPEC = "labels.csv", "marks.csv", "task.json"
# Of this process alone: another may collect into the same folder.
UNFINISHED = f"unfinished-{os.getpid()}.part"


@dataclass(frozen=True)
class Demonstration:
    """A recorded episode."""

    path: Path
    agent: str
    seed: int
    success: bool


@dataclass(frozen=True)
class Mark:
    """The first step of a recording whose action is not the expert's; none in an expert's."""

    file: str
    went_wrong: int | None


def collect(
    env: Simulator, task: str, folder: Path, experts: int, each: int, *, after_success_s: float = 0.0
) -> Iterator[Demonstration]:
    """Yields the episodes of the expert, then `each` of every imperfect agent; failed episodes are kept.

    An expert that fails is no expert there: another placement is taken in its place. The task is named `task`, and
    recordings continue for `after_success_s` once it is solved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SPEC).write_text(json.dumps(task_spec(env, task), indent=2) + "\n")
    marks = _marks(folder)
    made: list[Demonstration] = []
    for place, agent in enumerate((EXPERT, *env.imperfect)):
        wanted, seed = experts if agent is EXPERT else each, place * SEEDS_APART
        while wanted > 0:
            shown = _known(folder, marks, agent, seed)
            if shown is None:
                shown, mark = _record(env, agent, seed, folder, after_success_s)
                marks[mark.file] = mark
                _write(folder / MARKS, marks.values())
            seed += 1
            if agent is EXPERT and not shown.success:
                continue
            wanted -= 1
            made.append(shown)
            yield shown
    labels = [_Label(shown.path.name, task, "success" if shown.success else "failure", shown.agent) for shown in made]
    _write(folder / LABELS, labels)


@dataclass(frozen=True)
class _Label:
    file: str
    task: str
    outcome: str
    cohort: str


def _marks(folder: Path) -> dict[str, Mark]:
    if not (folder / MARKS).exists():
        return {}
    with (folder / MARKS).open(newline="") as file:
        steps = {row["file"]: row["went_wrong"] for row in csv.DictReader(file)}
    return {name: Mark(name, int(step) if step else None) for name, step in steps.items()}


def _write(path: Path, rows: Iterable[Mark | _Label]) -> None:
    rows = list(rows)
    part = path.with_suffix(f".{os.getpid()}.part")
    with part.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(rows[0])])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    part.replace(path)


def _known(folder: Path, marks: dict[str, Mark], agent: Agent, seed: int) -> Demonstration | None:
    for success in (True, False):
        path = _path(folder, agent, seed, success)
        if path.exists() and path.name in marks:
            return Demonstration(path, agent.name, seed, success)
    return None


def _path(folder: Path, agent: Agent, seed: int, success: bool) -> Path:
    return folder / f"{agent.name}-{seed:06d}-{'success' if success else 'failure'}.mcap"


def _record(
    env: Simulator, agent: Agent, seed: int, folder: Path, after_success_s: float
) -> tuple[Demonstration, Mark]:
    state, info = env.reset(seed=seed)
    act = env.demonstrator(agent, seed)
    about = {"task": env.task, "seed": str(seed), **{name: str(value) for name, value in asdict(agent).items()}}
    went_wrong: int | None = None
    with Recorder(folder / UNFINISHED, env.rate_hz, about) as recorder:
        step, truncated = 0, False
        last: int | None = None  # once the task is solved
        while not truncated and step != last:
            action, right = act(state)
            if went_wrong is None and not np.array_equal(action, right):
                went_wrong = step
            recorder.step(env.images(), env.depths(), env.felt(state), env.fields(action))
            state, _, _, truncated, info = env.step(action)
            step += 1
            if last is None and info["success"]:
                last = step + round(after_success_s * env.rate_hz)
        success = last is not None
        path = _path(folder, agent, seed, success)
        recorder.keep(path)
    return Demonstration(path, agent.name, seed, success), Mark(path.name, went_wrong)
