"""A deployed policy as a callable: observation in, action out. One episode is one session of the server."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gleaner._client import Client
from gleaner._messages import number
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._retry import patiently
from gleaner._session import Session
from gleaner.errors import GleanerError, Missed, NotFound, Rejected, invalid
from gleaner.observation import Observation, size, to_wire
from gleaner.scoring import LiveScore
from gleaner.types import TaskSpec, Timings

# The most of a rate or a time; longer deadlines than about an hour do not fit the message.
_MOST = 3600.0
# The part by which a rate may differ from the task's.
_OTHER_RATE = 0.1


@dataclass(frozen=True)
class Chunk:
    """The actions that answer one observation, one per control period from its stamp on."""

    stamp_ns: int
    actions: NDArray[np.float32]  # k × values
    timings: Timings  # durations of the stages in the server
    dropped: int  # observations dropped since the previous reply
    score: LiveScore | None = None  # of the newest segment scored, where the deployment names a score run


class Policy:
    """A deployment to act with. A context manager; for one thread.

    `rate_hz` is the control rate (None: the task's; another one is accepted with a warning), `deadline` how many
    seconds after its arrival at the server an observation may be answered (None: no deadline), `timeout` how long to
    wait for any answer.

    With `record` the server keeps each episode as a recording of the task, under `cohort` (empty: the deployment's
    name) and the outcome given to `close` or `reset`; an episode that ends otherwise is kept as unknown.

    `seed` is of the numbers that a policy such as flow draws its actions from; each later episode has the next seed.

    The session opens with the first call, retried while there is no connection. A call whose session is lost raises,
    because the history of its episode is lost too; the next call begins another episode.
    """

    def __init__(
        self,
        client: Client,
        deployment: str,
        *,
        rate_hz: float | None = None,
        deadline: float | None = None,
        timeout: float = 60.0,
        record: bool = False,
        cohort: str = "",
        seed: int = 0,
    ) -> None:
        for name, value in (("rate_hz", rate_hz), ("deadline", deadline), ("timeout", timeout)):
            if value is not None and not 0 < value <= _MOST:
                raise invalid(name, f"{value:g}: must be above 0 and at most {_MOST:g}")
        if not 0 <= seed < 2**64:
            raise invalid("seed", f"{seed}: must be from 0 to 2**64 - 1")
        self._client = client
        self.deployment = deployment
        self.spec = _spec(client, deployment)
        self.rate_hz = rate_hz if rate_hz is not None else self.spec.rate_hz
        if other_rate(self.rate_hz, self.spec):
            slower = "slower" if self.rate_hz < self.spec.rate_hz else "faster"
            warnings.warn(
                f"rate_hz {self.rate_hz:g}: the steps of the task are at {self.spec.rate_hz:g} Hz, so the robot moves "
                f"{slower} than its demonstrations",
                stacklevel=2,
            )
        self._open = pb.SessionOpen(
            deployment=deployment,
            control_rate_hz=rate_hz or 0.0,
            deadline_us=math.ceil((deadline or 0.0) * 1e6),
            record=record,
            cohort=cohort,
            seed=seed,
        )
        self._timeout = timeout
        self._session: Session | None = None
        self.policy_id = ""
        self.last: Chunk | None = None
        self.dropped = 0
        self.missed = 0
        self._given: NDArray[np.float32] | None = None
        self._stamp_ns: int | None = None

    def __call__(self, observation: Observation | Mapping[str, Any]) -> NDArray[np.float32]:
        """The action for this step.

        When the server misses the deadline, the newest chunk that covers this step is used in its place; without
        one `Missed` is raised, and the robot should hold.
        """
        self._observe(observation)
        return self._action()

    def chunk(self, observation: Observation | Mapping[str, Any]) -> Chunk:
        """All the actions for an observation, from this step on. Raises `Missed` without an answer by the deadline."""
        self._observe(observation)
        return self._answer()

    def _action(self) -> NDArray[np.float32]:
        # The action for the observation that was sent last.
        try:
            action: NDArray[np.float32] = self._answer().actions[0]
        except Missed:
            late = self._late()
            if late is None:
                raise
            action = late
        self._given = action.copy()
        return action.copy()

    def _observe(self, observation: Observation | Mapping[str, Any]) -> None:
        # Sends without waiting.
        observation = Observation.of(observation)
        stamp_ns = self._stamp(observation)
        message = to_wire(observation, self.spec, stamp_ns)
        if not message.executed_action and self._given is not None:
            message.executed_action.extend(self._given)
        session = self._session or self._connect()
        self._stamp_ns, self._given = stamp_ns, None
        session.observe(message)

    def _answer(self) -> Chunk:
        # The answer to the observation that was sent last.
        session, stamp_ns = self._session, self._stamp_ns
        if session is None or stamp_ns is None:
            raise invalid("observation", "none was sent")
        try:
            answer = session.answer(stamp_ns)
        except Rejected:
            self._abandon()
            raise
        self.dropped += answer.dropped
        if isinstance(answer, pb.SessionMissed):
            self.missed += 1
            reason = answer.reason or "no action by the deadline"
            raise Missed(f"deployment {self.deployment}: {reason}")
        actions = np.array([step.values for step in answer.actions], np.float32)
        score = LiveScore.of(answer.score) if answer.HasField("score") else None
        self.last = Chunk(stamp_ns, actions.reshape(-1, size(self.spec.action)), answer.timings, answer.dropped, score)
        return self.last

    def reset(self, outcome: str = "unknown") -> str:
        """Ends the episode; the next call starts another, with the policy deployed then.

        Returns the id of the recorded episode; empty without `record`, or with fewer than two steps.
        `outcome` is its label: success, failure or unknown. Raises when the server could not store it.
        """
        wire = number(pb.SessionClose, "outcome", outcome)
        session, self._session = self._session, None
        self._begin()
        if session is None:
            return ""
        try:
            return session.close(wire).episode_id
        except GleanerError:
            # The episode is over either way; without a recording only the close failed.
            if self._open.record:
                raise
            return ""

    @property
    def score(self) -> LiveScore | None:
        """The newest score of this episode: a falling q shows that it departs from the experts."""
        return self.last.score if self.last is not None else None

    @property
    def draining(self) -> bool:
        """Whether the server is stopping: it will close the session; finish or `reset()` soon."""
        return self._session is not None and self._session.draining

    def close(self, outcome: str = "unknown") -> str:
        """Ends the episode, as `reset` does."""
        return self.reset(outcome)

    def __enter__(self) -> Policy:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            # The first error matters more; the recording is kept with an unknown outcome.
            self._abandon()

    def _begin(self) -> None:
        # The state of one episode; policy_id stays until the next session opens.
        self.last, self._given, self._stamp_ns = None, None, None
        self.dropped, self.missed = 0, 0

    def _connect(self) -> Session:
        self._session = patiently(lambda: Session(self._client._rpc, self._open, self._timeout))
        self._open.seed = (self._open.seed + 1) % 2**64
        self.policy_id = self._session.opened.policy_id
        return self._session

    def _abandon(self) -> None:
        if self._session is not None:
            self._session.abandon()
            self._session = None
        self._begin()

    def _stamp(self, observation: Observation) -> int:
        if observation.stamp_ns is not None:
            return observation.stamp_ns
        if self._stamp_ns is not None:
            return self._stamp_ns + self._period_ns * (1 + observation.skipped_steps)
        # A recording needs real time stamps.
        return time.time_ns() if self._open.record else 0

    def _late(self) -> NDArray[np.float32] | None:
        if self.last is None or self._stamp_ns is None:
            return None
        place = round((self._stamp_ns - self.last.stamp_ns) / self._period_ns)
        return self.last.actions[place] if 0 <= place < len(self.last.actions) else None

    @property
    def _period_ns(self) -> int:
        return round(1e9 / self.rate_hz)


def other_rate(rate_hz: float, spec: TaskSpec) -> bool:
    """Whether a control rate is not the task's."""
    return abs(rate_hz / spec.rate_hz - 1) > _OTHER_RATE


def _spec(client: Client, deployment: str) -> TaskSpec:
    names = {known.name: known.task_id for known in client.deployments()}
    if deployment not in names:
        raise NotFound(f"no deployment {deployment}; existing: {', '.join(names) or 'none'}")
    return client.tasks.get(names[deployment]).spec
