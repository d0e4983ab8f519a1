"""The server's messages, as generated from its .proto files. `word` returns the word of an enum value."""

from gleaner._messages import word
from gleaner._proto.v1.dataset_pb2 import Dataset, ExportFile
from gleaner._proto.v1.episode_pb2 import Episode, Finding, InspectionEstimate, Label, Report
from gleaner._proto.v1.job_pb2 import Job, JobSpec, Metric, PipelineSpec
from gleaner._proto.v1.job_pb2 import ListKindsResponse as Kinds
from gleaner._proto.v1.policy_pb2 import Deployment, Evaluation, SeedResult, Timings
from gleaner._proto.v1.policy_pb2 import Policy as PolicyRecord
from gleaner._proto.v1.schedule_pb2 import Schedule
from gleaner._proto.v1.score_pb2 import KeptBySelection, ScoreRun
from gleaner._proto.v1.snapshot_pb2 import Snapshot, SnapshotEpisode
from gleaner._proto.v1.task_pb2 import CameraSpec, FieldSpec, Task, TaskSpec

__all__ = [
    "CameraSpec",
    "Dataset",
    "Deployment",
    "Episode",
    "Evaluation",
    "ExportFile",
    "FieldSpec",
    "Finding",
    "InspectionEstimate",
    "Job",
    "JobSpec",
    "KeptBySelection",
    "Kinds",
    "Label",
    "Metric",
    "PipelineSpec",
    "PolicyRecord",
    "Report",
    "Schedule",
    "ScoreRun",
    "SeedResult",
    "Snapshot",
    "SnapshotEpisode",
    "Task",
    "TaskSpec",
    "Timings",
    "word",
]
