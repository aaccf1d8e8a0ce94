"""Deals items out to the workers of a Dask cluster, until each is answered whatever dies."""
from __future__ import annotations

import asyncio
import concurrent.futures
import queue
import random
import threading
import time
from typing import Any, Callable, Iterator, NamedTuple, Optional, Sequence

import numpy as np

from ._copies import Copy, Road, seldom_profiled, uncompressed
from ._travel import LOST, Missing
from ._prepared import Prepared
from ._roster import Roster
from ._version import VERSION
from ._notes import Told, tell
from ._own_daemon import Setup, distributed, here, until_left
from ._workers import NoRoom, Source, files_at, has_deadline, info_of, item as make_item
from .errors import BY_EXIT_CODE, DeadlineError, Error, FailedError, InvalidError, RayWarning, UsageError, warn

PATIENCE = 4.0             # s of silence after which open items are dealt again
COPIES_MAX = 3             # of an item on the workers, before it is made here
ASK_SECONDS = 1.0          # between two questions to the scheduler who makes what
HELD_MAX = 8               # times `patience` that a worker which fails gets nothing new
LOAD_BYTES_PER_SECOND = 5e6     # that even a slow host fetches and builds
SENDS_MAX = 100            # times that an item may find pieces of the scene missing
_ONCE = (UsageError, InvalidError)  # what another worker would answer alike


@seldom_profiled()
def sent_item(*arguments: Any) -> Any:
    """Makes an item on a worker: returns what make_item() returns, on its way to the client."""
    try:
        return uncompressed(make_item(*arguments))
    except Exception as error:
        error.raynest_where = here()    # type: ignore[attr-defined]
        raise


_own = concurrent.futures.ThreadPoolExecutor(1, "raynest-own-daemon")   # which makes what no worker finishes


class Part(NamedTuple):
    """An item: a method of Scene and its arguments. `rays` is called when the item is dealt."""

    options: dict[str, Any]
    rays: Optional[Callable[[], Any]] = None
    heavy: bool = False        # its rays travel from here to the worker, not through the scheduler
    weight: int = 1            # rays or samples, for progress
    source: Optional[Source] = None     # other than the deal's
    fits: Callable[[Any], bool] = lambda answer: True   # says whether an answer may be the item's
    late: Optional[Told] = None         # what is told where its deadline passes; its answer is the error then


class Places(NamedTuple):
    """Where copies of items are, by the scheduler."""

    making: dict[str, set[str]]     # worker -> keys that it makes, or has in its queue
    made: dict[str, set[str]]       # worker -> keys of our copies that it has made

    def have(self, worker: str, keys: set[str]) -> bool:
        return bool(keys & (self.making.get(worker, set()) | self.made.get(worker, set())))


class Failures(NamedTuple):
    """A worker's: how many items, how many since it made one, until when it gets none, and the last error."""

    items: int
    in_a_row: int
    until: float
    error: BaseException


class Deal:
    """Deals items out to a cluster until each is answered. The first answer of an item counts. The items are parts of one
    request, or with `apart` requests of their own."""

    def __init__(self, cluster: Any, setup: Setup, scene: Prepared, method: Any, parts: Sequence[Part], patience: float,
                 progress: Any, stage: str = "tracing", apart: bool = False) -> None:
        self._cluster, self._setup, self._scene, self._method = cluster, setup, scene, method
        self._source = scene.at(scene.epoch)
        self._parts, self._patience, self._progress, self._stage = parts, patience, progress, stage
        self._apart = apart
        self._open: dict[int, set[Copy]] = {}           # item -> its copies
        self._copies = [0] * len(parts)
        self._left = len(parts)
        self._done = [False] * len(parts)
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._heard: dict[str, float] = {}              # worker -> when it last answered
        self._seconds: list[float] = []                 # that items took
        self._news = time.monotonic()
        self._alone = False
        self._roster, self._road = Roster(cluster, patience), Road(cluster, patience)
        self._sends = 0                                 # of pieces that were missing
        self._no_room: dict[str, NoRoom] = {}           # worker -> why it cannot have the scene
        self._failures: dict[str, Failures] = {}        # by worker
        self._beats: dict[str, tuple[Any, float]] = {}  # worker -> when the scheduler heard it, and when we learned that
        self._asked = self._looked = -np.inf
        self._here: dict[int, Any] = {}                 # items that this machine makes
        self._left_here = threading.Event()
        self._told: dict[int, Told] = {}
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
                    for item in (item for item, done in enumerate(self._done) if not done):
                        self._make_here(item)
                found = self._next()
                for item, answer in found:
                    if self._done[item]:
                        continue
                    self._done[item] = True
                    self._left -= 1
                    for copy in self._open.pop(item, ()):
                        copy.release()
                    answered += self._parts[item].weight
                    if self._progress:
                        self._progress(answered, total, self._stage)
                    yield item, answer
        finally:
            for copies in self._open.values():
                for copy in copies:
                    copy.release()
            self._left_here.set()
            for made in self._here.values():
                made.cancel()
            self._tell()

    def _tell(self) -> None:
        for where, failures in self._failures.items():
            what = "an item" if failures.items == 1 else f"{failures.items} items"
            self.notes[f"{where} failed at {what}{_because(failures.error)}, made elsewhere"] = None
        for note in self.notes:
            if note not in self._scene.noted:
                self._scene.noted.add(note)
                warn(note, RayWarning)
        if self._left:
            return      # an error says more
        rays = [part.weight for part in self._parts]
        if self._apart:
            for item, told in sorted(self._told.items()):
                tell([(0, told)], rays[item])
        else:
            firsts = np.concatenate([[0], np.cumsum(rays)]).tolist()
            tell([(firsts[item], told) for item, told in sorted(self._told.items())], firsts[-1])

    def _workers(self) -> dict[str, Any]:
        return self._roster.now()

    def _threads(self) -> list[int]:
        return [worker["nthreads"] for worker in self._workers().values()]

    def _fit(self, workers: Optional[list[str]]) -> Optional[list[str]]:
        """Those of the workers, or of all, that have room for the scene, and do not fail, if there are any; None: any."""
        now = time.monotonic()
        held = {where.split()[-1] for where, failures in self._failures.items() if failures.until > now}
        if not self._no_room and not held:
            return workers
        fit = [worker for worker in self._workers() if worker not in self._no_room]
        fit = [worker for worker in fit if worker not in held] or fit
        return [worker for worker in workers or () if worker in fit] or fit

    def _deal(self, item: int, workers: Optional[list[str]] = None) -> None:
        if self._cluster.status != "running":   # all that follows would wait for it
            return self._give_up_cluster(None)
        part = self._parts[item]
        source = (part.source or self._source)._replace(sending=self._scene.sending)
        workers = self._fit(workers)
        if workers == [] and self._no_room:
            raise next(iter(self._no_room.values()))
        rays = None if part.rays is None else part.rays()

        def submit(rays: Any, key: str) -> Any:
            return self._cluster.submit(sent_item, VERSION, self._setup, source, self._method, rays, part.options, pure=False,
                                        retries=0, workers=workers or None, key=key)
        try:
            copy = Copy(self._road, submit, rays, self._taker(workers) if part.heavy else "")
        except RuntimeError as error:   # its loop has ended
            return self._give_up_cluster(error)
        self._copies[item] += 1
        self._open.setdefault(item, set()).add(copy)
        copy.when_back(lambda done: self._events.put((item, copy, done)))

    def _taker(self, workers: Optional[list[str]]) -> str:
        """A worker that gets rays, the more often the more threads it has; "": there is none."""
        known = self._workers()
        takers = [worker for worker in workers or self._lively() or known if worker in known and worker not in self._road.slow]
        return random.choices(takers, [known[worker]["nthreads"] for worker in takers])[0] if takers else ""

    def _lively(self) -> list[str]:
        """Addresses of the workers that answered lately."""
        since = self._news - self._silence()
        return [where.split()[-1] for where, heard in self._heard.items() if heard >= since]

    def _places(self) -> Optional[Places]:
        """Asks the scheduler; None: it does not tell."""
        keys = [copy.key for copies in self._open.values() for copy in copies]

        async def ask() -> Any:
            told = self._cluster.scheduler
            return await asyncio.gather(told.processing(workers=None), told.who_has(keys=keys), self._roster.ask())
        asking = asyncio.run_coroutine_threadsafe(ask(), self._cluster.loop.asyncio_loop)
        try:
            making, made, workers = asking.result(self._patience)
        except LOST:        # what is late is dealt again all the same
            asking.cancel()
            return None
        self._hear(workers)
        places = Places({worker: set(theirs) for worker, theirs in making.items()}, {})
        for key, makers in made.items():
            for worker in makers:
                places.made.setdefault(worker, set()).add(key)
        return places

    def _hear(self, workers: dict[str, Any]) -> None:
        """Notes which workers the scheduler has heard since. Its clock may be another than ours."""
        now = time.monotonic()
        for worker, said in workers.items():
            if self._beats.get(worker, (None,))[0] != said.get("last_seen"):
                self._beats[worker] = said.get("last_seen"), now

    def _living(self, worker: str) -> bool:
        """True if the scheduler has heard it lately, and has not let it go."""
        workers = self._workers()
        beat: float = distributed.scheduler.heartbeat_interval(len(workers))
        heard = self._beats.get(worker, (None, -np.inf))[1]
        return worker in workers and time.monotonic() - heard < self._patience + ASK_SECONDS + 2 * beat

    def _silence(self) -> float:
        """Seconds after which an item is late, in which even a slow one is made, and at first the scene loaded."""
        if self._seconds:
            return max(self._patience, 3 * float(np.quantile(self._seconds, 0.99)))
        return 4 * self._patience + self._scene.bytes / LOAD_BYTES_PER_SECOND

    def _next(self) -> list[tuple[int, Any]]:
        if time.monotonic() - self._looked > ASK_SECONDS:
            self._look()
        try:
            item, copy, data = self._events.get(timeout=0.25)
        except queue.Empty:
            self._look()
            return []
        if self._done[item]:
            return []
        if copy is None:
            answer, self._told[item] = data.result()
            return [(item, answer)]
        if copy not in self._open.get(item, ()):
            return []
        self._open[item].remove(copy)
        if copy.made is not None and copy.made.status != "finished":
            return self._failed(item, copy.made)
        try:
            where, answer, told = data.result()
        except LOST as error:   # the worker died with the answer, or cannot be reached
            copy.release()
            return self._again(item, error)
        self._news = self._heard[where] = time.monotonic()
        if isinstance(answer, Missing):
            return self._send(item, answer)
        if not self._parts[item].fits(answer):
            return self._again(item, FailedError(f"{where} sent an answer of another form"))
        self._seconds.append(self._news - copy.born)
        self._told[item] = told
        if where in self._failures:
            self._failures[where] = self._failures[where]._replace(in_a_row=0, until=-np.inf)
        return [(item, answer)]

    def _send(self, item: int, missing: Missing) -> list[tuple[int, Any]]:
        """Gives the workers what one has asked for, and deals its item again."""
        self._sends += 1
        if self._sends > SENDS_MAX + len(self._parts):
            return self._make_here(item, FailedError("the workers lose the scene's files again and again"))
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

    def _failed(self, item: int, made: Any) -> list[tuple[int, Any]]:
        if made.status != "error":
            return self._again(item, FailedError("the scheduler dropped it"))
        error = made.exception()
        if isinstance(error, NoRoom):
            self._no_room[error.where.split()[-1]] = error
            self._copies[item] -= 1
            self._deal(item)
            self.notes[str(error)] = None
            return []
        late = self._parts[item].late
        if isinstance(error, DeadlineError) and late is not None:
            self._told[item] = late
            return [(item, error)]
        if isinstance(error, _ONCE) or (isinstance(error, DeadlineError) and has_deadline(self._parts[item].options)):
            raise error
        if isinstance(error, ImportError):
            raise FailedError(f"the workers cannot run it: {error}; install python3-raynest {VERSION} on all hosts")
        where = getattr(error, "raynest_where", "")
        if where:   # it fails at once, so it would get all items that the others are too slow for
            before = self._failures.get(where, Failures(0, 0, 0.0, error))
            holds = self._patience * min(2 ** before.in_a_row, HELD_MAX)
            self._failures[where] = Failures(before.items + 1, before.in_a_row + 1, time.monotonic() + holds, error)
        return self._again(item, error)

    def _again(self, item: int, error: BaseException) -> list[tuple[int, Any]]:
        if self._cluster.status != "running":
            self._give_up_cluster(error)
        elif self._open.get(item):
            pass    # another copy is on its way
        elif self._copies[item] < COPIES_MAX:
            self._deal(item)
        else:
            self._make_here(item, error)
        return []

    def _look(self) -> None:
        """Deals again what is late and no living worker makes, and what takes far longer than others did and a worker
        with a free thread could make. One may be stuck in an item and answer others."""
        now = self._looked = time.monotonic()
        if self._cluster.status != "running":
            return self._give_up_cluster(None)
        self._hear(self._workers())
        silence = self._silence()
        silent = now - self._news > silence
        if silent and self._open and not self._workers():
            if not self._here:      # whoever joins later makes the others
                self._make_here(min(self._open), FailedError("the cluster has no workers"))
            return
        late = [item for item, copies in sorted(self._open.items())
                if item not in self._here and not (copies and now - max(copy.born for copy in copies) < silence)]
        if not late or now - self._asked < ASK_SECONDS:
            return
        places, self._asked = self._places(), now
        for item in late:
            keys = {copy.key for copy in self._open[item]}
            is_made = places is not None and any(
                copy.key in theirs and self._living(worker) and (not copy.onto or self._living(copy.onto))
                for copy in self._open[item] for worker, theirs in places.making.items())
            if self._copies[item] < COPIES_MAX:
                others = self._without(keys, places, is_made)
                if others or not is_made:
                    self._deal(item, others or self._lively() or None)
            elif not is_made and (silent or not keys):
                self._make_here(item)

    def _without(self, keys: set[str], places: Optional[Places], must_be_free: bool) -> list[str]:
        """Living workers that have none of these copies, and a free thread, if that `must` be."""
        if places is None or must_be_free and not self._seconds:
            return []
        workers = self._workers()
        return [worker for worker in self._fit(list(workers)) or () if self._living(worker) and worker in workers
                and not places.have(worker, keys)
                and not (must_be_free and len(places.making.get(worker, ())) >= workers[worker]["nthreads"])]

    def _give_up_cluster(self, error: Optional[BaseException]) -> None:
        if not self._alone:
            self._alone = True
            self.notes["the Dask scheduler went away: the rest was made on this machine"] = None

    def _make_here(self, item: int, error: Optional[BaseException] = None) -> list[tuple[int, Any]]:
        """The last resort: a daemon on this machine. Answers of the workers are taken meanwhile."""
        if item not in self._here:
            self._here[item] = made = _own.submit(self._make, item, error)
            made.add_done_callback(lambda done: None if done.cancelled() else self._events.put((item, None, done)))
        return []

    def _make(self, item: int, error: Optional[BaseException]) -> tuple[Any, Told]:
        part = self._parts[item]
        try:
            with until_left(self._left_here):
                _, answer, told = make_item(VERSION, self._setup, part.source or self._source, self._method,
                                            None if part.rays is None else part.rays(), part.options)
        except Error as own:
            if isinstance(own, DeadlineError) and part.late is not None:
                return own, part.late
            raise BY_EXIT_CODE.get(own.exit_code, FailedError)(
                f"no worker finished an item{_because(error)}, and this machine cannot make it: {own}", own.name, own.code
            ) from error
        if not self._alone:
            self.notes[f"no worker finished some items{_because(error)}; they were made on this machine"] = None
        return answer, told


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

    scene.noted.clear()

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
