"""Robots that fit a task, and refusals that name what does not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from lerobot_policy_gleaner import task_match


def task(*cameras: str, depth: bool = False) -> Any:
    return SimpleNamespace(
        name="stack",
        cameras=[SimpleNamespace(name=name, depth=depth) for name in cameras],
        proprioception=[SimpleNamespace(name="joints", size=6)],
        action=[SimpleNamespace(name="goal", size=5), SimpleNamespace(name="gripper", size=1)],
    )


def test_cameras_are_matched_by_name_or_by_setting() -> None:
    keys = ["observation.images.front", "observation.images.hand", "observation.state", "task"]
    assert task_match.cameras(task("hand", "front"), keys, {}) == {
        "hand": "observation.images.hand",
        "front": "observation.images.front",
    }
    assert task_match.cameras(task("hand", "table"), keys, {"front": "table"})["table"] == "observation.images.front"
    assert task_match.cameras(task("hand"), keys, {}) == {"hand": "observation.images.hand"}


def test_a_given_camera_wins_over_one_of_the_same_name() -> None:
    keys = ["observation.images.front", "observation.images.hand"]
    for order in (keys, keys[::-1]):
        assert task_match.cameras(task("hand"), order, {"front": "hand"}) == {"hand": "observation.images.front"}
    swapped = task_match.cameras(task("hand", "front"), keys, {"front": "hand", "hand": "front"})
    assert swapped == {"hand": "observation.images.front", "front": "observation.images.hand"}


def test_a_camera_that_is_given_twice_is_named() -> None:
    keys = ["observation.images.front", "observation.images.hand"]
    with pytest.raises(ValueError, match=r"policy\.cameras\.hand: top is given to front too; keep one of them"):
        task_match.cameras(task("top"), keys, {"front": "top", "hand": "top"})


def test_single_cameras_need_no_name() -> None:
    assert task_match.cameras(task("top"), ["observation.image"], {}) == {"top": "observation.image"}


def test_cameras_that_do_not_match_are_named() -> None:
    keys = ["observation.images.front", "observation.images.hand"]
    with pytest.raises(ValueError, match=r"camera table of task stack: the robot has front, hand; name the one to use"):
        task_match.cameras(task("hand", "table"), keys, {})
    with pytest.raises(ValueError, match=r"policy\.cameras\.side: the robot has no such camera; it has front, hand"):
        task_match.cameras(task("hand"), keys, {"side": "hand"})
    with pytest.raises(ValueError, match=r"the robot has none"):
        task_match.cameras(task("hand"), ["observation.state"], {})
    with pytest.raises(ValueError, match=r"camera hand of task stack has depth"):
        task_match.cameras(task("hand", "front", depth=True), keys, {})
    with pytest.raises(ValueError, match=r"camera top of task stack has depth"):
        task_match.cameras(task("top", depth=True), ["observation.image"], {})


def test_sizes_that_do_not_match_are_named() -> None:
    task_match.sizes(task(), 6, 6)
    task_match.sizes(task(), None, None)
    with pytest.raises(ValueError, match=r"observation\.state: the robot has 7 values, .* has 6: joints \(6\)"):
        task_match.sizes(task(), 7, 6)
    with pytest.raises(ValueError, match=r"action: the robot has 7 values, .* goal \(5\), gripper \(1\)"):
        task_match.sizes(task(), 6, 7)
