"""Chromium without a window over WebDriver, and local folders as a web site. Must not depend on a page."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, TypeVar

import pytest
from PIL import Image

T = TypeVar("T")

# Seconds for an event in the page, whose app may be large, and between two looks at it.
LIMIT, POLL = 90.0, 0.1
# How often the driver is started: it ends when the port that it chose for IPv4 is taken for IPv6.
STARTS = 5
# WebDriver's name of a reference to an element.
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
# Drawn by the processor: the pictures are the same on every machine.
ARGUMENTS = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1280,900"]


class Site:
    """The files of several folders at one local address; the first folder that has a file serves it."""

    def __init__(self, *folders: Path) -> None:
        class Files(SimpleHTTPRequestHandler):
            def translate_path(self, path: str) -> str:
                candidates = []
                for folder in folders:
                    self.directory = str(folder)
                    candidates.append(Path(super().translate_path(path)))
                return str(next((found for found in candidates if found.exists()), candidates[-1]))

            def log_message(self, *words: object) -> None:
                del words

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Files)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.address = f"http://127.0.0.1:{self._server.server_port}/index.html"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class Browser:
    """A browser with one tab, which saves its downloads in a folder."""

    def __init__(self, downloads: Path) -> None:
        self.downloads = downloads
        self._driver, port = _driver()
        self._at = f"http://127.0.0.1:{port}/session"
        wanted = {"goog:chromeOptions": {"args": ARGUMENTS}, "goog:loggingPrefs": {"browser": "ALL"}}
        started = self._call("POST", "", capabilities={"alwaysMatch": wanted})
        self._at += f"/{started['sessionId']}"
        self.devtools("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))

    def devtools(self, command: str, **params: Any) -> Any:
        """Runs a command of Chromium's developer tools."""
        return self._call("POST", "/goog/cdp/execute", cmd=command, params=params)

    def open(self, address: str) -> None:
        self._call("POST", "/url", url=address)

    def run(self, script: str, *values: object) -> Any:
        """The value that a script returns; `values` are its `arguments`."""
        return self._call("POST", "/execute/sync", script=script, args=values)

    def until(self, event: str, holds: Callable[[], T]) -> T:
        """Waits until a function returns a value that is not false; returns it."""
        end = time.monotonic() + LIMIT
        while not (found := holds()):
            assert time.monotonic() < end, f"{event}: not within {LIMIT:.0f} s; console: {self.console()}"
            time.sleep(POLL)
        return found

    def picture(self, css: str) -> Image.Image:
        """What an element shows."""
        element = self._call("POST", "/element", using="css selector", value=css)[ELEMENT]
        encoded = self._call("GET", f"/element/{element}/screenshot")
        return Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB")

    def save(self, path: Path) -> None:
        """Saves a picture of the page."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(self._call("GET", "/screenshot")))

    def console(self) -> list[str]:
        """The errors of the console since the last call."""
        log = self._call("POST", "/se/log", type="browser")
        return [entry["message"] for entry in log if entry["level"] == "SEVERE"]

    def close(self) -> None:
        try:
            self._call("DELETE", "")
        finally:
            self._driver.terminate()
            self._driver.wait()

    def _call(self, method: str, path: str, **body: Any) -> Any:
        data = json.dumps(body).encode() if method == "POST" else None
        request = urllib.request.Request(self._at + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=LIMIT) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            pytest.fail(f"chromedriver: {method} {path}: {json.load(error)['value']['message']}")


def _driver() -> tuple[subprocess.Popen[str], str]:
    """A started driver and its port."""
    program = shutil.which("chromedriver")
    if program is None:
        pytest.fail("chromedriver is not on the PATH; install it (Debian: chromium and chromium-driver)")
    for _ in range(STARTS):
        process = subprocess.Popen([program, "--port=0"], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            _, found, port = line.partition("started successfully on port ")
            if found:
                # The driver blocks if its output is not read.
                threading.Thread(target=partial(list, process.stdout), daemon=True).start()
                return process, port.strip().rstrip(".")
        process.wait()
    pytest.fail(f"chromedriver ended {STARTS} times before it listened")
