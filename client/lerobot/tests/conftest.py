"""A server with a deployment that acts in LeRobot's PushT environment, trained for a few steps."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gleaner
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from PIL import Image

from programs import Server

DEPLOYMENT = "push_t@test"
RATE_HZ = 10.0
SIDE = 96  # of the images that LeRobot has from PushT
TASK: dict[str, Any] = {
    "name": "push_t",
    "rate_hz": RATE_HZ,
    "cameras": [{"name": "top", "height": 32, "width": 32, "recorded": {"height": SIDE, "width": SIDE}}],
    "proprioception": [{"name": "agent_pos", "size": 2}],
    "action": [{"name": "target", "size": 2, "minimum": 0.0, "maximum": 512.0}],
    "mappings": [
        {
            "name": "json",
            "cameras": [{"camera": "top", "color": "/top"}],
            "fields": [
                {"field": "agent_pos", "topic": "/state", "paths": ["agent_pos"]},
                {"field": "target", "topic": "/action", "paths": ["target"]},
            ],
        }
    ],
}


def record(path: Path, seed: int) -> None:
    """An episode of ten steps of a random walk, as JSON."""
    random = np.random.default_rng(seed)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        names = {"/top": "foxglove.CompressedImage", "/state": "State", "/action": "Action"}
        channels = {
            topic: writer.register_channel(
                topic, "json", writer.register_schema(name, "jsonschema", b'{"type": "object"}')
            )
            for topic, name in names.items()
        }
        at = random.uniform(100, 400, 2)
        for step in range(10):
            stamp = 1_700_000_000_000_000_000 + round(step * 1e9 / RATE_HZ)
            target = (at + random.normal(scale=20, size=2)).clip(0, 512)
            coded = io.BytesIO()
            Image.fromarray(random.integers(0, 256, (SIDE, SIDE, 3), np.uint8)).save(coded, "JPEG")
            time = {"timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}}
            picture = {"data": base64.b64encode(coded.getvalue()).decode(), "format": "jpeg", "frame_id": "top"}
            values = {"/top": picture, "/state": {"agent_pos": at.tolist()}, "/action": {"target": target.tolist()}}
            for topic, message in values.items():
                writer.add_message(channels[topic], stamp, json.dumps(time | message).encode(), stamp)
            at = target
        writer.finish()


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server with the deployment."""
    folder = tmp_path_factory.mktemp("lerobot")
    process = Server(folder / "data")
    with gleaner.connect(process.address) as client:
        client.tasks.create(TASK)
        for seed in range(3):
            path = folder / f"{seed}.mcap"
            record(path, seed)
            client.episodes.push(path, task="push_t", outcome="success" if seed else "failure")
        few = {"steps": 3, "batch": 4, "warmup_steps": 1}
        encoder = client.jobs.pretrain("push_t", segment_length=3, **few)
        trained = client.jobs.train("push_t", experts_of=encoder.result_id, policy="bc", **few)
        client.jobs.wait(trained, timeout=240)
        client.deploy(DEPLOYMENT, trained.result_id)
    yield process.address
    process.stop()
