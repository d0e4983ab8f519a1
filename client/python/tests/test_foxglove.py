"""Exports with scores in Foxglove itself: the open-source Studio 1.48 shows them in Chromium, with the client's layout.

`make check-foxglove` installs the app; elsewhere these tests are skipped.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders
from mcap_ros2.writer import Writer as Ros2Writer
from PIL import Image

import gleaner
from browser import Browser
from conftest import Lab
from foxglove_studio import APP, Studio, for_1_48
from gleaner import foxglove
from programs import ROOT, cli

pytestmark = pytest.mark.skipif(APP is None, reason="run make check-foxglove")

SHOTS = ROOT / "target" / "tmp" / "foxglove"
STEPS, SIDE = 12, 16
# The time of the first step and that between two steps, in nanoseconds.
START, PERIOD = 1_000_000_000, 50_000_000
# Median difference of a drawn colour from the recorded one; the time that the app writes on a picture does not count.
TOLERANCE = 3.0
# Share of a plot's width with a curve; the rest are the numbers of its axis.
WIDTH = 0.9

IMAGE_OF_ROS = f"""std_msgs/Header header
string format
uint8[] data
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
NUMBERS_OF_JSON = {
    "type": "object",
    "properties": {"values": {"type": "array", "items": {"type": "number"}}},
}
IMAGE_OF_JSON = {
    "type": "object",
    "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}


def png(step: int) -> bytes:
    """A picture that no other step has."""
    rows, columns = np.indices((SIDE, SIDE)) * 8
    pixels = np.stack([rows, columns, np.full_like(rows, 20 * step)], axis=-1).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "png")
    return file.getvalue()


def of_ros2(path: Path, sign: float) -> None:
    """A recording of ROS 2 messages."""
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        image = writer.register_msgdef("sensor_msgs/msg/CompressedImage", IMAGE_OF_ROS)
        numbers = writer.register_msgdef("lab_msgs/msg/Numbers", "float64[2] values\n")
        for step in range(STEPS):
            time = START + step * PERIOD
            stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
            picture = {"header": {"stamp": stamp, "frame_id": "front"}, "format": "png", "data": png(step)}
            given = [("/front", image, picture)]
            given += [(topic, numbers, {"values": [sign * step, sign]}) for topic in ("/state", "/goal")]
            for topic, schema, message in given:
                writer.write_message(topic, schema, message, log_time=time, publish_time=time)
        writer.finish()


def of_json(path: Path, sign: float) -> None:
    """A recording of JSON messages, with Foxglove's schema of pictures."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        image = writer.register_schema("foxglove.CompressedImage", "jsonschema", json.dumps(IMAGE_OF_JSON).encode())
        numbers = writer.register_schema("lab.Numbers", "jsonschema", json.dumps(NUMBERS_OF_JSON).encode())
        schemas = {"/front": image, "/state": numbers, "/goal": numbers}
        channels = {topic: writer.register_channel(topic, "json", schema) for topic, schema in schemas.items()}
        for step in range(STEPS):
            time = START + step * PERIOD
            stamp = {"sec": time // 10**9, "nsec": time % 10**9}
            data = base64.b64encode(png(step)).decode()
            picture = {"timestamp": stamp, "frame_id": "front", "data": data, "format": "png"}
            values = {"values": [sign * step, sign]}
            given = {"/front": picture, "/state": values, "/goal": values}
            for topic, message in given.items():
                writer.add_message(channels[topic], time, json.dumps(message).encode(), time)
        writer.finish()


def imported(client: gleaner.Client, write: Callable[[Path, float], None], folder: Path) -> tuple[str, str]:
    """A failed episode of such recordings, and a score run of it that was made elsewhere."""
    name = f"foxglove_{write.__name__}"
    sources = [{"field": field, "topic": f"/{field}", "paths": ["values"]} for field in ("state", "goal")]
    mapping = {"name": "lab", "cameras": [{"camera": "front", "color": "/front"}], "fields": sources}
    client.tasks.create(
        {
            "name": name,
            "rate_hz": 20.0,
            "cameras": [{"name": "front", "height": SIDE, "width": SIDE}],
            "proprioception": [{"name": "state", "size": 2}],
            "action": [{"name": "goal", "size": 2}],
            "mappings": [mapping],
        }
    )
    for outcome, sign in {"success": 1.0, "failure": -1.0}.items():
        write(folder / f"{outcome}.mcap", sign)
        episode = client.episodes.push(folder / f"{outcome}.mcap", task=name, outcome=outcome)
    snapshot = client.snapshots.create(name)
    q = [abs(step - 5) / 8 for step in range(STEPS)]
    run = client.scores.import_scores(snapshot.id, {"episode": [episode.id] * STEPS, "step": [*range(STEPS)], "q": q})
    return episode.id, run.id


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    started = Browser(tmp_path_factory.mktemp("downloads"))
    yield started
    started.close()


@pytest.fixture(scope="module", params=["protobuf", "json", "ros2"])
def episode(
    request: pytest.FixtureRequest,
    client: gleaner.Client,
    server: str,
    lab: Lab,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """An episode of each dialect, exported with its scores."""
    folder = tmp_path_factory.mktemp("episodes")
    if request.param == "protobuf":
        found, run = lab.failures[0], lab.run
    else:
        found, run = imported(client, {"json": of_json, "ros2": of_ros2}[request.param], folder)
    path = folder / f"{request.param}.mcap"
    cli("--server", server, "export", "--episode", found, "--scores", run, "--out", str(path))
    return path


class JsonDecoders(DecoderFactory):
    """Messages of JSON as objects."""

    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        del schema
        return (lambda data: SimpleNamespace(**json.loads(data))) if message_encoding == "json" else None


def messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    """The times and messages of a topic."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[ProtobufDecoders(), Ros2Decoders(), JsonDecoders()])
        return [(record.log_time, found) for _, _, record, found in reader.iter_decoded_messages(topics=[topic])]


def pixels(image: Any) -> np.ndarray:
    """The pixels of a compressed picture, or of depth in millimetres as the layout's scale draws them."""
    if hasattr(image, "format"):
        data = base64.b64decode(image.data) if isinstance(image.data, str) else bytes(image.data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=float)
    assert image.encoding == "16UC1"
    depth = np.frombuffer(image.data, "<u2").reshape(image.height, image.width, 1)
    return np.repeat(np.minimum(depth / 2000 * 255, 255), 3, axis=2)


def apart(shown: Image.Image, recorded: np.ndarray) -> float:
    """The median difference of a shown picture, in which the recorded one is centred, in the worst colour."""
    height, width, _ = recorded.shape
    scale = min(shown.width / width, shown.height / height)
    left, top = (shown.width - width * scale) / 2, (shown.height - height * scale) / 2
    box = (left, top, shown.width - left, shown.height - top)
    drawn = np.asarray(shown.resize((width, height), Image.Resampling.BOX, box), dtype=float)
    return float(np.median(np.abs(drawn - recorded), axis=(0, 1)).max())


def expect_plot(studio: Studio, panel: str, numbers: list[float]) -> None:
    """Waits until a plot has all numbers and draws them."""
    studio.until(f"{panel} has {len(numbers)} numbers", lambda: len(studio.plotted(panel)) == len(numbers))
    assert studio.plotted(panel) == numbers
    studio.until(f"{panel} has a curve", lambda: studio.curve(panel) > WIDTH)


def expect_picture(studio: Studio, panel: str, recorded: np.ndarray) -> None:
    """Waits until a panel shows a picture."""
    studio.until(f"{panel} has the picture", lambda: apart(studio.picture(panel), recorded) < TOLERANCE)


def test_foxglove_draws_cameras_and_scores_without_problems(browser: Browser, episode: Path, tmp_path: Path) -> None:
    layout = for_1_48(foxglove.layout(episode))
    panels = layout["configById"]
    plots = {name: panel["paths"][0]["value"] for name, panel in panels.items() if name.startswith("Plot!")}
    pictures = {name: panel["cameraTopic"] for name, panel in panels.items() if name.startswith("ImageViewPanel!")}
    assert [*plots] == ["Plot!q", "Plot!w"]
    assert pictures
    with Studio(browser, tmp_path / "site", episode, layout) as studio:
        for panel, value in plots.items():
            topic, _, path = value.rpartition(".")
            expect_plot(studio, panel, [float(getattr(message, path)) for _, message in messages(episode, topic)])
        for panel, topic in pictures.items():
            shown = [message for time, message in messages(episode, topic) if time <= studio.now()]
            expect_picture(studio, panel, pixels(shown[-1]))
        assert studio.problems() == []
    assert browser.console() == []
    browser.save(SHOTS / f"{episode.stem}.png")


def test_foxglove_lists_what_it_cannot_show(browser: Browser, tmp_path: Path) -> None:
    """The control of the test above: problems are seen where there are some."""
    path = tmp_path / "broken.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("gleaner.Quality", "protobuf", b"no descriptor")
        channel = writer.register_channel("/gleaner/quality", "protobuf", schema)
        writer.add_message(channel, START, b"no message", START)
        writer.finish()
    layout = {**foxglove.layout(path), "configById": {"Unknown!panel": {}}, "layout": "Unknown!panel"}
    with Studio(browser, tmp_path / "site", path, layout) as studio:
        assert "Unknown panel type" in studio.text("Unknown!panel")
        (problem,) = studio.problems()
        assert "/gleaner/quality" in problem
