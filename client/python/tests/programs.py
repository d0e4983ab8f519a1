"""The programs of the repository as child processes. Must not depend on fixtures or on a task."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def binary(name: str) -> str:
    """A program of the repository: as named by the environment, for example GLEANER_SERVER_BIN, or as built."""
    given = os.environ.get(f"{name.upper().replace('-', '_')}_BIN")
    found = Path(given) if given else ROOT / "target" / "debug" / name
    if not found.exists():
        pytest.exit(f"{found}: not built; run make demo or make test-python", returncode=2)
    return str(found)


def cli(*args: str) -> str:
    """Runs the command line tool, and returns what it prints."""
    done = subprocess.run([binary("gleaner"), *args], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def certificates(data: Path, *command: str) -> None:
    """Runs `gleaner-server tls …` over a data folder; the files are in its folder `tls`."""
    done = subprocess.run([binary("gleaner-server"), "tls", *command, "--data-dir", str(data)], check=False, text=True)
    assert done.returncode == 0


class Server:
    """A server process; `start` and `stop` can be called repeatedly over the same folder."""

    def __init__(self, data: Path, *flags: str) -> None:
        self.data, self.flags, self.listen = data, flags, "127.0.0.1:0"
        self.start()

    def start(self) -> None:
        """Starts it and waits until it listens: its first lines name its addresses."""
        command = [binary("gleaner-server"), "serve", "--listen", self.listen, "--data-dir", str(self.data)]
        self.process = subprocess.Popen(
            [*command, "--worker-threads", "1", *self.flags],
            stdout=subprocess.PIPE,
            text=True,
            env={"GLEANER_LOG": "warn", "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE", **os.environ},
        )
        assert self.process.stdout is not None
        self.openpi = ""
        line = self.process.stdout.readline()
        while not line.startswith("listening on ") and line:
            if line.startswith("clients of openpi on "):
                self.openpi = line.removeprefix("clients of openpi on ").strip()
            line = self.process.stdout.readline()
        assert line.startswith("listening on "), f"the server ended before it listened: {line!r}"
        self.address = line.removeprefix("listening on ").strip()
        # Clients reconnect to the same port after a restart.
        self.listen = self.address.rpartition("//")[2]

    def kill(self) -> None:
        """Kills it, as a power cut would."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        """Stops it with SIGTERM and waits for its end."""
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()
