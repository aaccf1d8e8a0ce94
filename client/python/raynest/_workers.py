"""The side of the workers: a daemon for each host, and what an item of raynest.dask does there."""
from __future__ import annotations

import atexit
import ctypes
import fcntl
import hashlib
import os
import queue
import shutil
import stat
import subprocess
import tempfile
import threading
import time
from typing import Any, NamedTuple, Optional, Sequence, Union

import numpy as np

from ._requests.film import Layers
from ._version import VERSION
from .client import Client, connect
from .errors import BusyError, ConnectError, DeadlineError, Error, FailedError, InvalidError, UsageError
from .scene import Scene

try:
    import distributed as distributed
except ImportError:
    raise ImportError("raynest.dask needs Dask distributed: apt install python3-distributed python3-paramiko") from None

ITEM_SECONDS = 120.0       # after which an item's daemon counts as stuck
START_SECONDS = 60.0


class Setup(NamedTuple):
    """How a worker starts its daemon."""

    binary: str = ""           # raynestd; empty: RAYNESTD, else as found in PATH
    each: str = "host"         # one daemon per "host", or per "worker"
    options: tuple[str, ...] = ()


class Source(NamedTuple):
    """A scene as workers load it, and what its digest must be."""

    path: str
    load: tuple[tuple[str, Any], ...] = ()
    digest: str = ""


class Host:
    """The daemon of this host, and the connections of this process to it. Thread-safe."""

    def __init__(self, setup: Setup, key: str) -> None:
        self._setup = setup
        name = hashlib.sha256(repr((key, setup)).encode()).hexdigest()[:16]
        self.folder = os.path.join(tempfile.gettempdir(), f"raynest-dask-{os.getuid()}-{name}")
        self._private()
        self.uri = f"unix:{self.folder}/s"
        self._owned: Optional[int] = None       # descriptor of the lock, where this process starts the daemon
        self._process: Optional[subprocess.Popen[bytes]] = None
        self._mutex, self._mine = threading.Lock(), threading.local()

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
            self._mine.scenes = {}
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

    def _connect(self) -> Client:
        end = time.monotonic() + START_SECONDS
        while True:
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
            self._private()     # a worker that ends takes it away
            lock = os.open(self.folder + "/lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(lock)
                return
            self._owned = lock
            atexit.register(self._end)
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
        known: Optional[Scene] = self._mine.scenes.get(source)
        if known is not None:
            return known
        name = "dask-" + hashlib.sha256(repr(source._replace(digest="")).encode()).hexdigest()[:16]
        with open(self.folder + "/loading", "wb") as lock:  # the workers of a host load it once
            fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                scene = client.scene(name)
            except InvalidError:
                scene = client.load(source.path, name=name, **dict(source.load))
        digest = scene.info["hash"]
        if source.digest not in ("", digest):
            raise InvalidError(f"{here()} has another scene at {source.path}: {digest[:12]} in place of "
                               f"{source.digest[:12]}", "SCENE_UNKNOWN")
        self._mine.scenes[source] = scene
        return scene


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


def item(version: str, setup: Setup, source: Source, method: Any, rays: Any, options: dict[str, Any]) -> Any:
    """Makes an item: a method of Scene by its name, or a function (host, scene, options). Returns where, the
    answer, and the notes of the daemon."""
    if version != VERSION:
        raise UsageError(f"{here()} has RayNest {VERSION}, this client {version}: install one version on all hosts")
    host = _host(setup)
    for last in (False, True):
        try:
            scene = host.scene(source)
            notes: Sequence[str] = ()
            if callable(method):
                answer = method(host, scene, options)
            else:
                answer = getattr(scene, method)(*(() if rays is None else (rays,)),
                                                **{"deadline": ITEM_SECONDS, **options})
                notes = tuple(host.client().outcome.get("notes", ()))
            return here(), _plain(answer), notes
        except DeadlineError:
            host.end_stuck()
            raise
        except Error as error:
            if last or not (error.lost or isinstance(error, ConnectError)):
                raise
            host.drop()


def columns_of(version: str, setup: Setup, source: Source, rays: Any, options: dict[str, Any]) -> Any:
    """The columns of an item alone, as they stay on a worker."""
    return item(version, setup, source, "trace", rays, options)[1]


def digest_of(_at: Host, scene: Scene, _options: dict[str, Any]) -> str:
    return str(scene.info["hash"])


def command(host: Host, scene: Scene, options: dict[str, Any]) -> bytes:
    """A command of raynest with --part, run beside the daemon. Returns the bytes of its file."""
    with tempfile.TemporaryDirectory(dir=host.folder) as folder:
        output = os.path.join(folder, "part" + options["ending"])
        words = [output if word is None else scene.name if word == options["scene"] else word
                 for word in options["words"]]
        program = [os.path.join(os.path.dirname(host.binary()), "raynest"), "--server", host.uri, "--quiet", *words]
        try:
            done = subprocess.run(program, stdin=subprocess.DEVNULL, capture_output=True, check=False,
                                  timeout=ITEM_SECONDS)
        except OSError as error:
            raise FailedError(f"{here()} cannot start {program[0]}: {error.strerror}; install raynest there") from None
        except subprocess.TimeoutExpired:
            raise DeadlineError(f"{here()} was not ready after {ITEM_SECONDS:.0f} s") from None
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines()
            raise error_of(done.returncode, said[-1].removeprefix("raynest: ") if said else "it said nothing")
        with open(output, "rb") as file:
            return file.read()


def error_of(exit_code: int, message: str) -> Error:
    """The error of a command that ended with this code."""
    kinds = (UsageError, InvalidError, BusyError, DeadlineError, ConnectError)
    kind = next((each for each in kinds if each.exit_code == exit_code), FailedError)
    return kind(message)


def _plain(answer: Any) -> Any:
    """An answer as it travels: views of arrays lose what only their own daemon could tell."""
    if isinstance(answer, Layers):
        return dict(answer)
    return answer.view(np.ndarray) if isinstance(answer, np.ndarray) else answer
