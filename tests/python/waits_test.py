#!/usr/bin/env python3
"""Daemons that are slow or stubborn, and callers that are: neither end waits for ever, nor gives up
too soon.

  waits_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import contextlib
import socket
import ssl
import sys
import threading
import time
import unittest
from unittest import mock

import numpy as np

import raynest
from raynest._net import reconnect
from raynest._net.frame import HEADER, read_header
from raynest._net.reconnect import open_again
from raynest._net.tls import TlsSocket
from daemon import PATIENCE
from with_fake import WELCOME, WithFake, frame, t


class Waits(WithFake):
    def test_a_daemon_that_ends_is_awaited_longer_than_one_that_is_away(self):
        def attempt(error, seconds_until_there):
            there = time.monotonic() + seconds_until_there

            def connect():
                if time.monotonic() < there:
                    raise error
            open_again(connect, 0.05, lambda: None)
        with mock.patch.object(reconnect, "DRAIN_SECONDS", PATIENCE):
            for draining in (raynest.errors.BusyError("it ends", lost=True), raynest.errors.ConnectError("", silent=True)):
                attempt(draining, 0.5)
            for away in (raynest.errors.ConnectError("nobody", lost=True), raynest.errors.BusyError("too many")):
                with self.assertRaises(type(away)):
                    attempt(away, 0.5)

    def test_an_encrypted_write_that_waits_is_repeated_as_it_was(self):
        """OpenSSL asks for the same bytes again, though more may have come meanwhile."""
        sizes = []

        def send(data):
            sizes.append(len(data))
            if len(sizes) < 3:
                raise ssl.SSLWantWriteError
            return len(data)
        stream = TlsSocket.__new__(TlsSocket)
        stream._tls = mock.Mock(send=send)
        stream._staged, stream._repeated = bytearray(1 << 14), 0
        for more in (b"", b"more", b"more"):
            with contextlib.suppress(BlockingIOError):
                stream.sendmsg([memoryview(b"x" * 100), memoryview(more)])
        self.assertEqual(sizes, [100, 100, 100])
        self.assertEqual(stream.sendmsg([memoryview(b"more")]), 4)

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
            header = read_header(peer.exactly(HEADER.size))  # the next one's, larger than the socket
            peer.send("Chunk", {"count": count}, t=t(count))
            peer.exactly(header.control_bytes + header.bulk_bytes)
            came_whole.set()
            peer.send("Chunk", {"first_ray": count, "count": count}, t=t(count))
            peer.send("Done", {})
        rays = np.ones((2 * count, 8), np.float32)
        for _ in self.scene(script).stream(rays, fields=("t",)):
            self.assertTrue(came_whole.wait(PATIENCE))

    def test_a_picture_that_is_closed_from_within_is_an_error(self):
        def script(peer):
            peer.until("Render")
            peer.send("Progress", {"done": 1, "total": 2})
            peer.until("Bye")
        scene = self.scene(script)
        with self.assertRaisesRegex(raynest.ConnectError, "closed meanwhile"):
            scene.render(size=(8, 8), progress=lambda *_: scene._client.close())

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
        whole = b"".join([frame("Started", {}, 1), frame("Chunk", {"count": 10}, 1, t=t(10)), frame("Done", {}, 1)])

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


class Patience(WithFake):
    """Waits with a patience of half a second."""

    def setUp(self):
        for name in ("GRACE_SECONDS", "GREETING_SECONDS"):
            patch = mock.patch.object(raynest._net.connection, name, 0.5)
            patch.start()
            self.addCleanup(patch.stop)

    def test_a_silent_daemon_ends_with_the_deadline(self):
        scene = self.scene(lambda peer: peer.until("Bye"))
        with self.assertRaises(raynest.DeadlineError):
            scene.trace(np.ones((10, 8)), deadline=0.1)

    def test_a_daemon_that_only_reports_ends_with_the_deadline(self):
        def script(peer):
            peer.until("Render")
            for _ in range(500):
                peer.send("Progress", {"done": 1, "total": 2})
                time.sleep(0.02)
            peer.send("Error", {"code": 20, "message": "it was awaited to the last report"})
        with self.assertRaises(raynest.DeadlineError):
            self.scene(script).render(size=(8, 8), deadline=0.1)

    def test_a_pause_of_the_caller_is_not_one_of_the_daemon(self):
        """Nor is one of this process, which nobody sees but the clock."""
        resumed = threading.Event()

        def script(peer):
            peer.until("QueryRays")
            peer.send("Chunk", {"count": 5}, t=t(5))
            resumed.wait(PATIENCE)
            time.sleep(0.2)  # in which there is nothing to read
            peer.send("Chunk", {"first_ray": 5, "count": 5}, t=t(5))
            peer.send("Done", {})
        for pause in (lambda _: time.sleep(1), lambda clock: setattr(clock, "_looked", -1e9)):
            resumed.clear()
            scene = self.scene(script)
            for _ in scene.stream(np.ones((10, 8)), fields=("t",), deadline=0.1):
                if not resumed.is_set():
                    pause(scene._client.connection)
                resumed.set()

    def test_a_server_that_does_not_greet_is_none(self):
        with self.assertRaisesRegex(raynest.ConnectError, "no RayNest daemon answers within"):
            raynest.connect(self.fake(lambda peer: peer.until("Bye"), welcome=None))

    def test_a_daemon_that_does_not_cancel_loses_the_connection(self):
        def script(peer):
            peer.until("QueryRays")
            peer.send("Chunk", {"count": 5}, t=t(5))
            peer.until("Bye")
        scene = self.scene(script)
        for _ in scene.stream(np.ones((10, 8)), fields=("t",)):
            break
        self.assertTrue(scene._client.connection.closed)


if __name__ == "__main__":
    del sys.argv[1:4]
    unittest.main()
