"""Closed-loop episodes over gRPC: stored one by one, so that an interrupted run resumes with the next, or printed."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import gleaner
from simulator_example.plan import Plan
from simulator_example.progress import Progress
from simulator_example.simulator import Simulator
from simulator_example.task import SimulatorAdapter

# Far from the seeds of all demonstrations; two seeds of a run share no episode.
SEED = 10_000_000
EPISODES_APART = 100_000


def trials(client: gleaner.Client, env: Simulator, plan: Plan, deployment: str) -> gleaner.Trials:
    """Evaluates a deployment, except for episodes in the file; the server stores the result with the policy."""
    file = plan.folder / "trials.jsonl"
    policy_id = next(known.policy_id for known in client.deployments() if known.name == deployment)
    done = _read(file, policy_id)[: plan.episodes]
    missing = plan.episodes - len(done)
    if missing == 0:
        return gleaner.Trials(SEED, tuple(done), policy_id)
    with (
        gleaner.Policy(client, deployment) as policy,
        Progress(f"evaluate {deployment}") as progress,
        file.open("a") as out,
    ):

        def on_trial(trial: gleaner.Trial) -> None:
            out.write(json.dumps({"policy": policy_id, **asdict(trial)}) + "\n")
            out.flush()
            done.append(trial)
            progress.at(len(done), plan.episodes, f"{sum(trial.success for trial in done)} solved")

        gleaner.evaluate(env, policy, SimulatorAdapter(), missing, SEED + len(done), on_trial=on_trial)
    result = gleaner.Trials(SEED, tuple(done), policy_id)
    result.report(client, f"{plan.simulator}/{plan.task}")
    return result


def attempt(client: gleaner.Client, env: Simulator, plan: Plan) -> None:
    """Evaluates a deployment for `gleaner experiment`: prints each episode as a line of JSON."""

    def on_trial(trial: gleaner.Trial) -> None:
        print(json.dumps({"seed": trial.seed, "success": trial.success, "steps": trial.steps}), flush=True)

    with gleaner.Policy(client, plan.deployment, record=bool(plan.cohort), cohort=plan.cohort) as policy:
        first = SEED + plan.seed * EPISODES_APART
        gleaner.evaluate(env, policy, SimulatorAdapter(), plan.episodes, first, on_trial=on_trial)


def _read(file: Path, policy_id: str) -> list[gleaner.Trial]:
    if not file.exists():
        return []
    text = file.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        # The line that an earlier run was interrupted in; that episode runs again.
        file.write_text(whole)
    rows = [json.loads(line) for line in whole.splitlines()]
    return [gleaner.Trial(row["seed"], row["success"], row["steps"]) for row in rows if row["policy"] == policy_id]
