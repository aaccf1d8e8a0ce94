"""The side of the workers: a daemon for each host, and what an item of raynest.dask does there."""
from __future__ import annotations

import atexit
import contextlib
import ctypes
import dataclasses
import fcntl
import glob
import hashlib
import os
import pickle
import queue
import shutil
import stat
import subprocess
import tempfile
import threading
import time
from typing import Any, Iterator, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from ._net.control import Message
from ._net.frame import Array
from ._net.interrupts import Interrupts
from ._travel import PIECE_BYTES, PIECE_SECONDS, Missing, fetch, keys_of_changes, keys_of_file
from ._requests.film import Layers
from ._requests.loads import Load, load_of_file
from ._version import VERSION
from .client import Client, connect
from .errors import (BusyError, CancelledError, ConnectError, DeadlineError, Error, FailedError, InvalidError,
                     UsageError)
from .scene import Scene

try:
    import distributed as distributed
except ImportError:
    raise ImportError("raynest.dask needs Dask distributed: apt install python3-distributed python3-paramiko") from None

SCENES_MAX = 4             # that a thread holds
ITEM_SECONDS = 600.0       # after which an item's daemon counts as stuck
LOOK_SECONDS = 0.25        # between two looks whether an item's program has ended, or nobody waits for it
TURN_SECONDS = 0.05        # between two looks whether another thread has loaded
START_SECONDS = 60.0
LEFT_SECONDS = 3600.0      # after which the folder of a worker that is gone is taken away
NAME_LETTERS = 16          # of the folders, which tell them apart
NOBODY_WAITS = "nobody waits for the item any more"


class Setup(NamedTuple):
    """How a worker starts its daemon."""

    binary: str = ""           # raynestd; empty: RAYNESTD, else as found in PATH
    each: str = "host"         # one daemon per "host", or per "worker"
    options: tuple[str, ...] = ()


class Source(NamedTuple):
    """A scene as workers load it, and what its digest must be."""

    path: str                               # where a worker may have the same files; "": nowhere
    load: dict[str, Any] = {}               # more arguments of Client.load()
    message: Optional[Message] = None       # a Load with the files' digests; None: the files at `path` say them
    digest: str = ""
    log: str = ""                           # of its changes
    epoch: int = 0                          # how many of them have happened
    piece_bytes: int = PIECE_BYTES
    piece_seconds: float = PIECE_SECONDS
    sending: int = 0                        # of the pieces: counts when whoever has some of them is silent

    @property
    def name(self) -> str:
        """On the daemons."""
        assert self.message is not None
        return str(self.message["name"])

    def files(self) -> list[tuple[bytes, int]]:
        """Digests and sizes."""
        assert self.message is not None
        digests = self.message["file_digests"]
        return [(digests[32 * i:32 * i + 32], size) for i, size in enumerate(self.message["file_bytes"])]


class Carried(NamedTuple):
    """A word of a command that names a file of the client's machine."""

    prefix: str         # of the word, as "points="
    name: str           # the same on all hosts, as the parts must say the same request
    digest: bytes
    size: int


def named(message: Message) -> Message:
    """The message with a name that says what it loads; the scene goes with the connections that hold it."""
    content = {**message, "name": "", "replace": False, "share": [], "temporary": True}
    return {**content, "name": "dask-" + hashlib.sha256(repr(sorted(content.items())).encode()).hexdigest()[:16]}


class NoRoom(BusyError):
    """A host has no memory for the scene, and `where` it is: others may have it."""

    where = ""


class Leaving(Interrupts):
    """Ends a request whose item nobody waits for any more, as Ctrl-C does in the main thread: once, so that the
    connection can still cancel it at the daemon."""

    _left = ""

    def check(self) -> None:
        super().check()
        key = dropped()
        if key not in ("", self._left):
            self._left = key
            raise CancelledError(NOBODY_WAITS)


class Host:
    """The daemon of this host, and the connections of this process to it. Thread-safe."""

    def __init__(self, setup: Setup, key: str) -> None:
        self._setup = setup
        name = hashlib.sha256(repr((key, setup)).encode()).hexdigest()[:NAME_LETTERS]
        self.folder = os.path.join(tempfile.gettempdir(), f"raynest-dask-{os.getuid()}-{name}")
        self.uri = f"unix:{self.folder}/s"
        self._owned: Optional[int] = None       # descriptor of the lock, where this process starts the daemon
        self._process: Optional[subprocess.Popen[bytes]] = None
        self._mutex, self._mine = threading.Lock(), threading.local()
        self._elsewhere: set[str] = set()       # scenes whose files are not at their path here

    def _private(self) -> None:
        """Makes the folder, or checks that nobody else made it or may enter it."""
        try:
            os.mkdir(self.folder, 0o700)
        except FileExistsError:
            found = os.lstat(self.folder)
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
                raise FailedError(f"{self.folder} is not a private folder of this user: remove it") from None

    def client(self) -> Client:
        """The connection of this thread; starts the daemon where nobody answers."""
        known: Optional[Client] = getattr(self._mine, "client", None)
        if known is None:
            self._mine.client = known = self._connect()
            known.connection.interrupts = Leaving()
            self._mine.scenes, self._mine.changed = {}, ("", None, 0)
        return known

    def drop(self) -> None:
        """Forgets the connection of this thread, which is lost."""
        known, self._mine.client = getattr(self._mine, "client", None), None
        if known is not None:
            known.close()

    def end_stuck(self) -> None:
        """Ends a daemon that did not answer in ITEM_SECONDS, if it is this process's own."""
        self.drop()
        with self._mutex:
            if self._process is not None:
                self._process.kill()
                self._process.wait()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _take_away_left(self) -> None:
        """Removes the folders of workers that were killed: nobody has their locks any more."""
        for folder in glob.glob(glob.escape(self.folder[:-NAME_LETTERS]) + "*"):
            with contextlib.suppress(OSError):
                found = os.lstat(folder)
                if found.st_uid != os.getuid() or time.time() - found.st_mtime < LEFT_SECONDS:
                    continue
                with open(folder + "/lock", "ab") as lock:      # there is none where no daemon was started
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder)

    def _connect(self) -> Client:
        end = time.monotonic() + START_SECONDS
        while True:
            self._private()     # a worker that ends takes it away, and nobody else may put another in its place
            try:
                return connect(self.uri, reconnect=0)
            except ConnectError:
                if time.monotonic() > end:
                    raise
            with self._mutex:
                self._start_if_owner()
            time.sleep(0.02)

    def _start_if_owner(self) -> None:
        if self._owned is None:
            self._private()
            lock = os.open(self.folder + "/lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(lock)
                return
            self._owned = lock
            atexit.register(self._end)
            self._take_away_left()
        if self._process is None or self._process.poll() is not None:
            started: queue.SimpleQueue[Union[OSError, subprocess.Popen[bytes]]] = queue.SimpleQueue()
            # The system ends the daemon with the thread that started it, so that thread stays.
            threading.Thread(target=self._keep, args=(started,), daemon=True).start()
            process = started.get()
            if isinstance(process, OSError):
                raise FailedError(f"{here()} cannot start {self.binary()}: {process.strerror}; install raynest there, "
                                  "or say with binary= where raynestd is") from None
            self._process = process

    def binary(self) -> str:
        named = self._setup.binary or os.environ.get("RAYNESTD", "raynestd")
        return shutil.which(named) or named

    def _keep(self, started: queue.SimpleQueue[Any]) -> None:
        prctl, killed = ctypes.CDLL(None).prctl, 9
        ready = self.folder + "/ready"
        for leftover in (self.folder + "/s", ready):
            if os.path.lexists(leftover):
                os.unlink(leftover)
        with open(self.folder + "/log", "wb") as log:
            try:
                process = subprocess.Popen(
                    [self.binary(), "--listen", self.uri, "--http", "off", "--ready-file", ready, "--log-level",
                     "error", *self._setup.options], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                    preexec_fn=lambda: prctl(1, killed))  # PR_SET_PDEATHSIG
            except OSError as error:
                return started.put(error)
        while process.poll() is None and not os.path.exists(ready):
            time.sleep(0.01)
        started.put(process)
        process.wait()

    def scene(self, source: Source) -> Scene:
        """The scene on the connection of this thread, which holds it; loads it where the daemon lacks it."""
        client = self.client()
        if source.epoch:
            return self._changed(client, source)
        scenes: dict[str, Scene] = self._mine.scenes
        scene = scenes.pop(source.name, None) or self._load(client, source, source.name)
        scenes[source.name] = scene
        while len(scenes) > SCENES_MAX:
            scenes.pop(next(iter(scenes))).close()
        return scene

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """Of all threads of the host's workers one loads, so that each scene is loaded once."""
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
        load = Load({**source.message, "name": name}, lambda number: self._read(source, number))
        with self._turn():
            try:
                scene, info = client._load(load)
            except (BusyError, MemoryError) as error:
                if getattr(error, "name", "MEMORY") not in ("MEMORY", "QUOTA", "RESOURCE_EXHAUSTED"):
                    raise
                size = sum(size for _, size in source.files())
                refused = NoRoom(f"{here()} has no room for the scene, whose files have {size / 1e6:.0f} MB: {error}",
                                 getattr(error, "name", ""))
                refused.where = here()
                raise refused from None
        if source.digest not in ("", info["hash"]):
            raise InvalidError(f"{here()} has another scene at {source.path}: {info['hash'][:12]} in place of "
                               f"{source.digest[:12]}", "SCENE_UNKNOWN")
        return scene

    def _read(self, source: Source, number: int) -> Iterator[Array]:
        """A file that the daemon lacks: from the same path, if that has the same bytes, else from the cluster."""
        if source.path and source.name not in self._elsewhere:
            here = read_at(source)
            if here is not None and here.message["file_digests"] == (source.message or {})["file_digests"]:
                yield from here.read(number)
                return
            self._elsewhere.add(source.name)
        keys = keys_of_file(*source.files()[number], source.piece_bytes)
        yield from fetch(keys, source.piece_seconds, source.sending)

    def take(self, carried: Carried, folder: str, source: Source) -> None:
        """Has a file that only the client's machine had in the folder, under its name."""
        os.makedirs(folder, exist_ok=True)
        path = os.path.join(folder, carried.name)
        with self._turn():
            if os.path.exists(path):
                return
            with open(path + ".part", "wb") as file:
                for piece in fetch(keys_of_file(carried.digest, carried.size, source.piece_bytes),
                                   source.piece_seconds, source.sending):
                    file.write(piece.data)
            os.replace(path + ".part", path)

    def _changed(self, client: Client, source: Source) -> Scene:
        """The scene at an epoch, as this thread's own copy of it, to which each change is made once, in their order."""
        held: tuple[str, Optional[Scene], int] = self._mine.changed
        log, scene, epoch = held
        self._mine.changed = "", None, 0
        if scene is not None and (log != source.log or epoch > source.epoch):
            scene.close()
            scene = None
        if scene is None:
            name = f"{source.name}-{source.log}-{os.getpid()}-{threading.get_ident()}"
            scene, epoch = self._load(client, source, name), 0
        try:
            keys = keys_of_changes(source.log, epoch, source.epoch)
            for piece in fetch(keys, source.piece_seconds, source.sending):
                change, added = pickle.loads(piece.data)
                # They are held until the change is made; then the scene has what it takes of them.
                held_for_it = [self._load(client, other._replace(sending=source.sending), other.name) for other in added]
                change.apply(client.connection, scene.name)
                del held_for_it
                epoch += 1
        except Missing:
            self._mine.changed = source.log, scene, epoch
            raise
        except Error:
            scene.close()
            raise
        self._mine.changed = source.log, scene, epoch
        return scene


def read_at(source: Source) -> Optional[Load]:
    """A Load of the files at a source's path on this machine; None where they cannot be read."""
    try:
        return load_of_file(source.path, "", **source.load)
    except (Error, OSError):
        return None


def dropped() -> str:
    """The key of this thread's item, where its client has left it or has the answer from elsewhere; else ""."""
    try:
        worker: Any = distributed.get_worker()
        key: str = worker.get_current_task()
        return key if worker.state.tasks[key].state == "cancelled" else ""
    except (ValueError, LookupError, AttributeError):   # no item of a cluster, or another Dask
        return ""


_hosts: dict[Any, Host] = {}
_hosts_lock = threading.Lock()


def here() -> str:
    try:
        return f"the worker {distributed.get_worker().address}"
    except ValueError:
        return "this machine"


def _host(setup: Setup) -> Host:
    """The host of a worker's process, or of this program's, where it is none."""
    try:
        worker = distributed.get_worker()
        key = worker.address if setup.each == "worker" else worker.scheduler.address
    except ValueError:
        key = f"client {os.getpid()}"
    with _hosts_lock:
        if (setup, key) not in _hosts:
            _hosts[setup, key] = Host(setup, key)
        return _hosts[setup, key]


@dataclasses.dataclass(frozen=True)
class MaskedRays:
    """Rays of an item, with the mask of each."""

    rays: Any
    masks: Array


def item(version: str, setup: Setup, source: Source, method: Any, rays: Any, options: dict[str, Any]) -> Any:
    """Makes an item: a method of Scene by its name, or a function (host, source, options). Returns where, the
    answer, which may be Missing, and the notes of the daemon."""
    if version != VERSION:
        raise UsageError(f"{here()} has RayNest {VERSION}, this client {version}: install one version on all hosts")
    host = _host(setup)
    for last in (False, True):
        try:
            notes: Sequence[str] = ()
            if callable(method):
                answer = method(host, source, options)
            else:
                if isinstance(rays, MaskedRays):
                    rays, options = rays.rays, {**options, "mask": rays.masks}
                answer = getattr(host.scene(source), method)(*(() if rays is None else (rays,)),
                                                             **{"deadline": ITEM_SECONDS, **options})
                notes = tuple(host.client().outcome.get("notes", ()))
            return here(), _plain(answer), notes
        except Missing as missing:
            return here(), missing, ()
        except DeadlineError:
            if not has_deadline(options):
                host.end_stuck()
            raise
        except Error as error:
            # The daemon may have begun anew, by another worker of this host, since it was given the scene.
            if last or not (error.lost or isinstance(error, ConnectError) or error.name == "SCENE_UNKNOWN"):
                raise
            host.drop()


def has_deadline(options: Mapping[str, Any]) -> bool:
    """True if the user of an item has set it one."""
    return "deadline" in options or any(str(word).startswith("--deadline") for word in options.get("words", ()))


def columns_of(version: str, setup: Setup, source: Source, rays: Any, options: dict[str, Any]) -> Any:
    """The columns of an item alone, as they stay on a worker."""
    answer = item(version, setup, source, "trace", rays, options)[1]
    if isinstance(answer, Missing):
        raise FailedError(f"{here()} lacks the scene, and no other worker has its files: compute the arrays again")
    return answer


def files_at(_host: Host, source: Source, _options: dict[str, Any]) -> Message:
    """The Load of files that the client cannot read."""
    try:
        return named(load_of_file(source.path, "", **source.load).message)
    except Error as error:
        raise InvalidError(f"neither this machine nor {here()} can read the scene: {error}", error.name) from None


def info_of(host: Host, source: Source, _options: dict[str, Any]) -> dict[str, Any]:
    return host.scene(source).info


def _plain(answer: Any) -> Any:
    """An answer as it travels: views of arrays lose what only their own daemon could tell."""
    if isinstance(answer, Layers):
        return dict(answer)
    return answer.view(np.ndarray) if isinstance(answer, np.ndarray) else answer
