"""SHA-256 of a file that is still being written."""
from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor


class Digest:
    """Computed in a thread of its own while the caller writes the next piece. Of a large mesh that the daemon has, this is
    most of the work."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()
        self._thread = ThreadPoolExecutor(1)

    def add(self, piece: memoryview) -> None:
        """The piece must stay as it is."""
        self._thread.submit(self._sha.update, piece)

    def value(self) -> bytes:
        """Waits for all pieces."""
        self._thread.shutdown()
        return self._sha.digest()
