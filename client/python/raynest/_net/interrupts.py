"""Ctrl-C between frames, never within one.

Python raises KeyboardInterrupt at any point of any function. In the middle of a frame that would
cost the connection. Within `with interrupts:` a Ctrl-C is only noted: check() raises it where the
code may stop, and so does the end of the outermost block. A second Ctrl-C before that is raised at
once. Handlers that a program has set itself stay in place. Python interrupts the main thread only,
so in other threads this class does nothing.
"""
from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Optional


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


class Interrupts:
    def __init__(self) -> None:
        self._seen = False
        self._depth = 0
        self._deferred = False

    def __enter__(self) -> Interrupts:
        if _in_main_thread():
            # Count after the handler is in place: a Ctrl-C before that leaves this function, and
            # __exit__ would not run.
            if self._depth == 0 and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                self._seen = False
                signal.signal(signal.SIGINT, self._note)
                self._deferred = True
            self._depth += 1
        return self

    def __exit__(self, *_: object) -> None:
        if _in_main_thread():
            self._depth -= 1
            if self._depth == 0 and self._deferred:
                self._deferred = False
                signal.signal(signal.SIGINT, signal.default_int_handler)
                self.check()

    @property
    def seen(self) -> bool:
        return self._seen and _in_main_thread()

    def check(self) -> None:
        if self.seen:
            self._seen = False
            raise KeyboardInterrupt

    def _note(self, number: int, frame: Optional[FrameType]) -> None:
        if self._seen:
            raise KeyboardInterrupt
        self._seen = True
