"""A policy whose server is late, stops or breaks (`fake_server`)."""

from __future__ import annotations

import threading

import pytest

import gleaner
from fake_server import SEEN, Start, action, missed
from gleaner._proto.v1 import policy_pb2 as pb


def test_missed_step_uses_the_chunk_that_covers_it(play: Start) -> None:
    chunk = action(1.0, 2.0)
    shown, client = play(lambda number, seen: (chunk if number == 0 else missed)(number, seen))
    with pytest.warns(UserWarning, match="rate_hz 20: the steps of the task are at 10 Hz.* moves faster"):
        twice_as_fast = gleaner.Policy(client, "d", deadline=0.05, rate_hz=20.0)
    with twice_as_fast as policy:
        policy.open()
        assert policy(SEEN) == [1.0]
        assert policy(SEEN) == [2.0]
        with pytest.raises(gleaner.Missed, match="deployment d"):
            policy(SEEN)
        assert policy.missed == 2
    assert (shown.opened[0].deadline_us, shown.opened[0].control_rate_hz) == (50_000, 20.0)
    assert [seen.stamp_ns for seen in shown.heard] == [0, 50_000_000, 100_000_000]
    # The executed action is sent, also if it comes from an older chunk.
    assert [list(seen.executed_action) for seen in shown.heard] == [[], [1.0], [2.0]]


def test_skipped_steps_are_sent_and_count_in_the_chunk(play: Start) -> None:
    chunk = action(1.0, 2.0, 3.0)
    shown, client = play(lambda number, seen: (chunk if number == 0 else missed)(number, seen))
    with gleaner.Policy(client, "d") as policy:
        assert policy(SEEN) == [1.0]
        assert policy({**SEEN, "skipped_steps": 1}) == [3.0]
        with pytest.raises(gleaner.InvalidArgument, match="skipped_steps: -1: must be from 0"):
            policy({**SEEN, "skipped_steps": -1})
    assert [(seen.stamp_ns, seen.skipped_steps) for seen in shown.heard] == [(0, 0), (200_000_000, 1)]


def test_dropped_and_draining_are_seen(play: Start) -> None:
    draining = pb.SessionResponse(draining=pb.SessionDraining())
    shown, client = play(lambda number, seen: draining if number == 1 else action(1.0, dropped=2)(number, seen))
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        assert (policy.dropped, policy.draining) == (2, False)
        policy(SEEN)
        assert policy.draining
        policy.reset()
        assert (policy.dropped, policy.draining) == (0, False)
        policy(SEEN)
        assert policy.policy_id == "pol_2"
    assert len(shown.opened) == 2


def test_each_answer_carries_the_newest_score(play: Start) -> None:
    def scored(number: int, seen: pb.Observation) -> pb.SessionResponse:
        response = action(1.0)(number, seen)
        if number > 0:
            response.action.score.CopyFrom(
                pb.LiveScore(w=-0.5, q=0.25, match_episode_id="ep_9", match_step=3, observation_stamp_ns=7)
            )
        return response

    _, client = play(scored)
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        assert policy.score is None
        policy(SEEN)
        assert policy.score == gleaner.LiveScore(stamp_ns=7, w=-0.5, q=0.25, match_episode="ep_9", match_step=3)
        assert policy.last is not None
        assert policy.last.score == policy.score
        policy.reset()
        assert policy.score is None


def test_a_recorded_episode_is_labelled_at_its_end(play: Start) -> None:
    shown, client = play(action(1.0))
    with gleaner.Policy(client, "d", record=True, cohort="tuesday") as policy:
        assert policy.reset("success") == "", "no session is open yet"
        policy(SEEN)
        policy(SEEN)
        assert policy.reset("success") == "ep_1"
        policy(SEEN)
        with pytest.raises(gleaner.InvalidArgument, match="'good' is unknown; supported: success, failure, unknown"):
            policy.close("good")
        assert policy.close("failure") == "ep_2"
        policy(SEEN)
    assert shown.outcomes == ["success", "failure", "unknown"]
    assert {(opened.record, opened.cohort) for opened in shown.opened} == {(True, "tuesday")}
    # A recording has a date, and its steps are a period apart.
    first, second = (seen.stamp_ns for seen in shown.heard[:2])
    assert first > 1_600_000_000_000_000_000
    assert second - first == 100_000_000


def test_failed_close_does_not_hide_an_earlier_error(play: Start) -> None:
    lost = pb.SessionResponse(closed=pb.SessionClosed())
    _, client = play(lambda number, seen: lost if number == 1 else action(1.0)(number, seen))
    for record in (True, False):
        policy = gleaner.Policy(client, "d", record=record)
        policy(SEEN)
        assert policy._session is not None
        policy._session._stream.end()
        if record:
            with pytest.raises(gleaner.Cancelled):
                policy.close("success")
        else:
            assert policy.close("success") == ""
    with pytest.raises(ZeroDivisionError), gleaner.Policy(client, "d", record=True) as policy:  # noqa: PT012
        policy(SEEN)
        assert policy._session is not None
        policy._session._stream.end()
        raise ZeroDivisionError


def test_lost_session_raises_and_is_not_restarted(play: Start) -> None:
    lost = pb.SessionResponse(closed=pb.SessionClosed())
    shown, client = play(lambda number, seen: lost if number == 1 else action(1.0)(number, seen))
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        with pytest.raises(gleaner.Unavailable, match="the server has stopped"):
            policy(SEEN)
        assert len(shown.opened) == 1
        # The next call is the first of another episode.
        assert policy(SEEN) == [1.0]
        assert shown.heard[-1].stamp_ns == 0
        assert not shown.heard[-1].executed_action


def test_silent_server_raises_after_the_time_limit(play: Start) -> None:
    silent = threading.Event()

    def answer(number: int, seen: pb.Observation) -> pb.SessionResponse:
        silent.wait(10)
        return action(1.0)(number, seen)

    _, client = play(answer)
    policy = gleaner.Policy(client, "d", timeout=0.2)
    with pytest.raises(gleaner.DeadlineExceeded, match=r"did not answer within 0\.2 s"):
        policy(SEEN)
    silent.set()
    policy.close()
