"""The policy `gleaner`: each row of a batch is an episode of its own, and so a session of its own on the server."""

from __future__ import annotations

import os
import weakref
from pathlib import Path
from typing import Any

import gleaner
import numpy as np
import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from numpy.typing import NDArray
from torch import Tensor

from . import task_match
from .configuration_gleaner import GleanerConfig
from .names import STATE

# Seconds for which a row without an action by the deadline repeats its last one. LeRobot ends the rollout at an error,
# but an action that moves the robot on must not be repeated for as long as the connection is broken.
HOLD = 1.0

TRAINED_BY_THE_SERVER = "policy gleaner: training is a job of the server; see `gleaner train --help`"


class GleanerPolicy(PreTrainedPolicy):
    """Sends the newest observation, and returns the action that the deployment gives."""

    config_class = GleanerConfig
    name = "gleaner"

    def __init__(self, config: GleanerConfig, *args: Any, **kwargs: Any) -> None:
        """Connects to the server. Raises ValueError if robot and task do not fit, and the errors of `gleaner`."""
        del args, kwargs
        super().__init__(config)
        if not config.deployment:
            raise ValueError("policy.deployment: is empty; name a deployment, such as pick_cube@prod")
        self.config: GleanerConfig = config
        self._client = gleaner.connect(config.server, os.environ.get("GLEANER_TOKEN"), ca=config.ca)
        self._cameras: dict[str, str] | None = None
        # One row, until a batch shows how many there are.
        self._sessions = self._open(1)
        state, action = config.robot_state_feature, config.action_feature
        sizes = (None if of is None else int(np.prod(of.shape)) for of in (state, action))
        task_match.sizes(self._sessions.spec, *sizes)

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: GleanerConfig | None = None, **kwargs: Any
    ) -> GleanerPolicy:
        """The policy of a folder that has settings alone: the weights are the server's."""
        del kwargs
        return cls(config or GleanerConfig.from_pretrained(pretrained_name_or_path))

    def reset(self) -> None:
        """Ends the episodes; the next observation begins new ones."""
        self._sessions.reset()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """The action of each row, `[rows, values]`.

        A row that misses its deadline repeats its last action for up to a second. Raises `gleaner.Missed` after that,
        and where the episode has no action yet, because no other one is known to be safe.
        """
        del kwargs
        seen = self._observations(batch)
        if len(seen) != len(self._sessions.rows):
            self._sessions.reset()
            self._sessions = self._open(len(seen))
        # The loop has no newer observation to send after a slow opening, and its robot has had no action until now.
        self._sessions.open()
        return torch.from_numpy(self._sessions(seen))

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **kwargs: Any) -> Tensor:
        """The action of each row as a chunk of one step, `[rows, 1, values]`: the server executes its chunks itself."""
        return self.select_action(batch, **kwargs).unsqueeze(1)

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Any] | None]:
        """Refuses: the server trains."""
        raise NotImplementedError(TRAINED_BY_THE_SERVER)

    def get_optim_params(self) -> dict[str, Any]:
        """Refuses: the server trains."""
        raise NotImplementedError(TRAINED_BY_THE_SERVER)

    def _observations(self, batch: dict[str, Tensor]) -> list[gleaner.Observation]:
        if STATE not in batch:
            raise ValueError(f"{STATE}: is missing; the batch has {', '.join(sorted(batch))}")
        if self._cameras is None:
            self._cameras = task_match.cameras(self._sessions.spec, list(batch), self.config.cameras)
        images = {name: _pixels(batch[key]) for name, key in self._cameras.items()}
        states = batch[STATE].cpu().numpy().astype(np.float32)
        return [
            gleaner.Observation({name: rows[at] for name, rows in images.items()}, states[at])
            for at in range(len(states))
        ]

    def _open(self, rows: int) -> gleaner.VectorPolicy:
        config = self.config
        sessions = gleaner.VectorPolicy(
            self._client,
            config.deployment,
            rows,
            rate_hz=config.rate_hz,
            deadline=config.deadline,
            hold=HOLD,
            record=config.record,
            cohort=config.cohort,
            seed=config.seed,
        )
        # LeRobot's loops do not reset a policy after their last episode, whose recording would lack its end.
        weakref.finalize(self, sessions.reset)
        return sessions


def _pixels(images: Tensor) -> NDArray[np.uint8]:
    """Rows of C × H × W in [0, 1] to H × W × C bytes."""
    if images.dtype == torch.uint8:
        return images.permute(0, 2, 3, 1).cpu().numpy()
    return (images * 255).round().clamp(0, 255).to(torch.uint8).permute(0, 2, 3, 1).cpu().numpy()
