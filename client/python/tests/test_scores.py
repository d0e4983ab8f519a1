"""Scores of runs in which not every episode has some."""

from __future__ import annotations

import numpy as np
import pytest

import gleaner
from conftest import TASK, Lab


def test_experts_without_scores_are_left_out(client: gleaner.Client, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = {episode: client.episodes.get(episode).steps for episode in lab.failures}
    table = {
        "episode": np.repeat([*steps], [*steps.values()]),
        "step": np.concatenate([np.arange(count) for count in steps.values()]),
        "q": np.full(sum(steps.values()), 0.25),
    }
    snapshot = client.scores.get(lab.run).snapshot_id
    run = client.scores.import_scores(snapshot, table, source="without experts").id
    with pytest.raises(gleaner.NotFound):
        client.scores.episode(run, lab.experts[0])
    assert {scores.episode_id for scores in client.scores.all(run)} == set(lab.failures)
    assert [*client.scores.all(run, "expert")] == []

    def absent(run: str, episode: str) -> None:
        raise gleaner.NotFound(episode)

    monkeypatch.setattr(client.scores, "episode", absent)
    with pytest.raises(gleaner.NotFound):
        next(client.scores.all(run, "imperfect"))


def test_an_only_expert_has_no_scores(client: gleaner.Client, lab: Lab) -> None:
    rule = {"expert_cohorts": ["expert"], "imperfect_cohorts": ["wrong_goal"], "max_experts": 1}
    snapshot = client.snapshots.create(TASK, rule)
    job = client.jobs.score(TASK, lab.pretrain.result_id, snapshot_id=snapshot.id, normaliser="quantile")
    client.jobs.wait(job, timeout=120)
    assert {scores.episode_id for scores in client.scores.all(job.result_id)} == set(lab.failures)
