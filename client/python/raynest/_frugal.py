"""Leaves out two things that Dask does for each item and that cost more than they bring here: it compresses arrays, and
looks at the threads of a worker a hundred times a second. Other programs of the cluster keep both."""
from __future__ import annotations

import contextlib
import threading
from typing import Any, Iterator

from ._own_daemon import distributed

PROFILE_MS = 1000           # between two looks at the threads of a worker, while it makes an item


def uncompressed(it: Any) -> Any:
    """In the form in which Dask sends it as it is. Whoever receives it has the object itself."""
    protocol: Any = distributed.protocol    # has few types
    header, frames = protocol.serialize(it)
    return protocol.Serialized({**header, "compression": (False,) * len(frames)}, frames)


_making = 0                 # items of this process
_usual = 0.0                # time between two looks without them
_lock = threading.Lock()


@contextlib.contextmanager
def seldom_profiled() -> Iterator[None]:
    """The worker of this thread looks seldom while it makes an item: often takes a hundredth of a core for each of them."""
    global _making, _usual
    try:
        looks: Any = distributed.get_worker().periodic_callbacks["profile"]
    except (ValueError, LookupError, AttributeError):   # this machine's own daemon, no profile, or another Dask
        yield
        return
    with _lock:
        if _making == 0:
            _usual, looks.callback_time = looks.callback_time, max(looks.callback_time, PROFILE_MS)
        _making += 1
    try:
        yield
    finally:
        with _lock:
            _making -= 1
            if _making == 0:
                looks.callback_time = _usual
