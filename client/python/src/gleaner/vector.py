"""A deployed policy in several environments at once: every step is one batch of the server."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gleaner._client import Client
from gleaner._opening import open_for_step
from gleaner.errors import invalid
from gleaner.observation import Observation, size
from gleaner.policy import Policy


class VectorPolicy:
    """One deployment that acts in `num_envs` environments, each with a session of its own. A context manager.

    The options are those of `Policy`; the sessions draw from seeds of their own. Observations of a step are sent
    before any answer is awaited, so that the server answers them together.
    """

    def __init__(self, client: Client, deployment: str, num_envs: int, *, seed: int = 0, **options: Any) -> None:
        if num_envs < 1:
            raise invalid("num_envs", "must be at least 1")
        # Later episodes of a row count on from its seed.
        seeds = ((seed + (row << 32)) % 2**64 for row in range(num_envs))
        self.rows = [Policy(client, deployment, seed=seed, **options) for seed in seeds]
        self.spec = self.rows[0].spec

    def __call__(self, observations: Sequence[Observation | Mapping[str, Any] | None]) -> NDArray[np.float32]:
        """The action of each row, `[num_envs, values]`; zeros for rows without an observation.

        Raises as `Policy` does, once every answer of the step has come.
        """
        return self._step(observations, lambda row: self.rows[row]._action())

    def _step(
        self,
        observations: Sequence[Observation | Mapping[str, Any] | None],
        take: Callable[[int], NDArray[np.float32]],
    ) -> NDArray[np.float32]:
        # `take` awaits the answer of a row and gives its action.
        if len(observations) != len(self.rows):
            raise invalid(
                "observations", f"expected {len(self.rows)}, one for each environment, got {len(observations)}"
            )
        # First, because an opening may take longer than the other rows' observations are of use.
        open_for_step([self.rows[row] for row, observation in enumerate(observations) if observation is not None])
        asked = []
        failed: Exception | None = None
        for row, observation in enumerate(observations):
            if observation is None:
                continue
            try:
                self.rows[row]._observe(observation)
            except Exception as error:  # The answers to what was sent before are taken first.
                failed = error
                break
            asked.append(row)
        actions = np.zeros((len(self.rows), size(self.spec.action)), np.float32)
        for row in asked:
            try:
                actions[row] = take(row)
            except Exception as error:  # As above.
                failed = failed or error
        if failed is not None:
            raise failed
        return actions

    def open(self) -> None:
        """Opens the session of each row, as the first call would."""
        for row in self.rows:
            row.open()

    @property
    def policy_ids(self) -> set[str]:
        """The policies that act: more than one if another was deployed between their episodes."""
        return {row.policy_id for row in self.rows if row.policy_id}

    def reset(self, row: int | None = None, outcome: str = "unknown") -> list[str]:
        """Ends the episode of one row, or of all; returns the ids of recorded episodes, as `Policy.reset` does."""
        chosen = self.rows if row is None else [self.rows[row]]
        kept = []
        failed: Exception | None = None
        for policy in chosen:
            try:
                kept.append(policy.reset(outcome))
            except Exception as error:  # The episodes of the other rows end too.
                failed = failed or error
        if failed is not None:
            raise failed
        return kept

    def close(self) -> None:
        """Ends every episode."""
        self.reset()

    def __enter__(self) -> VectorPolicy:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if error is None:
            self.close()
            return
        for row in self.rows:
            row.__exit__(kind, error, at)
