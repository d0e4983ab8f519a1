"""The task on the server: its spec, and the inputs of a policy. Independent of files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import gleaner
from simulator_example.agent import State
from simulator_example.recorder import ACTION_TOPIC, STATE_TOPIC, camera_topic, depth_topic
from simulator_example.simulator import ActionField, Depths, Frames, Simulator


def task_spec(env: Simulator, name: str) -> dict[str, Any]:
    """The spec of the task, as `gleaner task create` and `client.tasks.create` take it."""
    fields = [(STATE_TOPIC, field) for field in env.proprioception] + [(ACTION_TOPIC, field) for field in env.action]
    mapping = {
        "name": env.simulator,
        "clock": ACTION_TOPIC,
        "cameras": [_topics(env, camera) for camera in env.cameras],
        "fields": [{"field": field, "topic": topic, "paths": [field]} for topic, field in fields],
    }
    return {
        "name": name,
        "rate_hz": env.rate_hz,
        "cameras": [
            {"name": camera, "height": env.size, "width": env.size} | ({"depth": True} if env.has_depth else {})
            for camera in env.cameras
        ],
        "proprioception": [{"name": field, "size": size} for field, size in env.proprioception.items()],
        "action": [_action(name, field) for name, field in env.action.items()],
        "mappings": [mapping],
    }


def _topics(env: Simulator, camera: str) -> dict[str, str]:
    depth = {"depth": depth_topic(camera)} if env.has_depth else {}
    return {"camera": camera, "color": camera_topic(camera), **depth}


def _action(name: str, field: ActionField) -> dict[str, Any]:
    spec: dict[str, Any] = {"name": name, "size": field.size}
    if field.bounds is not None:
        spec["minimum"], spec["maximum"] = field.bounds
    return spec | ({"binary": True} if field.binary else {})


class SimulatorAdapter(gleaner.Adapter):
    """The images and proprioception of a policy; its action is the environment's."""

    def cameras(self, env: Simulator, observation: State) -> Frames:
        """The images of all cameras."""
        return env.images()

    def depth(self, env: Simulator, observation: State) -> Depths:
        """The depth of all cameras, if they have any."""
        return env.depths()

    def proprioception(self, env: Simulator, observation: State) -> NDArray[np.float32]:
        """All fields, one after the other."""
        return np.concatenate([*env.felt(observation).values()])
