"""The progress of a stage: one line that is overwritten on a terminal, occasional lines in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType

_EVERY_S = 20.0


class Progress:
    """The progress of one stage."""

    def __init__(self, stage: str) -> None:
        self._stage = stage
        self._live = sys.stderr.isatty()
        self._began = self._shown = time.monotonic()
        self._last = ""

    def at(self, done: int, total: int, note: str = "") -> None:
        """Shows the progress."""
        now = time.monotonic()
        share = f"{done}/{total}" if total else f"{done}"
        self._last = f"{self._stage}: {share} {note}".rstrip()
        if self._live:
            print(f"\r\033[K{self._last}", end="", file=sys.stderr, flush=True)
        elif now - self._shown > _EVERY_S:
            self._shown = now
            print(self._last, file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        took = time.monotonic() - self._began
        line = (
            f"{self._last or self._stage} in {took:.0f} s" if kind is None else f"{self._last or self._stage}: stopped"
        )
        print(f"\r\033[K{line}" if self._live else line, file=sys.stderr, flush=True)
