"""Pipelines, and schedules that start them, against a real server."""

from __future__ import annotations

import uuid
from typing import Any

import pytest

import gleaner
from conftest import TASK, Lab
from gleaner.settings import PipelineStages

SMALL: dict[str, Any] = {"steps": 2, "batch": 8, "warmup_steps": 1, "preset": "tiny"}
STAGES: PipelineStages = {
    "rule": {"expert_cohorts": ["expert"], "imperfect_cohorts": ["wrong_goal"]},
    "pretrain": {**SMALL, "segment_length": 3, "seed": 7},  # type: ignore[typeddict-item]
    "top_fraction": 0.5,
    "shape": {"min_run": 1},
    "train": {**SMALL, "policy": "finetune", "lambda_": 0.5},  # type: ignore[typeddict-item]
    "evaluate": {"simulation": "pick_cube", "episodes": 1, "max_steps": 2},
}


def test_a_pipeline_runs_to_the_last_stage_that_is_given(client: gleaner.Client, lab: Lab) -> None:
    chain = client.jobs.pipeline(TASK, **STAGES, key="chain", priority=3)
    assert [gleaner.word(job, "kind") for job in chain.jobs] == ["pretrain", "score", "train", "evaluate"]
    assert {job.priority for job in chain.jobs} == {3}
    again = client.jobs.pipeline(TASK, **STAGES, key="chain")
    assert [job.id for job in again.jobs] == [job.id for job in chain.jobs], "the same key is one chain"
    train = chain.jobs[2].spec.train
    assert (train.dataset_id, train.settings["lambda"]) == (chain.dataset_id, 0.5)
    evaluate = client.jobs.wait(chain, timeout=240)
    assert (evaluate.id, gleaner.word(evaluate, "state")) == (chain.jobs[-1].id, "succeeded")
    assert client.policies.evaluation(evaluate.result_id).policy_id == chain.jobs[2].result_id
    assert chain.dataset_id in [dataset.id for dataset in client.datasets.list(TASK)]
    assert isinstance(client.jobs.log(evaluate), str)


def test_stages_without_a_key_are_another_pipeline(client: gleaner.Client, lab: Lab) -> None:
    first, second = (client.jobs.pipeline(TASK, pretrain={"steps": 100_000}, score={}) for _ in range(2))
    assert [gleaner.word(job, "kind") for job in first.jobs] == ["pretrain", "score"]
    assert first.dataset_id == ""
    assert {job.id for job in first.jobs}.isdisjoint(job.id for job in second.jobs)
    for chain in (first, second):
        client.jobs.cancel(chain.jobs[0])
        with pytest.raises(gleaner.JobFailed, match="was cancelled") as raised:
            client.jobs.wait(chain, timeout=60)
        assert raised.value.job.id == chain.jobs[0].id


def test_invalid_stages_are_named(client: gleaner.Client, lab: Lab) -> None:
    with pytest.raises(gleaner.InvalidArgument, match=r"pipeline\.train: needs a dataset; set pipeline\.beta or"):
        client.jobs.pipeline(TASK, train={"steps": 2})
    with pytest.raises(gleaner.InvalidArgument, match=r"pipeline\.pretrian: is unknown; supported: beta, evaluate"):
        client.jobs.pipeline(TASK, pretrian={})  # type: ignore[call-arg]
    with pytest.raises(gleaner.InvalidArgument, match=r"pipeline\.train\.stepps: is unknown; supported: .*steps"):
        client.jobs.pipeline(TASK, beta=0.5, train={"stepps": 2})  # type: ignore[typeddict-unknown-key]
    with pytest.raises(gleaner.InvalidArgument, match=r"shape\.min_runs: is unknown"):
        client.jobs.pipeline(TASK, beta=0.5, shape={"min_runs": 3})
    with pytest.raises(gleaner.NotFound):
        client.jobs.pipeline("nothing")


def test_a_schedule_is_created_paused_resumed_and_deleted(
    client: gleaner.Client, task: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = client.tasks.get(task).spec
    spec.name = "scheduled"
    client.tasks.create(spec)
    nightly = client.schedules.create("scheduled", "nightly", cron="30 2 * * *", **STAGES)
    assert (nightly.name, nightly.cron, nightly.paused) == ("nightly", "30 2 * * *", False)
    assert nightly.next_run_time.seconds % 86_400 == 2 * 3600 + 30 * 60
    assert nightly.pipeline.train.settings["lambda"] == 0.5
    often = client.schedules.create("scheduled", "often", labelled_episodes=1000, score={})
    assert (often.labelled_episodes, often.pipeline.score, often.pipeline.HasField("train")) == (1000, True, False)
    rare = client.schedules.create("scheduled", "rare", cron="0 0 1 1 *")

    # Smaller pages than there are schedules.
    monkeypatch.setattr("gleaner.schedules._PAGE", 1)
    assert [one.id for one in client.schedules.list("scheduled")] == [nightly.id, often.id, rare.id]
    assert {nightly.id, often.id, rare.id} <= {one.id for one in client.schedules.list()}

    paused = client.schedules.pause(nightly)
    assert paused.paused
    assert not paused.HasField("next_run_time")
    assert client.schedules.resume(nightly.id).HasField("next_run_time")
    client.schedules.delete(nightly)
    assert nightly.id not in {one.id for one in client.schedules.list("scheduled")}
    with pytest.raises(gleaner.NotFound):
        client.schedules.pause(nightly)


def test_invalid_schedules_are_named(client: gleaner.Client, task: str) -> None:
    with pytest.raises(ValueError, match="cron, labelled_episodes: give one of the two"):
        client.schedules.create(task, "never")
    with pytest.raises(ValueError, match="cron, labelled_episodes: give one of the two"):
        client.schedules.create(task, "twice", cron="0 2 * * *", labelled_episodes=3)
    with pytest.raises(gleaner.InvalidArgument, match="cron"):
        client.schedules.create(task, "whenever", cron="whenever")
    with pytest.raises(gleaner.InvalidArgument, match=r"pipeline\.cron_: is unknown"):
        client.schedules.create(task, "x", cron="0 2 * * *", cron_="")  # type: ignore[call-arg]
    name = f"once {uuid.uuid4()}"
    schedule = client.schedules.create(task, name, cron="0 0 1 1 *")
    with pytest.raises(gleaner.AlreadyExists):
        client.schedules.create(task, name, cron="0 0 1 1 *")
    client.schedules.delete(schedule)
