"""Finds a daemon again that went away, as in a restart."""
from __future__ import annotations

import os
import time
from typing import Callable, Optional

import numpy as np

from .. import errors

DEFAULT_SECONDS = 10.0
# Time for the old daemon's jobs to end, while a service manager holds its socket: drain_ms_max.
DRAIN_SECONDS = 30.0
PAUSE_SECONDS = 0.05
# Calls of a request whose daemon goes away each time.
ATTEMPTS_MAX = 10


def seconds_of(reconnect: Optional[float]) -> float:
    """Returns the time to look for a daemon: the argument, else RAYNEST_RECONNECT, else 10 s."""
    if reconnect is None:
        text = os.environ.get("RAYNEST_RECONNECT", "")
        try:
            reconnect = float(text) if text else DEFAULT_SECONDS
        except ValueError:
            raise errors.UsageError(f"RAYNEST_RECONNECT={text!r}: it must be seconds") from None
    if isinstance(reconnect, (bool, np.bool_, str)) or not 0 <= reconnect <= 3600:
        raise errors.UsageError(f"reconnect of {reconnect!r}: it must be 0 to 3600 seconds")
    return reconnect


def open_again(connect: Callable[[], None], seconds: float, check: Callable[[], None]) -> None:
    """Calls `connect` until it succeeds: for `seconds`, and longer while something accepts connections
    and stays silent, or a daemon says that it ends. `check` raises where the wait must end."""
    begin = time.monotonic()
    while True:
        try:
            return connect()
        except (errors.ConnectError, errors.BusyError) as error:
            drains = error.silent or (error.lost and isinstance(error, errors.BusyError))
            patience = seconds + DRAIN_SECONDS * drains
            if time.monotonic() - begin > patience:
                raise
        check()
        time.sleep(PAUSE_SECONDS)


def open_first(connect: Callable[[], None], seconds: float, check: Callable[[], None]) -> None:
    """Calls `connect`, and once more as open_again() does where the daemon says that it ends, or was
    killed while its socket lives on. A server that stays silent may be of another kind."""
    try:
        connect()
    except errors.Error as error:
        if not seconds or not error.lost or error.silent:
            raise
        open_again(connect, seconds, check)
