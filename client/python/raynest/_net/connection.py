"""A conversation with a daemon: greet it, send a request, read its frames until the end.

One request runs at a time; a second thread waits for its turn. The socket does not block, and the
client sends while it waits for frames, so that the two ends can never wait for each other for ever.
This module counts both credits: the bytes that the client may send, and the bytes that it has
received and must grant again. Bulk data goes from and to the caller's arrays without a copy.

An exception in the middle of a frame closes the connection. Between frames it does not: a request
that the caller leaves early (Ctrl-C, an exception, a stream that is not read to its end) is
cancelled at the daemon, and its last frames are read here.
"""
from __future__ import annotations

import collections
import contextlib
import math
import os
import select
import socket
import threading
import time
from typing import Callable, Generator, NoReturn, Optional, Sequence, TypeVar

import numpy as np

from .. import _limits, errors
from .._lists import ACTING
from .._version import VERSION
from .access import Access
from .address import connect
from .control import Message, decode, encode
from .daemon import Daemon, read_welcome
from .frame import (HEADER, Array, Block, Header, describe, first_request_id, padding,
                    read_blocks, read_header, write_header)
from .interrupts import Interrupts
from .reconnect import ATTEMPTS_MAX, open_again, open_first
from .schema import SCHEMA

GREETING_SECONDS = 5.0
# The daemon answers DEADLINE and CANCELLED itself; beyond this it is taken for dead.
GRACE_SECONDS = 5.0
# Longest wait in one call of poll(): a Ctrl-C is noticed this soon.
TICK_MS = 100
# Frames that are followed by more of the same answer; every other frame ends its request.
CONTINUED = {"Started", "Chunk", "Progress", "Payload", "Credit", "Need"}
BUFFERS_MAX = 64  # in one system call
# Explains a connection that the daemon closed in the middle of an answer, where no ERROR fits.
CUT_SHORT = " within an answer: the daemon ended, or this reader paused and gave way to another client"

# The beginning of what a TLS server answers to bytes that are not TLS.
TLS_ALERT = b"\x15\x03"

T = TypeVar("T")
Frame = tuple[str, Message]
# Returns the arrays that receive the blocks of a frame, each with exactly its block's bytes.
Place = Callable[[str, Message, Sequence[Block]], Sequence[Array]]
# Returns the error to raise where no daemon answers.
Explain = Callable[[errors.ConnectError], errors.ConnectError]


def anywhere(_name: str, _message: Message, blocks: Sequence[Block]) -> Sequence[Array]:
    return [block.array() for block in blocks]


def _bytes_of(array: Array) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


class Connection:
    def __init__(self, uri: str, access: Access, window_bytes: int, reconnect: float = 0.0,
                 explain: Optional[Explain] = None, greeting_seconds: float = GREETING_SECONDS) -> None:
        self.uri = uri
        self._explain = explain or (lambda error: error)
        self._access = access
        self._window_bytes = window_bytes
        self._reconnect = reconnect         # seconds to look for a daemon that went away
        self._greeting_seconds = greeting_seconds   # that one may take to greet
        self._left = False                  # the caller has closed this
        self.closed = True
        self._opened = 0                    # times that the daemon has greeted this
        self._process = os.getpid()
        self._turn = threading.Lock()
        self._owner, self._streams = 0, False  # thread whose turn it is; has it an open stream?
        self.interrupts = Interrupts()
        self._scrap = bytearray(64 << 10)
        open_first(self._open, reconnect, self.interrupts.check)

    def _open(self) -> None:
        try:
            self._open_once()
        except errors.ConnectError as error:
            raise self._explain(error) from None

    def _open_once(self) -> None:
        self._outbox: collections.deque[list[memoryview]] = collections.deque()
        self._begun = False                 # was part of the first frame there sent?
        self._id = first_request_id()       # the greeting's: the log names it where it is refused
        self._greeted = False
        self._head = bytearray()            # the header of the last frame, as far as it has come
        self._begin(self._greeting_seconds)
        before = getattr(self, "_socket", None)
        if before is not None:
            before.close()
        self._socket = connect(self.uri, self._greeting_seconds, self._access)
        self.closed = False
        self._pending = getattr(self._socket, "pending", lambda: 0)  # only TLS decrypts ahead
        self._poll = select.poll()
        self._poll.register(self._socket)
        try:
            self.daemon = self._greet(self._access.token)
        except BaseException:
            self._shut()
            raise
        self._greeted = True
        self._opened += 1

    def again(self, work: Callable[[], T]) -> T:
        """Returns work(), which sends requests that do the same when they are sent again. Where the daemon goes away
        meanwhile, calls it once more: its first request connects again."""
        for attempt in range(1, ATTEMPTS_MAX + 1):
            try:
                return work()
            except errors.Error as error:
                if not error.lost or not self._reconnect or self._left or attempt == ATTEMPTS_MAX:
                    raise
                with self.interrupts:
                    self._shut()  # after DRAINING it is still open
        raise AssertionError

    def close(self) -> None:
        """Ends the connection for good; see _shut()."""
        self._left = True
        self._shut()

    def _shut(self) -> None:
        """Ends the connection and the request that runs on it, from any thread: the thread that reads
        finds the end of the stream. The descriptor is closed when no thread uses it any more; its
        number could otherwise name another file while a thread still waits for it."""
        self.closed = True
        if os.getpid() != self._process:
            self._socket.close()  # this process' end; the request goes on in the other one
            return
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._free()

    def _free(self) -> None:
        if self._turn.acquire(blocking=False):
            try:
                self._socket.close()
            finally:
                self._turn.release()

    def _check_open(self) -> None:
        if self.closed:
            raise errors.ConnectError(f"the connection to {self.uri} was closed meanwhile; connect "
                                      "again")

    def __reduce__(self) -> NoReturn:
        raise errors.UsageError("a connection cannot be pickled, nor copied: connect in each "
                                "process")

    # ---- requests -------------------------------------------------------------------------------

    def exchange(self, name: str, message: Message, deadline: float = 0.0, place: Place = anywhere,
                 feed: Callable[[], object] = lambda: None,
                 streams: bool = False) -> Generator[Frame, None, None]:
        """Sends a request and yields its frames, the last one included. `feed` is called before
        each wait and may queue more frames. `streams`: the user's code runs between two frames, and
        other threads are told, not kept waiting for an end that may wait for them. A Ctrl-C outside of `interrupts` comes
        between two frames, where it does no harm."""
        mine = False
        try:
            with self.interrupts:
                self._check_process()
                mine = self._take_turn()
                self._streams = streams
                if self.closed and not self._left and self._reconnect:
                    open_again(self._open, self._reconnect, self.interrupts.check)
                if self.closed:
                    raise errors.ConnectError(f"the connection to {self.uri} is closed; "
                                              "connect again")
                self._id += 1
                self.queue(name, message)  # raises if the message is invalid; nothing has begun yet
                self._begin(deadline + GRACE_SECONDS if deadline else math.inf)
                self.credit = self.daemon.window_bytes
            frames: collections.deque[Frame] = collections.deque()
            while self._running or frames:
                with self.interrupts:
                    self._check_process()
                    if self._running:
                        feed()
                    if not frames:
                        frames.append(self._next(place))
                    frames.extend(self._finish_frame(place))
                left = time.monotonic()
                yield frames.popleft()
                self._looked += time.monotonic() - left  # the caller's time, not the daemon's
        finally:
            with self.interrupts:
                try:
                    if os.getpid() != self._process:
                        self._shut()
                    elif mine and self._running and not self.closed:
                        self._abandon()
                finally:
                    if mine:
                        if self.closed:
                            self._outbox.clear()  # also releases the caller's arrays
                        self._owner, self._streams = 0, False
                        self._turn.release()
                        if self.closed:
                            self._free()

    def ask(self, name: str, message: Message, answer: str,
            feed: Callable[[], object] = lambda: None) -> Message:
        """Sends a request that is answered by one frame, `answer`, and returns that."""
        def once() -> Message:
            with self.interrupts:
                for kind, reply in self.exchange(name, message, feed=feed):
                    if kind == answer:
                        return reply
            raise errors.ProtocolError(f"the daemon answered {name} with {kind}")
        # A detached job that was begun runs on.
        return once() if name in ACTING or answer == "Detached" else self.again(once)

    def queue(self, name: str, message: Message, *blocks: tuple[str, Array, int]) -> None:
        """Queues a frame of the running request. A block is (name, data, values per element): data
        that is contiguous, fits the credit and does not change until it was sent."""
        bulk: list[memoryview] = []
        if blocks:
            message = {**message, "blocks": []}
        for block, data, width in blocks:
            message["blocks"].append(describe(block, data, width, sum(map(len, bulk))))
            bulk += [each for each in (_bytes_of(data), memoryview(bytes(padding(data.nbytes)))) if each]
        bulk_bytes = sum(map(len, bulk))
        self.credit -= bulk_bytes
        control = encode(name, message)
        header = Header(SCHEMA.types[name], len(control), len(blocks), bulk_bytes, self._id)
        self._outbox.append([memoryview(write_header(header) + control), *bulk])

    def _check_process(self) -> None:
        """Refuses use after a fork: two processes would read each other's answers."""
        if os.getpid() != self._process:
            raise errors.UsageError("this connection is of the process that was forked; "
                                    "connect again in this one")

    def _take_turn(self) -> bool:
        if self._owner == threading.get_ident():
            raise errors.UsageError("another call is still open on this connection, as a stream that "
                                    "is not read to its end, or the one that calls progress=: end "
                                    "it first, or use a second connection")
        while not self._turn.acquire(timeout=TICK_MS / 1000):
            if self._streams:
                raise errors.UsageError("another thread has an open stream on this connection: end it "
                                        "first, or connect() once more for this thread")
            self.interrupts.check()
        self._owner = threading.get_ident()
        return True

    def _tag(self) -> str:
        return f"{self._id:x}" if self._greeted else ""

    def _begin(self, seconds_max: float) -> None:
        self._running = True
        self._wait_at_most(seconds_max)
        self.credit = 0                         # bulk bytes that may be sent
        self._granted = self._window_bytes      # bulk bytes that may still come
        self._consumed = 0                      # bulk bytes that came and were not granted again

    def _wait_at_most(self, seconds: float) -> None:
        """Sets the time that the daemon may take from now on; the caller's own time does not count."""
        self._patience = seconds
        self._looked = time.monotonic()

    def _greet(self, token: str) -> Daemon:
        self.queue("Hello", {"client": "raynest-python " + VERSION, "token": token,
                             "window_bytes": self._window_bytes})
        try:
            with self.interrupts:
                name, welcome = self._next(anywhere)
        except errors.DeadlineError:
            raise errors.ConnectError(f"no RayNest daemon answers within {self._greeting_seconds:g} s; "
                                      "is it raynestd that listens there?", lost=True,
                                      silent=True) from None
        except errors.FailedError as error:
            # Only a connection that ended is `lost`: a server that has answered says no more later.
            is_tls = self._head.startswith(TLS_ALERT)
            reason = "this port is encrypted: connect to it with tls:// in place of tcp://" if is_tls else error
            raise errors.ConnectError(f"no RayNest daemon answers: {reason}",
                                      lost=error.lost and not is_tls) from None
        if name != "Welcome":
            raise errors.ConnectError(f"no RayNest daemon answers: it says {name}")
        return read_welcome(welcome)

    def _abandon(self) -> None:
        """Cancels the running request and reads the frames that are still on their way."""
        try:
            self._keep_begun()
            self._wait_at_most(GRACE_SECONDS)
            self.queue("Cancel", {"reason": "the client left the request"})
            while self._running:
                self._next(anywhere)
        except errors.Error:
            pass  # usually CANCELLED; any error ends the request
        finally:
            if self._running:
                self._shut()

    # ---- frames ---------------------------------------------------------------------------------

    def _next(self, place: Place) -> Frame:
        """The next frame of the running request. CREDIT has been counted; ERROR is raised."""
        while True:
            self._flush()
            if self._wait_for_frame():
                frame = self._take_frame(place)
                if frame is not None:
                    return frame

    def _finish_frame(self, place: Place) -> list[Frame]:
        """Sends the rest of a frame that was begun: the daemon drops clients that pause within a
        frame. Frames that arrive meanwhile are read, since both ends might otherwise wait for each
        other."""
        frames: list[Frame] = []
        self._flush()
        while self._begun and self._running:
            if self._wait_for_frame():
                frame = self._take_frame(place)
                if frame is not None:
                    frames.append(frame)
            self._flush()
        return frames

    def _take_frame(self, place: Place) -> Optional[Frame]:
        """Reads a frame that has begun to arrive. Returns None for a frame of an ended request, or of an
        unknown type."""
        try:
            header, name, message = self._read_frame(place)
        except BaseException:
            self._shut()  # within a frame there is no way back
            raise
        ours = header.request_id == self._id
        if name == "Error" and (ours or header.request_id == 0):
            self._end(message["closing"])
            raise errors.from_daemon(message["code"], message["message"],
                                     message["retry_after_ms"], f"{self._id:x}", self._opened > 1)
        if not ours or not name:
            return None
        if name == "Credit":
            self.credit = min(self.credit + message["bytes"], _limits.window_bytes_max)
        if name not in CONTINUED:
            self._end(closing=False)
        return name, message

    def _end(self, closing: bool) -> None:
        """Ends the request. Drops its queued frames, but sends the rest of a frame that was begun,
        because the daemon waits for it."""
        self._running = False
        if closing:
            return self._shut()
        self._keep_begun()
        self._wait_at_most(GRACE_SECONDS)
        self._flush()
        while self._outbox:
            self._look_around()
            self._poll.modify(self._socket, select.POLLOUT)
            self._poll.poll(TICK_MS)
            self._flush()

    def _wait_for_frame(self) -> bool:
        self.interrupts.check()
        self._look_around()
        if self._pending():
            return True
        self._poll.modify(self._socket, select.POLLIN | (select.POLLOUT if self._outbox else 0))
        return any(events & ~select.POLLOUT for _, events in self._poll.poll(TICK_MS))

    def _look_around(self) -> None:
        """Raises if the wait must end: after a close(), at the deadline, and soon after a Ctrl-C
        while the daemon owes the rest of a frame."""
        self._check_open()
        now = time.monotonic()
        # Count no more than two ticks: in a longer gap this process was stopped or got no CPU.
        self._patience -= min(now - self._looked, 2 * TICK_MS / 1000)
        self._looked = now
        if self.interrupts.seen:
            self._patience = min(self._patience, GRACE_SECONDS)
        if self._patience < 0:
            self._shut()
            self.interrupts.check()
            raise errors.DeadlineError("no answer from the daemon within the deadline; pass a "
                                       "longer deadline, or ask for less", "DEADLINE")

    def _read_frame(self, place: Place) -> tuple[Header, str, Message]:
        self._head = bytearray(HEADER.size)
        self._receive([memoryview(self._head)], within=False)
        header = read_header(bytes(self._head))
        control = self._receive_bytes(header.control_bytes)
        name = SCHEMA.names.get(header.type, "")
        if header.request_id not in (0, self._id) or not name:
            self._skip(header.bulk_bytes)
            return header, name, {}
        message = decode(name, control)
        blocks = read_blocks(header, message.get("blocks", []))
        self._count(header.bulk_bytes)
        views = []
        for block, array in zip(blocks, place(name, message, blocks) if blocks else ()):
            views.append(_bytes_of(array))
            views.append(memoryview(self._scrap)[:padding(block.bytes)])
        self._receive([view for view in views if len(view)])
        return header, name, message

    def _count(self, bulk_bytes: int) -> None:
        if bulk_bytes > self._granted:
            raise errors.ProtocolError("the daemon sent more than its credit")
        self._granted -= bulk_bytes
        self._consumed += bulk_bytes
        # Grant a quarter of the window at a time, so that the daemon never waits for credit.
        if self._consumed >= self._window_bytes // 4:
            self.queue("Credit", {"bytes": self._consumed})
            self._granted += self._consumed
            self._consumed = 0

    # ---- bytes ----------------------------------------------------------------------------------

    def _keep_begun(self) -> None:
        """Drops all queued frames except one that was begun."""
        while len(self._outbox) > self._begun:
            self._outbox.pop()

    def _flush(self) -> None:
        """Sends as much as the socket accepts now."""
        try:
            while self._outbox:
                views = [view for frame in self._outbox for view in frame][:BUFFERS_MAX]
                try:
                    self._sent(self._socket.sendmsg(views))
                except BlockingIOError:
                    return
        except OSError:
            self._outbox.clear()  # the daemon has closed; reading tells what it said before
            self._begun = False
        except BaseException:
            self._shut()
            raise

    def _sent(self, count: int) -> None:
        while count:
            frame = self._outbox[0]
            taken = min(count, len(frame[0]))
            frame[0] = frame[0][taken:]
            count -= taken
            self._begun = True
            if not frame[0]:
                frame.pop(0)
            if not frame:
                self._outbox.popleft()
                self._begun = False

    def _receive_bytes(self, count: int) -> bytes:
        data = bytearray(count)
        self._receive([memoryview(data)] if count else [])
        return bytes(data)

    def _skip(self, count: int) -> None:
        while count:
            part = min(count, len(self._scrap))
            self._receive([memoryview(self._scrap)[:part]])
            count -= part

    def _receive(self, views: list[memoryview], within: bool = True) -> None:
        """Fills all `views` in order; none may be empty. `within`: in the middle of a frame."""
        first = 0
        while first < len(views):
            try:
                count = self._socket.recvmsg_into(views[first:first + BUFFERS_MAX])[0]
            except BlockingIOError:
                count = -1
            except errors.Error:
                raise
            except OSError as error:
                self._check_open()
                raise errors.FailedError(f"the connection broke: {error.strerror}"
                                         + within * CUT_SHORT, request=self._tag(),
                                         lost=True) from None
            if count < 0:
                self._look_around()
                self._poll.modify(self._socket, select.POLLIN)
                self._poll.poll(TICK_MS)
                continue
            if count == 0:
                self._check_open()
                raise errors.FailedError("the daemon closed the connection" + within * CUT_SHORT,
                                         request=self._tag(), lost=True)
            while first < len(views) and count >= len(views[first]):
                count -= len(views[first])
                first += 1
            if count:
                views[first] = views[first][count:]
