"""A camera whose recordings are larger than the pictures that are learned from: a session sees what training saw."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from numpy.typing import NDArray
from PIL import Image

import gleaner

SPEC = {
    "name": "large_pictures",
    "rate_hz": 10.0,
    "cameras": [
        {
            "name": "eye",
            "height": 16,
            "width": 24,
            "recorded": {"height": 96, "width": 128, "crop": {"top": 7, "left": 13, "height": 80, "width": 110}},
        }
    ],
    "proprioception": [{"name": "arm", "size": 2}],
    "action": [{"name": "move", "size": 2}],
    "mappings": [
        {
            "name": "json",
            "cameras": [{"camera": "eye", "color": "/eye"}],
            "fields": [
                {"field": "arm", "topic": "/arm", "paths": ["data"]},
                {"field": "move", "topic": "/move", "paths": ["data"]},
            ],
            "clock": "/move",
        }
    ],
}
STEPS = 8
DEPLOYMENT = "large_pictures@test"

Seen = list[tuple[bytes, NDArray[np.float32]]]


# The properties of the messages' JSON schemas.
PICTURE = {"format": {"type": "string"}, "data": {"type": "string", "contentEncoding": "base64"}}
NUMBERS = {"data": {"type": "array", "items": {"type": "number"}}}


def jpeg(chance: np.random.Generator) -> bytes:
    """A picture with edges in it, whose every pixel depends on the quality of its decoding."""
    rough = chance.integers(0, 255, (12, 16, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    data = io.BytesIO()
    Image.fromarray(rough).save(data, "JPEG", quality=70)
    return data.getvalue()


def record(path: Path, seed: int) -> Seen:
    """Writes an episode and returns the picture and proprioception of each step."""
    chance = np.random.default_rng(seed)
    seen = []
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        picture_of, numbers_of = (
            writer.register_schema(
                name, "jsonschema", json.dumps({"type": "object", "properties": properties}).encode()
            )
            for name, properties in (("picture", PICTURE), ("numbers", NUMBERS))
        )
        schemas = {"/eye": picture_of, "/arm": numbers_of, "/move": numbers_of}
        channels = {topic: writer.register_channel(topic, "json", schema) for topic, schema in schemas.items()}
        for step in range(STEPS):
            stamp = 10**18 + step * 100_000_000
            picture, arm = jpeg(chance), chance.uniform(-1, 1, 2).astype(np.float32)
            seen.append((picture, arm))
            contents = {
                "/eye": {"format": "jpeg", "data": base64.b64encode(picture).decode()},
                "/arm": {"data": arm.tolist()},
                "/move": {"data": chance.uniform(-1, 1, 2).tolist()},
            }
            for topic, content in contents.items():
                writer.add_message(channels[topic], stamp, json.dumps(content).encode(), stamp)
        writer.finish()
    return seen


@pytest.fixture(scope="module")
def trained(client: gleaner.Client, tmp_path_factory: pytest.TempPathFactory) -> tuple[Seen, str]:
    """The recorded steps of the first expert, and a dataset with every step; a policy of its experts is deployed."""
    folder = tmp_path_factory.mktemp("large")
    client.tasks.create(SPEC)
    seen = [record(folder / f"{seed}.mcap", seed) for seed in range(3)]
    for seed, outcome in enumerate(("success", "success", "failure")):
        client.episodes.push(folder / f"{seed}.mcap", task="large_pictures", outcome=outcome)
    pretrain = client.jobs.pretrain("large_pictures", steps=1, batch=4, segment_length=2)
    score = client.jobs.score("large_pictures", pretrain.result_id)
    train = client.jobs.train("large_pictures", experts_of=pretrain.result_id, policy="bc", steps=20, batch=8)
    for job in (pretrain, score, train):
        client.jobs.wait(job, timeout=300)
    client.deploy(DEPLOYMENT, train.result_id)
    return seen[0], client.datasets.create(score.result_id, beta=0.0).id


def test_a_session_sees_what_training_saw(client: gleaner.Client, trained: tuple[Seen, str]) -> None:
    seen, dataset = trained
    learned = {
        tuple(segment.proprioception[-1]): segment.images["eye"][-1]
        for segment in client.datasets.stream(dataset, frames=True)
    }
    with gleaner.Policy(client, DEPLOYMENT) as sent, gleaner.Policy(client, DEPLOYMENT) as stored:
        answers = []
        for picture, arm in seen:
            answers.append(sent({"images": {"eye": picture}, "proprioception": arm}))
            again = stored({"images": {"eye": learned[tuple(arm)]}, "proprioception": arm})
            np.testing.assert_array_equal(answers[-1], again)
    # The policy looks: the same numbers with another picture give another action.
    with gleaner.Policy(client, DEPLOYMENT) as other:
        swapped = [
            other({"images": {"eye": seen[at - 1][0]}, "proprioception": arm}) for at, (_, arm) in enumerate(seen)
        ]
    assert np.abs(np.array(answers) - np.array(swapped)).min(axis=1).max() > 1e-4


def test_the_part_of_the_picture_that_a_step_shows_is_the_crop(
    client: gleaner.Client, trained: tuple[Seen, str]
) -> None:
    """What lies outside the crop has no effect on an action; what lies inside has."""
    seen, _ = trained
    picture = np.asarray(Image.open(io.BytesIO(seen[0][0])))
    inside, outside = picture.copy(), picture.copy()
    inside[40:60, 60:80] = 255 - inside[40:60, 60:80]
    outside[:7], outside[87:], outside[:, :13], outside[:, 123:] = 0, 255, 0, 255

    def act(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
        with gleaner.Policy(client, DEPLOYMENT) as policy:
            return policy({"images": {"eye": pixels}, "proprioception": seen[0][1]})

    np.testing.assert_array_equal(act(picture), act(outside))
    assert np.abs(act(picture) - act(inside)).max() > 1e-5
