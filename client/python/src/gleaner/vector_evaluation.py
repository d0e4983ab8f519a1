"""Closed-loop trials in a vector of environments (Gymnasium's vector API, ManiSkill). It opens no connection itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gleaner._films import Films
from gleaner._open_loop import Plan
from gleaner.errors import invalid
from gleaner.evaluation import Adapter, Trial, Trials
from gleaner.observation import Observation
from gleaner.vector import VectorPolicy

if TYPE_CHECKING:
    from gleaner._video import Video


class VectorEnv(Protocol):
    """The used part of a `gymnasium.vector.VectorEnv`."""

    num_envs: int

    def reset(self, *, seed: Any = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in each: returns the first observations, and info."""

    def step(self, actions: Any, /) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Acts in each: observations, rewards, terminated, truncated, info."""


def evaluate_vector(
    envs: VectorEnv,
    policy: VectorPolicy,
    adapter: Adapter,
    episodes: int = 50,
    seed: int = 0,
    *,
    max_steps: int | None = None,
    execute: int = 1,
    video: str | os.PathLike[str] | None = None,
    on_trial: Callable[[Trial], object] = lambda trial: None,
) -> Trials:
    """Runs episodes in as many environments at once as there are; episode i starts from seed + i, as in `evaluate`.

    The environments start together with the next seeds, and start again when the last of them has ended; what one does
    after its own end, whatever its autoreset mode, does not count. The adapter is given the vector as `env`, and the
    part of the observation and info that belongs to one environment. `execute` and `video` are those of `evaluate`.
    """
    if episodes < 1:
        raise invalid("episodes", "must be at least 1")
    if max_steps is not None and max_steps < 1:
        raise invalid("max_steps", "must be at least 1")
    if execute < 1:
        raise invalid("execute", "must be at least 1")
    count = envs.num_envs
    if count != len(policy.rows):
        raise invalid("policy", f"it acts in {len(policy.rows)} environments, there are {count}")
    adapter.spec = policy.spec
    films = None if video is None else Films(video, policy.spec)
    trials: list[Trial] = []
    ids: set[str] = set()
    for first in range(0, episodes, count):
        # All environments take a seed; those beyond the last episode are not looked at.
        seeds = [seed + first + row for row in range(count)]
        looked_at = min(count, episodes - first)
        acting = policy if execute == 1 else _OpenLoops(policy, execute)
        with _Filming(films, seeds[:looked_at]) as filming:
            ended = _round(
                envs, acting, adapter, seeds, looked_at, max_steps=max_steps, filming=filming, on_trial=on_trial
            )
        trials += ended
        # Of every round: all rows begin a round with the policy deployed then. A row without a step has asked none.
        ids |= {row.policy_id for row, trial in zip(policy.rows, ended, strict=False) if trial.steps}
        if len(ids) > 1:
            raise invalid(
                "policy", "another policy was deployed under this name while it was evaluated; evaluate again"
            )
    return Trials(seed, tuple(trials), ids.pop() if ids else "")


class _Rows(Protocol):
    """The used part of a `VectorPolicy`."""

    def __call__(self, observations: Sequence[Observation | None], /) -> NDArray[np.float32]:
        """The action of each row."""

    def reset(self, row: int | None = None, outcome: str = "unknown") -> list[str]:
        """Ends the episode of one row, or of all."""


class _OpenLoops:
    """A policy of which several actions of each chunk are executed, in each row separately."""

    def __init__(self, policy: VectorPolicy, execute: int) -> None:
        self._policy, self._plans = policy, [Plan(execute) for _ in policy.rows]

    def __call__(self, observations: Sequence[Observation | None], /) -> NDArray[np.float32]:
        for observation, plan in zip(observations, self._plans, strict=True):
            if observation is not None and observation.executed_action is None:
                observation.executed_action = plan.before
        return self._policy._step(observations, lambda row: self._plans[row].action(self._policy.rows[row]._answer))

    def reset(self, row: int | None = None, outcome: str = "unknown") -> list[str]:
        for plan in self._plans if row is None else [self._plans[row]]:
            plan.reset()
        return self._policy.reset(row, outcome)


class _Filming:
    """The videos of the episodes of one round, or none."""

    def __init__(self, films: Films | None, seeds: Sequence[int]) -> None:
        self._films = films
        self._running: dict[int, Video] = {} if films is None else {seed: films.episode(seed) for seed in seeds}

    def add(self, seed: int, observation: Observation) -> None:
        """The cameras of a step."""
        if film := self._running.get(seed):
            film.add(observation.images)

    def end(self, seed: int, *, success: bool) -> None:
        """An episode has ended."""
        if film := self._running.pop(seed, None):
            film.__exit__(None, None, None)
        if self._films is not None:
            self._films.name(seed, success=success)

    def __enter__(self) -> _Filming:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for film in self._running.values():
            film.__exit__(kind, error, at)


def _round(
    envs: VectorEnv,
    policy: _Rows,
    adapter: Adapter,
    seeds: Sequence[int],
    looked_at: int,
    *,
    max_steps: int | None,
    filming: _Filming,
    on_trial: Callable[[Trial], object],
) -> list[Trial]:
    # An episode for each of the first environments.
    policy.reset()
    observed, info = envs.reset(seed=list(seeds))
    ended: dict[int, Trial] = {}
    steps = 0
    actions: list[Any] = [None] * len(seeds)
    executed: list[Any] = [None] * len(seeds)

    def end(row: int, success: bool) -> None:
        recorded = policy.reset(row, "success" if success else "failure")[0]
        ended[row] = Trial(seeds[row], success, steps, recorded)
        filming.end(seeds[row], success=success)
        on_trial(ended[row])

    for row in range(looked_at):
        if adapter.success(envs, info_of(info, row)):
            end(row, True)
    while len(ended) < looked_at:
        seen = [
            _observation(envs, adapter, row_of(observed, row), executed[row])
            if row < looked_at and row not in ended
            else None
            for row in range(len(seeds))
        ]
        for row, observation in enumerate(seen):
            if observation is not None:
                filming.add(seeds[row], observation)
        chosen = policy(seen)
        for row, action in enumerate(chosen):
            # Environments that have ended repeat their last action, which is within their bounds.
            if actions[row] is None or seen[row] is not None:
                actions[row] = adapter.action(envs, action)
                executed[row] = adapter.executed(envs, action)
        observed, _, terminated, truncated, info = envs.step(np.stack(actions))
        steps += 1
        over = np.asarray(_cpu(terminated), bool) | np.asarray(_cpu(truncated), bool)
        for row in range(looked_at):
            if row in ended:
                continue
            success = adapter.success(envs, info_of(info, row))
            if success or over[row] or steps == max_steps:
                end(row, success)
    return [ended[row] for row in range(looked_at)]


def _observation(envs: VectorEnv, adapter: Adapter, observed: Any, executed: Any) -> Observation:
    return Observation(
        images=adapter.cameras(envs, observed),
        depth=adapter.depth(envs, observed),
        proprioception=adapter.proprioception(envs, observed),
        executed_action=executed,
    )


def row_of(batch: Any, row: int) -> Any:
    """One environment's part of a batch of observations: arrays or tensors by their first axis, within any nesting."""
    if isinstance(batch, Mapping):
        return {key: row_of(part, row) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(row_of(part, row) for part in batch)
    return _cpu(batch[row])


def info_of(info: Mapping[str, Any], row: int) -> dict[str, Any]:
    """One environment's part of the info of a vector: a key `k` belongs to the environments that `_k` lists.

    Where an environment has been reset within its last step, `final_info` has what it ended with.
    """
    if "final_info" in info and _has(info, "final_info", row):
        final = info["final_info"]
        return info_of(final, row) if isinstance(final, Mapping) else dict(final[row] or {})
    found: dict[str, Any] = {}
    for key, values in info.items():
        if key.startswith("_") or not _has(info, key, row):
            continue
        if isinstance(values, Mapping):
            found[key] = info_of(values, row)
        elif hasattr(values, "__len__") and not isinstance(values, str) and len(values) > row:
            found[key] = _cpu(values[row])
    return found


def _has(info: Mapping[str, Any], key: str, row: int) -> bool:
    mask = info.get(f"_{key}")
    return mask is None or bool(mask[row])


def _cpu(value: Any) -> Any:
    # Tensors of simulators that run on a GPU.
    move: Callable[[], NDArray[Any]] | None = getattr(value, "cpu", None)
    return np.asarray(move()) if callable(move) else value
