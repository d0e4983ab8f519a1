"""Recorded and scored rollouts against a real server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from numpy.typing import NDArray

import gleaner
from conftest import TASK, Lab
from test_policy import Reach, ReachAdapter, observation

WATCHED = "pick_small@watched"
STEPS = 6
ABSENT = "run_01ARZ3NDEKTSV4RRFFQ69G5FAV"


@pytest.fixture(scope="module")
def watched(client: gleaner.Client, lab: Lab) -> str:
    """A deployment that names a score run."""
    made = client.deploy(WATCHED, lab.policy, score_run=lab.run)
    assert made.score_run_id == lab.run
    return WATCHED


def test_a_recorded_session_is_an_episode_of_its_task(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment, record=True, cohort="tuesday") as policy:
        for step in range(STEPS):
            policy(observation(policy.spec, step))
        kept = client.episodes.get(policy.reset("failure"))
        policy(observation(policy.spec))
        policy(observation(policy.spec))
        other = client.episodes.get(policy.reset())
        policy(observation(policy.spec))
        assert policy.close("success") == "", "one step is no episode"
    assert (kept.steps, kept.cohort, gleaner.word(kept, "outcome")) == (STEPS, "tuesday", "failure")
    assert (other.steps, gleaner.word(other, "outcome")) == (2, "unknown")
    assert kept.id in [episode.id for episode in client.episodes.list(TASK, cohort="tuesday")]


def test_episodes_are_recorded_on_request_only(client: gleaner.Client, deployment: str) -> None:
    before = len(list(client.episodes.list(TASK)))
    with gleaner.Policy(client, deployment) as policy:
        policy(observation(policy.spec))
        assert policy.close("success") == ""
    assert len(list(client.episodes.list(TASK))) == before


def test_an_evaluation_is_recorded_and_labelled(client: gleaner.Client, deployment: str) -> None:
    with gleaner.Policy(client, deployment, record=True, cohort="evaluated") as policy:
        trials = gleaner.evaluate(Reach(), policy, ReachAdapter(), episodes=2, seed=10)
    kept = [client.episodes.get(trial.episode_id) for trial in trials.trials]
    assert [(gleaner.word(one, "outcome"), one.steps) for one in kept] == [("success", 3), ("failure", 5)]


def test_a_session_is_scored_as_the_steps_without_it(client: gleaner.Client, watched: str, lab: Lab) -> None:
    with gleaner.Policy(client, watched) as policy:
        seen = [observation(policy.spec, step) for step in range(STEPS)]
        scores: dict[int, gleaner.LiveScore] = {}
        done = []
        for step in seen:
            done.append(policy(step))
            if policy.score is not None:
                scores[policy.score.stamp_ns] = policy.score
        period_ns = round(1e9 / policy.spec.rate_hz)
    # A score can be finished just after its reply was sent, so some come with a later reply, and the last with none.
    assert scores
    alone = client.score_steps(lab.run, zip(seen, done, strict=True))
    for stamp_ns, score in scores.items():
        place = round(stamp_ns / period_ns)
        assert score.w == pytest.approx(alone.w[place], abs=1e-5)
        assert (score.match_episode, score.match_step) == (alone.match_episode[place], alone.match_step[place])


def test_steps_are_scored_one_by_one_and_all_together(client: gleaner.Client, deployment: str, lab: Lab) -> None:
    with gleaner.Policy(client, deployment) as policy:
        spec = policy.spec
    seen = [(observation(spec, step), np.full(sum(field.size for field in spec.action), 0.1)) for step in range(40)]
    taken = []

    def happening() -> Iterator[tuple[dict[str, Any], NDArray[np.float64]]]:
        for step in seen:
            taken.append(len(scores))
            yield step

    scores: list[gleaner.LiveScore] = []
    for score in client.stream_scores(lab.run, happening()):
        scores.append(score)
    assert taken == list(range(40)), "each score came before the next step was taken"
    together = client.score_steps(lab.run, seen)
    assert together.w.shape == together.q.shape == together.match_step.shape == (40,)
    np.testing.assert_array_equal(together.w, [score.w for score in scores])
    assert set(together.match_episode) <= set(lab.experts)
    assert ((together.q >= 0) & (together.q <= 1)).all()
    with pytest.raises(gleaner.InvalidArgument, match="action: expected 7 values, got 1"):
        client.score_steps(lab.run, [(seen[0][0], [0.0])])
    with pytest.raises(gleaner.NotFound, match=ABSENT):
        client.score_steps(ABSENT, seen)


def test_a_recording_is_scored_as_the_run_scored_it_and_not_kept(
    client: gleaner.Client, lab: Lab, recordings: dict[str, list[Path]]
) -> None:
    before = len(list(client.episodes.list(TASK)))
    sent: list[int] = []
    path = recordings["wrong_goal"][0]
    scores, report = client.score_recording(lab.run, path, progress=sent.append)
    stored = client.scores.episode(lab.run, lab.failures[0])
    np.testing.assert_allclose(scores.w, stored.w, atol=1e-5)
    np.testing.assert_array_equal(scores.match_step, stored.match_step)
    assert report.steps == len(scores.w)
    assert sent[-1] == path.stat().st_size
    assert len(list(client.episodes.list(TASK))) == before


def test_invalid_scoring_requests_are_rejected(client: gleaner.Client, lab: Lab, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no recording at all")
    with pytest.raises(gleaner.InvalidArgument, match="recording"):
        client.score_recording(lab.run, broken)
    endless = tmp_path / "endless.mcap"
    with endless.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("x" * 1025, "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(gleaner.ResourceExhausted, match=r"open\.summary\.topics: .*--max-name-bytes"):
        client.score_recording(lab.run, endless)
    with pytest.raises(FileNotFoundError):
        client.score_recording(lab.run, tmp_path / "nowhere.mcap")
    with pytest.raises(gleaner.NotFound, match=ABSENT):
        client.score_recording(ABSENT, broken)
    with pytest.raises(gleaner.NotFound, match=ABSENT):
        client.deploy("odd", lab.policy, score_run=ABSENT)
