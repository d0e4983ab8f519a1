"""The README's five lines, as they stand there, against a real server."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import gleaner
from test_policy import Reach, ReachAdapter

README = Path(__file__).parents[1] / "README.md"


def test_the_five_lines_work(
    client: gleaner.Client, server: str, deployment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)[0]
    assert len([line for line in code.splitlines() if line]) == 4
    code = code.replace("127.0.0.1:7400", server).replace("pick_cube@prod", deployment).replace("=50", "=2")
    exec(code, {"env": Reach(), "adapter": ReachAdapter()})
    said = capsys.readouterr().out
    assert said.startswith("1 of 2 solved: 0.50")
    evaluation = client.policies.evaluation(said.split()[-1])
    assert evaluation.simulation == "mysim/pick-v0"
