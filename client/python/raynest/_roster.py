"""The workers of a cluster, as its scheduler tells: who is there, who lives, and whom this machine reaches. A client of Dask
has a copy of that, which lists all of them only up to release 2025.3."""
from __future__ import annotations

import asyncio
import concurrent.futures
import math
import time
import weakref
from typing import AbstractSet, Any, NamedTuple, Optional, Sequence

from ._own_daemon import distributed
from ._travel import LOST
from .errors import FailedError

PATIENCE = 4.0              # s of silence after which open items are dealt again, and a scheduler is not waited for
FRESH_SECONDS = 2.0         # after which the scheduler is asked again, as often as Dask's client asks
BUSY_SECONDS = 0.05         # after which a worker that gives others their answers is asked again
_all: weakref.WeakKeyDictionary[Any, Roster] = weakref.WeakKeyDictionary()


class Places(NamedTuple):
    """Where copies of items are, by the scheduler."""

    making: dict[str, set[str]]     # worker -> keys that it makes, or has in its queue
    made: dict[str, set[str]]       # worker -> keys of our copies that it has made

    def have(self, worker: str, keys: AbstractSet[str]) -> bool:
        return bool(keys & (self.making.get(worker, set()) | self.made.get(worker, set())))


class Roster:
    """Asks in the background, so that it costs a loop no round trip; it waits only where nothing is known any more, and
    not again for a scheduler that is stuck. All requests of a client share one."""

    def __init__(self, cluster: Any) -> None:
        self._cluster = weakref.proxy(cluster)
        self._known: dict[str, Any] = {}                # address -> what the scheduler knows of the worker
        self._beats: dict[str, tuple[Any, float]] = {}  # address -> when the scheduler heard it, and when we learned that
        self._asking: Optional[concurrent.futures.Future[None]] = None
        self._asked = self._told = -FRESH_SECONDS - time.monotonic()
        self._is_stuck = False                          # the scheduler is
        self.none_since = time.monotonic()              # there are no workers; infinite: there are some
        self._reaching: dict[str, asyncio.Future[bool]] = {}

    async def ask(self) -> None:
        """In Dask's loop, for somebody who waits."""
        self._hear((await self._cluster.scheduler.identity())["workers"])

    def _hear(self, workers: dict[str, Any]) -> None:
        """The scheduler's clock may be another than ours."""
        now = time.monotonic()
        for worker, said in workers.items():
            if self._beats.get(worker, (None,))[0] != said.get("last_seen"):
                self._beats[worker] = said.get("last_seen"), now
        self._known, self._told, self._is_stuck = workers, now, False
        self.none_since = math.inf if workers else min(self.none_since, now)

    def now(self, patience: float = PATIENCE) -> dict[str, Any]:
        """As last heard; {}: nothing is known, or there are none."""
        if self._cluster.status != "running":
            return self._known
        now, asking = time.monotonic(), self._asking
        if asking is None and now - self._asked > FRESH_SECONDS:
            self._asked = now
            asking = self._asking = asyncio.run_coroutine_threadsafe(self.ask(), self._cluster.loop.asyncio_loop)
        waits = now - self._told > 1.5 * FRESH_SECONDS and not self._is_stuck
        if asking is not None and (waits or asking.done() or now - self._asked > patience):
            try:
                asking.result(patience if waits else 0)
            except LOST:        # the scheduler is gone, or stuck: what it said before may still be so
                asking.cancel()
                self._is_stuck = True
            self._asking = None
        return self._known

    def living(self, patience: float = PATIENCE) -> dict[str, Any]:
        """Those that the scheduler has heard lately, and has not let go."""
        workers = self.now(patience)
        beat: float = distributed.scheduler.heartbeat_interval(len(workers))
        since = time.monotonic() - patience - FRESH_SECONDS - 2 * beat
        return {worker: said for worker, said in workers.items() if self._beats[worker][1] > since}

    def heard(self, worker: str) -> float:
        """When we learned that the scheduler had."""
        return self._beats.get(worker, ("", -math.inf))[1]

    def threads(self, patience: float = PATIENCE) -> int:
        """Of those that live, together."""
        return sum(worker["nthreads"] for worker in self.living(patience).values())

    def places(self, keys: Sequence[str], patience: float) -> Optional[Places]:
        """Asks the scheduler where these are; None: it does not tell."""
        async def ask() -> Any:
            told = self._cluster.scheduler
            return await asyncio.gather(told.processing(workers=None), told.who_has(keys=keys), self.ask())
        asking = asyncio.run_coroutine_threadsafe(ask(), self._cluster.loop.asyncio_loop)
        try:
            making, made, _ = asking.result(patience)
        except LOST:        # what is late is dealt again all the same
            asking.cancel()
            return None
        places = Places({worker: set(theirs) for worker, theirs in making.items()}, {})
        for key, makers in made.items():
            for worker in makers:
                places.made.setdefault(worker, set()).add(key)
        return places

    # ---- in Dask's loop -------------------------------------------------------------------------

    async def reaches(self, worker: str) -> bool:
        """False where the scheduler hears a worker, and this machine cannot connect to it, as behind a tunnel or a gateway:
        what it has then comes and goes through the scheduler. Raises OSError for one that nobody hears."""
        found = self._reaching.get(worker)
        if found is None or found.done() and (found.cancelled() or found.exception()):
            found = self._reaching[worker] = asyncio.ensure_future(self._reach(worker))
        return await asyncio.shield(found)

    async def _reach(self, worker: str) -> bool:
        connecting, heard = asyncio.ensure_future(self._cluster.rpc.connect(worker)), 0
        try:
            while True:
                begin = time.monotonic()
                ended, _ = await asyncio.wait([connecting], timeout=PATIENCE)
                if ended and not connecting.exception():
                    self._cluster.rpc.reuse(worker, connecting.result())
                    return True
                await asyncio.sleep(begin + PATIENCE - time.monotonic())    # whoever refuses does so at once
                heard += self.heard(worker) > begin
                if heard > (not ended):     # the second time: it may have been stuck for a while
                    return False
                if ended:
                    raise OSError(f"{worker} cannot be reached")
        finally:
            connecting.cancel()

    def far(self) -> list[str]:
        """Those that this machine cannot reach."""
        return [worker for worker, found in self._reaching.items()
                if found.done() and not found.cancelled() and not found.exception() and not found.result()]

    async def answer_of(self, key: str) -> Any:
        """Fetches what a worker has under a key. Dask's gather() fetches five lots at once, each of all that was asked for
        meanwhile: a worker that is stuck holds up the answers of all others."""
        cluster = self._cluster
        for worker in (await cluster.scheduler.who_has(keys=[key])).get(key, ()):
            if await self.reaches(worker):
                while True:
                    told = await distributed.worker.get_data_from_worker(       # type: ignore[no-untyped-call]
                        cluster.rpc, [key], worker)
                    if told["status"] != "busy":
                        break
                    await asyncio.sleep(BUSY_SECONDS)
            else:
                told = await cluster.scheduler.gather(keys=[key])
            if key in told.get("data", ()):
                return plain(told["data"][key])
        raise FailedError("no worker has the answer any more")


def roster_of(cluster: Any) -> Roster:
    return _all.setdefault(cluster, Roster(cluster))


def plain(it: Any) -> Any:
    """It, as it was sent: within one process it comes so."""
    protocol: Any = distributed.protocol    # has few types
    return protocol.deserialize(it.header, it.frames) if isinstance(it, protocol.Serialized) else it
