"""An arm and a gripper that share topics: the ROS 2 example keeps and sends the joints of both. No server."""

from __future__ import annotations

import importlib
import math
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import gleaner
from fake_ros import Graph, JointState
from gleaner._proto.v1.task_pb2 import FieldSource, FieldSpec, Mapping, TaskSpec

JOINTS = {"arm": ["joint1", "joint2"], "gripper": ["finger"]}
STATES, COMMANDS = "/joint_states", "/joint_commands"
STATE = "test_msgs/msg/JointState"
STOP = [0.0, 0.0, 0.5]


class Command(JointState):
    def __init__(self) -> None:
        super().__init__()
        self.velocity: list[float] = []
        self.effort: list[float] = []


def spec(gripper: str = "position") -> TaskSpec:
    """A task whose arm and gripper share a topic of states and one of commands; the gripper's command is at a path."""
    paths = {"arm_command": "position", "gripper_command": gripper}
    fields = [
        FieldSource(field=f"{part}{kind}", topic=topic, paths=[paths.get(f"{part}{kind}", "position")], names=names)
        for kind, topic in {"": STATES, "_command": COMMANDS}.items()
        for part, names in JOINTS.items()
    ]
    return TaskSpec(
        proprioception=[FieldSpec(name=part, size=len(names)) for part, names in JOINTS.items()],
        action=[FieldSpec(name=f"{part}_command", size=len(names)) for part, names in JOINTS.items()],
        mappings=[Mapping(name="ros", fields=fields)],
    )


class Counting:
    """Answers the n-th observation with n, n + 0.1 and n + 0.2, and keeps what it sees."""

    rate_hz = 10.0

    def __init__(self) -> None:
        self.spec = spec()
        self.seen: list[gleaner.Observation] = []

    def __call__(self, observation: gleaner.Observation) -> np.ndarray[Any, Any]:
        self.seen.append(observation)
        return np.array([0.0, 0.1, 0.2]) + len(self.seen)

    def close(self, outcome: str) -> str:
        return outcome


class Robot:
    """A node whose joint states come from several drivers."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        parameters = {"max_age": 0.5, "watchdog": 0.5, "stop_action": STOP}
        self.graph = Graph({STATES: STATE, COMMANDS: STATE}, {STATE: Command}, parameters)
        self.graph.install(monkeypatch)
        self.policy = Counting()
        self.node: Any = importlib.import_module("gleaner_node").GleanerNode(self.policy)
        self.node.discover()

    def state(self, **joints: float) -> None:
        """The message of a driver."""
        self.graph.send(STATES, SimpleNamespace(name=[*joints], position=[*joints.values()]))

    def step(self) -> str:
        """One control period; returns what the node logged last."""
        self.node.step()
        return self.graph.log[-1]

    def commands(self) -> list[tuple[list[str], list[float]]]:
        return [(message.name, message.position) for topic, message in self.graph.published if topic == COMMANDS]


@pytest.fixture
def robot(monotonic: list[float], monkeypatch: pytest.MonkeyPatch) -> Robot:
    del monotonic
    return Robot(monkeypatch)


def test_action_fields_of_one_topic_are_one_message(modules: dict[str, ModuleType]) -> None:
    scene = modules["control"].Scene(spec())
    found = scene.commands(np.array([0.25, 0.5, 0.75]), lambda topic: Command())
    assert [*found] == [COMMANDS]
    assert (found[COMMANDS].name, found[COMMANDS].position) == (["joint1", "joint2", "finger"], [0.25, 0.5, 0.75])
    assert (found[COMMANDS].velocity, found[COMMANDS].effort) == ([], []), "no field has these"


def test_arrays_that_not_every_action_field_has_stay_parallel(modules: dict[str, ModuleType]) -> None:
    found = modules["control"].Scene(spec("effort")).commands(np.array([1.0, 2.0, 3.0]), lambda topic: Command())
    message = found[COMMANDS]
    assert message.name == ["joint1", "joint2", "finger"]
    np.testing.assert_array_equal(message.position, [1.0, 2.0, math.nan])
    np.testing.assert_array_equal(message.effort, [math.nan, math.nan, 3.0])
    assert message.velocity == []


def test_names_stand_beside_the_last_part_of_a_path(modules: dict[str, ModuleType]) -> None:
    messages, message = modules["messages"], SimpleNamespace(left=Command(), right=Command())
    paths = ["left.position", "right.position"]
    messages.write(message, paths, ["a", "b"], [1, 2, 3, 4])
    messages.write(message, ["right.effort"], ["c"], [5])
    assert (message.left.name, message.right.name) == (["a", "b"], ["a", "b", "c"])
    assert (message.left.position, message.right.position) == ([1, 2], [3, 4])
    assert messages.read(message, paths, ["b", "a"]) == [2, 1, 4, 3]
    assert messages.missing(message, paths, ["a", "c"]) == (["c"], ["a", "b"])
    assert messages.missing(message, ["right.position"], ["c"]) == ([], [])


def test_names_that_a_message_has_are_updated_and_others_appended(modules: dict[str, ModuleType]) -> None:
    messages, message = modules["messages"], Command()
    messages.write(message, ["position", "velocity"], ["a", "b"], [1, 2, 3, 4])
    messages.write(message, ["position", "velocity"], ["c", "a"], [5, 6, 7, 8])
    assert message.name == ["a", "b", "c"]
    assert message.position == [6, 2, 5]
    assert message.velocity == [8, 4, 7]
    assert messages.read(message, ["velocity"], ["c", "b"]) == [7, 4]
    with pytest.raises(messages.Unfit, match="position: expected a value for each of 2 names, got 1"):
        messages.write(message, ["position"], ["a", "b"], [1])


def test_executed_and_stop_actions_are_of_every_field(robot: Robot, monotonic: list[float]) -> None:
    robot.state(joint1=0.0, joint2=0.0, finger=0.0)
    assert robot.step() == "acting"
    monotonic[0] += 0.6
    robot.node.check()
    robot.state(joint1=0.0, joint2=0.0, finger=0.0)
    for _ in range(2):
        robot.step()
    names = ["joint1", "joint2", "finger"]
    assert [name for name, _ in robot.commands()] == [names] * 4
    np.testing.assert_allclose(
        [sent for _, sent in robot.commands()], [[1, 1.1, 1.2], STOP, [2, 2.1, 2.2], [3, 3.1, 3.2]]
    )
    executed = [seen.executed_action for seen in robot.policy.seen]
    assert executed[0] is None
    np.testing.assert_allclose(np.asarray(executed[1:], np.float64), [STOP, [2, 2.1, 2.2]])
    robot.node.end()


def test_drivers_that_alternate_on_one_topic_give_every_field(robot: Robot) -> None:
    robot.state(joint2=0.2, joint1=0.1)
    why = "no action: no message on /joint_states with the names of gripper yet: one has no finger; it names joint2, "
    assert robot.step() == f"{why}joint1"
    robot.state(finger=0.3)
    assert robot.step() == "acting"
    robot.state(joint2=0.5, joint1=0.4)
    robot.state()
    assert robot.step() == "acting"
    assert [np.asarray(seen.proprioception).tolist() for seen in robot.policy.seen] == [
        [0.1, 0.2, 0.3],
        [0.4, 0.5, 0.3],
    ]
    robot.node.end()


def test_a_driver_that_stops_makes_its_field_stale(robot: Robot, monotonic: list[float]) -> None:
    why = "no action: no message on /joint_states with the names of arm for 0.5 s: one has no joint1; it names finger"
    robot.state(joint1=0.1, joint2=0.2)
    for _ in range(5):
        robot.state(finger=0.3)
        assert robot.step() == "acting"
        monotonic[0] += 0.125
    logged = len(robot.graph.log)
    for _ in range(5):
        robot.state(finger=0.3)
        assert robot.step() == why
        monotonic[0] += 0.125
    assert robot.graph.log[logged:] == [why], "a reason is logged once"
    robot.state(joint1=0.1, joint2=0.2)
    assert robot.step() == "acting"
    monotonic[0] += 0.6
    assert robot.step() == "no action: no message on /joint_states for 0.5 s", "of neither driver since"
    robot.node.end()


def test_names_that_no_message_has_are_the_reason(robot: Robot) -> None:
    assert robot.step() == "no action: no message on /joint_states yet"
    # Of the messages, the one that lacks the fewest names of the field is the reason.
    why = "no action: no message on /joint_states with the names of arm yet: one has no joint2; it names joint1, elbow"
    for _ in range(3):
        robot.state(finger=0.3)
        robot.state(joint1=0.1, elbow=0.2)
        assert robot.step() == why
    assert robot.graph.log.count(why) == 1
    assert robot.commands() == []
    robot.node.end()


def test_messages_without_names_are_unfit(robot: Robot) -> None:
    robot.graph.send(STATES, SimpleNamespace(position=[0.1, 0.2]))
    assert robot.step() == "no action: path 'position': SimpleNamespace has no name"
    robot.node.end()
