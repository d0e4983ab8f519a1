"""One episode as an MCAP file: images as foxglove.CompressedImage, numbers as JSON. Independent of the simulator."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray
from PIL import Image

STATE_TOPIC = "/arm/state"
ACTION_TOPIC = "/arm/action"
# The date is fixed, so that a seed always gives the same file.
BEGIN_NS = 1_700_000_000_000_000_000

Numbers = Mapping[str, NDArray[np.float32]]


def camera_topic(camera: str) -> str:
    """The topic of a camera's images."""
    return f"/camera/{camera}"


def depth_topic(camera: str) -> str:
    """The topic of a camera's depth."""
    return f"/camera/{camera}/depth"


class Recorder:
    """Writes an episode step by step. The file exists only once it is complete and kept."""

    def __init__(self, part: Path, rate_hz: float, about: Mapping[str, str]) -> None:
        self._part = part
        self._period_ns = round(1e9 / rate_hz)
        self._steps = 0
        self._file = self._part.open("wb")
        # Images are compressed already.
        self._mcap = Writer(self._file, compression=CompressionType.NONE)
        self._mcap.start(library="gleaner simulator example")
        self._mcap.add_metadata("episode", dict(about))
        self._channels: dict[str, int] = {}

    def step(
        self,
        images: Mapping[str, NDArray[np.uint8]],
        depths: Mapping[str, NDArray[np.uint16]],
        state: Numbers,
        action: Numbers,
    ) -> None:
        """Writes one step: the observation, then the action."""
        stamp_ns = BEGIN_NS + self._steps * self._period_ns
        for camera, image in images.items():
            self._picture(camera_topic(camera), stamp_ns, image)
        for camera, depth in depths.items():
            self._picture(depth_topic(camera), stamp_ns, depth)
        self._numbers(STATE_TOPIC, stamp_ns, state)
        self._numbers(ACTION_TOPIC, stamp_ns, action)
        self._steps += 1

    def keep(self, path: Path) -> None:
        """Ends the recording and renames it."""
        self._mcap.finish()
        self._file.close()
        self._part.replace(path)

    def _picture(self, topic: str, stamp_ns: int, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        if topic not in self._channels:
            schema = self._mcap.register_schema(
                CompressedImage.DESCRIPTOR.full_name,
                "protobuf",
                build_file_descriptor_set(CompressedImage).SerializeToString(),
            )
            self._channels[topic] = self._mcap.register_channel(topic, "protobuf", schema)
        # PNG keeps every pixel, so that a policy is trained on the images of its sessions.
        coded = io.BytesIO()
        Image.fromarray(image).save(coded, "PNG")
        stamp = Timestamp()
        stamp.FromNanoseconds(stamp_ns)
        message = CompressedImage(timestamp=stamp, data=coded.getvalue(), format="png", frame_id=topic)
        self._write(topic, stamp_ns, message.SerializeToString())

    def _numbers(self, topic: str, stamp_ns: int, values: Numbers) -> None:
        if topic not in self._channels:
            schema = self._mcap.register_schema(topic.strip("/"), "jsonschema", json.dumps(_schema(values)).encode())
            self._channels[topic] = self._mcap.register_channel(topic, "json", schema)
        sec, nsec = divmod(stamp_ns, 10**9)
        message = {"timestamp": {"sec": sec, "nsec": nsec}, **{name: row.tolist() for name, row in values.items()}}
        self._write(topic, stamp_ns, json.dumps(message).encode())

    def _write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        self._mcap.add_message(self._channels[topic], stamp_ns, data, stamp_ns)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()
        self._part.unlink(missing_ok=True)


def _schema(values: Numbers) -> dict[str, Any]:
    """The JSON schema of messages with these values. Foxglove lists a problem for an object without `properties`."""
    stamp = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    rows = {name: {"type": "array", "items": {"type": "number"}} for name in values}
    return {"type": "object", "properties": {"timestamp": stamp, **rows}}
