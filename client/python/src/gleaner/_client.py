"""The client: one connection, and a room for each concern."""

from __future__ import annotations

from types import TracebackType

from gleaner._rpc import Rpc
from gleaner.datasets import Datasets
from gleaner.episodes import Episodes
from gleaner.jobs import Jobs
from gleaner.policies import Policies
from gleaner.scores import Scores
from gleaner.snapshots import Snapshots
from gleaner.tasks import Tasks
from gleaner.types import Deployment


class Client:
    """A connection to a gleaner server; made by `connect`. Threads may share it. A context manager."""

    def __init__(self, address: str, token: str | None, timeout: float) -> None:
        self._rpc = Rpc(address, token, timeout)
        self.tasks = Tasks(self._rpc)
        self.episodes = Episodes(self._rpc)
        self.snapshots = Snapshots(self._rpc)
        self.jobs = Jobs(self._rpc)
        self.scores = Scores(self._rpc)
        self.datasets = Datasets(self._rpc, (address, token, timeout))
        self.policies = Policies(self._rpc)

    def deploy(self, name: str, policy_id: str) -> Deployment:
        """Points a deployment's name at a policy; running sessions keep the policy they began with."""
        return self.policies.deploy(name, policy_id)

    def rollback(self, name: str) -> Deployment:
        """Points a deployment's name back at what it pointed at before."""
        return self.policies.rollback(name)

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


def connect(address: str = "127.0.0.1:7400", token: str | None = None, timeout: float = 30.0) -> Client:
    """Connects to a server, for example at `127.0.0.1:7400` or `http://lab:7400`.

    `timeout` bounds the connecting and each single call, in seconds. Reads, and other calls that may be made
    twice, are made again for about 13 s while there is no connection; others are not.

    Raises `Unavailable` when nobody answers, `InvalidArgument` when the address or token is none.
    """
    return Client(address, token, timeout)
