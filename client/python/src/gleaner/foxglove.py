"""A layout of Foxglove for exports: a panel for every camera, a plot of q and a plot of w.

`python -m gleaner.foxglove FILE` writes it beside the file; in Foxglove import it in the menu of layouts.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from gleaner._command import ended
from gleaner._topics import Number, topics

# The scale of 16-bit depth, in millimetres; other pictures have none. Foxglove's own ends at 10 m, where an arm and its
# table are black.
_DEPTH = {"minValue": 0, "maxValue": 2000}


def layout(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The layout of an exported MCAP file. Raises `InvalidArgument` when it is no MCAP file or has nothing to show."""
    found = topics(Path(path))
    panels: dict[str, dict[str, Any]] = {}
    for at, topic in enumerate(found.pictures):
        panels[f"Image!camera{at}"] = {"imageMode": {"imageTopic": topic, **_DEPTH}, "foxglovePanelTitle": topic}
    pictures = [*panels]
    # Each number has a scale to itself: q is in [0, 1], and w may be far below 0.
    plots = []
    for number in found.scores:
        plots.append(f"Plot!{number.name}")
        panels[plots[-1]] = _plot(number)
    parts = [_split(pictures, "row")] if pictures else []
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": _split(parts + plots, "column"),
    }


def write_layout(path: str | os.PathLike[str], into: str | os.PathLike[str] | None = None) -> Path:
    """Writes the layout of an exported MCAP file: beside it with the ending `.layout.json`, or to the path `into`."""
    path = Path(path)
    saved = path.with_suffix(".layout.json") if into is None else Path(into)
    saved.write_text(json.dumps(layout(path), indent=2) + "\n")
    return saved


def _plot(number: Number) -> dict[str, Any]:
    """A plot of one number over the time of the recording; its title is the legend."""
    value = f"{number.topic}.{number.path}"
    plot: dict[str, Any] = {
        "paths": [{"value": value, "label": number.name, "enabled": True, "timestampMethod": "receiveTime"}],
        "foxglovePanelTitle": number.name,
        "showLegend": False,
        "legendDisplay": "none",
        "isSynced": True,
        "xAxisVal": "timestamp",
    }
    if number.name == "q":
        plot |= {"minYValue": 0, "maxYValue": 1}
    return plot


def _split(parts: list[Any], direction: str) -> Any:
    """Parts beside each other at equal sizes, as the tree of pairs that layouts are."""
    if len(parts) == 1:
        return parts[0]
    share = 100 / len(parts)
    return {"direction": direction, "first": parts[0], "second": _split(parts[1:], direction), "splitPercentage": share}


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m gleaner.foxglove", description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="exported MCAP file")
    parser.add_argument("--into", type=Path, help="path of the layout, by default beside the file")
    given = parser.parse_args()

    def run() -> int:
        print(write_layout(given.file, given.into))
        return 0

    return ended(run)


if __name__ == "__main__":
    sys.exit(main())
