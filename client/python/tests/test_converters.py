"""Recordings in formats that others convert: the command that is named makes recordings with the same steps."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbags.rosbag1
import rosbags.rosbag2
from rosbags.typesys import Stores, get_typestore

from programs import binary, cli

STEPS = 20
SECOND = 10**9


def messages(store: Any, k: int) -> dict[str, Any]:
    """The messages of a step, by topic; a header of ROS 1 has a number too."""
    ros = store.types
    stamp = ros["builtin_interfaces/msg/Time"](sec=SECOND + k // 10, nanosec=k % 10 * SECOND // 10)
    kind = ros["std_msgs/msg/Header"]
    numbered = {"seq": k} if "seq" in kind.__dataclass_fields__ else {}
    header = kind(**numbered, stamp=stamp, frame_id="base")
    image, joints, twist, vector = (
        ros[name]
        for name in (
            "sensor_msgs/msg/Image",
            "sensor_msgs/msg/JointState",
            "geometry_msgs/msg/Twist",
            "geometry_msgs/msg/Vector3",
        )
    )
    empty = np.array([])
    place = np.array([k * 0.1, -k * 0.1])
    picture = np.full(16 * 16 * 3, k, np.uint8)
    return {
        "/joint_states": joints(header, ["shoulder", "elbow"], place, velocity=empty, effort=empty),
        "/cmd": twist(linear=vector(k * 0.01, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)),
        "/camera": image(header, 16, 16, encoding="rgb8", is_bigendian=0, step=48, data=picture),
    }


def ros1_bag(folder: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    path = folder / "run.bag"
    with rosbags.rosbag1.Writer(path) as writer:
        write(writer, store, store.serialize_ros1)
    return path


def sqlite_bag(folder: Path) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = folder / "run"
    with rosbags.rosbag2.Writer(path, version=8, storage_plugin=rosbags.rosbag2.StoragePlugin.SQLITE3) as writer:
        write(writer, store, store.serialize_cdr)
    return path


def write(writer: Any, store: Any, serialize: Any) -> None:
    channels = {
        topic: writer.add_connection(topic, message.__msgtype__, typestore=store)
        for topic, message in messages(store, 0).items()
    }
    for k in range(STEPS):
        for topic, message in messages(store, k).items():
            writer.write(channels[topic], (10 * SECOND + k) * SECOND // 10, serialize(message, message.__msgtype__))


@pytest.mark.parametrize("bag", [ros1_bag, sqlite_bag])
def test_the_named_command_makes_a_recording_with_the_same_steps(bag: Any, tmp_path: Path, server: str) -> None:
    path = bag(tmp_path)
    refused = subprocess.run([binary("gleaner"), "inspect", str(path)], check=False, capture_output=True, text=True)
    assert refused.returncode != 0, refused.stdout
    command = shlex.split(refused.stderr.split("`")[1].replace("NEW_FOLDER", str(tmp_path / "made")))
    assert command[0] == "rosbags-convert", refused.stderr
    subprocess.run([Path(sys.executable).with_name(command[0]), *command[1:]], check=True)

    seen = json.loads(cli("--json", "inspect", str(tmp_path / "made")))
    topics = {topic["topic"]: topic for topic in seen["recordings"][0]["survey"]["topics"]}
    assert {name: topic["messages"] for name, topic in topics.items()} == dict.fromkeys(
        messages(get_typestore(Stores.LATEST), 0), STEPS
    )
    position = next(field for field in topics["/joint_states"]["fields"] if field["path"] == "position")
    assert position["names"] == ["shoulder", "elbow"]
    last = STEPS / 10 - 0.1
    assert [(round(r["minimum"], 9), round(r["maximum"], 9)) for r in position["ranges"]] == [(0, last), (-last, 0)]
    assert (topics["/camera"]["camera"]["height"], topics["/camera"]["camera"]["unreadable"]) == (16, 0)
    task = tmp_path / "task.toml"
    name = bag.__name__
    task.write_text(cli("task", "draft", str(tmp_path / "made"), "--name", name))
    cli("--server", server, "task", "create", str(task))
    pushed = json.loads(cli("--server", server, "--json", "push", str(tmp_path / "made"), "--task", name))
    assert [int(entry["episode"]["steps"]) for entry in pushed["episodes"]] == [STEPS]
