#!/usr/bin/env python3
"""Daemons that lie: every wrong length, type, order and end is one exception, soon, and none of
them costs memory first. And daemons that are only slow or stubborn: neither end waits for ever.

  hostile_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import contextlib
import pathlib
import resource
import socket
import struct
import sys
import tempfile
import threading
import time
import unittest

import numpy as np

import raynest
from raynest import _limits
from raynest._control import decode, encode
from raynest._frame import DTYPES, HEADER, MAGIC, Header, padding, read_header, write_header
from raynest._schema import SCHEMA
from daemon import PATIENCE

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
        self.socket.sendall(frame(name, message, self.id, **columns))


def t(count):
    return np.arange(count, dtype=np.float32)


class WithFake(unittest.TestCase):
    def fake(self, script, welcome=WELCOME):
        """The URI of a daemon that greets, then plays `script(peer)`, for one connection."""
        folder = tempfile.TemporaryDirectory(prefix="raynest-fake-")
        self.addCleanup(folder.cleanup)
        path = str(pathlib.Path(folder.name) / "socket")
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
                        accepted.sendall(frame("Welcome", welcome, 0))
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


class Lies(WithFake):
    def refused(self, answer, error=raynest.ProtocolError, closed=True, **options):
        """A query that `answer(peer)` answers ends in this exception."""
        def script(peer):
            peer.until("QueryRays")
            answer(peer)
            with contextlib.suppress(ConnectionError):
                while True:
                    peer.read()
        scene = self.scene(script)
        begin = time.monotonic()
        with self.assertRaises(error) as caught:
            scene.trace(np.ones((100, 8), np.float32), **{"fields": ("t",), **options})
        self.assertLess(time.monotonic() - begin, PATIENCE)
        self.assertNotIn("\n", str(caught.exception))
        self.assertEqual(scene._client.connection.closed, closed)
        return caught.exception

    def test_honest_answers_pass(self):
        def script(peer):
            peer.until("Query")
            peer.until("QueryRays")
            peer.send("Started", {"epoch": 1})
            peer.send("Chunk", {"first_ray": 60, "count": 40}, t=t(40))
            peer.send("Chunk", {"first_ray": 0, "count": 60}, t=t(60))
            peer.send("Done", {"rays": 100})
        hits = self.scene(script).trace(np.ones((100, 8)), fields=("t",))
        np.testing.assert_array_equal(hits["t"], np.append(t(60), t(40)))

    def test_headers(self):
        def header(**fields):
            words = {"magic": MAGIC, "type": 153, "flags": 0, "control_bytes": 64, "blocks": 1,
                     "bulk_bytes": 64, "request_id": 1, **fields}
            return lambda peer: peer.socket.sendall(struct.pack("<4sHHIIQQ", *words.values()))
        for fields in ({"magic": b"HTTP"}, {"flags": 1}, {"control_bytes": 2**32 - 1},
                       {"bulk_bytes": 2**32}, {"bulk_bytes": 2**64 - 64}, {"bulk_bytes": 63},
                       {"blocks": 2**32 - 1}, {"blocks": 0}):
            with self.subTest(**fields):
                self.refused(header(**fields))

    def test_a_large_announcement_costs_no_memory(self):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        self.refused(lambda peer: peer.socket.sendall(
            write_header(Header(153, 64, 1, 2**40, 1)) + bytes(64)))
        self.assertLess(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, 32 << 10)

    def test_junk(self):
        chance = np.random.default_rng(1)
        for size in (1, 31, 32, 1000, 100000):
            junk = chance.bytes(size)
            with self.subTest(size=size):
                self.refused(lambda peer: (peer.socket.sendall(junk), peer.socket.close()),
                             raynest.FailedError)

    def test_frames_that_end_too_early(self):
        whole = frame("Chunk", {"first_ray": 0, "count": 100}, 1, t=t(100))
        for cut in list(range(0, 40, 7)) + [100, len(whole) - 1]:
            with self.subTest(cut=cut):
                error = self.refused(lambda peer: (peer.socket.sendall(whole[:cut]),
                                                   peer.socket.close()), raynest.FailedError)
                self.assertIn("closed", str(error))

    def test_damaged_messages(self):
        whole = frame("Chunk", {"first_ray": 0, "count": 100}, 1, t=t(100))
        for at in range(HEADER.size, HEADER.size + 4):
            damaged = bytearray(whole)
            damaged[at] ^= 0xFF
            with self.subTest(at=at):
                self.refused(lambda peer: peer.socket.sendall(damaged))

    def test_columns_that_were_not_asked_for_or_do_not_fit(self):
        for name, chunk, columns, options in (
                ("missing", {"count": 100}, {"prim": np.zeros(100, np.uint32)}, {}),
                ("of another type", {"count": 100}, {"t": np.zeros(100, np.uint32)}, {}),
                ("too wide", {"count": 100}, {"t": np.zeros((100, 2), np.float32)}, {}),
                ("too long", {"count": 100}, {"t": t(101)}, {}),
                ("too short", {"count": 100}, {"t": t(99)}, {}),
                ("of no rays", {"count": 0}, {"t": t(0)}, {}),
                ("of more rays than asked", {"count": 101}, {"t": t(101)}, {}),
                ("of rays beyond", {"first_ray": 100, "count": 1}, {"t": t(1)}, {}),
                ("of rays far beyond", {"first_ray": 2**63, "count": 100}, {"t": t(100)}, {}),
                ("with splits", {"count": 100},
                 {"t": t(100), "ray_splits": np.zeros(101, np.uint64)}, {}),
                ("without splits", {"count": 100}, {"t": t(100)}, {"kind": "multi"}),
                ("with few splits", {"count": 100},
                 {"t": t(5), "ray_splits": np.zeros(100, np.uint64)}, {"kind": "multi"})):
            with self.subTest(name):
                self.refused(lambda peer: peer.send("Chunk", chunk, **columns), **options)

    def test_splits_that_do_not_rise_to_the_number_of_hits(self):
        rising = np.arange(101, dtype=np.uint64)
        falling, late, long = rising.copy(), rising + np.uint64(1), rising * np.uint64(2)
        falling[50] = 2**63
        for splits in (falling, late, long):
            def answer(peer):
                peer.send("Chunk", {"count": 100}, ray_splits=splits, t=t(100))
                peer.until("Cancel")
                peer.send("Error", {"code": 14})
            error = self.refused(answer, kind="multi", closed=False)
            self.assertIn("do not rise", str(error))

    def test_answers_that_come_twice(self):
        def answer(peer):
            peer.send("Chunk", {"first_ray": 0, "count": 60}, t=t(60))
            peer.send("Chunk", {"first_ray": 59, "count": 41}, t=t(41))
        self.refused(answer)

    def test_columns_that_change_between_chunks(self):
        def answer(peer):
            peer.send("Chunk", {"first_ray": 0, "count": 60}, t=t(60), extra=t(60))
            peer.send("Chunk", {"first_ray": 60, "count": 40}, t=t(40))
        self.refused(answer)

    def test_an_end_before_the_last_answer(self):
        def answer(peer):
            peer.send("Chunk", {"first_ray": 0, "count": 60}, t=t(60))
            peer.send("Done", {"rays": 100})
        self.refused(answer, closed=False)

    def test_more_than_the_credit(self):
        def script(peer):
            peer.until("QueryRays")
            peer.send("Chunk", {"count": 16384}, t=t(16384), ng=np.zeros((16384, 3), np.float32))
            peer.until("Bye")
        with self.assertRaisesRegex(raynest.ProtocolError, "more than its credit"):
            self.scene(script, window_bytes=128 << 10).trace(np.ones((16384, 8), np.float32),
                                                             fields=("t", "ng"))

    def test_errors_of_the_daemon(self):
        error = self.refused(lambda peer: peer.send("Error", {
            "code": 12, "message": "full", "retry_after_ms": 250}), raynest.BusyError, closed=False)
        self.assertEqual((error.retry_after, error.name, error.exit_code), (0.25, "BUSY", 6))
        self.assertEqual(str(error), "full (try again in 250 ms)")
        self.refused(lambda peer: peer.send("Error", {"code": 16, "closing": True}),
                     raynest.BusyError)
        self.refused(lambda peer: peer.socket.sendall(frame("Error", {
            "code": 1, "closing": True}, 0)), raynest.FailedError)

    def test_texts_with_control_characters(self):
        self.refused(lambda peer: peer.send("Error", {"code": 1, "message": "a\x1b[2Jb"}))

    def test_frames_of_other_requests_and_later_versions_are_skipped(self):
        def script(peer):
            peer.until("QueryRays")
            peer.socket.sendall(frame("Chunk", {"count": 9}, 77, t=t(9)))
            peer.socket.sendall(frame("Done", {"rays": 9}, 77))
            peer.socket.sendall(write_header(Header(999, 8, 1, 128, 1)) + bytes(136))
            peer.send("Chunk", {"count": 100}, t=t(100))
            peer.send("Done", {})
        hits = self.scene(script).trace(np.ones((100, 8)), fields=("t",))
        np.testing.assert_array_equal(hits["t"], t(100))

    def test_greetings(self):
        for script in (lambda peer: peer.socket.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 9),
                       lambda peer: peer.socket.close(),
                       lambda peer: peer.socket.sendall(frame("Pong", {}, 0))):
            with self.assertRaisesRegex(raynest.ConnectError, "no RayNest daemon answers"):
                raynest.connect(self.fake(script, welcome=None))
        for nothing in ({"chunk_rays_max": 0}, {"window_bytes": 64}, {"frame_bytes_max": 0}):
            with self.assertRaisesRegex(raynest.FailedError, "takes no data"):
                raynest.connect(self.fake(lambda peer: None, {**WELCOME, **nothing}))

    def test_pictures_that_do_not_fit_together(self):
        piece = np.zeros(64, np.uint8)
        for name, message in (("a large one", {"total": 2**50}), ("a small one", {"total": 64}),
                              ("a gap", {"total": 8 * 8 * 4, "offset": 64})):
            def script(peer):
                peer.until("Render")
                peer.send("Picture", message, data=piece)
            with self.subTest(name), self.assertRaises(raynest.ProtocolError):
                self.scene(script).render(size=(8, 8))

    def fetched(self, kind, answer):
        def script(peer):
            peer.until("Jobs")
            peer.send("JobList", {"jobs": [{"job": 5, "kind": kind}]})
            peer.until("Fetch")
            answer(peer)
        return raynest.Job(self.scene(script)._client, 5).fetch()

    def test_answers_of_jobs(self):
        def rows(*chunks, done):
            def answer(peer):
                for first, columns in chunks:
                    peer.send("Chunk", {"first_ray": first, "count": 4}, **columns)
                peer.send("Done", {"rows": done})
            return answer
        honest = self.fetched("query", rows((4, {"t": t(4)}), (0, {"t": t(4)}), done=8))
        np.testing.assert_array_equal(honest["t"], np.append(t(4), t(4)))
        for lie in (rows((0, {"t": t(4)}), done=8), rows((0, {"t": t(4)}), done=3),
                    rows((4, {"t": t(4)}), (2, {"t": t(4)}), done=8),
                    rows((0, {"t": t(4)}), (4, {"uv": t(4)}), done=8),
                    rows((0, {"t": t(5)}), done=4), rows((2**36, {"t": t(4)}), done=4)):
            with self.assertRaises(raynest.ProtocolError):
                self.fetched("query", lie)

    def test_pictures_of_jobs(self):
        def piece(**message):
            return lambda peer: (peer.send("Picture", message, data=np.zeros(64, np.uint8)),
                                 peer.send("Done", {}))
        size = {"width": 4, "height": 4, "encode": "raw"}
        self.assertEqual(self.fetched("render", piece(**size, total=64)).shape, (4, 4, 4))
        self.assertEqual(self.fetched("heatmap", piece(**size, total=64)).shape, (4, 4))
        for lie in ({**size, "total": 65}, {**size, "encode": "png", "total": 2**40},
                    {"width": 2**31, "height": 2**31, "encode": "raw", "total": 2**64 - 4},
                    {**size, "total": 64, "offset": 64}):
            with self.assertRaises(raynest.ProtocolError, msg=lie):
                self.fetched("render", piece(**lie))

    def test_jobs_without_end(self):
        """A daemon that always has more jobs, and always the same."""
        def script(peer):
            with contextlib.suppress(ConnectionError):
                while True:
                    peer.until("Jobs")
                    peer.send("JobList", {"jobs": [{"job": 5}], "more": True})
        client = raynest.connect(self.fake(script))
        self.addCleanup(client.close)
        with self.assertRaisesRegex(raynest.ProtocolError, "twice"):
            client.jobs()

    def test_files_that_were_not_offered(self):
        def script(peer):
            peer.until("Load")
            peer.send("Need", {"files": [1]})
            peer.until("Cancel")
            peer.send("Error", {"code": 14})
        client = raynest.connect(self.fake(script))
        with self.assertRaisesRegex(raynest.ProtocolError, "not offered"):
            client.mesh(np.eye(3), [[0, 1, 2]])
        client.close()


class Waits(WithFake):
    def test_a_daemon_that_writes_before_it_reads_on(self):
        """It takes one frame of rays, then writes more than sockets hold before it reads again."""
        count, frames = 16384, 16
        columns = {"t": t(count), "position": np.zeros((count, 3), np.float32),
                   "ng": np.zeros((count, 3), np.float32), "path": np.zeros(count, np.uint64)}

        def script(peer):
            peer.until("QueryRays")
            for i in range(frames):
                if i:
                    peer.until("QueryRays")
                else:  # with the buffers full of rays that nobody reads
                    time.sleep(0.2)
                peer.send("Chunk", {"first_ray": i * count, "count": count}, **columns)
                peer.send("Credit", {"bytes": count * 32})
            peer.send("Done", {})
        hits = self.scene(script).trace(np.ones((frames * count, 8), np.float32),
                                        fields=tuple(columns))
        np.testing.assert_array_equal(hits["t"], np.tile(t(count), frames))

    def test_a_pause_of_the_caller_leaves_no_frame_half_sent(self):
        count = 16384
        came_whole = threading.Event()

        def script(peer):
            peer.until("QueryRays")
            peer.send("Started", {"epoch": 1})
            header = read_header(peer.exactly(HEADER.size))  # of the next, larger than the socket
            peer.send("Chunk", {"count": count}, t=t(count))
            peer.exactly(header.control_bytes + header.bulk_bytes)
            came_whole.set()
            peer.send("Chunk", {"first_ray": count, "count": count}, t=t(count))
            peer.send("Done", {})
        rays = np.ones((2 * count, 8), np.float32)
        for _ in self.scene(script).stream(rays, fields=("t",)):
            self.assertTrue(came_whole.wait(PATIENCE))

    def test_rays_are_sent_within_the_credit(self):
        early = []

        def script(peer):
            # Two frames fit the window of 64,000 bytes; the third one is for when there is credit.
            for _ in range(2):
                peer.until("QueryRays")
            peer.socket.settimeout(0.3)
            with contextlib.suppress(socket.timeout):
                early.append(peer.socket.recv(1))
            peer.socket.settimeout(PATIENCE)
            peer.send("Credit", {"bytes": 32000})
            message, bulk = peer.until("QueryRays")
            early.append((message["first_ray"], len(bulk)))
            peer.send("Chunk", {"count": 3000}, t=t(3000))
            peer.send("Done", {})
        with raynest.connect(self.fake(script, {**WELCOME, "window_bytes": 64000})) as client:
            raynest.Scene(client, "fake").trace(np.ones((3000, 8), np.float32), fields=("t",))
        self.assertEqual(early, [(2000, 32000)])

    def test_answers_in_drips(self):
        whole = b"".join([frame("Chunk", {"count": 10}, 1, t=t(10)), frame("Done", {}, 1)])

        def script(peer):
            peer.until("QueryRays")
            for i in range(len(whole)):
                peer.socket.sendall(whole[i:i + 1])
        hits = self.scene(script).trace(np.ones((10, 8)), fields=("t",))
        np.testing.assert_array_equal(hits["t"], t(10))

    def test_the_window_is_granted_again(self):
        """Chunks of twice the window in all: without grants the fake would send beyond it."""
        granted = []

        def script(peer):
            peer.until("QueryRays")
            credit = 64 << 10
            for first in range(0, 16384, 2048):
                while credit < 8192 * 4:
                    message, _ = peer.until("Credit")
                    granted.append(message["bytes"])
                    credit += message["bytes"]
                credit -= 8192 * 4
                peer.send("Chunk", {"first_ray": first, "count": 2048}, t=t(2048),
                          ng=np.zeros((2048, 3), np.float32))
            peer.send("Done", {})
        scene = self.scene(script, window_bytes=64 << 10)
        scene.trace(np.ones((16384, 8), np.float32), fields=("t", "ng"))
        self.assertGreaterEqual(sum(granted), 128 << 10)

    def test_a_silent_daemon_ends_with_the_deadline(self):
        scene = self.scene(lambda peer: peer.until("Bye"))
        raynest._connection.GRACE_SECONDS, before = 0.5, raynest._connection.GRACE_SECONDS
        self.addCleanup(setattr, raynest._connection, "GRACE_SECONDS", before)
        begin = time.monotonic()
        with self.assertRaises(raynest.DeadlineError):
            scene.trace(np.ones((10, 8)), deadline=0.1)
        self.assertLess(time.monotonic() - begin, PATIENCE)

    def test_a_server_that_does_not_greet_is_none(self):
        raynest._connection.GREETING_SECONDS, before = 0.5, raynest._connection.GREETING_SECONDS
        self.addCleanup(setattr, raynest._connection, "GREETING_SECONDS", before)
        with self.assertRaisesRegex(raynest.ConnectError, "no RayNest daemon answers within"):
            raynest.connect(self.fake(lambda peer: peer.until("Bye"), welcome=None))

    def test_a_daemon_that_does_not_cancel_loses_the_connection(self):
        def script(peer):
            peer.until("QueryRays")
            peer.send("Chunk", {"count": 5}, t=t(5))
            peer.until("Bye")
        raynest._connection.GRACE_SECONDS, before = 0.5, raynest._connection.GRACE_SECONDS
        self.addCleanup(setattr, raynest._connection, "GRACE_SECONDS", before)
        scene = self.scene(script)
        for _ in scene.stream(np.ones((10, 8)), fields=("t",)):
            break
        self.assertTrue(scene._client.connection.closed)


if __name__ == "__main__":
    del sys.argv[1:4]
    unittest.main()
