"""Exports in Rerun: a view of every camera, one of q and one of w over time. Only this module needs rerun-sdk.

`python -m gleaner.rerun FILE` opens the viewer. Rerun draws numbers of unknown messages only through a view of the
blueprint, and applies a blueprint only to the file whose name it has.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

try:
    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.blueprint import encodings
except ImportError as error:
    raise ImportError("gleaner.rerun needs Rerun 0.41 or newer; pip install 'rerun-sdk>=0.41'") from error

from gleaner._command import ended
from gleaner._topics import Number, topics

# What a blueprint says of the topics of a view.
Overrides = Mapping[Any, Any]


def blueprint(path: str | os.PathLike[str], into: str | os.PathLike[str] | None = None) -> Path:
    """Writes the blueprint of an exported MCAP file: beside it with the ending `.rbl`, or to the path `into`.

    Raises `InvalidArgument` when the file is no MCAP file or has nothing to show.
    """
    path = Path(path)
    found = topics(path)
    views = [rrb.Spatial2DView(origin=topic, name=topic) for topic in found.pictures]
    parts: list[rrb.Grid | rrb.TimeSeriesView] = [rrb.Grid(*views)] if views else []
    parts.extend(_curve(number) for number in found.scores)
    saved = path.with_suffix(".rbl") if into is None else Path(into)
    # The viewer applies a blueprint to the recording of this application, which is the file's name.
    rrb.Blueprint(rrb.Vertical(*parts)).save(path.stem, os.fspath(saved))
    return saved


def show(path: str | os.PathLike[str]) -> subprocess.Popen[bytes]:
    """Writes the blueprint of an exported MCAP file beside it and opens both in the viewer; returns its process."""
    return subprocess.Popen([sys.executable, "-m", "rerun", os.fspath(path), os.fspath(blueprint(path))])


def _curve(number: Number) -> rrb.TimeSeriesView:
    """A view of one number, on a scale to itself: q is in [0, 1], and w may be far below 0."""
    lines: Overrides = {number.topic: [_line(number)]}
    axis = rrb.ScalarAxis(range=(0.0, 1.0)) if number.name == "q" else None
    return rrb.TimeSeriesView(
        origin="/gleaner", name=number.name, contents=[number.topic], overrides=lines, axis_y=axis
    )


def _line(number: Number) -> rrb.Visualizer:
    component = f"{number.schema.replace('/', '.')}:message"
    source = encodings.ComponentSourceKind.SourceComponent
    mapping = encodings.VisualizerComponentMapping(
        "Scalars:scalars", source, source_component=component, selector=f".{number.path}"
    )
    return rr.SeriesLines(names=number.name).visualizer(mappings=[mapping])


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m gleaner.rerun", description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="exported MCAP file")
    parser.add_argument("--blueprint-only", action="store_true", help="write the blueprint beside it, open no viewer")
    given = parser.parse_args()

    def run() -> int:
        if given.blueprint_only:
            print(blueprint(given.file))
            return 0
        return show(given.file).wait()

    return ended(run)


if __name__ == "__main__":
    sys.exit(main())
