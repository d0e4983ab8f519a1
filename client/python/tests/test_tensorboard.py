"""The event files of `gleaner metrics --tensorboard` and of `gleaner jobs export`, read by TensorBoard itself."""

import json
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import gleaner
from conftest import Lab
from programs import cli


def test_tensorboard_reads_the_curves_of_a_job(server: str, client: gleaner.Client, lab: Lab, tmp_path: Path) -> None:
    cli("--server", server, "metrics", lab.pretrain.id, "--tensorboard", str(tmp_path))
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    curves = client.jobs.metrics(lab.pretrain)
    assert curves, "the job has metrics"
    assert set(events.Tags()["scalars"]) == {f"pretrain/{name}" for name in curves}
    for name, curve in curves.items():
        read = events.Scalars(f"pretrain/{name}")
        assert [event.step for event in read] == curve.steps.tolist()
        assert [event.value for event in read] == [float(value) for value in curve.values.astype("float32")]


def test_tensorboard_reads_a_run_of_each_job_that_is_exported(
    server: str, client: gleaner.Client, lab: Lab, tmp_path: Path
) -> None:
    exported = cli("--server", server, "jobs", "export", "--task", lab.pretrain.task_id, "--tensorboard", str(tmp_path))
    jobs = {job["id"]: job for job in map(json.loads, exported.splitlines())}
    assert list(jobs) == sorted(jobs), "the oldest comes first"
    assert lab.pretrain.id in jobs
    assert jobs[lab.pretrain.id]["spec"]["pretrain"]["settings"]["preset"] == "tiny"
    for name, job in jobs.items():
        curves = client.jobs.metrics(name)
        assert job["metrics"] == {name: curve.values[-1] for name, curve in curves.items()}
        if not curves:
            continue  # It has no folder.
        events = EventAccumulator(str(tmp_path / name))
        events.Reload()
        kind = next(iter(job["spec"]))
        assert set(events.Tags()["scalars"]) == {f"{kind}/{name}" for name in curves}
    assert {path.name for path in tmp_path.iterdir()} == {name for name, job in jobs.items() if job["metrics"]}
