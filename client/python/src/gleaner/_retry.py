"""Patience with a connection that broke: waits that grow, and an end to them."""

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
    """Tries left, for calls that are safe to make again."""

    def __init__(self) -> None:
        self._failures = 0

    def restore(self) -> None:
        """Something was achieved: the count begins anew."""
        self._failures = 0

    def wait(self, error: Exception) -> None:
        """Waits before the next try; raises the error instead when it is time to give up, or when no try will help."""
        if self._failures == _TRIES or isinstance(error, HandshakeFailed):
            raise error
        time.sleep(_FIRST_WAIT * 2**self._failures)
        self._failures += 1


def patiently(call: Callable[[], T]) -> T:
    """Makes a call that is safe to make twice, again and again while there is no connection."""
    patience = Patience()
    while True:
        try:
            return call()
        except Unavailable as error:
            patience.wait(error)
