"""The stages, in order."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gleaner
from gleaner.types import Episode
from simulator_example.collect import Demonstration, collect
from simulator_example.gleaning import glean, push
from simulator_example.own_server import own_server
from simulator_example.plan import Plan, parse
from simulator_example.progress import Progress
from simulator_example.report import write
from simulator_example.simulator import Simulator, make
from simulator_example.trials import attempt, trials

STAGES = ("collect", "push", "glean", "evaluate", "all", "attempt")


def main(about: str) -> None:
    """Runs the stages of the command line."""
    until, plan = parse(STAGES, about)
    env = make(plan.simulator, plan.task, plan.size)
    try:
        if until == "attempt":
            with _connected(plan.server) as client:
                attempt(client, env, plan)
            return
        plan.folder.mkdir(parents=True, exist_ok=True)
        shown = _collect(env, plan)
        if until != "collect":
            with _client(plan) as client:
                _with_server(client, plan, env, shown, until)
    finally:
        env.close()


@contextmanager
def _client(plan: Plan) -> Iterator[gleaner.Client]:
    if not plan.server_bin:
        with _connected(plan.server) as client:
            yield client
        return
    with own_server(Path(plan.server_bin), plan.out / "server") as address, gleaner.connect(address) as client:
        yield client


def _connected(address: str) -> gleaner.Client:
    # The variables of the command line tool; an argument would be readable by other users of the machine.
    read = os.environ.get
    cert, key = read("GLEANER_CLIENT_CERT"), read("GLEANER_CLIENT_KEY")
    return gleaner.connect(address, read("GLEANER_TOKEN"), ca=read("GLEANER_CA"), cert=cert, key=key)


def _with_server(client: gleaner.Client, plan: Plan, env: Simulator, shown: list[Demonstration], until: str) -> None:
    episodes = _push(client, plan, env, shown)
    if until == "push":
        return
    gleaned = glean(client, plan, env, episodes)
    if until == "glean":
        return
    results = {name: trials(client, env, plan, deployment) for name, deployment in gleaned.policies.items()}
    for name, result in results.items():
        print(f"{name}: {result}")
    if until == "all":
        print(write(client, plan, env, gleaned, results))


def _collect(env: Simulator, plan: Plan) -> list[Demonstration]:
    total = plan.experts + len(env.imperfect) * plan.imperfect
    shown = []
    with Progress("collect") as progress:
        where, amounts = (plan.server_task, plan.folder / "episodes"), (plan.experts, plan.imperfect)
        for demonstration in collect(env, *where, *amounts, after_success_s=plan.after_success):
            shown.append(demonstration)
            progress.at(len(shown), total, demonstration.agent)
    return shown


def _push(client: gleaner.Client, plan: Plan, env: Simulator, shown: list[Demonstration]) -> list[Episode]:
    pushed = []
    with Progress("push") as progress:
        for episode in push(client, plan, env, shown):
            pushed.append(episode)
            progress.at(len(pushed), len(shown))
    return pushed
