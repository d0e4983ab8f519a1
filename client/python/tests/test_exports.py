"""Exports of every format, read by the packages that users read them with."""

from __future__ import annotations

import io
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders
from mcap_ros2.writer import Writer as Ros2Writer
from PIL import Image
from rosbags.highlevel import AnyReader

import gleaner
from conftest import IMAGE, TASK, Lab

DEFINITION = "float64[2] values\n"
STEPS = 12


@pytest.fixture(scope="module")
def exported(client: gleaner.Client, lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folder of each format."""
    folders = {}
    for format_ in ("mcap", "lerobot", "robomimic"):
        spec = {"export": {"dataset_id": lab.dataset, "format": format_}}
        job = client.jobs.submit(TASK, spec, key=f"export {format_}")
        client.jobs.wait(job, timeout=120)
        folders[format_] = tmp_path_factory.mktemp("exports") / format_
        client.datasets.download_export(job.result_id, folders[format_])
    return folders


def stretches(folder: Path) -> list[dict[str, Any]]:
    """The lines of the manifest that are not experts."""
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    return [line for line in lines if line["role"] == "imperfect"]


def test_manifest_is_read_by_pandas(exported: dict[str, Path]) -> None:
    folder = exported["mcap"]
    table = pd.read_parquet(folder / "manifest.parquet")
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    for name in ("episode", "source", "file", "role", "first_step", "last_step", "segment_length"):
        assert table[name].tolist() == [line[name] for line in lines]
    kept = table[table["role"] == "imperfect"].explode("steps")
    steps = pd.DataFrame(kept["steps"].tolist())
    expected = pd.DataFrame([step for line in stretches(folder) for step in line["steps"]])
    assert len(steps) > 0
    for name in ("step", "w", "nearest_episode", "nearest_step"):
        assert steps[name].tolist() == expected[name].tolist()
    assert steps["q"].tolist() == expected["q"].astype(np.float32).tolist()


def test_exported_scores_are_read_by_mcap_protobuf(exported: dict[str, Path]) -> None:
    for line in stretches(exported["mcap"]):
        with (exported["mcap"] / line["file"]).open("rb") as file:
            reader = make_reader(file, decoder_factories=[ProtobufDecoders()])
            found = [message for *_, message in reader.iter_decoded_messages(topics=["/gleaner/quality"])]
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert [message.step for message in found] == list(range(line["first_step"], line["last_step"] + 1))
        kept = {step["step"]: step for step in line["steps"]}
        for message in found:
            assert message.kept == (message.step in kept)
            if message.kept:
                step = kept[message.step]
                assert message.q == np.float32(step["q"])
                assert message.w == step["w"]
                assert (message.match_episode, message.match_step) == (step["nearest_episode"], step["nearest_step"])
        assert metadata["gleaner"]["outcome"] == "failure"
        assert metadata["gleaner"]["cohort"] == "wrong_goal"
        assert metadata["gleaner"]["run"].startswith("run_")


def test_lerobot_export_is_read_by_pyarrow(exported: dict[str, Path]) -> None:
    folder = exported["lerobot"]
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    frames = pq.read_table(folder / "data/chunk-000/file-000.parquet")
    assert set(frames.column_names) == set(info["features"])
    assert frames["index"].to_pylist() == list(range(info["total_frames"]))
    picture = frames["observation.images.hand"][0].as_py()
    assert picture["path"] is None
    assert Image.open(io.BytesIO(picture["bytes"])).size == (IMAGE, IMAGE)
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    assert sum(episodes["length"].to_pylist()) == info["total_frames"]
    lengths = [line["last_step"] - line["first_step"] + 1 for line in stretches(exported["mcap"])]
    roles = episodes["gleaner.role"].to_pylist()
    assert episodes["length"].to_pylist()[roles.index("imperfect") :] == lengths
    tasks = pq.read_table(folder / "meta/tasks.parquet").to_pandas()
    assert tasks.index.tolist() == [TASK]
    assert tasks.index.name == "task"
    action = np.stack(frames["action"].to_numpy())
    stats = json.loads((folder / "meta/stats.json").read_text())
    np.testing.assert_allclose(stats["action"]["mean"], action.mean(0, dtype=np.float64), atol=1e-9)
    np.testing.assert_allclose(stats["action"]["std"], action.std(0, dtype=np.float64), atol=1e-9)
    np.testing.assert_allclose(stats["action"]["q90"], np.quantile(action.astype(np.float64), 0.9, axis=0), atol=1e-9)


def test_lerobot_video_is_read_by_av(
    client: gleaner.Client, lab: Lab, exported: dict[str, Path], tmp_path: Path
) -> None:
    spec = {"export": {"dataset_id": lab.dataset, "format": "lerobot", "video": True}}
    job = client.jobs.submit(TASK, spec, key="export lerobot video")
    client.jobs.wait(job, timeout=120)
    client.datasets.download_export(job.result_id, tmp_path / "video")
    frames = pq.read_table(exported["lerobot"] / "data/chunk-000/file-000.parquet")
    pictures = [Image.open(io.BytesIO(cell["bytes"])) for cell in frames["observation.images.hand"].to_pylist()]
    with av.open(str(tmp_path / "video/videos/observation.images.hand/chunk-000/file-000.mp4")) as film:
        rate = json.loads((tmp_path / "video/meta/info.json").read_text())["fps"]
        assert film.streams.video[0].average_rate == rate
        found = list(film.decode(video=0))
    times = [frame.pts * frame.time_base for frame in found if frame.pts is not None and frame.time_base is not None]
    assert times == [Fraction(at, rate) for at in range(len(pictures))]
    for frame, picture in zip(found, pictures, strict=True):
        error = frame.to_ndarray(format="rgb24").astype(float) - np.asarray(picture.convert("RGB"), dtype=float)
        assert 10 * np.log10(255**2 / np.mean(error**2)) > 20


def test_whole_episodes_have_scores_and_weights_at_every_step(
    client: gleaner.Client, lab: Lab, exported: dict[str, Path], tmp_path: Path
) -> None:
    spec = {"export": {"dataset_id": lab.dataset, "format": "lerobot", "whole": True}}
    job = client.jobs.submit(TASK, spec, key="export whole episodes")
    client.jobs.wait(job, timeout=120)
    client.datasets.download_export(job.result_id, tmp_path / "whole")
    episodes = pq.read_table(tmp_path / "whole/meta/episodes/chunk-000/file-000.parquet").to_pandas()
    frames = pq.read_table(tmp_path / "whole/data/chunk-000/file-000.parquet").to_pandas()
    imperfect = episodes[episodes["gleaner.role"] == "imperfect"]
    assert (imperfect["gleaner.first_step"] == 0).all()
    kept = {
        (line["episode"], step["step"]): step["q"] for line in stretches(exported["mcap"]) for step in line["steps"]
    }
    assert kept
    found: dict[tuple[str, int], float] = {}
    for row in imperfect.itertuples():
        own = frames[frames["episode_index"] == row.episode_index]
        name = episodes["gleaner.episode"][row.Index]
        assert own["gleaner.step"].tolist() == list(range(len(own)))
        found |= {(name, step): w for step, w in zip(own["gleaner.step"], own["gleaner.weight"], strict=True) if w > 0}
    assert found == {key: pytest.approx(q) for key, q in kept.items()}


def test_robomimic_export_is_read_by_h5py(exported: dict[str, Path]) -> None:
    with h5py.File(exported["robomimic"] / "dataset.hdf5") as file:
        assert json.loads(file["data"].attrs["env_args"])["env_name"] == TASK
        kept = [name.decode() for name in file["mask/kept"][()]]
        assert len(kept) == len(stretches(exported["mcap"]))
        assert len(file["mask/experts"]) == 4
        for name, line in zip(kept, stretches(exported["mcap"]), strict=True):
            demo = file["data"][name]
            steps = line["last_step"] - line["first_step"] + 1
            assert demo.attrs["num_samples"] == steps
            assert demo["obs/hand_image"].shape == (steps, IMAGE, IMAGE, 3)
            assert np.count_nonzero(demo["weights"][()]) == len(line["steps"])
            assert np.abs(demo["actions"][()]).max() <= 1
        assert sum(demo.attrs["num_samples"] for demo in file["data"].values()) == file["data"].attrs["total"]


def ros2_recording(path: Path, sign: float) -> Path:
    """A recording of ROS 2 messages in CDR."""
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schemas = {
            topic: writer.register_msgdef(f"lab_msgs/msg/{topic.title()}", DEFINITION) for topic in ("state", "goal")
        }
        for step in range(STEPS):
            time = 1_000_000_000 + step * 100_000_000
            for topic, schema in schemas.items():
                message = {"values": [sign * step, sign]}
                writer.write_message(f"/{topic}", schema, message, log_time=time, publish_time=time)
        writer.finish()
    return path


def test_ros2_readers_read_an_exported_ros2_recording(client: gleaner.Client, tmp_path: Path) -> None:
    fields = {"state": "/state", "goal": "/goal"}
    sources = [{"field": name, "topic": topic, "paths": ["values"]} for name, topic in fields.items()]
    client.tasks.create(
        {
            "name": "ros2_export",
            "rate_hz": 10.0,
            "proprioception": [{"name": "state", "size": 2}],
            "action": [{"name": "goal", "size": 2}],
            "mappings": [{"name": "ros2", "fields": sources}],
        }
    )
    push = client.episodes.push
    push(ros2_recording(tmp_path / "good.mcap", 1.0), task="ros2_export", outcome="success")
    failed = push(ros2_recording(tmp_path / "bad.mcap", -1.0), task="ros2_export", outcome="failure")
    snapshot = client.snapshots.create("ros2_export")
    q = [0.25] * 4 + [0.75] * 4 + [0.25] * 4
    table = {"episode": [failed.id] * STEPS, "step": list(range(STEPS)), "q": q}
    run = client.scores.import_scores(snapshot.id, table)
    dataset = client.datasets.create(run.id, beta=0.5)
    job = client.jobs.submit("ros2_export", {"export": {"dataset_id": dataset.id, "format": "mcap"}})
    client.jobs.wait(job, timeout=120)
    client.datasets.download_export(job.result_id, tmp_path / "out")
    (line,) = stretches(tmp_path / "out")
    path = tmp_path / "out" / line["file"]

    # Every message of the file: a topic that is not CDR would end this reader with an error.
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros2Decoders()])
        decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    assert [message.data for topic, message in decoded if topic == "/gleaner/q"] == [0.75] * 4
    assert [message.data for topic, message in decoded if topic == "/gleaner/step"] == [4, 5, 6, 7]
    assert all(message.data for topic, message in decoded if topic == "/gleaner/kept")
    with AnyReader([path]) as bag:
        connections = [one for one in bag.connections if one.topic == "/gleaner/w"]
        values = [vars(bag.deserialize(raw, one.msgtype))["data"] for one, _, raw in bag.messages(connections)]
    assert values == [0.75] * 4, "the w of an import is its q"


def test_an_export_does_not_leave_its_folder(tmp_path: Path) -> None:
    from gleaner._download import below

    assert below(tmp_path, "data/chunk-000/file-000.parquet") == tmp_path / "data/chunk-000/file-000.parquet"
    for name in ("", "/etc/passwd", "../up", "a/../../up", "a//b", "a/"):
        with pytest.raises(gleaner.Damaged, match="outside the folder"):
            below(tmp_path, name)


def test_export_is_not_written_into_a_folder_with_files(
    client: gleaner.Client, exported: dict[str, Path], lab: Lab, tmp_path: Path
) -> None:
    del exported
    spec = {"export": {"dataset_id": lab.dataset, "format": "robomimic"}}
    export = client.jobs.submit(TASK, spec, key="export robomimic").result_id
    other = tmp_path / "other"
    other.write_text("another file")
    for folder in (tmp_path, other):
        with pytest.raises(gleaner.errors.InvalidArgument, match=r"folder: .* is not an empty folder"):
            client.datasets.download_export(export, folder)
    assert [path.name for path in tmp_path.iterdir()] == ["other"]
    # An empty folder, and one whose parents do not exist yet, are taken.
    for folder in (tmp_path / "empty", tmp_path / "new" / "deep"):
        (tmp_path / "empty").mkdir(exist_ok=True)
        files = client.datasets.download_export(export, folder)
        assert [path.relative_to(folder).as_posix() for path in files] == ["dataset.hdf5"]
        assert [*folder.iterdir()] == files
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "new", "other"]
