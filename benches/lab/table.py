"""The table of a walk: the time and the peak memory of each piece of work."""

import time
from collections.abc import Callable

from process import Server


class Table:
    """The measurements, as rows of Markdown."""

    def __init__(self):
        self.rows: list[dict[str, object]] = []
        self.failed: list[str] = []
        self.missed: list[str] = []

    def add(self, what: str, seconds: float, peak: float, note: str = "") -> None:
        self.rows.append({"what": what, "seconds": seconds, "peak_mib": peak, "note": note})
        print(f"| {what} | {shown(seconds)} | {peak:.0f} | {note} |", flush=True)

    def fail(self, what: str, seconds: float, peak: float, error: str) -> None:
        """A row of work that failed; the walk continues."""
        self.failed.append(what)
        self.add(what, seconds, peak, f"FAILED: {error}")

    def within(self, what: str, seconds: float, target: float) -> None:
        """Compares a time with its target; a miss ends the bench with an error once the walk is complete."""
        if seconds > target:
            self.missed.append(f"{what}: {shown(seconds)}, target {shown(target)}")

    def measured(self, server: Server, what: str, work: Callable[[], object], note: Callable[[object], str] = str) -> object:
        server.forget_peak()
        begun = time.perf_counter()
        try:
            found = work()
            text = note(found)
        except Exception as error:
            # Some errors have no text.
            first = (str(error).splitlines() or [type(error).__name__])[0]
            self.fail(what, time.perf_counter() - begun, server.peak_mib(), first[:160])
            return None
        self.add(what, time.perf_counter() - begun, server.peak_mib(), text)
        return found


def shown(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if seconds < 2 else f"{seconds:.1f} s"
