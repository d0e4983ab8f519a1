"""Scores: the quality of every imperfect segment, as numpy arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gleaner._messages import build, word
from gleaner._pages import PAGE, pages
from gleaner._proto.v1 import score_pb2 as pb
from gleaner._proto.v1.selection_pb2 import Selection
from gleaner._retry import patiently
from gleaner._rpc import Rpc
from gleaner._score_table import Table, batches, by_episode
from gleaner.episodes import Episodes
from gleaner.errors import NotFound
from gleaner.snapshots import Snapshots
from gleaner.types import KeptBySelection, ScoreRun


@dataclass(frozen=True)
class EpisodeScores:
    """One episode's scores. Every array has one entry per step: the segment that ends there."""

    episode_id: str  # empty when it is not stored
    role: str  # expert or imperfect; experts' scores leave their own episode out; unspecified when it is not stored
    q: NDArray[np.float32]  # quality in [0, 1]
    # The highest similarity to an expert segment; log p of classifier, information of deminf, gain of progress, share
    # of vote, imported q.
    w: NDArray[np.float64]
    # The expert episode matched; empty for classifier, deminf, progress, vote and imports, as are the rest.
    match_episode: NDArray[np.str_]
    match_step: NDArray[np.uint32]
    distance_o: NDArray[np.float32]  # of the images' features
    distance_m: NDArray[np.float32]  # of the proprioception's
    distance_a: NDArray[np.float32]  # of the action's


@dataclass(frozen=True)
class Histogram:
    """The distribution of q over a run's imperfect segments, and over those of its experts and of each cohort."""

    counts: NDArray[np.uint64]
    experts: NDArray[np.uint64]  # as counts; of an imported run without experts all 0
    cohorts: dict[str, NDArray[np.uint64]]  # as counts, of each cohort of imperfect episodes
    edges: NDArray[np.float64]  # one more than counts, from 0 to 1
    segments: int
    kept: dict[float, int]  # segments with q > β, for each requested β
    expert_auroc: float | None  # how often an expert's segment has the higher q, ties counted half; None: no experts


_EPISODE_ID = re.compile("ep_[0-9A-HJKMNP-TV-Z]{26}")


class Scores:
    """`client.scores`."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc
        self._snapshots, self._episodes = Snapshots(rpc), Episodes(rpc)

    def get(self, run: str) -> ScoreRun:
        """Returns a score run. Raises `FailedPrecondition` while its job has not succeeded."""
        request = pb.GetScoreRunRequest(score_run_id=run)
        return self._rpc.safe("ScoreService/GetScoreRun", request, pb.GetScoreRunResponse).score_run

    def histogram(self, run: str, bins: int = 20, betas: Sequence[float] = ()) -> Histogram:
        """The histogram of q, and the counts of each threshold."""
        request = pb.GetHistogramRequest(score_run_id=run, bins=bins, betas=betas)
        reply = self._rpc.safe("ScoreService/GetHistogram", request, pb.GetHistogramResponse)
        return Histogram(
            counts=np.array(reply.counts, np.uint64),
            experts=np.array(reply.expert_counts, np.uint64),
            cohorts={of.cohort: np.array(of.counts, np.uint64) for of in reply.cohort_counts},
            edges=np.linspace(0.0, 1.0, len(reply.counts) + 1),
            segments=reply.segments,
            kept={count.beta: count.segments for count in reply.kept},
            expert_auroc=reply.expert_auroc if reply.HasField("expert_auroc") else None,
        )

    def what_if(
        self, run: str, selections: Sequence[Mapping[str, Any]], *, per_episode: bool = False
    ) -> list[KeptBySelection]:
        """The counts of datasets, per cohort, without creating them.

        Selections are like `{"beta": 0.5}` or `{"top_fraction": 0.1, "shape": {"min_run": 5}}`.
        """
        wanted = [build(Selection, selection) for selection in selections]
        request = pb.CountKeptRequest(score_run_id=run, selections=wanted, per_episode=per_episode)
        return [*self._rpc.safe("ScoreService/CountKept", request, pb.CountKeptResponse).counts]

    def episode(self, run: str, episode: str) -> EpisodeScores:
        """One episode's scores. Raises `NotFound` when the run has no such episode."""
        request = pb.GetEpisodeScoresRequest(score_run_id=run, episode_id=episode)
        return from_wire(self._rpc.safe("ScoreService/GetEpisodeScores", request, pb.GetEpisodeScoresResponse).scores)

    def all(self, run: str, role: str | None = None) -> Iterator[EpisodeScores]:
        """Every episode's scores, or those of one role (expert, imperfect), fetched lazily.

        Experts without scores, such as the only expert of a snapshot or those that an import lacks, are left out.
        """
        for episode in self._snapshots.episodes(self.get(run).snapshot_id):
            of = word(episode, "role")
            if role not in (None, of):
                continue
            try:
                scores = self.episode(run, episode.episode_id)
            except NotFound:
                if of == "expert":
                    continue
                raise
            yield scores

    def import_scores(self, snapshot: str, table: Table, *, source: str = "", encoder: str = "") -> ScoreRun:
        """Stores scores made elsewhere as a score run of a snapshot; the same scores return the same run.

        `table` has the columns episode (an id, or the file name or BLAKE3 digest of a recording), step (counted from 0)
        and q (0 to 1): a dict of lists or arrays, a pandas DataFrame or a pyarrow Table, for every step of every
        imperfect episode; experts are optional. `source` names what made the scores. Policies that need an encoder,
        trained on a dataset of the run, start from `encoder`. Raises `ValueError` for a table that is not complete.
        """
        scores = self._with_ids(snapshot, by_episode(table))
        start = pb.ImportScoresOpen(snapshot_id=snapshot, source=source, encoder_id=encoder)

        def requests() -> Iterator[pb.ImportScoresRequest]:
            yield pb.ImportScoresRequest(open=start)
            for group in batches(scores):
                episodes = [pb.ImportedEpisode(episode_id=episode, q=q) for episode, q in group.items()]
                yield pb.ImportScoresRequest(batch=pb.ImportedEpisodes(episodes=episodes))

        send = self._rpc.upload
        return patiently(lambda: send("ScoreService/ImportScores", requests(), pb.ImportScoresResponse)).score_run

    def _with_ids(self, snapshot: str, scores: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
        """The scores by the ids of their episodes, which a table may name otherwise."""
        if all(_EPISODE_ID.fullmatch(name) for name in scores):
            return scores
        members = {episode.episode_id for episode in self._snapshots.episodes(snapshot)}
        task = self._snapshots.get(snapshot).task_id
        ids: dict[str, set[str]] = {}
        for deleted in (False, True):  # an episode of a snapshot may be in the trash
            for episode in self._episodes.list(task, deleted=deleted):
                if episode.id in members:
                    for name in (episode.id, episode.file_name, episode.blake3):
                        ids.setdefault(name, set()).add(episode.id)
        found: dict[str, NDArray[np.float64]] = {}
        for name, q in scores.items():
            match sorted(ids.get(name, ())):
                case [only] if only not in found:
                    found[only] = q
                case [only]:
                    raise ValueError(f"{name}: is {only}, which the table has under another name too; use one name")
                case []:
                    raise ValueError(f"{name}: no episode of {snapshot} has this id, file name or digest")
                case _:
                    raise ValueError(f"{name}: several episodes of {snapshot} have this name; use their ids or digests")
        return found

    def list(self, task: str) -> list[ScoreRun]:
        """A task's finished score runs, newest first."""
        request = pb.ListScoreRunsRequest(task=task, page_size=PAGE)
        found = pages(self._rpc, "ScoreService/ListScoreRuns", request, pb.ListScoreRunsResponse)
        return [run for page in found for run in page.score_runs]


def from_wire(scores: pb.EpisodeScores) -> EpisodeScores:
    """Scores as arrays."""
    experts = np.array([*scores.expert_ids], np.str_)
    return EpisodeScores(
        episode_id=scores.episode_id,
        role=word(scores, "role"),
        q=np.array(scores.q, np.float32),
        w=np.array(scores.w, np.float64),
        match_episode=experts[np.array(scores.match_episode, np.int64)],
        match_step=np.array(scores.match_step, np.uint32),
        distance_o=np.array(scores.distance_o, np.float32),
        distance_m=np.array(scores.distance_m, np.float32),
        distance_a=np.array(scores.distance_a, np.float32),
    )
