"""The recordings of the simulator example: their schemas describe every message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from programs import ROOT

JSON_TYPES = {"object": (dict,), "array": (list,), "integer": (int,), "number": (int, float)}


def expect_described(message: Any, schema: dict[str, Any]) -> None:
    """A message has the types of its schema, and nothing that the schema lacks."""
    assert type(message) in JSON_TYPES[schema["type"]]
    if schema["type"] == "object":
        assert message.keys() == schema["properties"].keys()
        for name, value in message.items():
            expect_described(value, schema["properties"][name])
    elif schema["type"] == "array":
        for value in message:
            expect_described(value, schema["items"])


def test_json_schemas_of_recordings_describe_every_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "client" / "python" / "examples"))
    from simulator_example.recorder import ACTION_TOPIC, STATE_TOPIC, Recorder

    state = {"joints": np.arange(7, dtype=np.float32), "gripper": np.zeros(1, np.float32)}
    with Recorder(tmp_path / "part", 20.0, {"task": "reach"}) as recorder:
        for _ in range(2):
            picture, depth = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.uint16)
            recorder.step({"front": picture}, {"front": depth}, state, {"delta": np.ones(3, np.float32)})
        recorder.keep(tmp_path / "a.mcap")
    fields: dict[str, set[str]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages([STATE_TOPIC, ACTION_TOPIC]):
            assert schema is not None
            described = json.loads(schema.data)
            expect_described(json.loads(message.data), described)
            fields[channel.topic] = {*described["properties"]}
    assert fields == {STATE_TOPIC: {"timestamp", "joints", "gripper"}, ACTION_TOPIC: {"timestamp", "delta"}}
