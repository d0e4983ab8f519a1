"""What the example needs of a simulator's task: a Gymnasium environment with cameras, fields and demonstrators."""

from __future__ import annotations

import abc
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from simulator_example.agent import Action, Agent, Demonstrator, State

Frames = dict[str, NDArray[np.uint8]]
Depths = dict[str, NDArray[np.uint16]]
Fields = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class ActionField:
    """A part of the action."""

    size: int
    bounds: tuple[float, float] | None = None
    binary: bool = False


class Simulator(gymnasium.Env[State, Action], abc.ABC):
    """One task of a simulator. A seed is a placement of its objects; `info` of a step has `success`."""

    simulator: str  # the name of the simulator in reports
    task: str
    rate_hz: float
    size: int  # height and width of every camera
    cameras: tuple[str, ...]
    has_depth: bool = False
    proprioception: Mapping[str, int]  # sizes of the fields
    action: Mapping[str, ActionField]
    imperfect: tuple[Agent, ...]

    @abc.abstractmethod
    def images(self) -> Frames:
        """The current images of the cameras: size × size × RGB each."""

    def depths(self) -> Depths:
        """The current depth of the cameras: size × size millimetres each."""
        return {}

    @abc.abstractmethod
    def felt(self, state: State) -> Fields:
        """The proprioception in a state, by field."""

    @abc.abstractmethod
    def demonstrator(self, agent: Agent, seed: int) -> Demonstrator:
        """The agent of the episode that `reset` has begun."""

    def fields(self, action: Action) -> Fields:
        """An action, by field."""
        parts, at = {}, 0
        for name, field in self.action.items():
            parts[name] = action[at : at + field.size]
            at += field.size
        return parts


# The modules are loaded when they are used: the simulators' packages do not fit into one Python environment.
_MODULES = {"metaworld": "meta_world", "maniskill2": "mani_skill2_task"}
SIMULATORS = tuple(_MODULES)


def make(simulator: str, task: str, size: int) -> Simulator:
    """The task of a simulator, with cameras of this height and width."""
    module: Any = importlib.import_module(f"simulator_example.{_MODULES[simulator]}")
    env: Simulator = module.make(task, size)
    return env
