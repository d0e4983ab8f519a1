"""Proprioception by name, checked against a task without a server."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gleaner
from gleaner._messages import build
from gleaner.observation import to_wire
from gleaner.types import TaskSpec

SPEC = build(
    TaskSpec,
    {
        "name": "pour",
        "rate_hz": 10.0,
        "proprioception": [{"name": "joints", "size": 2}, {"name": "gripper", "size": 1}],
        "action": [{"name": "delta", "size": 3}],
        "mappings": [
            {
                "name": "ros2",
                "fields": [
                    {"field": "joints", "topic": "/joints", "paths": ["position"], "names": ["elbow", "wrist"]},
                    {"field": "gripper", "topic": "/gripper", "paths": ["data"]},
                ],
            }
        ],
    },
)


def sent(proprioception: Any) -> list[float]:
    """The values as they are sent."""
    message = to_wire(gleaner.Observation(images={}, proprioception=proprioception), SPEC, 0)
    return list(message.proprioception)


def test_values_by_name_are_sent_in_the_order_of_the_task() -> None:
    assert sent([1, 2, 3]) == [1, 2, 3]
    assert sent({"gripper": 3, "joints": np.array([1, 2])}) == [1, 2, 3]
    assert sent({"gripper": [3], "joints": {"wrist": 2, "elbow": 1}}) == [1, 2, 3]


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
