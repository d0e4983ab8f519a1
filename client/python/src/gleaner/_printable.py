"""Escaping of text from servers and recordings for terminals. Independent of messages."""

from __future__ import annotations

import unicodedata

# Controls, invisible and bidirectional characters, line and paragraph separators, private ones.
_HIDDEN = ("Cc", "Cf", "Zl", "Zp", "Co", "Cs")


def printable(text: str, kept: str = "\n\t") -> str:
    """The text with each such character as a visible escape, except those in `kept`."""
    return "".join(
        f"\\u{{{ord(character):x}}}"
        if unicodedata.category(character) in _HIDDEN and character not in kept
        else character
        for character in text
    )
