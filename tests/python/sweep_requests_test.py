#!/usr/bin/env python3
"""Sweeps whose rays the daemon makes from a trajectory: those that the client makes in float64.

  sweep_requests_test.py RAYNESTD RAYNEST FLATC
"""
import numpy as np

import raynest
from raynest import generators, sweeps
from sweeps_test import turn
from with_daemon import WithDaemon, main

SURVEY = np.array([4_500_000.25, 10.0, -5_400_000.5])
ELEVATIONS = (-25.0, -3.5, 0.0, 12.25)


def drive(count, end=1.0, at=(0, 0, 0), seed=1):
    """A trajectory of `count` poses from 0 to `end`, which turns and moves at random."""
    chance = np.random.default_rng(seed)
    times = np.concatenate([[0], np.sort(chance.uniform(0, end, count - 2)), [end]]) if count > 1 else np.zeros(1)
    poses = np.empty((count, 3, 4))
    way = turn(chance.normal(size=3), 1)
    for pose in poses:
        way = way @ turn(chance.normal(size=3), 0.3)
        pose[:, :3] = way
        pose[:, 3] = chance.uniform(-20, 20, 3) * [1, 0.2, 1] + [0, 6, 0] + at
    return times, poses


class SweepRequests(WithDaemon):
    def made_here(self, trajectory, azimuths, begin, end, scans, elevations=ELEVATIONS):
        """The rays (N, 6) of all scans, ring and time, by numpy alone."""
        around = np.radians(azimuths)
        times = begin + (end - begin) * np.arange(scans * len(around)) / len(around)
        poses = sweeps.poses_at(trajectory, times).reshape(scans, 1, len(around), 3, 4)
        up = np.radians(elevations)[None, :, None]
        ways = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), -1)
        rays = np.empty((scans, len(elevations), len(around), 6))
        rays[..., :3] = poses[..., 3]
        rays[..., 3:] = (poses[..., :3] @ ways[..., None])[..., 0]
        ring = np.broadcast_to(np.arange(len(elevations))[None, :, None], rays.shape[:3])
        time = np.broadcast_to(times.reshape(scans, 1, -1), rays.shape[:3])
        return rays.reshape(-1, 6), ring.ravel(), time.ravel()

    def near(self, found, exact):
        """Each value is that of float64 after one rounding to float32, or the next one: sine and cosine are the
        library's there, and may differ in their last bit."""
        exact = exact.astype(np.float32)
        self.assertEqual(found.shape, exact.shape)
        off = np.abs(found.astype(np.float64) - exact) > np.spacing(np.maximum(np.abs(exact), 1e-6))
        self.assertFalse(off.any())
        self.assertGreater((found == exact).mean(), 0.999)

    def test_the_rays_are_those_of_the_client_and_of_numpy(self):
        trajectory = drive(37)
        uneven = np.array([90.0, 45, 44, -170.5, 360, 1e-3, 0, 720.25])
        for azimuths, columns in (((0, 360, 500), 360 * np.arange(500) / 500), ((180, -180, 77), 180 - 360 * np.arange(77) / 77),
                                  (uneven, uneven)):
            for begin, end, scans in ((0.0, 0.1, 1), (0.125, 0.225, 8), (0.5, 0.5, 3)):
                with self.subTest(columns=len(columns), begin=begin, scans=scans):
                    made = generators.sweep(ELEVATIONS, azimuths, trajectory=trajectory, begin=begin, end=end, scans=scans)
                    rays, ring, time = self.made_here(trajectory, columns, begin, end, scans)
                    seen = self.woods.trace(made, fields=("origin", "direction", "t", "hit"))
                    self.near(seen["origin"], rays[:, :3])
                    self.near(seen["direction"], rays[:, 3:])
                    np.testing.assert_array_equal(made.ring, ring)
                    np.testing.assert_array_equal(made.time, time)
                    # The daemon traces the rays that it tells.
                    sent = np.concatenate([seen["origin"], seen["direction"]], 1)
                    self.same(self.woods.trace(sent, fields=("t", "hit")), {name: seen[name] for name in ("t", "hit")})
                    if scans == 1:
                        here = sweeps.lidar(ELEVATIONS, azimuths, begin=begin, end=end, trajectory=trajectory)
                        self.near(seen["direction"], here.rays[:, 3:])
                        np.testing.assert_array_equal(made.ring, here.ring)
                        np.testing.assert_array_equal(made.time, here.time)

    def test_radial_velocities_are_those_of_the_sensor(self):
        trajectory = drive(37)
        rising = (np.linspace(0, 1, 5), np.tile(np.eye(4)[:3], (5, 1, 1)))
        rising[1][:, 1, 3] = 5 + np.array([0, 1, 1.5, 4, 3.])
        sweep = generators.sweep(ELEVATIONS, (0, 360, 97), trajectory=trajectory, begin=0, end=0.1, scans=9)
        picture = generators.rolling_shutter(30, size=(40, 31), trajectory=rising, begin=0.1, end=0.9)
        rows = (0.1 + 0.8 * np.arange(31) / 31).repeat(40)
        for made, way, times in ((sweep, trajectory, sweep.time), (picture, rising, rows)):
            fields = ("t", "hit", "direction", "radial_velocity")
            seen = self.woods.trace(made, fields=fields)
            unit = seen["direction"] / np.linalg.norm(seen["direction"], axis=1)[:, None]
            away = -(sweeps._velocity_at(way, times) * unit).sum(1)
            self.assertGreater(seen["hit"].sum(), 100)
            np.testing.assert_allclose(seen["radial_velocity"], np.where(seen["hit"], away, 0), rtol=1e-5, atol=1e-4)
            parts = [self.woods.trace(made.part(first, count), fields=("radial_velocity",))["radial_velocity"]
                     for first, count in ((0, 501), (501, made.count - 501))]
            np.testing.assert_array_equal(np.concatenate(parts), seen["radial_velocity"])
            every = self.woods.trace(made, kind="all", fields=("t", "radial_velocity"), max_hits=64)
            np.testing.assert_allclose(every["radial_velocity"], away.repeat(np.diff(every["ray_splits"].astype(int))), rtol=1e-5, atol=1e-4)

    def test_positions_in_the_axes_of_the_sensor(self):
        trajectory = drive(37)
        fields = ("t", "hit", "sensor_position")
        sweep = generators.sweep(ELEVATIONS, (0, 360, 97), trajectory=trajectory, begin=0, end=0.1, scans=9)
        around, up = np.radians(360 * np.arange(97) / 97), np.radians(ELEVATIONS)[:, None]
        ways = np.tile(np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)),
                                -1).reshape(-1, 3), (9, 1))
        pose = np.eye(3, 4)
        pose[:, :3], pose[:, 3] = turn([1, 2, 3], 1.0), (3, 7, 2)
        lidar = generators.lidar(ELEVATIONS, (0, 360, 97), pose=pose)
        camera = generators.pinhole(20, size=(30, 20), pose=pose)
        x, y = np.meshgrid((np.arange(30) + .5 - 15) / 20, -(np.arange(20) + .5 - 10) / 20)
        for made, way in ((sweep, ways), (lidar, ways[:4 * 97]), (camera, np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3))):
            seen = self.woods.trace(made, fields=fields)
            self.assertGreater(seen["hit"].sum(), 20)
            local = np.where(seen["hit"][:, None], np.where(seen["hit"], seen["t"], 0)[:, None] * way, 0)
            np.testing.assert_allclose(seen["sensor_position"], local, rtol=1e-5, atol=2e-5)
            part = self.woods.trace(made.part(50, 33), fields=fields)["sensor_position"]
            np.testing.assert_array_equal(part, seen["sensor_position"][50:83])
        for rays in (np.ones((2, 6)), generators.hemisphere([[0, 9, 0]], [0, 1, 0])):
            with self.assertRaisesRegex(raynest.Error, "sensor_position is of rays that a generator"):
                self.woods.trace(rays, fields=("sensor_position",))

    def test_a_hundred_scans_are_one_request(self):
        trajectory = drive(300, end=10)
        made = generators.sweep(ELEVATIONS, (0, 360, 200), trajectory=trajectory, begin=0, end=0.1, scans=100)
        self.assertEqual(made.count, 100 * 4 * 200)
        before = self.client.stats()["jobs_started"]
        seen = self.woods.trace(made, fields=("t", "prim", "direction"))
        self.assertEqual(self.client.stats()["jobs_started"], before + 1)
        rays, _, _ = self.made_here(trajectory, 360 * np.arange(200) / 200, 0, 0.1, 100)
        self.near(seen["direction"], rays[:, 3:])
        for scan in (0, 41, 99):
            alone = self.woods.trace(rays[scan * 800:(scan + 1) * 800], fields=("t",))["t"]
            np.testing.assert_allclose(seen["t"][scan * 800:(scan + 1) * 800][::50], alone[::50], rtol=1e-2)

    def test_one_that_stands_still_is_the_lidar_of_the_daemon(self):
        for poses in (1, 2):
            pose = np.eye(4)[:3]
            pose[:, 3] = 1, 5, 2
            made = generators.sweep(ELEVATIONS, (0, 360, 300), trajectory=(np.arange(poses), np.tile(pose, (poses, 1, 1))),
                                    end=0.0, tmin=0.5, tmax=40)
            lidar = generators.lidar(ELEVATIONS, (0, 360, 300), pose=pose, tmin=0.5, tmax=40)
            fields = ("t", "prim", "origin", "direction", "position", "hit")
            self.same(self.woods.trace(made, fields=fields), self.woods.trace(lidar, fields=fields))

    def test_far_scenes_parts_streams_kinds_and_detached_jobs(self):
        far = self.client.mesh(np.array([[-90, 0, -90], [90, 0, -90], [0, 0, 90]]) + SURVEY, [[0, 1, 2]], name="ground",
                               origin=SURVEY)
        there = generators.sweep(ELEVATIONS, (0, 360, 64), trajectory=drive(5, at=SURVEY), scans=3)
        here = generators.sweep(ELEVATIONS, (0, 360, 64), trajectory=drive(5), scans=3)
        near = self.client.mesh([[-90, 0, -90], [90, 0, -90], [0, 0, 90]], [[0, 1, 2]], name="near")
        seen = far.trace(there, fields=("t", "position", "hit"))
        beside = near.trace(here, fields=("t", "hit"))
        np.testing.assert_array_equal(seen["hit"], beside["hit"])
        np.testing.assert_allclose(seen["t"], beside["t"], rtol=1e-4)
        self.assertTrue((np.abs(seen["position"][seen["hit"] != 0] - SURVEY) < 100).all())
        # The origin of the request replaces the scene's.
        np.testing.assert_allclose(far.trace(here, origin=(0, 0, 0), fields=("t",))["t"], beside["t"], rtol=1e-5)

        made = generators.sweep(ELEVATIONS, (0, 360, 3000), trajectory=drive(9), scans=4)
        whole = self.woods.trace(made)
        for first, count in ((0, 1), (11999, 2), (12000, 12000), (40000, 8000)):
            part = made.part(first, count)
            self.same(self.woods.trace(part), {name: column[first:first + count] for name, column in whole.items()})
            np.testing.assert_array_equal(part.ring, made.ring[first:first + count])
            np.testing.assert_array_equal(part.time, made.time[first:first + count])
        rows = 0
        told = self.woods.trace(made, fields=("time", "t", "ring"))
        np.testing.assert_array_equal(told["ring"], made.ring)
        np.testing.assert_array_equal(told["time"], made.time)
        np.testing.assert_array_equal(told["t"], whole["t"])
        with self.assertRaises(raynest.UsageError):
            self.woods.trace(made, fields="ring")
        for first, columns in self.woods.stream(made, fields=("t", "ring", "time")):
            rows += len(columns["t"])
            for name in ("ring", "time"):
                np.testing.assert_array_equal(columns[name], told[name][first:first + len(columns["t"])])
            np.testing.assert_array_equal(columns["t"], whole["t"][first:first + len(columns["t"])])
        self.assertEqual(rows, made.count)
        sent = self.woods.trace(made, fields=("origin", "direction"))
        rays = np.concatenate([sent["origin"], sent["direction"]], 1)
        for options in ({"kind": "any"}, {"kind": "multi"}, {"kind": "all", "fields": ("t",)}, {"fields": ("total",)},
                        {"reduce": "visible_pixels"}, {"kind": "null"}, {"traversal": "single"}):
            self.same(self.woods.trace(made, **options), self.woods.trace(rays, **options))
        job = self.woods.trace(made, detach=True)
        job.wait()
        self.same(job.fetch(), whole)

    def test_long_trajectories_come_in_several_frames(self):
        times = np.linspace(0, 1, 200_000)
        poses = np.tile(np.eye(4)[:3], (len(times), 1, 1))
        poses[:, 0, 3] = 10 * np.sin(times)
        poses[:, 1, 3] = 5
        made = generators.sweep(np.linspace(-30, 30, 700), np.linspace(0, 359, 100), trajectory=(times, poses), end=1)
        seen = self.woods.trace(made, fields=("origin",))["origin"]
        np.testing.assert_allclose(seen[:100, 0], 10 * np.sin(np.arange(100) / 100), atol=1e-6)

    def test_the_command_line_sends_world_coordinates_to_a_scene_with_an_origin(self):
        self.client.mesh(np.array([[-90, 0, -90], [90, 0, -90], [0, 0, 90]]) + SURVEY, [[0, 1, 2]], name="far", origin=SURVEY)
        times, poses = drive(5, at=SURVEY)
        np.save(self.out / "far.npy", np.column_stack([times, poses.reshape(-1, 12)]))
        trajectory = f"trajectory={self.out / 'far.npy'}"
        for made, words in (
                (generators.sweep(ELEVATIONS, (0, 360, 64), trajectory=(times, poses)),
                 ("sweep", "elevations=-25,-3.5,0,12.25", "azimuths=0:360:64", trajectory)),
                (generators.rolling_shutter(16, 16, size=(32, 8), trajectory=(times, poses)),
                 ("rolling_shutter", "size=32x8", "fx=16", "fy=16", trajectory))):
            done = self.cli.run("query", "far", "--generate", *words, "--fields", "t,hit", "-o", self.out / "far.npz")
            self.assertEqual(done.returncode, 0, done.stderr)
            with np.load(self.out / "far.npz") as file:
                self.same(dict(file), self.client.scene("far").trace(made, fields=("t", "hit")))

    def test_the_command_line_reads_a_trajectory_from_a_file(self):
        times, poses = drive(20)
        made = generators.sweep(ELEVATIONS, (0, 360, 600), trajectory=(times, poses), begin=0.1, end=0.2, scans=4)
        fields = ("t", "prim", "position")
        whole = self.woods.trace(made, fields=fields)
        np.save(self.out / "drive.npy", np.column_stack([times, poses.reshape(-1, 12)]))
        words = ("query", "woods", "--generate", "sweep", f"trajectory={self.out / 'drive.npy'}", "elevations=-25,-3.5,0,12.25",
                 "azimuths=0:360:600", "begin=0.1", "end=0.2", "scans=4", "--fields", ",".join(fields), "-o")
        done = self.cli.run(*words, self.out / "whole.npz")
        self.assertEqual(done.returncode, 0, done.stderr)

        def read(name):
            with np.load(self.out / name) as file:
                return {field: file[field] for field in fields}
        self.same(read("whole.npz"), whole)
        for part in (1, 2, 3):
            done = self.cli.run(*words, self.out / f"part-{part}.npz", "--part", f"{part}/3")
            self.assertEqual(done.returncode, 0, done.stderr)
        done = self.cli.run("merge", self.out / "all.npz", *(self.out / f"part-{part}.npz" for part in (1, 2, 3)))
        self.assertEqual(done.returncode, 0, done.stderr)
        self.same(read("all.npz"), whole)
        # Angles from files, in any order.
        up, around = np.linspace(-30, 12, 5), np.array([90, 45, 44, -170.5, 360, 1e-3, 0.0])
        np.save(self.out / "up.npy", up), np.save(self.out / "around.npy", around.astype(np.float32))
        words = ["query", "woods", "--generate", "sweep", f"trajectory={self.out / 'drive.npy'}", f"azimuths={self.out / 'around.npy'}",
                 f"elevations={self.out / 'up.npy'}", "begin=0.1", "end=0.2", "scans=3", "--fields", ",".join(fields), "-o"]
        exact = self.woods.trace(generators.sweep(up, around.astype(np.float32), trajectory=(times, poses), begin=.1, end=.2, scans=3), fields=fields)
        for part in (1, 2):
            done = self.cli.run(*words, self.out / f"part-{part}.npz", "--part", f"{part}/2")
            self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.cli.run("merge", self.out / "all.npz", self.out / "part-1.npz", self.out / "part-2.npz").returncode, 0)
        self.same(read("all.npz"), exact)
        for wrong, said in ((np.zeros((2, 2)), "must have the shape (N,), of 1 to 4096 rows: degrees"), (np.zeros(4097), "must have the shape"),
                            (np.array([0, np.inf]), "must be finite")):
            np.save(self.out / "up.npy", wrong)
            done = self.cli.run(*words, self.out / "no.npz")
            self.assertIn(said, done.stderr)
            self.assertIn(done.returncode, (2, 5))
        done = self.cli.run("query", "woods", "--generate", "lidar", "elevations=1", f"azimuths={self.out / 'around.npy'}")
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("of --generate sweep", done.stderr)
        words = ("query", "woods", "--generate", "sweep", f"trajectory={self.out / 'drive.npy'}", "elevations=-25,-3.5,0,12.25",
                 "azimuths=0:360:600", "begin=0.1", "end=0.2", "scans=4", "--fields", ",".join(fields), "-o")
        for wrong, code, said in ((np.zeros((3, 12)), 5, "must have the shape"), (np.zeros((0, 13)), 5, "must have the shape"),
                                  (np.full((2, 13), np.nan), 2, "pose 0 of the trajectory or its time is not finite")):
            np.save(self.out / "drive.npy", wrong)
            done = self.cli.run(*words, self.out / "no.npz")
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertIn(said, done.stderr)
        done = self.cli.run("query", "woods", "--generate", "sweep", "elevations=1", "azimuths=0:360:60")
        self.assertEqual(done.returncode, 2)
        self.assertIn("needs trajectory=FILE.npy", done.stderr)
        # The daemon would wait for numbers that never come.
        for key, instead in (("channels", "elevations="), ("columns", "azimuths="), ("poses", "trajectory=FILE.npy")):
            done = self.cli.run("query", "woods", "--generate", "sweep", "elevations=1", "azimuths=0:360:60", f"{key}=4")
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn(f"on the command line it is {instead}", done.stderr)

    def test_a_lidar_with_a_trajectory_is_a_sweep(self):
        trajectory = drive(4)
        for azimuths in ((0, 360, 300), np.array([90.0, 30.0, 60.0, 0.0])):
            made = generators.lidar(ELEVATIONS, azimuths, trajectory=trajectory, end=0.05, scans=2, tmax=40)
            other = generators.sweep(ELEVATIONS, azimuths, trajectory=trajectory, end=0.05, scans=2, tmax=40)
            fields = ("t", "prim", "origin", "direction", "time", "ring")
            self.same(self.woods.trace(made, fields=fields), self.woods.trace(other, fields=fields))
        for settings, said in (({"trajectory": trajectory, "pose": np.eye(4)}, "in motion goes without pose"),
                               ({"trajectory": trajectory, "azimuth_offsets": [0, 1, 2]}, "one for each of the 4 elevations"),
                               ({"trajectory": trajectory, "origin_offsets": np.zeros((3, 3))}, "one for each of the 4 elevations"),
                               ({"end": 0.1, "look_at": ([0, 0, 0], [1, 0, 0])}, "with end goes without look_at"),
                               ({"step_error": 0.1, "camera": ""}, "with step_error goes without camera")):
            with self.assertRaisesRegex(raynest.UsageError, said):
                generators.lidar(ELEVATIONS, **settings)

    def test_channels_of_a_head_in_motion_have_offsets(self):
        offsets = {"azimuth_offsets": [3, -1.5, 0, 10], "origin_offsets": [[.1, 0, .3], [0, -.2, 0], [0, 0, 0], [.05, .05, -.1]]}
        fields = ("origin", "direction", "t", "prim")
        poses = drive(4)[1]
        for pose in poses[:2]:
            still = self.woods.trace(generators.lidar(ELEVATIONS, (0, 360, 90), pose=pose, **offsets), fields=fields)
            moving = generators.lidar(ELEVATIONS, (0, 360, 90), trajectory=([0.0, 1.0], [pose, pose]), **offsets)
            self.same(self.woods.trace(moving, fields=fields), still)
        # Each column is that of a head which stands where the sensor is then.
        moving = generators.sweep(ELEVATIONS, (0, 360, 6), trajectory=drive(4), end=1.0, **offsets)
        seen = self.woods.trace(moving, fields=fields)
        for column, pose in enumerate(sweeps.poses_at(drive(4), np.arange(6) / 6)):
            still = self.woods.trace(generators.lidar(ELEVATIONS, (0, 360, 6), pose=pose, **offsets), fields=fields)
            for name in ("origin", "direction"):
                np.testing.assert_allclose(seen[name][column::6], still[name][column::6], atol=2e-6)
        plain = self.woods.trace(generators.sweep(ELEVATIONS, (0, 360, 6), trajectory=drive(4), end=1.0), fields=fields)
        self.assertTrue((plain["direction"][:6] != seen["direction"][:6]).any(axis=1).all())

    def test_what_is_wrong_gets_a_line(self):
        times, poses = drive(4)

        def refused(said, spoil):
            made = generators.sweep(ELEVATIONS, np.arange(10), trajectory=(times, poses))
            spoil(made)
            with self.assertRaisesRegex(raynest.Error, said):
                self.woods.trace(made)
            self.woods.trace([[0, 9, 0, 0, -1, 0]])     # the connection lives

        def put(row, column, value):
            return lambda made: made._way.rows.__setitem__((row, column), value)
        refused("pose 2 of the trajectory or its time is not finite", put(2, 5, np.nan))
        refused("pose 0 of the trajectory or its time is not finite", put(0, 0, -np.inf))
        refused("pose 3 of the trajectory is not later", put(3, 0, 0.0))
        refused("pose 1 of the trajectory is not rigid", put(1, 1, 3.0))
        refused("pose 1 of the trajectory is not rigid", lambda made: made._way.rows.__setitem__(
            (1, slice(1, 13)), np.diag([1, 1, -1.0, 1])[:3].ravel()))
        refused("measures at 0.0.*the trajectory lasts from 0.05", put(0, 0, 0.05))
        refused("elevations and azimuths must be finite", lambda made: made._angles.__setitem__(5, np.nan))
        refused("elevations must lie between -90 and 90 degrees", lambda made: made._angles.__setitem__(0, -90.5))
        refused("longer than its announced", lambda made: made._settings.update(poses="3"))

        def say(**settings):
            return lambda made: made._settings.update(settings)
        refused("poses: 1048577, the limit is 1048576", say(poses="1048577"))
        refused("channels: 4097", say(channels="4097"))
        refused("columns: 65537", say(columns="65537"))
        refused("ask for fewer at a time", say(scans="104858"))
        refused("needs scans above 0", say(scans="0"))
        refused("one of each two", say(channels="0"))
        refused("one of each two", say(elevations="1,2"))
        refused("must end after it begins", say(end="-1"))
        for wrong, said in (({"trajectory": (times, poses[:3])}, "for 4 times"), ({"trajectory": 3}, r"\(times, poses\)"),
                            ({"end": 2}, "the trajectory from 0.0 to 1.0"), ({"end": -1}, "end after it begins"),
                            ({"scans": 100}, "the trajectory from"), ({"scans": 0}, "scans"),
                            ({"scans": 513, "azimuths": (0, 360, 2048)}, "all have at most 1048576"),
                            ({"elevations": np.zeros(513), "azimuth_offsets": np.zeros(513)}, "at most 512 channels"),
                            ({"elevations": [np.inf]}, "finite"), ({"azimuths": []}, "azimuths of shape")):
            with self.subTest(**wrong), self.assertRaisesRegex(raynest.UsageError, said):
                generators.sweep(**{"elevations": [0], "trajectory": (times, poses), **wrong})
        many = np.zeros(100_000)
        with self.assertRaises(raynest.UsageError):
            generators.sweep([0], many, trajectory=(times, poses))

    def test_clients_that_leave_before_their_trajectory_came_hold_nothing(self):
        made = generators.sweep(ELEVATIONS, np.arange(10), trajectory=drive(4))
        made._settings["poses"] = "1000000"
        before = self.client.stats()["memory_used_bytes"]
        with self.assertRaises(raynest.DeadlineError):
            self.woods.trace(made, deadline=0.2)
        with raynest.connect(self.daemon.uri) as other:
            with self.assertRaises(raynest.DeadlineError):
                other.scene("woods").trace(made, deadline=0.2)
        self.assertLess(self.client.stats()["memory_used_bytes"], before + (32 << 20))


if __name__ == "__main__":
    main()
