"""Retries over a broken connection: growing pauses and a limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from gleaner.errors import HandshakeFailed, Unavailable

T = TypeVar("T")

# 0.1 + 0.2 + 0.4 + ... + 6.4 s: about 13 s, in which a server can restart.
_FIRST_WAIT = 0.1
_TRIES = 7


class Patience:
    """The remaining retries of calls that are safe to repeat."""

    def __init__(self) -> None:
        self._failures = 0

    def restore(self) -> None:
        """Progress was made: the count starts again."""
        self._failures = 0

    def wait(self, error: Exception) -> None:
        """Pauses before the next try; raises the error when the retries are exhausted or cannot help."""
        if self._failures == _TRIES or isinstance(error, HandshakeFailed):
            raise error
        time.sleep(_FIRST_WAIT * 2**self._failures)
        self._failures += 1


def patiently(call: Callable[[], T]) -> T:
    """Makes a call that is safe to repeat; retries while there is no connection."""
    patience = Patience()
    while True:
        try:
            return call()
        except Unavailable as error:
            patience.wait(error)
