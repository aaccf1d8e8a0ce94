"""The way of an item over a worker and back: its rays go there, it is made, and its answer comes.

Each of these steps may wait for a worker that is stuck or gone, and Dask waits half a minute and longer. So a copy of an
item goes all of its way in the loop of Dask's client, apart from the others, and whoever deals it out waits for none.

Dask does three things for each item that cost more than they bring here: it compresses arrays, looks at the threads of a
worker a hundred times a second, and tells the scheduler the source text of the function that submits it. All are left out;
other programs of the cluster keep them.
"""
from __future__ import annotations

import asyncio
import contextlib
import math
import os
import threading
import time
from typing import Any, Callable, Iterator, Optional

import dask

from ._own_daemon import distributed
from .errors import FailedError

SENDS_MAX = 4               # that share the client's link: more of them would each take longer
BUSY_SECONDS = 0.05         # after which a worker that gives others their answers is asked again
NO_SOURCE = {"distributed.diagnostics.computations.ignore-modules": [""]}   # "" is where all names begin
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


async def answer_of(cluster: Any, key: str) -> Any:
    """Fetches what a worker has under a key. Dask's gather() fetches five lots at once, each of all that was asked for
    meanwhile: a worker that is stuck holds up the answers of all others."""
    for worker in (await cluster.scheduler.who_has(keys=[key])).get(key, ()):
        while True:
            told = await distributed.worker.get_data_from_worker(cluster.rpc, [key], worker)    # type: ignore[no-untyped-call]
            if told["status"] != "busy":
                break
            await asyncio.sleep(BUSY_SECONDS)
        if key in told.get("data", ()):
            return told["data"][key]
    raise FailedError("no worker has the answer any more")


class Road:
    """To the workers of a cluster, for the copies of a request."""

    def __init__(self, cluster: Any, patience: float) -> None:
        self.cluster, self._patience = cluster, patience
        self.slow: set[str] = set()                         # workers that did not take rays
        self._sends: Optional[asyncio.Semaphore] = None     # of the loop that first needs it

    async def sent(self, rays: Any, to: str) -> Any:
        """Sends rays to a worker; None: it is stuck, or gone."""
        self._sends = self._sends or asyncio.Semaphore(SENDS_MAX)
        async with self._sends:
            if to in self.slow:
                return None
            sending = self.cluster.scatter(uncompressed(rays), hash=False, direct=True, workers=[to], asynchronous=True)
            try:
                return await asyncio.wait_for(sending, self._patience)
            except Exception:
                self.slow.add(to)
                return None


class Copy:
    """An item on its way. `submit` makes a Dask Future of its rays and key. The rays go to the worker `onto` before, from
    which whoever makes the item takes them; without one they go with the item, through the scheduler."""

    def __init__(self, road: Road, submit: Callable[[Any, str], Any], rays: Any, onto: str) -> None:
        self.key, self.onto = f"raynest-{os.urandom(8).hex()}", onto
        self.made: Any = None       # the Future
        self.born = math.inf        # since when a worker may make it: then its rays are there
        self._going = asyncio.run_coroutine_threadsafe(self._go(road, submit, rays), road.cluster.loop.asyncio_loop)

    async def _go(self, road: Road, submit: Callable[[Any, str], Any], rays: Any) -> Any:
        if self.onto:
            sent = await road.sent(rays, self.onto)
            rays, self.onto = (rays, "") if sent is None else (sent, self.onto)
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        with dask.config.set(NO_SOURCE):
            self.made, self.born = submit(rays, self.key), time.monotonic()
        del rays
        self.made.add_done_callback(lambda _: loop.call_soon_threadsafe(ended.set))
        await ended.wait()
        return await answer_of(road.cluster, self.key) if self.made.status == "finished" else None

    def when_back(self, call: Callable[[Any], None]) -> None:
        """Calls, in another thread, with what has the answer, or the error of the way."""
        self._going.add_done_callback(call)

    def release(self) -> None:
        """Ends its way: nobody waits for it any more."""
        self._going.cancel()
        if self.made is not None:
            self.made.release()
