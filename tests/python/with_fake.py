"""Daemons that play a script, for tests of what a real one would never do."""
import contextlib
import pathlib
import socket
import tempfile
import threading
import unittest

import numpy as np

import raynest
import raynest._net.connection
from raynest._net.control import decode, encode
from raynest._net.frame import DTYPES, HEADER, Header, padding, read_header, write_header
from raynest._net.schema import SCHEMA
from daemon import PATIENCE

# Scripts count a connection's requests from 1.
raynest._net.connection.first_request_id = lambda: 0

WELCOME = {"version": 1, "server": "fake", "window_bytes": 8 << 20, "frame_bytes_max": 64 << 20,
           "chunk_rays_max": 16384, "jobs_max": 8}


def frame(name, message, request_id, **columns):
    """A frame with these arrays as blocks."""
    blocks, bulk = [], b""
    for column, array in columns.items():
        width = array.shape[1] if array.ndim > 1 else 1
        blocks.append({"name": column, "dtype": DTYPES.index(array.dtype), "count": len(array),
                       "stride": width * array.itemsize, "offset": len(bulk),
                       "bytes": array.nbytes})
        bulk += array.tobytes() + bytes(padding(array.nbytes))
    control = encode(name, {**message, "blocks": blocks} if blocks else message)
    return write_header(Header(SCHEMA.types[name], len(control), len(blocks), len(bulk),
                               request_id)) + control + bulk


class Peer:
    """The daemon's end of a connection."""

    def __init__(self, accepted):
        self.socket = accepted
        self.id = 0
        self.started = None     # the request

    def read(self):
        """(name, message, bulk) of the next frame."""
        header = read_header(self.exactly(HEADER.size))
        name = SCHEMA.names[header.type]
        self.id = header.request_id or self.id
        return name, decode(name, self.exactly(header.control_bytes)), \
            self.exactly(header.bulk_bytes)

    def exactly(self, count):
        data = bytearray()
        while len(data) < count:
            part = self.socket.recv(min(count - len(data), 1 << 20))
            if not part:
                raise ConnectionError
            data += part
        return bytes(data)

    def until(self, wanted):
        while True:
            name, message, bulk = self.read()
            if name == wanted:
                return message, bulk

    def send(self, name, message, **columns):
        """Sends a message. A request ends after it was started, as the client demands."""
        if name == "Done" and self.started != self.id:
            self.send("Started", {})
        if name == "Started":
            self.started = self.id
        self.socket.sendall(frame(name, message, self.id, **columns))


def t(count):
    return np.arange(count, dtype=np.float32)


class WithFake(unittest.TestCase):
    def fake(self, script, welcome=WELCOME):
        """The URI of a daemon that greets, then plays `script(peer)`, for one connection."""
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-fake-")))
        path = str(folder / "socket")
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(path)
        listener.listen(1)

        def serve():
            with listener, contextlib.suppress(ConnectionError, OSError):
                accepted, _ = listener.accept()
                with accepted:
                    peer = Peer(accepted)
                    if welcome is not None:
                        peer.read()
                        peer.send("Welcome", welcome)
                    script(peer)
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        self.addCleanup(thread.join, PATIENCE)
        return "unix:" + path

    def scene(self, script, **options):
        """A scene whose first query `script` answers."""
        client = raynest.connect(self.fake(script), **options)
        self.addCleanup(client.close)
        return raynest.Scene(client, "fake")
