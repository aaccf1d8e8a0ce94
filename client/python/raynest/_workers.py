"""The side of the workers: a daemon for each host, and what an item of raynest.dask does there."""
from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import functools
import io
import math
import os
import pickle
import threading
import time
import weakref
from typing import Any, Iterator, Mapping, Optional, Sequence

import numpy as np

from ._net.control import Message
from ._net.frame import Array
from ._notes import Told, rounding_of, tell, told_of
from ._own_daemon import NOBODY_WAITS, Daemon, Setup, distributed, dropped, here
from ._travel import LOST, Carried, Files, Missing, Source, fetch, keys_of_file, named
from ._requests.film import Layers
from ._requests.loads import Load, load_of_file
from ._version import VERSION
from .client import Client
from .errors import BusyError, CancelledError, ConnectError, Error, FailedError, InvalidError, UsageError, warnings_taken
from .scene import Scene

SCENES_MAX = 4             # that a thread holds
KEPT_SECONDS = 600.0        # that a host keeps a scene or a client's file which no item needs
FILES_BYTES_MAX = 1 << 30   # of clients, beyond which those that no item needs go
LOOK_SECONDS = 0.25        # between two looks whether an item's program has ended, or nobody waits for it
IDLE_SECONDS = 60.0         # after which a daemon ends where one of another setup begins
TURN_SECONDS = 0.05        # between two looks whether another thread has loaded


class NoRoom(BusyError):
    """A host has no memory for the scene, and `where` it is: others may have it."""

    where = ""


class OtherVersion(UsageError):
    """A host has another version than the client, and `where` it is."""

    where = ""


class Held:
    """Scenes and files that a thread has on its connection. Another one may let it go while the thread makes no item."""

    def __init__(self) -> None:
        self.making = threading.Lock()
        self.scenes: dict[str, Scene] = {}
        self.changed: tuple[str, Optional[Scene], int] = ("", None, 0)
        self.piece: tuple[str, Array] = ("", np.empty(0, np.uint8))     # of changes, that came last
        self.needed: set[str] = set()           # scenes of the item
        self.files: list[Any] = []              # of the item
        self.left = 0.0                         # when the last item ended

    def let_go(self) -> None:
        """Closes the scenes that the item does not need."""
        for name in self.scenes.keys() - self.needed:
            self.scenes.pop(name).close()
        log, scene, _ = self.changed
        if scene is not None and log not in self.needed:
            self.changed, self.piece = ("", None, 0), ("", np.empty(0, np.uint8))
            scene.close()


class Host(Daemon):
    """The daemon of this host, and the scenes that this process has there. Thread-safe."""

    def __init__(self, setup: Setup, key: str) -> None:
        super().__init__(setup, key)
        self._elsewhere: set[str] = set()       # scenes whose files are not at their path here
        self._threads: weakref.WeakSet[Held] = weakref.WeakSet()
        self._tidies = threading.Lock()         # held until what is kept now is looked at

    def greeted(self) -> None:
        self._held.scenes, self._held.changed = {}, ("", None, 0)

    @property
    def _held(self) -> Held:
        held: Optional[Held] = getattr(self._mine, "held", None)
        if held is None:
            self._mine.held = held = Held()
            self._threads.add(held)
        return held

    @contextlib.contextmanager
    def making(self) -> Iterator[None]:
        """While this thread makes an item, nobody lets go of what that needs."""
        held = self._held
        with held.making:
            try:
                yield
            finally:
                held.needed.clear()
                while held.files:
                    held.files.pop().close()
                held.left = time.monotonic()
                self._tidy_later()

    def _tidy_later(self) -> None:
        if self._tidies.acquire(blocking=False):
            timer = threading.Timer(KEPT_SECONDS, self._tidy)
            timer.daemon = True
            timer.start()

    def _tidy(self) -> None:
        self._tidies.release()
        with contextlib.suppress(Error, OSError):   # a daemon that is gone has nothing
            if self._let_go(time.monotonic() - KEPT_SECONDS) + self._remove_files(KEPT_SECONDS):
                self._tidy_later()

    def _let_go(self, since: float) -> int:
        """Closes the scenes of threads that have made no item since then. Returns how many threads have some."""
        have = 0
        for held in list(self._threads):
            if held.making.acquire(blocking=False):
                try:
                    with contextlib.suppress(Error):    # its connection is lost, and with that what it held
                        if held.left <= since:
                            held.let_go()
                finally:
                    held.making.release()
            have += bool(held.scenes or held.changed[1])
        return have

    def _remove_files(self, seconds: float) -> int:
        """Removes files of clients that no item has needed for so long, or that are too many. Returns how many are left."""
        with self._turn():
            found = sorted((each.stat().st_mtime, each.path, each.stat().st_size) for each in os.scandir(self.files))
            size, left = sum(size for *_, size in found), len(found)
            for used, path, bytes_ in found:
                if time.time() - used >= seconds or size > FILES_BYTES_MAX:
                    with open(path, "rb") as file, contextlib.suppress(BlockingIOError):    # an item of another worker has it
                        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                        os.unlink(path)
                        size, left = size - bytes_, left - 1
        return left

    def scene(self, source: Source) -> Scene:
        """The scene on the connection of this thread, which holds it; loads it where the daemon lacks it."""
        client, held = self.client(), self._held
        held.needed.add(source.log if source.changes else source.name)
        if source.changes:
            return self._changed(client, source)
        scenes = held.scenes
        scene = scenes.pop(source.name, None)
        if scene is None:
            with warnings_taken():      # the client tells them, once
                scene = self._load(client, source, source.name)
        scenes[source.name] = scene
        while len(scenes) > SCENES_MAX:
            scenes.pop(next(iter(scenes))).close()
        return scene

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """Lets one of all threads of the host's workers load, so that each scene is loaded once."""
        with open(self.folder + "/loading", "wb") as lock:
            while True:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                if dropped():
                    raise CancelledError(NOBODY_WAITS)
                time.sleep(TURN_SECONDS)
            yield

    def _load(self, client: Client, source: Source, name: str) -> Scene:
        assert source.message is not None
        files = Files(source, self._elsewhere)
        load = Load({**source.message, "name": name}, files.read, need=files.need)
        with self._turn():
            for last in (False, True):
                try:
                    scene, info = client._load(load)
                    break
                except (BusyError, MemoryError) as error:
                    if getattr(error, "name", "MEMORY") not in ("MEMORY", "QUOTA", "RESOURCE_EXHAUSTED"):
                        raise
                    if not last:    # those that no item needs make room
                        self._held.let_go()
                        self._let_go(math.inf)
                        continue
                    size = sum(size for _, size in source.files())
                    refused = NoRoom(f"{here()} has no room for the scene, whose files have {size / 1e6:.0f} MB: {error}",
                                     getattr(error, "name", ""))
                    refused.where = here()
                    raise refused from None
        if source.digest not in ("", info["hash"]):
            raise InvalidError(f"{here()} has another scene at {source.path}: {info['hash'][:12]} in place of "
                               f"{source.digest[:12]}", "SCENE_UNKNOWN")
        return scene

    @property
    def files(self) -> str:
        """The folder of files that only the client's machine had."""
        self._private()
        os.makedirs(folder := os.path.join(self.folder, "files"), exist_ok=True)
        return folder

    def local(self, sent: Any, source: Source) -> Any:
        """An argument of an item as it is here: the path of a file that was sent, another scene, or what it was."""
        if isinstance(sent, Source):
            return self.scene(sent._replace(sending=source.sending))
        return self._take(sent, source) if isinstance(sent, Carried) else sent

    def _take(self, carried: Carried, source: Source) -> str:
        path = os.path.join(self.files, carried.name)
        with self._turn():
            if not os.path.exists(path):
                with open(path + ".part", "wb") as file:
                    for piece in fetch(keys_of_file(carried.digest, carried.size, source.piece_bytes),
                                       source.piece_seconds, source.sending):
                        file.write(piece.data)
                os.replace(path + ".part", path)
            self._held.files.append(needed := open(path, "rb"))
            fcntl.flock(needed, fcntl.LOCK_SH)
            os.utime(path)
        self._remove_files(KEPT_SECONDS)
        return path

    def _changes(self, source: Source, made: int) -> Iterator[tuple[int, Any]]:
        """The changes from this number on. The last piece is kept: the next item may need more of it."""
        held, pieces = self._held, source.changes_since(made)
        known = held.piece if pieces and held.piece[0] == pieces[0][0] else None
        coming = fetch([key for key, _ in pieces[known is not None:]], source.piece_seconds, source.sending)
        for key, first in pieces:
            piece = known[1] if known else next(coming)
            held.piece, known = (key, piece), None
            file = io.BytesIO(piece.data)
            for number in range(first, source.changes):
                if file.tell() == len(piece):
                    break
                change = pickle.load(file)
                if number >= made and number not in source.refused:
                    yield number, change

    def _changed(self, client: Client, source: Source) -> Scene:
        """The scene with its changes, as this thread's own copy of it, to which each is made once, in their order."""
        held = self._held
        log, scene, made = held.changed
        held.changed = "", None, 0
        if scene is not None and (log != source.log or made > source.changes):
            scene.close()
            scene = None
        if scene is None:
            name = f"{source.name}-{source.log}-{os.getpid()}-{threading.get_ident()}"
            with warnings_taken():
                scene, made = self._load(client, source, name), 0
        try:
            for number, (change, added) in self._changes(source, made):
                try:
                    # They are held until the change is made; then the scene has what it takes of them.
                    held_for_it = [self._load(client, other._replace(sending=source.sending), other.name) for other in added]
                    change.apply(client.connection, scene.name)
                except (UsageError, InvalidError) as error:
                    if error.name != "SCENE_UNKNOWN":
                        error.raynest_refused = source.log, number      # type: ignore[union-attr]
                    raise
                del held_for_it
                made = number + 1
        except Missing:
            held.changed = source.log, scene, made
            raise
        except Error:
            scene.close()
            raise
        held.changed = source.log, scene, source.changes
        return scene


_hosts: dict[Any, Host] = {}
_hosts_lock = threading.Lock()


@contextlib.contextmanager
def _host(setup: Setup) -> Iterator[Host]:
    """The host of a worker's process, or of this program's, where it is none. Where another setup begins, daemons of others
    that have had nothing to do for a while end: they would keep their scenes as long as the worker lives."""
    try:
        worker = distributed.get_worker()
        key = worker.address if setup.each == "worker" else worker.scheduler.address
    except ValueError:
        key = f"client {os.getpid()}"
    setup = setup._replace(options=tuple(setup.options))    # whoever gives a list
    with _hosts_lock:
        if (setup, key) not in _hosts:
            for known, idle in list(_hosts.items()):
                if idle.end_if_idle(IDLE_SECONDS):
                    _hosts.pop(known)
            _hosts[setup, key] = Host(setup, key)
        host = _hosts[setup, key]
    with host.in_use():
        yield host


@dataclasses.dataclass(frozen=True)
class SentRays:
    """Rays of an item as arguments of trace(), and the options that each has for itself, as its mask."""

    rays: tuple[Any, ...]
    options: Mapping[str, Array]


def item(version: str, setup: Setup, source: Source, method: Any, rays: Any, options: dict[str, Any]
         ) -> tuple[str, Any, Told]:
    """Makes an item: a method of Scene by its name, a function (scene, rays, ...), or without rays a function (host, source,
    options). Returns where, the answer, which may be Missing, and what it tells."""
    if version != VERSION:
        refused = OtherVersion(f"{here()} has RayNest {VERSION}, this client {version}: install one version on all hosts")
        refused.where = here()
        raise refused
    with _host(setup) as host, host.making():
        return _made(host, source, method, rays, options)


def _made(host: Host, source: Source, method: Any, rays: Any, options: dict[str, Any]) -> tuple[str, Any, Told]:
    for last in (False, True):
        try:
            with warnings_taken() as warned:
                if callable(method) and rays is None:
                    answer = method(host, source, options)
                    return here(), answer, Told(tuple(warned), None, rounding_of(host.outcome))
                given = {name: host.local(value, source) for name, value in options.items()}
                sent = rays if isinstance(rays, SentRays) else SentRays(() if rays is None else (rays,), {})
                scene = host.scene(source)
                ask = functools.partial(method, scene) if callable(method) else getattr(scene, method)
                answer = ask(*sent.rays, **{**given, **sent.options})
                return here(), _plain(answer), told_of("trace" if callable(method) else method, warned, host.client().outcome)
        except Missing as missing:
            return here(), missing, Told()
        except Error as error:
            # The daemon may have begun anew, by another worker of this host, since it was given the scene.
            if last or not (error.lost or isinstance(error, ConnectError) or error.name == "SCENE_UNKNOWN"):
                raise
            host.drop()
    raise AssertionError


def columns_of(version: str, setup: Setup, source: Source, rays: Any, options: dict[str, Any], first: int, count: int,
               rounding: str, fit: Sequence[str]) -> Any:
    """The columns of an item alone, as they stay on a worker: rays `first`, ... What it tells is told by Dask, to all
    clients of the cluster, as nobody waits for it here. A worker that fails, or does not round so, leaves it to another one,
    of those that are `fit` if any are named."""
    try:
        _, answer, told = item(version, setup, source, "trace", rays, options)
        if isinstance(answer, Missing):
            raise FailedError(f"{here()} lacks the scene, and no other worker has its files any more: call arrays() again")
        if rounding not in ("", told.rounding):
            raise FailedError(f"{here()} rounds {told.rounding}, and those that were there first {rounding}, so its bytes differ")
    except Exception:
        _leave_to_others(fit)
        raise
    with warnings_taken() as said:
        tell([(first, told)], count)
    for text, category in said:
        distributed.worker.warn(f"rays {first} to {first + count - 1} of arrays(): {text}", category)
    return answer


def _leave_to_others(fit: Sequence[str]) -> None:
    """Has Dask make the task of this thread on another worker, where it has one, when it makes it again."""
    with contextlib.suppress(*LOST):
        worker: Any = distributed.get_worker()
        cluster: Any = distributed.get_client()
        there = cluster.sync(cluster.scheduler.identity)
        others = {each for each in there["workers"] if each in (fit or [each])} - {worker.address}
        if others:
            cluster.sync(cluster.scheduler.set_restrictions, worker={worker.get_current_task(): list(others)})


def files_at(_host: Host, source: Source, _options: dict[str, Any]) -> Message:
    """The Load of files that the client cannot read."""
    try:
        return named(load_of_file(source.path, "", **source.load).message)
    except Error as error:
        raise InvalidError(f"neither this machine nor {here()} can read the scene: {error}", error.name) from None


def info_of(host: Host, source: Source, _options: dict[str, Any]) -> dict[str, Any]:
    return host.scene(source).info


def paths_of(host: Host, source: Source, options: dict[str, Any]) -> list[str]:
    found: list[str] = host.scene(source).path_of(**options)
    return found


def _plain(answer: Any) -> Any:
    """An answer as it travels: views of arrays lose what only their own daemon could tell."""
    if isinstance(answer, Layers):
        return dict(answer)
    return answer.view(np.ndarray) if isinstance(answer, np.ndarray) else answer
