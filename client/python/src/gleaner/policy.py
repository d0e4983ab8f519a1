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
from gleaner._executed import Executed
from gleaner._limits import Limits, check
from gleaner._messages import number
from gleaner._opening import open_for_step
from gleaner._proto.v1 import policy_pb2 as pb
from gleaner._retry import patiently
from gleaner._session import Session
from gleaner.errors import GleanerError, Missed, NotFound, Rejected, invalid
from gleaner.observation import Observation, size, to_wire
from gleaner.scoring import LiveScore
from gleaner.types import TaskSpec, Timings

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
    seconds after its arrival at the server an observation may be answered (None: no deadline).

    A deadline is for robots in real time. With one, a call waits for its answer until 0.1 s after the deadline, also
    while the connection is broken, and does not send an observation whose session took longer than two control periods
    to open. A step without an action repeats the last one for `hold` seconds, and then raises `Missed`.

    `timeout` is how many seconds a server that owes an answer may send nothing, `open_timeout` how many it may take to
    load the policy and open a session, and `close_timeout` to inspect and store a recorded episode.

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
        hold: float = 0.0,
        timeout: float = 60.0,
        open_timeout: float = 60.0,
        close_timeout: float = 600.0,
        record: bool = False,
        cohort: str = "",
        seed: int = 0,
    ) -> None:
        if rate_hz is not None:
            check("rate_hz", rate_hz)
        self._limits = Limits(deadline, hold, timeout, open_timeout, close_timeout)
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
        self._session: Session | None = None
        self.policy_id = ""
        self.last: Chunk | None = None
        self.dropped = 0
        self.missed = 0
        self._executed = Executed()
        self._stamp_ns: int | None = None

    def __call__(self, observation: Observation | Mapping[str, Any]) -> NDArray[np.float32]:
        """The action for this step.

        Without an answer by the deadline, the newest chunk that covers this step is used in its place; without one
        the action before is repeated for the time of `hold`, or `Missed` is raised, and the robot should hold.
        """
        self._observe(observation)
        return self._action()

    def chunk(self, observation: Observation | Mapping[str, Any]) -> Chunk:
        """All the actions for an observation, from this step on. Raises `Missed` without an answer by the deadline."""
        self._observe(observation)
        return self._answer()

    def open(self) -> None:
        """Opens the session of the next episode, as the first call would.

        The server ends a session that gets no observation within a minute, by default.
        """
        self._opened()

    def discard_action(self) -> None:
        """Reports that the action returned last was not executed: the robot still executes the one before it.

        Without one before it the episode begins again, because the server takes its first action as executed.
        """
        if self._executed.next is None or self._session is None:
            return
        self._executed.withhold()
        if self._executed.next is None:
            begun, self._session = self._session, None
            self._begin()
            try:
                # Before the other ends, so that the policy stays loaded.
                self.open()
            finally:
                begun.abandon()

    def _action(self) -> NDArray[np.float32]:
        # The action for the observation that was sent last.
        try:
            action: NDArray[np.float32] = self._answer().actions[0]
        except Missed as missed:
            late = self._late()
            if late is None:
                return self._repeated(missed)
            action = late
        self._executed.give(action)
        return action.copy()

    def _repeated(self, missed: Missed) -> NDArray[np.float32]:
        hold = self._limits.hold
        if not hold:
            raise missed
        action = self._executed.repeated(hold)
        if action is None:
            raise Missed(f"{missed}; there is no action of the last {hold:g} s to repeat") from None
        return action

    def _observe(self, observation: Observation | Mapping[str, Any]) -> None:
        # Sends without waiting.
        observation = Observation.of(observation)
        stamp_ns = self._stamp(observation)
        message = to_wire(observation, self.spec, stamp_ns)
        open_for_step([self])
        self._executed.report(message)
        self._stamp_ns = stamp_ns
        self._opened().observe(message)

    def _answer(self) -> Chunk:
        # The answer to the observation that was sent last.
        session, stamp_ns = self._session, self._stamp_ns
        if session is None or stamp_ns is None:
            raise invalid("observation", "none was sent")
        try:
            answer = session.answer(stamp_ns, self._limits.answer_within)
        except Rejected:
            self._abandon()
            raise
        if answer is None:
            # The server may have answered with an action, which it would take as executed.
            self._executed.withhold()
            answer = pb.SessionMissed(reason=f"no reply within {self._limits.answer_within:g} s")
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
        `outcome` is its label: success, failure or unknown. Raises when the server could not store it, or has not
        within `close_timeout`.
        """
        wire = number(pb.SessionClose, "outcome", outcome)
        session, self._session = self._session, None
        self._begin()
        if session is None:
            return ""
        record = self._open.record
        try:
            return session.close(wire, self._limits.close_timeout if record else self._limits.timeout).episode_id
        except GleanerError:
            # The episode is over either way; without a recording only the close failed.
            if record:
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
        self.last, self._stamp_ns, self._executed = None, None, Executed()
        self.dropped, self.missed = 0, 0

    def _opened(self) -> Session:
        if self._session is None:
            rpc, limits = self._client._rpc, self._limits
            self._session = patiently(lambda: Session(rpc, self._open, limits.timeout, limits.open_timeout))
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
