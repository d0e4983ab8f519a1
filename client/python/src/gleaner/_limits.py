"""The time limits of a policy's calls, in seconds."""

from __future__ import annotations

from dataclasses import dataclass

from gleaner.errors import invalid

# The most of a rate or a time; longer deadlines than about an hour do not fit the message.
_MOST = 3600.0
# Beyond the deadline, for the way of an observation and of its reply, which the server's clock leaves out.
_GRACE = 0.1


def check(name: str, value: float) -> None:
    """Checks the range of a rate or a time."""
    if not 0 < value <= _MOST:
        raise invalid(name, f"{value:g}: must be above 0 and at most {_MOST:g}")


@dataclass(frozen=True)
class Limits:
    """Checked arguments of `Policy`."""

    deadline: float | None
    hold: float
    timeout: float
    open_timeout: float
    close_timeout: float

    def __post_init__(self) -> None:
        if not 0 <= self.hold <= _MOST:
            raise invalid("hold", f"{self.hold:g}: must be from 0 to {_MOST:g}")
        for name, value in vars(self).items():
            if name != "hold" and value is not None:
                check(name, value)

    @property
    def answer_within(self) -> float:
        """How long a call waits for its answer."""
        return self.timeout if self.deadline is None else min(self.timeout, self.deadline + _GRACE)
