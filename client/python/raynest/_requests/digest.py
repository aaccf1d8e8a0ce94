"""SHA-256 of a file that is still being written."""
from __future__ import annotations

import hashlib
import threading
from typing import Optional


class Digest:
    """Computed in threads of its own while the caller writes the next piece. Of a large mesh that the daemon has, this is
    most of the work."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()
        self._last: Optional[threading.Thread] = None

    def add(self, piece: memoryview) -> None:
        """The piece must stay as it is."""
        before = self._last

        def update() -> None:
            if before:
                before.join()
            self._sha.update(piece)
        self._last = threading.Thread(target=update)    # concurrent.futures takes longer to import
        self._last.start()

    def value(self) -> bytes:
        """Waits for all pieces."""
        if self._last:
            self._last.join()
        return self._sha.digest()
