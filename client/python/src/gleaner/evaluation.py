"""Closed-loop trials of a policy in any Gymnasium environment. It needs a server only to report results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gleaner._client import Client
from gleaner._films import Films
from gleaner._open_loop import OpenLoop, Planner
from gleaner.errors import invalid
from gleaner.observation import Observation
from gleaner.policy import Policy
from gleaner.statistics import wilson
from gleaner.types import Evaluation, SeedResult, TaskSpec

if TYPE_CHECKING:
    from gleaner._video import Video


class Env(Protocol):
    """The used part of a `gymnasium.Env`."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode: returns its first observation, and info."""

    def step(self, action: Any, /) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Acts: observation, reward, terminated, truncated, info."""


class Acting(Protocol):
    """The used part of a `Policy`; any controller with these methods is accepted."""

    def __call__(self, observation: Observation, /) -> NDArray[np.float32]:
        """The action for this step."""

    def reset(self) -> object:
        """Ends the episode."""


class Adapter:
    """Adapter of an environment to a task: override `cameras` and `proprioception`, and whatever else differs.

    `spec` is the task's, set before the first episode: image sizes are there, for rendering.
    """

    spec: TaskSpec

    def cameras(self, env: Any, observation: Any) -> Mapping[str, NDArray[np.uint8] | bytes]:
        """Each of the task's cameras by name: height × width × RGB, or JPEG or PNG bytes."""
        raise NotImplementedError(f"{type(self).__name__}.cameras: override it to give the task's cameras")

    def depth(self, env: Any, observation: Any) -> Mapping[str, NDArray[np.uint16] | bytes]:
        """Each camera with depth by name: height × width millimetres."""
        return {}

    def proprioception(self, env: Any, observation: Any) -> ArrayLike | Mapping[str, Any]:
        """The task's proprioception, in physical units: its fields one after the other, or field → values."""
        raise NotImplementedError(f"{type(self).__name__}.proprioception: override it to give the task's values")

    def action(self, env: Any, action: NDArray[np.float32]) -> Any:
        """The environment's action for a policy's action: by default the action itself."""
        return action

    def executed(self, env: Any, action: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """What the environment executes of a policy's action, as an action of the task; None: the action itself.

        The policy gets it with the next observation, and a recording keeps it.
        """
        return None

    def success(self, env: Any, info: Mapping[str, Any]) -> bool:
        """Whether the task is solved after a step: by default `success` or `is_success` in the environment's info."""
        return bool(info.get("success", info.get("is_success", False)))


@dataclass(frozen=True)
class Trial:
    """One episode."""

    seed: int
    success: bool
    steps: int
    episode_id: str = ""  # of its recording on the server, if any


@dataclass(frozen=True)
class Trials:
    """The result of an evaluation."""

    seed: int
    trials: tuple[Trial, ...]
    policy_id: str  # empty unless the controller is a deployed policy

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return len(self.trials)

    @property
    def successes(self) -> int:
        """The number of solved episodes."""
        return sum(trial.success for trial in self.trials)

    @property
    def success_rate(self) -> float:
        """Share of episodes that were solved."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson(self.successes, self.episodes)

    @property
    def mean_steps(self) -> float:
        """Steps of an episode, on average."""
        return sum(trial.steps for trial in self.trials) / self.episodes

    def report(self, client: Client, simulation: str) -> Evaluation:
        """Stores this result with the policy on the server; `simulation` is for example metaworld/pick-place-v3."""
        if not self.policy_id:
            raise invalid("policy_id", "these trials did not use a deployed policy")
        seed = SeedResult(seed=self.seed, episodes=self.episodes, successes=self.successes, mean_steps=self.mean_steps)
        return client.policies.report(self.policy_id, simulation, [seed])

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.successes} of {self.episodes} solved: {self.success_rate:.2f} [{low:.2f}, {high:.2f}]"


def evaluate(
    env: Env,
    policy: Acting,
    adapter: Adapter,
    episodes: int = 50,
    seed: int = 0,
    *,
    max_steps: int | None = None,
    execute: int = 1,
    video: str | os.PathLike[str] | None = None,
    on_trial: Callable[[Trial], object] = lambda trial: None,
) -> Trials:
    """Runs episodes one after the other; episode i starts from seed + i, so that policies are evaluated on equal ones.

    An episode ends solved as soon as the adapter's `success` returns true, else when the environment ends it, or
    unsolved after `max_steps`. An exception of the policy, including a missed deadline, ends the evaluation. A
    recording `Policy` labels each episode by its result.

    `execute` is the number of actions of each chunk to execute before the next chunk counts (open loop).
    `video` is a folder for a video of each episode with the cameras that the policy saw, named by seed and result;
    it needs PyAV (`pip install av`).
    """
    if episodes < 1:
        raise invalid("episodes", "must be at least 1")
    if max_steps is not None and max_steps < 1:
        raise invalid("max_steps", "must be at least 1")
    if execute < 1:
        raise invalid("execute", "must be at least 1")
    spec = getattr(policy, "spec", None)
    if spec is not None:
        adapter.spec = spec
    films = None if video is None else Films(video, spec)
    trials = []
    ids: set[str] = set()
    for index in range(episodes):
        with nullcontext() if films is None else films.episode(seed + index) as film:
            trial = _trial(env, policy, adapter, seed + index, max_steps=max_steps, execute=execute, film=film)
        if films is not None:
            films.name(trial.seed, success=trial.success)
        # An episode that was solved from the start has asked no policy.
        if trial.steps:
            ids.add(getattr(policy, "policy_id", ""))
        if len(ids) > 1:
            raise invalid(
                "policy", "another policy was deployed under this name while it was evaluated; evaluate again"
            )
        trials.append(trial)
        on_trial(trial)
    return Trials(seed, tuple(trials), ids.pop() if ids else "")


def _trial(
    env: Env,
    policy: Acting,
    adapter: Adapter,
    seed: int,
    *,
    max_steps: int | None,
    execute: int,
    film: Video | None,
) -> Trial:
    acting = policy if execute == 1 else OpenLoop(_planner(policy), execute)
    acting.reset()
    observed, info = env.reset(seed=seed)
    steps, success, over = 0, adapter.success(env, info), False
    executed: NDArray[np.float32] | None = None
    while not (success or over):
        observation = Observation(
            images=adapter.cameras(env, observed),
            depth=adapter.depth(env, observed),
            proprioception=adapter.proprioception(env, observed),
            executed_action=executed,
        )
        if film is not None:
            film.add(observation.images)
        action = acting(observation)
        executed = adapter.executed(env, action)
        observed, _, terminated, truncated, info = env.step(adapter.action(env, action))
        steps += 1
        success = adapter.success(env, info)
        over = bool(terminated) or bool(truncated) or steps == max_steps
    if isinstance(policy, Policy):
        return Trial(seed, success, steps, policy.close("success" if success else "failure"))
    policy.reset()
    return Trial(seed, success, steps)


def _planner(policy: Acting) -> Planner:
    if not callable(getattr(policy, "chunk", None)):
        raise invalid("execute", "the policy has no method `chunk`, which open-loop execution needs")
    return cast("Planner", policy)
