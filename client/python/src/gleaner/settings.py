"""Settings of jobs, as typed keywords. Choices are words: `preset="tiny"`; missing settings have their default.

The settings themselves are generated from the server's schema (`gleaner._proto.kinds`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict

from gleaner._proto.kinds import EvaluateValues, PretrainValues, ScoreValues, TrainValues
from gleaner.errors import invalid


class Order(TypedDict, total=False):
    """How a job is queued."""

    key: str  # chosen by the caller; a second submission with the same key returns the first job
    priority: int  # higher runs first
    needs: Sequence[str]  # further jobs to wait for
    max_attempts: int
    engine_options: str  # options of sbatch for this job; needs the role admin and a server with --engine slurm


class RoleRule(TypedDict, total=False):
    """Which episodes are experts and which are imperfect. Empty: success and failure."""

    expert_cohorts: Sequence[str]
    imperfect_cohorts: Sequence[str]
    imperfect_per_expert: float
    max_experts: int
    seed: int


class PretrainSettings(Order, PretrainValues, total=False):
    """Settings of a pretraining job."""

    snapshot_id: str
    rule: RoleRule


class ScoreSettings(Order, ScoreValues, total=False):
    """Settings of a scoring job."""

    snapshot_id: str
    extends: str


class TrainSettings(Order, TrainValues, total=False):
    """Settings of a training job; exactly one of dataset_id, experts_of and experts_in."""

    dataset_id: str
    experts_of: str
    experts_in: str


class EvaluateSettings(Order, EvaluateValues, total=False):
    """Settings of an evaluation in the embedded simulator; exactly one of policy_id and deployment."""

    policy_id: str
    deployment: str


class PipelineStages(TypedDict, total=False):
    """The stages of a pipeline. A stage without settings of its own is given as `{}`."""

    snapshot_id: str  # what to pretrain on; without it a new snapshot under the rule
    rule: RoleRule
    pretrain: PretrainValues  # always a stage
    score: ScoreValues  # also a stage if a later one is given
    beta: float  # the dataset: segments with q > β
    top_fraction: float  # or the best part of them
    shape: Mapping[str, Any]  # of the dataset, such as {"min_run": 5}; {"min_expert_auroc": 0} keeps every cohort
    train: TrainValues  # needs beta or top_fraction
    evaluate: EvaluateValues  # needs train


def expect_known(place: str, given: Iterable[str], known: type) -> None:
    """Raises `InvalidArgument` for a name that a typed dictionary lacks."""
    unknown = {*given} - known.__annotations__.keys()
    if unknown:
        raise invalid(f"{place}.{min(unknown)}", f"is unknown; supported: {', '.join(sorted(known.__annotations__))}")


def values(given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by the names that the server has: a word of Python's own cannot be a keyword."""
    return {name.removesuffix("_"): value for name, value in given.items() if value is not None}
