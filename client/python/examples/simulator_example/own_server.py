"""A server for one run, over the run's folder: started on a free port, stopped at the end."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_STOPPING_S = 40.0


@contextmanager
def own_server(program: Path, data: Path) -> Iterator[str]:
    """Yields the address of the server, whose data stay in the folder."""
    command = [str(program), "serve", "--listen", "127.0.0.1:0", "--data-dir", str(data)]
    # An environment variable also applies to the workers.
    quiet = {"GLEANER_LOG": "warn", **os.environ}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet) as process:
        try:
            # Its first line names the address, once it listens.
            line = process.stdout.readline() if process.stdout is not None else ""
            if not line.startswith("listening on "):
                raise SystemExit(f"--server-bin {program}: it ended before it was listening; its output is above")
            yield line.removeprefix("listening on ").strip()
        finally:
            process.terminate()
            try:
                process.wait(_STOPPING_S)
            except subprocess.TimeoutExpired:
                process.kill()
