"""The agents of the demonstrations: a scripted expert, and the expert with faults. Independent of simulators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Action = NDArray[np.float32]
State = NDArray[np.float64]


@dataclass(frozen=True)
class Agent:
    """The fault of an agent; with `amount` 0 it equals the expert. The scripted experts document what each fault is."""

    name: str
    spoiled: str = "noise"  # noise, goal or release
    amount: float = 0.0


EXPERT = Agent("expert")


class Demonstrator(Protocol):
    """The agent of one episode, called once for each step."""

    def __call__(self, state: State) -> tuple[Action, Action]:
        """The agent's action for a state, and what the expert would do there."""
