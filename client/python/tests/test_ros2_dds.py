"""The ROS 2 example with rclpy itself: its node, a real server and a robot exchange messages over DDS.

`make check-ros2` installs rclpy; elsewhere these tests are skipped.
"""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import gleaner
from conftest import TASK
from fake_ros import EXAMPLE, picture
from gleaner._proto.v1 import task_pb2
from gleaner.types import TaskSpec
from programs import Server
from test_policy import observation
from test_ros2_node import ARM, IN_ROOT, JOINTS, TOOL, Posed

rclpy = pytest.importorskip("rclpy", reason="run make check-ros2")
executors = pytest.importorskip("rclpy.executors")
qos = pytest.importorskip("rclpy.qos")
geometry_msgs = pytest.importorskip("geometry_msgs.msg")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")
std_msgs = pytest.importorskip("std_msgs.msg")

# Seconds; shorter than the time that the node waits for an answer of the server.
LIMIT = 40.0
# Seconds between two observations of the robot; the control period of the task is twice as long.
PERIOD = 0.05
# Seconds, for `max_age` and `watchdog`: longer than the delays of a busy machine.
PATIENCE = 2.0
# No action of the policy: its gripper is open or closed.
STOP = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TYPES = [f"{topic}={TRANSFORM}" for topic in ("/tf", "/tf_static")]
AXES = ("x", "y", "z")
KEPT = qos.QoSProfile(depth=10, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)


def ros_mapping(spec: TaskSpec) -> task_pb2.Mapping:
    """The topics of a robot with joints, images, and a stamped twist and a number as commands."""
    first, *others = [field.name for field in spec.proprioception]
    sources = [("/joint_states", first, ["position"])]
    sources += [
        (f"/{name}", name, [f"data[0:{field.size}]"])
        for name, field in zip(others, spec.proprioception[1:], strict=True)
    ]
    parts = [f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in AXES]
    sources += [("/servo/twist", "delta_position", parts[:3]), ("/servo/twist", "delta_rotation", parts[3:])]
    sources += [("/gripper/command", "gripper", ["data"])]
    fields = [task_pb2.FieldSource(field=field, topic=topic, paths=paths) for topic, field, paths in sources]
    fields[0].names.extend(JOINTS[: spec.proprioception[0].size])
    cameras = [
        task_pb2.CameraSource(camera=one.name, color=f"/{one.name}", depth=f"/{one.name}/depth" if one.depth else "")
        for one in spec.cameras
    ]
    return task_pb2.Mapping(name="ros", clock="/servo/twist", cameras=cameras, fields=fields)


def image(pixels: np.ndarray[Any, Any], encoding: str) -> Any:
    return sensor_msgs.Image(**vars(picture(pixels, encoding)))


def messages(spec: TaskSpec, seen: Mapping[str, Any]) -> dict[str, Any]:
    """An observation as messages by topic: joints in another order than the task's, images with padded rows."""
    found: dict[str, Any] = {}
    values = [float(value) for value in seen["proprioception"]]
    for at, field in enumerate(spec.proprioception):
        part, values = values[: field.size], values[field.size :]
        if at == 0:
            found["/joint_states"] = sensor_msgs.JointState(name=JOINTS[: field.size][::-1], position=part[::-1])
        else:
            found[f"/{field.name}"] = std_msgs.Float64MultiArray(data=[*part, 99.0])
    found |= {f"/{name}": image(pixels[..., ::-1], "bgr8") for name, pixels in seen["images"].items()}
    found |= {f"/{name}/depth": image(pixels[..., None], "16UC1") for name, pixels in seen["depth"].items()}
    return found


class Robot:
    """A node of its own that sends the same messages each period and keeps what it receives."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("robot")
        self.executor = executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.twists: list[list[float]] = []
        self.grippers: list[float] = []
        self.active: list[bool] = []
        self.sent: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._changed = threading.Condition()
        self.node.create_timer(PERIOD, self._send)
        subscribe = self.node.create_subscription
        subscribe(geometry_msgs.TwistStamped, "/servo/twist", self._noted(self._twist), 100)
        subscribe(std_msgs.Float64, "/gripper/command", self._noted(lambda one: self.grippers.append(one.data)), 100)
        subscribe(std_msgs.Bool, "/gleaner/active", self._noted(lambda one: self.active.append(one.data)), 100)
        self._thread = threading.Thread(target=self.executor.spin, daemon=True)
        self._thread.start()

    def advertise(self, topics: Mapping[str, Any]) -> None:
        """Makes topics and their types visible, without a message."""
        for topic, message in topics.items():
            self._publishers[topic] = self.node.create_publisher(type(message), topic, 1)

    def send(self, topics: Mapping[str, Any]) -> None:
        """Begins to send these messages, or ends it with none."""
        self.advertise({topic: message for topic, message in topics.items() if topic not in self._publishers})
        self.sent = dict(topics)

    def wait(self, condition: Callable[[], bool], alive: Callable[[], bool] = lambda: True) -> bool:
        """Waits until a condition holds; False when it does not within the limit or the other side has ended."""
        with self._changed:
            self._changed.wait_for(lambda: condition() or not alive(), LIMIT)
        return condition()

    def executes(self, action: Any) -> bool:
        """Whether the newest commands are those of an action."""
        newest = [value for twist in self.twists[-1:] for value in twist] + self.grippers[-1:]
        return len(newest) == len(action) and np.allclose(newest, action, atol=1e-5)

    def close(self) -> None:
        self.executor.shutdown()
        self._thread.join()
        self.node.destroy_node()

    def _send(self) -> None:
        for topic, message in self.sent.items():
            self._publishers[topic].publish(message)
        with self._changed:
            self._changed.notify_all()

    def _noted(self, keep: Callable[[Any], None]) -> Callable[[Any], None]:
        def received(message: Any) -> None:
            with self._changed:
                keep(message)
                self._changed.notify_all()

        return received

    def _twist(self, message: Any) -> None:
        parts = (message.twist.linear, message.twist.angular)
        self.twists.append([getattr(part, axis) for part in parts for axis in AXES])


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    """On a domain of its own, whose messages do not leave the machine."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 100 + 1))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros"))
    rclpy.init(args=["--ros-args", "-p", f"types:={TYPES}"])
    found = Robot()
    yield found
    found.close()
    rclpy.shutdown()


class Driven:
    """The node of the example in a process of its own, which drives the robot with the deployment."""

    def __init__(self, robot: Robot, spec: TaskSpec, log: Path, server: str, deployment: str) -> None:
        self.robot, self.log = robot, log
        robot.advertise(messages(spec, observation(spec)))
        given: dict[str, Any] = {"server": server, "deployment": deployment, "mapping": "ros", "stop_action": STOP}
        given |= {"max_age": PATIENCE, "watchdog": PATIENCE, "record": "true", "cohort": "dds"}
        parameters = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        command = [sys.executable, str(EXAMPLE / "gleaner_node.py"), "--ros-args", *parameters]
        with log.open("wb") as errors:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)

    def wait(self, condition: Callable[[], bool]) -> None:
        """Waits for the robot until a condition holds."""
        held = self.robot.wait(condition, lambda: self.process.poll() is None)
        assert held, f"exit {self.process.poll()}; active {self.robot.active[-3:]}; log: {self.log.read_text()[-3000:]}"

    def drive(self, topics: Mapping[str, Any]) -> None:
        """Sends observations until the node acts."""
        self.robot.send(topics)
        acts = len(self.robot.twists)
        self.wait(lambda: self.robot.active[-1:] == [True] and len(self.robot.twists) > acts + 3)

    def stopped(self) -> bool:
        """Whether the newest command is the one that stops the robot, and the node reports it."""
        return self.robot.executes(STOP) and self.robot.active[-1:] == [False]

    def ends(self, number: int) -> str:
        """Sends a signal; returns what the node printed at its end."""
        self.process.send_signal(number)
        printed, _ = self.process.communicate(timeout=LIMIT)
        assert self.process.returncode == 0, self.log.read_text()
        return printed.strip()


@pytest.fixture
def spec(client: gleaner.Client, deployment: str) -> TaskSpec:
    """The task, with a mapping for the robot."""
    del deployment
    found = client.tasks.get(TASK).spec
    if all(one.name != "ros" for one in found.mappings):
        found.mappings.append(ros_mapping(found))
        client.tasks.update(TASK, found)
    return found


@pytest.fixture
def driven(robot: Robot, spec: TaskSpec, tmp_path: Path, server: str, deployment: str) -> Iterator[Driven]:
    found = Driven(robot, spec, tmp_path / "log", server, deployment)
    yield found
    found.process.kill()
    found.process.communicate()


def test_actions_over_dds_are_those_of_a_session(
    client: gleaner.Client, deployment: str, spec: TaskSpec, driven: Driven
) -> None:
    robot = driven.robot
    for seed in range(2):
        seen = observation(spec, seed)
        with gleaner.Policy(client, deployment) as policy:
            expected = [policy(seen) for _ in range(20)][-1]
        driven.drive(messages(spec, seen))
        # With the same observation again and again the actions settle.
        driven.wait(partial(robot.executes, expected))


def test_watchdog_stops_the_robot_when_observations_stop(spec: TaskSpec, driven: Driven) -> None:
    robot, topics = driven.robot, messages(spec, observation(spec))
    driven.drive(topics)
    acts = len(robot.twists)
    robot.send({})
    driven.wait(driven.stopped)
    commands, reports = len(robot.twists), len(robot.active)
    driven.wait(lambda: len(robot.active) > reports + 10)
    assert len(robot.twists) == commands, "no command follows"
    assert not any(robot.active[reports:])
    assert robot.twists[acts:].count(STOP[:-1]) == 1
    stale = re.findall(r"no action: no message on /\S+ for 2 s", driven.log.read_text())
    assert len(stale) == len(set(stale)) > 0, "each reason is logged once"
    # One topic alone is not enough.
    robot.send({"/joint_states": topics["/joint_states"]})
    reports = len(robot.active)
    driven.wait(lambda: len(robot.active) > reports + 10)
    assert len(robot.twists) == commands
    driven.drive(topics)


def test_watchdog_stops_the_robot_while_a_call_waits_for_the_server(
    spec: TaskSpec, driven: Driven, running: Server
) -> None:
    topics = messages(spec, observation(spec))
    driven.drive(topics)
    running.process.send_signal(signal.SIGSTOP)
    try:
        driven.wait(driven.stopped)
    finally:
        running.process.send_signal(signal.SIGCONT)
    driven.drive(topics)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_stops_the_robot_and_ends_the_episode(
    client: gleaner.Client, spec: TaskSpec, driven: Driven, number: int
) -> None:
    robot = driven.robot
    driven.drive(messages(spec, observation(spec)))
    recorded = driven.ends(number)
    assert robot.wait(driven.stopped)
    assert client.episodes.get(recorded).cohort == "dds"


def test_signal_stops_the_robot_while_a_call_waits_for_the_server(
    spec: TaskSpec, driven: Driven, running: Server
) -> None:
    robot = driven.robot
    driven.drive(messages(spec, observation(spec)))
    running.process.send_signal(signal.SIGSTOP)
    try:
        # Periods in which the node has begun a call.
        reports = len(robot.active)
        driven.wait(lambda: len(robot.active) > reports + 5)
        driven.process.send_signal(signal.SIGINT)
        driven.wait(lambda: robot.executes(STOP))
    finally:
        running.process.send_signal(signal.SIGCONT)
    driven.ends(signal.SIGINT)
    assert robot.executes(STOP), "no action follows"


def stamped(transform: Any) -> Any:
    """A transform of the stand-in's tests as a message."""
    found = geometry_msgs.TransformStamped(child_frame_id=transform.child_frame_id)
    found.header.frame_id = transform.header.frame_id
    for name in ("translation", "rotation"):
        for axis, value in vars(getattr(transform.transform, name)).items():
            setattr(getattr(found.transform, name), axis, float(value))
    return found


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module of the node, with rclpy."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    yield importlib.import_module("gleaner_node")
    for name in ("messages", "transforms", "control", "gleaner_node"):
        sys.modules.pop(name, None)


def test_poses_are_composed_from_transforms_over_dds(robot: Robot, node: ModuleType) -> None:
    # Published once, before the node begins.
    fixed = robot.node.create_publisher(geometry_msgs.TransformStamped, "/tf_static", KEPT)
    fixed.publish(stamped(TOOL))
    commands: list[list[float]] = []
    robot.node.create_subscription(std_msgs.Float64MultiArray, "/command", lambda one: commands.append([*one.data]), 10)
    policy: Any = Posed()
    acting = node.GleanerNode(policy)
    robot.executor.add_node(acting)
    robot.send({"/tf": stamped(ARM)})
    acting.start()
    try:
        assert robot.wait(lambda: len(commands) > 0)
        np.testing.assert_allclose(np.asarray(policy.seen[0].proprioception), IN_ROOT, atol=1e-8)
        assert commands[0] == [0.0] * 7
    finally:
        acting.end()
        robot.executor.remove_node(acting)
        acting.destroy_node()
