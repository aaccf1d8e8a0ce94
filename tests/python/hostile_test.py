#!/usr/bin/env python3
"""Daemons that lie: every wrong length, type, order and end is one exception, soon, and none of
them costs memory first.

  hostile_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import contextlib
import resource
import struct
import sys
import time
import unittest

import numpy as np

import raynest
from raynest._net.frame import HEADER, MAGIC, Header, write_header
from daemon import PATIENCE
from with_fake import WELCOME, WithFake, frame, t


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
        self.assertLess(time.monotonic() - begin, PATIENCE / 3)
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
        self.assertEqual(str(error), "full (try again in 250 ms) [request 1]")
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

    def test_honest_pictures_pass(self):
        def script(peer):
            peer.until("Render")
            for i in range(4):
                peer.send("Progress", {"done": i, "total": 4, "stage": "tracing"})
                peer.send("Picture", {"total": 256, "offset": 64 * i}, data=np.full(64, i, np.uint8))
            peer.send("Done", {})
        news = []
        pixels = self.scene(script).render(size=(8, 8), progress=lambda *now: news.append(now))
        self.assertEqual(news, [(i, 4, "tracing") for i in range(4)])
        np.testing.assert_array_equal(pixels, np.repeat(np.arange(4), 64).reshape(8, 8, 4))

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


if __name__ == "__main__":
    del sys.argv[1:4]
    unittest.main()
