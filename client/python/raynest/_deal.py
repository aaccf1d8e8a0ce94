"""Deals items out to the workers of a Dask cluster, until each is answered whatever dies."""
from __future__ import annotations

import asyncio
import concurrent.futures
import os
import queue
import random
import threading
import time
from typing import AbstractSet, Any, Generator, NamedTuple, Optional, Sequence

import numpy as np

from ._copies import Came, Copy, Road, seldom_profiled, uncompressed
from ._travel import Missing
from ._prepared import Part, Prepared, at_their_epoch
from ._roster import Places, plain
from ._version import VERSION
from ._notes import Told, tell
from ._own_daemon import Setup, here, until_left
from ._requests.deadlines import deadline_of, share_of
from ._workers import NoRoom, OtherVersion, item as make_item
from ._wording import localize_message
from .errors import BY_EXIT_CODE, ConnectError, DeadlineError, Error, FailedError, InvalidError, RayWarning, UsageError, warn

COPIES_MAX = 3             # of an item on the workers, before it is made here
ASK_SECONDS = 1.0          # between two questions to the scheduler who makes what
HELD_MAX = 8               # times `patience` that a worker which fails gets nothing new
LOAD_BYTES_PER_SECOND = 5e6     # that even a slow host fetches and builds
SENDS_MAX = 100            # times that an item may find pieces of the scene missing
LATE_SECONDS = 2.0         # after a deadline that the answers of items may come whose share ended with it
HERE_MAX = 2               # items that wait for this machine's daemon, while no worker lives
_ONCE = (UsageError, InvalidError, TypeError)   # what another worker would answer alike


@seldom_profiled()
def sent_item(*arguments: Any) -> Any:
    """Makes an item on a worker: returns what make_item() returns, on its way to the client."""
    try:
        return uncompressed(make_item(*map(plain, arguments)))
    except Exception as error:
        error.raynest_where = here()    # type: ignore[attr-defined]
        raise


_own = concurrent.futures.ThreadPoolExecutor(1, "raynest-own-daemon")   # which makes what no worker finishes


class Failures(NamedTuple):
    """A worker's: how many items, how many since it made one, until when it gets none, and the last error."""

    items: int
    in_a_row: int
    until: float
    error: BaseException


class OtherRounding(FailedError):
    """A processor of another kind has made an answer."""


class Unable(FailedError):
    """A worker cannot even begin an item."""


_NO_GOOD = (NoRoom, OtherVersion, Unable)       # where all workers are so, nobody makes it


class Deal:
    """Deals items out to a cluster until each is answered. The first answer of an item counts. The items are parts of one
    request, or with `apart` requests of their own. While no worker lives, this machine makes them in turn."""

    def __init__(self, cluster: Any, setup: Setup, scene: Prepared, method: Any, parts: Sequence[Part], patience: float,
                 progress: Any, stage: str = "tracing", apart: bool = False) -> None:
        self._cluster, self._setup, self._scene, self._method = cluster, setup, scene, method
        self._parts, self._patience, self._progress, self._stage = at_their_epoch(scene, parts), patience, progress, stage
        self._apart = apart
        self._open: dict[int, dict[str, Copy]] = {}     # item -> its copies, by their keys
        self._copies = [0] * len(parts)
        self._left = len(parts)
        self._done = [False] * len(parts)
        self._next_item, self._turn = 0, iter(range(len(parts)))
        self._events: queue.SimpleQueue[tuple[int, str, Came]] = queue.SimpleQueue()
        self._heard: dict[str, float] = {}              # worker -> when it last answered
        self._seconds: list[float] = []                 # that items took
        self._news = time.monotonic()
        self._end = self._news + (not apart and deadline_of(parts[0].options) or np.inf)
        self._alone = self._nobody = False              # without a scheduler, or a worker that lives
        self._road = Road(cluster, patience)
        self._roster = self._road.roster
        self._sends = 0                                 # of pieces that were missing
        self._unfit: dict[str, Error] = {}              # worker -> why it gets nothing
        self._unable = ""                               # that a worker could not begin an item, and nobody knows which
        self._cannot: Optional[tuple[float, Error]] = None  # since when this machine cannot make an item, and why
        self._failures: dict[str, Failures] = {}        # by worker
        self._asked = self._looked = -np.inf
        self._here: dict[int, threading.Event] = {}     # items that this machine makes, and what leaves them
        self._told: dict[int, Told] = {}
        self.rounding, self._noted = scene.rounding, scene.noted    # of this request, whatever others of the scene find
        self.notes: dict[str, str] = {}                 # by what each is about

    def all(self) -> list[Any]:
        """The answers, in the order of their items."""
        found = dict(self.answers())
        return [found[item] for item in range(len(self._parts))]

    def answers(self) -> Generator[tuple[int, Any], None, None]:
        """Yields (item, answer) in any order. Leaving the loop cancels the rest."""
        answered = 0
        total = sum(part.weight for part in self._parts)
        try:
            while self._left:
                if time.monotonic() - self._looked > ASK_SECONDS:
                    self._look()
                self._deal_some()
                for item, answer in self._next():
                    self._done[item] = True
                    self._left -= 1
                    self._leave(item)
                    answered += self._parts[item].weight
                    if self._progress:
                        self._progress(answered, total, self._stage)
                    yield item, answer
        finally:
            for item in {*self._open, *self._here}:
                self._leave(item)
            self._tell()

    def _deal_some(self) -> None:
        """Deals what is next to the workers, or to this machine where there are none."""
        if time.monotonic() > self._end:
            return
        ahead = max(8, 3 * self._roster.threads(self._patience))
        while not (self._alone or self._nobody) and self._next_item < len(self._parts) and len(self._open) < ahead:
            item, self._next_item = self._next_item, self._next_item + 1
            if not self._done[item] and item not in self._here:
                self._deal(item, [self._parts[item].first])
        while (self._alone or self._nobody and not self._cannot) and len(self._here) < HERE_MAX:
            found = next((item for item in self._turn if not self._done[item] and item not in self._here), None)
            if found is None:
                break
            self._make_here(found, None if self._alone else FailedError(
                "no worker of the cluster is heard" if self._roster.now(self._patience) else "the cluster has no workers"))

    def _leave(self, item: int) -> None:
        """Ends all that makes an item."""
        for copy in self._open.pop(item, {}).values():
            copy.release()
        if item in self._here:
            self._here.pop(item).set()

    def _tell(self) -> None:
        for where, failures in self._failures.items():
            what = "an item" if failures.items == 1 else f"{failures.items} items"
            self.notes[where] = f"{where} failed at {what}{_because(failures.error)}, made elsewhere"
        for worker in self._roster.far():
            self._note(f"this machine cannot reach the worker {worker}: rays and answers go through the scheduler")
        if self._unable and not any(isinstance(why, Unable) for why in self._unfit.values()):
            self._note(self._unable)
        for about, note in self.notes.items():
            if about not in self._noted:
                self._noted.add(about)
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

    def _note(self, text: str) -> None:
        self.notes[text] = text

    def _fit(self) -> list[str]:
        """The workers that live, are not unfit, and do not fail, if there are any."""
        now = time.monotonic()
        held = {where.split()[-1] for where, failures in self._failures.items() if failures.until > now}
        fit = [worker for worker in self._roster.living(self._patience) if worker not in self._unfit]
        return [worker for worker in fit if worker not in held] or fit

    def good(self) -> list[str]:
        """The workers that live and neither are unfit nor fail; empty, if all are so, or none."""
        failing = {where.split()[-1] for where, failures in self._failures.items() if failures.in_a_row}
        good = [worker for worker in self._roster.living(self._patience) if worker not in self._unfit.keys() | failing]
        return good if len(good) < len(self._roster.now(self._patience)) else []

    def _deal(self, item: int, workers: Sequence[str] = ()) -> None:
        """To one of these workers, or of all."""
        if self._cluster.status != "running":   # all that follows would wait for it
            return self._give_up_cluster()
        part = self._parts[item]
        assert part.source is not None
        source = part.source._replace(sending=self._scene.sending)
        fit = self._fit()
        takers = [worker for worker in workers if worker in fit] or fit
        if self._unable:    # those that answered can; and one alone is known by its failure
            heard = {where.split()[-1] for where in self._heard}
            takers = [worker for worker in takers if worker in heard] or takers[:1]
        # A worker that joins may have it, too.
        to = takers if self._unable or len(takers) < len(self._roster.now(self._patience)) else None
        rays, options = None if part.rays is None else part.rays(), self._options(item)
        setup, method, cluster = self._setup, self._method, self._cluster

        def submit(rays: Any, key: str) -> Any:
            return cluster.submit(sent_item, VERSION, setup, source, method, rays, options, pure=False, retries=0,
                                  workers=to or None, key=key)
        key = f"raynest-{os.urandom(8).hex()}"
        events = self._events
        try:
            copy = Copy(self._road, submit, rays, self._taker(takers) if part.heavy else "", key,
                        lambda came: events.put((item, key, came)))
        except RuntimeError:    # its loop has ended
            return self._give_up_cluster()
        copy.only = takers[0] if to and len(takers) == 1 else ""
        self._copies[item] += 1
        self._open.setdefault(item, {})[key] = copy

    def _options(self, item: int) -> dict[str, Any]:
        """Those of an item, which may have its share of the time that is left."""
        part = self._parts[item]
        if part.late is None or not part.options.get("deadline"):
            return part.options
        share = share_of(self._end - time.monotonic(), self._roster.threads(self._patience), self._left)
        return {**part.options, "deadline": share}

    def _at_the_end(self) -> list[tuple[int, Any]]:
        """The answers of items at the request's deadline: of those that may have none, once nobody makes them, or lately did."""
        error = DeadlineError(localize_message("the request's deadline passed; pass a longer `deadline_ms`, or ask for less"), "DEADLINE")
        if self._parts[0].late is None:
            raise error
        waits = self._open.keys() | self._here.keys() if time.monotonic() < self._end + LATE_SECONDS else ()
        late = [item for item, done in enumerate(self._done) if not done and item not in waits]
        self._told.update((item, part.late) for item in late if (part := self._parts[item]).late is not None)
        return [(item, error) for item in late]

    def _taker(self, workers: Sequence[str]) -> str:
        """One of the workers, or of those of them that answered lately, that gets rays, the more often the more threads it
        has; "": there is none."""
        known, lively = self._roster.now(self._patience), self._lively()
        takers = [worker for worker in workers if worker in known and worker not in self._road.slow]
        takers = [worker for worker in takers if worker in lively] or takers
        return random.choices(takers, [known[worker]["nthreads"] for worker in takers])[0] if takers else ""

    def _lively(self) -> list[str]:
        """Addresses of the workers that answered lately."""
        since = self._news - self._silence()
        return [where.split()[-1] for where, heard in self._heard.items() if heard >= since]

    def _silence(self) -> float:
        """Seconds after which an item is late, in which even a slow one is made, and at first the scene loaded."""
        if self._seconds:
            return max(self._patience, 3 * float(np.quantile(self._seconds, 0.99)))
        return 4 * self._patience + self._scene.bytes / LOAD_BYTES_PER_SECOND

    def _next(self) -> list[tuple[int, Any]]:
        """Waits a while for an answer."""
        left = self._end - time.monotonic()
        if left < 0 and (late := self._at_the_end()):
            return late
        try:
            item, key, came = self._events.get(timeout=min(0.25, left) if left > 0 else 0.25)
        except queue.Empty:
            return []
        if self._done[item]:
            return []
        if key in self._open.get(item, ()):
            copy = self._open[item].pop(key)
        elif key:
            return []
        elif came.error is None:
            answer, told = came.answer
            self._told[item] = told
            return [(item, answer)]
        else:
            return self._not_made_here(item, came.error)
        if came.error is not None:
            return self._failed(item, came.error, copy.only) if came.failed else self._again(item, came.error)
        where, answer, told = came.answer
        self._news = self._heard[where] = time.monotonic()
        if isinstance(answer, Missing):
            return self._send(item, answer)
        try:
            self._check(item, where, answer, told)
        except OtherRounding as error:
            return self._leave_out(item, where, error)
        except FailedError as error:
            self._hold(where, error)
            return self._again(item, error)
        self._cannot = None
        self._seconds.append(self._news - copy.born)
        self._told[item] = told
        if where in self._failures:
            self._failures[where] = self._failures[where]._replace(in_a_row=0, until=-np.inf)
        return [(item, answer)]

    def _check(self, item: int, where: str, answer: Any, told: Told) -> None:
        """Raises FailedError for what is no answer of the item, whoever has made it."""
        if isinstance(answer, Missing):
            raise FailedError(f"{where} cannot read {self._scene.source.path or 'the files of the scene'}")
        if not self._parts[item].fits(answer):
            raise FailedError(f"{where} sent an answer of another form")
        if told.rounding and self.rounding.setdefault("how", told.rounding) != told.rounding:
            raise OtherRounding(f"{where} is left out: it rounds {told.rounding}, and those that began {self.rounding['how']}, "
                                "so its bytes differ")

    def _leave_out(self, item: int, where: str, why: Error) -> list[tuple[int, Any]]:
        """A worker that is no good for the scene; another one makes the item."""
        self._unfit[where.split()[-1]] = why
        self.notes.setdefault(f"{where} is left out", str(why))     # its threads may each say it in other figures
        self._copies[item] -= 1
        self._look()
        return self._again(item, why)

    def _send(self, item: int, missing: Missing) -> list[tuple[int, Any]]:
        """Gives the workers what one has asked for, and deals its item again."""
        self._sends += 1
        if self._sends > SENDS_MAX + len(self._parts):
            return self._make_here(item, FailedError("the workers lose the scene's files again and again"))
        try:
            if missing.silent:
                self._scene.send_anew(missing.keys)
            else:
                fit, lively = self._fit(), self._lively() if self._scene.sending else ()
                self._scene.send(self._cluster, missing.keys, [worker for worker in fit if worker in lively] or fit,
                                 self._progress)
        except (OSError, asyncio.TimeoutError, RuntimeError, FailedError) as error:
            return self._again(item, error)
        self._news = time.monotonic()
        self._copies[item] -= 1
        self._deal(item)
        return []

    def _failed(self, item: int, error: BaseException, only: str = "") -> list[tuple[int, Any]]:
        """`only` is the worker that had it, if no other one could."""
        if isinstance(error, (NoRoom, OtherVersion)):
            return self._leave_out(item, error.where, error)
        late, where = self._parts[item].late, getattr(error, "raynest_where", "")
        if isinstance(error, DeadlineError) and late is not None:
            self._told[item] = late
            return [(item, error)]
        if not where and isinstance(error, (AttributeError, TypeError, ImportError)):   # it could not even begin
            unable = f" cannot run it: {error}; install python3-raynest {VERSION} on all hosts"
            if only:    # a request is dealt in several turns, of which one may not know who it was: it is told once
                self._noted.add(f"{only} is left out" if f"a worker{unable}" in self._noted else f"a worker{unable}")
                return self._leave_out(item, only, Unable(f"the worker {only}{unable}"))
            self._copies[item] -= not self._unable
            self._unable = f"a worker{unable}"
            return self._again(item, error)
        if isinstance(error, _ONCE) or (isinstance(error, DeadlineError) and deadline_of(self._parts[item].options)):
            told = self._scene.refused(error) if isinstance(error, Error) else error
            raise of_scan(item, told) if self._apart else told
        if where:
            self._hold(where, error)
        return self._again(item, error)

    def _hold(self, where: str, error: BaseException) -> None:
        """Has a worker that failed get nothing for a while: it fails at once, so it would get all that others are too slow for."""
        before = self._failures.get(where, Failures(0, 0, 0.0, error))
        holds = self._patience * min(2 ** before.in_a_row, HELD_MAX)
        self._failures[where] = Failures(before.items + 1, before.in_a_row + 1, time.monotonic() + holds, error)

    def _again(self, item: int, error: BaseException) -> list[tuple[int, Any]]:
        if self._cluster.status != "running":
            self._give_up_cluster()
        elif self._open.get(item) or self._nobody:
            pass    # another copy is on its way, or this machine makes it in its turn
        elif time.monotonic() > self._end:
            self._open.pop(item, None)      # nobody makes it any more
        elif self._copies[item] < COPIES_MAX:
            self._deal(item)
        else:
            self._make_here(item, error)
        return []

    def _look(self) -> None:
        """Sees whether any worker lives. Deals again what is late and no living worker makes, and what takes far longer than
        others did and a worker with a free thread could make. One may be stuck in an item and answer others."""
        now = self._looked = time.monotonic()
        if self._cluster.status != "running":
            return self._give_up_cluster()
        living, silence = self._roster.living(self._patience), self._silence()
        joining = self._patience if self._seconds else 4 * self._patience     # they may come right behind the request
        self._nobody = not living.keys() - self._unfit and (
            bool(self._roster.now(self._patience)) or now - self._roster.none_since > joining)
        if living and self._nobody and all(isinstance(self._unfit[worker], _NO_GOOD) for worker in living):
            self.notes.clear()      # the error says it
            raise self._unfit[next(iter(living))]
        if self._nobody and self._cannot and now - self._cannot[0] > 4 * self._patience:
            raise self._cannot[1]
        late = [item for item, copies in sorted(self._open.items())
                if item not in self._here and not (copies and now - max(copy.born for copy in copies.values()) < silence)]
        if self._nobody or not late or now - self._asked < ASK_SECONDS:
            return
        keys = [key for copies in self._open.values() for key in copies]
        places, self._asked = self._roster.places(keys, self._patience), now
        for item in late:
            copies = self._open[item]
            is_made = places is not None and any(
                copies[key].onto in ("", *living) for worker, theirs in places.making.items() if worker in living
                for key in copies.keys() & theirs)
            if self._copies[item] < COPIES_MAX:
                others = self._without(copies.keys(), places, is_made)
                if others or not is_made:
                    self._deal(item, others or self._lively())
            elif not is_made and (now - self._news > silence or not copies):
                self._make_here(item)

    def _without(self, keys: AbstractSet[str], places: Optional[Places], must_be_free: bool) -> list[str]:
        """Living workers that have none of these copies, and a free thread, if that `must` be."""
        if places is None or must_be_free and not self._seconds:
            return []
        workers = self._roster.now(self._patience)
        return [worker for worker in self._fit() if not places.have(worker, keys)
                and not (must_be_free and len(places.making.get(worker, ())) >= workers[worker]["nthreads"])]

    def _give_up_cluster(self) -> None:
        if self._alone:
            return
        if self._cluster.status in ("closing", "closed") and self._cluster.scheduler_comm is not None:
            raise UsageError("the Client was closed before its request was done: keep it open until then")
        self._alone = True
        self._note("the Dask scheduler went away: the rest was made on this machine")

    def _make_here(self, item: int, error: Optional[BaseException] = None) -> list[tuple[int, Any]]:
        """The last resort: a daemon on this machine. Answers of the workers are taken meanwhile."""
        if item not in self._here:
            self._here[item] = left = threading.Event()
            _own.submit(self._make, item, error, left)
        return []

    def _not_made_here(self, item: int, error: BaseException) -> list[tuple[int, Any]]:
        """Raises the error, unless this machine alone is no good for the item, and a worker may come yet."""
        if self._alone or not self._nobody or type(error) not in (FailedError, ConnectError):
            raise of_scan(item, error) if self._apart and isinstance(error, Error) else error
        assert isinstance(error, Error)
        self._cannot = self._cannot or (time.monotonic(), error)
        self._here.pop(item, None)
        self._open.setdefault(item, {})     # for who comes
        return []

    def _make(self, item: int, error: Optional[BaseException], left: threading.Event) -> None:
        part = self._parts[item]
        assert part.source is not None
        if left.is_set():
            return
        try:
            with until_left(left):
                where, answer, told = make_item(VERSION, self._setup, part.source, self._method,
                                                None if part.rays is None else part.rays(), self._options(item))
            self._check(item, where, answer, told)
            came = Came((answer, told))
        except DeadlineError as own:
            came = Came((own, part.late)) if part.late is not None else Came(None, own)
        except Error as own:
            why = self._scene.refused(own)
            made = BY_EXIT_CODE.get(why.exit_code, FailedError)(
                f"no worker finished an item{_because(error)}, and this machine cannot make it: {why}", why.name, why.code)
            made.__cause__ = error
            came = Came(None, made)
        except BaseException as own:
            came = Came(None, own.with_traceback(None))
        if not (self._alone or came.error):
            self._note(f"no worker finished some items{_because(error)}; they were made on this machine")
        self._events.put((item, "", came))


def of_scan(number: int, error: Exception) -> Exception:
    """The error of a scan among several, which it names."""
    text = f"scans[{number}]: {error}"
    return type(error)(text, error.name, error.code) if isinstance(error, Error) else type(error)(text)


def _because(error: Optional[BaseException]) -> str:
    return "" if error is None else f" ({type(error).__name__}: {error})".replace("\n", " ")
