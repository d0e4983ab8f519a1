"""The jobs on the server: task, scores, dataset, two policies. Existing jobs are not submitted again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import gleaner
from gleaner.types import Dataset, Episode, Job
from simulator_example.agent import EXPERT
from simulator_example.collect import Demonstration
from simulator_example.plan import Plan
from simulator_example.progress import Progress
from simulator_example.simulator import Simulator
from simulator_example.task import task_spec

WITHOUT, WITH = "experts only", "with gleaned segments"


@dataclass(frozen=True)
class Gleaned:
    """The results of the jobs."""

    encoder: str
    run: str
    dataset: Dataset
    episodes: list[Episode]  # all that were pushed
    policies: dict[str, str]  # deployment by what it was trained on


def push(
    client: gleaner.Client, plan: Plan, env: Simulator, demonstrations: Iterable[Demonstration]
) -> Iterator[Episode]:
    """Pushes the recordings, labelled by outcome, with the agent as cohort; recordings on the server are skipped."""
    try:
        client.tasks.create(task_spec(env, plan.server_task))
    except gleaner.AlreadyExists:
        _same_task(client, plan)
    for shown in demonstrations:
        outcome = "success" if shown.success else "failure"
        yield client.episodes.push(shown.path, task=plan.server_task, outcome=outcome, cohort=shown.agent)


def _same_task(client: gleaner.Client, plan: Plan) -> None:
    spec = client.tasks.get(plan.server_task).spec
    sizes = {(camera.height, camera.width) for camera in spec.cameras}
    if sizes != {(plan.size, plan.size)}:
        raise SystemExit(
            f"--size {plan.size}: the server's task has pictures of {sizes}; use that size, or another server"
        )


def glean(client: gleaner.Client, plan: Plan, env: Simulator, episodes: list[Episode]) -> Gleaned:
    """Scores, selects, trains twice and deploys; shows the progress of each job."""
    there = sum(1 for _ in client.episodes.list(plan.server_task))
    if there != len(episodes):
        raise SystemExit(
            f"the server's task {plan.server_task} holds {there} episodes, not the {len(episodes)} of this run; "
            "give the run a --label of its own"
        )
    # Roles depend on the agent, because a success of an imperfect agent is imperfect data too.
    rule = {"expert_cohorts": [EXPERT.name], "imperfect_cohorts": [agent.name for agent in env.imperfect]}
    # A name of these episodes: neither the default scorer nor the default policy reads an encoder.
    pretrain = _job(client, plan, "pretrain", {"rule": rule, "steps": 1})
    score = _job(client, plan, "score", {"encoder_id": pretrain.result_id})
    dataset = client.datasets.create(score.result_id, top_fraction=plan.keep or None)
    learnt_from: dict[str, dict[str, Any]] = {
        WITHOUT: {"experts_of": pretrain.result_id},
        WITH: {"dataset_id": dataset.id},
    }
    policies = {}
    for name, data in learnt_from.items():
        settings = {**data, "seed": plan.seed, "steps": plan.train_steps, "batch": plan.train_batch}
        job = _job(client, plan, "train", settings, name)
        policies[name] = _deploy(client, f"{plan.server_task}@{name.split()[0]}", job.result_id, score.result_id)
    return Gleaned(pretrain.result_id, score.result_id, client.datasets.get(dataset.id), episodes, policies)


def _job(client: gleaner.Client, plan: Plan, kind: str, spec: dict[str, Any], name: str = "") -> Job:
    # The key identifies the work: a second submission, also of a resumed run, returns the first job.
    digest = hashlib.sha256(json.dumps(spec, sort_keys=True).encode()).hexdigest()[:16]
    job = getattr(client.jobs, kind)(plan.server_task, key=f"{plan.simulator} {kind} {digest}", **spec)
    with Progress(f"{kind} {name}".strip()) as progress:
        for event in client.jobs.watch(job):
            progress.at(event.job.done, event.job.total, event.job.message)
    return client.jobs.wait(job)


def _deploy(client: gleaner.Client, name: str, policy_id: str, run: str) -> str:
    deployed = {known.name: (known.policy_id, known.score_run_id) for known in client.deployments()}
    if deployed.get(name) != (policy_id, run):
        # With a score run every session receives live scores.
        client.deploy(name, policy_id, score_run=run)
    return name
