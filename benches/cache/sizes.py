"""Size of the decoded steps beside that of their recordings, by codec and scene.

Draws scenes, records each with every codec, pushes the recordings to a server and measures what it has written into its
cache. Prints a table; ends with an error if a push fails or its inspection has a warning.
"""

import argparse
import itertools
import json
import os
import pathlib
import subprocess
import tempfile
from dataclasses import dataclass, field
from fractions import Fraction

import av
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from PIL import Image, ImageDraw
from process import Server, client
from scenes import (
    ACTION,
    CAMERAS,
    HEIGHT,
    QUALITY,
    RATE_HZ,
    SIDE,
    STATE,
    WIDTH,
    Episode,
    coded,
    specification,
    write_recording,
)

TASK = "sizes"
CAMERA = CAMERAS[0]
SEED = 1
# Pictures from one key frame to the next: a second and a half.
KEY_FRAMES = 30
# Standard deviations of the sensor noise, in steps of 8 bits.
NOISE = (2, 5)
# The canvas of a scene is larger than the picture by this factor, so that a moving camera stays within it.
CANVAS = 2


@dataclass(frozen=True)
class Codec:
    """A way to code a camera: `encoder` is FFmpeg's name, or empty for JPEG; `format` is that of its messages."""

    name: str
    format: str
    encoder: str = ""
    options: dict[str, str] = field(default_factory=dict)


X264 = {"g": str(KEY_FRAMES), "bf": "0", "threads": "1"}
X265 = f"keyint={KEY_FRAMES}:bframes=0:open-gop=0:repeat-headers=1:pools=none:frame-threads=1:log-level=error"
SVT_AV1 = {"g": str(KEY_FRAMES), "preset": "10", "svtav1-params": "lp=1"}
CODECS = (
    Codec(f"JPEG, quality {QUALITY}", "jpeg"),
    Codec("H.264 `ultrafast`", "h264", "libx264", {**X264, "preset": "ultrafast", "tune": "zerolatency"}),
    Codec("H.264 `medium`", "h264", "libx264", {**X264, "preset": "medium"}),
    Codec("H.265 `fast`", "h265", "libx265", {"preset": "fast", "x265-params": X265}),
    Codec("AV1, preset 10", "av1", "libsvtav1", SVT_AV1),
)


def textured(chance: np.random.Generator) -> Image.Image:
    """A canvas with texture of four sizes."""
    canvas = np.zeros((HEIGHT * CANVAS, WIDTH * CANVAS, 3), np.float32)
    for cells, weight in ((8, 0.5), (32, 0.25), (128, 0.15), (512, 0.1)):
        texture = Image.fromarray(chance.integers(0, 256, (cells * 3 // 4, cells, 3), np.uint8))
        texture = texture.resize((WIDTH * CANVAS, HEIGHT * CANVAS), Image.Resampling.BICUBIC)
        canvas += weight * np.asarray(texture, np.float32)
    return Image.fromarray(canvas.clip(0, 255).astype(np.uint8))


def view(seconds: float) -> tuple[float, ...]:
    """The affine map from a picture to the canvas, of a camera on a hand: it shifts, turns and approaches."""
    angle, zoom = 0.15 * np.sin(0.9 * seconds), 1 + 0.15 * np.sin(0.7 * seconds)
    cosine, sine = np.cos(angle) / zoom, np.sin(angle) / zoom
    across = WIDTH * CANVAS / 2 + 120 * np.sin(1.1 * seconds)
    down = HEIGHT * CANVAS / 2 + 80 * np.sin(1.7 * seconds)
    left, top = across - cosine * WIDTH / 2 + sine * HEIGHT / 2, down - sine * WIDTH / 2 - cosine * HEIGHT / 2
    return tuple(map(float, (cosine, -sine, left, sine, cosine, top)))


def draw_arm(picture: Image.Image, seconds: float) -> None:
    """An arm of two links and a hand, from the lower edge of the picture."""
    joints = np.array([(0.5, 1.05), (0.5 + 0.2 * np.sin(1.3 * seconds), 0.65)])
    hand = (0.5 + 0.35 * np.sin(0.8 * seconds), 0.4 + 0.15 * np.cos(1.9 * seconds))
    points = np.vstack([joints, hand]) * (WIDTH, HEIGHT)
    pen = ImageDraw.Draw(picture)
    pen.line([tuple(point) for point in points], fill=(205, 205, 210), width=44, joint="curve")
    for point, radius in zip(points[1:], (30, 38), strict=True):
        pen.ellipse([*(point - radius), *(point + radius)], fill=(60, 62, 70))


def drawn(moving: bool, noise: float, count: int) -> list[np.ndarray]:
    """The pictures of a camera that stands still or moves, with an arm before it."""
    chance = np.random.default_rng(SEED)
    canvas = textured(chance)
    pictures = []
    for at in range(count):
        seconds = at / RATE_HZ
        place = view(seconds if moving else 0.0)
        picture = canvas.transform((WIDTH, HEIGHT), Image.Transform.AFFINE, place, Image.Resampling.BICUBIC)
        draw_arm(picture, seconds)
        noisy = np.asarray(picture) + chance.normal(0, noise, (HEIGHT, WIDTH, 3))
        pictures.append(noisy.round().clip(0, 255).astype(np.uint8))
    return pictures


def encoded(codec: Codec, pictures: list[np.ndarray]) -> list[bytes]:
    """One message of the camera for each picture."""
    if not codec.encoder:
        return [coded(picture) for picture in pictures]
    context = av.CodecContext.create(codec.encoder, "w")
    context.height, context.width, context.pix_fmt = HEIGHT, WIDTH, "yuv420p"
    context.time_base, context.framerate = Fraction(1, RATE_HZ), Fraction(RATE_HZ)
    context.options, context.thread_count = codec.options, 1
    packets = []
    for at, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
        frame.pts, frame.time_base = at, context.time_base
        packets += context.encode(frame)
    packets += context.encode(None)
    if [packet.pts for packet in packets] != list(range(len(pictures))):
        raise SystemExit(f"{codec.name}: its packets are not one for each picture, in their order")
    return [bytes(packet) for packet in packets]


def episode_of(codec: Codec, messages: list[bytes]) -> tuple[tuple[type, str], Episode]:
    """The type and format of the camera's messages, and an episode of them with made-up numbers."""
    kind = CompressedVideo if codec.encoder else CompressedImage
    chance = np.random.default_rng(SEED)
    # Four digits, so that numbers take little of the file.
    state, action = (chance.uniform(-1, 1, (len(messages), size)).round(4) for size in (STATE, ACTION))
    return (kind, codec.format), Episode({CAMERA: messages}, state, action)


def task() -> dict:
    """The task of benches/loading with one camera."""
    made = specification(TASK)
    for part in (made, *made["mappings"]):
        part["cameras"] = part["cameras"][:1]
    return made


class Lab:
    """A server with the task, and the sizes of what it writes into its cache."""

    def __init__(self, programs: pathlib.Path, server: Server, folder: pathlib.Path):
        self.programs, self.server, self.folder = programs, server, folder
        (folder / "task.json").write_text(json.dumps(task()))
        self.run("task", "create", "task.json")

    def run(self, *words: str) -> dict:
        """The answer of a command of the client, which prints its own errors."""
        try:
            return json.loads(client(self.programs, self.server, self.folder, *words))
        except subprocess.CalledProcessError as error:
            raise SystemExit(f"gleaner {' '.join(words)}: failed with {error.returncode}") from None

    def cached(self) -> dict[pathlib.Path, int]:
        """The size of each file of decoded steps."""
        return {path: path.stat().st_size for path in (self.folder / "data" / "cache").glob("*.frames")}

    def push(self, recording: pathlib.Path, pictures: int) -> int:
        """Pushes a recording and returns the size of its decoded steps."""
        before = self.cached()
        answer = self.run("push", recording.name, "--task", TASK, "--outcome", "success")
        steps, warnings = ([pushed["episode"][name] for pushed in answer["episodes"]] for name in ("steps", "warnings"))
        if answer["failures"] or answer["skipped"] or steps != [pictures] or warnings != [0]:
            raise SystemExit(f"{recording.name}: expected {pictures} steps and no warning: {json.dumps(answer)}")
        new = [size for path, size in self.cached().items() if path not in before]
        if len(new) != 1:
            raise SystemExit(f"{recording.name}: {len(new)} new files of decoded steps, expected 1")
        return new[0]


def main() -> None:
    """Prints the table of all codecs and scenes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=pathlib.Path, required=True, help="folder of the programs")
    parser.add_argument("--pictures", type=int, default=120, help="number of pictures of each recording")
    given = parser.parse_args()
    # SVT-AV1 prints its settings otherwise.
    os.environ.setdefault("SVT_LOG", "1")
    programs, ratios = given.bin.resolve(), []
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        with Server(programs, folder / "data", 0) as server:
            lab = Lab(programs, server, folder)
            print(f"{given.pictures} pictures of {HEIGHT} × {WIDTH} each, kept at {SIDE} × {SIDE}\n")
            print("| case | recording, kB a picture | cache, kB a picture | cache over recording |")
            print("|---|---:|---:|---:|", flush=True)
            for moving, noise in itertools.product((False, True), NOISE):
                pictures = drawn(moving, noise, given.pictures)
                for at, codec in enumerate(CODECS):
                    path = folder / f"{at}-{moving}-{noise}.mcap"
                    write_recording(path, *episode_of(codec, encoded(codec, pictures)))
                    cache, recorded = lab.push(path, given.pictures), path.stat().st_size
                    ratios.append(cache / recorded)
                    case = f"{'moving' if moving else 'still'}, noise {noise}: {codec.name}"
                    sizes = f"{recorded / given.pictures / 1e3:.1f} | {cache / given.pictures / 1e3:.1f}"
                    print(f"| {case} | {sizes} | {ratios[-1]:.2f} |", flush=True)
    print(f"\nat most as large as the recording: {sum(ratio <= 1 for ratio in ratios)} of {len(ratios)} cases")


if __name__ == "__main__":
    main()
