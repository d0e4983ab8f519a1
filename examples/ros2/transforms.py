"""Poses of frames from a robot's transforms, as gleaner reads them from recordings. Depends on nothing, not on ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from messages import Unfit

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Frames from one to the root of its tree.
MAX_DEPTH = 256


@dataclass(frozen=True)
class Pose:
    """Where a frame is in another, and how it is turned (x, y, z, w)."""

    place: Vector = (0.0, 0.0, 0.0)
    turn: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def then(self, inner: Pose) -> Pose:
        """The pose in this one's frame of what has the pose `inner` in this one."""
        x, y, z = _rotated(self.turn, inner.place)
        place = (self.place[0] + x, self.place[1] + y, self.place[2] + z)
        return Pose(place, _product(self.turn, inner.turn))

    def inverse(self) -> Pose:
        """The pose of the other frame in this one."""
        turn = _conjugate(self.turn)
        x, y, z = _rotated(turn, self.place)
        return Pose((-x, -y, -z), turn)


@dataclass(frozen=True)
class _Link:
    parent: str
    pose: Pose
    # When it came; None for one that never changes.
    time: float | None


class Tree:
    """The newest transform of each frame in its parent."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def update(self, message: Any, time: float | None) -> None:
        """Takes the transforms of a message that came at `time`; None: they never change. Raises `Unfit`."""
        try:
            links = [_link(one, time) for one in (message.transforms if hasattr(message, "transforms") else [message])]
        except AttributeError as error:
            raise Unfit(f"{type(message).__name__} is no message of transforms: {error}") from None
        self._links.update(link for link in links if link is not None)

    def pose(self, parent: str, child: str) -> tuple[list[float], float]:
        """Seven numbers, x, y, z and the quaternion, and the time of their last change. Raises `Unfit`."""
        own, others = self._ancestors(_bare(child)), self._ancestors(_bare(parent))
        common = next((frame for frame in own if frame in others), None)
        if common is None:
            raise Unfit(f"no transforms connect {child} with {parent}")
        own, others = own[: own.index(common)], others[: others.index(common)]
        times = [self._links[frame].time for frame in (*own, *others)]
        found = self._among(others).inverse().then(self._among(own))
        return [*found.place, *found.turn], max((time for time in times if time is not None), default=-math.inf)

    def _among(self, frames: list[str]) -> Pose:
        found = Pose()
        for frame in frames:
            found = self._links[frame].pose.then(found)
        return found

    def _ancestors(self, frame: str) -> list[str]:
        found = [frame]
        while (link := self._links.get(found[-1])) and link.parent not in found and len(found) <= MAX_DEPTH:
            found.append(link.parent)
        return found


def _link(one: Any, time: float | None) -> tuple[str, _Link] | None:
    """A frame with its place; None without a rotation."""
    moved, turned = one.transform.translation, one.transform.rotation
    length = math.hypot(turned.x, turned.y, turned.z, turned.w)
    if not length > 0:
        return None
    turn = (turned.x / length, turned.y / length, turned.z / length, turned.w / length)
    return _bare(one.child_frame_id), _Link(_bare(one.header.frame_id), Pose((moved.x, moved.y, moved.z), turn), time)


def _bare(frame: str) -> str:
    return frame.removeprefix("/")


def _conjugate(turn: Quaternion) -> Quaternion:
    x, y, z, w = turn
    return (-x, -y, -z, w)


def _product(one: Quaternion, other: Quaternion) -> Quaternion:
    (ax, ay, az, aw), (bx, by, bz, bw) = one, other
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _rotated(turn: Quaternion, place: Vector) -> Vector:
    x, y, z, _ = _product(_product(turn, (*place, 0.0)), _conjugate(turn))
    return (x, y, z)
