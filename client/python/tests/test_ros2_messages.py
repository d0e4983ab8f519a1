"""What the ROS 2 example makes of messages, also malformed ones, and that its node continues after them. No server."""

from __future__ import annotations

import importlib
import threading
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gleaner
from fake_ros import Array, Graph, JointState, picture
from gleaner._proto.v1.task_pb2 import CameraSource, CameraSpec
from test_ros2_node import ARM, ARRAY, TF, TOOL, Posed, transforms

PNG = b"\x89PNG\r\n\x1a\n"


def test_values_and_pictures_of_messages(modules: dict[str, ModuleType]) -> None:
    messages = modules["messages"]
    pose = SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=1, y=2, z=3)), data=[4, 5, 6])
    assert messages.read(pose, ["pose.position.z", "data[1]", "data[0:2]"], []) == [3, 5, 4, 5]
    for path, problem in {"pose.speed": "has no speed", "data[9]": "has 3 values", "data[": "expected a.b"}.items():
        with pytest.raises(messages.Unfit, match=problem):
            messages.read(pose, [path], [])
    command = SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=0, y=0)), data=0.0)
    messages.write(command, ["twist.linear.x", "twist.linear.y", "data"], [], [1, 2, 3])
    assert (command.twist.linear.x, command.twist.linear.y, command.data) == (1, 2, 3)
    joints = JointState()
    messages.write(joints, ["position"], ["a", "b"], [1, 2])
    assert (joints.name, joints.position) == (["a", "b"], [1, 2])
    with pytest.raises(messages.Unfit, match="1 values more"):
        messages.write(command, ["data"], [], [1, 2])
    metres = np.array([[0.5, np.nan], [np.inf, 70.0]], np.float32)[..., None]
    assert messages.picture(picture(metres, "32FC1")).tolist() == [[500, 0], [0, 65535]]
    packed = SimpleNamespace(format="16UC1; compressedDepth png", data=b"123456789012PNG")
    assert messages.picture(packed) == b"PNG"
    assert messages.picture(SimpleNamespace(format="jpeg", data=b"JPEG")) == b"JPEG"
    with pytest.raises(messages.Unfit, match="encoding yuv422 is unknown; supported: rgb8"):
        messages.picture(SimpleNamespace(encoding="yuv422"))


@pytest.mark.parametrize(
    ("encoding", "pixel", "rgb"),
    [
        ("rgb8", [1, 2, 3], [1, 2, 3]),
        ("bgr8", [3, 2, 1], [1, 2, 3]),
        ("8UC3", [3, 2, 1], [1, 2, 3]),
        ("rgba8", [1, 2, 3, 9], [1, 2, 3]),
        ("bgra8", [3, 2, 1, 9], [1, 2, 3]),
        ("8UC4", [3, 2, 1, 9], [1, 2, 3]),
        ("mono8", [7], [7, 7, 7]),
        ("8UC1", [7], [7, 7, 7]),
    ],
)
def test_color_is_read_as_from_recordings(
    modules: dict[str, ModuleType], encoding: str, pixel: list[int], rgb: list[int]
) -> None:
    pixels = np.zeros((2, 3, len(pixel)), np.uint8)
    pixels[1, 2] = pixel
    message = picture(pixels, encoding)
    found = modules["messages"].picture(message)
    assert (found.shape, found.dtype, found.flags.c_contiguous) == ((2, 3, 3), np.uint8, True)
    assert (found[1, 2].tolist(), found[0].any()) == (rgb, False)
    # Rows without padding, whose step some drivers leave out, and a last row without it.
    plain = SimpleNamespace(**{**vars(message), "step": 0, "data": pixels.tobytes()})
    assert modules["messages"].picture(plain).tolist() == found.tolist()
    message.data = message.data[:-5]
    assert modules["messages"].picture(message).tolist() == found.tolist()


@pytest.mark.parametrize(
    "kind", ["32FC1; compressedDepth png", "32FC1; compressedDepth rvl", "16UC1; compressedDepth rvl"]
)
def test_compressed_depth_that_is_no_png_of_millimetres_is_refused(modules: dict[str, ModuleType], kind: str) -> None:
    unfit = modules["messages"].Unfit
    image = PNG if kind.endswith("png") else b"RVL"
    packed = SimpleNamespace(format=kind, data=b"123456789012" + image)
    with pytest.raises(unfit, match=f"format '{kind}' is not supported; publish 16UC1 as png, or the depth as"):
        modules["messages"].picture(packed)
    spec = Posed().spec
    spec.cameras.append(CameraSpec(name="front", height=2, width=2, depth=True))
    spec.mappings[0].cameras.append(CameraSource(camera="front", color="/color", depth="/depth"))
    scene = modules["control"].Scene(spec)
    scene.arrived("/color", SimpleNamespace(format="jpeg", data=b"JPEG"), 0.0)
    scene.arrived("/depth", packed, 0.0)
    with pytest.raises(unfit, match=f"^/depth: format '{kind}'"):
        scene.observation(0)


def test_a_png_that_is_named_rvl_is_read(modules: dict[str, ModuleType]) -> None:
    for header in (b"123456789012", b""):
        packed = SimpleNamespace(format="16UC1; compressedDepth rvl", data=header + PNG)
        assert modules["messages"].picture(packed) == PNG


def test_malformed_messages_are_unfit(modules: dict[str, ModuleType]) -> None:
    messages = modules["messages"]
    short = picture(np.zeros((2, 3, 3), np.uint8), "rgb8")
    short.data = short.data[:22]
    with pytest.raises(messages.Unfit, match="rgb8 of 2×3: expected 2 rows of at least 9 bytes, got 22 bytes with"):
        messages.picture(short)
    empty = picture(np.zeros((2, 3, 3), np.uint8), "rgb8")
    empty.height = 0
    with pytest.raises(messages.Unfit, match="rgb8 of 0×3"):
        messages.picture(empty)
    narrow = picture(np.zeros((2, 3, 1), np.uint16), "16UC1")
    narrow.width = 9
    with pytest.raises(messages.Unfit, match="expected 2 rows of at least 18 bytes, got 22 bytes with rows of 11"):
        messages.picture(narrow)
    joints = SimpleNamespace(name=["a", "b"], position=[1, 2], velocity=[])
    with pytest.raises(messages.Unfit, match="velocity: expected a value for each of 2 names, got 0"):
        messages.read(joints, ["velocity"], ["b"])
    with pytest.raises(messages.Unfit, match="path 'data': SimpleNamespace has no name"):
        messages.read(SimpleNamespace(data=[1]), ["data"], ["a"])


@pytest.mark.parametrize("path", ["speed", "speed[0:2]", "data.speed"])
def test_a_command_without_the_path_is_unfit(modules: dict[str, ModuleType], path: str) -> None:
    messages = modules["messages"]
    with pytest.raises(messages.Unfit, match=r"path '.*': .* has no speed"):
        messages.write(Array(), [path], [], [1, 2])
    with pytest.raises(messages.Unfit, match="path 'data': Array has no name"):
        messages.write(Array(), ["data"], ["a"], [1])


class Failing(Posed):
    """Fails once, by an error that no client raises."""

    def __call__(self, observation: gleaner.Observation) -> np.ndarray[Any, Any]:
        action = super().__call__(observation)
        if len(self.seen) == 1:
            raise KeyError("surprise")
        return action


def node_of(policy: Posed, graph: Graph, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A node that sees its poses."""
    graph.install(monkeypatch)
    node = importlib.import_module("gleaner_node").GleanerNode(policy)
    node.discover()
    graph.send("/tf", transforms(ARM))
    graph.send("/tf_static", transforms(TOOL))
    return node


def test_the_thread_goes_on_after_any_error(modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    del modules
    types = {"/tf": TF, "/tf_static": TF, "/command": ARRAY}
    graph = Graph(types, {TF: SimpleNamespace, ARRAY: Array}, {"max_age": 60.0})
    node = node_of(Failing(), graph, monkeypatch)
    stepped = threading.Semaphore(0)
    step = node.step

    def noted() -> None:
        try:
            step()
        finally:
            stepped.release()

    monkeypatch.setattr(node, "step", noted)
    node._thread.start()
    tick = next(callback for seconds, callback in node.timers if seconds == 0.1)
    for said in ("no action: KeyError: 'surprise'", "acting"):
        tick()
        assert stepped.acquire(timeout=10)
        assert graph.log[-1] == said
    node.end()


def test_a_stop_action_that_does_not_fit_is_logged(
    modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    del modules
    types = {"/tf": TF, "/tf_static": TF, "/command": "test_msgs/msg/Other"}
    classes: dict[str, type] = {TF: SimpleNamespace, "test_msgs/msg/Other": type("Other", (), {})}
    graph = Graph(types, classes, {"max_age": 60.0, "stop_action": [0.0] * 7})
    node = node_of(Posed(), graph, monkeypatch)
    node.step()
    assert graph.log[-1] == "no action: path 'data': Other has no data"
    assert node.end("failure") == "failure"
    assert graph.log[-1] == "stop_action: Unfit: path 'data': Other has no data"


def test_a_message_that_is_no_transform_does_not_end_the_node(
    modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    del modules
    types = {"/tf": TF, "/tf_static": TF, "/command": ARRAY}
    graph = Graph(types, {TF: SimpleNamespace, ARRAY: Array}, {"max_age": 60.0})
    node = node_of(Posed(), graph, monkeypatch)
    graph.send("/tf", SimpleNamespace(data=1))
    assert graph.log[-1].startswith("no action: /tf: SimpleNamespace is no message of transforms: ")
    node.step()
    assert graph.log[-1] == "acting"
    node.end()


class Late(Posed):
    """Gives ones, and takes a time that the test sets for its answers."""

    def __init__(self, now: list[float]) -> None:
        super().__init__()
        self.now, self.takes, self.discarded = now, 0.0, 0

    def __call__(self, observation: gleaner.Observation) -> np.ndarray[Any, Any]:
        self.now[0] += self.takes
        return super().__call__(observation) + 1

    def discard_action(self) -> None:
        self.discarded += 1


def late_node(now: list[float], monkeypatch: pytest.MonkeyPatch, **parameters: Any) -> tuple[Any, Late, Graph]:
    types = {"/tf": TF, "/tf_static": TF, "/command": ARRAY}
    graph = Graph(types, {TF: SimpleNamespace, ARRAY: Array}, {"max_age": 0.5, **parameters})
    policy = Late(now)
    return node_of(policy, graph, monkeypatch), policy, graph


def published(graph: Graph) -> list[list[float]]:
    return [message.data for topic, message in graph.published if topic == "/command"]


def test_an_answer_that_took_too_long_is_not_published(monotonic: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    node, policy, graph = late_node(monotonic, monkeypatch)
    policy.takes = 0.6
    node.step()
    assert graph.log[-1] == "no action: the answer took longer than 0.5 s"
    assert published(graph) == []
    assert policy.discarded == 1
    policy.takes = 0.4
    graph.send("/tf", transforms(ARM))
    node.step()
    assert published(graph) == [[1.0] * 7]
    assert policy.discarded == 1
    node.end()


def test_the_published_action_is_reported_as_executed(monotonic: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    node, policy, graph = late_node(monotonic, monkeypatch, stop_action=[0.0] * 7, watchdog=0.5)
    node.step()
    monotonic[0] += 0.6
    node.check()
    graph.send("/tf", transforms(ARM))
    node.step()
    policy.takes = 0.6
    graph.send("/tf", transforms(ARM))
    node.step()
    policy.takes = 0.0
    graph.send("/tf", transforms(ARM))
    node.step()
    executed = [np.asarray(seen.executed_action).tolist() for seen in policy.seen]
    # The third answer was late, so that the robot still executes the second.
    assert executed == [None, [0.0] * 7, [1.0] * 7, [1.0] * 7]
    node.end()


def test_periods_without_a_step_are_skipped_steps(monotonic: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    node, policy, graph = late_node(monotonic, monkeypatch)
    tick = next(callback for seconds, callback in node.timers if seconds == 0.1)
    # One period after the other, then a step that took three of them.
    for periods in (1, 1, 3, 1):
        for _ in range(periods):
            tick()
        node.step()
    # Periods without a fresh message.
    monotonic[0] += 2.0
    for _ in range(20):
        tick()
        node.step()
    graph.send("/tf", transforms(ARM))
    tick()
    node.step()
    assert [seen.skipped_steps for seen in policy.seen] == [0, 0, 2, 0, 20]
    node.end()


@pytest.mark.parametrize(("stop", "problem"), [([0.0] * 3, "expected 7 values, got 3"), ([float("nan")] * 7, "finite")])
def test_a_stop_action_that_cannot_be_executed_is_refused(
    modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch, stop: list[float], problem: str
) -> None:
    del modules
    graph = Graph({}, {}, {"stop_action": stop})
    graph.install(monkeypatch)
    with pytest.raises(gleaner.InvalidArgument, match=f"stop_action.*{problem}"):
        importlib.import_module("gleaner_node").GleanerNode(Posed())


def test_metres_become_the_nearest_millimetre_as_from_recordings(modules: dict[str, ModuleType]) -> None:
    metres = np.array([[1.2346, 1.2344, 0.0005, 0.0004]], np.float32)[..., None]
    found = modules["messages"].picture(picture(metres, "32FC1"))
    assert found.tolist() == [[1235, 1234, 1, 0]]
