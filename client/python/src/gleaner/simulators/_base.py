"""What a simulator gives, by its own names, and the adapter to the names and sizes of a task. Knows no simulator."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gleaner.errors import invalid
from gleaner.evaluation import Adapter
from gleaner.observation import size
from gleaner.policy import other_rate
from gleaner.types import CameraSpec, TaskSpec

if TYPE_CHECKING:
    from gleaner.simulators._vector import SimulatorVector


@dataclass(frozen=True)
class Camera:
    """A camera to render, by the simulator's name."""

    name: str
    height: int
    width: int
    depth: bool = False


@dataclass(frozen=True)
class Seen:
    """One observation, by the simulator's names."""

    values: Mapping[str, NDArray[Any]]
    images: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)  # height × width × RGB
    depth: Mapping[str, NDArray[np.uint16]] = field(default_factory=dict)  # height × width, mm


class Simulator(abc.ABC):
    """One environment, in the form of Gymnasium: a seed is always the same episode, and `info` has `success`."""

    name: str  # as results are reported, robosuite/Lift for example
    low: NDArray[np.float32]  # of an action
    high: NDArray[np.float32]
    rate_hz: float | None = None  # at which it takes actions; None: unknown, and not compared with the task's
    rate_option: str = ""  # which option changes it, with {hz:g} for the rate

    @abc.abstractmethod
    def reset(self, *, seed: int | None = None) -> tuple[Seen, dict[str, Any]]:
        """Starts the episode of a seed."""

    @abc.abstractmethod
    def step(self, action: NDArray[np.float32], /) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Acts for one control period: observation, reward, terminated, truncated, info."""

    @abc.abstractmethod
    def close(self) -> None:
        """Frees what renders."""


class SimulatorAdapter(Adapter):
    """The task's cameras and fields by the names of a simulator: the same names, unless the mappings give others."""

    def __init__(self, cameras: Mapping[str, str] | None = None, fields: Mapping[str, str] | None = None) -> None:
        self._cameras, self._fields = dict(cameras or {}), dict(fields or {})

    def wanted(self, spec: TaskSpec) -> list[Camera]:
        """The cameras to render for a task, at the size of its recordings."""
        _known("camera", self._cameras, [camera.name for camera in spec.cameras])
        _known("field", self._fields, [one.name for one in spec.proprioception])
        return [self._camera(camera) for camera in spec.cameras]

    def check(self, env: Simulator | SimulatorVector, spec: TaskSpec) -> None:
        """Raises `InvalidArgument` if the simulator moves at another rate than the task."""
        if env.rate_hz is None or not other_rate(env.rate_hz, spec):
            return
        fix = f"; change it with {env.rate_option.format(hz=spec.rate_hz)}" if env.rate_option else ""
        raise invalid(
            "rate_hz", f"{env.name} takes actions at {env.rate_hz:g} Hz, the task's are at {spec.rate_hz:g} Hz{fix}"
        )

    def cameras(self, env: Any, observation: Seen) -> Mapping[str, NDArray[np.uint8]]:
        """The task's pictures. They come first of an observation: none is sent from a simulator of another rate."""
        self.check(env, self.spec)
        return {camera.name: observation.images[self._of(camera)] for camera in self.spec.cameras}

    def depth(self, env: Any, observation: Seen) -> Mapping[str, NDArray[np.uint16]]:
        """The task's depth pictures."""
        return {camera.name: observation.depth[self._of(camera)] for camera in self.spec.cameras if camera.depth}

    def proprioception(self, env: Any, observation: Seen) -> NDArray[np.float32]:
        """The task's fields, one after the other."""
        fields = [self._field(one.name, one.size, observation) for one in self.spec.proprioception]
        return np.concatenate([np.empty(0, np.float32), *fields])

    def action(self, env: Simulator | SimulatorVector, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """The action within the simulator's bounds."""
        if len(env.low) != size(self.spec.action):
            raise invalid("action", f"{env.name} takes {len(env.low)} values, the task has {size(self.spec.action)}")
        return np.clip(action, env.low, env.high)

    def executed(self, env: Simulator | SimulatorVector, action: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """The action within the simulator's bounds, where the policy's is outside of them."""
        within = self.action(env, action)
        return None if np.array_equal(within, action) else within

    def _camera(self, camera: CameraSpec) -> Camera:
        # The server crops and resizes pictures of the recorded size, as it does those of recordings.
        recorded = camera.recorded if camera.HasField("recorded") else camera
        return Camera(self._of(camera), recorded.height, recorded.width, camera.depth)

    def _of(self, camera: CameraSpec) -> str:
        return self._cameras.get(camera.name, camera.name)

    def _field(self, name: str, length: int, observation: Seen) -> NDArray[np.float32]:
        source = self._fields.get(name, name)
        if source not in observation.values:
            offered = ", ".join(f"{key} [{np.size(value)}]" for key, value in sorted(observation.values.items()))
            raise invalid(
                f"field {name}", f"the simulator has no {source!r}; name one with --field {name}=…: {offered}"
            )
        values = np.asarray(observation.values[source], np.float32).reshape(-1)
        if len(values) != length:
            raise invalid(f"field {name}", f"{source} has {len(values)} values, the task has {length}")
        return values


def _known(kind: str, given: Mapping[str, str], names: list[str]) -> None:
    for name in given:
        if name not in names:
            raise invalid(f"{kind} {name}", f"the task has none of this name; it has {', '.join(names)}")
