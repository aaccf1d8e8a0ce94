#!/usr/bin/env python3
"""Sweeps of a moving lidar against float64 formulas, and point clouds read back from files.

  sweeps_test.py RAYNESTD RAYNEST FLATC
"""
import struct
import tempfile
from pathlib import Path

import numpy as np

import raynest
from raynest import points, sweeps
from with_daemon import WithDaemon, main


def turn(axis, angle):
    """Rodrigues' formula, by the exponential of the matrix: another way than the library's."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    made, term = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ across * angle / k
        made = made + term
    return made


class Trajectories(WithDaemon):
    def test_poses_lie_on_lines_and_shortest_arcs(self):
        random = np.random.default_rng(4)
        for angle in (0, 1e-12, 1e-5, 0.3, 1.5, 3.0, np.pi - 1e-9, np.pi):
            axis = random.normal(size=3)
            first = turn(random.normal(size=3), 2)
            ends = np.zeros((2, 3, 4))
            ends[0, :, :3], ends[1, :, :3] = first, first @ turn(axis, angle)
            ends[:, :, 3] = random.normal(size=(2, 3)) * 100
            at = np.array([2, 2.25, 3.5, 4])
            poses = sweeps.poses_at(([2, 4], ends), at)
            for pose, share in zip(poses, (at - 2) / 2):
                with self.subTest(angle=angle, share=share):
                    np.testing.assert_allclose(pose[:, 3], ends[0, :, 3] + share * (ends[1, :, 3] - ends[0, :, 3]),
                                               atol=1e-12)
                    wanted = first @ turn(axis, angle * share)
                    if angle == np.pi and 0 < share < 1:  # both ways round are as short
                        other = first @ turn(axis, -angle * share)
                        wanted = min(wanted, other, key=lambda one: np.abs(one - pose[:, :3]).max())
                    np.testing.assert_allclose(pose[:, :3], wanted, atol=1e-7)

    def test_a_moving_lidar_measures_a_wall_from_where_it_is(self):
        wall = self.client.mesh([[50, -900, -900], [50, 900, -900], [50, 900, 900], [50, -900, 900]],
                                [[0, 1, 2], [0, 2, 3]], name="wall")
        speed, period = 20.0, 0.1
        poses = np.tile(np.eye(4)[:3], (2, 1, 1))
        poses[1, 0, 3] = speed * period
        sweep = sweeps.lidar([-10, 0, 12], (-60, 60, 500), end=period, trajectory=([0, period], poses))
        hits = wall.trace(sweep.rays, fields=("t", "position"))
        ahead = sweep.rays[:, 3]
        exact = (50 - speed * sweep.time) / ahead
        np.testing.assert_allclose(hits["t"], exact, rtol=4 * 2**-24)
        self.assertEqual(sweep.ring.tolist(), [0] * 500 + [1] * 500 + [2] * 500)
        np.testing.assert_allclose(sweep.time[:500], period * np.arange(500) / 500)
        # One that stands still measures what the daemon's own lidar does.
        still = sweeps.lidar([-10, 0, 12], (-60, 60, 500), trajectory=([0, 1], np.tile(np.eye(4), (2, 1, 1))))
        pose = np.eye(4)
        theirs = wall.trace(raynest.generators.lidar([-10, 0, 12], (-60, 60, 500), pose=pose), fields=("t",))
        np.testing.assert_allclose(wall.trace(still.rays, fields=("t",))["t"], theirs["t"], rtol=1e-5)
        # Clockwise, and uneven.
        listed = sweeps.lidar([0], [30, 10, -20], trajectory=([0, 1], poses * 0 + np.eye(4)[:3]))
        np.testing.assert_allclose(np.degrees(np.arctan2(listed.rays[:, 4], listed.rays[:, 3])), [30, 10, -20])

    def test_steps_keep_what_moves_within_the_error(self):
        self.assertEqual(sweeps.steps(20, 0.1, 0.01), 100)
        self.assertEqual(sweeps.steps(0, 0.1, 0.01), 1)
        car = self.client.scene_of({"car": ([[0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, 9]], [[0, 1, 2], [0, 2, 3]])},
                                   {"car": ("car", (40, 0, 0))}, name="car")
        speed, period, error = 15.0, 0.1, 0.05
        count = sweeps.steps(speed, period, error)
        pose = np.tile(np.eye(4)[:3], (2, 1, 1))
        here, worst = 0.0, 0.0
        for step, chosen in enumerate(np.array_split(np.linspace(-5, 5, 300), count)):
            first, last = period * step / count, period * (step + 1) / count
            to = speed * (first + last) / 2
            with car.edit() as edit:
                edit.move("car", (to - here, 0, 0))
            here = to
            sweep = sweeps.lidar([0], chosen, begin=first, end=last, trajectory=([0, period], pose))
            t = car.trace(sweep.rays, fields=("t",))["t"]
            exact = (40 + speed * sweep.time) / sweep.rays[:, 3]
            worst = max(worst, np.abs(t - exact).max())
        self.assertLess(worst, error * 1.01 + 1e-4)
        self.assertGreater(worst, error / 4)  # it is the motion that is off, and not much less than is allowed

    def test_bad_trajectories_are_refused(self):
        good = np.tile(np.eye(4)[:3], (3, 1, 1))
        for times, poses, words in (
                ([0, 1, 1], good, "must ascend"), ([0, 2, 1], good, "must ascend"), ([0, 1], good, "for 2 times"),
                ([0, 1, np.nan], good, "finite"), ([0, 1, 2], good * 2, "pose 0 of the trajectory is not rigid"),
                ([0, 1, 2], good * [[[1], [1], [-1]]], "not rigid"),
                ([0, 1, 2], np.where(np.arange(3)[:, None, None] == 1, np.nan, good), "pose 1 .* is not rigid"),
                ([0, 0.01, 0.02], good, "the trajectory from 0.0 to 0.02"), ([0, 1, 2], np.eye(3), "shape")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                sweeps.lidar([0], trajectory=(times, poses))
        for elevations, azimuths, words in (([], (0, 1, 2), "elevations of shape"), ([np.inf], (0, 1, 2), "finite"),
                                            (np.zeros(4097), (0, 1, 2), "1 to 4096"), ([0], [], "azimuths of shape")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                sweeps.lidar(elevations, azimuths, trajectory=([0, 1, 2], good))


class PointClouds(WithDaemon):
    def setUp(self):
        self.folder = Path(self.enterContext(tempfile.TemporaryDirectory()))
        random = np.random.default_rng(8)
        self.points = random.uniform(-300, 500, (1000, 3))
        self.points[7] = np.nan
        self.hit = np.arange(1000) % 5 != 0
        self.kept = self.hit & (np.arange(1000) != 7)
        self.columns = {"ring": (np.arange(1000) % 64).astype(np.uint16), "time": random.uniform(0, 0.1, 1000),
                        "intensity": random.uniform(0, 1, 1000).astype(np.float32)}

    def save(self, name, **more):
        path = self.folder / name
        self.assertEqual(points.save(path, self.points, where=self.hit, **{**self.columns, **more}), self.kept.sum())
        return path.read_bytes()

    def same(self, table, places):
        np.testing.assert_allclose(np.stack([table[axis] for axis in "xyz"], -1), self.points[self.kept], atol=places)
        for name, column in self.columns.items():
            np.testing.assert_array_equal(table[name], column[self.kept])

    def test_ply_comes_back(self):
        header, body = self.save("a.ply", path=np.arange(1000, dtype=np.uint64), ng=self.points).split(b"end_header\n", 1)
        sizes = {"double": "<f8", "float": "<f4", "ushort": "<u2", "uint": "<u4"}
        lines = [line.split() for line in header.decode().splitlines()]
        table = np.frombuffer(body, [(name, sizes[kind]) for word, kind, name in
                                     (line for line in lines if line[0] == "property")])
        self.assertIn(["element", "vertex", str(self.kept.sum())], lines)
        self.same(table, 0)
        np.testing.assert_array_equal(table["path"], np.arange(1000)[self.kept])
        np.testing.assert_array_equal(table["ng_2"], self.points[self.kept][:, 2])

    def test_pcd_comes_back(self):
        for far in (0, 4e6):
            self.points = self.points + far
            header, body = self.save("a.PCD").split(b"DATA binary\n", 1)
            said = dict(line.split(" ", 1) for line in header.decode().splitlines() if line[0] != "#")
            kinds = [kind.lower() + size for kind, size in zip(said["TYPE"].split(), said["SIZE"].split())]
            table = np.frombuffer(body, list(zip(said["FIELDS"].split(), ["<" + kind for kind in kinds])))
            self.assertEqual((said["POINTS"], said["HEIGHT"]), (str(self.kept.sum()), "1"))
            self.same(table, 1e-9 if far else 4e-5)

    def test_las_comes_back(self):
        data = self.save("a.las", **{"return": np.arange(1000) % 3})
        version, start, kind, size, count = (*struct.unpack_from("<BB", data, 24)[1:],
                                             *struct.unpack_from("<I", data, 96),
                                             *struct.unpack_from("<BHI", data, 104))
        self.assertEqual((data[:4], version, kind, size, count), (b"LASF", 2, 1, 28, self.kept.sum()))
        scale, offset = np.frombuffer(data, "<f8", 6, 131).reshape(2, 3)
        self.assertEqual(len(data), start + size * count)
        raw = np.frombuffer(data[start:], np.uint8).reshape(count, size)
        place = np.ascontiguousarray(raw[:, :12]).view("<i4") * scale + offset
        np.testing.assert_allclose(place, self.points[self.kept], atol=1e-6)
        np.testing.assert_array_equal(raw[:, 17], self.columns["ring"][self.kept])
        np.testing.assert_array_equal(np.ascontiguousarray(raw[:, 20:28]).view("<f8")[:, 0],
                                      self.columns["time"][self.kept])
        np.testing.assert_array_equal((raw[:, 14] & 7) - 1, (np.arange(1000) % 3)[self.kept])
        returns = struct.unpack_from("<5I", data, 111)
        self.assertEqual(sum(returns), count)
        bounds = np.frombuffer(data, "<f8", 6, 179).reshape(3, 2)
        np.testing.assert_array_equal(bounds[:, 0], self.points[self.kept].max(axis=0))
        # The daemon reads them as points.
        cloud = self.client.load(str(self.folder / "a.las"), "cloud", radius=0.5)
        self.assertEqual(cloud.info["records"]["sphere"] if "records" in cloud.info else self.kept.sum(), self.kept.sum())

    def test_what_no_file_can_hold_is_refused(self):
        for name, more, words in (("a.xyz", {}, "must end with .ply, .pcd or .las"), ("a.las", {"prim": self.hit}, "'prim'"),
                                  ("a.ply", {"path": np.full(1000, 2**40)}, "beyond 32 bits"),
                                  ("a.ply", {"ring": np.zeros(3)}, "ring has shape"),
                                  ("a.ply", {"x": self.hit}, "cannot be called 'x'"),
                                  ("a.las", {"ring": np.full(1000, 256)}, "'ring' from 0 to 255"),
                                  ("a.las", {"return": np.full(1000, 5)}, "'return' from 0 to 4"),
                                  ("a.las", {"intensity": np.full(1000, np.nan)}, "'intensity' from 0 to 1"),
                                  ("a.ply", {"names": np.full(1000, "x")}, "must be numbers")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                self.save(name, **more)
            self.assertFalse((self.folder / name).exists())


if __name__ == "__main__":
    main()
