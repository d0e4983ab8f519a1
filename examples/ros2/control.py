"""What a robot sees and does by a task's mapping, and the watchdog of its actions. Depends on gleaner, not on ROS.

Topics arrive at any rate and from any thread; a step takes the newest message of each camera and of each field.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import messages
import numpy as np
from transforms import Tree

import gleaner

Publish = Callable[[str, Any], None]
# Where ROS has the transforms that never change.
STATIC_TOPIC = "/tf_static"


class Held:
    """The newest message of a topic, or of a field: drivers that share a topic send the values of some fields each."""

    def __init__(self, topic: str, source: Any = None) -> None:
        self.message: Any = None
        self._topic, self._field = topic, source.field if source else ""
        self._paths, self._names = ([*source.paths], [*source.names]) if source else ([], [])
        self._time: float | None = None
        # Of the messages since then that lack names of the field, those of the one with most: missing ones and its own.
        self._without: tuple[list[str], list[str]] | None = None

    def take(self, message: Any, now: float) -> None:
        """Keeps a message that has all names."""
        missing, known = messages.missing(message, self._paths, self._names)
        if not missing:
            self.message, self._time, self._without = message, now, None
        elif self._without is None or len(missing) < len(self._without[0]):
            self._without = missing, known

    def stale(self, now: float, most: float) -> str:
        """Why there is no message within the last `most` seconds; empty if there is one."""
        if self._time is not None and now - self._time <= most:
            return ""
        since = "yet" if self._time is None else f"for {most:g} s"
        if self._without is None:
            return f"no message on {self._topic} {since}"
        (missing, *_), known = self._without
        why = f"one has no {missing}; it names {', '.join(known) or 'nothing'}"
        return f"no message on {self._topic} with the names of {self._field} {since}: {why}"


class Scene:
    """The newest message of each camera and field that the task's mapping names."""

    def __init__(self, spec: gleaner.types.TaskSpec, mapping: str = "") -> None:
        known = {one.name: one for one in spec.mappings}
        if not known or (mapping and mapping not in known):
            raise gleaner.InvalidArgument(f"mapping {mapping!r}: the task has {', '.join(known) or 'no mapping'}")
        self.mapping = known[mapping] if mapping else spec.mappings[0]
        self.spec = spec
        self.fields = {source.field: source for source in self.mapping.fields}
        seen = {field.name for field in spec.proprioception}
        pictures = {topic for source in self.mapping.cameras for topic in (source.color, source.depth) if topic}
        self.observed = pictures | {source.topic for source in self.mapping.fields if source.field in seen}
        self.acted = {self.fields[field.name].topic for field in spec.action}
        for field in spec.action:
            if self.fields[field.name].HasField("transform"):
                raise gleaner.InvalidArgument(f"action {field.name}: a pose from transforms cannot be published")
        poses = [self.fields[name] for name in seen if self.fields[name].HasField("transform")]
        self._trees = {source.topic: Tree() for source in poses}
        # Topics of transforms that never change, with those that use them; a robot may have none.
        self.fixed: dict[str, set[str]] = {}
        for source in poses:
            given = source.transform.HasField("static_topic")
            if topic := source.transform.static_topic if given else STATIC_TOPIC:
                self.fixed.setdefault(topic, set()).add(source.topic)
        # By topic and field; of a topic of pictures or transforms without a field.
        self._held = {(topic, ""): Held(topic) for topic in pictures | self._trees.keys()}
        for source in (self.fields[name] for name in seen):
            if not source.HasField("transform"):
                self._held[source.topic, source.field] = Held(source.topic, source)
        self._lock = threading.Lock()

    @property
    def transforms(self) -> set[str]:
        """The topics of transforms that change."""
        return set(self._trees)

    def arrived(self, topic: str, message: Any, now: float) -> None:
        """Keeps a message; `now` in seconds of a clock that never jumps. Raises `Unfit` if transforms are expected."""
        with self._lock:
            for of in self.fixed.get(topic, ()):
                self._trees[of].update(message, None)
            if topic in self._trees:
                self._trees[topic].update(message, now)
            for (of, _), held in self._held.items():
                if of == topic:
                    held.take(message, now)

    def stale(self, now: float, most: float) -> str:
        """Why there is no step: a camera or field without a message within the last `most` seconds; or empty.

        The text stays the same as time passes.
        """
        with self._lock:
            for _, held in sorted(self._held.items()):
                if why := held.stale(now, most):
                    return why
        for field in self.spec.proprioception:
            source = self.fields[field.name]
            if source.HasField("transform"):
                parent, child = source.transform.parent, source.transform.child
                try:
                    with self._lock:
                        age = now - self._trees[source.topic].pose(parent, child)[1]
                except messages.Unfit as problem:
                    return str(problem)
                if age > most:
                    return f"no transform of {child} in {parent} has changed for {most:g} s"
        return ""

    def observation(self, stamp_ns: int) -> gleaner.Observation:
        """The step of the newest messages. Raises `Unfit` when one is not what the mapping says."""
        with self._lock:
            newest = {of: held.message for of, held in self._held.items()}
        images, depth = {}, {}
        for source in self.mapping.cameras:
            images[source.camera] = _picture(source.color, newest)
            if source.depth:
                depth[source.camera] = _picture(source.depth, newest)
        values: list[float] = []
        for field in self.spec.proprioception:
            source = self.fields[field.name]
            if source.HasField("transform"):
                with self._lock:
                    values += self._trees[source.topic].pose(source.transform.parent, source.transform.child)[0]
            else:
                values += messages.read(newest[source.topic, source.field], source.paths, source.names)
        return gleaner.Observation(images=images, depth=depth, proprioception=values, stamp_ns=stamp_ns)

    def commands(self, action: np.ndarray, made: Callable[[str], Any]) -> Mapping[str, Any]:
        """The messages of an action by topic; `made` returns an empty message for a topic."""
        found: dict[str, Any] = {}
        # First the names of all fields of a message, so that each of its arrays has a place for every one.
        for source in (self.fields[field.name] for field in self.spec.action):
            message = found.setdefault(source.topic, made(source.topic))
            messages.add_names(message, source.names, source.paths)
        at = 0
        for field in self.spec.action:
            source = self.fields[field.name]
            messages.write(found[source.topic], source.paths, source.names, action[at : at + field.size])
            at += field.size
        return found


def _picture(topic: str, newest: Mapping[tuple[str, str], Any]) -> np.ndarray | bytes:
    try:
        return messages.picture(newest[topic, ""])
    except messages.Unfit as problem:
        raise messages.Unfit(f"{topic}: {problem}") from None


class Watchdog:
    """Whether actions still come: after `seconds` without one it trips, until the next action."""

    def __init__(self, seconds: float, now: float) -> None:
        self._seconds, self._last, self._tripped = seconds, now, True
        self._lock = threading.Lock()

    def acted(self, now: float) -> None:
        """An action was published."""
        with self._lock:
            self._last, self._tripped = now, False

    def trips(self, now: float) -> bool:
        """True once for each silence."""
        with self._lock:
            if self._tripped or now - self._last <= self._seconds:
                return False
            self._tripped = True
            return True

    @property
    def active(self) -> bool:
        """Whether actions come."""
        return not self._tripped
