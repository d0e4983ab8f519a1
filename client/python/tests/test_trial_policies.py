"""Which policy the trials of an evaluation belong to, where a deployment moves meanwhile. No server."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

import gleaner
from gleaner.types import FieldSpec, TaskSpec
from test_policy import Blind, Reach
from test_vector import Tolerant


class Deployed:
    """A controller whose next episode has the policy deployed then; another one after `moves` episodes."""

    def __init__(self, moves: int | None = None) -> None:
        self.moves, self.begun, self.running = moves, 0, False
        self.policy_id = ""

    def __call__(self, observation: gleaner.Observation, /) -> NDArray[np.float32]:
        if not self.running:
            self.running = True
            self.policy_id = "pol_2" if self.moves is not None and self.begun >= self.moves else "pol_1"
            self.begun += 1
        return np.zeros(2, np.float32)

    def reset(self, outcome: str = "unknown") -> str:
        self.running = False
        return ""


class Rows:
    """The used part of a `VectorPolicy`."""

    def __init__(self, count: int, moves: int | None = None) -> None:
        self.rows = [Deployed(moves) for _ in range(count)]
        self.spec = TaskSpec(action=[FieldSpec(name="move", size=2)])

    def __call__(self, observations: list[gleaner.Observation | None], /) -> NDArray[np.float32]:
        for row, observation in zip(self.rows, observations, strict=True):
            if observation is not None:
                row(observation)
        return np.zeros((len(self.rows), 2), np.float32)

    def reset(self, row: int | None = None, outcome: str = "unknown") -> list[str]:
        return [one.reset(outcome) for one in (self.rows if row is None else [self.rows[row]])]


class SolvedAtFirst(Blind):
    """The first episode is solved before any step."""

    def __init__(self) -> None:
        self.first = True

    def success(self, env: Any, info: Any) -> bool:
        first, self.first = self.first, False
        return first or super().success(env, info)


def vector(count: int) -> SyncVectorEnv:
    return SyncVectorEnv([Tolerant] * count, autoreset_mode=AutoresetMode.DISABLED)


def test_an_episode_that_is_solved_at_once_is_of_no_policy() -> None:
    trials = gleaner.evaluate(Reach(), Deployed(), SolvedAtFirst(), episodes=3, seed=11)
    assert [trial.steps for trial in trials.trials] == [0, 3, 5]
    assert trials.policy_id == "pol_1"
    assert gleaner.evaluate(Reach(), Deployed(), SolvedAtFirst(), episodes=1).policy_id == ""
    rows: Any = Rows(1)
    assert gleaner.evaluate_vector(vector(1), rows, SolvedAtFirst(), episodes=1).policy_id == ""
    trials = gleaner.evaluate_vector(vector(1), rows, SolvedAtFirst(), episodes=2, seed=11)
    assert ([trial.steps for trial in trials.trials], trials.policy_id) == ([0, 3], "pol_1")


def test_a_deployment_that_moves_between_rounds_ends_the_evaluation() -> None:
    moved: Any = Rows(2, moves=1)
    with pytest.raises(gleaner.InvalidArgument, match="another policy was deployed"):
        gleaner.evaluate_vector(vector(2), moved, Blind(), episodes=4)
    with pytest.raises(gleaner.InvalidArgument, match="another policy was deployed"):
        gleaner.evaluate(Reach(), Deployed(moves=1), Blind(), episodes=2)


def test_policies_of_earlier_evaluations_do_not_count() -> None:
    rows: Any = Rows(2)
    for row in rows.rows:
        row.policy_id = "pol_0"
    assert gleaner.evaluate_vector(vector(2), rows, Blind(), episodes=1).policy_id == "pol_1"


def test_every_row_ends_its_episode_although_one_cannot_be_stored() -> None:
    ended: list[int] = []

    def row(number: int) -> SimpleNamespace:
        def reset(outcome: str) -> str:
            ended.append(number)
            if number == 0:
                raise gleaner.Unavailable("the recording cannot be stored")
            return f"ep_{number}"

        return SimpleNamespace(reset=reset)

    policy = gleaner.VectorPolicy.__new__(gleaner.VectorPolicy)
    rows: Any = [row(number) for number in range(3)]
    policy.rows = rows
    for end in (policy.reset, policy.close, lambda: policy.__exit__(None, None, None)):
        ended.clear()
        with pytest.raises(gleaner.Unavailable, match="cannot be stored"):
            end()
        assert ended == [0, 1, 2]
