"""A layout of Foxglove for exports: a panel for every camera, and a plot of q and w.

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
from gleaner._topics import topics


def layout(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The layout of an exported MCAP file. Raises `InvalidArgument` when it is no MCAP file or has nothing to show."""
    found = topics(Path(path))
    panels: dict[str, dict[str, Any]] = {}
    for at, topic in enumerate(found.pictures):
        panels[f"Image!camera{at}"] = {"imageMode": {"imageTopic": topic}, "foxglovePanelTitle": topic}
    pictures = [*panels]
    if found.scores:
        line = {"enabled": True, "timestampMethod": "receiveTime"}
        paths = [{**line, "value": f"{number.topic}.{number.path}", "label": number.name} for number in found.scores]
        panels["Plot!scores"] = {"paths": paths, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}
    parts = [_split(pictures, "row")] if pictures else []
    parts += ["Plot!scores"] if found.scores else []
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": _split(parts, "column"),
    }


def write_layout(path: str | os.PathLike[str], into: str | os.PathLike[str] | None = None) -> Path:
    """Writes the layout of an exported MCAP file: beside it with the ending `.layout.json`, or to the path `into`."""
    path = Path(path)
    saved = path.with_suffix(".layout.json") if into is None else Path(into)
    saved.write_text(json.dumps(layout(path), indent=2) + "\n")
    return saved


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
