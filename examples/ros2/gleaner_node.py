#!/usr/bin/env python3
"""A ROS 2 node that drives a robot with a gleaner deployment, by the topics of the task's own mapping.

    python3 gleaner_node.py --ros-args -p deployment:=pick_cube@prod -p server:=lab:7400

The parameters are described in README.md beside this file.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import rclpy
from control import Scene, Watchdog
from messages import Unfit
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool

import gleaner
from gleaner.observation import size, vector

# Seconds between looks for the types of topics that are not known yet.
DISCOVERY = 0.5
# Transforms come in many small messages, of which none may be missed.
TRANSFORMS = 100
TRANSFORM_TYPE = "tf2_msgs/msg/TFMessage"


def message_class(kind: str) -> Any:
    """The class of a type such as `std_msgs/msg/Bool`; not every rclpy comes with `rosidl_runtime_py`, which has it."""
    module, _, name = kind.rpartition("/")
    return getattr(import_module(module.replace("/", ".")), name)


class GleanerNode(Node):
    """One robot: newest messages in, an action each control period out.

    The policy is called in a thread of its own, so that the watchdog's timer runs while a call waits for the server.
    """

    def __init__(self, policy: gleaner.Policy | None = None) -> None:
        super().__init__("gleaner")

        def given(name: str, default: Any) -> Any:
            return self.declare_parameter(name, default).value

        self._policy = policy or gleaner.Policy(
            gleaner.connect(
                given("server", "127.0.0.1:7400"), os.environ.get("GLEANER_TOKEN"), ca=given("ca", "") or None
            ),
            given("deployment", ""),
            rate_hz=given("rate_hz", 0.0) or None,
            deadline=given("deadline", 0.0) or None,
            record=given("record", False),
            cohort=given("cohort", ""),
        )
        self._scene = Scene(self._policy.spec, given("mapping", ""))
        self._most = given("max_age", 0.5)
        self._types = dict(pair.split("=", 1) for pair in given("types", [""]) if pair)
        stop = np.array(given("stop_action", [float("nan")]), np.float32)
        unset = len(stop) == 1 and np.isnan(stop[0])
        self._stop_action = None if unset else vector("stop_action", stop, size(self._policy.spec.action))
        self._classes: dict[str, Any] = {}
        self._command: dict[str, Any] = {}
        # The action that the robot executes, the periods so far, and the one whose observation was sent last.
        self._executed: np.ndarray | None = None
        self._periods = 0
        self._sent: int | None = None
        self._active = self.create_publisher(Bool, "~/active", 1)
        self._watchdog = Watchdog(given("watchdog", 0.5), time.monotonic())
        self._due = threading.Event()
        self._ending = threading.Event()
        # Held while an action is published, so that none follows the last one or is mixed with another.
        self._publishing = threading.Lock()
        self._said = ""
        period = 1.0 / self._policy.rate_hz
        self._discovery = self.create_timer(DISCOVERY, self.discover)
        self._ticks = self.create_timer(period, self._tick)
        self._checks = self.create_timer(min(period, 0.1), self.check)
        self._thread = threading.Thread(target=self._run, daemon=True)
        # Transforms that never change are published once, and kept for those who come later.
        kept = QoSProfile(depth=TRANSFORMS, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic in self._scene.fixed:
            kind = message_class(self._types.get(topic, TRANSFORM_TYPE))
            self.create_subscription(kind, topic, partial(self._arrived, topic), kept)

    def start(self) -> None:
        """Begins to act."""
        self.discover()
        self._thread.start()

    def discover(self) -> None:
        """Subscribes to topics, and advertises actions, as soon as their types are known."""
        known = {name: types[0] for name, types in self.get_topic_names_and_types()} | self._types
        for topic in (self._scene.observed | self._scene.acted) - self._classes.keys():
            if topic not in known:
                continue
            self._classes[topic] = kind = message_class(known[topic])
            if topic in self._scene.observed:
                quality = QoSProfile(depth=TRANSFORMS) if topic in self._scene.transforms else qos_profile_sensor_data
                self.create_subscription(kind, topic, partial(self._arrived, topic), quality)
            if topic in self._scene.acted:
                self._command[topic] = self.create_publisher(kind, topic, 1)
        missing = (self._scene.observed | self._scene.acted) - self._classes.keys()
        if missing:
            self._say(f"waiting for the types of {', '.join(sorted(missing))}; set them with the parameter `types`")
        else:
            self._discovery.cancel()

    def _arrived(self, topic: str, message: Any) -> None:
        # An error here would end the node and not only a step. Without the message, the topic becomes stale.
        try:
            self._scene.arrived(topic, message, time.monotonic())
        except Unfit as problem:
            self._say(f"no action: {topic}: {problem}")

    def step(self) -> None:
        """One control period: an action if every camera and field is fresh, else nothing."""
        if self._command.keys() != self._scene.acted:
            return
        # The watchdog stops the robot if an error lasts; the next period tries again.
        try:
            begun, period = time.monotonic(), self._periods
            if why := self._scene.stale(begun, self._most):
                self._say(f"no action: {why}")
                return
            observation = self._scene.observation(self.get_clock().now().nanoseconds)
            action = self._act(observation, period)
            if time.monotonic() - begun > self._most:
                # The robot has moved on, or the watchdog has stopped it.
                self._say(f"no action: the answer took longer than {self._most:g} s")
                self._policy.discard_action()
                return
            with self._publishing:
                if self._ending.is_set():
                    return
                self._publish(action)
                self._watchdog.acted(time.monotonic())
        except (gleaner.GleanerError, Unfit) as error:
            self._say(f"no action: {error}")
            return
        except Exception as error:  # Such as a message of another type: the thread continues.
            self._say(f"no action: {type(error).__name__}: {error}")
            return
        self._say("acting")

    def _act(self, observation: gleaner.Observation, period: int) -> np.ndarray:
        # The policy's action. Its last one may not have been published, and periods may have passed without a step.
        observation.executed_action = self._executed
        if self._sent is not None:
            observation.skipped_steps = max(period - self._sent - 1, 0)
        try:
            action = self._policy(observation)
        except gleaner.Missed:
            self._sent = period
            raise
        self._sent = period
        return action

    def check(self) -> None:
        """Stops the robot when actions have not come for longer than the watchdog allows."""
        with self._publishing:
            if self._watchdog.trips(time.monotonic()):
                self.get_logger().error("watchdog: no action in time")
                self._stop()
        self._active.publish(Bool(data=self._watchdog.active))

    def end(self, outcome: str = "unknown") -> str:
        """Stops the robot and ends the episode; returns the id of its recording, if any."""
        with self._publishing:
            self._ending.set()
            # First, because a call may wait for the server.
            if self._command.keys() == self._scene.acted:
                self._stop()
            self._active.publish(Bool(data=False))
        self._due.set()
        if self._thread.is_alive():
            self._thread.join()
        return self._policy.close(outcome)

    def _tick(self) -> None:
        self._periods += 1
        self._due.set()

    def _run(self) -> None:
        while True:
            self._due.wait()
            self._due.clear()
            if self._ending.is_set():
                return
            self.step()

    def _stop(self) -> None:
        if self._stop_action is None:
            return
        try:
            self._publish(self._stop_action)
        except Exception as error:  # The episode ends anyway.
            self.get_logger().error(f"stop_action: {type(error).__name__}: {error}")

    def _publish(self, action: np.ndarray) -> None:
        for topic, message in self._scene.commands(action, lambda topic: self._classes[topic]()).items():
            self._command[topic].publish(message)
        self._executed = action

    def _say(self, state: str) -> None:
        # Once for each change, not once a period.
        if state != self._said:
            self._said = state
            self.get_logger().info(state)


def main() -> None:
    """Runs the node until SIGINT or SIGTERM."""
    # The handlers of rclpy would end its context, and with it publishing, before the robot is stopped.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = GleanerNode()
    interrupted = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    node.start()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not interrupted.is_set():
            executor.spin_once(timeout_sec=0.1)
    finally:
        if recorded := node.end():
            print(recorded)


if __name__ == "__main__":
    main()
