"""The client: one connection, with an attribute per service."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType

from gleaner._endpoint import Endpoint
from gleaner._rpc import Rpc
from gleaner.datasets import Datasets
from gleaner.episodes import Episodes
from gleaner.jobs import Jobs
from gleaner.policies import Policies
from gleaner.schedules import Schedules
from gleaner.scores import Scores
from gleaner.scoring import LiveScore, ScoredRecording, Scoring, Step, StepScores
from gleaner.snapshots import Snapshots
from gleaner.tasks import Tasks
from gleaner.types import Deployment


class Client:
    """A connection to a gleaner server; made by `connect`. Threads may share it. A context manager."""

    def __init__(self, endpoint: Endpoint) -> None:
        if not isinstance(endpoint, Endpoint):
            raise TypeError("gleaner.Client: use gleaner.connect(address)")
        self._rpc = Rpc(endpoint)
        self.tasks = Tasks(self._rpc)
        self.episodes = Episodes(self._rpc)
        self.snapshots = Snapshots(self._rpc)
        self.jobs = Jobs(self._rpc)
        self.schedules = Schedules(self._rpc)
        self.scores = Scores(self._rpc)
        self.datasets = Datasets(self._rpc)
        self.policies = Policies(self._rpc)
        self._scoring = Scoring(self._rpc)

    def score_recording(
        self, run: str, path: str | os.PathLike[str], *, progress: Callable[[int], object] = lambda sent: None
    ) -> ScoredRecording:
        """Scores a recording (MCAP) as a score run scores its own, without storing it on the server.

        Raises `InvalidArgument` when it does not fit the task, `FailedPrecondition` when the run is not finished or
        scores only what is stored (those of ssdf score anything).
        """
        return self._scoring.recording(run, Path(path), progress)

    def score_steps(self, run: str, steps: Iterable[Step]) -> StepScores:
        """Scores an episode's steps, pairs of observation and action, without a recording; as arrays."""
        return self._scoring.steps(run, steps)

    def stream_scores(self, run: str, steps: Iterable[Step]) -> Iterator[LiveScore]:
        """As `score_steps`, for a running episode: yields each step's score before it takes the next step."""
        return self._scoring.stream(run, steps)

    def deploy(self, name: str, policy_id: str, *, score_run: str = "", hide_history: bool = False) -> Deployment:
        """Points a deployment's name at a policy; running sessions keep theirs.

        With a score run each answer carries the score of the session's newest segment. With `hide_history` the policy
        acts on the newest step alone, or without its past actions if it was trained with hidden_history "actions"; it
        must have been trained with history_dropout above 0.
        """
        return self.policies.deploy(name, policy_id, score_run=score_run, hide_history=hide_history)

    def rollback(self, name: str) -> Deployment:
        """Points a deployment's name back at its previous policy."""
        return self.policies.rollback(name)

    def undeploy(self, name: str) -> None:
        """Deletes a deployment with its history; running sessions keep their policy until they end."""
        self.policies.undeploy(name)

    def deployments(self, task: str = "") -> list[Deployment]:
        """Deployments with their history, of one task or of all."""
        return self.policies.deployments(task)

    def close(self) -> None:
        """Ends the connection and every session on it."""
        self._rpc.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def connect(
    address: str = "127.0.0.1:7400",
    token: str | None = None,
    timeout: float = 30.0,
    *,
    ca: str | os.PathLike[str] | None = None,
    cert: str | os.PathLike[str] | None = None,
    key: str | os.PathLike[str] | None = None,
) -> Client:
    """Connects to a server, for example at `127.0.0.1:7400`, `http://lab:7400` or, encrypted, `https://lab:7400`.

    `timeout` bounds the connecting and each single call, in seconds. Reads, and other calls that may be made
    twice, are made again for about 13 s while there is no connection; others are not.

    `ca` is a file of certificates (PEM), one of which must have signed the server's (`ca.pem` of `gleaner-server tls
    init`); without it public authorities are trusted. `cert` and `key` are files of one's own certificate and its
    private key, if the server asks for one.

    Raises `Unavailable` when no server answers, `HandshakeFailed` within seconds when one side does not trust the other
    or only one encrypts, `InvalidArgument` when the address, the token or a file cannot be used.
    """
    return Client(Endpoint(address, token, timeout, ca, cert, key))
