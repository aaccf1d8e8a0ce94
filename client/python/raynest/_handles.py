"""Counts the Scene objects of each scene without a name.

The daemon counts a connection once, however many Scene objects it has of a scene. Counting them
here lets such a scene go with its last object.
"""
from __future__ import annotations

import collections
import threading


class Handles:
    """Thread-safe; leave() takes no lock, so that a finalizer may call it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users: collections.Counter[str] = collections.Counter()
        self._left: collections.deque[str] = collections.deque()
        self._temporary: dict[str, bool] = {}

    def enter(self, name: str) -> None:
        with self._lock:
            self._users[name] += 1

    def leave(self, name: str) -> None:
        self._left.append(name)

    def loaded(self, name: str, temporary: bool) -> None:
        """Notes a load. A scene that this client once loaded to stay does not become temporary again."""
        with self._lock:
            self._temporary[name] = temporary and self._temporary.get(name, True)

    def unloaded(self, name: str) -> None:
        with self._lock:
            self._temporary.pop(name, None)

    def take_unused(self) -> list[str]:
        """Returns the scenes without a name that have no Scene object any more, each once."""
        with self._lock:
            while self._left:
                self._users[self._left.popleft()] -= 1
            self._users = +self._users  # without the zeros
            unused = [name for name, temporary in self._temporary.items()
                      if temporary and not self._users[name]]
            for name in unused:
                del self._temporary[name]
            return unused
