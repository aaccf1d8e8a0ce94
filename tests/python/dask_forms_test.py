#!/usr/bin/env python3
"""All forms of what one daemon takes, on many hosts: files that only the client has, cameras, rays, columns.

  dask_forms_test.py RAYNESTD RAYNEST FLATC
"""
import inspect
import json
import os
import re
import struct
import subprocess
import sys
import types
import typing
import unittest.mock
import warnings
import zlib

import distributed
import numpy as np
from dask import array

import raynest
from daemon import PATIENCE, until
from animation_test import travelling
from raynest import _command, _roster, generators, returns
from raynest._notes import rounding_of
from raynest.dask import known_to
from raynest._requests import exr, loads, png
from with_cluster import WithCluster, many
from with_daemon import main, rain

SCENE = "builtin:forest?trees=20"
OTHER = "builtin:forest?trees=5"
SWEEP = generators.lidar([-20, -10, 0], (0, 360, 500), look_at=((0, 9, 0), (1, 9, 0)))
# A red sky.
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes((200, 20, 10, 129)) * 8


def drawn_of(file):
    """The pixels of a PNG."""
    at, packed = 8, b""
    while at < len(file):
        size, kind = struct.unpack_from(">I4s", file, at)
        packed += file[at + 8:at + 8 + size] if kind == b"IDAT" else b""
        at += 12 + size
    return png.unfiltered(zlib.decompress(packed), struct.unpack_from(">I", file, 16)[0])


class Rows:
    """A file of an array that workers write rows of, the least that a store has."""

    def __init__(self, path):
        self.path = path

    def __setitem__(self, rows, values):
        numpy = __import__("numpy")     # the workers get it as code: they have not this module
        numpy.load(self.path, mmap_mode="r+")[rows] = values


class Forms(WithCluster):
    def setUp(self):
        super().setUp()
        # No worker sees what is named below this folder: theirs is another.
        before = os.getcwd()
        os.chdir(self.out)
        self.addCleanup(os.chdir, before)

    def command(self, cluster, *words, stdin=subprocess.DEVNULL):
        return subprocess.run([self.raynest, "--dask", cluster.client.scheduler.address, *map(str, words)], cwd=self.out,
                              env={**os.environ, "RAYNEST_PYTHON": sys.executable}, stdin=stdin,
                              capture_output=True, text=True, timeout=10 * PATIENCE)

    def one(self, *words, stdin=subprocess.DEVNULL):
        """The same command on one daemon."""
        subprocess.run([self.raynest, "--server", self.daemon.uri, *map(str, words)], cwd=self.out, check=True,
                       stdin=stdin, capture_output=True)

    def carried(self, cluster, *words, stdin=subprocess.DEVNULL):
        done = self.command(cluster, *words, stdin=stdin)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done

    # ---- files that only the client has ---------------------------------------------------------

    def test_what_names_a_file_is_known(self):
        """A new argument or option that names a file must travel, too."""
        def named(function, *words):
            return {name for name, hint in typing.get_type_hints(function).items()
                    if any(word in str(hint) for word in words)} - {"return"}
        scene = raynest.scene.Scene
        found = {name: named(getattr(scene, name), "PathLike", "Scene") for name in ("trace", "render", "heatmap")}
        self.assertEqual(found, {"trace": set(), "render": {"environment"}, "heatmap": {"diff"}})
        self.assertEqual(set(many.TRAVELS), set().union(*found.values()))
        self.assertEqual(named(raynest.scene.JobOptions, "PathLike", "Scene"), set())
        # prepare() reads these itself.
        self.assertEqual([named(each, "PathLike") for each in (loads.load_of_file, loads.load_of_mesh, loads.load_of_parts)],
                         [{"source", "instances"}, set(), set()])
        for name, function in inspect.getmembers(generators, inspect.isfunction):
            if function.__module__ == generators.__name__ and not name.startswith("_") and name != "of_sensor":
                self.assertEqual(named(function, "PathLike"), set(), name)
        options, settings = set(), set()
        for command in ("query", "render", "heatmap"):
            text = subprocess.run([self.raynest, command, "--help"], check=True, capture_output=True, text=True).stdout
            text = re.sub(r"\n {24,}(?=\S)", " ", text)     # a name too long for its column has its text below it
            for line in text.splitlines():
                if re.search("FILE|OTHER_SCENE", line) and (option := re.match(r" +(?:-\w,)?(--[\w-]+)", line)):
                    options.add(option[1])
                elif "FILE" in line and (setting := re.match(r"  ([a-z]\w+) {2,}", line)):
                    settings.add(setting[1])
        # Those of the last line are read here, or name what is written.
        self.assertEqual(options - {"--returns", "--times", "--trajectory", "--output", "--detach", "--cameras"},
                         set(_command.FILES))
        self.assertEqual(settings, set(_command.SETTINGS))

    def test_files_of_pictures_travel(self):
        cluster = self.cluster(1)
        (self.out / "red.hdr").write_bytes(HDR)
        lit = {"size": (96, 64), "integrator": "path", "spp": 2}
        red = self.woods.render(**lit, environment=HDR)
        self.assertFalse((red["rgba"] == self.woods.render(**lit, environment="sky")["rgba"]).all())
        for environment in ("red.hdr", self.out / "red.hdr", HDR):
            self.same(many.render(cluster.client, SCENE, **lit, environment=environment, item_samples=4096, setup=self.setup),
                      red)
        for environment in ("sky", None):
            self.same(many.render(cluster.client, SCENE, **lit, environment=environment, setup=self.setup),
                      self.woods.render(**lit, environment=environment))
        with self.assertRaisesRegex(raynest.InvalidError, "^nowhere.hdr: No such file"):
            many.render(cluster.client, SCENE, **lit, environment="nowhere.hdr", setup=self.setup)
        words = ("render", SCENE, "--size", "96x64", "--integrator", "path", "--spp", "2", "--env=red.hdr", "-o")
        self.carried(cluster, *words, "many.exr")
        self.same(raynest.read_layers((self.out / "many.exr").read_bytes()), red)

    def test_what_is_compared_with_travels(self):
        cluster = self.cluster(1)
        size = {"size": (96, 64)}
        triangles = np.array([[-40, 0, -40], [40, 0, -40], [0, 0, 60]]), np.array([[0, 1, 2]])
        np.savez(self.out / "flat.npz", vertices=triangles[0], faces=triangles[1])
        flat = self.client.mesh(*triangles)
        whole = self.woods.heatmap(**size, diff=flat)
        self.assertTrue((whole != 0).any())
        for diff in (triangles, "flat.npz", flat, many.prepare(*triangles)):
            np.testing.assert_array_equal(many.heatmap(cluster.client, SCENE, **size, diff=diff, item_samples=2048,
                                                       setup=self.setup), whole)
        opaque = {"intersector": "opaque"}
        np.testing.assert_array_equal(many.heatmap(cluster.client, SCENE, **size, diff=opaque, setup=self.setup),
                                      self.woods.heatmap(**size, diff=opaque))
        edited = many.prepare(*triangles)
        with edited.edit() as edit:
            edit.hide("*")
        with edited.edit() as edit:
            edit.show("*")
        np.testing.assert_array_equal(many.heatmap(cluster.client, SCENE, **size, diff=edited, setup=self.setup), whole)
        with self.assertRaisesRegex(raynest.UsageError, "two scenes that were edited"):
            many.heatmap(cluster.client, edited, **size, diff=edited, setup=self.setup)
        for other in ("flat.npz", OTHER):
            words = ("heatmap", SCENE, "--size", "96x64", "--diff", other, "--metric", "boxes", "-o")
            self.carried(cluster, *words, "many.exr")
            self.one(*words, "one.exr")
            (seen, _), (wanted, _) = (exr.read_exr((self.out / name).read_bytes(), 1 << 20) for name in ("many.exr", "one.exr"))
            self.same(seen, wanted)

    # ---- rays that one daemon takes -------------------------------------------------------------

    def test_rays_of_every_form(self):
        cluster = self.cluster(1)
        rays = rain(5000)
        origins, ways = rays[:, :3].astype(np.float64), rays[:, 4:7]
        masked = np.ma.MaskedArray(np.hstack([origins, ways]), np.repeat(np.arange(5000)[:, None] % 3 == 0, 6, 1))
        nothing = generators.hemisphere(np.empty((0, 3)), np.empty((0, 3)))
        for form in ((origins, ways), ((0, 30, 0), ways), (origins, (0, -1, 0)), ((0, 60, 0), (0, -1, 0)), (rays,), (rays[0],),
                     (masked,), ([],), ([], []), (rays[:0],), (nothing,)):
            for options in ({"fields": ("t", "prim")}, {"kind": "all", "fields": ("t", "path")}):
                with self.subTest(form=form, **options):
                    seen = many.trace(cluster.client, SCENE, *form, **options, item_rays=2000, setup=self.setup)
                    self.same(seen, self.woods.trace(*form, **options))
        for form in ([], (origins, ways)):
            found = many.arrays(cluster.client, SCENE, form, item_rays=2000, setup=self.setup)
            whole = self.woods.trace(form) if form == [] else self.woods.trace(*form)
            for name in ("t", "prim"):
                np.testing.assert_array_equal(cluster.client.compute(found[name], sync=True), whole[name])
        self.same(many.reduce(cluster.client, SCENE, [], "visible_pixels", setup=self.setup),
                  self.woods.trace([], reduce="visible_pixels"))
        for said, form in (("do not fit together", (origins, ways[1:])), ("origins and directions, or a generator", (origins,)),
                           ("pass no others", (SWEEP, ways))):
            with self.assertRaisesRegex(raynest.UsageError, said):
                many.trace(cluster.client, SCENE, *form, setup=self.setup)

    def test_a_camera_in_motion(self):
        cluster = self.cluster(1)
        poses = np.tile(np.eye(4)[:3], (2, 1, 1))
        poses[:, 1, 3], poses[:, 2, 3] = 6, (20, 15)
        options = {"trajectory": ([0, 1], poses), "readout": .5, "size": (64, 48), "fov": 60, "mask": 1}
        whole, made = self.woods.render(**options), []
        np.testing.assert_array_equal(many.render(cluster.client, SCENE, **options, setup=self.setup,
                                                  progress=lambda done, _total, stage: stage == "tracing" and made.append(done)), whole)
        self.assertEqual(made, [6 * 64 * part for part in range(1, 9)])     # four for each thread
        file, moved = travelling().write(self.out / "travels.glb"), {**options, "readout": 1, "step_error": .02}
        np.testing.assert_array_equal(many.render(cluster.client, file, **moved, setup=self.setup),
                                      self.client.load(file, "travels").render(**moved))
        for wrong in ({"integrator": "path"}, {"spp": 4}, {"sun": (1, 2)}, {"encode": "exr"}):
            with self.assertRaises(raynest.UsageError) as one:
                self.woods.render(**options, **wrong)
            with self.assertRaises(raynest.UsageError) as seen:
                many.render(cluster.client, SCENE, **options, **wrong, setup=self.setup)
            self.assertEqual(str(seen.exception), str(one.exception))

    def test_times_of_rays(self):
        cluster = self.cluster(1)
        file = travelling().write(self.out / "moving.glb")
        rng = np.random.default_rng(4)
        rays = np.zeros((600, 6), np.float32)
        rays[:, :3], rays[:, 4] = rng.uniform((-5, 9, -5), (5, 9, 5), (600, 3)), -1
        times = np.round(rng.uniform(0, 2, 600), 1)
        scene = self.client.load(file, "moving")
        self.assertLess(np.isfinite(scene.trace(rays, time=times)["t"]).sum(), 600)
        for options in ({}, {"time_step": .37}, {"kind": "all", "fields": ("t", "prim")}, {"mask": np.arange(600) % 2},
                        {"animation": "Rest", "time": times / 4}):
            options = {"time": times, **options}
            self.same(many.trace(cluster.client, file, rays, **options, item_rays=170, setup=self.setup),
                      scene.trace(rays, **options))
        for wrong in ({"time": times[1:]}, {"time": [*times[1:], np.nan]}, {"time": times, "time_step": 0}, {"time": 1.0, "time_step": 1},
                      {"time": times, "reduce": "visible_pixels"}):
            with self.assertRaises(raynest.UsageError) as one:
                scene.trace(rays, **wrong)
            with self.assertRaises(raynest.UsageError) as seen:
                many.trace(cluster.client, file, rays, **wrong, setup=self.setup)
            self.assertEqual(str(seen.exception), str(one.exception))

    def test_what_a_lidar_measures(self):
        cluster = self.cluster(1)
        poses = np.tile(np.eye(4)[:3], (2, 1, 1))
        poses[:, :, :3], poses[:, :, 3] = ((1, 0, 0), (0, 0, 1), (0, -1, 0)), ((0, 3, 0), (2, 3, 1))
        moving = generators.sweep(np.linspace(-20, 10, 4), (0, 360, 90), trajectory=([0, .2], poses), scans=2)
        beams, stands = moving.beams(), generators.lidar([-10, 0, 5], (0, 360, 90), look_at=((0, 3, 0), (0, 3, -1)))
        wide = {"returns": 3, "divergence": 0.02, "footprint": 7, "noise": 0.05, "seed": 4}
        wind = "builtin:forest?trees=20&wind=1"
        one = {SCENE: self.woods, wind: self.client.load(wind, "wind")}
        times = 0.5 + moving.time
        for scene, sweep, options in (
                (SCENE, moving, wide), (SCENE, beams, {**wide, "mask": np.arange(720) % 2}), (SCENE, stands, wide),
                (SCENE, moving, {**wide, "velocities": {"oak-*": [(1, 2, 0), (0, 0, 1), (0, 1, 0)]}, "epoch": 1}),
                (wind, moving, {**wide, "time": times, "time_step": .03}), (wind, beams, {"time": times[0]}),
                (wind, beams, {"time": times, "fields": ("t", "normal", "velocity"), "hide": "birch-*", "prefer": "strongest"})):
            with self.subTest(scene=scene, sweep=type(sweep), **options):
                whole = returns.measure(one[scene], sweep, **options)
                self.assertGreater(len(whole["t"]), 100)
                self.same(many.measure(cluster.client, scene, sweep, **options, item_rays=700, setup=self.setup), whole)
                traced = returns._TRACED_MAX
                try:        # in pieces of one daemon, too
                    returns._TRACED_MAX = 500
                    self.same(returns.measure(one[scene], sweep, **options), whole)
                finally:
                    returns._TRACED_MAX = traced
        for wrong in ({"velocities": {"nothing": (1, 0, 0)}}, {"mask": [1, 2]}, {"time": times[1:]}, {"kind": "all"}, {"epochs": 1}):
            with self.subTest(**wrong), self.assertRaises((raynest.Error, TypeError)) as told:
                returns.measure(self.woods, moving, **wrong)
            with self.assertRaises(type(told.exception)) as seen:
                many.measure(cluster.client, SCENE, moving, **wrong, setup=self.setup)
            self.assertEqual(str(seen.exception).replace("dask-", "")[:40], str(told.exception)[:40])

    # ---- answers that stay ----------------------------------------------------------------------

    def test_columns_stay_and_are_stored_from_there(self):
        cluster = self.cluster(2)
        whole = self.woods.trace(SWEEP, fields=("t", "direction"))
        with distributed.Client(cluster.client.scheduler.address) as client:    # which all of Dask then takes
            found = many.arrays(client, SCENE, SWEEP, fields=("t", "direction"), item_rays=400, setup=self.setup)
            with self.subTest("persist"):
                doubled = (found["t"] * 2).persist()
                distributed.wait(doubled)
                self.assertEqual(len(client.who_has(doubled)), 4)
                np.testing.assert_array_equal(doubled.compute(), whole["t"] * 2)
            with self.subTest("store"):
                for name, column in found.items():
                    file = np.lib.format.open_memmap(self.out / f"{name}.npy", "w+", column.dtype, column.shape)
                    array.store(column, Rows(self.out / f"{name}.npy"), lock=False)
                    np.testing.assert_array_equal(file, whole[name])
            with self.subTest("zarr"):
                try:
                    import zarr
                except ImportError:
                    self.skipTest("no python3-zarr")
                found["direction"].to_zarr(str(self.out / "d.zarr"))
                np.testing.assert_array_equal(zarr.open(str(self.out / "d.zarr"))[:], whole["direction"])

    def test_a_block_of_rays_that_were_sent_is_made_again(self):
        cluster = self.cluster(2)
        rays = rain(4000)
        whole = self.woods.trace(rays, fields=("t",))
        with distributed.Client(cluster.client.scheduler.address) as client:
            found = many.arrays(client, SCENE, rays, fields=("t",), item_rays=500, setup=self.setup)["t"].persist()
            distributed.wait(found)
            cluster.workers[0].kill()
            cluster.workers[0].wait()
            np.testing.assert_array_equal(found.compute(), whole["t"])

    def test_blocks_are_made_where_a_host_is_good_for_them(self):
        whole = self.woods.trace(SWEEP, fields=("t",))["t"]
        setup = many.Setup("", "worker", ("--threads", "1"))
        bad = {"no daemon": ("", {"RAYNESTD": "/nowhere"}), "another version": ("import raynest._version as v; v.VERSION='0.0.1'", {})}
        rounds = rounding_of(self.client.outcome)
        if rounds == "once":
            bad["rounds otherwise"] = "", {"RAYNEST_TARGET": "v2"}
        for what, (patch, environment) in bad.items():
            cluster = self.cluster(1)
            first, = cluster.client.scheduler_info()["workers"]
            self.same(many.trace(cluster.client, SCENE, SWEEP, fields=("t",), setup=setup), {"t": whole})
            cluster.environment.update(environment)
            cluster.workers.append(cluster.add(patch))
            cluster.wait(2)
            for joins in ("early", "late"):
                with self.subTest(what, joins=joins), warnings.catch_warnings():
                    warnings.simplefilter("ignore", raynest.RayWarning)
                    roster = _roster.roster_of(cluster.client)
                    until(lambda: len(roster.living()) == 2)
                    # A late one could not be asked.
                    living = {first: roster.living()[first]} if joins == "late" else roster.living()
                    def known(*given):
                        scene = known_to(*given)
                        scene.rounding["how"] = rounds
                        return scene
                    good = many.Deal.good
                    with unittest.mock.patch.object(many, "known_to", known), unittest.mock.patch.object(
                            many, "roster_of", return_value=types.SimpleNamespace(living=lambda _: living)), \
                            unittest.mock.patch.object(many.Deal, "good", lambda deal: good(deal) if joins == "early" else []):
                        found = many.arrays(cluster.client, SCENE, SWEEP, fields=("t",), item_rays=100, setup=setup)["t"]
                    np.testing.assert_array_equal(cluster.client.compute(found).result(), whole)

    def test_mistakes_are_refused_before_anything_is_dealt_out(self):
        cluster = self.cluster(1)
        dealt = self.enterContext(unittest.mock.patch.object(many.Deal, "_deal"))
        to = cluster.client, SCENE
        for error, said, request in (
                (TypeError, r"trace\(\) has no argument mask_: did you mean mask=", lambda: many.trace(*to, SWEEP, mask_=1)),
                (TypeError, r"arrays\(\) has no argument progress", lambda: many.arrays(*to, SWEEP, progress=print)),
                (TypeError, r"render\(\) has no argument metric", lambda: many.render(*to, metric="total")),
                (TypeError, r"measure\(\) has no argument misspelt", lambda: many.measure(*to, SWEEP, misspelt=1)),
                (TypeError, r"sweep\(\) has no argument misspelt", lambda: many.sweep(*to, [(0, SWEEP)], misspelt=1)),
                (TypeError, r"reduce\(\) has no argument misspelt", lambda: many.reduce(*to, SWEEP, "visible_pixels", misspelt=1)),
                (raynest.UsageError, "encode= is for one daemon", lambda: many.heatmap(*to, encode="exr"))):
            with self.subTest(said), self.assertRaisesRegex(error, said):
                request()
        dealt.assert_not_called()

    def test_numbers_of_other_types(self):
        cluster = self.cluster(1)
        self.same(many.trace(cluster.client, SCENE, SWEEP, item_rays=1e3, kind=None, setup=self.setup), self.woods.trace(SWEEP))
        self.assertTrue((many.render(cluster.client, SCENE, size=(64, 40), integrator=None, setup=self.setup) ==
                         self.woods.render(size=(64, 40))).all())
        with self.assertRaisesRegex(raynest.UsageError, "a side of size of 40.5"):
            many.render(cluster.client, SCENE, size=(40.5, 30), setup=self.setup)
        with self.assertRaisesRegex(raynest.UsageError, "items of 0.5: each needs one"):
            many.trace(cluster.client, SCENE, SWEEP, item_rays=0.5, setup=self.setup)

    def test_newer_releases_of_dask(self):
        """A client's copy of the workers' list is empty, and a Future by its key does not ask for the value."""
        cluster = self.cluster(0)
        cluster.workers.append(cluster.add("import distributed; made = distributed.Future.__init__; distributed.Future.__init__ = "
                                           "lambda self, key, client=None, inform=False, state=None: made(self, key, client, False, "
                                           "state)"))
        cluster.wait(1)
        cluster.client._periodic_callbacks["scheduler-info"].stop()
        cluster.client._scheduler_identity = {}
        triangles = np.array([[-40, 0, -40], [40, 0, -40], [0, 0, 60]]), np.array([[0, 1, 2]])
        rays = rain(1000)
        told = []
        seen = many.trace(cluster.client, triangles, rays, setup=self.setup, progress=lambda *news: told.append(news))
        self.same(seen, self.client.mesh(*triangles).trace(rays))
        self.assertEqual(told[0][2], "sending")

    # ---- commands that one daemon takes ---------------------------------------------------------

    def test_all_cameras(self):
        cluster = self.cluster(1)
        words = ("render", SCENE, "--size", "96x64", "--cameras")
        done = self.carried(cluster, *words, "all", "-o", "many.png")
        self.assertRegex(done.stdout, r"^many\.0\.png: 64 rows of pixels of \d+ parts\nmany\.1\.png: 64 rows[^\n]*\n$")
        done = self.carried(cluster, "--json", "render", SCENE, "--size", "96x64", "--cameras=all", "-o", "many.exr")
        documents = [json.loads(line) for line in done.stdout.splitlines()]
        self.assertEqual([(each["file"], each["camera"], each["height"]) for each in documents],
                         [("many.0.exr", "clearing", 64), ("many.1.exr", "canopy", 64)])
        self.one(*words, "all", "-o", "one.exr")
        for i in range(2):
            (seen, _), (wanted, _) = (exr.read_exr((self.out / f"{name}.{i}.exr").read_bytes(), 1 << 20)
                                      for name in ("many", "one"))
            self.same(seen, wanted)
        np.savez(self.out / "flat.npz", vertices=np.eye(3), faces=np.array([[0, 1, 2]]))
        done = self.command(cluster, "render", "flat.npz", "--cameras", "all", "-o", "x.png")
        self.assertEqual((done.returncode, done.stderr), (5, "raynest: the scene has no cameras: leave --cameras out\n"))

    def test_what_all_parts_say_together(self):
        cluster = self.cluster(1)
        heat = ("heatmap", SCENE, "--size", "96x64")
        self.carried(cluster, *heat, "-o", "many.npy")
        np.testing.assert_array_equal(np.load(self.out / "many.npy"), self.woods.heatmap(size=(96, 64)))
        drawn = (*heat, "--palette", "viridis", "-o")
        self.carried(cluster, *drawn, "many.png")
        self.one(*drawn, "one.png")
        many, one = (drawn_of((self.out / name).read_bytes()) for name in ("many.png", "one.png"))
        np.testing.assert_array_equal(many[:64], one[:64])      # below it stands the scene's name, which workers choose
        self.assertEqual(many.shape, one.shape)
        done = self.carried(cluster, *heat, "--fail-if", "total.max>1e9", "--fail-if=total.min<0", "-o", "many.exr")
        self.assertRegex(done.stdout, r"\ntotal.max is \d+, not above 1000000000: ok\ntotal.min is \d+, not below 0: ok\n$")
        done = self.command(cluster, *heat, "--fail-if", "total.max>1", "-o", "many.exr")
        self.assertEqual(done.returncode, 9)
        self.assertRegex(done.stderr, "^raynest: 1 of 1 limit exceeded: total.max is .*\n$")
        limits = ("--fail-if", "total.max>1", "--fail-if", "boxes.1.mean>1e9")
        done = self.command(cluster, "--json", *heat, *limits, "-o", "many.exr")
        self.assertEqual((done.returncode, json.loads(done.stderr)["error"]["name"]), (9, "THRESHOLD"))
        one = subprocess.run([self.raynest, "--server", self.daemon.uri, "--json", *heat, *limits], capture_output=True, text=True)
        self.assertEqual(json.loads(done.stdout)["checks"], json.loads(one.stdout)["checks"])
        self.carried(cluster, "render", SCENE, "--size", "96x64", "-o", "many.npy")
        np.testing.assert_array_equal(np.load(self.out / "many.npy"), self.woods.render(size=(96, 64)))
        words = ("query", SCENE, "--generate", "camera", "size=96x64", "--fields", "position,t", "-o")
        self.carried(cluster, *words, "many.ply")
        self.one(*words, "one.ply")
        self.assertEqual((self.out / "many.ply").read_bytes(), (self.out / "one.ply").read_bytes())
        for words, said in (((*heat, "--top", "3", "-o", "x.exr"), "leave it out, or --dask"),
                            ((*heat, "-o", "x.html"), "a heat map is written as .png, .exr or .npy")):
            done = self.command(cluster, *words)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (2, 1), done.stderr)
            self.assertIn(said, done.stderr)

    def test_a_part_is_no_smaller_than_pays(self):
        cluster = self.cluster(1)
        for parts, words in ((1, ("render", SCENE, "--size", "96x64")), (4, ("heatmap", SCENE, "--size", "1024x256")),
                             (2, ("render", SCENE, "--size", "96x64", "--integrator", "ao", "--spp", "22"))):
            document = json.loads(self.carried(cluster, "--json", *words, "-o", "many.exr").stdout)
            self.assertEqual(document["parts"], parts)

    def test_rays_of_all_kinds_are_dealt_out(self):
        cluster = self.cluster(1)       # of two threads, with four parts for each
        np.save(self.out / "rays.npy", rain(140000))
        points = np.random.default_rng(3).uniform(-20, 20, (900, 3))
        np.save(self.out / "points.npy", np.hstack([points, np.broadcast_to([0, 1, 0], points.shape)]))
        np.save(self.out / "few.npy", np.load(self.out / "points.npy")[:3])
        np.save(self.out / "up.npy", np.linspace(-40, 5, 32))
        np.save(self.out / "round.npy", np.linspace(0, 350, 4096))
        np.save(self.out / "way.npy", np.array([[0, 1, 0, 0, 0, 0, 1, 0, 9, 0, 0, 1, 0], [1, 1, 0, 0, 5, 0, 1, 0, 9, 0, 0, 1, 0]]))
        sky, sweep = ("--generate", "hemisphere", "seed=1"), ("--generate", "sweep", "trajectory=way.npy", "end=0.05")
        for parts, given, words in (
                (2, "", ("--rays", "rays.npy")), (2, "rays.npy", ("--rays", "-")), (1, "", ("--ray", "0,9,0,0,-1,0")),
                (8, "", (*sky, "points=points.npy", "samples=800")), (3, "", (*sky, "points=few.npy", "samples=65536")),
                (1, "", (*sky, "points=points.npy")), (2, "", (*sweep, "elevations=up.npy", "azimuths=round.npy")),
                (4, "", (*sweep, "elevations=up.npy", "azimuths=0:360:4096", "scans=2")),
                (3, "", (*sweep, "elevations=-5,0,5", "azimuths=round.npy", "scans=16"))):
            with self.subTest(words=words):
                words = ("query", SCENE, *words, "--fields", "t,prim", "-o")
                with open(self.out / given if given else os.devnull, "rb") as file:
                    done = self.carried(cluster, "--json", *words, "many.npz", stdin=file)
                self.assertEqual(json.loads(done.stdout)["parts"], parts)
                with open(self.out / given if given else os.devnull, "rb") as file:
                    self.one(*words, "one.npz", stdin=file)
                with np.load(self.out / "many.npz") as seen, np.load(self.out / "one.npz") as wanted:
                    self.same(dict(seen), dict(wanted))


if __name__ == "__main__":
    main()
