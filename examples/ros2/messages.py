"""Values and pictures of ROS 2 messages, by the paths of a task's mapping. Depends on numpy alone, not on ROS."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

PART = re.compile(r"(?P<name>[A-Za-z_]\w*)(?:\[(?P<first>\d+)(?::(?P<end>\d+))?\])?")
# The header that image transport puts before the PNG of a compressed depth image.
DEPTH_HEADER = 12
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


class Unfit(ValueError):
    """A message is not what the mapping says: names the path and what was expected."""


def read(message: Any, paths: Sequence[str], names: Sequence[str]) -> list[float]:
    """The numbers at some paths, one after the other; with names, those of arrays with a `name` beside them."""
    found: list[float] = []
    for path in paths:
        holder, last = _holder(message, path)
        values = _part(holder, last)
        if names:
            known = [*_attribute(holder, "name", path)]
            missing = [name for name in names if name not in known]
            if missing:
                raise Unfit(f"{path}: the message has no {missing[0]}; it names {', '.join(known) or 'nothing'}")
            places = [known.index(name) for name in names]
            if max(places) >= len(values):
                raise Unfit(f"{path}: expected a value for each of {len(known)} names, got {len(values)}")
            values = [values[place] for place in places]
        found += [float(value) for value in np.ravel(values)]
    return found


def missing(message: Any, paths: Sequence[str], names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Those of the names that are not beside one of the paths, and those that are there.

    None is missing beside a path without an array `name`, or one that does not exist: `read` refuses both.
    """
    for path in paths if names else ():
        try:
            known = getattr(_holder(message, path)[0], "name", None)
        except Unfit:
            continue
        known = [*known] if hasattr(known, "__iter__") else [*names]
        if lacking := [name for name in names if name not in known]:
            return lacking, known
    return [], []


def add_names(message: Any, names: Sequence[str], paths: Sequence[str]) -> None:
    """Appends those of the names that are not beside the paths yet."""
    for path in paths if names else ():
        holder, _ = _holder(message, path)
        known = [*_attribute(holder, "name", path)]
        holder.name = known + [name for name in dict.fromkeys(names) if name not in known]


def write(message: Any, paths: Sequence[str], names: Sequence[str], values: Sequence[float]) -> None:
    """The reverse of `read`: puts numbers into a message, with names beside those that are in it already.

    Each array that is written has a number for each name beside it: NaN where no value was given.
    """
    left = [float(value) for value in values]
    add_names(message, names, paths)
    for path in paths:
        holder, last = _holder(message, path)
        match = _match(last)
        before = _attribute(holder, match["name"], path)
        if names:
            count = len(names)
            if len(left) < count:
                raise Unfit(f"{path}: expected a value for each of {count} names, got {len(left)}")
            places = [holder.name.index(name) for name in names]
            setattr(holder, match["name"], _placed(before, int(match["first"] or 0), places, left, len(holder.name)))
        elif match["first"] is None:
            whole = hasattr(before, "__len__")
            count = len(left) if whole else 1
            setattr(holder, match["name"], left[:count] if whole else left[0])
        else:
            first, end = int(match["first"]), int(match["end"] or int(match["first"]) + 1)
            count = end - first
            array = [*before]
            array += [0.0] * (end - len(array))
            array[first:end] = left[:count]
            setattr(holder, match["name"], array)
        left = left[count:]
    if left:
        raise Unfit(f"{', '.join(paths)}: {len(left)} values more than the paths take")


# Encodings of color: the bytes of a pixel, and the places of red, green and blue; 8UC3 and 8UC4 are in the order of
# OpenCV. And encodings of depth. The same ones, by the same rules, are read from recordings.
RGB, BGR, GRAY = (0, 1, 2), (2, 1, 0), (0, 0, 0)
COLORS = {
    "rgb8": (3, RGB),
    "bgr8": (3, BGR),
    "8UC3": (3, BGR),
    "rgba8": (4, RGB),
    "bgra8": (4, BGR),
    "8UC4": (4, BGR),
    "mono8": (1, GRAY),
    "8UC1": (1, GRAY),
}
DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def picture(message: Any) -> np.ndarray | bytes:
    """The picture of an Image or CompressedImage as gleaner takes it: RGB, 16-bit millimetres, or its bytes."""
    if hasattr(message, "format"):
        return _compressed(message.format, bytes(message.data))
    if message.encoding in COLORS:
        channels, order = COLORS[message.encoding]
        return np.ascontiguousarray(_pixels(message, "u1", channels)[..., order])
    if message.encoding not in DEPTHS:
        raise Unfit(f"encoding {message.encoding} is unknown; supported: {', '.join([*COLORS, *DEPTHS])}")
    kind = DEPTHS[message.encoding]
    pixels = _pixels(message, kind, 1)[..., 0]
    if kind == "f4":
        metres = np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0)
        # To the nearest millimetre, as from recordings.
        return np.floor((metres * 1000).astype(np.float64) + 0.5).clip(0, 65535).astype(np.uint16)
    return pixels.astype(np.uint16)


def _pixels(message: Any, kind: str, channels: int) -> np.ndarray:
    """The numbers of an Image, height × width × channels, without the padding of its rows."""
    height, width = message.height, message.width
    row = width * channels * np.dtype(kind).itemsize
    # A step of 0 is unset: the rows have no padding. The last row needs none in any case.
    step = message.step or row
    needed = (height - 1) * step + row
    data = bytes(message.data)
    if height == 0 or row == 0 or step < row or len(data) < needed:
        raise Unfit(
            f"{message.encoding} of {height}×{width}: expected {height} rows of at least {row} bytes, got {len(data)} "
            f"bytes with rows of {step}"
        )
    # Every row ends within the data, as checked above.
    rows = np.lib.stride_tricks.as_strided(np.frombuffer(data, np.uint8), (height, row), (step, 1))
    order = ">" if message.is_bigendian else "<"
    return np.ascontiguousarray(rows).view(f"{order}{kind}").reshape(height, width, channels)


def _compressed(kind: str, data: bytes) -> bytes:
    encoding, depth, codec = kind.partition("compressedDepth")
    if not depth:
        return data
    # Drivers fill in any codec, with or without the header: a PNG is one.
    image = data if data.startswith(PNG_MAGIC) else data[DEPTH_HEADER:]
    if encoding.startswith("32FC1") or (codec.strip() == "rvl" and not image.startswith(PNG_MAGIC)):
        raise Unfit(f"format {kind!r} is not supported; publish 16UC1 as png, or the depth as sensor_msgs/msg/Image")
    return image


def _placed(before: Any, first: int, places: Sequence[int], values: Sequence[float], names: int) -> list[float]:
    # The array that begins at `first`, with a number for each of the message's names.
    array = [*before]
    array += [math.nan] * (first + names - len(array))
    for place, value in zip(places, values, strict=False):
        array[first + place] = value
    return array


def _match(part: str) -> re.Match[str]:
    match = PART.fullmatch(part)
    if match is None:
        raise Unfit(f"path {part!r}: expected a.b, a.b[2] or a.b[0:9]")
    return match


def _part(holder: Any, part: str) -> Any:
    match = _match(part)
    value = _attribute(holder, match["name"], part)
    if match["first"] is None:
        return value
    first, end = int(match["first"]), match["end"]
    if len(value) < (int(end) if end else first + 1):
        raise Unfit(f"path {part!r}: the message has {len(value)} values")
    return value[first : int(end)] if end else value[first]


def _attribute(holder: Any, name: str, path: str) -> Any:
    if not hasattr(holder, name):
        raise Unfit(f"path {path!r}: {type(holder).__name__} has no {name}")
    return getattr(holder, name)


def _holder(message: Any, path: str) -> tuple[Any, str]:
    # The message that has the path's last part, and that part.
    *way, last = path.split(".")
    for part in way:
        message = _part(message, part)
    return message, last
