"""The exceptions: one class for each exit code of the command line.

    Error                    code, name, exit_code, retry_after, request
    ├── FailedError          1    defects, broken connections, a taken name
    │   └── ProtocolError    1    the other end does not speak the protocol
    ├── UsageError           2    a field or parameter is wrong; also a ValueError
    ├── ConnectError         3    nobody answers there; also a ConnectionError
    ├── NotAllowedError      4    it belongs to another principal; also a PermissionError
    ├── InvalidError         5    scene, file, variant or job is unknown; also a LookupError
    ├── BusyError            6    full, or over a quota: try again after `retry_after` seconds
    ├── DeadlineError        7    the deadline passed; also a TimeoutError
    └── CancelledError       130  the request was cancelled

`name` tells errors of one class apart: InvalidError is SCENE_UNKNOWN, JOB_UNKNOWN, ...
Warning (a UserWarning)
    ├── SceneWarning         load() or mesh() had to change or skip something
    └── RayWarning           rays of a query were not valid

Ctrl-C raises KeyboardInterrupt as everywhere in Python, after the request was cancelled.
"""
from __future__ import annotations

import contextlib
import re
import sys
import threading
import warnings
from typing import Iterator

from ._lists import ERRORS
from ._wording import localize_message


class Error(Exception):
    """A request that RayNest refused or failed to do; the text says what to do about it."""

    exit_code = 1

    def __init__(self, message: str, name: str = "", code: int = 0, retry_after: float = 0.0,
                 request: str = "", lost: bool = False, silent: bool = False):
        # Values of users are quoted, and an array's text has lines.
        message = shown_text(re.sub(r"\s*\n\s*", " ", message))
        super().__init__(message + (f" [request {request}]" if request else ""))
        self.name = name
        self.code = code
        self.retry_after = retry_after
        """Seconds to wait before trying again; 0 if the daemon names no time."""
        self.request = request
        """Id of the request, as the daemon's log names it; "" if the error is about none."""
        self.lost = lost
        """True if the connection or its daemon ended: another connection may get the answer."""
        self.silent = silent
        """True if a server has accepted the connection and said nothing."""


class FailedError(Error):
    pass


class ProtocolError(FailedError):
    pass


class UsageError(Error, ValueError):
    exit_code = 2


class ConnectError(Error, ConnectionError):
    exit_code = 3


class NotAllowedError(Error, PermissionError):
    exit_code = 4


class InvalidError(Error, LookupError):
    exit_code = 5


class BusyError(Error):
    exit_code = 6


class DeadlineError(Error, TimeoutError):
    exit_code = 7


class CancelledError(Error):
    exit_code = 130


class Warning(UserWarning):
    """A request that succeeded, with the reservation in the text."""


class SceneWarning(Warning):
    pass


class RayWarning(Warning):
    pass


_here = threading.local()


@contextlib.contextmanager
def warnings_taken() -> Iterator[list[tuple[str, type[Warning]]]]:
    """Warnings of this thread come into a list, for somebody who tells them elsewhere."""
    before, _here.taken = getattr(_here, "taken", None), []
    try:
        yield _here.taken
    finally:
        _here.taken = before


def warn(text: str, category: type[Warning]) -> None:
    """Warns, and attributes the warning to the line that called this package."""
    if getattr(_here, "taken", None) is not None:
        return _here.taken.append((text, category))     # type: ignore[no-any-return]
    package = __name__.partition(".")[0]
    level = 1
    frame = sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, level)


BY_EXIT_CODE: dict[int, type[Error]] = {kind.exit_code: kind for kind in (
    FailedError, UsageError, ConnectError, NotAllowedError, InvalidError, BusyError, DeadlineError,
    CancelledError)}
INTERNAL: tuple[str, type[Error]] = ("INTERNAL", FailedError)

# The error table of PROTOCOL.md, in order of its codes from 1.
TABLE: tuple[tuple[str, type[Error]], ...] = tuple(
    (name, BY_EXIT_CODE[exit_code]) for name, exit_code in ERRORS)


def shown_text(text: str) -> str:
    """The text as a terminal may show it: one line, "?" in the place of control characters."""
    return re.sub("[\x00-\x1f\x7f-\x9f]", "?", re.sub("[\n\r\t]", " ", text))


def from_daemon(code: int, message: str, retry_after_ms: int, request: str = "",
                again: bool = False) -> Error:
    """Returns the exception for an ERROR frame; an unknown code, of a later version, gives INTERNAL. `again`:
    the connection is not the first to this daemon."""
    known = 1 <= code <= len(TABLE)
    name, kind = TABLE[code - 1] if known else INTERNAL
    seconds = retry_after_ms / 1000
    hint = f" (try again in {retry_after_ms} ms)" if retry_after_ms else ""
    if again and name == "SCENE_UNKNOWN":
        hint += "; the daemon was restarted, or the connection to it broke, since this client connected first"
    return kind(localize_message(message or name) + hint, name, code, seconds, request,
                name == "DRAINING")
