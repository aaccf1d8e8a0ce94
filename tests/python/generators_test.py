#!/usr/bin/env python3
"""Rays that the daemon makes, and what it sums over them, against numpy on the same rays.

  generators_test.py RAYNESTD RAYNEST FLATC

That the daemon's formulas are those of PROTOCOL.md is shown in tests/integration; here: that what
is asked for in Python's words arrives.
"""
import math
import warnings

import numpy as np

import raynest
from raynest import generators
from with_daemon import WithDaemon, main

ULP = 2.0**-23
POSE = np.array([[0, 0, 1, 5], [1, 0, 0, 20], [0, 1, 0, -3], [0, 0, 0, 1.0]])
SIZE = (61, 43)


def pixels():
    row, column = np.mgrid[0:SIZE[1], 0:SIZE[0]]
    return column.ravel() + 0.5, row.ravel() + 0.5


class Generators(WithDaemon):
    def made(self, generator, scene=None, **options):
        """Origins and directions of the daemon; nothing is traced."""
        rays = (scene or self.woods).trace(generator, kind="null", fields=("origin", "direction"),
                                           **options)
        self.assertEqual(len(rays["origin"]), generator.count)
        return rays["origin"], rays["direction"]

    def check(self, generator, origins, directions):
        for have, want in zip(self.made(generator), (origins, directions)):
            scale = np.maximum(np.abs(want).max(1, keepdims=True), 1e-30)
            self.assertLessEqual((np.abs(have - want) / scale).max(), 1.01 * ULP)

    def placed(self, directions, offsets=0.0):
        return (POSE[:3, 3] + offsets @ POSE[:3, :3].T if np.ndim(offsets) else
                np.broadcast_to(POSE[:3, 3], directions.shape)), directions @ POSE[:3, :3].T

    def test_a_pinhole_has_its_focal_lengths_and_its_principal_point(self):
        x, y = pixels()
        for given, (fx, fy, cx, cy) in (((50,), (50, 50, SIZE[0] / 2, SIZE[1] / 2)),
                                        ((50, 40, 10, 20), (50, 40, 10, 20))):
            ways = np.stack([(x - cx) / fx, (cy - y) / fy, -np.ones_like(x)], 1)
            self.check(generators.pinhole(*given, size=SIZE, pose=POSE), *self.placed(ways))

    def test_orthographic_and_equirectangular(self):
        x, y = pixels()
        offsets = np.stack([(x / SIZE[0] - 0.5) * 12.5, (0.5 - y / SIZE[1]) * 7.5, 0 * x], 1)
        self.check(generators.orthographic((12.5, 7.5), size=SIZE, pose=POSE[:3]),
                   *self.placed(np.broadcast_to([0, 0, -1.0], offsets.shape), offsets))
        a, e = (x / SIZE[0] - 0.5) * 2 * np.pi, (0.5 - y / SIZE[1]) * np.pi
        ways = np.stack([np.cos(e) * np.sin(a), np.sin(e), -np.cos(e) * np.cos(a)], 1)
        self.check(generators.equirectangular(size=SIZE, pose=POSE), *self.placed(ways))

    def test_a_lidar_has_channels_by_azimuths(self):
        elevations, offsets = np.array([-10, 0, 20.0]), np.array([1, 0, -2.0])
        places = np.array([[0.5, 0.25, 0], [0, 0, 0], [0, -0.5, 1]])
        head = np.radians(-60 + 180 * np.arange(100) / 100)[None]
        a, e = head + np.radians(offsets)[:, None], np.radians(elevations)[:, None] + 0 * head
        ways = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
        px, py, pz = (places[:, i, None] for i in range(3))
        turned = np.stack([px * np.cos(head) - py * np.sin(head),
                           px * np.sin(head) + py * np.cos(head), pz + 0 * head], -1)
        self.check(generators.lidar(elevations, (-60, 120, 100), azimuth_offsets=offsets,
                                    origin_offsets=places, pose=POSE),
                   *self.placed(ways.reshape(-1, 3), turned.reshape(-1, 3)))
        # Free lists of angles, also clockwise, and more channels than a text has.
        for up, around in ((elevations, np.array([30, -5, -90.5, 720])), (np.linspace(-80, 80, 600), np.array([7.5])),
                           (np.linspace(-80, 80, 600), (0, 360, 2))):
            a = np.radians(around if isinstance(around, np.ndarray) else np.array([0, 180]))[None]
            e = np.radians(up)[:, None] + 0 * a
            ways = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)
            made = generators.lidar(up, around, pose=POSE)
            self.check(made, *self.placed(ways))
            np.testing.assert_array_equal(made.ring, np.arange(len(up)).repeat(a.size))
        made = generators.lidar(elevations, (0, 360, 5))
        np.testing.assert_array_equal(made.ring, np.arange(3).repeat(5))
        np.testing.assert_array_equal(made.part(7, 4).ring, made.ring[7:11])
        seen = self.woods.trace(made.part(7, 4), fields=("t", "ring"))
        np.testing.assert_array_equal(seen["ring"], made.ring[7:11])
        # Without any place its pose is the identity, and with a look-at it stands as a camera does.
        for pose in (None, np.eye(3, 4)):
            origins, ways = self.made(generators.lidar([0], (0, 360, 4), pose=pose))
            np.testing.assert_allclose(origins, 0)
            np.testing.assert_allclose(ways, [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]],
                                       atol=ULP)
        origins, ways = self.made(generators.lidar([0], (0, 360, 4),
                                                   look_at=([1, 2, 3], [1, 2, 0])))
        np.testing.assert_allclose(origins, [[1, 2, 3]] * 4, atol=ULP)
        np.testing.assert_allclose(ways, [[0, 0, -1], [-1, 0, 0], [0, 0, 1], [1, 0, 0]], atol=ULP)

    def test_generated_rays_have_the_answers_of_the_same_rays_sent(self):
        points = np.random.default_rng(3).uniform(-10, 10, (30, 3)) + [0, 12, 0]
        for generator in (generators.camera(size=(203, 117)),
                          generators.camera(camera="canopy", fov=30, size=(80, 60), tmin=3),
                          generators.camera(camera=1, size=(40, 30), tmax=40),
                          generators.lidar([-20, 0, 9], pose=POSE, tmin=0.5, tmax=30),
                          generators.hemisphere(points, [0, 1, 0], samples=500, seed=7)):
            for kind, fields in (("closest", ("t", "path")), ("any", ("hit",)),
                                 ("multi", ("t", "path")), ("all", ("t", "path"))):
                made = self.woods.trace(generator, kind=kind,
                                        fields=(*fields, "origin", "direction"))
                rays = np.empty((generator.count, 8), np.float32)
                rays[:, :3], rays[:, 4:7] = made.pop("origin"), made.pop("direction")
                limits = generator._sensor
                rays[:, 3], rays[:, 7] = limits.get("tmin", 0), limits.get("tmax", np.inf)
                self.same(made, self.woods.trace(rays, kind=kind, fields=fields))
            self.assertGreater(len(made["t"]), 10)

    def test_a_stream_of_generators_counts_on(self):
        a, b = generators.camera(size=(300, 200)), generators.lidar([-9, 5], pose=POSE)
        whole = np.concatenate([self.woods.trace(each)["t"] for each in (a, b)])
        seen = np.full(len(whole), np.nan, np.float32)
        for first, columns in self.woods.stream(iter([a, b]), fields=("t",)):
            seen[first:first + len(columns["t"])] = columns["t"]
        np.testing.assert_array_equal(seen, whole)

    def test_an_origin_shifts_what_a_generator_says_of_places(self):
        far = np.array([4e6, 5e6, 100.0])
        scene = self.client.mesh(far + [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], origin=far)
        down = np.eye(4)
        down[:3, 3] = far + [0.25, 0.25, 2]
        for generator in (generators.pinhole(1, size=(1, 1), pose=down),
                          generators.orthographic((1e-3, 1e-3), size=(1, 1), look_at=(
                              down[:3, 3], down[:3, 3] - [0, 0, 1])),
                          generators.hemisphere([down[:3, 3]], [0, 0, -1], samples=1, margin=0)):
            self.assertEqual(self.made(generator, scene)[0].tolist(), [down[:3, 3].tolist()])
        self.assertEqual(scene.trace(generators.pinhole(1, size=(1, 1), pose=down))["t"], [2])

    def test_parts_far_away_keep_their_digits_beside_an_origin(self):
        """In float64 up to the origin, as those of mesh() do; also of a part that stands in several places."""
        far = np.array([500000.3, 5300000.7, 120.45])
        corners, spread = far + np.array([[0, 0, 0], [.3, 0, 0], [0, .3, 0.]]), np.array([[0, 0, 0], [7.25, 0, -3]])
        scene = self.client.scene_of({"tile": (corners, [[0, 1, 2]]), "box": ([[0, 0, 9], [1, 0, 9], [0, 1, 9]], [[0, 1, 2]])},
                                     {"tile": ("tile", spread), "box": ("box", far)}, origin=np.round(far))
        for path, at in (("tile#0", far), ("tile#1", far + spread[1]), ("box", far + [0, 0, 9])):
            above = at + [.1, .1, 2]
            hit = scene.trace([[*above, 0, 0, -1]], fields=("t", "path", "uv"))
            self.assertEqual(scene.path_of(hit["path"]), [path])
            np.testing.assert_allclose(hit["t"], 2, atol=1e-6)
            np.testing.assert_allclose(hit["uv"], [[.1, .1]] if path == "box" else [[1 / 3, 1 / 3]], atol=1e-5)
            self.assertEqual(scene.path_of(scene.trace([[*(at + [.1, .1, 3]), 0, 0, -1]], fields=("path",))["path"]), [path])

    def test_azimuths_may_be_an_array_of_floats(self):
        self.assertEqual(generators.lidar([0, 1], np.array([0.0, 360.0, 2048.0])).count, 4096)
        for count in (2.5, np.inf):
            with self.assertRaisesRegex(raynest.UsageError, "the count of azimuths of"):
                generators.lidar([0], (0, 360, count))

    def test_points_that_are_nowhere_are_named(self):
        points = np.array([[0, 3, 0], [0, 3, 0], [np.nan, 3, 0]])
        with self.assertWarnsRegex(raynest.RayWarning, "first is ray 10, of point 2:"):
            self.woods.trace(generators.hemisphere(points, [0, 1, 0], samples=5),
                             reduce="hit_fraction")
        # A part is told of its own points.
        far = generators.hemisphere([[0, 3, 0], [3e7 + 1.3, 3, 0]], [0, 1, 0], samples=5)
        with self.assertWarnsRegex(raynest.RayWarning, "start so far from the scene's origin"):
            self.woods.trace(far.part(1, 1), reduce="hit_fraction")

    def test_sizes_may_be_any_whole_numbers(self):
        size = np.array([300, 250], np.uint16)
        generator = generators.orthographic((1, 1), size=size)
        self.assertEqual(len(self.woods.trace(generator, fields=("t",))["t"]), 75000)

    def test_the_margin_follows_the_size_of_the_scene_and_not_its_place(self):
        """Sky view factors in a street canyon, at coordinates that float32 holds: (cos a + cos b) / 2."""
        def slab(low, high):
            low, high = np.array(low, float), np.array(high, float)
            corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3)
            return corners * (high - low) + low
        box = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7],
                        [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
        walls = np.concatenate([slab((-18, -2000, 0), (-8, 2000, 12)), slab((8, -2000, 0), (18, 2000, 20))])
        x = np.array([-7, -3, 0, 3, 7.0])
        points = np.stack([x, 0 * x, 0 * x], 1)
        exact = (np.cos(np.arctan2(12, x + 8)) + np.cos(np.arctan2(20, 8 - x))) / 2
        for place in ((0, 0, 0), (1e5, 0, 0), (432000, 5412000, 0)):
            with self.client.mesh(walls + place, np.concatenate([box, box + 8])) as scene:
                rays = generators.hemisphere(points + place, [0, 0, 1], samples=4096)
                seen = 1 - scene.trace(rays, reduce="hit_fraction")["hit_fraction"]
                np.testing.assert_allclose(seen, exact, atol=2e-3)
                start = scene.trace(generators.hemisphere(points + place, [0, 0, 1], samples=1),
                                    fields=("origin",))["origin"]
                np.testing.assert_allclose(start[:, 2], 4000 * 2.0**-20, rtol=0.01)

    def test_accumulated_azimuths_keep_their_digits(self):
        first = self.made(generators.lidar([0], (12.3, 372.3, 8)))[1]
        for turns in (10_000, 1_000_000):
            begin = 360.0 * turns + 12.3
            ways = self.made(generators.lidar([0], (begin, begin + 360, 8)))[1]
            np.testing.assert_allclose(ways, first, atol=2 * ULP)

    def test_a_sensor_that_float32_moves_is_told_of_as_rays_are(self):
        off = np.array([432123.37, 5412345.86, 312.5])
        corners, faces = np.array([[-100, -100, 0], [100, -100, 0], [0, 100, 0.0]]), [[0, 1, 2]]
        far = self.client.mesh(corners + off.round(), faces)
        near = self.client.mesh(corners + off.round(), faces, origin=off.round())
        eye = off + [0, 0, 50]
        pose = np.eye(4)
        pose[:3, 3] = eye
        narrow = lambda value: np.asarray(value, np.float32)
        lidar = lambda **place: generators.lidar([0.0], (0, 360, 4), **place)
        points = lambda at, way: generators.hemisphere(at, way, samples=4, margin=0)
        for scene, make, says in (
                (far, lambda: lidar(pose=pose), "with origin="),
                (far, lambda: lidar(look_at=(eye, off)), "with origin="),
                (far, lambda: points(eye, [0, 0, -1]), "with origin="),
                (near, lambda: lidar(pose=narrow(pose)), "pass the pose as float64"),
                (near, lambda: generators.sweep([0.0], trajectory=([0], narrow([pose[:3]])), end=0), "pass the poses as float64"),
                (near, lambda: lidar(look_at=narrow((eye, off))), "pass the look_at as float64"),
                (near, lambda: points(narrow(eye), [0, 0, -1]), "pass the points as float64"),
                (near, lambda: points(narrow(eye), narrow([0, 0, -1])), "pass the points as float64")):
            with self.assertWarnsRegex(raynest.RayWarning, r"start so far .* float32 moves them .*" + says):
                scene.trace(make(), fields=("t",))
        with self.assertWarnsRegex(raynest.RayWarning, "pass the look_at as float64"):
            near.render(size=(8, 8), look_at=narrow((eye, off)))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for make in (lambda: lidar(pose=pose), lambda: lidar(look_at=(eye, off)),
                         lambda: points(eye, narrow([0, 0, -1]))):
                start = near.trace(make(), fields=("origin",))["origin"][0]
                np.testing.assert_allclose(start, eye, atol=1e-5)
            near.render(size=(8, 8), look_at=(eye, off))
            lone = self.client.mesh(corners, faces)
            lone.trace(lidar(pose=narrow(np.eye(4))), fields=("t",))

    def test_a_lidar_stands_upright_where_a_view_pitches(self):
        ways = self.made(generators.lidar([0], (0, 360, 2), look_at=((0, 0, 2), (5, 0, 0), (0, 0, 1))))[1]
        np.testing.assert_allclose(ways, [[1, 0, 0], [-1, 0, 0]], atol=ULP)

    def test_a_pose_that_scales_or_mirrors_is_refused_by_name(self):
        for scale, says in (((2, 2, 2), "pose: it scales"), ((1, 1, -1), "pose: it mirrors")):
            for make in (lambda pose: generators.lidar([0.0], pose=pose),
                         lambda pose: generators.pinhole(9, pose=pose)):
                with self.assertRaisesRegex(raynest.UsageError, says):
                    self.woods.trace(make(np.diag([*scale, 1.0])))

    def test_a_surface_does_not_hide_the_points_that_lie_on_it(self):
        """Points as a trace gives them, on a level floor, a tilted one, and one far from zero."""
        corners = np.array([[-9, 0, -9], [-9, 0, 9], [9, 0, 9], [9, 0, -9]], float)
        tilt = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
        for floor in (corners + [0, 7, 0], corners @ tilt.T, corners @ tilt.T + [900, 300, 1000]):
            with self.client.mesh(floor, [[0, 1, 2], [0, 2, 3]]) as scene:
                place = np.random.default_rng(2).uniform(-5, 5, (500, 3)) + floor.mean(0)
                seen = scene.trace(place + [0, 50, 0], [0, -1, 0], fields=("hit", "position", "ng"))
                points, ng = seen["position"][seen["hit"]], seen["ng"][seen["hit"]]
                rays = generators.hemisphere(points, ng, samples=64)
                self.assertEqual(scene.trace(rays, reduce="hit_fraction")["hit_fraction"].max(), 0)
                rays = generators.hemisphere(points, ng, samples=64, margin=0.25)
                self.assertTrue(np.allclose(scene.trace(rays, fields=("origin",))["origin"][::64],
                                            points + 0.25 * ng, atol=1e-3))
        for margin in (-1, np.inf):
            with self.assertRaisesRegex(raynest.Error, "margin"):
                self.woods.trace(generators.hemisphere([0, 3, 0], [0, 1, 0], margin=margin))

    def test_the_share_of_rays_that_hit(self):
        points = np.random.default_rng(3).uniform(-10, 10, (50, 3)) + [0, 3, 0]
        for samples in (100, 20_000):
            rays = generators.hemisphere(points, [0, 1, 0], samples=samples, seed=4)
            hit = self.woods.trace(rays, kind="any")["hit"].reshape(50, samples)
            got = self.woods.trace(rays, reduce="hit_fraction")
            self.assertEqual(list(got), ["hit_fraction"])
            np.testing.assert_array_equal(got["hit_fraction"], hit.mean(1).astype(np.float32))
            self.assertGreater(len(set(hit.mean(1))), 5)
        self.assertEqual(self.client.outcome["rays"], 50 * 20_000)
        first, again, other = (self.made(generators.hemisphere(points, [0, 1, 0], seed=seed))[1]
                               for seed in (1, 1, 2**64 - 1))
        self.assertTrue((first == again).all() and (first != other).any())
        none = generators.hemisphere(points[:0], points[:0])
        self.assertEqual(len(self.woods.trace(none, reduce="hit_fraction")["hit_fraction"]), 0)

    def test_how_many_rays_see_each_path_first(self):
        sent = np.zeros((30000, 6))
        sent[:, :3] = np.random.default_rng(1).uniform(-50, 50, (30000, 3))
        sent[:, 1], sent[:, 4] = 60, -1
        for rays in (generators.camera(size=(203, 117)), sent):
            path = self.woods.trace(rays, fields=("path",))["path"]
            paths, counts = np.unique(path[path != 2**64 - 1], return_counts=True)
            got = self.woods.trace(rays, reduce="visible_pixels")
            self.same(got, {"path": paths, "pixels": counts.astype(np.uint32)})
            self.assertGreater(len(paths), 5)
        up = generators.orthographic((1, 1), size=(8, 8),
                                     look_at=([0, 90, 0], [0, 99, 0], [1, 0, 0]))
        nothing = self.woods.trace(up, reduce="visible_pixels")
        self.same(nothing, {"path": np.zeros(0, np.uint64), "pixels": np.zeros(0, np.uint32)})

    def test_what_cannot_be_made_or_reduced_is_said(self):
        camera = generators.camera(size=(8, 8))
        for says, call in (
                ("hit_fraction, visible_pixels", lambda: self.woods.trace(camera, reduce="sum")),
                ("hemisphere", lambda: self.woods.trace(camera, reduce="hit_fraction")),
                ("name no fields", lambda: self.woods.trace(camera, reduce="visible_pixels",
                                                            fields=("t",))),
                ("pass no others", lambda: self.woods.trace(camera, [0, 0, 1])),
                ("fx and fy above 0", lambda: self.woods.trace(generators.pinhole(0))),
                ("unheard", lambda: self.woods.trace(generators.camera(camera="unheard"))),
                ("pinhole", lambda: generators.camera(pose=POSE)),
                ("3, 4", lambda: generators.pinhole(9, pose=np.eye(3))),
                ("0 0 0 1", lambda: generators.pinhole(9, pose=2 * POSE)),
                ("pose", lambda: self.woods.trace(generators.pinhole(9, pose=1e200 * POSE[:3]))),
                ("tmin < tmax", lambda: generators.lidar([0], tmin=2, tmax=1)),
                ("tmin < tmax", lambda: generators.camera(tmax=1e-60)),
                ("tmin < tmax", lambda: generators.hemisphere([0, 0, 0], [0, 0, 1], tmax=1e-60)),
                ("tmin < tmax, in float32", lambda: generators.camera(tmin=1, tmax=1 + 1e-12)),
                ("tmax must be numbers", lambda: generators.camera(tmax="far")),
                ("fov of 1e-60", lambda: self.woods.trace(generators.camera(fov=1e-60))),
                ("start, stop, count", lambda: generators.lidar([0], (0, 360))),
                ("start, stop, count", lambda: generators.lidar([0], 360)),
                ("as a tuple", lambda: generators.sweep([0], [0, 360, 512], trajectory=([0, 1], np.tile(np.eye(4), (2, 1, 1))))),
                ("azimuths must be finite", lambda: generators.lidar([0], (0, math.inf, 8))),
                ("elevations must be numbers", lambda: generators.lidar("up")),
                ("pose must be numbers", lambda: generators.pinhole(9, pose="up")),
                ("width, height", lambda: generators.orthographic(5)),
                ("elevations of shape", lambda: generators.lidar([])),
                *(("elevations must lie between -90 and 90 degrees", call) for call in (
                    lambda: generators.lidar([0, 91]), lambda: generators.lidar([-90.5], np.arange(9)),
                    lambda: generators.sweep([91], trajectory=([0], [np.eye(4)])),
                    lambda: raynest.sweeps.lidar([91], trajectory=([0], [np.eye(4)])))),
                ("elevations", lambda: generators.lidar(np.zeros(4097))),
                ("whose angles are a list goes without look_at", lambda: generators.lidar([0, 1], np.arange(9), azimuth_offsets=[1, 2], look_at=([0, 0, 1], [1, 0, 0]))),
                ("azimuths", lambda: generators.lidar([0], (0, 360, 65537))),
                ("elevations", lambda: generators.lidar([0, 1], azimuth_offsets=[1])),
                ("origin_offsets", lambda: generators.lidar([0], origin_offsets=[1])),
                ("samples", lambda: generators.hemisphere([0, 0, 0], [0, 0, 1], samples=0)),
                ("shape", lambda: generators.hemisphere(np.zeros((2, 3)), np.zeros((3, 3)))),
                ("a side of size of 0: .* from 1 to 16384",
                 lambda: generators.equirectangular(size=(0, 5))),
                ("picture_pixels_max", lambda: generators.camera(size=(16384, 16384))),
                ("pose and look_at", lambda: generators.lidar([0], pose=POSE, look_at=(
                    [0, 0, 0], [0, 0, 1]))),
                ("camera and look_at", lambda: generators.camera(camera=1, look_at=(
                    [0, 0, 0], [0, 0, 1]))),
                ("camera and look_at", lambda: self.woods.render(camera=1, look_at=(
                    [0, 0, 0], [0, 0, 1])))):
            with self.assertRaisesRegex(raynest.UsageError, says):
                call()
        with self.assertRaisesRegex(TypeError, "has no argument unheard. It has .*pose, camera"):
            generators.lidar([0], unheard=1)


class Kinds(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        corners = np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]])
        layers = corners + np.arange(300)[:, None, None] * [0, 0, 1]
        cls.stack = cls.client.mesh(layers.reshape(-1, 3), np.arange(900).reshape(-1, 3))

    def test_all_hits_come_in_order_of_t(self):
        starts = np.zeros((20000, 3))
        starts[:, 2] = np.random.default_rng(2).uniform(-1, 300, 20000)
        hits = self.stack.trace(starts, [0, 0, 1], kind="all", fields=("t", "flags"))
        want = [np.arange(max(0, np.ceil(z)), 300) - z for z in starts[:, 2]]
        self.assertEqual(np.diff(hits["ray_splits"]).tolist(), [len(t) for t in want])
        np.testing.assert_allclose(hits["t"], np.concatenate(want), atol=1e-4)
        self.assertFalse(hits["flags"].any())
        self.assertEqual(self.client.outcome["truncated"], 0)

    def test_a_ray_over_its_budget_keeps_the_nearest_and_is_counted(self):
        starts = np.zeros((300, 3))
        starts[:, 2] = np.arange(300) - 0.5
        hits = self.stack.trace(starts, [0, 0, 1], kind="all", max_hits=100, fields=("t", "flags"))
        whole = 300 - np.arange(300)
        self.assertEqual(np.diff(hits["ray_splits"]).tolist(), np.minimum(whole, 100).tolist())
        self.assertEqual(hits["flags"].tolist(), (2 * (whole > 100)).tolist())
        self.assertEqual(self.client.outcome["truncated"], 200)
        np.testing.assert_allclose(hits["t"][hits["ray_splits"][:-1].astype(int)], 0.5, atol=1e-4)
        pieces = {first: columns for first, columns in self.stack.stream(
            starts, [0, 0, 1], kind="all", max_hits=100, fields=("t",))}
        np.testing.assert_array_equal(
            np.concatenate([pieces[first]["t"] for first in sorted(pieces)]), hits["t"])

    def test_null_answers_misses(self):
        hits = self.stack.trace([[0, 0, -1, 0, 0, 1]] * 9, kind="null", fields=("t", "prim", "hit"))
        self.assertTrue(np.isinf(hits["t"]).all() and (hits["prim"] == 2**32 - 1).all())
        self.assertFalse(hits["hit"].any())

    def test_parts_are_rows_of_the_whole(self):
        fields = ("t", "path", "origin", "direction", "total")
        points = np.random.default_rng(5).uniform(-20, 20, (40, 3))
        for whole in (generators.camera(size=(203, 97)), generators.equirectangular(size=(64, 33), look_at=((0, 9, 0), (1, 9, 0))),
                      generators.orthographic((40, 40), size=(50, 50), look_at=((0, 60, 0), (0, 0, 0), (1, 0, 0))),
                      generators.lidar([-9, -5, 0, 5], (0, 360, 1000), look_at=((0, 9, 0), (1, 9, 0))),
                      generators.hemisphere(points, np.broadcast_to([0, 1, 0], points.shape), samples=30, seed=3)):
            columns = self.woods.trace(whole, fields=fields)
            count = len(points) if "hemisphere" in repr(whole) else whole.count
            each = whole.count // count
            for first, rows in ((0, count), (0, 1), (count - 1, 1), (count // 3, count // 2), (count // 5, 8)):
                part = whole.part(first, rows)
                self.assertEqual(part.count, rows * each)
                self.same(self.woods.trace(part, fields=fields), {
                    name: column[first * each:(first + rows) * each] for name, column in columns.items()})
            within = whole.part(count // 4, count // 2).part(3, 2)
            self.same(self.woods.trace(within, fields=("t",)), {
                "t": columns["t"][(count // 4 + 3) * each:(count // 4 + 5) * each]})
            for first, rows in ((count, 1), (-1, 1), (0, 0), (1, count)):
                with self.assertRaises(raynest.UsageError):
                    whole.part(first, rows)
        # The daemon checks it too.
        beyond = generators.camera(size=(10, 10)).part(50, 50)
        beyond._part = (51, 50)
        with self.assertRaisesRegex(raynest.UsageError, "part: rays 51 to 101, but the generator makes 100"):
            self.woods.trace(beyond)


if __name__ == "__main__":
    main()
