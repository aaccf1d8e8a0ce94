"""Translates the protocol's words in messages to those of this package, or of the command line."""
from __future__ import annotations

import re

from ._lists import WORDS

_COMMAND, _PYTHON = range(2)    # whose words: columns of WORDS
_own = _PYTHON


def speak_as_command() -> None:
    """This program is a command of raynest from now on: messages have the command line's words."""
    global _own
    _own = _COMMAND


# A word with its value: a number, a mask, a word in quotes, or one that stands for itself.
_VALUED = r"`([A-Za-z_]+)` ((?:[-+]?[\d.]+(?:e[-+]?\d+)?|[\dA-F]{8}|none|auto|sky|'[^']*')(?![\w.]))"


def _valued(word: str, value: str) -> str:
    name = WORDS[word][_PYTHON] if word in WORDS else ""
    return name + value if name.endswith("=") else f"`{word}` {value}"


def _points(numbers: str) -> str:
    parts = numbers.split(",")
    points = ", ".join(f"({', '.join(parts[at:at + 3])})" for at in range(0, len(parts), 3))
    return f"({points})"


def localize_message(message: str) -> str:
    """Replaces the words between backticks in a message of the daemon, which are fields or messages
    of the protocol (PROTOCOL.md, 9), by the user's spelling."""
    if _own == _PYTHON:
        message = _with_points(message)
        message = re.sub(_VALUED, lambda match: _valued(match[1], match[2]), message)
    return re.sub("`([A-Za-z_]+)`", lambda match: WORDS[match[1]][_own] if match[1] in WORDS else match[0], message)


def _with_points(message: str) -> str:
    message = re.sub(r"`origin` ([-+.,e\d]+)", r"origin=(\1)", message)
    # Eye, point and, where there is one, up.
    return re.sub(r"`look_at` ([-+.,e\d]+)", lambda match: "look_at=" + _points(match[1]), message)
