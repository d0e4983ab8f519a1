"""Observations: a robot's data of one step, checked against the task and converted to a message."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gleaner._proto.v1 import policy_pb2 as pb
from gleaner.errors import invalid
from gleaner.types import CameraSpec, FieldSpec, TaskSpec


@dataclass
class Observation:
    """One step. A mapping with the same keys is accepted in its place."""

    images: Mapping[str, NDArray[np.uint8] | bytes]  # camera → height × width × RGB, or JPEG or PNG bytes
    # The task's fields, one after the other, in physical units; or field → values, whose names are checked. Values of a
    # field whose mapping names them, such as joints, may be name → value; with several paths, path → name → value.
    proprioception: ArrayLike | Mapping[str, ArrayLike | Mapping[str, Any]]
    depth: Mapping[str, NDArray[np.uint16] | bytes] = field(default_factory=dict)  # camera → height × width mm, or PNG
    stamp_ns: int | None = None  # None: from the start of the episode, by the control period
    executed_action: ArrayLike | None = None  # executed since the previous step; None: the policy's action
    skipped_steps: int = 0  # control steps since the previous observation for which none was sent

    @classmethod
    def of(cls, given: Observation | Mapping[str, Any]) -> Observation:
        """An observation from itself or from a mapping."""
        if isinstance(given, Observation):
            return given
        try:
            return cls(**given)
        except TypeError as error:
            raise invalid("observation", f"{error}; supported: {', '.join(cls.__dataclass_fields__)}") from None


def size(fields: Iterable[FieldSpec]) -> int:
    """The total number of values of the fields."""
    return sum(field.size for field in fields)


def to_wire(observation: Observation, spec: TaskSpec, stamp_ns: int) -> pb.Observation:
    """The message for an observation. Raises `InvalidArgument` naming the field and the fix."""
    known = {camera.name for camera in spec.cameras}
    for kind, given in (("images", observation.images), ("depth", observation.depth)):
        for name in given:
            if name not in known:
                raise invalid(f"{kind}.{name}", f"the task has no such camera; it has {', '.join(sorted(known))}")
    if not 0 <= observation.skipped_steps < 2**32:
        raise invalid("skipped_steps", f"{observation.skipped_steps}: must be from 0 to 2**32 - 1")
    message = pb.Observation(
        stamp_ns=stamp_ns,
        skipped_steps=observation.skipped_steps,
        cameras=[_camera(camera, observation) for camera in spec.cameras],
        proprioception=_proprioception(observation.proprioception, spec),
    )
    if observation.executed_action is not None:
        message.executed_action.extend(vector("executed_action", observation.executed_action, size(spec.action)))
    return message


def vector(name: str, values: ArrayLike, length: int) -> NDArray[np.float32]:
    """Values as 32-bit numbers, checked for length and finiteness."""
    array = np.asarray(values, np.float32).reshape(-1)
    if len(array) != length:
        raise invalid(name, f"expected {length} values, got {len(array)}")
    if not np.isfinite(array).all():
        place = int(np.flatnonzero(~np.isfinite(array))[0])
        raise invalid(f"{name}[{place}]", f"is {array[place]}, must be finite")
    return array


def _proprioception(given: ArrayLike | Mapping[str, Any], spec: TaskSpec) -> NDArray[np.float32]:
    if not isinstance(given, Mapping):
        return vector("proprioception", given, size(spec.proprioception))
    _check_names("proprioception", given, [field.name for field in spec.proprioception])
    parts = []
    for one in spec.proprioception:
        path, values = f"proprioception.{one.name}", given[one.name]
        if isinstance(values, Mapping):
            values = _by_name(path, values, _names(one, spec))
        parts.append(vector(path, values, one.size))
    return np.concatenate(parts) if parts else np.empty(0, np.float32)


def _names(one: FieldSpec, spec: TaskSpec) -> list[_Names]:
    """The names of a field's values in each mapping that has them."""
    sources = [source for mapping in spec.mappings for source in mapping.fields if source.field == one.name]
    return [_Names(list(source.paths), list(source.names)) for source in sources if source.names]


@dataclass(frozen=True)
class _Names:
    """What a mapping calls the values of a field: for each path, each name."""

    paths: list[str]
    names: list[str]

    def order_of(self, values: Mapping[str, Any]) -> tuple[tuple[str, ...], ...] | None:
        """The order that these names give values in; None if values are given by others."""
        if len(self.paths) == 1:
            return (tuple(self.names),) if set(self.names) == set(values) else None
        named = [inner for inner in values.values() if isinstance(inner, Mapping)]
        if set(self.paths) != set(values) or any(set(inner) != set(self.names) for inner in named):
            return None
        return tuple(self.paths), tuple(self.names) if named else ()

    def ordered(self, path: str, values: Mapping[str, Any]) -> list[float]:
        """The values in the order of the task."""
        if len(self.paths) == 1:
            return self._of_path(path, values)
        _check_names(path, values, self.paths)
        return [value for inner in self.paths for value in self._of_path(f"{path}.{inner}", values[inner])]

    def _of_path(self, path: str, values: Any) -> list[float]:
        if not isinstance(values, Mapping):
            return list(vector(path, values, len(self.names)))
        _check_names(path, values, self.names)
        return [values[name] for name in self.names]


def _by_name(path: str, values: Mapping[str, Any], known: Sequence[_Names]) -> list[float]:
    # Mappings may name the values of a field differently, each in the order of the task.
    if not known:
        raise invalid(path, "no mapping of the task names its values; send them in the order of the task")
    orders = {order: names for names in known if (order := names.order_of(values)) is not None}
    if len(orders) > 1:
        raise invalid(path, "the mappings of the task name these values in different orders; send them without names")
    return next(iter(orders.values()), known[0]).ordered(path, values)


def _check_names(path: str, given: Mapping[str, Any], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise invalid(f"{path}.{name}", f"the task has no such name; it has {', '.join(names)}")
    for name in names:
        if name not in given:
            raise invalid(f"{path}.{name}", "is missing; send every value of the task")


def _camera(camera: CameraSpec, observation: Observation) -> pb.CameraFrame:
    name = camera.name
    if name not in observation.images:
        raise invalid(f"images.{name}", "is missing; send an image of every camera of the task")
    # The size of recordings, which the server crops and resizes, or that of a step.
    recorded = camera.recorded if camera.HasField("recorded") else camera
    sizes = [(recorded.height, recorded.width), (camera.height, camera.width)]
    colors = [(*size, 3) for size in sizes]
    frame = pb.CameraFrame(
        camera=name, color=_image(f"images.{name}", observation.images[name], np.dtype(np.uint8), colors)
    )
    if camera.depth:
        if name not in observation.depth:
            raise invalid(f"depth.{name}", "is missing; the task's camera has depth")
        frame.depth.CopyFrom(_image(f"depth.{name}", observation.depth[name], np.dtype("<u2"), sizes))
    elif name in observation.depth:
        raise invalid(f"depth.{name}", "the task's camera has no depth; leave it out")
    return frame


def _image(path: str, given: NDArray[Any] | bytes, kind: np.dtype[Any], shapes: Sequence[tuple[int, ...]]) -> pb.Image:
    if isinstance(given, bytes):
        return pb.Image(data=given)
    array = np.asarray(given)
    # Never converted implicitly: a float image in [0, 1] would turn black, metres would turn to zero.
    if array.dtype != kind:
        raise invalid(path, f"is of {array.dtype}, must be {kind.name}")
    if array.shape not in shapes:
        raise invalid(path, f"is {_times(array.shape)}, the task has {_times(shapes[0])}")
    return pb.Image(format=pb.IMAGE_FORMAT_RAW, data=array.tobytes())


def _times(shape: tuple[int, ...]) -> str:
    return " × ".join(map(str, shape))
