#!/usr/bin/env python3
"""The Python client against a real daemon: all kinds and forms of rays, pictures, scenes, errors,
and what happens when a request is left before its end.

  client_test.py RAYNESTD RAYNEST FLATC
"""
import json
import os
import pathlib
import signal
import sys
import tempfile
import threading
import time
import unittest

import numpy as np

import raynest
from daemon import PATIENCE, SHARED_SCENES, Client, Daemon

MISS = {"t": np.inf, "prim": 2**32 - 1, "geom": 2**32 - 1, "path": 2**64 - 1, "inst": 2**32 - 1,
        "uid": 2**32 - 1, "material": 2**32 - 1, "uv": 0, "ng": 0, "front": 0, "position": 0,
        "hit": 0}
FIELDS = ("t", "prim", "geom", "path", "inst", "uid", "uv", "ng", "front", "position", "material",
          "hit", "flags", "total")


def rain(count, seed=1):
    """Rays (count, 8) from the sky, some of them to the side; float32, of the form that travels."""
    chance = np.random.default_rng(seed)
    rays = np.zeros((count, 8), np.float32)
    rays[:, :3] = chance.uniform(-60, 60, (count, 3))
    rays[:, 1] = 60
    rays[:, 4:7] = chance.normal(0, 0.3, (count, 3))
    rays[:, 5] = -1
    rays[:, 7] = np.inf
    rays[::7, 5] = 1
    return rays


class WithDaemon(unittest.TestCase):
    raynestd = None
    raynest = None

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="raynest python ")
        cls.out = pathlib.Path(cls.folder.name)
        cls.socket = f"unix:{cls.out}/socket"
        cls.daemon = Daemon(cls.raynestd, "--listen", cls.socket)
        cls.cli = Client(cls.raynest, cls.daemon.uri)
        cls.client = raynest.connect(cls.daemon.uri)
        cls.woods = cls.client.load("builtin:forest?trees=20", "woods")

    @classmethod
    def tearDownClass(cls):
        cls.client.close()
        code = cls.daemon.stop()
        cls.folder.cleanup()
        assert code == 0, code

    def same(self, a, b):
        self.assertEqual(a.keys(), b.keys())
        for name in a:
            self.assertEqual(a[name].dtype, b[name].dtype, name)
            np.testing.assert_array_equal(a[name], b[name], name)


class Rays(WithDaemon):
    def from_cli(self, rays, *options):
        """What `raynest query` answers for the same rays."""
        np.save(self.out / "rays.npy", rays)
        done = self.cli.run("query", "woods", "--rays", self.out / "rays.npy", *options, "-o",
                            self.out / "hits.npz")
        self.assertEqual(done.returncode, 0, done.stderr)
        with np.load(self.out / "hits.npz") as file:
            return {name: file[name] for name in file.files}

    def test_closest_is_what_the_command_line_answers(self):
        rays = rain(40000)
        hits = self.woods.trace(rays, fields=FIELDS)
        self.same(hits, self.from_cli(rays, "--fields", ",".join(FIELDS)))
        self.assertGreater(np.count_nonzero(hits["hit"]), 20000)
        self.assertGreater(np.count_nonzero(hits["hit"] == 0), 5000)

    def test_multi_is_what_the_command_line_answers(self):
        rays = rain(40000)
        hits = self.woods.trace(rays, kind="multi", max_hits=5, fields=FIELDS)
        self.same(hits, self.from_cli(rays, "--kind", "multi", "--max-hits", "5", "--fields",
                                      ",".join(FIELDS)))
        counts = np.diff(hits["ray_splits"])
        self.assertEqual((len(counts), counts.max(), len(hits["uv"])), (40000, 5, counts.sum()))
        closest = self.woods.trace(rays, fields=("t",))["t"]
        some = counts > 0
        np.testing.assert_array_equal(hits["t"][hits["ray_splits"][:-1][some].astype(int)],
                                      closest[some])

    def test_any_is_what_the_command_line_answers(self):
        rays = rain(40000)
        hits = self.woods.trace(rays, kind="any")
        self.same(hits, self.from_cli(rays, "--kind", "any"))
        self.assertEqual(self.woods.trace(rays, kind="any", fields=("flags", "hit")).keys(),
                         {"flags", "hit"})

    def test_default_columns_and_what_a_miss_looks_like(self):
        hits = self.woods.trace([[0, 0, 0, 0, 1, 0], [0, 1000, 0, 0, 1, 0]])
        self.assertEqual(list(hits), ["t", "prim", "geom", "path", "uv"])
        hits = self.woods.trace([[0, 1000, 0, 0, 1, 0]], fields=list(MISS))
        for name, value in MISS.items():
            self.assertTrue((hits[name] == value).all(), name)

    def test_all_forms_of_rays_give_the_same(self):
        rays = rain(20000)
        six = rays[:, [0, 1, 2, 4, 5, 6]]
        expected = self.woods.trace(rays)
        for form in ((six,), (np.ascontiguousarray(six),), (six.astype(np.float64),),
                     (rays[:, :3], rays[:, 4:7]), (np.asfortranarray(rays),),
                     (rays[::-1][::-1],), (rays.astype(np.float64),)):
            self.same(self.woods.trace(*form), expected)
        self.assertEqual(len(self.woods.trace(rays[0, :3], rays[:5, 4:7])["t"]), 5)

    def test_tmin_and_tmax_bound_the_hits(self):
        ray = np.array([[0.3, 60, 0.4, 0, 0, -1, 0, np.inf]], np.float32)
        t = self.woods.trace(ray)["t"][0]
        self.assertTrue(0 < t < 100)
        for tmin, tmax, hit in ((0, t, 1), (0, np.nextafter(t, np.float32(0)), 0), (t, 2 * t, 0)):
            ray[0, 3], ray[0, 7] = tmin, tmax
            found = self.woods.trace(ray, kind="multi", max_hits=1, fields=("t", "hit"))
            self.assertEqual(t in found["t"], bool(hit), (tmin, tmax))

    def test_no_rays_give_empty_columns(self):
        one = self.woods.trace(np.zeros((1, 6)), fields=FIELDS)
        none = self.woods.trace(np.zeros((0, 6)), fields=FIELDS)
        self.assertEqual({name: (column.dtype, column.shape[1:]) for name, column in one.items()},
                         {name: (column.dtype, column.shape[1:]) for name, column in none.items()})
        self.assertTrue(all(len(column) == 0 for column in none.values()))
        multi = self.woods.trace(np.zeros((0, 8)), kind="multi")
        self.assertEqual((multi["ray_splits"].tolist(), len(multi["t"])), ([0], 0))
        self.assertEqual(list(self.woods.stream(np.zeros((0, 6)))), [])
        with self.assertRaises(raynest.UsageError):
            self.woods.trace(np.zeros((0, 6)), fields=("unheard",))

    def test_rays_that_make_no_sense_are_flagged_misses(self):
        rays = rain(7)
        rays[0, 0], rays[1, 5], rays[2, 4:7], rays[3, 3], rays[4, 7], rays[5, 3] = \
            np.nan, np.inf, 0, -1, np.nan, 7
        rays[5, 7] = 6
        hits = self.woods.trace(rays, fields=("t", "hit", "flags"))
        self.assertEqual(hits["flags"].tolist(), [1, 1, 1, 1, 1, 1, 0])
        self.assertTrue(np.isinf(hits["t"][:6]).all())
        self.assertEqual(self.woods.trace(np.full((1, 6), 1e300), fields=("flags",))["flags"], [1])

    def test_an_origin_keeps_the_digits_of_far_coordinates(self):
        origin = np.array([4e6, 5e6, 100.0])
        vertices = origin + [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        scene = self.client.mesh(vertices, [[0, 1, 2]], origin=origin)
        down = [0, 0, -1]
        for x, hit in ((0.99, 1), (1.01, 0)):
            points = origin + [[x, 0.001, 5.0]]
            self.assertEqual(scene.trace(points, down, fields=("hit",))["hit"][0], hit)
            self.assertEqual(scene.occluded(points, points - [0, 0, 10])[0], bool(hit))
            shifted = self.client.scene(scene.name).trace(points, down, origin=origin,
                                                          fields=("hit",))
            self.assertEqual(shifted["hit"][0], hit)

    def test_occluded_asks_about_the_segment_alone(self):
        wall = self.client.mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]])
        ends = [[0, 0, -1], [0, 0, 0.5], [0, 0, 0], [5, 0, -1]]
        self.assertEqual(wall.occluded([0, 0, 1], ends).tolist(), [True, False, False, False])

    def test_options_reach_the_daemon(self):
        rays = rain(2000)
        sums = [np.minimum(self.woods.trace(rays, intersector="procedural_mask",
                                            params={"pattern": "discs", "fill": fill})["t"],
                           1000).sum() for fill in (0.1, 0.9)]
        self.assertGreater(sums[0], sums[1])
        self.assertEqual(self.client.outcome["intersector"], "procedural_mask")
        for traversal in ("latency", "batch"):
            named = self.woods.trace(rays, traversal=traversal)
            self.assertEqual(self.client.outcome["traversal"], traversal)
            self.same(named, self.woods.trace(rays))
        self.assertEqual(self.client.outcome["rays"], 2000)
        self.assertTrue(np.isinf(self.woods.trace(rays, mask=0)["t"]).all())
        self.woods.trace(rays, precision="fast", priority="low", deadline=30, epoch=1)
        with self.assertRaisesRegex(TypeError, "there is no option unheard"):
            self.woods.trace(rays, unheard=1)

    def test_tiny_windows_only_cost_time(self):
        rays = rain(60000)
        expected = self.woods.trace(rays, fields=FIELDS)
        for uri in (self.daemon.uri, self.socket):
            with raynest.connect(uri, window_bytes=64 << 10) as narrow:
                scene = narrow.scene("woods")
                self.same(scene.trace(rays, fields=FIELDS), expected)
                self.assertEqual(scene.trace(rays[:99], kind="multi", max_hits=256)["ray_splits"][-1],
                                 self.woods.trace(rays[:99], kind="multi", max_hits=256)["t"].size)

    def test_progress_rises_to_the_end(self):
        seen = []
        self.woods.trace(rain(50000), fields=("t",), progress=lambda *news: seen.append(news))
        self.assertEqual(seen[-1], (50000, 50000, "tracing"))
        self.assertEqual(seen, sorted(seen))
        self.assertGreater(len(seen), 2)


class Streams(WithDaemon):
    def test_chunks_cover_all_rays_once(self):
        rays = rain(100000)
        whole = self.woods.trace(rays, fields=("t", "path"))
        seen = np.zeros(len(rays), int)
        for first, columns in self.woods.stream(rays, fields=("t", "path")):
            part = slice(first, first + len(columns["t"]))
            seen[part] += 1
            self.same(columns, {name: column[part] for name, column in whole.items()})
        self.assertTrue((seen == 1).all())
        self.assertEqual(self.client.outcome["rays"], 100000)

    def test_blocks_of_an_iterator_count_on(self):
        blocks = [rain(30000), rain(0), rain(12345, seed=2), rain(1, seed=3)]
        whole = self.woods.trace(np.concatenate(blocks), fields=("t",))["t"]
        answered = np.full(len(whole), np.nan)
        for first, columns in self.woods.stream(iter(blocks), fields=("t",)):
            answered[first:first + len(columns["t"])] = columns["t"]
        np.testing.assert_array_equal(answered, whole)

    def test_multi_comes_with_splits_of_its_own(self):
        rays = rain(40000)
        whole = self.woods.trace(rays, kind="multi", fields=("t",))
        counts = np.diff(whole["ray_splits"])
        for first, columns in self.woods.stream(rays, kind="multi", fields=("t",)):
            own = np.diff(columns["ray_splits"])
            np.testing.assert_array_equal(own, counts[first:first + len(own)])
            start = int(whole["ray_splits"][first])
            np.testing.assert_array_equal(columns["t"], whole["t"][start:start + len(columns["t"])])

    def test_leaving_a_stream_cancels_it_and_frees_the_connection(self):
        cancelled = self.client.stats()["jobs_cancelled"]
        for _ in self.woods.stream(rain(4_000_000), fields=("t", "total")):
            break
        stats = self.client.stats()
        self.assertEqual(stats["jobs_cancelled"], cancelled + 1)
        self.assertEqual(stats["jobs_ended"], stats["jobs_started"])
        self.assertEqual(len(self.woods.trace(rain(5))["t"]), 5)

    def test_an_open_stream_keeps_the_connection(self):
        stream = self.woods.stream(rain(200000))
        next(stream)
        with self.assertRaisesRegex(raynest.UsageError, "a stream is still open"):
            self.client.scenes()
        stream.close()
        self.assertTrue(self.client.scenes())

    def test_an_exception_in_the_loop_leaves_the_connection_usable(self):
        with self.assertRaises(ZeroDivisionError):
            self.woods.trace(rain(200000), progress=lambda *_: 1 // 0)
        self.assertLess(self.client.ping(), PATIENCE)

    def test_threads_take_turns(self):
        rays = rain(30000)
        expected = self.woods.trace(rays)
        answers = [None] * 4

        def work(i):
            answers[i] = self.woods.trace(rays)
        threads = [threading.Thread(target=work, args=(i,)) for i in range(len(answers))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        for answer in answers:
            self.same(answer, expected)


class Interrupts(WithDaemon):
    def interrupt_once(self, condition):
        """Ctrl-C for this process, as soon as the daemon says so to a second connection."""
        def wait():
            with raynest.connect(self.daemon.uri) as watcher:
                end = time.monotonic() + PATIENCE
                while not condition(watcher.stats()) and time.monotonic() < end:
                    time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGINT)
        thread = threading.Thread(target=wait)
        thread.start()
        self.addCleanup(thread.join)

    def assert_usable(self, before):
        stats = self.client.stats()
        self.assertEqual(stats["jobs_cancelled"], before["jobs_cancelled"] + 1)
        self.assertEqual(stats["jobs_ended"], stats["jobs_started"])
        self.assertFalse(self.client.connection.closed)
        self.assertEqual(signal.getsignal(signal.SIGINT), signal.default_int_handler)
        np.testing.assert_array_equal(self.woods.trace(rain(100))["t"],
                                      self.woods.trace(rain(100))["t"])

    def test_an_interrupt_cancels_a_picture(self):
        before = self.client.stats()
        self.interrupt_once(lambda stats: stats["jobs_started"] > before["jobs_started"])
        with self.assertRaises(KeyboardInterrupt):
            self.woods.render(size=(8192, 8192))
        self.assert_usable(before)

    def test_an_interrupt_cancels_a_query_in_the_midst_of_sending(self):
        before = self.client.stats()
        self.interrupt_once(lambda stats: stats["rays"] > before["rays"])
        with self.assertRaises(KeyboardInterrupt):
            self.woods.trace(rain(8_000_000), fields=FIELDS)
        self.assert_usable(before)

    def test_a_handler_of_the_program_stays(self):
        seen = []
        old = signal.signal(signal.SIGINT, lambda *_: seen.append(1))
        self.addCleanup(signal.signal, signal.SIGINT, old)
        rays = self.client.stats()["rays"]
        self.interrupt_once(lambda stats: stats["rays"] > rays)
        self.woods.trace(rain(1_000_000), fields=("t",))
        self.until(lambda: seen)

    def until(self, condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            self.assertLess(time.monotonic(), end, "it did not come true")
            time.sleep(0.01)

    def test_a_deadline_ends_the_request_alone(self):
        with self.assertRaises(raynest.DeadlineError) as caught:
            self.woods.render(size=(8192, 8192), deadline=0.2)
        self.assertEqual((caught.exception.name, caught.exception.exit_code), ("DEADLINE", 7))
        self.assertIsInstance(caught.exception, TimeoutError)
        self.assertLess(self.client.ping(), PATIENCE)


class Scenes(WithDaemon):
    def test_info_is_what_the_command_line_says(self):
        info, expected = self.woods.info, self.cli.json("info", "woods")
        for key in expected.keys() - {"bytes_per_triangle"}:
            self.assertEqual(info[key], expected[key], key)
        self.assertTrue((np.array(info["box_min"]) < info["box_max"]).all())

    def test_lists_are_what_the_command_line_says(self):
        self.assertEqual([scene["name"] for scene in self.client.scenes()],
                         [scene["name"] for scene in self.cli.json("scenes")["scenes"]])
        masks = next(v for v in self.client.variants() if v["name"] == "alpha_mask")
        self.assertEqual([param["name"] for param in masks["params"]][:1], ["cutoff"])
        self.assertEqual(self.client.stats().keys(), self.cli.json("stats").keys())

    def test_paths_have_names(self):
        paths = self.woods.trace(rain(2000), fields=("path",))["path"]
        paths = paths[paths != MISS["path"]][:20]
        names = self.woods.path_of(paths)
        self.assertEqual(len(names), len(paths))
        for path, name in list(zip(paths, names))[:3]:
            self.assertIn(name, self.cli.run("path", "woods", path).stdout)
            self.assertEqual(self.woods.path_of(int(path)), name)
        self.assertEqual(self.woods.path_of(paths[:0]), [])

    def test_files_come_with_what_they_name(self):
        if not SHARED_SCENES.is_dir():
            self.skipTest(f"skipped: {SHARED_SCENES} is not there")
        loaded = 0
        for path in sorted(SHARED_SCENES.rglob("small/**/*.gl*")):
            with self.subTest(path=str(path)):
                expected = self.cli.run("--json", "load", path, "--name", "by-cli", "--replace")
                news = []
                scene = self.client.load(path, "by-python", replace=True,
                                         progress=lambda *item: news.append(item))
                self.assertEqual(scene.info["hash"], json.loads(expected.stdout)["hash"])
                self.assertTrue(news)
                loaded += 1
        self.assertGreater(loaded, 2)

    def test_files_outside_of_the_folder_are_not_sent(self):
        folder = self.out / "scene"
        (folder / "inner").mkdir(parents=True)
        (self.out / "secret.bin").write_bytes(b"secret")
        (folder / "link.bin").symlink_to(self.out / "secret.bin")
        (folder / "inner" / "there.bin").write_bytes(b"there")
        os.mkfifo(folder / "pipe.bin")
        for uri in ("../secret.bin", "link.bin", "pipe.bin", "missing.bin", "inner/../inner/there.bin"):
            document = {"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 5}]}
            (folder / "a.gltf").write_text(json.dumps(document))
            with self.assertRaisesRegex(raynest.InvalidError, "a.gltf names") as caught:
                self.client.load(folder / "a.gltf")
            self.assertEqual(caught.exception.exit_code, 5)
        for name in ("a.obj", "missing.glb"):
            with self.assertRaises(raynest.InvalidError):
                self.client.load(folder / name)

    def test_records_need_a_primitive(self):
        np.save(self.out / "balls.npy", np.array([[0, 0, 0, 1], [5, 0, 0, 2]], np.float32))
        with self.assertRaisesRegex(raynest.UsageError, "primitive="):
            self.client.load(self.out / "balls.npy")
        balls = self.client.load(self.out / "balls.npy", primitive="sphere")
        self.assertEqual(balls.name, "balls")
        hits = balls.trace([[0, 0, 9, 0, 0, -1], [5, 0, 9, 0, 0, -1]], fields=("t", "prim"))
        np.testing.assert_allclose(hits["t"], [8, 7], rtol=1e-6)
        self.assertEqual(hits["prim"].tolist(), [0, 1])

    def test_rows_of_faces_are_the_column_prim(self):
        chance = np.random.default_rng(5)
        centres = chance.uniform(-10, 10, (500, 3)) * [1, 1, 0] + [0, 0, 1] * np.arange(500)[:, None]
        vertices = (centres[:, None] + [[-1, -1, 0], [1, -1, 0], [0, 1, 0]]).reshape(-1, 3)
        scene = self.client.mesh(vertices, np.arange(1500).reshape(-1, 3), "triangles")
        hits = scene.trace(centres + [0, 0, 0.5], [0, 0, -1], fields=("t", "prim"))
        self.assertEqual(hits["prim"].tolist(), list(range(500)))
        np.testing.assert_allclose(hits["t"], 0.5, atol=1e-4)
        self.assertEqual(scene.info["unique_triangles"], 500)

    def test_a_mesh_is_called_after_its_content(self):
        corners = np.eye(3)
        a, b = (self.client.mesh(corners, [[0, 1, 2]]) for _ in range(2))
        c = self.client.mesh(corners * 2, [[0, 1, 2]])
        self.assertEqual(a.name, b.name)
        self.assertNotEqual(a.name, c.name)
        c.unload()
        with self.assertRaises(raynest.InvalidError):
            self.client.scene(c.name)

    def test_a_taken_name_needs_replace_and_is_a_new_epoch(self):
        corners = np.eye(3)
        first = self.client.mesh(corners, [[0, 1, 2]], "taken")
        with self.assertRaises(raynest.FailedError) as caught:
            self.client.mesh(corners * 2, [[0, 1, 2]], "taken")
        self.assertEqual(caught.exception.name, "NAME_TAKEN")
        self.assertEqual(first.info["epoch"], 1)
        again = self.client.mesh(corners * 2, [[0, 1, 2]], "taken", replace=True)
        self.assertEqual(again.info["epoch"], 2)
        with self.assertRaises(raynest.Error):
            again.trace(rain(1), epoch=1)


class Pictures(WithDaemon):
    def test_pictures_are_what_the_command_line_gets(self):
        self.cli.run("heatmap", "woods", "--size", "64x36", "-o", self.out / "h.npy")
        np.testing.assert_array_equal(self.woods.heatmap(size=(64, 36)), np.load(self.out / "h.npy"))
        heat = self.client.outcome["heat"]
        self.assertEqual(heat["metric"], "total")
        for name, options in (("h.png", {}), ("h.exr", {"metric": "prims", "palette": "viridis"})):
            words = [word for key, value in options.items() for word in (f"--{key}", value)]
            self.cli.run("heatmap", "woods", "--size", "64x36", *words, "-o", self.out / name)
            self.assertEqual(self.woods.heatmap(size=(64, 36), encode=name[-3:], **options),
                             (self.out / name).read_bytes())
        self.cli.run("render", "woods", "--size", "64x36", "-o", self.out / "r.png")
        self.assertEqual(self.woods.render(size=(64, 36), encode="png"),
                         (self.out / "r.png").read_bytes())

    def test_raw_pixels_are_an_array(self):
        pixels = self.woods.render(size=(80, 45), camera=1)
        self.assertEqual((pixels.shape, pixels.dtype), ((45, 80, 4), np.uint8))
        self.assertEqual(self.client.outcome["camera"], "canopy")
        above = self.woods.render(size=(40, 30), look_at=([0, 100, 0], [0, 0, 0], [0, 0, 1]), fov=30)
        self.assertEqual(set(above[:, :, 3].ravel()), {255})

    def test_large_pictures_come_in_pieces(self):
        news = []
        pixels = self.woods.render(size=(2048, 2048), progress=lambda *item: news.append(item))
        self.assertEqual(pixels.shape, (2048, 2048, 4))
        self.assertTrue((pixels[-1, :, 3] == 255).any())

    def test_bad_cameras_and_sizes_are_refused(self):
        for options in ({"size": (0, 5)}, {"size": (99999, 5)}, {"look_at": ([0, 0, 0],)},
                        {"look_at": ([0, 0], [1, 1])}, {"camera": "unheard"}, {"fov": 200},
                        {"encode": "unheard"}, {"camera": 7}):
            with self.assertRaises(raynest.UsageError, msg=options):
                self.woods.render(**{"size": (8, 8), **options})


class Errors(WithDaemon):
    def test_errors_have_the_class_of_their_exit_code(self):
        ray = rain(1)
        for kind, name, call in (
                (raynest.InvalidError, "SCENE_UNKNOWN", lambda: self.client.scene("nowhere")),
                (raynest.InvalidError, "VARIANT_UNKNOWN",
                 lambda: self.woods.trace(ray, intersector="unheard")),
                (raynest.UsageError, "INVALID_PARAM",
                 lambda: self.woods.trace(ray, params={"unheard": 1})),
                (raynest.UsageError, "INVALID_FIELD", lambda: self.woods.trace(ray, kind="unheard")),
                (raynest.UsageError, "INVALID_FIELD",
                 lambda: self.woods.trace(ray, fields=("t", "unheard"))),
                (raynest.UsageError, "INVALID_FIELD",
                 lambda: self.woods.trace(ray, kind="any", fields=("t",))),
                (raynest.InvalidError, "LIMIT_EXCEEDED",
                 lambda: self.woods.trace(ray, kind="multi", max_hits=257)),
                (raynest.InvalidError, "SCENE_INVALID", lambda: self.client.load("builtin:unheard"))):
            with self.assertRaises(kind, msg=name) as caught:
                call()
            self.assertEqual(caught.exception.name, name)
            self.assertNotIn("\n", str(caught.exception))
        # In the midst of many rays, too.
        with self.assertRaises(raynest.UsageError):
            self.woods.trace(rain(1_000_000), fields=("unheard",))
        self.assertEqual(len(self.woods.trace(ray)["t"]), 1)

    def test_servers_that_are_none(self):
        for uri in ("127.0.0.1:31060", "tcp://127.0.0.1", "tcp://127.0.0.1:0", "tcp://127.0.0.1:65536"):
            with self.assertRaises(raynest.UsageError, msg=uri):
                raynest.connect(uri)
        for uri in ("tcp://127.0.0.1:9", f"unix:{self.out}/nobody", "unix:" + "x" * 200):
            with self.assertRaises(raynest.ConnectError, msg=uri) as caught:
                raynest.connect(uri)
            self.assertEqual(caught.exception.exit_code, 3)
            self.assertIsInstance(caught.exception, ConnectionError)

    def test_the_address_comes_from_the_environment(self):
        os.environ["RAYNEST_SERVER"] = self.socket
        self.addCleanup(os.environ.pop, "RAYNEST_SERVER")
        with raynest.connect() as client:
            self.assertEqual(client.uri, self.socket)
            self.assertIn("raynestd", repr(client))
            self.assertEqual(len(client.scene("woods").trace(rain(3))["t"]), 3)
        with self.assertRaisesRegex(raynest.ConnectError, "connect again"):
            client.scenes()

    def test_a_daemon_that_goes_away_is_an_error(self):
        daemon = Daemon(self.raynestd)
        client = raynest.connect(daemon.uri)
        client.load("builtin:terrain?size=16", "hills")
        daemon.stop()
        with self.assertRaises(raynest.Error):
            client.scenes()


if __name__ == "__main__":
    WithDaemon.raynestd, WithDaemon.raynest = sys.argv[1:3]
    del sys.argv[1:4]
    unittest.main()
