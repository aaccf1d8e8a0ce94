#!/usr/bin/env python3
"""Daemons that lie: every wrong length, type, order and end is one exception, soon, and none of
them costs memory first.

  hostile_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import contextlib
import io
import json
import os
import pathlib
import resource
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import unittest.mock
import zipfile
import zlib

import numpy as np

import raynest
from raynest._net.control import decode, encode
from raynest._net.frame import HEADER, MAGIC, Header, write_header
from raynest._heat import range_text
from raynest._pictures import _unfiltered
from raynest.merge import merge
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
                peer.send("Payload", {"total": 256, "offset": 64 * i}, data=np.full(64, i, np.uint8))
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
                peer.send("Payload", message, data=piece)
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
            return lambda peer: (peer.send("Payload", message, data=np.zeros(64, np.uint8)),
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

    def test_a_list_without_end(self):
        def script(peer):
            with contextlib.suppress(ConnectionError):
                while True:
                    peer.until("Unload")
                    peer.send("Unloaded", {"names": ["a"] * 500})
        client = raynest.connect(self.fake(script))
        self.addCleanup(client.close)
        with unittest.mock.patch("raynest._requests.words.LISTED_MAX", 2000):
            with self.assertRaisesRegex(raynest.ProtocolError, "more than 2000 entries"):
                client.unload_all()

    def test_a_request_that_starts_twice(self):
        def answer(peer):
            peer.send("Started", {})
            peer.send("Started", {})
            peer.until("Cancel")
            peer.send("Error", {"code": 14})
        self.assertIn("twice", str(self.refused(answer, closed=False)))

    def test_files_that_were_not_offered(self):
        for lies in ([[1]], [[0, 0]], [[], []]):
            def script(peer):
                peer.until("Load")
                for files in lies:
                    peer.send("Need", {"files": files})
                peer.until("Cancel")
                peer.send("Error", {"code": 14})
            client = raynest.connect(self.fake(script))
            with self.assertRaisesRegex(raynest.ProtocolError, "not offered|Need twice"):
                client.mesh(np.eye(3), [[0, 1, 2]])
            client.close()

    def test_a_request_that_ends_before_it_began(self):
        def script(peer):
            peer.until("QueryRays")
            peer.started = peer.id
            peer.send("Done", {})
        with self.assertRaisesRegex(raynest.ProtocolError, "had not started"):
            self.scene(script).trace(np.ones((9, 8), np.float32))

    def test_a_column_that_was_asked_for_is_not_hidden(self):
        def script(peer):
            peer.until("QueryRays")
            peer.send("Started", {"hidden": ["hit"]})
            peer.send("Chunk", {"count": 9}, hit=np.ones(9, np.uint8))
            peer.send("Done", {})
        self.assertTrue(self.scene(script).trace(np.ones((9, 8), np.float32), kind="any")["hit"].all())

    def answered(self, request, answer, message):
        """A client whose request gets this answer."""
        def script(peer):
            peer.until(request)
            peer.send(answer, message)
        client = raynest.connect(self.fake(script))
        self.addCleanup(client.close)
        return client

    def test_lists_of_different_lengths(self):
        scenes = {"names": ["a", "b"], "total": 2, "hashes": ["", ""], "owners": ["", ""],
                  **{key: [1, 2] for key in ("epochs", "instanced_triangles", "bytes", "age_ms", "idle_ms", "holders")}}
        older = self.answered("Scenes", "SceneList", scenes).scenes()
        self.assertEqual([(each["name"], each["epoch"], each["share"]) for each in older], [("a", 1, ""), ("b", 2, "")])
        for lie in ({"age_ms": []}, {"hashes": ["x"]}, {"shares": ["public"]}):
            with self.assertRaisesRegex(raynest.ProtocolError, "different lengths"):
                self.answered("Scenes", "SceneList", {**scenes, **lie}).scenes()
        with self.assertRaisesRegex(raynest.ProtocolError, "different lengths"):
            self.answered("Stats", "Statistics", {"names": ["a", "b"], "values": [1.0]}).stats()

    def test_places_that_are_not_finite(self):
        for lie in ({"origin_x": np.nan}, {"box_min": (0, 0, 0), "box_max": (1, np.inf, 1)}):
            with self.assertRaisesRegex(raynest.ProtocolError, "finite"):
                self.answered("Info", "SceneInfo", lie).scene("fake")

    def test_a_text_that_a_small_message_names_many_times(self):
        """Each name of a list costs memory, but all offsets may lead to one text."""
        data = bytearray(encode("SceneList", {"names": ["x" * 1000, *["y"] * 100]}))
        at = data.index(struct.pack("<I", 101)) + 4
        first = at + struct.unpack_from("<I", data, at)[0]
        for place in range(at, at + 4 * 101, 4):
            struct.pack_into("<I", data, place, first - place)
        self.assertLess(len(data), 8 << 10)
        with self.assertRaisesRegex(raynest.ProtocolError, "repeats"):
            decode("SceneList", bytes(data))

    def test_a_picture_larger_than_was_asked_for(self):
        def exr(width, channels):
            def attribute(name, kind, value):
                return name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value
            named = b"".join(b"c%d\0" % i + struct.pack("<I", 2) + bytes(12) for i in range(channels))
            head = (struct.pack("<II", 20000630, 2) + attribute(b"channels", b"chlist", named + b"\0")
                    + attribute(b"compression", b"compression", b"\3")
                    + attribute(b"dataWindow", b"box2i", struct.pack("<4i", 0, 0, width - 1, 7)) + b"\0")
            block = zlib.compress(bytes(8 * width * 4 * channels))
            return head + struct.pack("<QiI", len(head) + 8, 0, len(block)) + block

        def picture(file):
            def script(peer):
                peer.until("Render")
                peer.send("Payload", {"total": len(file), "last": True}, data=np.frombuffer(file, np.uint8))
                peer.send("Done", {})
            return self.scene(script).render(size=(8, 8), integrator="path")
        self.assertEqual(picture(exr(8, 3))["c0"].shape, (8, 8))
        for width, channels in ((8192, 3), (8, 400)):
            with self.assertRaisesRegex(raynest.ProtocolError, "cannot be read"):
                picture(exr(width, channels))


class Parts(unittest.TestCase):
    """Files that `raynest merge` is given: each is refused by its name, or its rows are there."""

    def merged(self, *parts):
        with tempfile.TemporaryDirectory(prefix="raynest-parts-") as folder:
            paths = [pathlib.Path(folder) / f"{i}.npz" for i in range(len(parts))]
            for path, (said, columns) in zip(paths, parts):
                with zipfile.ZipFile(path, "w") as file:
                    said = said if isinstance(said, bytes) else json.dumps(said).encode()
                    for name, column in {"part": np.frombuffer(said, np.uint8), **columns}.items():
                        data = io.BytesIO()
                        np.save(data, column, allow_pickle=True)
                        file.writestr(name + ".npy", data.getvalue())
            whole = pathlib.Path(folder) / "whole.npz"
            before = os.umask(0o027)
            try:
                merge(str(whole), list(map(str, paths)))
            finally:
                os.umask(before)
            self.assertEqual(whole.stat().st_mode & 0o777, 0o640)
            with np.load(whole) as file:
                return {name: file[name] for name in file.files}

    def test_parts(self):
        def part(first, **more):
            return {"first": first, "count": 3, "of": 6, **more}
        ends = np.array([0, 2, 2, 5])
        hits = self.merged((part(0), {"file": t(3)}), (part(3), {"file": t(3)}))
        np.testing.assert_array_equal(hits["file"], [0, 1, 2, 0, 1, 2])
        hits = self.merged(*[(part(i), {"ray_splits": ends, "t": t(5)}) for i in (0, 3)])
        np.testing.assert_array_equal(hits["ray_splits"], [0, 2, 2, 5, 7, 7, 10])
        for name, said, columns in (
                ("few rows", part(3), {"t": t(2)}), ("no rows", part(3), {"t": np.float32(1)}),
                ("other rows of each", part(3), {"t": t(6)}), ("another width", part(3), {"t": np.zeros((3, 2), np.float32)}),
                ("another type", part(3), {"t": np.zeros(3, np.uint32)}),
                ("objects", part(3), {"t": np.array([{}, {}, {}], object)}), ("texts", part(3), {"t": np.array(["a", "b", "c"])}),
                ("splits", part(3), {"t": t(5), "ray_splits": ends[::-1]}),
                ("no columns of a reducer", part(3, reduce="visible_pixels"), {"t": t(3)}),
                ("a huge number", b'{"first": 1e999, "count": 3, "of": 6}', {"t": t(3)}), ("depth", b"[" * 100000, {"t": t(3)})):
            with self.subTest(name), self.assertRaisesRegex(raynest.InvalidError, "1.npz"):
                self.merged((part(0), {"t": t(5), "ray_splits": ends} if "ray_splits" in columns else {"t": t(3)}), (said, columns))

    def test_columns_have_the_types_that_answers_have(self):
        ends, seen = np.array([0, 2, 2, 5]), {"path": np.ones(1, np.uint64), "pixels": np.ones(1, np.uint32)}
        whole = {"first": 0, "count": 3, "of": 3}
        self.merged((whole, {"t": t(5), "ray_splits": ends}))
        self.merged(({**whole, "reduce": "visible_pixels"}, seen))
        for more, columns in (("", {"t": t(5), "ray_splits": ends.astype(np.uint8)}), ("", {"t": t(3).astype(float)}),
                              ("", {"uv": np.zeros((3, 3), np.float32)}), ("", {"file": np.zeros(3, np.longdouble)}),
                              ("visible_pixels", {**seen, "pixels": -np.ones(1, int)}),
                              ("visible_pixels", {name: column[:, None] for name, column in seen.items()})):
            with self.subTest(columns), self.assertRaisesRegex(raynest.InvalidError, "0.npz: is no part, made with --part: its column"):
                self.merged(({**whole, "reduce": more}, columns))

    def test_what_only_all_parts_together_have(self):
        splits = [({"first": first, "count": 1, "of": 2}, {"flags": np.zeros(1, np.uint8), "ray_splits": np.array([0, 2**62])})
                  for first in (0, 1)]
        with self.assertRaisesRegex(raynest.InvalidError, "more hits than are counted"):
            self.merged(*splits)
        with unittest.mock.patch("raynest.merge.joined", side_effect=OverflowError("at x")), \
                self.assertRaisesRegex(raynest.InvalidError, "0.npz and the other parts become no .npz: it is damaged, or has been cut$"):
            self.merged(splits[0], splits[1])

    def test_ranges_are_those_of_all_counts(self):
        counts = np.arange(1, 151)
        for asked, wanted in (("p99", "0:149"), ("auto", "0:150"), ("0.5:1e20", "0.5:1e+20")):
            with self.subTest(asked=asked, wanted=wanted):
                self.assertEqual(range_text(asked, counts, False), wanted)
        for case in json.loads((pathlib.Path(__file__).parents[1] / "golden/heat_ranges.json").read_text())["cases"]:
            values = np.repeat(*np.array(case["values"]).T)
            for asked in ("auto", "p99"):
                differs, end = case.get("difference", False), case[asked]
                with self.subTest(case["what"], asked=asked):
                    self.assertEqual(range_text(asked, values, differs), f"{-end if differs else 0}:{end}")

    def test_the_first_row_of_a_part_loses_its_filter(self):
        row = np.random.default_rng(5).integers(0, 256, 20, np.uint8)
        for kind, before in ((0, lambda left: 0), (1, lambda left: left), (2, lambda left: 0), (3, lambda left: left // 2), (4, lambda left: left)):
            plain = []
            for i, value in enumerate(row.tolist()):
                plain.append((value + before(plain[i - 4] if i >= 4 else 0)) % 256)
            self.assertEqual(_unfiltered(bytes([kind]) + row.tobytes()), b"\0" + bytes(plain), kind)

    def test_a_whole_that_cannot_be_written(self):
        with self.assertRaisesRegex(raynest.UsageError, "cannot write /nowhere/a.npz: No such file"):
            with tempfile.NamedTemporaryFile(suffix=".npz") as part:
                said = np.frombuffer(b'{"first": 0, "count": 3, "of": 3}', np.uint8)
                np.savez(part, part=said, t=t(3))
                part.flush()
                merge("/nowhere/a.npz", [part.name])


class Hosts(unittest.TestCase):
    def test_who_logs_out_at_the_same_time_loses_nothing(self):
        """hosts.toml is read and written again; it is also a link, which stays one."""
        count, turns = 24, 8  # each is written to the disk
        program = ("import sys; from raynest import logout\n"
                   f"for i in range(int(sys.argv[1]), {count}, {turns}): logout(f'tcp://h{{i}}:1')")
        with tempfile.TemporaryDirectory(prefix="raynest-hosts-") as folder:
            real, link = pathlib.Path(folder) / "real.toml", pathlib.Path(folder) / "raynest/hosts.toml"
            real.touch(0o600)
            real.write_text("# kept\n" + "".join(f'["tcp://h{i}:1"]\ntoken = "t{i}"\n' for i in range(count)) + "# kept, too\n")
            link.parent.mkdir()
            link.symlink_to(real)
            running = [subprocess.Popen([sys.executable, "-c", program, str(turn)],
                                        env={**os.environ, "XDG_CONFIG_HOME": folder}) for turn in range(turns)]
            self.assertEqual([each.wait(PATIENCE) for each in running], [0] * turns)
            self.assertEqual((real.read_text(), link.is_symlink()), ("# kept\n# kept, too\n", True))


class Lines(WithFake):
    def test_errors_are_one_line(self):
        scene = self.scene(lambda peer: peer.until("Bye"))
        for wrong in (np.zeros((3, 3, 3)), [[1, 2], [3]], "a\x1b[2J\nb"):
            for ask in (lambda: scene.render(size=wrong), lambda: scene.explain(pixel=wrong),
                        lambda: scene.render(tile=wrong), lambda: scene.render(sun=wrong, integrator="path")):
                with self.assertRaises(raynest.UsageError) as caught:
                    ask()
                self.assertRegex(str(caught.exception), "^[^\x00-\x1f]* must be [^\x00-\x1f]*$")


if __name__ == "__main__":
    del sys.argv[1:4]
    unittest.main()
