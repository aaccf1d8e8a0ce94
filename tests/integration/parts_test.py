#!/usr/bin/env python3
"""--part of query, render and heatmap, and `raynest merge`: the files of the whole, and what is wrong with parts.

  parts_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import re
import struct
import subprocess
import sys
import unittest
import zlib

import numpy

from daemon import Client, Daemon, DaemonTest, main

PACKAGE = pathlib.Path(__file__).resolve().parents[2] / "client/python"
LOOK = "lookat=0,6,20,0,2,0"
SWEEP = ("--generate", "lidar", "elevations=-30:10:24", "azimuths=0:360:500", LOOK)


def pixels(data):
    """The pixels of a PNG of RGBA, (height, width, 4), by its definition."""
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        at += 12 + size
        if kind == b"IHDR":
            width, height = struct.unpack_from(">II", body)
        if kind == b"IDAT":
            packed += body
    rows, above, out = zlib.decompress(packed), [0] * (4 * width), []
    for y in range(height):
        kind, *line = rows[y * (1 + 4 * width):(y + 1) * (1 + 4 * width)]
        row = []
        for i, value in enumerate(line):
            left, corner = (row[i - 4], above[i - 4]) if i >= 4 else (0, 0)
            up = above[i]
            paeth = min((abs(up - corner), 0, left), (abs(left - corner), 1, up),
                        (abs(left + up - 2 * corner), 2, corner))[2]
            row.append((value + (0, left, up, (left + up) // 2, paeth)[kind]) & 255)
        out.append(row)
        above = row
    return numpy.array(out, numpy.uint8).reshape(height, width, 4)


class Parts(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.environment.update(PYTHONPATH=str(PACKAGE), RAYNEST_PYTHON=sys.executable)
        cls.client.json("load", "builtin:forest?trees=20", "--name", "woods")

    def done(self, *words):
        done = self.client.run(*words)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def parts(self, name, count, *words):
        """Makes the whole and its parts; returns their paths."""
        whole = self.out / f"whole-{name}"
        self.done(*words, "-o", whole)
        made = [self.out / f"{i}-{name}" for i in range(1, count + 1)]
        for i, path in enumerate(made, 1):
            self.done(*words, "-o", path, "--part", f"{i}/{count}")
        return whole, made

    def merged(self, name, made):
        out = self.out / f"merged-{name}"
        said = self.done("merge", out, *made)
        self.assertIn(f"of {len(made)} parts", said)
        if name.endswith(".npz"):
            with numpy.load(out) as file:
                rows = len(file["ray_splits"]) - 1 if "ray_splits" in file else len(file[file.files[0]])
            self.assertIn(f": {rows:,} rows of", said)
        return out

    def refused(self, code, said, *words):
        done = self.client.run(*words)
        self.assertEqual((done.returncode, done.stdout), (code, ""), done.stderr)
        self.assertRegex(done.stderr, said)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)

    def same_columns(self, name, count, *words):
        whole, made = self.parts(name, count, "query", "woods", *words)
        with numpy.load(whole) as one, numpy.load(self.merged(name, made[::-1])) as other:
            self.assertEqual(set(one.files), set(other.files))
            for column in one.files:
                self.assertEqual(one[column].dtype, other[column].dtype)
                self.assertEqual(one[column].tobytes(), other[column].tobytes(), column)
        return made

    def test_columns_of_parts_are_those_of_the_whole(self):
        numpy.save(self.out / "rays.npy", numpy.random.default_rng(1).normal(0, 1, (1000, 6)) * [9, 1, 9, 1, 1, 1])
        points = numpy.random.default_rng(2).normal(0, 1, (100, 6)) * [9, 1, 9, 1, 1, 1]
        numpy.save(self.out / "points.npy", points.astype(numpy.float32))
        sky = ("--generate", "hemisphere", f"points={self.out}/points.npy", "samples=20", "seed=7")
        for name, count, words in (
                ("sweep.npz", 7, (*SWEEP, "--fields", "t,prim,path,direction")),
                ("camera.npz", 3, ("--generate", "camera", "size=97x61", LOOK, "--fields", "t,position")),
                ("all.npz", 4, (*SWEEP, "--kind", "all", "--fields", "t,prim")),
                ("rays.npz", 7, ("--rays", self.out / "rays.npy", "--fields", "t,origin")),
                ("sky.npz", 7, (*sky, "--fields", "t,direction")),
                ("open.npz", 7, (*sky, "--reduce", "hit_fraction")),
                ("seen.npz", 7, (*SWEEP, "--reduce", "visible_pixels"))):
            with self.subTest(name):
                self.same_columns(name, count, *words)

    def test_a_part_of_the_sky_has_seen_nothing(self):
        around = ("query", "woods", "--generate", "equirectangular", "size=64x32", "pose=1,0,0,0,0,1,0,900,0,0,1,0",
                  "--reduce", "visible_pixels")
        whole, made = self.parts("sky.npz", 4, *around)
        with numpy.load(made[0]) as file:
            self.assertEqual([(name, file[name].dtype, file[name].size) for name in file.files[1:]],
                             [("path", numpy.uint64, 0), ("pixels", numpy.uint32, 0)])
        self.done(*around[:6], "range=0:1", *around[6:], "-o", self.out / "nothing.npz")
        with numpy.load(self.out / "nothing.npz") as file:
            self.assertEqual([(name, file[name].dtype, file[name].size) for name in file.files],
                             [("path", numpy.uint64, 0), ("pixels", numpy.uint32, 0)])
        with numpy.load(self.merged("sky.npz", made)) as file, numpy.load(whole) as wanted:
            self.assertGreater(wanted["path"].size, 0)
            for name in wanted.files:
                numpy.testing.assert_array_equal(file[name], wanted[name])

    def test_point_clouds_of_parts_are_the_whole(self):
        """In every byte, and of scenes of many sizes, whose .las have other scales."""
        numpy.save(self.out / "rays.npy", numpy.random.default_rng(1).normal(0, 1, (500, 6)) * [9, 1, 9, 1, 1, 1])
        many = (*SWEEP, "range=0:10", "--kind", "all", "--max-hits", "5", "--fields")
        for number, (ending, *words) in enumerate((
                ("las", *SWEEP, "--fields", "position,reflectance,ring"), ("las", *many, "position"),
                ("las", *SWEEP, "range=0:0.01", "--fields", "position"), ("ply", *many, "position,t,path"),
                ("ply", "--rays", self.out / "rays.npy", "--fields", "position,normal,base_colour"),
                ("pcd", *SWEEP, "--fields", "position,t,ring"),
                *(("las", "--generate", "orthographic", "size=9x9", LOOK, f"window={size}x{size}", "--fields", "position")
                  for size in (1e-3, 30)))):
            with self.subTest(ending, words=words):
                whole, made = self.parts(f"{number}.npz", 3, "query", "woods", *words)
                whole, out = self.out / f"whole{number}.{ending}", self.out / f"merged{number}.{ending}"
                self.done("query", "woods", *words, "-o", whole)
                self.done("merge", out, *made)
                self.assertEqual(whole.read_bytes(), out.read_bytes())

    def test_pictures_of_parts_are_the_whole(self):
        size = ("--size", "200x150")
        for name, words in (("primary.exr", ("render", "woods", *size)),
                            ("path.exr", ("render", "woods", *size, "--integrator", "path", "--spp", "3"))):
            with self.subTest(name):
                whole, made = self.parts(name, 7, *words)
                self.assertEqual(whole.read_bytes(), self.merged(name, made).read_bytes())
        for name, words in (("primary.png", ("render", "woods", *size)),
                            ("ao.png", ("render", "woods", *size, "--integrator", "ao", "--spp", "3"))):
            with self.subTest(name):
                whole, made = self.parts(name, 7, *words)
                whole, merged = whole.read_bytes(), self.merged(name, made).read_bytes()
                self.assertNotIn(b"raynest:tile", merged)
                self.assertTrue((pixels(whole) == pixels(merged)).all())
        for number, words in enumerate(((), ("--range", "auto"), ("--range", "12.5:100000"), ("--metric", "boxes.1"),
                                        ("--diff", "intersector=opaque"), ("--diff", "mask=1"), ("--metric", "rejects"))):
            with self.subTest("heat map", words=words):
                whole, made = self.parts(f"heat{number}.exr", 7, "heatmap", "woods", *size, *words)
                self.assertIn(b"raynest:range\0", whole.read_bytes())
                self.assertEqual(whole.read_bytes(), self.merged(f"heat{number}.exr", made).read_bytes())

    def test_parts_of_heat_maps_are_drawn(self):
        for number, words in enumerate(((), ("--palette", "viridis", "--scale", "log", "--range", "auto"), ("--range", "12.5:100"),
                                        ("--metric", "boxes.1", "--count", "necessary"), ("--diff", "mask=1"), ("--hide", "oak-*"),
                                        ("--camera", "0", "--metric", "rejects"))):
            with self.subTest(words=words):
                whole, out = self.out / f"whole{number}.png", self.out / f"drawn{number}.png"
                self.done("heatmap", "woods", "--size", "200x150", *words, "-o", whole)
                _, made = self.parts(f"drawn{number}.exr", 3, "heatmap", "woods", "--size", "200x150", *words)
                self.done("merge", out, *made)
                self.assertEqual(out.read_bytes(), whole.read_bytes())
        for path in made:
            path.write_bytes(path.read_bytes().replace(b"raynest:palette", b"raynest:pallete"))
        self.refused(5, "does not say how it is drawn", "merge", out, *made)
        with self.subTest("no daemon"):
            self.client.environment["RAYNESTD"] = "/nowhere/raynestd"
            self.addCleanup(self.client.environment.pop, "RAYNESTD")
            for path in made:
                path.write_bytes(path.read_bytes().replace(b"raynest:pallete", b"raynest:palette"))
            self.refused(1, "cannot start /nowhere/raynestd, which draws heat maps: .*; install raynest here, or write an .exr",
                         "merge", out, *made)

    def test_what_raynestd_cannot_draw(self):
        asked = {"width": 2, "height": 1, "differs": False, "metric": "total", "palette": "turbo", "scale": "linear", "range": "auto",
                 "count": "traversed", "view": ["woods"], "attributes": {}}
        for said, words, counts in (("fewer counts than pixels", asked, 1), ("for raynest merge", {**asked, "metric": 3}, 2),
                                    ("has 1 to", {**asked, "width": 0}, 2), ("has 1 to", {**asked, "height": 1 << 31}, 2),
                                    ("palette", {**asked, "palette": "none"}, 2), ("for raynest merge", {}, 2), ("", asked, 2)):
            with self.subTest(said, words=words):
                done = subprocess.run([self.raynestd, "draw"], capture_output=True,
                                      input=json.dumps(words).encode() + b"\n" + bytes(4 * counts))
                self.assertEqual((done.returncode, done.stderr.count(b"\n")), (int(bool(said)), int(bool(said))))
                self.assertIn(said, done.stderr.decode())
                self.assertEqual(done.stdout[:4], b"" if said else b"\x89PNG")

    def test_parts_become_arrays(self):
        size = ("--size", "200x150")
        for number, (ending, words) in enumerate((("png", ("render", "woods", *size)),
                                                  ("png", ("render", "woods", "--size", "9x40", "--integrator", "ao", "--spp",
                                                           "2", "--exposure", "0")),
                                                  ("exr", ("heatmap", "woods", *size)),
                                                  ("exr", ("heatmap", "woods", *size, "--metric", "boxes.1")),
                                                  ("exr", ("heatmap", "woods", *size, "--diff", "mask=2")))):
            with self.subTest(words=words):
                _, made = self.parts(f"{number}.{ending}", 3, *words)
                whole, out = self.out / f"whole{number}.npy", self.out / f"merged{number}.npy"
                self.done(*words, "-o", whole)
                self.done("merge", out, *made)
                wanted, seen = numpy.load(whole), numpy.load(out)
                self.assertEqual(wanted.dtype, seen.dtype)
                numpy.testing.assert_array_equal(wanted, seen)
        lit = self.out / "lit.exr"
        self.done("render", "woods", *size, "-o", lit, "--part", "1/1")
        self.refused(5, "is of a picture, and no heat map", "merge", self.out / "no.npy", lit)
        self.refused(5, "does not end in .png, as the parts of a .npy do", "merge", self.out / "no.npy", "x.npz")

    def test_limits_are_checked_of_all_parts(self):
        """By the package, of which `raynest merge` is the command."""
        heat = ("heatmap", "woods", "--size", "200x150")
        _, made = self.parts("heat.exr", 5, *heat, "--metric", "boxes")
        asked = [f"{metric}.{statistic}>-1" for metric in ("total", "boxes", "boxes.1", "rejects")
                 for statistic in ("min", "mean", "p50", "p90", "p99", "max")]
        words = [word for limit in asked for word in ("--fail-if", limit)]
        done = self.client.run(*heat, *words)
        self.assertEqual(done.returncode, 9)
        wanted = done.stderr.splitlines()[-1]

        def merged(*words):
            return subprocess.run([sys.executable, "-m", "raynest.merge", *map(str, words)], capture_output=True, text=True,
                                  env=dict(self.client.environment))
        done = merged(*words, self.out / "all.exr", *made)
        self.assertEqual((done.returncode, done.stderr), (9, wanted + "\n"))
        self.assertTrue((self.out / "all.exr").exists())
        with self.subTest("as the command says it of the whole"):
            one, all = (self.client.run(*command, "--fail-if", "total.p99>1e9", "--fail-if", "boxes.1.max >= 0") for command in (
                heat, ("merge", self.out / "all.exr", *made)))
            self.assertEqual((all.returncode, all.stderr), (9, one.stderr))
            self.assertRegex(all.stderr, r"^raynest: 1 of 2 limits exceeded: boxes.1.max is \d+, at or above 0: exceeded\n$")
            self.assertEqual(all.stdout.splitlines()[1:], one.stdout.splitlines()[-2:])
            one, all = (self.client.run("--json", *command, *words) for command in (heat, ("merge", self.out / "all.exr", *made)))
            self.assertEqual((all.returncode, all.stderr), (9, one.stderr))
            self.assertEqual(json.loads(all.stdout)["checks"], json.loads(one.stdout)["checks"])
        for limit, code, said in (("total.p99<1", 0, "total.p99 is \\d+, not below 1: ok"), ("boxes.99.max>1", 2, "has no boxes.99"),
                                  ("total.p98>1", 2, "'total.p98>1' is not METRIC"), ("total.p99>x", 2, "is not METRIC"),
                                  ("levels > 3", 2, "which raynest info tells")):
            done = merged("--fail-if", limit, self.out / "one.exr", *made)
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertRegex(done.stderr if code else done.stdout.splitlines()[1], said)
        picture = self.out / "1.png"
        self.done("render", "woods", "--size", "64x48", "-o", picture, "--part", "1/1")
        done = merged("--fail-if", "total.p99>1", self.out / "one.png", picture)
        self.assertEqual((done.returncode, done.stderr), (2, "raynest: --fail-if is for the parts of a heat map, which are .exr\n"))

    def test_parts_of_other_pictures_are_told_apart(self):
        size = ("--size", "64x48")
        for kind, command, others in (("png", "render", (("--fov", "30"), ("--hide", "inst=3"), ("--only", "inst=3"))),
                                      ("exr", "render", (("--hide", "inst=3"), ("--integrator", "ao", "--spp", "2"))),
                                      ("exr", "heatmap", (("--fov", "30"), ("--hide", "inst=3"), ("--skip-hidden-boxes",))),
                                      ("exr", "heatmap --diff mask=1", (("--diff", "mask=2"),))):
            first, second, given = self.out / f"first.{kind}", self.out / f"second.{kind}", ("woods", *size)
            command, *more = command.split()
            self.done(command, *given, *more, "-o", first, "--part", "1/2")
            for words in others:
                with self.subTest(command, kind=kind, words=words):
                    self.done(command, *given, *(() if "--diff" in words else more), *words, "-o", second, "--part", "2/2")
                    self.refused(5, "is of another request", "merge", self.out / f"both.{kind}", first, second)
            # Options of where, when and by which kernel it runs make no other picture.
            for words in (("--priority", "low"), ("--worker", "cpu"), ("--deadline", "99"), ("--traversal", "single"), ("--epoch", "1")):
                with self.subTest(command, kind=kind, more=more, words=words):
                    self.done(command, *given, *more, *words, "-o", second, "--part", "2/2")
                    self.done("merge", self.out / f"both.{kind}", first, second)
            self.assertNotIn(b"raynest:request", (self.out / f"both.{kind}").read_bytes())
        for part in (1, 2):
            self.done("render", "woods", *size, "--integrator", "ao", "--spp", "2", "--deadline", 900 + part,
                      "-o", self.out / f"late{part}.exr", "--part", f"{part}/2")
        self.done("merge", self.out / "late.exr", self.out / "late1.exr", self.out / "late2.exr")

    @unittest.skipUnless("fma" in pathlib.Path("/proc/cpuinfo").read_text(), "this CPU has no FMA")
    def test_parts_of_hosts_that_round_otherwise_are_told_apart(self):
        daemon = Daemon(self.raynestd, "--target", "v2")
        self.addCleanup(daemon.stop)
        old = Client(self.raynest, daemon.uri)
        old.json("load", "builtin:forest?trees=20", "--name", "woods")
        for name, *words in (("rays.npz", "query", *SWEEP), ("look.png", "render", "--size", "32x24"),
                             ("heat.exr", "heatmap", "--size", "32x24")):
            with self.subTest(name):
                first, second = (self.out / f"{half}-{name}" for half in ("new", "old"))
                command, *options = words
                self.done(command, "woods", *options, "-o", first, "--part", "1/2")
                done = old.run(command, "woods", *options, "-o", second, "--part", "2/2")
                self.assertEqual(done.returncode, 0, done.stderr)
                self.refused(5, "old-.* is of another CPU, which rounds otherwise, than .*new-.*: its arithmetic is v2, "
                             "not v3", "merge", self.out / f"both-{name}", first, second)

    def test_parts_of_other_rays_are_told_apart(self):
        rays = self.out / "rays.npy"
        fields = ("--fields", "t")
        first, second = (self.out / f"{number}-rays.npz" for number in (1, 2))

        def made(*words, number):
            self.done("query", "woods", *words, *fields, "-o", (first, second)[number - 1], "--part", f"{number}/2")
        made("--ray", "0,9,0,0,-1,0", "--ray", "1,9,0,0,-1,0", number=1)
        made("--ray", "2,9,0,0,-1,0", "--ray", "3,9,0,0,-1,0", number=2)
        self.refused(5, "is of another request .*: rays is", "merge", self.out / "rays.npz", first, second)
        cast = numpy.zeros((100, 6), numpy.float32)
        cast[:, 1], cast[:, 4] = 9, -1
        numpy.save(rays, cast)
        made("--rays", rays, number=1)
        numpy.save(rays, cast + numpy.float32(.5))
        made("--rays", rays, number=2)
        self.refused(5, "is of another request .*: rays is", "merge", self.out / "rays.npz", first, second)
        # The same rays, or points, under another name are the same.
        numpy.save(self.out / "copy.npy", cast)
        for words in (("--rays", "{}"), ("--generate", "hemisphere", "points={}")):
            for number, path in ((1, rays), (2, self.out / "copy.npy")):
                numpy.save(path, cast)
                made(*(word.format(path) for word in words), number=number)
            self.done("merge", self.out / "rays.npz", first, second)
        numpy.save(rays, cast + numpy.float32(.5))
        made(*(word.format(rays) for word in words), number=2)
        self.refused(5, "is of another request .*: rays is", "merge", self.out / "rays.npz", first, second)

    def test_every_option_of_a_query_is_part_of_its_request_or_changes_no_byte(self):
        """Merge joins parts that say the same: it must know all options that change a byte."""
        (self.out / "leaf.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        turns = [{"name": name, "channels": [{"instance": "leaf", "path": "translation", "times": [0, 1],
                                              "values": [[0, 0, 0], [far, 0, 0]]}]} for name, far in (("near", 1), ("far", 2))]
        town = {"rnscene": 1, "objects": {"leaf": {"file": "leaf.obj"}}, "instances": [{"object": "leaf"}], "animations": turns}
        (self.out / "town.rnscene.json").write_text(json.dumps(town))
        self.client.json("load", self.out / "town.rnscene.json", "--name", "town")
        way = numpy.zeros((2, 13))
        way[:, 0], way[:, [1, 6, 11]] = (0, 1), 1
        for name, array in (("masks", numpy.ones(2, numpy.uint32)), ("rays", numpy.eye(2, 6, dtype=numpy.float32) + .5),
                            ("directions", numpy.eye(2, 3, dtype=numpy.float32)), ("way", way)):
            numpy.save(self.out / f"{name}.npy", array)

        def of(*words):
            path = self.out / "of.npz"
            self.done("query", "town", *words, "-o", path, "--part", "1/2")
            with numpy.load(path) as file:
                said = json.loads(file["part"].tobytes())
            return {key: value for key, value in said.items() if key not in ("first", "count")}
        cast = ("--rays", self.out / "rays.npy")
        lidar = ("--generate", "lidar", "elevations=-9:9:2", "azimuths=0:360:8")
        sweep = ("--generate", "sweep", "elevations=-9,9", "azimuths=0:360:8", f"trajectory={self.out}/way.npy")
        moment = (*cast, "--time", "0.5")
        changes = {
            "intersector": [(cast, (*cast, "--intersector", "opaque"))], "mask": [(cast, (*cast, "--mask", "1"))],
            "set": [(cast, (*cast, "--set", "cull=back"))],
            "hide": [(cast, (*cast, "--hide", "leaf"))], "only": [(cast, (*cast, "--only", "leaf"))],
            "skip-hidden-boxes": [((*cast, "--hide", "leaf"), (*cast, "--hide", "leaf", "--skip-hidden-boxes"))],
            "time": [(cast, moment), (moment, (*cast, "--time", "0.6"))],
            "animation": [(moment, (*moment, "--animation", "far"))],
            "step-error": [(sweep, (*sweep, "--step-error", "1"))],
            "from": [(("--rays", self.out / "directions.npy", "--from", start) for start in ("0,0,9", "0,0,8"))],
            "masks": [(cast, (*cast, "--masks", self.out / "masks.npy"))],
            "kind": [(cast, (*cast, "--kind", "all"))],
            "max-hits": [((*cast, "--kind", "multi"), (*cast, "--kind", "multi", "--max-hits", "3"))],
            "fields": [(cast, (*cast, "--fields", "t"))],
            "reduce": [(lidar, (*lidar, "--reduce", "visible_pixels"))],
            "ray": [(("--ray", "0,0,9,0,0,1", "--ray", f"0,0,9,0,{y},1") for y in (0, 1))],
            "rays": [(("--rays", self.out / name, *more) for name, more in (
                ("rays.npy", ()), ("directions.npy", ("--from", "0,0,9"))))],
            "generate": [(lidar, (*lidar[:-1], "azimuths=0:180:8"))]}
        changes_none = {"traversal": "single", "epoch": "1", "worker": "cpu", "deadline": "99", "priority": "low"}
        by_python = {"returns", "divergence", "footprint", "resolution", "threshold", "noise", "seed", "prefer", "times", "time-step"}
        with self.subTest("all options are named here"):
            told = set(re.findall(r"^ +(?:-\w,)?--([a-z-]+)", self.done("query", "--help"), re.MULTILINE))
            self.assertEqual(told, {"help", "output", "part", "detach", *by_python, *changes, *changes_none})
        for option, pairs in changes.items():
            for one, other in pairs:
                with self.subTest(option):
                    self.assertNotEqual(of(*one), of(*other))
        for option, value in changes_none.items():
            with self.subTest(option):
                self.assertEqual(of(*cast), of(*cast, f"--{option}", value))
        for words in ((*sweep, "--returns", "1"), (*cast, "--times", self.out / "rays.npy")):
            self.refused(2, "--part", "query", "town", *words, "-o", self.out / "no.npz", "--part", "1/2")

    def test_parts_of_other_sweeps_are_told_apart(self):
        poses = numpy.zeros((2, 13))
        poses[:, 0] = 0, 1
        poses[:, [1, 6, 11]] = 1
        poses[:, 8] = 2, 3
        way = self.out / "way.npy"
        numpy.save(way, poses)
        first, second = (self.out / f"{number}-sweep.npz" for number in (1, 2))

        def made(number, *words):
            self.done("query", "woods", "--generate", "sweep", "elevations=-20,0", "azimuths=0:360:64", f"trajectory={way}", *words,
                      "--fields", "t", "-o", (first, second)[number - 1], "--part", f"{number}/2")
        made(1, "--step-error", "0.1")
        made(2, "--step-error", "0.2")
        self.refused(5, "is of another request .*: step_error is", "merge", self.out / "sweep.npz", first, second)
        made(1)
        numpy.save(way, poses + numpy.eye(13)[8])
        made(2)
        self.refused(5, "is of another request .*: rays is", "merge", self.out / "sweep.npz", first, second)
        way = self.out / "copy.npy"
        numpy.save(way, poses + numpy.eye(13)[8])
        made(1)
        self.done("merge", self.out / "sweep.npz", first, second)

    def test_a_damaged_block_is_found_out(self):
        whole, made = self.parts("lit.exr", 2, "render", "woods", "--size", "64x48", "--integrator", "ao", "--spp", "2")
        data = bytearray(made[1].read_bytes())
        data[-40] ^= 0x55
        made[1].write_bytes(data)
        self.refused(5, "lit.exr: is no part", "merge", self.out / "broken.exr", *made)
        self.assertFalse((self.out / "broken.exr").exists())

    def test_a_wrong_part_is_named(self):
        made = self.same_columns("again.npz", 3, *SWEEP, "--fields", "t")
        out = self.out / "wrong.npz"
        self.refused(5, "a part is missing: rows 4000 to 7999 of 12000", "merge", out, made[0], made[2])
        self.refused(5, "a part is missing: rows 8000 to 11999", "merge", out, *made[:2])
        self.refused(5, "1-again.npz has rows that .*/1-again.npz has too: 0 to 3999$", "merge", out, *made, made[0])
        other = self.out / "foreign.npz"
        self.done("query", "woods", *SWEEP, "--fields", "t", "--mask", "1", "-o", other, "--part", "2/3")
        self.refused(5, "foreign.npz is of another request .*: mask is 1, not 4294967295", "merge", out, made[0], other,
                     made[2])
        self.client.json("load", "builtin:forest?trees=21", "--name", "others")
        self.done("query", "others", *SWEEP, "--fields", "t", "-o", other, "--part", "2/3")
        self.refused(5, "foreign.npz is of another scene than .*/1-again.npz: its digest is [0-9a-f]{12}, not [0-9a-f]{12}$", "merge", out,
                     made[0], other, made[2])
        with numpy.load(made[1]) as part:
            columns = dict(part)
        said = columns["part"].tobytes().replace(b'"epoch":1', b'"epoch":2')
        numpy.savez(other, **{**columns, "part": numpy.frombuffer(said, numpy.uint8)})
        self.refused(5, "foreign.npz is of another epoch of the scene than .*/1-again.npz: it is 2, not 1$", "merge", out,
                     made[0], other, made[2])
        for size, fov, said in (("64x96", "40", "another range than .*/size.png: of 96 rows of pixels, not 64$"),
                                ("64x64", "50", "another request than .*/size.png: the options' digest is [0-9a-f]{12}, not")):
            self.done("render", "woods", "--size", "64x64", "--fov", "40", "-o", self.out / "size.png", "--part", "1/2")
            self.done("render", "woods", "--size", size, "--fov", fov, "-o", self.out / "other.png", "--part", "2/2")
            self.refused(5, f"other.png is of {said}", "merge", self.out / "wrong.png", self.out / "size.png",
                         self.out / "other.png")
        self.refused(5, "whole-again.npz: is no part", "merge", out, self.out / "whole-again.npz")
        self.refused(5, "nowhere.npz: No such file", "merge", out, "nowhere.npz")
        self.refused(2, "parts become a .npz, a .png, an .exr, a .npy", "merge", "out.txt", made[0])
        (self.out / "cut.npz").write_bytes(made[0].read_bytes()[:300])
        self.refused(5, "cut.npz: is no part", "merge", out, self.out / "cut.npz")
        self.assertFalse(out.exists())
        for name in ("cut.png", "cut.exr"):
            whole = self.out / ("1-" + name)
            self.done("render", "woods", "--size", "64x64", "-o", whole, "--part", "1/2")
            for length in (0, 9, 100, whole.stat().st_size - 30):
                (self.out / name).write_bytes(whole.read_bytes()[:length])
                self.refused(5, f"{name}: is no part", "merge", self.out / ("wrong" + name[3:]), self.out / name)

    def test_json(self):
        made = self.same_columns("told.npz", 2, *SWEEP, "--fields", "t")
        out = self.out / "told.npz"
        for parts, code in ((made, 0), (made[:1], 5)):
            done = subprocess.run([sys.executable, "-m", "raynest.merge", "--json", out, *parts], capture_output=True,
                                  text=True, env={**os.environ, "PYTHONPATH": str(PACKAGE)})
            self.assertEqual(done.returncode, code, done.stderr)
            if code == 0:
                self.assertEqual(json.loads(done.stdout), {"file": str(out), "parts": 2, "notes": []})
            else:
                self.assertEqual(done.stdout, "")
                error = json.loads(done.stderr)["error"]
                self.assertEqual((error["name"], error["message"]),
                                 ("FILE_INVALID", "a part is missing: rows 6000 to 11999 of 12000"))

    def test_a_part_that_cannot_be_made_says_why(self):
        picture = ("render", "woods", "--size", "64x64", "-o", self.out / "no.png")
        for text in ("0/3", "4/3", "1/0", "1", "a/b", "1/3x"):
            self.refused(2, "is not I/N", *picture, "--part", text)
        self.refused(2, "64 rows of pixels have at most 4 parts", *picture, "--part", "1/5")
        self.refused(2, "give `exposure` in stops|--exposure", *picture, "--integrator", "path", "--part", "1/2")
        self.refused(2, "a .npy does not say", *picture[:-1], self.out / "no.npy", "--part", "1/2")
        heat = ("heatmap", "woods", "--part", "1/2", "-o")
        for name in ("no.png", "no.npy", "no.html"):
            self.refused(2, "--part: makes a .exr alone: .*raynest merge", *heat, self.out / name)
        self.refused(2, "--part: give --fail-if to raynest merge", *heat, self.out / "no.exr", "--fail-if", "total.p99>1")
        self.refused(2, "--part: leave it out with --top", *heat, self.out / "no.exr", "--top", "3")
        self.refused(2, "--part needs -o", "query", "woods", *SWEEP, "--part", "1/2")


if __name__ == "__main__":
    main()
