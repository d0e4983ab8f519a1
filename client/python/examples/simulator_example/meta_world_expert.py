"""Meta-World's scripted expert, and its faults. Independent of files."""

from __future__ import annotations

import warnings

import numpy as np
from metaworld.policies import ENV_POLICY_MAP
from numpy.typing import NDArray

from simulator_example.agent import Action, Agent, State

GOAL = slice(36, 39)
OPEN = -1.0
# Before the grasp of some episodes, on the way to the goal in most.
RELEASE_STEPS = (8, 20)


class Expert:
    """The scripted expert, with the fault of an agent and its size `amount`.

    noise    white noise of this deviation on every value of the action
    goal     a goal that is off by N(0, amount · 10 cm) in x and y
    release  from some step on the gripper stays open, in this share of the episodes
    """

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

    def __call__(self, state: State) -> tuple[Action, Action]:
        """The agent's action for a state, and what the expert would do there."""
        seen = state.copy()
        seen[GOAL] += self._goal_off
        action = self._expert(seen)
        if self._agent.spoiled == "noise":
            action += self._agent.amount * self._random.normal(size=action.shape)
        if self._open_from is not None and self._step >= self._open_from:
            action[3] = OPEN
        self._step += 1
        return _bounded(action), _bounded(self._expert(state))

    def _expert(self, state: State) -> NDArray[np.float64]:
        with warnings.catch_warnings():
            # The scripted policies warn at every step that the environment clips their actions.
            warnings.simplefilter("ignore")
            # They keep no state between steps.
            return np.asarray(self._policy.get_action(state), np.float64)


def _bounded(action: NDArray[np.float64]) -> Action:
    return np.clip(action, -1.0, 1.0).astype(np.float32)
