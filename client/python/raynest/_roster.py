"""The workers of a cluster, as its scheduler tells. A client of Dask has a copy of that, which lists all of them only up
to release 2025.3."""
from __future__ import annotations

import asyncio
import concurrent.futures
import time
from typing import Any, Optional

from ._travel import LOST

FRESH_SECONDS = 2.0         # after which the scheduler is asked again, as often as Dask's client asks


async def _ask(cluster: Any) -> dict[str, Any]:
    workers: dict[str, Any] = (await cluster.scheduler.identity())["workers"]
    return workers


def workers_of(cluster: Any) -> dict[str, Any]:
    """address -> what the scheduler knows of the worker."""
    found: dict[str, Any] = cluster.sync(_ask, cluster)
    return found


def share_of(cluster: Any, seconds: float, items: int) -> float:
    """The time that each of so many items may take if all of them may take so long: they are made by turns where the
    workers have fewer threads."""
    threads: int = sum(worker["nthreads"] for worker in workers_of(cluster).values())
    return seconds * min(1.0, max(1, threads) / items)


class Roster:
    """The same, asked for in the background, so that it costs a loop no round trip; but for the first time, for which it
    waits so many seconds."""

    def __init__(self, cluster: Any, patience: float) -> None:
        self._cluster, self._patience = cluster, patience
        self._known: Optional[dict[str, Any]] = None
        self._asking: Optional[concurrent.futures.Future[dict[str, Any]]] = None
        self._asked = 0.0

    async def ask(self) -> dict[str, Any]:
        """In Dask's loop, for somebody who waits."""
        self._known = await _ask(self._cluster)
        return self._known

    def now(self) -> dict[str, Any]:
        """As last heard; {}: nothing is known, or there are none."""
        if self._cluster.status != "running":
            return self._known or {}
        if self._asking is None and (self._known is None or time.monotonic() > self._asked + FRESH_SECONDS):
            self._asked = time.monotonic()
            self._asking = asyncio.run_coroutine_threadsafe(_ask(self._cluster), self._cluster.loop.asyncio_loop)
        if self._asking is not None and (self._known is None or self._asking.done()):
            try:
                self._known = self._asking.result(self._patience)
            except LOST:        # the scheduler is gone, or stuck: what it said before may still be so
                self._asking.cancel()
                self._known = self._known or {}
            self._asking = None
        return self._known or {}
