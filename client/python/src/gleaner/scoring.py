"""Scores of data that is not stored: a recording, or the steps of a running episode."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gleaner._conversation import Conversation
from gleaner._proto.v1 import score_pb2 as pb
from gleaner._proto.v1.episode_pb2 import RecordingSummary
from gleaner._retry import patiently
from gleaner._rpc import Rpc
from gleaner._summary import summarize
from gleaner._upload import name_to_send, regular
from gleaner.errors import ServerError
from gleaner.observation import Observation, size, to_wire, vector
from gleaner.scores import EpisodeScores, Scores, from_wire
from gleaner.tasks import Tasks
from gleaner.types import Report, TaskSpec

# Half of the server's message limit.
_PIECE = 1 << 20
# Steps in flight while the first of them is unanswered.
_AHEAD = 16
_PATIENCE_S = 60.0

# A step's observation and action.
Step = tuple[Observation | Mapping[str, Any], ArrayLike]


@dataclass(frozen=True)
class LiveScore:
    """The score of one segment."""

    stamp_ns: int  # of the segment's last observation
    w: float  # the highest similarity to an expert segment
    q: float  # quality in [0, 1]
    match_episode: str
    match_step: int

    @classmethod
    def of(cls, score: Any) -> LiveScore:
        """From the message."""
        stamp_ns = score.observation_stamp_ns
        return cls(stamp_ns, score.w, score.q, score.match_episode_id, score.match_step)


@dataclass(frozen=True)
class StepScores:
    """Scores of an episode's steps; every array has one entry per step: the segment that ends there."""

    stamp_ns: NDArray[np.int64]
    w: NDArray[np.float64]
    q: NDArray[np.float64]
    match_episode: NDArray[np.str_]
    match_step: NDArray[np.uint32]


class ScoredRecording(NamedTuple):
    """A recording's scores, and the report of its inspection."""

    scores: EpisodeScores
    report: Report


class Scoring:
    """Behind `client.score_recording`, `client.score_steps` and `client.stream_scores`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc
        self._scores, self._tasks = Scores(rpc), Tasks(rpc)

    def recording(self, run: str, path: Path, progress: Callable[[int], object]) -> ScoredRecording:
        """A whole recording's scores. Retried from the beginning while there is no connection."""
        size_bytes, summary = os.path.getsize(regular(path)), summarize(path)

        def send() -> pb.ScoreRecordingResponse:
            # Each attempt opens the file: the thread of one whose connection broke may still read from its own.
            requests = self._pieces(run, path, (size_bytes, summary), progress)
            return self._rpc.upload("ScoreService/ScoreRecording", requests, pb.ScoreRecordingResponse)

        reply = patiently(send)
        return ScoredRecording(from_wire(reply.scores), reply.report)

    def steps(self, run: str, steps: Iterable[Step]) -> StepScores:
        """All steps' scores, once all have arrived."""
        scores = [*self._converse(run, steps, _AHEAD)]
        return StepScores(
            stamp_ns=np.array([score.stamp_ns for score in scores], np.int64),
            w=np.array([score.w for score in scores], np.float64),
            q=np.array([score.q for score in scores], np.float64),
            match_episode=np.array([score.match_episode for score in scores], np.str_),
            match_step=np.array([score.match_step for score in scores], np.uint32),
        )

    def stream(self, run: str, steps: Iterable[Step]) -> Iterator[LiveScore]:
        """Each step's score before the next step is taken."""
        return self._converse(run, steps, 1)

    @staticmethod
    def _pieces(
        run: str, path: Path, declared: tuple[int, RecordingSummary | None], progress: Callable[[int], object]
    ) -> Iterator[pb.ScoreRecordingRequest]:
        size_bytes, summary = declared
        name = name_to_send(path)
        yield pb.ScoreRecordingRequest(
            open=pb.ScoreRecordingOpen(score_run_id=run, file_name=name, size_bytes=size_bytes, summary=summary)
        )
        sent = 0
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                yield pb.ScoreRecordingRequest(data=piece)
                sent += len(piece)
                progress(sent)

    def _converse(self, run: str, steps: Iterable[Step], ahead: int) -> Iterator[LiveScore]:
        spec = self._tasks.get(self._scores.get(run).task_id).spec
        stream: Conversation[pb.ScoreStepsRequest, pb.ScoreStepsResponse] = Conversation(
            self._rpc,
            "ScoreService/ScoreSteps",
            pb.ScoreStepsResponse,
            _PATIENCE_S,
            lambda response: response.HasField("draining"),
        )
        waiting: deque[int] = deque()
        try:
            stream.send(pb.ScoreStepsRequest(open=pb.ScoreStepsOpen(score_run_id=run)))
            for place, step in enumerate(steps):
                message = _step(step, spec, place)
                stream.send(pb.ScoreStepsRequest(step=message))
                waiting.append(message.observation.stamp_ns)
                if len(waiting) == ahead:
                    yield _answer(stream.receive(), waiting.popleft())
            stream.no_more()
            while waiting:
                yield _answer(stream.receive(), waiting.popleft())
        finally:
            stream.end()


def _step(step: Step, spec: TaskSpec, place: int) -> pb.ScoreStep:
    observation, action = Observation.of(step[0]), vector("action", step[1], size(spec.action))
    stamp_ns = observation.stamp_ns
    if stamp_ns is None:
        stamp_ns = round(place * 1e9 / spec.rate_hz)
    message = to_wire(observation, spec, stamp_ns)
    # The action of this step.
    message.ClearField("executed_action")
    return pb.ScoreStep(observation=message, action=action)


def _answer(response: pb.ScoreStepsResponse, stamp_ns: int) -> LiveScore:
    score = LiveScore.of(response.score)
    if score.stamp_ns != stamp_ns:
        raise ServerError(f"the server scored the step of {score.stamp_ns} ns, expected {stamp_ns} ns")
    return score
