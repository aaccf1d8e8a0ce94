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
import threading
import time
import warnings
import weakref
from typing import Any, Callable, Iterator, NamedTuple, Optional

import dask

from ._own_daemon import distributed
from ._roster import roster_of
from ._travel import LOST
from .errors import FailedError

SENDS_MAX = 4               # that share the client's link: more of them would each take longer
QUIETLY = {"distributed.diagnostics.computations.ignore-modules": [""]}     # "" is where all names begin
SEND_SECONDS = 60.0         # that a worker may take to get some rays
PROFILE_MS = 1000           # between two looks at the threads of a worker, while it makes an item
# Rays that go through the scheduler are meant to.
warnings.filterwarnings("ignore", "Large object of size|Sending large graph", UserWarning)


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


class Came(NamedTuple):
    """The end of a copy, or of an item that this machine makes: its answer, or the error of the way, or with `failed` of
    whoever made it."""

    answer: Any = None
    error: Optional[BaseException] = None
    failed: bool = False


class Road:
    """To the workers of a cluster, for the copies of a request."""

    def __init__(self, cluster: Any, patience: float) -> None:
        self.cluster, self.roster, self._patience = cluster, roster_of(cluster), patience
        self.slow: set[str] = set()                         # workers that did not take rays
        self._sends: Optional[asyncio.Semaphore] = None     # of the loop that first needs it

    async def sent(self, rays: Any, to: str) -> Any:
        """Sends rays to a worker; None: it is stuck, or gone."""
        self._sends = self._sends or asyncio.Semaphore(SENDS_MAX)
        async with self._sends:
            if to in self.slow:
                return None
            begin, sending = time.monotonic(), asyncio.ensure_future(self._scattered(rays, to))
            try:
                while not (await asyncio.wait([sending], timeout=self._patience))[0]:
                    now = time.monotonic()      # if the worker is heard meanwhile, the link is slow
                    if self.roster.heard(to) < now - self._patience or now > begin + SEND_SECONDS:
                        raise OSError("it is stuck")
                return sending.result()
            except Exception:
                self.slow.add(to)
                return None
            finally:
                if not sending.done():
                    sending.add_done_callback(let_go)

    async def _scattered(self, rays: Any, to: str) -> Any:
        if not await self.roster.reaches(to):
            raise OSError("its rays go through the scheduler")
        return await scattered(self.cluster, uncompressed(rays), to, True)


_on_the_way: weakref.WeakKeyDictionary[Any, set[Any]] = weakref.WeakKeyDictionary()    # scatters, by their cluster


async def scattered(cluster: Any, data: Any, to: str, direct: bool) -> Any:
    """Scatters data to a worker, however soon nobody waits for it any more: one that is broken off would leave its data there
    for good, as the scheduler is told of it at the end."""
    scattering = asyncio.ensure_future(cluster.scatter(data, hash=False, workers=[to], direct=direct, asynchronous=True))
    _on_the_way.setdefault(cluster, set()).add(scattering)
    scattering.add_done_callback(_on_the_way[cluster].discard)
    try:
        return await asyncio.shield(scattering)
    except asyncio.CancelledError:
        scattering.add_done_callback(let_go)
        raise


def settle(cluster: Any, seconds: float) -> None:
    """Waits until all has arrived that is on its way to the workers, so that it is let go there before the client goes."""
    end = time.monotonic() + seconds
    while _on_the_way.get(cluster) and time.monotonic() < end:
        time.sleep(0.01)


def let_go(scattering: Any) -> None:
    """Is called when a scatter ends that nobody waits for."""
    if not scattering.cancelled() and scattering.exception() is None:
        given = scattering.result()
        for future in given.values() if isinstance(given, dict) else [given]:
            future.release()


class Copy:
    """An item on its way. `submit` makes a Dask Future of its rays and key. The rays go to the worker `onto` before, from
    which whoever makes the item takes them; without one they go with the item, through the scheduler. `back` is called in
    Dask's loop with what Came. Nothing is left on the cluster then: a Future that refers to itself would be."""

    def __init__(self, road: Road, submit: Callable[[Any, str], Any], rays: Any, onto: str, key: str,
                 back: Callable[[Came], None]) -> None:
        self.key, self.onto = key, onto
        self.born = math.inf        # since when a worker may make it: then its rays are there
        self.only = ""              # the worker that alone may make it
        self._is_left = False
        self._going = asyncio.run_coroutine_threadsafe(self._go(road, submit, rays, back), road.cluster.loop.asyncio_loop)

    async def _go(self, road: Road, submit: Callable[[Any, str], Any], rays: Any, back: Callable[[Came], None]) -> None:
        sent = made = None
        try:
            if self.onto:
                sent = await road.sent(rays, self.onto)
                rays, self.onto = (rays, "") if sent is None else (sent, self.onto)
            ended, loop = asyncio.Event(), asyncio.get_running_loop()
            with dask.config.set(QUIETLY):
                made, self.born = submit(rays, self.key), time.monotonic()
            rays = None
            made.add_done_callback(lambda _: loop.call_soon_threadsafe(ended.set))
            await ended.wait()
            if made.status == "finished":
                came = Came(await road.roster.answer_of(self.key))
            elif made.status == "error":
                came = Came(None, await made._exception(), True)
            else:
                came = Came(None, FailedError("the scheduler dropped it"))
        except LOST as error:       # the worker died with the answer, or cannot be reached
            came = Came(None, error.with_traceback(None))
        finally:
            for future in (made, sent):
                if future is not None:
                    future.release()
        if not self._is_left:
            back(came)

    def release(self) -> None:
        """Ends its way: nobody waits for it any more."""
        self._is_left = True
        with contextlib.suppress(RuntimeError):     # the loop has ended
            self._going.cancel()
