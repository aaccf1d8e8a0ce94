"""The daemon of a host: who starts it, finds it stuck and ends it, among all workers that share its folder."""
from __future__ import annotations

import atexit
import contextlib
import ctypes
import fcntl
import glob
import hashlib
import os
import queue
import shutil
import signal
import socket
import stat
import struct
import subprocess
import tempfile
import threading
import time
from typing import Any, Iterator, Mapping, NamedTuple, Optional, Union

from ._limits import window_bytes
from ._net.access import find_access
from ._net.interrupts import Interrupts
from .client import Client
from .errors import CancelledError, ConnectError, Error, FailedError

try:
    import distributed as distributed
except ImportError:
    raise ImportError("raynest.dask needs Dask distributed: apt install python3-distributed python3-paramiko") from None

DAEMON_SECONDS = 1.0       # between two looks whether a daemon answers while it makes an item
GREETING_SECONDS = 4.0     # that one may take to greet, whatever else its host does
SILENT_LOOKS = 2           # in a row, after which it counts as stuck
START_SECONDS = 60.0       # until a daemon is ready
LEFT_SECONDS = 3600.0      # after which the folder of a worker that is gone is taken away
NAME_LETTERS = 16          # of a folder's name, which tell it from others of its host
NOBODY_WAITS = "nobody waits for the item any more"


class Setup(NamedTuple):
    """How a worker starts its daemon."""

    binary: str = ""           # raynestd; empty: RAYNESTD, else as found in PATH
    each: str = "host"         # one daemon per "host", or per "worker"
    options: tuple[str, ...] = ()


class Leaving(Interrupts):
    """Ends a request whose item nobody waits for any more, as Ctrl-C does in the main thread: once, so that the
    connection can still cancel it at the daemon. Ends one whose daemon is stuck, too."""

    _left = ""

    def __init__(self, daemon: Daemon) -> None:
        super().__init__()
        self._daemon = daemon

    def check(self) -> None:
        super().check()
        key = dropped()
        if key not in ("", self._left):
            self._left = key
            raise CancelledError(NOBODY_WAITS)
        self._daemon.look()


class Daemon:
    """The daemon of this host, and the connections of this process to it. Thread-safe."""

    def __init__(self, setup: Setup, key: str) -> None:
        self._setup = setup
        name = hashlib.sha256(repr((key, setup)).encode()).hexdigest()[:NAME_LETTERS]
        self.folder = os.path.join(tempfile.gettempdir(), f"raynest-dask-{os.getuid()}-{_system()}-{name}")
        self.uri = f"unix:{self.folder}/s"
        self._process: Optional[subprocess.Popen[bytes]] = None     # the daemon, where this process has started it
        self._ends_with_this = False
        self._mutex, self._mine = threading.Lock(), threading.local()
        self._looking, self._looked, self._silent = threading.Lock(), time.monotonic(), 0

    def _private(self) -> None:
        """Makes the folder, or checks that nobody else made it or may enter it."""
        try:
            os.mkdir(self.folder, 0o700)
        except FileExistsError:
            found = os.lstat(self.folder)
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
                raise FailedError(f"{here()} may not use {self.folder}, which is no private folder of this user: remove "
                                  "it, or set another TMPDIR there") from None
        except OSError as error:
            raise FailedError(f"{here()} cannot make {self.folder}: {error.strerror}; set another TMPDIR there") from None

    def client(self) -> Client:
        """The connection of this thread; starts the daemon where nobody answers."""
        known: Optional[Client] = getattr(self._mine, "client", None)
        if known is None:
            self._mine.client = known = self._connect()
            known.connection.interrupts = Leaving(self)
            self.greeted()
        return known

    @property
    def outcome(self) -> Mapping[str, Any]:
        """The outcome of the last answer on the connection of this thread; empty without one."""
        known: Optional[Client] = getattr(self._mine, "client", None)
        return {} if known is None else known.outcome

    def _open(self) -> Client:
        return Client(self.uri, find_access(self.uri, None, None, None, None, True), window_bytes,
                      greeting_seconds=GREETING_SECONDS)

    def greeted(self) -> None:
        """Is called when this thread has a new connection."""

    def drop(self) -> None:
        """Forgets the connection of this thread, which is lost."""
        known, self._mine.client = getattr(self._mine, "client", None), None
        if known is not None:
            known.close()

    def look(self) -> None:
        """Ends a daemon that answers nobody, however long an item may take: one that makes an item still greets."""
        waits = 0.0 if self._silent else DAEMON_SECONDS     # the look itself waits for a greeting
        if time.monotonic() - self._looked < waits or not self._looking.acquire(blocking=False):
            return
        try:
            self._open().close()
            self._silent = 0
        except ConnectError:
            if self._is_stuck():
                raise ConnectError(f"{here()} has a daemon that answers nobody any more", lost=True) from None
        except Error:
            self._silent = 0    # it has no room for the look, which is an answer
        finally:
            self._looked = time.monotonic()
            self._looking.release()

    def _is_stuck(self) -> bool:
        """Is called when the daemon has not greeted; ends it, and returns True, the last time."""
        self._silent += 1
        if self._silent < SILENT_LOOKS:
            return False
        self._silent = 0
        self._end_stuck()
        return True

    def _end_stuck(self) -> None:
        """Ends the daemon, which another process of this host may have started."""
        own = self._process
        if own is not None:
            return own.kill()
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as reached:
            reached.settimeout(DAEMON_SECONDS)
            reached.connect(self.folder + "/s")
            process, *_ = struct.unpack("3i", reached.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            if process > 0:     # it may be in another container
                os.kill(process, signal.SIGKILL)

    @contextlib.contextmanager
    def in_use(self) -> Iterator[None]:
        """While this lasts, no process of this host ends the daemon as one that has nothing to do."""
        while True:
            self._private()
            try:
                lock = os.open(self.folder + "/items", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            except FileNotFoundError:
                continue    # the folder has just been taken away
            fcntl.flock(lock, fcntl.LOCK_SH)
            if _is(lock, self.folder + "/items"):
                break
            os.close(lock)
        try:
            yield
        finally:
            os.utime(lock)
            os.close(lock)

    def end_if_idle(self, seconds: float) -> bool:
        """Ends the daemon, unless a process of this host has used it for so long. Returns whether this one is done with it."""
        try:
            with open(self.folder + "/items", "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if time.time() - os.fstat(lock.fileno()).st_mtime < seconds:
                    return False
                self._end()
        except BlockingIOError:
            return False
        except FileNotFoundError:
            pass    # another one has taken it away
        return True

    def _end(self) -> None:
        with self._mutex:
            if self._process is None:
                return _take_away(self.folder)
            self._process.kill()
            self._process.wait()
            shutil.rmtree(self.folder, ignore_errors=True)

    def _take_away_left(self) -> None:
        """Removes the folders of workers that were killed: nobody has their locks any more."""
        for folder in glob.glob(glob.escape(self.folder[:-NAME_LETTERS]) + "*"):
            with contextlib.suppress(OSError):
                found = os.lstat(folder)
                if found.st_uid == os.getuid() and time.time() - found.st_mtime >= LEFT_SECONDS:
                    _take_away(folder)

    def _connect(self) -> Client:
        end = time.monotonic() + START_SECONDS
        while True:
            self._private()     # a worker that ends takes it away, and nobody else may put another in its place
            try:
                return self._open()
            except ConnectError as error:
                if time.monotonic() > end:
                    raise
                if error.silent:
                    self._is_stuck()
            if dropped():
                raise CancelledError(NOBODY_WAITS)
            with self._mutex:
                self._start_if_none()
            time.sleep(0.02)

    def _start_if_none(self) -> None:
        """Starts the daemon, unless a worker of this host has done so: the lock is held as long as it lives."""
        if self._process is not None:
            return
        self._private()
        lock = os.open(self.folder + "/lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = _is(lock, self.folder + "/lock")
        except OSError:
            held = False
        if not held:
            return os.close(lock)
        if not self._ends_with_this:
            self._ends_with_this = True
            atexit.register(self._end)
        self._take_away_left()
        started: queue.SimpleQueue[Union[Error, subprocess.Popen[bytes]]] = queue.SimpleQueue()
        # The system ends the daemon with the thread that started it, so that thread stays.
        threading.Thread(target=self._keep, args=(here(), lock, started), daemon=True).start()
        process = started.get()
        if isinstance(process, Error):
            raise process
        self._process = process

    def binary(self) -> str:
        named = self._setup.binary or os.environ.get("RAYNESTD", "raynestd")
        return shutil.which(named) or named

    def _keep(self, where: str, lock: int, started: queue.SimpleQueue[Any]) -> None:
        try:
            process = self._started(where)
        except Exception as error:
            os.close(lock)
            return started.put(error if isinstance(error, Error) else FailedError(f"{where} cannot start a daemon: {error}"))
        started.put(process)
        process.wait()
        with self._mutex:
            self._process = None
            os.close(lock)      # now any worker of this host may start the next one

    def _started(self, where: str) -> subprocess.Popen[bytes]:
        """Starts the daemon; returns when it is ready. Raises FailedError with what it says, if it ends."""
        prctl, killed = ctypes.CDLL(None).prctl, 9
        ready, log = self.folder + "/ready", self.folder + "/log"
        for leftover in (self.folder + "/s", ready):
            if os.path.lexists(leftover):
                os.unlink(leftover)
        with open(log, "wb") as said:
            try:
                process = subprocess.Popen(
                    [self.binary(), "--listen", self.uri, "--http", "off", "--ready-file", ready, "--log-level",
                     "error", *self._setup.options], stdin=subprocess.DEVNULL, stdout=said, stderr=said,
                    preexec_fn=lambda: prctl(1, killed))  # PR_SET_PDEATHSIG
            except OSError as error:
                raise FailedError(f"{where} cannot start {self.binary()}: {error.strerror}; install raynest there, "
                                  "or say with binary= where raynestd is") from None
        end = time.monotonic() + START_SECONDS
        while process.poll() is None and not os.path.exists(ready):
            if time.monotonic() > end:
                process.kill()
                process.wait()
                raise FailedError(f"{where} has a daemon that was not ready after {START_SECONDS:.0f} s{_last_line(log)}")
            time.sleep(0.01)
        if process.returncode is not None:
            raise FailedError(f"{where} has a daemon that ended at once{_last_line(log, process.returncode)}")
        return process


def _is(opened: int, path: str) -> bool:
    """False if what was opened there has been taken away."""
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(opened), os.stat(path))
    return False


def _take_away(folder: str) -> None:
    """Removes a folder, unless a worker's daemon has it."""
    with contextlib.suppress(OSError), open(folder + "/lock", "ab") as lock:    # there is none if no daemon was started
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)


def _last_line(log: str, code: int = 0) -> str:
    """Returns what a daemon said at last, to be put behind what happened to it."""
    with contextlib.suppress(OSError), open(log, "rb") as file:
        lines = file.read().decode(errors="replace").strip().splitlines()
        if lines:
            return ": " + lines[-1].removeprefix("raynestd: ")
    return f" by signal {-code}" if code < 0 else f" with code {code}" if code else ""


def _system() -> str:
    """Names the running system: hosts may have one TMPDIR, where a lock or a socket of one is no other's."""
    try:
        with open("/proc/sys/kernel/random/boot_id", "rb") as file:
            booted = file.read()
    except OSError:
        booted = b""
    return hashlib.sha256(booted + socket.gethostname().encode()).hexdigest()[:6]


_item = threading.local()


@contextlib.contextmanager
def until_left(left: threading.Event) -> Iterator[None]:
    """For an item that this thread makes for this program: it may be left once `left` is set."""
    _item.left = left
    try:
        yield
    finally:
        _item.left = None


def dropped() -> str:
    """The key of this thread's item, where its client has left it or has the answer from elsewhere; else ""."""
    left = getattr(_item, "left", None)
    if left is not None:
        return f"left {id(left)}" if left.is_set() else ""
    try:
        worker: Any = distributed.get_worker()
        key: str = worker.get_current_task()
        return key if worker.state.tasks[key].state == "cancelled" else ""
    except (ValueError, LookupError, AttributeError):   # no item of a cluster, or another Dask
        return ""


def here() -> str:
    try:
        return f"the worker {distributed.get_worker().address}"
    except ValueError:
        return "this machine"
