"""The command that evaluates a deployment in a simulator: `python -m gleaner.simulators --help`."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from typing import Any

import numpy as np

from gleaner import Client, Policy, Trial, Trials, VectorPolicy, evaluate, evaluate_vector
from gleaner._command import add_connection, connected, ended
from gleaner.errors import invalid
from gleaner.simulators import NAMES, Simulator, SimulatorAdapter, SimulatorVector, make


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        prog="python -m gleaner.simulators", description="Evaluates a deployment in a simulator."
    )
    parser.add_argument("simulator", choices=NAMES)
    parser.add_argument("env", help="its environment, such as Lift or pick-place-v3")
    parser.add_argument("--deployment", help="name of the deployment; without it, what the environment offers is shown")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument(
        "--envs",
        type=int,
        default=1,
        help="environments that run at once, each in a process; the server answers a step of all together",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the first episode; later ones count on")
    parser.add_argument("--max-steps", type=int, help="steps after which an episode is unsolved (default: its own)")
    parser.add_argument("--execute", type=int, default=1, help="actions of each chunk to execute open loop")
    parser.add_argument("--video", metavar="DIR", help="write a video of each episode into this folder")
    parser.add_argument("--record", action="store_true", help="keep each episode as a recording on the server")
    parser.add_argument("--cohort", default="", help="cohort of the recordings")
    parser.add_argument("--report", action="store_true", help="store the result with the policy on the server")
    pair: dict[str, Any] = {"action": "append", "default": [], "metavar": "TASK=SIMULATOR"}
    parser.add_argument("--camera", **pair, help="the simulator's name of a camera of the task")
    parser.add_argument("--field", **pair, help="the simulator's name of a field of the task")
    parser.add_argument("--option", action="append", default=[], metavar="NAME=JSON", help="option of the environment")
    add_connection(parser)
    given = parser.parse_args()
    return ended(lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Evaluates, or shows what there is."""
    options = {name: _json(name, value) for name, value in _pairs("option", given.option).items()}
    if given.deployment is None:
        sim = make(given.simulator, given.env, [], **options)
        show(sim)
        sim.close()
        return 0
    adapter = SimulatorAdapter(_pairs("camera", given.camera), _pairs("field", given.field))
    with connected(given) as client:
        name, trials = (_one if given.envs == 1 else _several)(client, given, adapter, options)
        print(trials)
        if given.report:
            print(trials.report(client, name).id)
    return 0


def _one(
    client: Client, given: argparse.Namespace, adapter: SimulatorAdapter, options: dict[str, Any]
) -> tuple[str, Trials]:
    # The simulator's name, and the trials in one environment.
    with Policy(client, given.deployment, record=given.record, cohort=given.cohort) as policy:
        sim = make(given.simulator, given.env, adapter.wanted(policy.spec), **options)
        try:
            adapter.check(sim, policy.spec)
            return sim.name, evaluate(sim, policy, adapter, given.episodes, given.seed, **_how(given))
        finally:
            sim.close()


def _several(
    client: Client, given: argparse.Namespace, adapter: SimulatorAdapter, options: dict[str, Any]
) -> tuple[str, Trials]:
    # The same in several at once.
    count = min(given.envs, given.episodes)
    if count < 1:
        raise invalid("--envs, --episodes", "must be at least 1")
    with VectorPolicy(client, given.deployment, count, record=given.record, cohort=given.cohort) as policy:
        cameras = adapter.wanted(policy.spec)
        with SimulatorVector(partial(make, given.simulator, given.env, cameras, **options), count) as envs:
            adapter.check(envs, policy.spec)
            return envs.name, evaluate_vector(envs, policy, adapter, given.episodes, given.seed, **_how(given))


def _how(given: argparse.Namespace) -> dict[str, Any]:
    return {
        "max_steps": given.max_steps,
        "execute": given.execute,
        "video": given.video,
        "on_trial": _progress,
    }


def show(sim: Simulator) -> None:
    """Prints the values and the action of an environment, to write a task or choose fields by."""
    seen, _ = sim.reset(seed=0)
    for name, value in sorted(seen.values.items()):
        print(f"{name}: {np.size(value)}")
    print(f"action: {len(sim.low)}, from {sim.low.tolist()} to {sim.high.tolist()}")


def _progress(trial: Trial) -> None:
    result = "solved" if trial.success else "not solved"
    print(f"seed {trial.seed}: {result} after {trial.steps} steps {trial.episode_id}".rstrip(), file=sys.stderr)


def _pairs(name: str, given: list[str]) -> dict[str, str]:
    for pair in given:
        if "=" not in pair:
            raise invalid(f"--{name} {pair}", "expected NAME=VALUE")
    return dict(pair.split("=", 1) for pair in given)


def _json(name: str, text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise invalid(f"--option {name}", f"{text!r} is no JSON; write texts with quotes") from None


if __name__ == "__main__":
    sys.exit(main())
