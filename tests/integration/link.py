"""A network between clients and a port of this machine: slow, far, tapped or broken, as a test needs it.

    with Link(port, round_trip=0.05, rate=12.5e6) as link:      # 50 ms, 100 Mbit/s
        raynest.connect(f"tls://127.0.0.1:{link.port}")
"""
import contextlib
import queue
import socket
import struct
import threading
import time

UP, DOWN = "up", "down"  # from the client, to the client
HARMLESS = ("delay", "drip")
HARMS = (*HARMLESS, "stall", "cut", "half_close", "reset", "flip")
DRIP_BYTES = 200
STEP_BYTES = 64 << 10


class Harm:
    """Changes the byte at `offset` of a direction, once."""

    def __init__(self, kind, direction, offset):
        self.kind, self.direction, self.offset = kind, direction, offset
        self.struck = False


class Link:
    """Forwards every connection to 127.0.0.1:PORT. `round_trip` is in seconds, `rate` in bytes per second
    and direction. With `record`, `seen` holds all bytes that went by. `buffer` is the size of the buffer
    for what clients send: a small one keeps their own small."""

    def __init__(self, port, round_trip=0.0, rate=None, record=False, harm=None, buffer=None):
        self._target, self._delay, self._rate = port, round_trip / 2, rate
        self._record, self._harm = record, harm
        self._parts, self._pairs, self._threads = [], [], []
        self._listener = socket.create_server(("127.0.0.1", 0))
        if buffer:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        self.port = self._listener.getsockname()[1]
        self._start(self._serve)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @property
    def seen(self):
        return b"".join(self._parts)

    def close(self):
        """Ends the link and every connection over it."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for pair in self._pairs:
            for end in pair:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(10)
        for pair in self._pairs:
            for end in pair:
                end.close()

    def _start(self, run, *arguments):
        thread = threading.Thread(target=run, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _serve(self):
        while True:
            try:
                near = self._listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._target), 10)
            except OSError:
                return
            far.settimeout(None)
            for end in (near, far):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._pairs.append((near, far))
            for source, target, direction in ((near, far, UP), (far, near, DOWN)):
                # As many bytes are on their way as the line holds, and a buffer's worth.
                line = queue.Queue(max(4, int((self._rate or 1e9) * self._delay / STEP_BYTES) + 4))
                self._start(self._take, source, line)
                self._start(self._give, line, target, direction, (near, far))

    def _take(self, source, line):
        data = True
        while data:
            try:
                data = source.recv(STEP_BYTES)
            except OSError:
                data = b""
            line.put((time.monotonic(), data))

    def _give(self, line, target, direction, ends):
        free, sent = 0.0, 0  # when the line is free again; bytes sent
        try:
            while True:
                came, data = line.get()
                if not data:
                    target.shutdown(socket.SHUT_WR)
                    return
                if self._record:
                    self._parts.append(data)
                free = max(free, came) + (len(data) / self._rate if self._rate else 0.0)
                time.sleep(max(0.0, free + self._delay - time.monotonic()))
                if not self._deliver(data, target, direction, sent, ends):
                    return
                sent += len(data)
        except OSError:
            pass
        finally:
            threading.Thread(target=self._drain, args=(line,), daemon=True).start()

    @staticmethod
    def _drain(line):
        """Lets the thread that reads end, too."""
        with contextlib.suppress(queue.Empty):
            while line.get(timeout=10)[1]:
                pass

    def _deliver(self, data, target, direction, sent, ends):
        """Sends the bytes; False if the connection is over."""
        harm = self._harm
        if not harm or harm.struck or harm.direction != direction or sent + len(data) <= harm.offset:
            target.sendall(data)
            return True
        harm.struck = True
        at = harm.offset - sent
        target.sendall(data[:at])
        rest = data[at:]
        if harm.kind == "flip":
            rest = bytes([rest[0] ^ 1]) + rest[1:]
        elif harm.kind in ("delay", "stall"):
            time.sleep(0.005)
        elif harm.kind == "drip":
            for byte in rest[:DRIP_BYTES]:
                target.sendall(bytes([byte]))
            rest = rest[DRIP_BYTES:]
        if harm.kind in (*HARMLESS, "flip"):
            target.sendall(rest)
            return True
        if harm.kind == "half_close":
            target.shutdown(socket.SHUT_WR)
            return False
        for end in ends:
            if harm.kind == "reset":
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        if harm.kind == "reset":
            for end in ends:
                end.close()
        return False
