"""Chunks executed open loop: several actions of an answer before the next answer counts. Knows no environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gleaner.errors import Missed
from gleaner.observation import Observation


class Planner(Protocol):
    """The used part of a `Policy`."""

    def chunk(self, observation: Observation, /) -> Any:
        """All actions for an observation, as `.actions`."""

    def reset(self) -> object:
        """Ends the episode."""


class Plan:
    """What is left of a chunk of which `execute` actions are executed, or all if it is shorter."""

    def __init__(self, execute: int) -> None:
        self._execute = execute
        self._left: list[NDArray[np.float32]] = []
        self.before: NDArray[np.float32] | None = None  # the action of the step before

    def action(self, answer: Callable[[], Any]) -> NDArray[np.float32]:
        """The action of a step, whose answer is awaited in any case. Raises `Missed` only where a chunk is due."""
        try:
            actions = answer().actions
        except Missed:
            if not self._left:
                raise
        else:
            self._left = self._left or [*actions[: self._execute]]
        self.before = self._left.pop(0)
        return self.before.copy()

    def reset(self) -> None:
        """Ends the episode."""
        self._left, self.before = [], None


class OpenLoop:
    """A policy whose chunks are executed for `execute` steps, or to their end if that comes first.

    Every observation is still sent, with the action that was executed before it, so that histories and recordings are
    complete.
    """

    def __init__(self, policy: Planner, execute: int) -> None:
        self._policy, self._plan = policy, Plan(execute)

    def __call__(self, observation: Observation) -> NDArray[np.float32]:
        """The action for this step. Raises `Missed` only where a chunk is due."""
        if observation.executed_action is None:
            observation.executed_action = self._plan.before
        return self._plan.action(lambda: self._policy.chunk(observation))

    def reset(self) -> None:
        """Ends the episode."""
        self._plan.reset()
        self._policy.reset()
