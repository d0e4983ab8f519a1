"""Whether a robot's features fit the task of a deployment. Must not depend on a connection or on LeRobot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .names import IMAGE, IMAGES, STATE


def cameras(task: Any, keys: list[str], renamed: Mapping[str, str]) -> dict[str, str]:
    """The key of the batch for each of the task's cameras, among the image keys of a batch.

    `renamed` has the task's camera for some of the robot's. Raises ValueError that names what is missing and what is
    there.
    """
    deep = [camera.name for camera in task.cameras if camera.depth]
    if deep:
        raise ValueError(
            f"camera {deep[0]} of task {task.name} has depth, which LeRobot's policies do not receive; train on a task "
            "without it"
        )
    theirs = {key.removeprefix(IMAGES): key for key in keys if key.startswith(IMAGES)}
    if IMAGE in keys:
        theirs["image"] = IMAGE
    unknown = [name for name in renamed if name not in theirs]
    if unknown:
        raise ValueError(f"policy.cameras.{unknown[0]}: the robot has no such camera; it has {_list(theirs)}")
    chosen: dict[str, str] = {}
    for name, camera in renamed.items():
        if camera in chosen:
            raise ValueError(f"policy.cameras.{name}: {camera} is given to {chosen[camera]} too; keep one of them")
        chosen[camera] = name
    # What is given wins over a camera of an equal name.
    equal = {name: key for name, key in theirs.items() if name not in renamed}
    ours = equal | {camera: theirs[name] for camera, name in chosen.items()}
    wanted = [camera.name for camera in task.cameras]
    if len(wanted) == 1 and len(theirs) == 1 and not renamed:
        # One camera on either side is the same camera, whatever its names.
        return {wanted[0]: next(iter(theirs.values()))}
    missing = [name for name in wanted if name not in ours]
    if missing:
        raise ValueError(
            f"camera {missing[0]} of task {task.name}: the robot has {_list(theirs)}; name the one to use, such as "
            f'--policy.cameras=\'{{"{next(iter(theirs), "front")}": "{missing[0]}"}}\''
        )
    return {name: ours[name] for name in wanted}


def sizes(task: Any, state: int | None, action: int | None) -> None:
    """Compares numbers of values. Raises ValueError; None is not compared."""
    for name, key, fields, found in (
        ("proprioception", STATE, task.proprioception, state),
        ("action", "action", task.action, action),
    ):
        expected = sum(field.size for field in fields)
        if found is not None and found != expected:
            listed = ", ".join(f"{field.name} ({field.size})" for field in fields)
            raise ValueError(
                f"{key}: the robot has {found} values, {name} of task {task.name} has {expected}: {listed}"
            )


def _list(names: Mapping[str, object]) -> str:
    return ", ".join(sorted(names)) or "none"
