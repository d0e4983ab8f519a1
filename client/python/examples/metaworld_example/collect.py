"""Demonstrations as files: one MCAP per episode, named by agent, seed and outcome. Existing files are kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from metaworld_example.demonstrator import EXPERT, IMPERFECT, Agent, Demonstrator
from metaworld_example.lab import done, felt
from metaworld_example.recorder import Recorder
from metaworld_example.simulator import RATE_HZ, MetaWorld

# Each agent has its own placements, which evaluations never use (see trials).
SEEDS_APART = 100_000


@dataclass(frozen=True)
class Demonstration:
    """A recorded episode."""

    path: Path
    agent: str
    seed: int
    success: bool


def collect(env: MetaWorld, task: str, folder: Path, experts: int, each: int) -> Iterator[Demonstration]:
    """Yields the episodes of the expert, then `each` of every imperfect agent; failed episodes are kept.

    An expert that fails is no expert there: another placement is taken in its place.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for place, agent in enumerate((EXPERT, *IMPERFECT)):
        wanted, seed = experts if agent is EXPERT else each, place * SEEDS_APART
        while wanted > 0:
            made = _known(folder, agent, seed) or _record(env, task, agent, seed, folder)
            seed += 1
            if agent is EXPERT and not made.success:
                continue
            wanted -= 1
            yield made


def _known(folder: Path, agent: Agent, seed: int) -> Demonstration | None:
    for success in (True, False):
        path = _path(folder, agent, seed, success)
        if path.exists():
            return Demonstration(path, agent.name, seed, success)
    return None


def _path(folder: Path, agent: Agent, seed: int, success: bool) -> Path:
    return folder / f"{agent.name}-{seed:06d}-{'success' if success else 'failure'}.mcap"


def _record(env: MetaWorld, task: str, agent: Agent, seed: int, folder: Path) -> Demonstration:
    act = Demonstrator(task, agent, seed)
    state, info = env.reset(seed=seed)
    about = {
        "task": task,
        "seed": str(seed),
        "agent": agent.name,
        "spoiled": agent.spoiled,
        "amount": f"{agent.amount}",
    }
    with Recorder(folder / "unfinished.part", RATE_HZ, about) as recorder:
        over = False
        while not over:
            seen, felt_now, action = env.images(), felt(env, state), act(state)
            recorder.step(seen, felt_now, done(action))
            state, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        path = _path(folder, agent, seed, info["success"])
        recorder.keep(path)
    return Demonstration(path, agent.name, seed, info["success"])
