"""A loader in a process of its own, so that nothing of it runs beside what is compared with it."""

import json
import pathlib
import subprocess
import sys


def peer(kind: str, folder: pathlib.Path, window: int, seconds: float) -> float:
    """The samples a second of a kind of `loaders.py` over a folder."""
    program = pathlib.Path(__file__).parent / "loaders.py"
    words = [sys.executable, "-B", program, kind, folder, "--window", str(window), "--seconds", str(seconds)]
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])["samples_per_second"]
