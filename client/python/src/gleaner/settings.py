"""What jobs can be told, as typed keywords. Choices are words: `preset="tiny"`; what is left out takes the default.

The .proto files (job.proto) say what each setting means.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict


class Order(TypedDict, total=False):
    """How a job is queued."""

    key: str  # the caller's own name for this work: submitted twice, the first job is the answer
    priority: int  # higher runs first
    needs: Sequence[str]  # further jobs to wait for
    max_attempts: int


class Optim(TypedDict, total=False):
    """The optimiser (AdamW)."""

    steps: int
    batch: int
    learning_rate: float
    weight_decay: float
    warmup_steps: int
    clip_norm: float


class RoleRule(TypedDict, total=False):
    """Which episodes are experts and which are imperfect. Empty: success and failure."""

    expert_cohorts: Sequence[str]
    imperfect_cohorts: Sequence[str]
    imperfect_per_expert: float
    max_experts: int
    seed: int


class Augmentation(TypedDict, total=False):
    """Random changes to the images of a training batch."""

    shift_pixels: int
    brightness: float
    contrast: float


class Act(TypedDict, total=False):
    """Settings of ACT."""

    chunk_length: int
    kl_weight: float
    latent_size: int


class ModalityScale(TypedDict):
    """Factors of the distances of o, m and a."""

    image: float
    proprioception: float
    action: float


class PretrainSettings(Order, Optim, total=False):
    """Settings of a pretraining job."""

    snapshot_id: str
    rule: RoleRule
    preset: str  # tiny, small, base
    segment_length: int
    seed: int
    device: str  # cpu, cuda
    checkpoint_every: int
    objectives: Sequence[str]  # mtp, tr, aa
    augmentation: Augmentation


class ScoreSettings(Order, total=False):
    """Settings of a scoring job."""

    snapshot_id: str
    device: str
    scorer: str  # ssdf, raw, classifier
    similarity: str  # last_l2, last_cosine, segment_l2, segment_cosine
    normaliser: str  # minmax, quantile
    modality_scale: ModalityScale
    extends: str
    seed: int
    feature_scale: str  # whitened, plain
    yardstick: str  # local, none


class TrainSettings(Order, Optim, total=False):
    """Settings of a training job; exactly one of dataset_id, experts_of and experts_in."""

    dataset_id: str
    experts_of: str
    experts_in: str
    lambda_: float  # weight of the kept segments' loss
    policy: str  # finetune, tf_bc, bc, act
    seed: int
    device: str
    checkpoint_every: int
    act: Act
    augmentation: Augmentation
    preset: str
    segment_length: int
    history_dropout: float


class EvaluateSettings(Order, total=False):
    """Settings of an evaluation in the embedded simulator; exactly one of policy_id and deployment."""

    policy_id: str
    deployment: str
    simulation: str
    episodes: int
    seeds: Sequence[int]
    max_steps: int
    device: str
