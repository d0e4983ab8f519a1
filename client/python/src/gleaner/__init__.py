"""Client of the gleaner server: failed demonstrations in, their good steps out, policies to robots and simulators."""

from gleaner._client import Client, connect
from gleaner.datasets import Segment
from gleaner.errors import (
    AlreadyExists,
    Cancelled,
    Damaged,
    DeadlineExceeded,
    FailedPrecondition,
    GleanerError,
    HandshakeFailed,
    InvalidArgument,
    JobFailed,
    Missed,
    NotFound,
    Rejected,
    ResourceExhausted,
    ServerError,
    Unauthorized,
    Unavailable,
)
from gleaner.evaluation import Adapter, Trial, Trials, evaluate
from gleaner.jobs import Curve, JobEvent, Pipeline
from gleaner.observation import Observation
from gleaner.policy import Chunk, Policy
from gleaner.scores import EpisodeScores, Histogram
from gleaner.scoring import LiveScore, ScoredRecording, StepScores
from gleaner.statistics import wilson
from gleaner.types import word
from gleaner.vector import VectorPolicy
from gleaner.vector_evaluation import evaluate_vector

__all__ = [
    "Adapter",
    "AlreadyExists",
    "Cancelled",
    "Chunk",
    "Client",
    "Curve",
    "Damaged",
    "DeadlineExceeded",
    "EpisodeScores",
    "FailedPrecondition",
    "GleanerError",
    "HandshakeFailed",
    "Histogram",
    "InvalidArgument",
    "JobEvent",
    "JobFailed",
    "LiveScore",
    "Missed",
    "NotFound",
    "Observation",
    "Pipeline",
    "Policy",
    "Rejected",
    "ResourceExhausted",
    "ScoredRecording",
    "Segment",
    "ServerError",
    "StepScores",
    "Trial",
    "Trials",
    "Unauthorized",
    "Unavailable",
    "VectorPolicy",
    "connect",
    "evaluate",
    "evaluate_vector",
    "wilson",
    "word",
]
