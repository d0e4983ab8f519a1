"""A policy's time limits while its server is silent or slow (`fake_server`), and the actions that it then reports."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gleaner
from fake_server import SEEN, Answer, Start, action, missed
from gleaner._proto.v1 import policy_pb2 as pb
from test_policy import observation
from test_ros2_node import Robot


@pytest.fixture
def silent() -> Iterator[threading.Event]:
    """Ends the silence of a server when set."""
    event = threading.Event()
    yield event
    event.set()


def after(first: Answer, silence: threading.Event) -> Answer:
    """Answers the first observation, and each later one with its number once the silence has ended."""

    def answer(number: int, seen: pb.Observation) -> pb.SessionResponse:
        if number == 0:
            return first(number, seen)
        silence.wait(20)
        return action(float(number))(number, seen)

    return answer


def executed(heard: list[pb.Observation]) -> list[list[float]]:
    return [list(seen.executed_action) for seen in heard]


def slow(seconds: float) -> Callable[[], None]:
    return lambda: time.sleep(seconds)


def test_silent_server_is_a_missed_deadline_and_the_session_continues(play: Start, silent: threading.Event) -> None:
    shown, client = play(after(action(8.0, 9.0), silent))
    with gleaner.Policy(client, "d", deadline=0.2) as policy:
        policy.open()
        assert policy(SEEN) == [8.0]
        begun = time.monotonic()
        assert policy(SEEN) == [9.0], "of the chunk that covers the step"
        with pytest.raises(gleaner.Missed, match=r"deployment d: no reply within 0\.3 s"):
            policy(SEEN)
        assert time.monotonic() - begun < 5
        assert policy.missed == 2
        silent.set()
        # The late answers to the two before are skipped.
        assert policy(SEEN) == [3.0]
    assert len(shown.opened) == 1
    assert executed(shown.heard) == [[], [8.0], [9.0], [9.0]]


def test_server_that_is_silent_for_the_timeout_ends_the_session(play: Start, silent: threading.Event) -> None:
    _, client = play(after(action(8.0), silent))
    policy = gleaner.Policy(client, "d", deadline=0.2, timeout=0.8)
    policy.open()
    policy(SEEN)
    for _ in range(2):
        with pytest.raises(gleaner.Missed):
            policy(SEEN)
    with pytest.raises(gleaner.DeadlineExceeded, match=r"did not answer within 0\.8 s"):
        policy(SEEN)
    assert policy._session is None


def test_lost_session_is_an_error_despite_a_deadline(play: Start) -> None:
    lost = pb.SessionResponse(closed=pb.SessionClosed())
    _, client = play(lambda number, seen: lost if number == 1 else action(1.0)(number, seen))
    policy = gleaner.Policy(client, "d", deadline=20.0)
    policy.open()
    policy(SEEN)
    with pytest.raises(gleaner.Unavailable, match="the server has stopped"):
        policy(SEEN)


def test_newest_observation_replaces_those_that_a_stalled_connection_has_not_sent(
    play: Start, silent: threading.Event
) -> None:
    shown, client = play(after(action(8.0), silent))
    # More than the connection takes while the server reads none.
    large = {**SEEN, "images": {"top": bytes(3 << 20)}}
    with gleaner.Policy(client, "d", deadline=20.0) as policy:
        policy.open()
        policy(SEEN)
        patient, policy._limits = policy._limits, replace(policy._limits, deadline=0.02)
        for _ in range(12):
            with pytest.raises(gleaner.Missed):
                policy(large)
        policy._limits = patient
        silent.set()
        policy(SEEN)
    assert len(shown.heard) < 12
    assert sum(1 + seen.skipped_steps for seen in shown.heard) == 14, "the others are skipped steps"


def test_observation_older_than_its_session_is_not_sent_by_a_robot(play: Start) -> None:
    shown, client = play(action(1.0))
    shown.opening = slow(0.3)
    with gleaner.Policy(client, "d", deadline=20.0) as policy:
        with pytest.raises(gleaner.Missed, match=r"the session was opened meanwhile.*; send the newest observation"):
            policy(SEEN)
        assert policy.missed == 1
        assert shown.heard == []
        assert policy({**SEEN, "proprioception": [7.0]}) == [1.0]
    assert [seen.proprioception[0] for seen in shown.heard] == [7.0]


def test_observation_of_a_simulator_waits_for_its_session(play: Start) -> None:
    shown, client = play(action(1.0))
    shown.opening = slow(0.3)
    with gleaner.Policy(client, "d") as policy:
        assert policy(SEEN) == [1.0]
        policy.reset()
        assert policy(SEEN) == [1.0]


def test_rows_send_no_observation_older_than_a_session_of_theirs(play: Start) -> None:
    shown, client = play(action(1.0))
    with gleaner.VectorPolicy(client, "d", 2, deadline=20.0) as policy:
        policy.open()
        policy.reset(1)
        shown.opening = slow(0.3)
        with pytest.raises(gleaner.Missed, match="the session was opened meanwhile"):
            policy([SEEN, SEEN])
        assert shown.heard == []
        assert policy([SEEN, SEEN]).tolist() == [[1.0], [1.0]]


def test_held_action_is_repeated_and_reported(play: Start) -> None:
    shown, client = play(lambda number, seen: (action(5.0) if number == 0 else missed)(number, seen))
    with gleaner.Policy(client, "d", hold=60.0) as policy:
        assert [policy(SEEN).tolist() for _ in range(3)] == [[5.0]] * 3
        assert policy.missed == 2
    assert executed(shown.heard) == [[], [5.0], [5.0]]


def test_held_action_is_repeated_for_its_time_only(play: Start) -> None:
    _, client = play(lambda number, seen: (action(5.0) if number == 0 else missed)(number, seen))
    with gleaner.Policy(client, "d", hold=0.1) as policy:
        policy(SEEN)
        time.sleep(0.2)
        with pytest.raises(gleaner.Missed, match=r"no action by the deadline; there is no action of the last 0\.1 s"):
            policy(SEEN)
    with pytest.raises(gleaner.InvalidArgument, match="hold: -1: must be from 0"):
        gleaner.Policy(client, "d", hold=-1.0)


def test_missed_first_action_raises_even_with_hold(play: Start) -> None:
    _, client = play(missed)
    with gleaner.Policy(client, "d", hold=60.0) as policy, pytest.raises(gleaner.Missed, match="to repeat"):
        policy(SEEN)


def test_row_that_misses_holds_and_the_others_keep_their_actions(play: Start) -> None:
    def answer(number: int, seen: pb.Observation) -> pb.SessionResponse:
        late = number == 1 and seen.proprioception[0] == 0
        return missed(number, seen) if late else action(10.0 * number + seen.proprioception[0])(number, seen)

    _, client = play(answer)
    rows: list[dict[str, Any]] = [{**SEEN, "proprioception": [row]} for row in range(2)]
    with gleaner.VectorPolicy(client, "d", 2, hold=60.0) as policy:
        assert [policy(rows).tolist() for _ in range(3)] == [[[0.0], [1.0]], [[0.0], [11.0]], [[20.0], [21.0]]]


def test_discarded_action_is_not_reported(play: Start) -> None:
    shown, client = play(lambda number, seen: action(float(number))(number, seen))
    with gleaner.Policy(client, "d") as policy:
        policy(SEEN)
        policy(SEEN)
        policy.discard_action()
        policy(SEEN)
        policy({**SEEN, "executed_action": [7.0]})
        policy.discard_action()
        policy(SEEN)
    assert executed(shown.heard) == [[], [0.0], [0.0], [7.0], [7.0]]
    assert len(shown.opened) == 1


def test_episode_whose_first_action_is_discarded_begins_again(play: Start) -> None:
    shown, client = play(action(1.0))
    with gleaner.Policy(client, "d") as policy:
        policy.discard_action()
        policy(SEEN)
        policy.discard_action()
        policy(SEEN)
        assert policy.policy_id == "pol_2"
    assert [seen.stamp_ns for seen in shown.heard] == [0, 0]
    assert executed(shown.heard) == [[], []]


def test_ros2_node_does_not_report_an_action_that_came_too_late(
    client: gleaner.Client, deployment: str, monotonic: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(client, monkeypatch, max_age=0.5)
    robot.node.discover()
    answer, took = robot.policy._answer, iter([0.6, 0.0])

    def slow_answer() -> gleaner.Chunk:
        monotonic[0] += next(took)
        return answer()

    monkeypatch.setattr(robot.policy, "_answer", slow_answer)
    for seed in range(2):
        robot.see(observation(robot.spec, seed))
        robot.node.step()
    with gleaner.Policy(client, deployment) as policy:
        np.testing.assert_allclose(robot.commands(), [policy(observation(robot.spec, 1))], atol=1e-6)
    robot.node.end()


def test_opening_and_storing_may_take_longer_than_an_answer(play: Start) -> None:
    shown, client = play(action(1.0))
    shown.opening = shown.closing = slow(0.5)
    with gleaner.Policy(client, "d", record=True, timeout=0.2) as policy:
        assert policy(SEEN) == [1.0]
        assert policy.close("success") == "ep_1"


def test_close_that_takes_too_long_names_the_recording(play: Start) -> None:
    shown, client = play(action(1.0))
    shown.closing = slow(0.5)
    policy = gleaner.Policy(client, "d", record=True, close_timeout=0.2)
    policy(SEEN)
    with pytest.raises(gleaner.DeadlineExceeded, match=r"session ses_1: .* continues to store .* ses_1\.mcap"):
        policy.close("success")


def test_opening_that_takes_too_long_names_the_deployment(play: Start) -> None:
    shown, client = play(action(1.0))
    shown.opening = slow(0.5)
    policy = gleaner.Policy(client, "d", open_timeout=0.2)
    with pytest.raises(gleaner.DeadlineExceeded, match=r"deployment d: no session was opened within 0\.2 s"):
        policy(SEEN)
