#!/usr/bin/env python3
"""Draws the tables "At a glance" of docs/results.md as docs/experiments/at_a_glance.svg: for each row the success of a
policy trained on experts alone, on gleaned segments too, and on the simulator's own good steps.

    python scripts/at_a_glance.py [--check]

With --check it draws nothing and exits with 1 if the picture is not that of the tables.
"""

from __future__ import annotations

import argparse
import re
import sys
from html import escape
from itertools import dropwhile, takewhile
from pathlib import Path

ROOT = Path(__file__).parent.parent
TABLE = ROOT / "docs/results.md"
PICTURE = ROOT / "docs/experiments/at_a_glance.svg"

# Pixels.
LEFT, RIGHT, TOP, ROW, WIDTH = 400, 30, 56, 26, 910
# The columns that are drawn: heading, colour, radius.
COLUMNS = [("experts only", "#8a8f98", 5.0), ("gleaned", "#0b7a75", 6.5), ("the good steps", "#c58b1b", 5.0)]
DRAWN = {name for name, *_ in COLUMNS}


def rows(text: str) -> list[tuple[str, dict[str, float]]]:
    """The label of each row of the first table under each heading of the section, and the numbers that are drawn."""
    section = text.split("## At a glance\n", 1)[1].split("\n## ", 1)[0]
    found = []
    for part in section.split("\n### ")[1:]:
        simulator, *lines = part.splitlines()
        first = takewhile(lambda line: line.startswith("|"), dropwhile(lambda line: not line.startswith("|"), lines))
        table = [[cell.strip(" *").replace("`", "") for cell in line.strip("|").split("|")] for line in first]
        if not table:
            continue
        names, _, *body = table
        for cells in body:
            numbers = {}
            for name, cell in zip(names, cells, strict=True):
                number = re.match(r"\d+(\.\d+)?", cell)
                if name in DRAWN and number:
                    numbers[name] = float(number.group())
            found.append((f"{simulator}, {cells[0]}", numbers))
    return found


def picture(found: list[tuple[str, dict[str, float]]]) -> str:
    """The tables as dots on lines from 0 to 100 %."""
    height = TOP + ROW * len(found) + 34
    scale = (WIDTH - LEFT - RIGHT) / 100

    def at(value: float) -> str:
        return f"{LEFT + value * scale:.1f}"

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img"'
        ' font-family="system-ui, sans-serif" font-size="13">',
        "<title>Success of policies on experts only, with gleaned segments, and with the good steps</title>",
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
    ]
    for place, (name, colour, radius) in enumerate(COLUMNS):
        x = LEFT + 150 * place
        parts.append(f'<circle cx="{x + 6}" cy="20" r="{radius}" fill="{colour}"/>')
        parts.append(f'<text x="{x + 18}" y="24.5" fill="#22262b">{escape(name)}</text>')
    for value in range(0, 101, 20):
        bottom = height - 28
        parts.append(f'<line x1="{at(value)}" y1="{TOP - 16}" x2="{at(value)}" y2="{bottom}" stroke="#e3e6ea"/>')
        parts.append(f'<text x="{at(value)}" y="{height - 10}" text-anchor="middle" fill="#5b636d">{value} %</text>')
    for number, (label, values) in enumerate(found):
        y = TOP + ROW * number
        parts.append(f'<text x="{LEFT - 14}" y="{y + 4.5}" text-anchor="end" fill="#22262b">{escape(label)}</text>')
        if len(values) > 1:
            ends = at(min(values.values())), at(max(values.values()))
            parts.append(f'<line x1="{ends[0]}" y1="{y}" x2="{ends[1]}" y2="{y}" stroke="#c9ced4" stroke-width="3"/>')
        for name, colour, radius in COLUMNS:
            if name in values:
                parts.append(f'<circle cx="{at(values[name])}" cy="{y}" r="{radius}" fill="{colour}"/>')
    return "\n".join([*parts, "</svg>", ""])


def main() -> None:
    """Draws, or checks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare with the picture that is there")
    given = parser.parse_args()
    drawn = picture(rows(TABLE.read_text()))
    if not given.check:
        PICTURE.write_text(drawn)
    elif not PICTURE.exists() or PICTURE.read_text() != drawn:
        sys.exit(f"{PICTURE.relative_to(ROOT)} is not of the present tables: run scripts/at_a_glance.py")


if __name__ == "__main__":
    main()
