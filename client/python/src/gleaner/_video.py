"""Videos of episodes: the cameras that a policy saw, side by side, as H.264. Needs PyAV."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import av
except ImportError as error:
    raise ImportError("videos need PyAV: pip install av") from error


class Video:
    """One MP4 file, written while the episode runs; it appears when the block ends."""

    def __init__(self, path: str | os.PathLike[str], rate_hz: float) -> None:
        self._path = Path(path)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._part = self._path.with_name(f"{self._path.name}.part")
        self._rate = Fraction(rate_hz).limit_denominator(1000)
        self._container: Any = None
        self._stream: Any = None

    def add(self, images: Mapping[str, NDArray[np.uint8] | bytes]) -> None:
        """The cameras of one step: arrays of height × width × RGB, or JPEG or PNG bytes."""
        picture = _beside([_decoded(image) for image in images.values()])
        if self._container is None:
            self._container = av.open(os.fspath(self._part), "w", format="mp4")
            self._stream = self._container.add_stream("libx264", rate=self._rate)
            self._stream.height, self._stream.width = picture.shape[:2]
            self._stream.pix_fmt = "yuv420p"
        self._mux(av.VideoFrame.from_ndarray(picture, format="rgb24"))

    def _mux(self, frame: Any) -> None:
        for packet in self._stream.encode(frame):
            self._container.mux(packet)

    def __enter__(self) -> Video:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._container is None:
            return
        try:
            if error is None:
                self._mux(None)
        finally:
            self._container.close()
        # A part of an episode that failed is of use too, but is not taken for a whole one.
        if error is None:
            self._part.replace(self._path)


def _decoded(image: NDArray[np.uint8] | bytes) -> NDArray[np.uint8]:
    if not isinstance(image, bytes):
        return np.asarray(image)
    opened: Any = av.open(io.BytesIO(image), "r")
    with opened:
        decoded: NDArray[np.uint8] = next(opened.decode(video=0)).to_ndarray(format="rgb24")
    return decoded


def _beside(pictures: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures in a row, in a frame of even height and width, which the codec asks for."""
    size = max(len(picture) for picture in pictures), sum(picture.shape[1] for picture in pictures)
    height, width = (2 * math.ceil(length / 2) for length in size)
    frame = np.zeros((height, width, 3), np.uint8)
    left = 0
    for picture in pictures:
        frame[: len(picture), left : left + picture.shape[1]] = picture
        left += picture.shape[1]
    return frame
