"""The confidence interval of a success rate."""

from __future__ import annotations

import math

# The normal distribution's 97.5 % quantile.
_Z = 1.959963984540054


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a success rate: low, high; (0, 1) without trials."""
    if not 0 <= successes <= trials:
        raise ValueError(f"successes: {successes} of {trials} is impossible")
    if trials == 0:
        return 0.0, 1.0
    rate = successes / trials
    centre = rate + _Z**2 / (2 * trials)
    spread = _Z * math.sqrt(rate * (1 - rate) / trials + _Z**2 / (4 * trials**2))
    scale = 1 + _Z**2 / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)
