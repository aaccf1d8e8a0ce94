#!/usr/bin/env python3
"""Sweeps of a moving lidar against float64 formulas.

  sweeps_test.py RAYNESTD RAYNEST FLATC
"""
import numpy as np

import raynest
from raynest import generators, returns, sweeps
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

    def test_half_turns_of_float32_poses_end_where_they_should(self):
        """float32 poses are a little off a turn; near half a turn that is no axis."""
        random = np.random.default_rng(7)
        for angle in (np.pi, np.pi - 1e-7, np.pi - 1e-6, np.pi - 1e-3, np.pi + 1e-4, 2.0, 1.5):
            axis = random.normal(size=3)
            first = turn(random.normal(size=3), 2)
            ends = np.zeros((2, 3, 4), np.float32)
            ends[0, :, :3], ends[1, :, :3] = first, first @ turn(axis, angle)
            at = np.array([0, 0.5, 1 - 1e-9])
            made = sweeps.poses_at(([0, 1], ends), at)[:, :, :3]
            half = [first @ turn(axis, sign * angle / 2) for sign in ((1, -1) if abs(angle - np.pi) < 1e-5 else (1,))]
            if angle > np.pi:
                half = [first @ turn(axis, angle / 2 - np.pi)]
            off = [np.abs(made[0] - first).max(), min(np.abs(made[1] - one).max() for one in half),
                   np.abs(made[2] - first @ turn(axis, angle)).max()]
            self.assertLess(max(off), 2e-6, f"{angle}: {off}")
            # The daemon's are the same.
            rays = generators.sweep([0, 45], [0, 90, 180.0, 30], trajectory=([0, 1], ends), end=1)
            found = self.woods.trace(rays, fields=("direction",))["direction"]
            here = sweeps.lidar([0, 45], [0, 90, 180.0, 30], end=1, trajectory=([0, 1], ends)).rays[:, 3:]
            np.testing.assert_allclose(found, here, atol=3e-7)

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
        # At a time of the trajectory the velocity is that of the stretch which begins there.
        bent = np.tile(np.eye(4)[:3], (3, 1, 1))
        bent[:, 0, 3] = 0, 1, 5
        np.testing.assert_array_equal(sweeps.lidar([0], [1, 2], end=2, trajectory=([0, 1, 2], bent)).velocity[:, 0], [1, 4])
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
                ([0, 1, 2], good * 1.001, "not rigid"),
                ([0, 1, 2], good * [[[1], [1], [-1]]], "not rigid"),
                ([0, 1, 2], np.where(np.arange(3)[:, None, None] == 1, np.nan, good), "pose 1 .* is not rigid"),
                ([0, 1, 2], np.tile(np.vstack((np.eye(4)[:3], [5, 0, 0, 1])), (3, 1, 1)), "not 0 0 0 1"),
                ([0, 0.01, 0.02], good, "the trajectory from 0.0 to 0.02"), ([0, 1, 2], np.eye(3), "shape")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                sweeps.lidar([0], trajectory=(times, poses))
        for elevations, azimuths, words in (([], (0, 1, 2), "elevations of shape"), ([np.inf], (0, 1, 2), "finite"),
                                            (np.zeros(4097), (0, 1, 2), "1 to 4096"), ([0], [], "azimuths of shape"),
                                            ([0], [0, 360, 1800], "as a tuple")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                sweeps.lidar(elevations, azimuths, trajectory=([0, 1, 2], good))


def plate(x, y=(-90, 90), z=(-90, 90)):
    """A rectangle across x, as vertices and triangles."""
    return ([[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]], [[0, 1, 2], [0, 2, 3]])


def still(elevations, azimuths, place=(0, 0, 0), speed=(0, 0, 0), **more):
    """A sweep of a sensor that looks along x, in a second."""
    poses = np.tile(np.eye(4)[:3], (2, 1, 1))
    poses[:, :, 3] = place, np.add(place, speed)
    return sweeps.lidar(elevations, azimuths, end=1, trajectory=([0, 1], poses), **more)


class Returns(WithDaemon):
    def test_a_beam_without_width_measures_what_its_ray_meets(self):
        wall = self.client.mesh(*plate(50), name="plain")
        sweep = still([-10, 0, 12], (-80, 80, 300))
        for wrong in (generators.pinhole(9), sweep.rays, None):
            with self.assertRaisesRegex(TypeError, "takes what raynest.sweeps.lidar"):
                returns.measure(wall, wrong)
        with self.assertRaisesRegex(TypeError, "rays is a sweep: pass sweep.rays"):
            wall.trace(sweep)
        made = returns.measure(wall, sweep, returns=3)
        hits = wall.trace(sweep.rays, fields=("t", "hit", "prim", "base_colour", "reflectance"))
        np.testing.assert_allclose(hits["reflectance"][made["beam"]], made["intensity"], rtol=1e-5)
        self.assertFalse(hits["reflectance"][~hits["hit"]].any())
        self.assertEqual(made["beam"].tolist(), np.flatnonzero(hits["hit"]).tolist())
        self.assertEqual({len(column) for column in made.values()}, {len(made["beam"])})
        np.testing.assert_array_equal(made["t"], hits["t"][made["beam"]])
        np.testing.assert_array_equal(made["prim"], hits["prim"][made["beam"]])
        np.testing.assert_allclose(made["position"][:, 0], 50, rtol=1e-6)
        np.testing.assert_array_equal(made["time"], sweep.time[made["beam"]])
        np.testing.assert_array_equal(made["ring"], sweep.ring[made["beam"]])
        white = hits["base_colour"][hits["hit"]][0] @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose(made["intensity"], white * sweep.rays[made["beam"], 3], rtol=1e-5)
        for footprint in (2, 7, 50, 100):  # whose shares are sums that are rounded
            whole = returns.measure(wall, sweep.where(np.array([150])), divergence=1e-4, footprint=footprint, threshold=1)
            self.assertEqual(len(whole["share"]), 1)
            self.assertAlmostEqual(whole["share"][0], 1, places=12)
        self.assertEqual((made["return"].max(), made["returns"].max(), made["share"].min()), (0, 1, 1))

    def test_returns_have_the_columns_of_their_hits(self):
        sweep = still(np.linspace(-20, 20, 9), (0, 360, 90), (0, 3, 0))
        more = ("normal", "base_colour", "texcoord", "reflectance", "material", "front")
        hits = self.woods.trace(sweep.rays, fields=("hit", "uid", *more))
        made = returns.measure(self.woods, sweep, fields=("base_colour", "uid", *more, "beam"))
        self.assertEqual(list(made), ["base_colour", "uid", "normal", "texcoord", "reflectance", "material", "front", "beam"])
        self.assertGreater(hits["hit"].sum(), 300)
        self.assertEqual(made["beam"].tolist(), np.flatnonzero(hits["hit"]).tolist())
        for name in ("uid", *more):
            self.assertEqual(made[name].dtype, hits[name].dtype)
            np.testing.assert_array_equal(made[name], hits[name][hits["hit"]], name)
        # A beam that is split: each return has those of its own hits.
        near, far = (raynest.Mesh(*plate(0, y=y, z=(-5, 5)), raynest.Material(name, colour))
                     for name, y, colour in (("near", (-5, 0), (.2, .4, .6)), ("far", (-5, 5), (.8, .1, .3))))
        scene = self.client.scene_of({"near": near, "far": far}, {"near": ("near", (10, 0, 0)), "far": ("far", (20, 0, 0))}, name="split")
        split = returns.measure(scene, still([0], [0.0]), divergence=0.01, footprint=100, returns=3, fields=("t", "base_colour", "return"))
        np.testing.assert_allclose(split["base_colour"], [(.2, .4, .6), (.8, .1, .3)], rtol=1e-6)
        self.assertEqual(list(returns.measure(self.woods, sweep, fields="normal")), ["normal"])
        with self.assertRaisesRegex(raynest.UsageError, "no column colour: there are beam, t, .*, and of hits .*texcoord"):
            returns.measure(self.woods, sweep, fields=("t", "colour"))

    def test_masks_many_texts_and_one_epoch(self):
        places = np.stack([np.arange(700.0), 0 * np.arange(700), 0 * np.arange(700)], 1)
        scene = self.client.scene_of({"p": plate(0, y=(-.2, .2), z=(-.2, .2))}, {"p": ("p", places)}, name="row")
        sweep = still([0], np.zeros(8) + .01)
        masks = np.array([1, 0, 1, 1, 0, 0, 1, 0])
        made = returns.measure(scene, sweep, mask=masks, divergence=1e-3, footprint=7, velocities={f"p#{i}": (1, 0, 0) for i in range(700)})
        np.testing.assert_array_equal(made["beam"], np.flatnonzero(masks))
        np.testing.assert_allclose(made["radial_velocity"], 1, atol=1e-3)
        with self.assertRaisesRegex(raynest.UsageError, "one for each beam"):
            returns.measure(scene, sweep, mask=[1, 2])
        # All parts of a sweep are of one epoch, which is told to have gone if it has.
        traced = returns._TRACED_MAX
        try:
            returns._TRACED_MAX = 4
            trace = type(scene).trace

            def edit_before(self, *arguments, **options):
                with self.edit() as edit:
                    edit.move(0, (0, 1, 0))
                with self.edit() as edit:   # the epoch before the last edit may still be there
                    edit.move(0, (0, 1, 0))
                return trace(self, *arguments, **options)
            type(scene).trace = edit_before
            with self.assertRaisesRegex(raynest.InvalidError, "is at epoch"):
                returns.measure(scene, sweep)
        finally:
            returns._TRACED_MAX, type(scene).trace = traced, trace

    def test_returns_end_at_surfaces_and_share_the_beam(self):
        # A near plate that covers what is left of the beam's middle, one behind it, and one behind that.
        scene = self.client.scene_of({"near": plate(10, y=(0.001, 9)), "far": plate(20), "hidden": plate(30)},
                                     {name: (name, (0, 0, 0)) for name in ("near", "far", "hidden")}, name="plates")
        sweep = still([0], [0.0, 5.0, 180.0])
        # At half of `divergence` the power has fallen to 1/e^2, here of one ray beside that in the middle.
        spot = self.client.scene_of({"spot": plate(10, y=(-.01, .01), z=(-.01, .01)), "far": plate(20)}, name="spot")
        two = returns.measure(spot, still([0], [0.0]), divergence=0.01, footprint=2, returns=2)["share"]
        np.testing.assert_allclose(two, np.array([1, np.exp(-2)]) / (1 + np.exp(-2)))
        made = returns.measure(scene, sweep, divergence=0.01, footprint=400, returns=3)
        self.assertEqual(made["beam"].tolist(), [0, 0, 1])  # all of the second beam ends at the near plate, none turns back
        self.assertEqual(made["return"].tolist(), [0, 1, 0])
        self.assertEqual(made["returns"].tolist(), [2, 2, 1])
        np.testing.assert_allclose(made["t"], [10, 20, 10 / np.cos(np.radians(5))], rtol=1e-4)
        np.testing.assert_allclose(made["share"], [0.5, 0.5, 1], atol=0.03)
        self.assertAlmostEqual(made["share"][:2].sum(), 1, places=6)
        self.assertNotEqual(made["path"][0], made["path"][1])
        one = returns.measure(scene, sweep, divergence=0.01, footprint=400, returns=1, prefer="strongest")
        self.assertEqual(one["t"][0], made["t"][np.argmax(made["intensity"][:2])])
        self.assertEqual(one["returns"].tolist(), [1, 1])
        joined = returns.measure(scene, sweep, divergence=0.01, footprint=400, returns=3, resolution=11)
        self.assertEqual(len(joined["t"]), 2)
        np.testing.assert_allclose(joined["t"][0], 15, atol=0.3)
        weak = returns.measure(scene, sweep, divergence=0.01, footprint=400, returns=3, threshold=0.6)
        self.assertEqual(weak["beam"].tolist(), [1])
        self.assertEqual(len(returns.measure(scene, sweep, range=(0, 9))["t"]), 0)
        self.assertEqual(returns.measure(scene, sweep, range=(11, 90))["t"].tolist()[0], 20)

    def test_a_wide_beam_does_not_fall_through_a_small_hole(self):
        # A hole of 1 cm at 100 m, where a beam of 1.35 mrad is 13.5 cm wide.
        pieces = {"a": plate(100, y=(-90, -0.005)), "b": plate(100, y=(0.005, 90)),
                  "c": plate(100, y=(-0.005, 0.005), z=(0.005, 90)), "d": plate(100, y=(-0.005, 0.005), z=(-90, -0.005))}
        scene = self.client.scene_of(pieces, {name: (name, (0, 0, 0)) for name in pieces}, name="hole")
        sweep = still([0], [0.0])
        self.assertEqual(len(returns.measure(scene, sweep)["t"]), 0)
        np.testing.assert_allclose(returns.measure(scene, sweep, divergence=0.00135)["t"], [100], rtol=1e-5)

    def test_noise_is_of_its_seed(self):
        wall = self.client.mesh(*plate(50), name="noisy")
        sweep = still(np.linspace(-20, 20, 50), (-20, 20, 200))
        plain = returns.measure(wall, sweep)["t"]
        first, again, other = (returns.measure(wall, sweep, noise=0.05, seed=seed) for seed in (1, 1, 2))
        np.testing.assert_array_equal(first["t"], again["t"])
        self.assertGreater(np.abs(first["t"] - other["t"]).min(), 0)
        off = first["t"] - plain
        self.assertAlmostEqual(off.std() / 0.05, 1, delta=0.05)
        self.assertLess(abs(off.mean()), 5 * 0.05 / 100)
        np.testing.assert_allclose(np.linalg.norm(first["position"] - sweep.rays[:, :3], axis=1), first["t"], rtol=1e-9)

    def test_radial_velocity_of_the_sensor_and_of_what_moves(self):
        boxes = {name: plate(0, y=(-5, 5), z=(-5, 5)) for name in ("stands", "drives", "turns")}
        scene = self.client.scene_of(boxes, {"stands": ("stands", (40, -20, 0)), "drives": ("drives", (40, 0, 0)),
                                             "turns": ("turns", (40, 20, 0))}, name="three")
        speed, velocity, spin, pivot = np.array([13, 2, 1]), np.array([-9, 1, 0.5]), np.array([0, 0, 2.5]), np.array([40, 20, 0])
        sweep = still([-2, 0, 3], (-40, 40, 400), speed=speed)
        made = returns.measure(scene, sweep, velocities={"drives": velocity, "turns": [velocity, spin, pivot]})
        name = np.array([text.partition("/")[0] for text in scene.path_of(made["path"])])
        self.assertEqual(set(name), set(boxes))
        way = sweep.rays[made["beam"], 3:]
        moving = np.zeros((len(way), 3))
        moving[name == "drives"] = velocity
        arm = made["position"] - pivot - velocity * made["time"][:, None]
        turning = name == "turns"
        moving[turning] = velocity + np.stack([-2.5 * arm[:, 1], 2.5 * arm[:, 0], 0 * arm[:, 0]], -1)[turning]
        np.testing.assert_allclose(made["radial_velocity"], ((moving - speed) * way).sum(axis=1), atol=1e-4)
        moved = returns.measure(scene, sweep, velocities={"drives": velocity, "turns": [velocity, spin, pivot]}, fields=("velocity",))
        np.testing.assert_allclose(moved["velocity"], moving, atol=1e-4)
        # A star stands for any letters, and a beam that meets nothing moves nothing.
        stars = returns.measure(scene, sweep, velocities={"driv*": velocity, "t*": [velocity, spin, pivot]})
        np.testing.assert_array_equal(stars["radial_velocity"], made["radial_velocity"])
        none = returns.measure(scene, sweep, velocities={"drives": velocity}, range=(0, 1))
        self.assertEqual({len(column) for column in none.values()}, {0})
        self.assertEqual(none["intensity"].dtype, np.float64)
        # Approach is negative: the distance a moment later says so, too.
        later = still([-2, 0, 3], (-40, 40, 400), place=speed * 1e-3, speed=speed)
        stands = name == "stands"
        gone = np.linalg.norm(made["position"] - later.rays[made["beam"], :3], axis=1) - made["t"]
        np.testing.assert_allclose(made["radial_velocity"][stands], gone[stands] / 1e-3, rtol=1e-2)

    def test_sweeps_of_the_daemon_are_measured_as_those_that_are_made_here(self):
        wall, wide = self.client.mesh(*plate(50), name="both"), {"divergence": 0.003, "footprint": 7, "returns": 2}
        poses = np.tile(np.eye(4)[:3], (2, 1, 1))
        poses[1, :, 3] = 3, 1, 0.5
        angles, move = ([-10, 0, 12], (-60, 60, 40)), ([0, 0.2], poses)
        def same(made, wanted, **off):
            self.assertGreater(len(wanted["t"]), 50)
            self.assertEqual(made.keys(), wanted.keys())
            for name, column in wanted.items():
                np.testing.assert_allclose(made[name], column, err_msg=name, **off)
        scans = [sweeps.lidar(*angles, begin=0.1 * scan, end=0.1 * scan + 0.1, trajectory=move) for scan in (0, 1)]
        both = sweeps.Sweep(*(np.concatenate(columns) for columns in zip(*scans)))
        ours = generators.sweep(*angles, scans=2, trajectory=move)
        same(returns.measure(wall, ours, **wide), returns.measure(wall, both, **wide), atol=1e-12)
        same(returns.measure(wall, ours.part(50, 150), **wide), returns.measure(wall, both.where(slice(50, 200)), **wide), atol=1e-12)
        stands = still(*angles, place=poses[1, :, 3])
        stands.time[:] = 0
        same(returns.measure(wall, generators.lidar(*angles, pose=poses[1]), **wide), returns.measure(wall, stands, **wide), atol=1e-5)
        near = generators.lidar(*angles, pose=poses[1], tmin=1, tmax=60)
        same(returns.measure(wall, near, **wide), returns.measure(wall, stands, range=(1, 60), **wide), atol=1e-5)
        same(returns.measure(wall, near, range=(0, np.inf), **wide), returns.measure(wall, stands, **wide), atol=1e-5)
        with self.assertRaisesRegex(raynest.UsageError, "pass time=sweep.time and a time_step"):
            returns.measure(wall, generators.sweep(*angles, trajectory=move, step_error=0.1))

    def test_pieces_of_a_sweep_are_the_sweep(self):
        wall = self.client.mesh(*plate(50), name="whole")
        sweep = still([-10, 0, 12], (-60, 60, 300))
        whole = returns.measure(wall, sweep, divergence=0.003, returns=2)
        parts = [returns.measure(wall, sweep.where(chosen), divergence=0.003, returns=2)
                 for chosen in np.array_split(np.arange(len(sweep.rays)), 7)]
        for name in ("t", "position", "intensity", "ring", "time", "radial_velocity"):
            np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), whole[name])
        kept, returns._TRACED_MAX = returns._TRACED_MAX, 1000
        self.addCleanup(setattr, returns, "_TRACED_MAX", kept)
        small = returns.measure(wall, sweep, divergence=0.003, returns=2)
        for name, column in whole.items():
            np.testing.assert_array_equal(small[name], column)

    def test_bad_values_are_refused(self):
        wall = self.client.mesh(*plate(50), name="refused")
        sweep = still([0], [0.0])
        for more, words in (({"divergence": -1}, "divergence"), ({"divergence": np.nan}, "divergence"),
                            ({"divergence": 2}, "angle in radians"), ({"footprint": 0}, "footprint"),
                            ({"footprint": 5000}, "footprint"), ({"returns": 0}, "returns"), ({"returns": 99}, "returns"),
                            ({"resolution": 0}, "resolution"), ({"threshold": 2}, "threshold"), ({"noise": -1}, "noise"),
                            ({"prefer": "last"}, "'nearest' or 'strongest'"), ({"range": (5, 5)}, "range"),
                            ({"range": (-1, 5)}, "range"), ({"range": 5}, "range"), ({"range": (1,)}, "range"),
                            ({"resolution": np.inf}, "finite"), ({"noise": np.inf}, "finite"), ({"kind": "all"}, "kind"),
                            ({"detach": True}, "detach"), ({"velocities": [1]}, "texts of paths"), ({"velocities": {"car": (1, 2)}}, "'car' has shape"),
                            ({"velocities": {"car": (1, 2, np.inf)}}, "'car'"), ({"velocities": {3: (1, 2, 3)}}, "texts of paths"), ({"seed": -1}, "seed")):
            with self.subTest(more=more), self.assertRaisesRegex(raynest.UsageError, words):
                returns.measure(wall, sweep, **more)


if __name__ == "__main__":
    main()
