"""The open-source Foxglove Studio 1.48 in a browser, over one recording and one layout. Knows no server."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from browser import Browser, Site

# Where `make check-foxglove` installs the app.
APP = os.environ.get("GLEANER_FOXGLOVE_APP")
PAGE = Path(__file__).parent / "foxglove"
# A pixel whose channels differ by more belongs to a curve: axes, grids and texts are grey.
COLOURED = 60

OPENED = "return self.playerState?.presence == 'PRESENT'"
FOUND = "return document.querySelector(arguments[0]) != null"
CLICK = "document.querySelector(arguments[0]).click()"
TEXT = "return document.querySelector(arguments[0]).innerText"
# The tab of the list of problems, with their number if there are any.
PROBLEMS = """
const tab = [...document.querySelectorAll("[role=tab]")].find((tab) => /^Problems/i.test(tab.innerText));
tab.click();
return tab.ariaSelected == "true";
"""
LISTED = "return [...document.querySelectorAll('.MuiListItemText-primary')].map((item) => item.innerText)"


def for_1_48(layout: dict[str, Any]) -> dict[str, Any]:
    """The layout with 1.48's panel of pictures, which later versions convert to the layout's own, `Image`."""
    converted: dict[str, Any] = json.loads(json.dumps(layout).replace('"Image!', '"ImageViewPanel!'))
    for panel in converted["configById"].values():
        for key, value in panel.pop("imageMode", {}).items():
            panel["cameraTopic" if key == "imageTopic" else key] = value
    return converted


class Studio:
    """The app over one file."""

    def __init__(self, browser: Browser, folder: Path, recording: Path, layout: dict[str, Any]) -> None:
        self._browser = browser
        folder.mkdir()
        (folder / "recording.mcap").write_bytes(recording.read_bytes())
        (folder / "layout.json").write_text(json.dumps(layout))
        self._site = Site(folder, PAGE, Path(str(APP)))
        browser.open(self._site.address)
        browser.until("the recording is open", partial(browser.run, OPENED))
        for panel in layout["configById"]:
            browser.until(f"{panel} is there", partial(browser.run, FOUND, self._css(panel)))

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *error: object) -> None:
        self._site.close()

    def until(self, event: str, holds: Callable[[], bool]) -> None:
        """Waits until a function returns true."""
        self._browser.until(event, holds)

    def text(self, panel: str) -> str:
        """The text of a panel, which is also that of an error in its place."""
        return str(self._browser.run(TEXT, self._css(panel)))

    def problems(self) -> list[str]:
        """The app's list of problems with the recording."""
        self._browser.until("the list of problems is open", partial(self._browser.run, PROBLEMS))
        found: list[str] = self._browser.run(LISTED)
        assert bool(found) != ("No problems found" in self._browser.run(TEXT, "body")), found
        return found

    def now(self) -> int:
        """The time that the app shows, in nanoseconds."""
        time = self._browser.run("return self.playerState.activeData.currentTime")
        return int(time["sec"] * 10**9 + time["nsec"])

    def picture(self, panel: str) -> Image.Image:
        """What a panel of pictures shows."""
        return self._browser.picture(self._css(panel) + " canvas")

    def plotted(self, panel: str) -> list[float]:
        """The numbers of a plot, as the app saves them."""
        saved = self._browser.downloads / "plot_data.csv"
        saved.unlink(missing_ok=True)
        self._browser.run(CLICK, f'{self._css(panel)} [title="Download plot data as CSV"]')
        self._browser.until(f"the data of {panel} is saved", saved.exists)
        return [float(row["value"]) for row in csv.DictReader(io.StringIO(saved.read_text()))]

    def curve(self, panel: str) -> float:
        """The share of a plot's width that has a curve."""
        shown = np.asarray(self._browser.picture(self._css(panel) + " canvas"), dtype=int)
        coloured = np.ptp(shown, axis=2) > COLOURED
        return float(coloured.any(axis=0).mean())

    @staticmethod
    def _css(panel: str) -> str:
        return f'[data-testid="panel-mouseenter-container {panel}"]'
