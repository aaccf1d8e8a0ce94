#!/usr/bin/env python3
"""Point clouds of sweeps read back from files, written by Python and by the command line.

  point_clouds_test.py RAYNESTD RAYNEST FLATC
"""
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import raynest
from raynest import points
from with_daemon import WithDaemon, main, rain


def parse_ply(data):
    header, body = data.split(b"end_header\n", 1)
    sizes = {"double": "<f8", "float": "<f4", "ushort": "<u2", "uint": "<u4", "uchar": "u1"}
    lines = [line.split() for line in header.decode().splitlines()]
    return np.frombuffer(body, [(name, sizes[kind]) for word, kind, name in (line for line in lines if line[0] == "property")])


def parse_pcd(data):
    header, body = data.split(b"DATA binary\n", 1)
    said = dict(line.split(" ", 1) for line in header.decode().splitlines() if line[0] != "#")
    kinds = ["<" + kind.lower() + size for kind, size in zip(said["TYPE"].split(), said["SIZE"].split())]
    return np.frombuffer(body, list(zip(said["FIELDS"].split(), kinds)))


def srgb(linear):
    share = np.clip(linear.astype(float), 0, 1)
    return np.where(share <= 0.0031308, share * 12.92, 1.055 * share ** (1 / 2.4) - 0.055)


class PointClouds(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.cli.environment.update(PYTHONPATH=str(Path(raynest.__file__).parents[1]), RAYNEST_PYTHON=sys.executable)

    def setUp(self):
        self.folder = Path(self.enterContext(tempfile.TemporaryDirectory()))
        random = np.random.default_rng(8)
        self.points = random.uniform(-300, 500, (1000, 3))
        self.points[7] = self.points[8, 1] = np.nan
        self.hit = np.arange(1000) % 5 != 0
        self.kept = self.hit & ~np.isin(np.arange(1000), (7, 8))
        self.columns = {"ring": (np.arange(1000) % 64).astype(np.uint16), "time": random.uniform(0, 0.1, 1000),
                        "intensity": random.uniform(0, 1, 1000).astype(np.float32)}

    def save(self, name, **more):
        path = self.folder / name
        self.assertEqual(points.save(path, self.points, where=self.hit, **{**self.columns, **more}), self.kept.sum())
        return path.read_bytes()

    def same_points(self, table, places):
        np.testing.assert_allclose(np.stack([table[axis] for axis in "xyz"], -1), self.points[self.kept], rtol=0, atol=places)
        for name, column in self.columns.items():
            np.testing.assert_array_equal(table[name], column[self.kept])

    def test_ply_comes_back(self):
        data = self.save("a.ply", path=np.arange(1000, dtype=np.uint64), ng=self.points)
        table = parse_ply(data)
        self.assertIn(b"\nelement vertex %d\n" % self.kept.sum(), data)
        self.same_points(table, 0)
        np.testing.assert_array_equal(table["path"], np.arange(1000)[self.kept])
        np.testing.assert_array_equal(table["ng_2"], self.points[self.kept][:, 2])

    def test_normals_and_colours_have_the_names_that_other_programs_read(self):
        normals = np.random.default_rng(3).normal(size=(1000, 3)).astype(np.float32)
        linear = np.random.default_rng(4).uniform(-0.1, 1.1, (1000, 3)).astype(np.float32)
        linear[0] = 0.5, 0, 1   # as sRGB 188, 0, 255
        self.hit[0] = self.kept[0] = True
        of_hits = normals[self.kept]
        ply = parse_ply(self.save("a.ply", normal=normals, base_colour=linear))
        self.assertEqual(ply.dtype.names[-6:], ("nx", "ny", "nz", "red", "green", "blue"))
        np.testing.assert_array_equal(np.stack([ply["nx"], ply["ny"], ply["nz"]], -1), of_hits)
        colours = np.stack([ply["red"], ply["green"], ply["blue"]], -1)
        self.assertEqual((colours.dtype, colours[0].tolist()), (np.uint8, [188, 0, 255]))
        np.testing.assert_array_equal(colours, np.rint(srgb(linear[self.kept]) * 255))
        pcd = parse_pcd(self.save("a.pcd", normal=normals, base_colour=linear, intensity=self.columns["intensity"].astype(float)))
        self.assertEqual(pcd.dtype.names[-4:], ("normal_x", "normal_y", "normal_z", "rgb"))
        self.assertEqual([pcd.dtype[name].str for name in ("intensity", "normal_x", "rgb")], ["<f4"] * 3)  # as PCL's points
        np.testing.assert_array_equal(np.stack([pcd[f"normal_{axis}"] for axis in "xyz"], -1), of_hits)
        packed = pcd["rgb"].copy().view("<u4")
        np.testing.assert_array_equal(np.stack([packed >> 16, packed >> 8 & 255, packed & 255], -1), colours)
        las = self.save("a.las", base_colour=linear)
        start, kind, size = *struct.unpack_from("<I", las, 96), *struct.unpack_from("<BH", las, 104)
        self.assertEqual((kind, size, len(las)), (3, 34, start + 34 * self.kept.sum()))
        rows = np.frombuffer(las[start:], np.uint8).reshape(-1, size)
        np.testing.assert_array_equal(np.ascontiguousarray(rows[:, 28:]).view("<u2"), np.rint(srgb(linear[self.kept]) * 65535))
        # The daemon reads the colours that it had given.
        for name in ("a.ply", "a.las"):
            with self.client.load(str(self.folder / name), "painted", radius=0.001, replace=True) as cloud:
                at = self.points[self.kept][0]
                seen = cloud.trace([[*at[:2], at[2] + 1, 0, 0, -1]], fields=("base_colour",))["base_colour"]
                np.testing.assert_allclose(seen[0], linear[0], atol=0.005)

    def test_pcd_comes_back(self):
        for far in (0, 4e4, 4e6):
            self.points = self.points + far
            data = self.save("a.PCD")
            table = parse_pcd(data)
            self.assertIn(b"\nHEIGHT 1\n", data)
            self.assertIn(b"\nPOINTS %d\n" % self.kept.sum(), data)
            self.same_points(table, 1e-9 if far else 4e-5)

    def test_las_comes_back(self):
        kinds = np.arange(1000) % 32
        data = self.save("a.las", **{"return": np.arange(1000) % 3, "returns": 3 + np.arange(1000) % 2, "classification": kinds})
        version, start, kind, size, count = (*struct.unpack_from("<BB", data, 24)[1:],
                                             *struct.unpack_from("<I", data, 96),
                                             *struct.unpack_from("<BHI", data, 104))
        self.assertEqual((data[:4], version, kind, size, count), (b"LASF", 2, 1, 28, self.kept.sum()))
        scale, offset = np.frombuffer(data, "<f8", 6, 131).reshape(2, 3)
        self.assertEqual(len(data), start + size * count)
        raw = np.frombuffer(data[start:], np.uint8).reshape(count, size)
        place = np.ascontiguousarray(raw[:, :12]).view("<i4") * scale + offset
        np.testing.assert_allclose(place, self.points[self.kept], rtol=0, atol=1e-6)
        np.testing.assert_array_equal(raw[:, 17], self.columns["ring"][self.kept])
        np.testing.assert_array_equal(raw[:, 15], kinds[self.kept])
        np.testing.assert_array_equal(np.ascontiguousarray(raw[:, 20:28]).view("<f8")[:, 0],
                                      self.columns["time"][self.kept])
        np.testing.assert_array_equal((raw[:, 14] & 7) - 1, (np.arange(1000) % 3)[self.kept])
        np.testing.assert_array_equal(raw[:, 14] >> 3, (3 + np.arange(1000) % 2)[self.kept])
        returns = struct.unpack_from("<5I", data, 111)
        self.assertEqual(returns, (*np.bincount((np.arange(1000) % 3)[self.kept]), 0, 0))
        bounds = np.frombuffer(data, "<f8", 6, 179).reshape(3, 2)
        np.testing.assert_array_equal(bounds, np.stack([self.points[self.kept].max(axis=0), self.points[self.kept].min(axis=0)], -1))
        # Without `returns` each pulse is said to have as many as any has.
        alone = np.frombuffer(self.save("b.las", **{"return": np.arange(1000) % 3})[start:], np.uint8).reshape(count, size)
        np.testing.assert_array_equal(alone[:, 14], (np.arange(1000) % 3 + 1 | 3 << 3)[self.kept])
        # The daemon reads them as points.
        cloud = self.client.load(str(self.folder / "a.las"), "cloud", radius=0.5)
        self.assertEqual(cloud.info["records"]["sphere"] if "records" in cloud.info else self.kept.sum(), self.kept.sum())

    def query(self, name, *words, code=0):
        """Writes a file by the command line; returns what it said."""
        done = subprocess.run([self.raynest, "--server", self.daemon.uri, "query", "woods", *words, "-o",
                               str(self.folder / name)], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, code, done.stderr)
        return done.stdout + done.stderr

    def test_the_command_line_writes_the_same_bytes(self):
        np.save(self.folder / "rain.npy", rain(5000))
        rays = ("--rays", str(self.folder / "rain.npy"))
        hits = self.woods.trace(rain(5000), fields=("position", "t", "inst", "ng", "hit", "normal", "base_colour"))
        self.assertTrue(0 < hits["hit"].sum() < 5000)
        beside = {"t": hits["t"], "inst": hits["inst"]}
        for ending, fields, columns in ((".ply", "", beside), (".pcd", "", beside), (".las", "", {}),
                                        (".ply", "ng,position", {"ng": hits["ng"]}),
                                        *((ending, "position,normal,base_colour",
                                           {"normal": hits["normal"], "base_colour": hits["base_colour"]}) for ending in (".ply", ".pcd")),
                                        (".las", "position,base_colour", {"base_colour": hits["base_colour"]})):
            self.query("theirs" + ending, *rays, *(("--fields", fields) if fields else ()))
            points.save(self.folder / ("ours" + ending), hits["position"], where=hits["hit"], **columns)
            with self.subTest(ending=ending, fields=fields):
                self.assertEqual((self.folder / ("theirs" + ending)).read_bytes(),
                                 (self.folder / ("ours" + ending)).read_bytes())
        shade = self.woods.trace(rain(5000), fields=("reflectance",))["reflectance"]
        self.query("theirs.las", *rays, "--fields", "position,reflectance")
        points.save(self.folder / "ours.las", hits["position"], where=hits["hit"], reflectance=shade)
        self.assertEqual((self.folder / "theirs.las").read_bytes(), (self.folder / "ours.las").read_bytes())
        # Several hits of a ray, and a column that rays have once.
        many = self.woods.trace(rain(5000), kind="multi", max_hits=3, fields=("position", "direction"))
        splits = many["ray_splits"]
        counts = np.diff(splits)
        number = (np.arange(splits[-1]) - np.repeat(splits[:-1], counts)).astype(np.uint16)
        of_ray = np.repeat(counts, counts).astype(np.uint16)
        for ending in (".ply", ".las"):
            more = {} if ending == ".las" else {"direction": np.repeat(many["direction"], counts, axis=0)}
            self.query("theirs" + ending, *rays, "--kind", "multi", "--max-hits", "3", "--fields",
                       "position" if ending == ".las" else "position,direction")
            points.save(self.folder / ("ours" + ending), many["position"], **more, **{"return": number, "returns": of_ray})
            with self.subTest(ending=ending):
                self.assertEqual((self.folder / ("theirs" + ending)).read_bytes(),
                                 (self.folder / ("ours" + ending)).read_bytes())

    def test_points_in_the_frame_of_the_sensor(self):
        # The columns that --generate lidar makes, of a sensor that stands turned and away from zero.
        sensor = ("--generate", "lidar", "elevations=-30,-20,-10", "azimuths=0:360:200", "pose=0,0,1,5,1,0,0,6,0,1,0,-3")
        pose = np.array([[0, 0, 1, 5], [1, 0, 0, 6], [0, 1, 0, -3]], float)
        fields = ("sensor_position", "position", "hit", "ring")
        hits = self.woods.trace(raynest.generators.lidar((-30, -20, -10), (0, 360, 200), pose=pose), fields=fields)
        self.assertTrue(0 < hits["hit"].sum())
        for ending, beside in ((".ply", {"ring": hits["ring"]}), (".pcd", {"ring": hits["ring"]}), (".las", {})):
            words = ("--fields", ",".join(("sensor_position", *beside)))
            self.query("theirs" + ending, *sensor, *words)
            points.save(self.folder / ("ours" + ending), hits["sensor_position"], where=hits["hit"], **beside)
            with self.subTest(ending):
                self.assertEqual((self.folder / ("theirs" + ending)).read_bytes(),
                                 (self.folder / ("ours" + ending)).read_bytes())
        # Beside `position` it is a column like others.
        self.query("both.ply", *sensor, "--fields", "position,sensor_position")
        self.assertIn(b"sensor_position_2", (self.folder / "both.ply").read_bytes()[:600])

    def test_the_command_line_refuses_what_makes_no_points(self):
        through = np.zeros((400, 6), np.float32)  # along the ground, through many leaves
        through[:, 0], through[:, 1], through[:, 2], through[:, 3] = -60, 4, np.linspace(-40, 40, 400), 1
        np.save(self.folder / "rain.npy", through)
        rays = ("--rays", str(self.folder / "rain.npy"))
        for name, words, said in (("a.ply", ("--kind", "any"), "needs hits"), ("a.ply", ("--fields", "t"), "column position"),
                                  ("a.las", ("--fields", "position,t"), "no room for the column 't'"),
                                  ("a.las", ("--fields", "position,hit"), "no room for the column 'hit'"),
                                  ("a.las", ("--kind", "multi"), "--max-hits 5"), ("a.ply", ("--part", "1/2"), "FILE.npz"), 
                                  ("a.xyz", (), ".npz or .ply or .pcd or .las")):
            with self.subTest(name=name, words=words):
                self.assertIn(said, self.query(name, *rays, *words, code=2))
                self.assertFalse((self.folder / name).exists())

    def test_what_no_file_can_hold_is_refused(self):
        for name, more, words in (("a.xyz", {}, "must end with .ply, .pcd or .las"), ("a.las", {"prim": self.hit}, "'prim'"),
                                  ("a.las", {"normal": np.zeros((1000, 3))}, "'normal'"), ("a.las", {"base_colour": self.hit}, "'base_colour'"),
                                  ("a.ply", {"path": np.full(1000, 2**40)}, "beyond 32 bits"),
                                  ("a.ply", {"ring": np.zeros(3)}, "ring has shape"),
                                  ("a.ply", {"x": self.hit}, "cannot be called 'x'"),
                                  ("a.ply", {"a b": self.hit}, "cannot be called 'a b'"),
                                  ("a.pcd", {"n_0": self.hit, "n": np.zeros((1000, 2))}, "cannot be called 'n_0'"),
                                  ("a.las", {"ring": np.full(1000, 256)}, "'ring' from 0 to 255"),
                                  ("a.las", {"classification": np.full(1000, 32)}, "'classification' from 0 to 31"),
                                  ("a.las", {"intensity": np.zeros(1000), "reflectance": np.zeros(1000)}, "one of the columns"),
                                  ("a.las", {"return": np.full(1000, 5)}, "'return' from 0 to 4"),
                                  ("a.las", {"return": np.full(1000, 2), "returns": np.full(1000, 2)}, "beyond the number"),
                                  ("a.las", {"returns": np.full(1000, 6)}, "'returns' from 0 to 5"),
                                  ("a.las", {"intensity": np.full(1000, np.nan)}, "'intensity' from 0 to 1"),
                                  ("a.ply", {"names": np.full(1000, "x")}, "must be numbers")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                self.save(name, **more)
            self.assertFalse((self.folder / name).exists())

    def sensor(self):
        """A sweep of two poses: the words of --generate, and the same in Python."""
        times, poses = np.array([0, 1.0]), np.zeros((2, 3, 4))
        poses[:, 0, 0] = poses[:, 1, 2] = 1
        poses[:, 2, 1] = -1
        poses[:, :, 3] = (0, 4, 0), (3, 4, 0)
        np.save(self.folder / "way.npy", np.column_stack([times, poses.reshape(2, 12)]))
        words = ("--generate", "sweep", f"trajectory={self.folder / 'way.npy'}", "end=1", "elevations=-40:20:6", "azimuths=0:360:90")
        return words, raynest.generators.sweep(np.linspace(-40, 20, 6), (0, 360, 90), trajectory=(times, poses), end=1.0)

    def test_a_sensor_has_its_columns_by_default(self):
        words, sweep = self.sensor()
        hits = self.woods.trace(sweep, fields=("position", "t", "inst", "hit", "ring", "time"))
        self.assertTrue(0 < hits["hit"].sum() < len(hits["hit"]))
        self.query("a.ply", *words)
        whole = parse_ply((self.folder / "a.ply").read_bytes())
        self.assertEqual(whole.dtype.names, ("x", "y", "z", "t", "inst", "ring", "time"))
        self.query("a.las", *words)
        las = (self.folder / "a.las").read_bytes()
        rows = np.frombuffer(las[227:], np.uint8).reshape(-1, 28)
        for name, found in (("ring", rows[:, 17]), ("time", np.ascontiguousarray(rows[:, 20:28]).view("<f8")[:, 0])):
            np.testing.assert_array_equal(whole[name], hits[name][hits["hit"]], name)
            np.testing.assert_array_equal(found, hits[name][hits["hit"]], name)
        self.query("b.ply", "--generate", "lidar", "elevations=-40:20:6", "azimuths=0:360:90", "pose=1,0,0,0,0,0,1,4,0,-1,0,0")
        self.assertEqual(parse_ply((self.folder / "b.ply").read_bytes()).dtype.names, ("x", "y", "z", "t", "inst", "ring"))

    def test_a_detached_sweep_becomes_the_same_points(self):
        words, sweep = self.sensor()
        for ending, more in ((".ply", ()), (".pcd", ("--fields", "position,normal")), (".las", ()), (".ply", ("--kind", "multi"))):
            with self.subTest(ending=ending, more=more):
                asked = more if more[:1] != ("--fields",) else ("--fields", more[1] + ",ring,time")
                self.query("attached" + ending, *words, *asked)
                job = self.cli.json("query", "woods", *words, *more, "--detach", "-o", "x" + ending)["job"]
                self.cli.json("wait", str(job))
                self.cli.json("fetch", str(job), *words, "-o", self.folder / ("fetched" + ending))
                self.assertEqual((self.folder / ("fetched" + ending)).read_bytes(), (self.folder / ("attached" + ending)).read_bytes())
        for more, said in ((("--generate", "lidar", "elevations=1,2"), "this --generate"), (("--generate", "camera"), "no ring and no time"),
                           (words[:4], "this --generate")):
            refused = self.cli.run("fetch", str(job), *more, "-o", self.folder / "no.ply")
            self.assertEqual((refused.returncode, (self.folder / "no.ply").exists()), (2, False), refused.stderr)
            self.assertIn(said, refused.stderr)
        self.assertIn("give raynest fetch this --generate", self.query("a.ply", *words, "--detach", "--fields", "position,ring", code=2))
        no_points = str(self.cli.json("query", "woods", *words, "--fields", "t", "--detach")["job"])
        self.cli.json("wait", no_points)
        refused = self.cli.run("fetch", no_points, "-o", self.folder / "no.ply")
        self.assertEqual(refused.returncode, 2)
        self.assertIn("is no point cloud: the query needs the columns position", refused.stderr)
        # In Python a job knows its rays.
        fields = ("position", "hit", "ring", "time")
        made, there = self.woods.trace(sweep, fields=fields, detach=True).wait().fetch(), self.woods.trace(sweep, fields=fields)
        self.same(made, there)

    def test_parts_of_a_sweep_become_the_same_points(self):
        words, _ = self.sensor()
        for fields, more in (("position,t,ring,time", ()), ("position,base_colour,hit", ()), ("sensor_position,ring,t", ()), ("position,prim,ring", ("--kind", "multi"))):
            with self.subTest(fields=fields, more=more):
                parts = []
                for part in (3, 1, 2):
                    parts.append(self.folder / f"{part}.npz")
                    self.query(parts[-1].name, *words, "--fields", fields, *more, "--part", f"{part}/3")
                for ending in (".ply", ".pcd", ".npz"):
                    self.query("whole" + ending, *words, "--fields", fields, *more)
                    done = self.cli.run("merge", self.folder / ("merged" + ending), *parts)
                    self.assertEqual(done.returncode, 0, done.stderr)
                    if ending != ".npz":
                        self.assertEqual((self.folder / ("merged" + ending)).read_bytes(), (self.folder / ("whole" + ending)).read_bytes())
                    with self.subTest(ending=ending):
                        count = parse_ply((self.folder / "merged.ply").read_bytes()).size
                        self.assertIn(": 540 rows of 3 parts" if ending == ".npz" else f": {count:,} points of 3 parts", done.stdout)
                with np.load(self.folder / "merged.npz") as merged, np.load(self.folder / "whole.npz") as whole:
                    self.same(dict(merged), dict(whole))
        refused = self.cli.run("merge", self.folder / "no.las", *parts)
        self.assertEqual(refused.returncode, 2)
        self.assertIn("no room for the column 'prim'", refused.stderr)
        self.assertIn("raynest merge makes point clouds", self.query("a.ply", *words, "--part", "1/2", code=2))
        self.query("1.npz", *words, "--fields", "t", "--part", "1/1")
        refused = self.cli.run("merge", self.folder / "no.ply", self.folder / "1.npz")
        self.assertEqual((refused.returncode, (self.folder / "no.ply").exists()), (2, False))
        self.assertIn("position, or sensor_position, among its --fields", refused.stderr)
        self.query("1.npz", *words, "--fields", "sensor_position,t", "--part", "1/1")
        with np.load(self.folder / "1.npz") as part:
            np.savez(self.folder / "1.npz", **{name: part[name] for name in part.files if name != "hit"})
        refused = self.cli.run("merge", self.folder / "no.ply", self.folder / "1.npz")
        self.assertEqual((refused.returncode, (self.folder / "no.ply").exists()), (2, False))
        self.assertIn("do not say which rays have hit", refused.stderr)


if __name__ == "__main__":
    main()
