"""Ctrl-C between frames, never within one.

Python raises KeyboardInterrupt at any point of any function; half a frame later the connection would
be lost. Within `with interrupts:` a Ctrl-C is only noted, check() raises it where the code may stop,
and leaving the outermost block raises what is still due. Another one before that is raised at once.
Handlers that a program has set itself stay in place, and other threads Python never interrupts.
"""
from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Optional


class Interrupts:
    def __init__(self) -> None:
        self.seen = False
        self._depth = 0
        self._deferred = False

    def __enter__(self) -> Interrupts:
        self._depth += 1
        if (self._depth == 1 and threading.current_thread() is threading.main_thread()
                and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
            signal.signal(signal.SIGINT, self._note)
            self._deferred = True
        return self

    def check(self) -> None:
        if self.seen:
            self.seen = False
            raise KeyboardInterrupt

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth:
            return
        if self._deferred:
            self._deferred = False
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.check()

    def _note(self, number: int, frame: Optional[FrameType]) -> None:
        if self.seen:
            raise KeyboardInterrupt
        self.seen = True
