"""Videos of the episodes of an evaluation, named by seed and result. PyAV is needed only where one is made."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from gleaner.types import TaskSpec

if TYPE_CHECKING:
    from gleaner._video import Video


class Films:
    """A video of each episode, `seed-7-success.mp4` for example."""

    def __init__(self, folder: str | os.PathLike[str], spec: TaskSpec | None) -> None:
        from gleaner._video import Video

        self._folder, self._video = Path(folder), Video
        self._rate = spec.rate_hz if spec is not None else 20.0

    def episode(self, seed: int) -> Video:
        """The video of an episode that begins."""
        return self._video(self._path(seed, "running"), self._rate)

    def name(self, seed: int, *, success: bool) -> None:
        """Names the video of an episode that has ended."""
        running = self._path(seed, "running")
        # An episode that was solved from the start has no step.
        if running.exists():
            running.replace(self._path(seed, "success" if success else "failure"))

    def _path(self, seed: int, state: str) -> Path:
        return self._folder / f"seed-{seed}-{state}.mp4"
