"""A session: what scenes, jobs and pictures share of a client. They know it and not the client, which makes them."""
from __future__ import annotations

import contextlib
import threading
from typing import Any, Iterator

from ._handles import Handles
from ._net.access import Access
from ._net.connection import GREETING_SECONDS, Connection
from ._net.control import Message
from ._net.ssh import SshTunnel
from ._requests.job import Outcome
from ._requests.words import check_listed
from .errors import InvalidError


class _OfThread(threading.local):
    def __init__(self) -> None:
        self.outcome = Outcome()


class Session:
    """A connection with the last outcome of each thread and the meshes without a name in use."""

    def __init__(self, uri: str, access: Access, window_bytes: int, reconnect: float = 0.0,
                 greeting_seconds: float = GREETING_SECONDS) -> None:
        self._uri = uri
        self._tunnel = SshTunnel(uri) if uri.startswith("ssh://") else None
        try:
            self.connection = Connection(self._tunnel.uri if self._tunnel else uri, access, window_bytes,
                                         reconnect, self._tunnel.explain if self._tunnel else None, greeting_seconds)
        except BaseException:
            if self._tunnel:
                self._tunnel.close()
            raise
        self.handles = Handles()
        self._of_thread = _OfThread()

    @property
    def outcome(self) -> Outcome:
        """The outcome of this thread's last trace, stream or picture: what ran, and its statistics."""
        return self._of_thread.outcome

    @outcome.setter
    def outcome(self, outcome: Outcome) -> None:
        self._of_thread.outcome = outcome

    @property
    def uri(self) -> str:
        return self._uri

    def close(self) -> None:
        """Ends the connection. Scenes that have a name stay in the daemon; meshes without one go,
        unless another connection holds them."""
        self.connection.close()
        if self._tunnel:
            self._tunnel.close()

    def drop_unused(self) -> None:
        """Unloads the meshes without a name that have no Scene object any more; mesh() and load()
        call it first."""
        for name in () if self.connection.closed else self.handles.take_unused():
            with contextlib.suppress(InvalidError):  # somebody else has unloaded it
                self.connection.ask("Unload", {"scene": name}, "Unloaded")

    def pages(self, name: str, answer: str, entries: str, **request: Any) -> Iterator[Message]:
        """Yields the pages of a list request."""
        first = 0
        while True:
            page = self.connection.ask(name, {**request, "first": first}, answer)
            first += len(page[entries])
            check_listed(first)
            yield page
            if first >= page["total"] or not page[entries]:
                return
