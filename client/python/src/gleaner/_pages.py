"""Lists by pages. Independent of services."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

from google.protobuf.message import Message

from gleaner._rpc import Rpc

Reply = TypeVar("Reply", bound=Message)

# Rows of one page.
PAGE = 500


def pages(rpc: Rpc, method: str, request: Any, reply: type[Reply]) -> Iterator[Reply]:
    """Every page of a list, from the first to the last. `request` has the size of a page; its token is set here."""
    while True:
        page: Any = rpc.safe(method, request, reply)
        yield page
        if not page.next_page_token:
            return
        request.page_token = page.next_page_token
