"""The ROS 2 example drives a deployment by the task's mapping: its node over a stand-in for rclpy (`fake_ros`)."""

from __future__ import annotations

import importlib
import re
import threading
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gleaner
from conftest import DEPLOYMENT
from fake_ros import EXAMPLE, Array, Graph, JointState, picture
from gleaner._proto.v1.task_pb2 import CameraSource, FieldSource, FieldSpec, Mapping, TaskSpec, Transform
from gleaner.observation import size
from test_policy import observation

JOINTS = [f"joint{number}" for number in range(64)]
TF, ARRAY = "tf2_msgs/msg/TFMessage", "test_msgs/msg/Array"


class Image:
    pass


class Robot:
    """A node with a real deployment, and the topics of a mapping in which everything has a topic of its own."""

    def __init__(self, client: gleaner.Client, monkeypatch: pytest.MonkeyPatch, **parameters: Any) -> None:
        self.policy = gleaner.Policy(client, DEPLOYMENT)
        spec = self.spec = self.policy.spec
        # The first field and the action are joints by name, others plain arrays.
        first = spec.proprioception[0]
        fields = [FieldSource(field=first.name, topic="/joints", paths=["position"], names=JOINTS[: first.size])]
        for field in spec.proprioception[1:]:
            fields.append(FieldSource(field=field.name, topic=f"/{field.name}", paths=[f"data[0:{field.size}]"]))
        at = 0
        for field in spec.action:
            fields.append(FieldSource(field=field.name, topic="/command", paths=[f"data[{at}:{at + field.size}]"]))
            at += field.size
        cameras = [
            CameraSource(
                camera=camera.name, color=f"/{camera.name}", depth=f"/{camera.name}/depth" if camera.depth else ""
            )
            for camera in spec.cameras
        ]
        del spec.mappings[:]
        spec.mappings.append(Mapping(name="ros", cameras=cameras, fields=fields))
        classes: dict[str, type] = {f"test_msgs/msg/{one.__name__}": one for one in (JointState, Array, Image)}
        types = {"/joints": "test_msgs/msg/JointState"}
        types |= {source.topic: ARRAY for source in fields[1:]}
        types |= {topic: "test_msgs/msg/Image" for source in cameras for topic in (source.color, source.depth) if topic}
        self.graph = Graph(types, classes, parameters)
        self.graph.install(monkeypatch)
        self.node: Any = importlib.import_module("gleaner_node").GleanerNode(self.policy)

    def see(self, seen: dict[str, Any]) -> None:
        """Sends an observation as ROS messages; joints in another order than the task's, images with padded rows."""
        values = np.asarray(seen["proprioception"], np.float64)
        for field in self.spec.proprioception:
            part, values = values[: field.size], values[field.size :]
            if field.name == self.spec.proprioception[0].name:
                order = list(reversed(range(field.size)))
                message: Any = SimpleNamespace(
                    name=[JOINTS[joint] for joint in order], position=[part[joint] for joint in order]
                )
                self.graph.send("/joints", message)
            else:
                self.graph.send(f"/{field.name}", SimpleNamespace(data=[*part, 99.0]))
        for name, image in seen["images"].items():
            self.graph.send(f"/{name}", picture(image[..., ::-1], "bgr8"))
        for name, depth in seen["depth"].items():
            self.graph.send(f"/{name}/depth", picture(depth[..., None], "16UC1"))

    def commands(self) -> list[list[float]]:
        return [message.data for topic, message in self.graph.published if topic == "/command"]

    def active(self) -> bool:
        self.node.check()
        found: bool = [message.data for topic, message in self.graph.published if topic == "~/active"][-1]
        return found


def test_actions_are_those_of_a_session(
    client: gleaner.Client, deployment: str, modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(client, monkeypatch, max_age=60.0)
    robot.node.discover()
    spec = robot.spec
    steps = [observation(spec, seed) for seed in range(3)]
    for seen in steps:
        robot.see(seen)
        robot.node.step()
    with gleaner.Policy(client, deployment) as session:
        expected = [session(seen) for seen in steps]
    np.testing.assert_allclose(robot.commands(), expected, atol=1e-6)
    assert robot.graph.log[-1] == "acting"
    assert robot.active()
    robot.node.end()


def test_stale_and_unfit_messages_give_no_action(
    client: gleaner.Client, deployment: str, monotonic: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    del deployment
    robot = Robot(client, monkeypatch, max_age=0.5)
    robot.node.step()
    assert robot.commands() == []
    robot.node.discover()
    robot.node.step()
    assert robot.graph.log[-1].startswith("no action: no message on /")
    robot.see(observation(robot.spec))
    robot.node.step()
    assert len(robot.commands()) == 1
    monotonic[0] += 0.6
    robot.node.step()
    assert re.fullmatch(r"no action: no message on /\S+ for 0.5 s", robot.graph.log[-1])
    robot.see(observation(robot.spec))
    named = JOINTS[: robot.spec.proprioception[0].size]
    robot.graph.send("/joints", SimpleNamespace(name=named, position=[]))
    robot.node.step()
    assert robot.graph.log[-1] == f"no action: position: expected a value for each of {len(named)} names, got 0"
    assert len(robot.commands()) == 1
    # The session is still the one of the first action.
    robot.see(observation(robot.spec))
    robot.node.step()
    assert len(robot.commands()) == 2
    robot.node.end()


def test_watchdog_stops_the_robot_once_and_recovers(
    client: gleaner.Client, deployment: str, monotonic: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    del deployment
    still = [0.0] * size(gleaner.Policy(client, DEPLOYMENT).spec.action)
    robot = Robot(client, monkeypatch, watchdog=0.5, stop_action=still)
    robot.node.discover()
    assert not robot.active()
    robot.see(observation(robot.spec))
    robot.node.step()
    assert robot.active()
    monotonic[0] += 0.51
    assert not robot.active()
    assert not robot.active()
    assert robot.commands()[1:] == [still]
    assert robot.graph.log[-1] == "watchdog: no action in time"
    robot.see(observation(robot.spec))
    robot.node.step()
    assert robot.active()
    robot.node.end()
    assert robot.commands()[-1] == still


def test_ticks_are_served_by_a_thread_until_the_end(
    client: gleaner.Client, deployment: str, modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    del deployment
    robot = Robot(client, monkeypatch, max_age=60.0)
    acted = threading.Event()
    step = robot.node.step

    def noted() -> None:
        step()
        acted.set()

    monkeypatch.setattr(robot.node, "step", noted)
    robot.node.start()
    robot.see(observation(robot.spec))
    period = 1 / robot.policy.rate_hz
    tick = next(callback for seconds, callback in robot.node.timers if seconds == period)
    tick()
    assert acted.wait(60)
    robot.node.end()
    assert len(robot.commands()) == 1
    assert not robot.node._thread.is_alive()


def transform(parent: str, child: str, place: tuple[float, ...], turn: tuple[float, ...]) -> SimpleNamespace:
    vector, quaternion = (dict(zip(names, of, strict=True)) for names, of in (("xyz", place), ("xyzw", turn)))
    moved = SimpleNamespace(translation=SimpleNamespace(**vector), rotation=SimpleNamespace(**quaternion))
    return SimpleNamespace(header=SimpleNamespace(frame_id=parent), child_frame_id=child, transform=moved)


def transforms(*of: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(transforms=[*of])


ARM = transform("/root", "arm", (0.1, 0.2, 0.3), (1, 2, 3, 4))
TOOL = transform("arm", "/tool", (0.5, -0.4, 0.2), (-2, 1, 0, 3))
CAMERA = transform("root", "camera", (-0.3, 0.6, 0.9), (0, 1, 1, 5))
# As in the tests of the reader of recordings, computed apart by products of matrices.
IN_ROOT = [0.58, 0.56, 0.0, -0.390360029, 0.195180015, 0.683130051, 0.585540044]
IN_CAMERA = [1.068148148, -0.42962963, -0.51037037, -0.469530142, 0.150249645, 0.469530142, 0.732467021]


def test_poses_of_frames_are_those_of_recordings(modules: dict[str, ModuleType]) -> None:
    tree = modules["transforms"].Tree()
    tree.update(transforms(ARM, CAMERA), 3.0)
    tree.update(TOOL, None)
    for parent, pose in {"root": IN_ROOT, "/camera": IN_CAMERA}.items():
        found, time = tree.pose(parent, "tool")
        np.testing.assert_allclose(found, pose, atol=1e-8)
        assert time == 3.0
    tree.update(transforms(ARM), 4.0)
    assert tree.pose("root", "tool")[1] == 4.0
    assert tree.pose("arm", "tool")[1] == -np.inf, "it never changes"
    tree.update(transform("arm", "tool", (0, 0, 0), (0, 0, 0, 0)), 5.0)
    assert tree.pose("root", "tool")[1] == 4.0, "a transform with a zero quaternion is left out"
    with pytest.raises(modules["messages"].Unfit, match="no transforms connect hand with root"):
        tree.pose("root", "hand")
    for parent, child in (("a", "b"), ("b", "a")):
        tree.update(transform(parent, child, (0, 0, 0), (0, 0, 0, 1)), 1.0)
    with pytest.raises(modules["messages"].Unfit):
        tree.pose("root", "a")


class Posed:
    """A policy of a task with the pose of a frame, which keeps what it sees."""

    rate_hz = 10.0

    def __init__(self, field: str = "tool") -> None:
        frames = Transform(parent="root", child="tool", static_topic="/tf_static")
        other = {"tool": "command", "command": "tool"}[field]
        self.spec = TaskSpec(
            proprioception=[FieldSpec(name="tool", size=7)],
            action=[FieldSpec(name="command", size=7)],
            mappings=[
                Mapping(
                    name="ros",
                    fields=[
                        FieldSource(field=field, topic="/tf", transform=frames),
                        FieldSource(field=other, topic="/command", paths=["data"]),
                    ],
                )
            ],
        )
        self.seen: list[gleaner.Observation] = []

    def __call__(self, observation: gleaner.Observation) -> np.ndarray[Any, Any]:
        self.seen.append(observation)
        return np.zeros(7, np.float32)

    def close(self, outcome: str) -> str:
        return outcome


def test_node_feeds_poses_from_transforms(monotonic: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    types = {"/tf": TF, "/tf_static": TF, "/command": ARRAY}
    graph = Graph(types, {TF: SimpleNamespace, ARRAY: Array}, {"max_age": 0.5})
    graph.install(monkeypatch)
    policy = Posed()
    node = importlib.import_module("gleaner_node").GleanerNode(policy)
    assert graph.qualities["/tf_static"].durability == "kept", "published before the node began"
    node.discover()
    assert graph.qualities["/tf"].depth == 100
    graph.send("/tf", transforms(ARM))
    node.step()
    assert graph.log[-1] == "no action: no transforms connect tool with root"
    graph.send("/tf_static", transforms(TOOL))
    node.step()
    assert graph.log[-1] == "acting"
    np.testing.assert_allclose(np.asarray(policy.seen[0].proprioception, np.float64), IN_ROOT, atol=1e-8)
    monotonic[0] += 0.6
    graph.send("/tf", transforms(CAMERA))
    node.step()
    assert graph.log[-1] == "no action: no transform of tool in root has changed for 0.5 s"
    assert len(policy.seen) == 1
    node.end()


def test_action_that_is_a_pose_from_transforms_is_refused(modules: dict[str, ModuleType]) -> None:
    with pytest.raises(gleaner.InvalidArgument, match="command: a pose from transforms cannot be published"):
        modules["control"].Scene(Posed("command").spec)


def test_readme_names_every_parameter_of_the_node() -> None:
    code = (EXAMPLE / "gleaner_node.py").read_text()
    readme = (EXAMPLE / "README.md").read_text()
    parameters = re.findall(r'given\(\s*"(\w+)"', code)
    assert len(parameters) == 12
    for name in parameters:
        assert f"| `{name}` |" in readme
