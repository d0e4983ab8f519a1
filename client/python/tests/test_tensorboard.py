"""The event files of `gleaner metrics --tensorboard`, read by TensorBoard itself."""

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
