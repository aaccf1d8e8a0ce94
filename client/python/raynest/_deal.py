"""Deals items out to the workers of a Dask cluster, until each is answered whatever dies."""
from __future__ import annotations

import asyncio
import os
import queue
import time
from typing import Any, Callable, Iterator, NamedTuple, Optional, Sequence

import numpy as np

from ._frugal import seldom_profiled, uncompressed
from ._travel import LOST, Missing
from ._prepared import Prepared
from ._version import VERSION
from ._own_daemon import Setup, distributed
from ._workers import NoRoom, Source, files_at, has_deadline, info_of, item as make_item
from .errors import DeadlineError, Error, FailedError, InvalidError, RayWarning, UsageError, warn

PATIENCE = 4.0             # s of silence after which open items are dealt again
COPIES_MAX = 3             # of an item on the workers, before it is made here
LOAD_BYTES_PER_SECOND = 5e6     # that even a slow host fetches and builds
SENDS_MAX = 100            # times that an item may find pieces of the scene missing
_ONCE = (UsageError, InvalidError)  # what another worker would answer alike


@seldom_profiled()
def sent_item(*arguments: Any) -> Any:
    """Makes an item on a worker: returns what make_item() returns, on its way to the client."""
    return uncompressed(make_item(*arguments))


class Part(NamedTuple):
    """An item: a method of Scene and its arguments. `rays` is called when the item is dealt."""

    options: dict[str, Any]
    rays: Optional[Callable[[], Any]] = None
    heavy: bool = False        # its rays travel from here to the worker, not through the scheduler
    weight: int = 1            # rays or samples, for progress
    source: Optional[Source] = None     # other than the deal's
    fits: Callable[[Any], bool] = lambda answer: True   # says whether an answer may be the item's


class Deal:
    """Deals items out to a cluster until each is answered. The first answer of an item counts."""

    def __init__(self, cluster: Any, setup: Setup, scene: Prepared, method: Any,
                 parts: Sequence[Part], patience: float, progress: Any, stage: str = "tracing") -> None:
        self._cluster, self._setup, self._scene, self._method = cluster, setup, scene, method
        self._source = scene.at(scene.epoch)
        self._parts, self._patience, self._progress, self._stage = parts, patience, progress, stage
        self._open: dict[int, dict[Any, float]] = {}    # item -> its copies, and when each was dealt
        self._copies = [0] * len(parts)
        self._left = len(parts)
        self._done = [False] * len(parts)
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._heard: dict[str, float] = {}              # worker -> when it last answered
        self._seconds: list[float] = []                 # that items took
        self._news = time.monotonic()
        self._alone = False
        self._sends = 0                                 # of pieces that were missing
        self._no_room: dict[str, NoRoom] = {}           # worker -> why it cannot have the scene
        self.notes: dict[str, None] = {}

    def answers(self) -> Iterator[tuple[int, Any]]:
        """Yields (item, answer) in any order. Leaving the loop cancels the rest."""
        next_item, answered = 0, 0
        total = sum(part.weight for part in self._parts)
        try:
            while self._left:
                ahead = max(8, 3 * sum(self._threads()))
                while not self._alone and next_item < len(self._parts) and len(self._open) < ahead:
                    self._deal(next_item)
                    next_item += 1
                if self._alone:
                    next_item = len(self._parts)
                    found = [(item, self._make(item)) for item in [self._done.index(False)]]
                else:
                    found = self._next()
                for item, answer in found:
                    if self._done[item]:
                        continue
                    self._done[item] = True
                    self._left -= 1
                    for copy in self._open.pop(item, {}):
                        copy.release()
                    answered += self._parts[item].weight
                    if self._progress:
                        self._progress(answered, total, self._stage)
                    yield item, answer
        finally:
            for copies in self._open.values():
                for copy in copies:
                    copy.release()
            for note in self.notes:
                warn(note, RayWarning)

    def _workers(self) -> dict[str, Any]:
        # The client's own copy, which costs no round trip.
        found: dict[str, Any] = (self._cluster._scheduler_identity or {}).get("workers", {})
        return found

    def _threads(self) -> list[int]:
        return [worker["nthreads"] for worker in self._workers().values()]

    def _fit(self, workers: Optional[list[str]]) -> Optional[list[str]]:
        """Those of the workers, or of all, that have room for the scene; None: any."""
        if not self._no_room:
            return workers
        fit = [worker for worker in self._workers() if worker not in self._no_room]
        return [worker for worker in workers or () if worker in fit] or fit

    def _deal(self, item: int, workers: Optional[list[str]] = None) -> None:
        part = self._parts[item]
        source = (part.source or self._source)._replace(sending=self._scene.sending)
        workers = self._fit(workers)
        if workers == [] and self._no_room:
            raise next(iter(self._no_room.values()))
        rays = None if part.rays is None else part.rays()
        try:
            if part.heavy:
                rays = self._sent(rays, workers or self._lively())
            copy = self._cluster.submit(sent_item, VERSION, self._setup, source, self._method, rays, part.options,
                                        pure=False, retries=1, workers=workers, key=f"raynest-{os.urandom(8).hex()}")
        except (OSError, asyncio.TimeoutError, RuntimeError, ValueError) as error:
            return self._give_up_cluster(error)
        self._copies[item] += 1
        self._open.setdefault(item, {})[copy] = time.monotonic()
        copy.add_done_callback(lambda done: self._events.put((item, done, None)))

    def _sent(self, rays: Any, workers: list[str]) -> Any:
        """Sends rays to a worker; where that is stuck they go with the task, through the scheduler."""
        async def scatter() -> Any:
            return await self._cluster.scatter(uncompressed(rays), hash=False, direct=True, workers=workers or None,
                                               asynchronous=True)
        sending = asyncio.run_coroutine_threadsafe(scatter(), self._cluster.loop.asyncio_loop)
        try:
            return sending.result(self._patience)
        except LOST:        # whatever it is, the rays are still here
            sending.cancel()
            return rays

    def _lively(self) -> list[str]:
        """Addresses of the workers that answered lately."""
        since = self._news - self._silence()
        return [where.split()[-1] for where, heard in self._heard.items() if heard >= since]

    def _places(self) -> dict[str, set[str]]:
        """worker -> keys of what it makes, and of our copies that it has made. The scheduler tells; {}: it does not."""
        keys = [copy.key for copies in self._open.values() for copy in copies]

        async def ask() -> Any:
            return await asyncio.gather(self._cluster.scheduler.processing(workers=None),
                                        self._cluster.scheduler.who_has(keys=keys))
        asking = asyncio.run_coroutine_threadsafe(ask(), self._cluster.loop.asyncio_loop)
        try:
            making, made = asking.result(self._patience)
        except LOST:        # what is late is dealt again all the same
            asking.cancel()
            return {}
        places = {worker: set(theirs) for worker, theirs in making.items()}
        for key, workers in made.items():
            for worker in workers:
                places.setdefault(worker, set()).add(key)
        return places

    def _silence(self) -> float:
        """Seconds after which an item is late, in which even a slow one is made, and at first the scene loaded."""
        if self._seconds:
            return max(self._patience, 3 * float(np.quantile(self._seconds, 0.99)))
        return 4 * self._patience + self._scene.bytes / LOAD_BYTES_PER_SECOND

    def _next(self) -> list[tuple[int, Any]]:
        try:
            item, copy, data = self._events.get(timeout=0.25)
        except queue.Empty:
            return self._look()
        if self._done[item] or copy not in self._open.get(item, {}):
            return []
        if data is None and copy.status == "finished":
            fetched = asyncio.run_coroutine_threadsafe(self._fetch(copy), self._cluster.loop.asyncio_loop)
            fetched.add_done_callback(lambda done: self._events.put((item, copy, done)))
            return []
        born = self._open[item].pop(copy)
        if data is None:
            return self._failed(item, copy)
        try:
            where, answer, notes = data.result()
        except LOST as error:   # the worker died with the answer, or cannot be reached
            return self._again(item, error)
        self._news = self._heard[where] = time.monotonic()
        if isinstance(answer, Missing):
            return self._send(item, answer)
        if not self._parts[item].fits(answer):
            return self._again(item, FailedError(f"{where} sent an answer of another form"))
        self._seconds.append(self._news - born)
        self.notes.update(dict.fromkeys(notes))
        return [(item, answer)]

    def _send(self, item: int, missing: Missing) -> list[tuple[int, Any]]:
        """Gives the workers what one has asked for, and deals its item again."""
        self._sends += 1
        if self._sends > SENDS_MAX + len(self._parts):
            return [(item, self._make(item, FailedError("the workers lose the scene's files again and again")))]
        try:
            if missing.silent:
                self._scene.send_anew(missing.keys)
            else:
                lively = self._lively() if self._scene.sending else None
                self._scene.send(self._cluster, missing.keys, self._fit(lively) or self._workers(), self._progress)
        except (OSError, asyncio.TimeoutError, RuntimeError, FailedError) as error:
            return self._again(item, error)
        self._news = time.monotonic()
        self._copies[item] -= 1
        self._deal(item)
        return []

    async def _fetch(self, copy: Any) -> Any:
        return (await self._cluster.gather([copy], direct=True, asynchronous=True))[0]

    def _failed(self, item: int, copy: Any) -> list[tuple[int, Any]]:
        if copy.status in ("cancelled", "lost"):
            return self._again(item, FailedError("the scheduler dropped it"))
        error = copy.exception()
        if isinstance(error, NoRoom):
            self._no_room[error.where.split()[-1]] = error
            self._copies[item] -= 1
            self._deal(item)
            self.notes[str(error)] = None
            return []
        if isinstance(error, _ONCE) or (isinstance(error, DeadlineError) and has_deadline(self._parts[item].options)):
            raise error
        if isinstance(error, ImportError):
            raise FailedError(f"the workers cannot run it: {error}; install python3-raynest {VERSION} on all hosts")
        return self._again(item, error)

    def _again(self, item: int, error: BaseException) -> list[tuple[int, Any]]:
        if self._cluster.status != "running":
            self._give_up_cluster(error)
        elif self._open.get(item):
            pass    # another copy is on its way
        elif self._copies[item] < COPIES_MAX:
            self._deal(item)
        else:
            return [(item, self._make(item, error))]
        return []

    def _look(self) -> list[tuple[int, Any]]:
        """Nothing came for a while: deals what is late again, to workers that were heard of since and have no
        copy of it: one may be stuck in an item and answer others."""
        now = time.monotonic()
        if self._cluster.status != "running":
            self._give_up_cluster(None)
            return []
        silence = self._silence()
        silent = now - self._news > silence
        lively = self._lively()
        places: Optional[dict[str, set[str]]] = None
        if silent and self._open and not self._workers():
            item = min(self._open)      # whoever joins later makes the others
            return [(item, self._make(item, FailedError("the cluster has no workers")))]
        for item in sorted(self._open):
            copies = self._open[item]
            if copies and now - max(copies.values()) < silence:
                continue
            if self._copies[item] < COPIES_MAX:
                places = self._places() if places is None else places
                able, keys = self._fit(lively or list(places)) or [], {copy.key for copy in copies}
                others = [worker for worker in able if worker in places and not keys & places[worker]]
                self._deal(item, others or lively or None)
            elif silent or not copies:
                return [(item, self._make(item))]
        return []

    def _give_up_cluster(self, error: Optional[BaseException]) -> None:
        if not self._alone:
            self._alone = True
            self.notes[f"the Dask scheduler went away: {self._left} of {len(self._parts)} items were made on this "
                       "machine"] = None

    def _make(self, item: int, error: Optional[BaseException] = None) -> Any:
        """The last resort: a daemon on this machine."""
        part = self._parts[item]
        try:
            _, answer, notes = make_item(VERSION, self._setup, part.source or self._source, self._method,
                                     None if part.rays is None else part.rays(), part.options)
        except Error as here:
            raise FailedError(f"no worker finished an item{_because(error)}, and this machine cannot make it: {here}"
                              ) from error
        if not self._alone:
            self.notes[f"no worker finished some items{_because(error)}; they were made on this machine"] = None
        self.notes.update(dict.fromkeys(notes))
        return answer


def _because(error: Optional[BaseException]) -> str:
    return "" if error is None else f" ({type(error).__name__}: {error})".replace("\n", " ")


def known_to(cluster: Any, scene: Prepared, setup: Setup, patience: float, progress: Any = None) -> Prepared:
    """The scene with the digest that all workers must agree on."""
    if not isinstance(cluster, distributed.Client):
        raise UsageError("the first argument is a distributed.Client, as Client('tcp://head:8786')")
    if cluster.status in ("closing", "closed"):
        raise UsageError("the Client is closed, or its scheduler went away: connect anew")
    if cluster.asynchronous:    # all that waits here would keep its loop from answering
        raise UsageError("the Client is asynchronous: give one made without asynchronous=True, or call this in another "
                         "thread, as asyncio.to_thread() does")

    def ask(method: Any) -> Any:
        def send(done: int, total: int, stage: str) -> None:
            if progress and stage == "sending":
                progress(done, total, stage)
        (_, answer), = Deal(cluster, setup, scene, method, [Part({}, source=scene.source)], patience, send).answers()
        return answer
    if scene.source.message is None:
        scene.found(ask(files_at))
    if not scene.source.digest:
        scene.learn(ask(info_of))
    return scene
