"""Jobs: queued units of work, and how to follow them."""

from __future__ import annotations

import time
import uuid
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gleaner import settings
from gleaner._messages import build, number
from gleaner._pipeline import pipeline_spec
from gleaner._proto.v1 import job_pb2 as pb
from gleaner._retry import Patience
from gleaner._rpc import Rpc
from gleaner.errors import DeadlineExceeded, JobFailed, Unavailable
from gleaner.types import Job, JobSpec, Kinds, Metric

if TYPE_CHECKING:
    from typing_extensions import Unpack

_PAGE = 500
_ENDED = (pb.JOB_STATE_SUCCEEDED, pb.JOB_STATE_FAILED, pb.JOB_STATE_CANCELLED)


class JobEvent(NamedTuple):
    """The current job and its new metrics."""

    job: Job
    metrics: list[Metric]


class Curve(NamedTuple):
    """One metric over a job's steps."""

    steps: NDArray[np.int64]
    values: NDArray[np.float64]


class Pipeline(NamedTuple):
    """The jobs of a pipeline in their order, and the dataset that it makes."""

    jobs: list[Job]
    dataset_id: str  # empty if the pipeline ends before it


class Jobs:
    """`client.jobs`. A job is named by its id or by the `Job` itself.

    A job's `result_id` is set from the start, so that a later job can name the result of an earlier one.
    """

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc

    def submit(self, task: str, spec: JobSpec | Mapping[str, Any], **order: Unpack[settings.Order]) -> Job:
        """Queues a job from its whole spec, for example `{"export": {"dataset_id": …, "format": "mcap"}}`.

        The same `key` never queues twice: without one the call has a key of its own, with which it is retried over a
        broken connection.
        """
        if not isinstance(spec, JobSpec):
            spec = build(JobSpec, spec)
        request = pb.SubmitJobRequest(task=task, spec=spec, **order)
        request.key = request.key or _own_key()
        return self._rpc.safe("JobService/SubmitJob", request, pb.SubmitJobResponse).job

    def pretrain(self, task: str, **given: Unpack[settings.PretrainSettings]) -> Job:
        """Queues the pretraining of an encoder over experts and imperfect episodes."""
        return self._submit("pretrain", task, dict(given), settings.PretrainSettings)

    def score(self, task: str, encoder_id: str = "", **given: Unpack[settings.ScoreSettings]) -> Job:
        """Queues the scoring of every imperfect segment.

        Without `encoder_id` the server takes the newest encoder of the task. A scorer that reads none, as by default,
        needs no pretraining.
        """
        return self._submit("score", task, {"encoder_id": encoder_id, **given}, settings.ScoreSettings)

    def train(self, task: str, **given: Unpack[settings.TrainSettings]) -> Job:
        """Queues the training of a policy."""
        return self._submit("train", task, dict(given), settings.TrainSettings)

    def evaluate(self, task: str, **given: Unpack[settings.EvaluateSettings]) -> Job:
        """Queues closed-loop trials of a policy in the server's own simulator."""
        return self._submit("evaluate", task, dict(given), settings.EvaluateSettings)

    def pipeline(
        self,
        task: str,
        *,
        key: str = "",
        priority: int = 0,
        engine_options: str = "",
        **stages: Unpack[settings.PipelineStages],
    ) -> Pipeline:
        """Queues a chain of jobs up to the last stage that is given: pretrain, score, a dataset, train, evaluate.

        The dataset leaves out cohorts that the scores rank above experts, unless `shape` has `min_expert_auroc` 0. For
        example `pipeline(task, pretrain={"steps": 1}, top_fraction=0.1, train={"steps": 2000}, evaluate={})`. Each
        stage has its own settings; the pipeline sets what it works on. A chain with the same `key` none of whose jobs
        failed or was cancelled is returned instead of a new one: without a key the call has one of its own, with which
        it is retried over a broken connection.

        Raises `InvalidArgument` naming the field, such as a stage whose earlier stage is missing.
        """
        request = pb.SubmitPipelineRequest(
            task=task,
            pipeline=pipeline_spec(stages),
            priority=priority,
            engine_options=engine_options,
            key=key or _own_key(),
        )
        reply = self._rpc.safe("JobService/SubmitPipeline", request, pb.SubmitPipelineResponse)
        return Pipeline([*reply.jobs], reply.dataset_id)

    def kinds(self) -> Kinds:
        """The kinds of jobs, policies, weightings, objectives and scorers, each with its settings."""
        return self._rpc.safe("JobService/ListKinds", pb.ListKindsRequest(), pb.ListKindsResponse)

    def get(self, job: str | Job) -> Job:
        """Returns a job. Raises `NotFound`."""
        return self._get(job).job

    def log(self, job: str | Job) -> str:
        """The end of the output of a job's workers, about 16 KiB at most. Raises `NotFound`."""
        return self._get(job).log

    def watch(self, job: str | Job, timeout: float | None = None) -> Iterator[JobEvent]:
        """The current job, then each change and new metric, until the job ends.

        A broken connection is reopened, after which metrics may repeat. Raises `DeadlineExceeded` when the job has
        not ended after `timeout` seconds; the job continues.
        """
        end = None if timeout is None else time.monotonic() + timeout
        patience = Patience()
        request = pb.WatchJobRequest(job_id=_id(job))
        while True:
            error = Unavailable("the server ended the stream before the job ended")
            left = None if end is None else max(0.0, end - time.monotonic())
            try:
                for event in self._rpc.stream("JobService/WatchJob", request, pb.WatchJobResponse, left):
                    patience.restore()
                    yield JobEvent(event.job, [*event.metrics])
                    if event.job.state in _ENDED:
                        return
            except Unavailable as broken:
                error = broken
            except DeadlineExceeded:
                if timeout is None:
                    # A limit of the server, or of something between.
                    raise
                raise DeadlineExceeded(f"job {_id(job)} has not ended after {timeout:g} s; it continues") from None
            patience.wait(error)

    def wait(self, job: str | Job | Pipeline, timeout: float | None = None) -> Job:
        """Waits until a job, or each of a pipeline, has ended, and returns it, or the last.

        Raises `JobFailed` unless it succeeded, for a pipeline with the first job that did not; `DeadlineExceeded` as
        `watch` does.
        """
        if isinstance(job, Pipeline):
            end = None if timeout is None else time.monotonic() + timeout
            for one in job.jobs:
                last = self.wait(one, None if end is None else max(0.0, end - time.monotonic()))
            return last
        for event in self.watch(job, timeout):
            ended = event.job
        if ended.state != pb.JOB_STATE_SUCCEEDED:
            why = f" failed: {ended.error}" if ended.state == pb.JOB_STATE_FAILED else " was cancelled"
            raise JobFailed(f"job {ended.id}{why}", ended)
        return ended

    def cancel(self, job: str | Job) -> Job:
        """Cancels a job that has not ended, and the jobs that wait for it."""
        request = pb.CancelJobRequest(job_id=_id(job))
        return self._rpc.unary("JobService/CancelJob", request, pb.CancelJobResponse).job

    def metrics(self, job: str | Job) -> dict[str, Curve]:
        """The metrics that a job has reported, by name; of very many, some with every peak."""
        request = pb.ListMetricsRequest(job_id=_id(job))
        metrics = self._rpc.safe("JobService/ListMetrics", request, pb.ListMetricsResponse).metrics
        rows: dict[str, list[tuple[int, float]]] = {}
        for metric in metrics:
            rows.setdefault(metric.name, []).append((metric.step, metric.value))
        return {
            name: Curve(np.array([step for step, _ in row], np.int64), np.array([value for _, value in row]))
            for name, row in rows.items()
        }

    def list(self, task: str = "", *, state: str | None = None) -> Iterator[Job]:
        """Jobs, newest first, of one task or of all; `state` is for example queued. Fetched lazily."""
        request = pb.ListJobsRequest(task=task, page_size=_PAGE)
        if state is not None:
            request.state = number(pb.ListJobsRequest, "state", state)
        while True:
            reply = self._rpc.safe("JobService/ListJobs", request, pb.ListJobsResponse)
            yield from reply.jobs
            if not reply.next_page_token:
                return
            request.page_token = reply.next_page_token

    def _get(self, job: str | Job) -> pb.GetJobResponse:
        return self._rpc.safe("JobService/GetJob", pb.GetJobRequest(job_id=_id(job)), pb.GetJobResponse)

    def _submit(self, kind: str, task: str, given: dict[str, Any], known: type) -> Job:
        settings.expect_known(kind, given.keys() - {"encoder_id"}, known)
        order = {name: given.pop(name) for name in settings.Order.__annotations__ if name in given}
        inputs: Any = JobSpec.DESCRIPTOR.fields_by_name[kind].message_type
        spec = {name: given.pop(name) for name in [*given] if name in inputs.fields_by_name}
        return self.submit(task, {kind: {**spec, "settings": settings.values(given)}}, **order)


def _own_key() -> str:
    """The key of a call that names none."""
    return f"python/{uuid.uuid4()}"


def _id(job: str | Job) -> str:
    return job if isinstance(job, str) else job.id
