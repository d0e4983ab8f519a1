"""The actions that a robot executed in an episode, each reported to the server with the observation after it."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from gleaner._proto.v1 import policy_pb2 as pb


class Executed:
    """What is known of them: an action counts as executed once it is given, until the caller reports otherwise."""

    def __init__(self) -> None:
        self.next: NDArray[np.float32] | None = None  # to report
        self.reported: NDArray[np.float32] | None = None
        self._given_at = 0.0

    def give(self, action: NDArray[np.float32]) -> None:
        """The policy gave an action for the newest observation."""
        self.next, self._given_at = action.copy(), time.monotonic()

    def withhold(self) -> None:
        """The action for the newest observation, if any, is not executed: the robot still executes the one before."""
        self.next = self.reported

    def repeated(self, within: float) -> NDArray[np.float32] | None:
        """The action before, once more, unless none was given for this many seconds."""
        if self.reported is None or time.monotonic() - self._given_at > within:
            return None
        self.next = self.reported
        return self.reported.copy()

    def report(self, message: pb.Observation) -> None:
        """Adds the action to an observation that has none of its own."""
        if not message.executed_action and self.next is not None:
            message.executed_action.extend(self.next)
        if message.executed_action:
            self.reported = np.array(message.executed_action, np.float32)
        self.next = None
