"""Chunks executed open loop: several actions of an answer before the next answer counts. Knows no environment."""

from __future__ import annotations

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


class OpenLoop:
    """A policy whose chunks are executed for `execute` steps, or to their end if that comes first.

    Every observation is still sent, with the action that was executed before it, so that histories and recordings are
    complete.
    """

    def __init__(self, policy: Planner, execute: int) -> None:
        self._policy, self._execute = policy, execute
        self._plan: list[NDArray[np.float32]] = []
        self._before: NDArray[np.float32] | None = None

    def __call__(self, observation: Observation) -> NDArray[np.float32]:
        """The action for this step. Raises `Missed` only where a chunk is due."""
        observation.executed_action = self._before
        try:
            actions = self._policy.chunk(observation).actions
        except Missed:
            if not self._plan:
                raise
        else:
            self._plan = self._plan or [*actions[: self._execute]]
        self._before = self._plan.pop(0)
        return self._before.copy()

    def reset(self) -> None:
        """Ends the episode."""
        self._plan, self._before = [], None
        self._policy.reset()
