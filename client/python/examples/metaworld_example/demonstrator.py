"""The agents of the demonstrations: Meta-World's scripted expert, and the expert with faults. Independent of files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from metaworld.policies import ENV_POLICY_MAP
from numpy.typing import NDArray

GOAL = slice(36, 39)
OPEN = -1.0
# Before the grasp of some episodes, on the way to the goal in most.
RELEASE_STEPS = (8, 20)


@dataclass(frozen=True)
class Agent:
    """The fault of an agent; with `amount` 0 it equals the expert.

    noise    white noise of this deviation on every value of the action
    goal     sees a goal that is off by N(0, amount · 10 cm) in x and y
    release  from some step on the gripper stays open, in this share of the episodes
    """

    name: str
    spoiled: str = "noise"
    amount: float = 0.0


EXPERT = Agent("expert")
IMPERFECT = (Agent("noise", "noise", 0.5), Agent("wrong_goal", "goal", 1.0), Agent("early_release", "release", 1.0))


class Demonstrator:
    """The agent of one episode: from a state of Meta-World to an action in [-1, 1]."""

    def __init__(self, task: str, agent: Agent, seed: int) -> None:
        self._policy = ENV_POLICY_MAP[task]()
        self._agent = agent
        self._random = np.random.default_rng([seed, 1])
        self._goal_off = np.zeros(3)
        self._open_from: int | None = None
        self._step = 0
        if agent.spoiled == "goal":
            self._goal_off[:2] = self._random.normal(0.0, 0.1 * agent.amount, 2)
        elif agent.spoiled == "release" and self._random.random() < agent.amount:
            self._open_from = int(self._random.integers(*RELEASE_STEPS))

    def __call__(self, state: NDArray[np.float64]) -> NDArray[np.float32]:
        """The action for a state."""
        seen = state.copy()
        seen[GOAL] += self._goal_off
        with warnings.catch_warnings():
            # The scripted policies warn at every step that the environment clips their actions.
            warnings.simplefilter("ignore")
            action = np.asarray(self._policy.get_action(seen), np.float64)
        if self._agent.spoiled == "noise":
            action += self._agent.amount * self._random.normal(size=action.shape)
        if self._open_from is not None and self._step >= self._open_from:
            action[3] = OPEN
        self._step += 1
        return np.clip(action, -1.0, 1.0).astype(np.float32)
