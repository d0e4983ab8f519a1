"""The surface of rclpy that the ROS 2 example uses, without ROS: topics are a dictionary, and tests call timers.

The tests set the time and the types (the packages of rclpy have no `tf2_msgs`); `test_ros2_dds.py` has the middleware.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from programs import ROOT

EXAMPLE = ROOT / "examples" / "ros2"


class JointState:
    def __init__(self) -> None:
        self.name: list[str] = []
        self.position: list[float] = []


class Array:
    def __init__(self) -> None:
        self.data: list[float] = []


def picture(pixels: np.ndarray[Any, Any], encoding: str) -> SimpleNamespace:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, 5)))
    return SimpleNamespace(
        height=len(pixels),
        width=pixels.shape[1],
        step=padded.shape[1],
        encoding=encoding,
        is_bigendian=0,
        data=padded.tobytes(),
    )


class Graph:
    """Every topic: its type, its subscribers and what was published."""

    def __init__(self, types: dict[str, str], classes: dict[str, type], parameters: dict[str, Any]) -> None:
        self.types, self.classes, self.parameters = types, classes, parameters
        self.subscribers: dict[str, Callable[[Any], None]] = {}
        self.qualities: dict[str, Any] = {}
        self.published: list[tuple[str, Any]] = []
        self.log: list[str] = []
        self.now_ns = 1_700_000_000_000_000_000

    def send(self, topic: str, message: Any) -> None:
        """A message arrives."""
        self.subscribers[topic](message)

    def install(self, monkeypatch: Any) -> None:
        """Makes the modules importable."""
        graph = self

        class Node:
            def __init__(self, name: str) -> None:
                self.timers: list[tuple[float, Callable[[], None]]] = []

            def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
                return SimpleNamespace(value=graph.parameters.get(name, default))

            def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
                return [(topic, [kind]) for topic, kind in graph.types.items()]

            def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any) -> None:
                assert kind is graph.classes[graph.types[topic]]
                graph.subscribers[topic] = callback
                graph.qualities[topic] = qos

            def create_publisher(self, kind: type, topic: str, qos: Any) -> SimpleNamespace:
                return SimpleNamespace(publish=lambda message: graph.published.append((topic, message)))

            def create_timer(self, period: float, callback: Callable[[], None]) -> SimpleNamespace:
                assert period > 0
                self.timers.append((period, callback))
                return SimpleNamespace(cancel=lambda: self.timers.remove((period, callback)))

            def get_clock(self) -> SimpleNamespace:
                return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=graph.now_ns))

            def get_logger(self) -> SimpleNamespace:
                return SimpleNamespace(info=graph.log.append, error=graph.log.append)

        modules: dict[str, dict[str, Any]] = {
            "rclpy": {},
            "rclpy.executors": {"SingleThreadedExecutor": object},
            "rclpy.node": {"Node": Node},
            "rclpy.qos": {
                "qos_profile_sensor_data": SimpleNamespace(depth=5),
                "QoSProfile": SimpleNamespace,
                "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="kept"),
            },
            "rclpy.signals": {"SignalHandlerOptions": object},
            "std_msgs": {},
            "std_msgs.msg": {"Bool": SimpleNamespace},
        }
        for kind, of in self.classes.items():
            package, _, name = kind.rpartition("/")
            modules.setdefault(package.partition("/")[0], {})
            modules.setdefault(package.replace("/", "."), {})[name] = of
        for name, content in modules.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)
