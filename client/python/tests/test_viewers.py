"""What Rerun and Foxglove are given beside an export: its pictures, and q and w as curves."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer as Ros2Writer

import gleaner
from conftest import TASK, Lab
from gleaner import foxglove


@pytest.fixture(scope="module")
def exported(client: gleaner.Client, lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A kept stretch as MCAP."""
    spec = {"export": {"dataset_id": lab.dataset, "format": "mcap"}}
    job = client.jobs.submit(TASK, spec, key="export mcap")
    client.jobs.wait(job, timeout=120)
    folder = tmp_path_factory.mktemp("viewers") / "mcap"
    client.datasets.download_export(job.result_id, folder)
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    name: str = next(line["file"] for line in lines if line["role"] == "imperfect")
    return folder / name


@pytest.fixture
def ros(tmp_path: Path) -> Path:
    """A ROS 2 file with q and no picture."""
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n")
        for step in range(3):
            writer.write_message("/gleaner/q", schema, {"data": step / 2}, log_time=step, publish_time=step)
        writer.finish()
    return path


def panels_of(node: Any) -> list[str]:
    """The panels of a layout's tree, from left to right."""
    return [node] if isinstance(node, str) else panels_of(node["first"]) + panels_of(node["second"])


def test_foxglove_layout_has_a_panel_for_each_camera_and_each_number(exported: Path) -> None:
    saved = foxglove.write_layout(exported)
    assert saved == exported.with_suffix(".layout.json")
    layout = json.loads(saved.read_text())
    panels = layout["configById"]
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    with exported.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    pictures = [panel["imageMode"]["imageTopic"] for name, panel in panels.items() if name.startswith("Image!")]
    assert set(pictures) == {topic for topic in topics if topic.startswith("/camera/")}
    plots = {name: panel["paths"] for name, panel in panels.items() if name.startswith("Plot!")}
    values = {name: [path["value"] for path in paths] for name, paths in plots.items()}
    # On one scale w, which may be far below 0, would make q a flat line.
    assert values == {"Plot!q": ["/gleaner/quality.q"], "Plot!w": ["/gleaner/quality.w"]}
    assert (panels["Plot!q"]["minYValue"], panels["Plot!q"]["maxYValue"]) == (0, 1)
    assert "minYValue" not in panels["Plot!w"]
    # A legend would cover the first steps of the curve; the title names it.
    assert [panels[name]["legendDisplay"] for name in plots] == ["none", "none"]
    assert [panels[name]["foxglovePanelTitle"] for name in plots] == ["q", "w"]


def test_foxglove_layout_shows_depth_up_to_two_metres(exported: Path) -> None:
    panels = foxglove.layout(exported)["configById"]
    depth = [
        panel["imageMode"] for panel in panels.values() if "/depth" in panel.get("imageMode", {}).get("imageTopic", "")
    ]
    assert depth
    assert all((mode["minValue"], mode["maxValue"]) == (0, 2000) for mode in depth)


def test_foxglove_layout_of_ros_scores_alone_is_one_plot(ros: Path) -> None:
    layout = foxglove.layout(ros)
    assert layout["layout"] == "Plot!q"
    assert [path["value"] for path in layout["configById"]["Plot!q"]["paths"]] == ["/gleaner/q.data"]


def test_files_without_anything_to_show_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"no recording")
    with pytest.raises(gleaner.errors.InvalidArgument, match="cannot be read as MCAP"):
        foxglove.layout(other)
    with pytest.raises(gleaner.errors.InvalidArgument, match="cannot be read as MCAP"):
        foxglove.layout(tmp_path / "missing.mcap")
    with other.open("wb") as file:
        Ros2Writer(file).finish()
    with pytest.raises(gleaner.errors.InvalidArgument, match="has neither pictures nor scores"):
        foxglove.layout(other)


def curves(printed: str) -> list[list[str]]:
    """The names of the curves of each view in a blueprint that Rerun has printed."""
    views: dict[str, list[str]] = {}
    for chunk in printed.split("\nChunk("):
        view = re.search(r"entity_path: /view/([0-9a-f-]+)/ViewContents/overrides/", chunk)
        name = re.search(r"┆ \[(\w+)\]", chunk)
        if view and name and "SeriesLines:names" in chunk:
            views.setdefault(view[1], []).append(name[1])
    return [*views.values()]


@pytest.mark.parametrize("kind", ["exported", "ros"])
def test_rerun_blueprint_is_read_by_rerun_for_that_file(kind: str, request: pytest.FixtureRequest) -> None:
    path: Path = request.getfixturevalue(kind)

    def run(*words: str | Path) -> str:
        done = subprocess.run([sys.executable, "-m", *words], check=True, capture_output=True, text=True)
        return done.stdout

    saved = Path(run("gleaner.rerun", path, "--blueprint-only").strip())
    assert saved == path.with_suffix(".rbl")
    run("rerun", "rrd", "verify", saved)
    printed = run("rerun", "rrd", "print", "-vvv", saved)
    # The viewer names the application of a file after it.
    assert f'"{path.stem}"' in printed
    # What the blueprint draws is what Rerun makes of the file.
    recording = path.with_suffix(".rrd")
    run("rerun", "mcap", "convert", path, "-o", recording)
    components = run("rerun", "rrd", "print", recording)
    expected = {"exported": "gleaner.Quality:message", "ros": "std_msgs.msg.Float64:message"}[kind]
    assert expected in components
    assert expected in printed
    # On one scale w, which may be far below 0, would make q a flat line.
    assert sorted(curves(printed)) == {"exported": [["q"], ["w"]], "ros": [["q"]]}[kind]
    assert printed.count("[[0.0, 1.0]]") == 1, "q has the scale of all its values"


@pytest.mark.parametrize("module", ["foxglove", "rerun"])
def test_a_file_that_cannot_be_shown_is_one_line(tmp_path: Path, module: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"no recording")
    options = ["--blueprint-only"] if module == "rerun" else []
    command = [sys.executable, "-m", f"gleaner.{module}", str(path), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"error: path: {path} cannot be read as MCAP")
    assert done.stderr.count("\n") == 1
