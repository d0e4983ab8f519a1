"""Pictures and numbers of a made-up robot, and the three forms in which a lab may keep them.

The same JPEG files (480 × 640, quality 90) are the messages of a recording, the files of a folder, and the source of a
video dataset. Does not depend on gleaner or on what reads the data.
"""

import io
import json
import pathlib
from dataclasses import dataclass

import numpy as np
from PIL import Image

CAMERAS = ("front", "wrist")
HEIGHT, WIDTH, SIDE = 480, 640, 128
RATE_HZ = 20
STATE, ACTION = 7, 4
BEGIN_NS = 1_700_000_000_000_000_000
# The quality with which pictures are coded as JPEG.
QUALITY = 90


@dataclass
class Episode:
    """The pictures of each camera as JPEG, and the numbers of each step."""

    pictures: dict[str, list[bytes]]
    state: np.ndarray
    action: np.ndarray


def episode(seed: int, steps: int) -> Episode:
    """A scene with texture and the noise of a sensor, before which something moves."""
    chance = np.random.default_rng(seed)
    pictures = {camera: [coded(frame) for frame in filmed(chance, steps)] for camera in CAMERAS}
    action = chance.uniform(-1, 1, (steps, ACTION)).astype(np.float32)
    state = np.cumsum(chance.normal(0, 0.1, (steps, STATE)), 0).astype(np.float32)
    return Episode(pictures, state, action)


def filmed(chance: np.random.Generator, steps: int) -> list[np.ndarray]:
    octaves = []
    for cells in (4, 16, 64):
        texture = chance.integers(0, 256, (cells * 3 // 4, cells, 3), np.uint8)
        octaves.append(np.asarray(Image.fromarray(texture).resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC), np.float32))
    scene = sum(weight * octave for weight, octave in zip((0.6, 0.25, 0.15), octaves, strict=True))
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    centre = chance.uniform(0.3, 0.7, 2) * (HEIGHT, WIDTH)
    color = chance.uniform(0, 255, 3)
    frames = []
    for _ in range(steps):
        centre += chance.normal(0, 4, 2)
        inside = (rows - centre[0]) ** 2 + (columns - centre[1]) ** 2 < 40**2
        frame = np.where(inside[..., None], color, scene) + chance.normal(0, 3, scene.shape)
        frames.append(frame.clip(0, 255).astype(np.uint8))
    return frames


def coded(frame: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(frame).save(out, "JPEG", quality=QUALITY)
    return out.getvalue()


def write_files(made: list[Episode], folder: pathlib.Path) -> None:
    """`folder/EPISODE/CAMERA-STEP.jpg`, the same at the size of a step with `-small`, and `folder/numbers.npz`."""
    for at, each in enumerate(made):
        (folder / str(at)).mkdir(parents=True)
        for camera, pictures in each.pictures.items():
            for step, picture in enumerate(pictures):
                (folder / str(at) / f"{camera}-{step}.jpg").write_bytes(picture)
                small = Image.open(io.BytesIO(picture)).resize((SIDE, SIDE), Image.Resampling.BILINEAR)
                small.save(folder / str(at) / f"{camera}-{step}-small.jpg", quality=QUALITY)
    numbers = {"state": np.stack([each.state for each in made]), "action": np.stack([each.action for each in made])}
    np.savez(folder / "numbers.npz", **numbers)


def write_recordings(made: list[Episode], folder: pathlib.Path) -> list[pathlib.Path]:
    """One MCAP file an episode: foxglove.CompressedImage, and numbers as JSON."""
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    folder.mkdir()
    paths = [folder / f"{at}.mcap" for at in range(len(made))]
    for path, each in zip(paths, made, strict=True):
        write_recording(path, (CompressedImage, "jpeg"), each)
    return paths


def write_recording(path: pathlib.Path, kind: tuple[type, str], made: Episode) -> None:
    """An MCAP file with the pictures as messages of this type and format, and numbers as JSON."""
    from mcap.writer import CompressionType, Writer
    from mcap_protobuf.schema import build_file_descriptor_set

    picture, form = kind
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        descriptors = build_file_descriptor_set(picture).SerializeToString()
        image = writer.register_schema(picture.DESCRIPTOR.full_name, "protobuf", descriptors)
        numbers = writer.register_schema("numbers", "jsonschema", b'{"type": "object"}')
        channels = {camera: writer.register_channel(f"/{camera}", "protobuf", image) for camera in made.pictures}
        rows = {name: writer.register_channel(f"/{name}", "json", numbers) for name in ("state", "action")}
        for step, (state, action) in enumerate(zip(made.state, made.action, strict=True)):
            stamp = BEGIN_NS + step * 10**9 // RATE_HZ
            seconds, nanoseconds = divmod(stamp, 10**9)
            for camera, pictures in made.pictures.items():
                message = picture(data=pictures[step], format=form, frame_id=camera)
                message.timestamp.FromNanoseconds(stamp)
                writer.add_message(channels[camera], stamp, message.SerializeToString(), stamp)
            for name, values in (("state", state), ("action", action)):
                row = {"timestamp": {"sec": seconds, "nsec": nanoseconds}, name: values.tolist()}
                writer.add_message(rows[name], stamp, json.dumps(row).encode(), stamp)
        writer.finish()


def specification(name: str) -> dict:
    """The task of the recordings, learned from at 128 × 128."""
    recorded = {"height": HEIGHT, "width": WIDTH}
    mapping = {
        "name": "scenes",
        "clock": "/action",
        "cameras": [{"camera": camera, "color": f"/{camera}"} for camera in CAMERAS],
        "fields": [{"field": field, "topic": f"/{field}", "paths": [field]} for field in ("state", "action")],
    }
    return {
        "name": name,
        "rate_hz": RATE_HZ,
        "cameras": [{"name": camera, "height": SIDE, "width": SIDE, "recorded": recorded} for camera in CAMERAS],
        "proprioception": [{"name": "state", "size": STATE}],
        "action": [{"name": "action", "size": ACTION}],
        "mappings": [mapping],
    }


def write_videos(made: list[Episode], folder: pathlib.Path) -> None:
    """A LeRobot dataset with a video of each camera, in the form that LeRobot writes by default (AV1)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    picture = {"dtype": "video", "shape": (HEIGHT, WIDTH, 3), "names": ["height", "width", "channels"]}
    features = {f"observation.images.{camera}": picture for camera in CAMERAS}
    features |= {
        "observation.state": {"dtype": "float32", "shape": (STATE,), "names": None},
        "action": {"dtype": "float32", "shape": (ACTION,), "names": None},
    }
    videos = LeRobotDataset.create("loading/scenes", RATE_HZ, features, root=folder)
    for each in made:
        for step, (state, action) in enumerate(zip(each.state, each.action, strict=True)):
            frames = {
                f"observation.images.{camera}": np.asarray(Image.open(io.BytesIO(pictures[step])))
                for camera, pictures in each.pictures.items()
            }
            videos.add_frame({**frames, "observation.state": state, "action": action, "task": "scenes"})
        videos.save_episode()
    videos.finalize()
