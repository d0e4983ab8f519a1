"""The task of Meta-World: its spec, and the inputs of a policy. Independent of files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import gleaner
from metaworld_example.recorder import ACTION_TOPIC, STATE_TOPIC, camera_topic
from metaworld_example.simulator import CAMERAS, RATE_HZ, MetaWorld, State

# Fields and their sizes. The position of the object is not among them: a policy must use the images.
PROPRIOCEPTION = {"joints": 7, "hand": 3, "gripper": 1, "goal": 3}
ACTION = {"motion": 3, "closing": 1}


def task_spec(name: str, size: int) -> dict[str, Any]:
    """The spec of the task."""
    fields = [(STATE_TOPIC, name) for name in PROPRIOCEPTION] + [(ACTION_TOPIC, name) for name in ACTION]
    mapping = {
        "name": "metaworld",
        "clock": ACTION_TOPIC,
        "cameras": [{"camera": camera, "color": camera_topic(camera)} for camera in CAMERAS],
        "fields": [{"field": name, "topic": topic, "paths": [name]} for topic, name in fields],
    }
    return {
        "name": name,
        "rate_hz": RATE_HZ,
        "cameras": [{"name": camera, "height": size, "width": size} for camera in CAMERAS],
        "proprioception": [{"name": name, "size": count} for name, count in PROPRIOCEPTION.items()],
        "action": [{"name": name, "size": count} for name, count in ACTION.items()],
        "mappings": [mapping],
    }


def felt(env: MetaWorld, state: State) -> dict[str, NDArray[np.float32]]:
    """The proprioception, by field."""
    parts = {"joints": env.joints(), "hand": state[:3], "gripper": state[3:4], "goal": state[36:39]}
    return {name: values.astype(np.float32) for name, values in parts.items()}


def done(action: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    """An action, by field."""
    return {"motion": action[:3], "closing": action[3:4]}


class MetaWorldAdapter(gleaner.Adapter):
    """The images and proprioception of a policy; its action is the environment's."""

    def cameras(self, env: MetaWorld, observation: State) -> dict[str, NDArray[np.uint8]]:
        """The images of both cameras."""
        return env.images()

    def proprioception(self, env: MetaWorld, observation: State) -> NDArray[np.float32]:
        """All fields, one after the other."""
        return np.concatenate([*felt(env, observation).values()])
