"""Sessions that open for a step, and whether its observations are still of use by then."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gleaner.errors import Missed

if TYPE_CHECKING:
    from gleaner.policy import Policy

# The control periods after which a robot has newer observations than one that waits for its session.
_NEWER = 2


def open_for_step(policies: Sequence[Policy]) -> None:
    """Opens missing sessions. Raises `Missed` if a robot's observations are out of date by then."""
    begun = time.monotonic()
    missing = [policy for policy in policies if policy._session is None]
    for policy in missing:
        policy.open()
    took = time.monotonic() - begun
    if any(policy._limits.deadline is not None and took > _NEWER / policy.rate_hz for policy in missing):
        for policy in policies:
            policy.missed += 1
        raise Missed(
            f"deployment {missing[0].deployment}: the session was opened meanwhile, in {took:.1f} s; send the newest "
            "observation"
        )
