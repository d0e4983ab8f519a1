"""Settings of the policy `gleaner`: which deployment acts, and which of the robot's cameras it sees."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.configs.policies import PreTrainedConfig
from lerobot.optim.optimizers import OptimizerConfig
from lerobot.optim.schedulers import LRSchedulerConfig


@PreTrainedConfig.register_subclass("gleaner")
@dataclass
class GleanerConfig(PreTrainedConfig):
    """`--policy.type=gleaner`. The token of a server that requires one is in the environment, GLEANER_TOKEN."""

    # Address of the server, such as https://lab:7400.
    server: str = "http://127.0.0.1:7400"
    # Name of the deployment, such as pick_cube@prod. Required.
    deployment: str = ""
    # File with the authority of the server's certificate; not needed if a public authority signed it.
    ca: str | None = None
    # Control rate in Hz; by default that of the task.
    rate_hz: float | None = None
    # Seconds after which an answer is worthless; by default answers are waited for.
    deadline: float | None = None
    # Whether the server keeps each episode as a recording of the task, and under which cohort.
    record: bool = False
    cohort: str = ""
    # The seed of policies that draw their actions; the first episode of each environment has a seed of its own.
    seed: int = 0
    # The task's camera for each of the robot's, such as {"front": "hand"}; cameras of equal names need no entry.
    cameras: dict[str, str] = field(default_factory=dict)

    # The server keeps the history and the chunks, so that LeRobot asks for one action at a time.
    n_obs_steps: int = 1
    n_action_steps: int = 1
    chunk_size: int = 1

    def validate_features(self) -> None:
        """Features are compared with the task when the connection is made."""

    def get_optimizer_preset(self) -> OptimizerConfig:
        """Refuses: the server trains."""
        raise NotImplementedError("policy gleaner: training is a job of the server; see `gleaner train --help`")

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        """None: the server trains."""
        return None

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """None: the newest observation alone is sent."""
        return None

    @property
    def action_delta_indices(self) -> list[int] | None:
        """None: nothing is trained here."""
        return None

    @property
    def reward_delta_indices(self) -> list[int] | None:
        """None: nothing is trained here."""
        return None
