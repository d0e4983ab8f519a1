"""Proprioception by name, checked against a task without a server."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gleaner
from gleaner._messages import build
from gleaner.observation import to_wire
from gleaner.types import TaskSpec


def task(size: int, *joints: dict[str, Any]) -> TaskSpec:
    """A task with joints, which each mapping takes from other places, and a gripper."""
    gripper = {"field": "gripper", "topic": "/gripper", "paths": ["data"]}
    return build(
        TaskSpec,
        {
            "name": "pour",
            "rate_hz": 10.0,
            "proprioception": [{"name": "joints", "size": size}, {"name": "gripper", "size": 1}],
            "action": [{"name": "delta", "size": 3}],
            "mappings": [
                {"name": f"way_{at}", "fields": [{"field": "joints", "topic": "/joints", **source}, gripper]}
                for at, source in enumerate(joints)
            ],
        },
    )


SPEC = task(2, {"paths": ["position"], "names": ["elbow", "wrist"]})


def sent(proprioception: Any, spec: TaskSpec = SPEC) -> list[float]:
    """The values as they are sent."""
    message = to_wire(gleaner.Observation(images={}, proprioception=proprioception), spec, 0)
    return list(message.proprioception)


def test_values_by_name_are_sent_in_the_order_of_the_task() -> None:
    assert sent([1, 2, 3]) == [1, 2, 3]
    assert sent({"gripper": 3, "joints": np.array([1, 2])}) == [1, 2, 3]
    assert sent({"gripper": [3], "joints": {"wrist": 2, "elbow": 1}}) == [1, 2, 3]


def test_values_of_several_paths_are_named_by_path_and_name() -> None:
    spec = task(4, {"paths": ["position", "velocity"], "names": ["elbow", "wrist"]})
    joints = {"velocity": {"wrist": 4, "elbow": 3}, "position": {"elbow": 1, "wrist": 2}}
    assert sent({"joints": joints, "gripper": 5}, spec) == [1, 2, 3, 4, 5]
    assert sent({"joints": {**joints, "position": [1, 2]}, "gripper": 5}, spec) == [1, 2, 3, 4, 5]
    for wrong, problem in [
        ({"elbow": 1, "wrist": 2}, r"joints\.elbow: the task has no such name; it has position, velocity"),
        ({"position": {"elbow": 1}, "velocity": [3, 4]}, r"proprioception\.joints\.position\.wrist: is missing"),
        ({"position": [1, 2, 3], "velocity": [3, 4]}, r"joints\.position: expected 2 values, got 3"),
    ]:
        with pytest.raises(gleaner.InvalidArgument, match=problem):
            sent({"joints": wrong, "gripper": 5}, spec)


def test_each_mapping_has_names_of_its_own_and_none_that_contradict() -> None:
    spec = task(2, {"paths": ["q"], "names": ["j1", "j2"]}, {"paths": ["position"], "names": ["elbow", "wrist"]})
    assert sent({"joints": {"j2": 2, "j1": 1}, "gripper": 3}, spec) == [1, 2, 3]
    assert sent({"joints": {"wrist": 2, "elbow": 1}, "gripper": 3}, spec) == [1, 2, 3]
    # The same names in the same order at other places.
    spec = task(2, {"paths": ["q"], "names": ["j1", "j2"]}, {"paths": ["position"], "names": ["j1", "j2"]})
    assert sent({"joints": {"j2": 2, "j1": 1}, "gripper": 3}, spec) == [1, 2, 3]
    two = {"paths": ["position", "velocity"], "names": ["a", "b"]}
    spec = task(4, two, {**two, "names": ["c", "d"]})
    for names in ("ab", "cd"):
        first, second = names
        by_name = {"position": {second: 2, first: 1}, "velocity": [3, 4]}
        assert sent({"joints": by_name, "gripper": 5}, spec) == [1, 2, 3, 4, 5]
    assert sent({"joints": {"velocity": [3, 4], "position": [1, 2]}, "gripper": 5}, spec) == [1, 2, 3, 4, 5]
    spec = task(2, {"paths": ["q"], "names": ["j1", "j2"]}, {"paths": ["q"], "names": ["j2", "j1"]})
    with pytest.raises(
        gleaner.InvalidArgument, match=r"joints: the mappings of the task name these values in different"
    ):
        sent({"joints": {"j2": 2, "j1": 1}, "gripper": 3}, spec)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"joint": [1, 2], "gripper": 3}, r"proprioception\.joint: the task has no such name; it has joints, gripper"),
        ({"joints": [1, 2]}, r"proprioception\.gripper: is missing"),
        ({"joints": [1], "gripper": 3}, r"proprioception\.joints: expected 2 values, got 1"),
        (
            {"joints": {"elbow": 1, "hand": 2}, "gripper": 3},
            r"joints\.hand: the task has no such name; it has elbow, wrist",
        ),
        ({"joints": {"elbow": 1}, "gripper": 3}, r"proprioception\.joints\.wrist: is missing"),
        (
            {"joints": [1, 2], "gripper": {"width": 3}},
            r"proprioception\.gripper: no mapping of the task names its values",
        ),
    ],
)
def test_a_wrong_name_is_refused_with_those_of_the_task(given: Any, problem: str) -> None:
    with pytest.raises(gleaner.InvalidArgument, match=problem):
        sent(given)
