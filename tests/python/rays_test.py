#!/usr/bin/env python3
"""Scene.trace() and occluded() against a real daemon: all kinds, columns and forms of rays,
compared with what the command line answers.

  rays_test.py RAYNESTD RAYNEST FLATC
"""
import warnings

import numpy as np

import raynest
import raynest.returns
import raynest.sweeps
from raynest import generators
from with_daemon import FIELDS, MISS, WithDaemon, main, rain


class Rays(WithDaemon):
    def from_cli(self, rays, *options):
        """Returns the answer of `raynest query` to the same rays."""
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

    def test_splits_count_and_repeat_as_numpy_expects(self):
        hits = self.woods.trace(rain(100), kind="all", fields=("t",))
        counts = np.diff(hits["ray_splits"])
        self.assertEqual(len(np.repeat(np.arange(100), counts)), len(hits["t"]))
        self.assertEqual(np.bincount(counts).sum(), 100)

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
        # So many hits that a frame of rays is traced in parts.
        self.same(self.woods.trace(six, kind="multi", max_hits=256),
                  self.woods.trace(rays, kind="multi", max_hits=256))

    def test_tmin_and_tmax_bound_the_hits(self):
        ray = np.array([[0.3, 60, 0.4, 0, 0, -1, 0, np.inf]], np.float32)
        t = self.woods.trace(ray)["t"][0]
        self.assertTrue(0 < t < 100)
        for tmin, tmax, hit in ((0, t, 1), (0, np.nextafter(t, np.float32(0)), 0), (t, 2 * t, 0)):
            ray[0, 3], ray[0, 7] = tmin, tmax
            found = self.woods.trace(ray, kind="multi", max_hits=1, fields=("t", "hit"))
            self.assertEqual(t in found["t"], bool(hit), (tmin, tmax))

    def test_the_limit_of_kind_all(self):
        """5000 squares, 1 m apart: 4096 hits unless more are asked for, and at most 65536."""
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
        levels = np.arange(5000, dtype=np.float32)
        vertices = (corners + levels[:, None, None] * np.float32([0, 0, 1])).reshape(-1, 3)
        faces = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(5000)[:, None, None]).reshape(-1, 3)
        stack = self.client.mesh(vertices, faces, name="stack")
        ray = [[0.3, 0.1, -1, 0, 0, 1]]
        for asked, found in ((None, 4096), (4095, 4095), (4097, 4097), (65536, 5000)):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                hits = stack.trace(ray, kind="all", max_hits=asked, fields=("t", "flags"))
            np.testing.assert_array_equal(hits["t"], 1 + levels[:found])
            self.assertEqual(hits["flags"].tolist(), [2 if found < 5000 else 0])
            self.assertEqual(["more hits than max_hits" in str(warning.message) for warning in caught], [True] * (found < 5000))
        with self.assertRaisesRegex(raynest.UsageError, "max_hits of 65537: .* from 1 to 65536"):
            stack.trace(ray, kind="all", max_hits=65537)

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
        for origin in ([1e300, 0, 0], [np.nan, 0, 0]):
            self.assertEqual(self.woods.trace(origin, rays[:2, 4:7], fields=("flags",))["flags"].tolist(),
                             [1, 1])

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
        for dtype in (np.uint8, np.int8, np.uint64, np.int64, np.float16, np.float64):
            a, b = np.array([[0, 0, 9]], dtype), np.array([[0, 0, 2]], dtype)
            past = self.client.mesh([[-1, -1, 5], [1, -1, 5], [0, 1, 5]], [[0, 1, 2]])
            self.assertEqual(past.occluded(a, b).tolist(), [True], dtype)
        for margin in (0.5, -1):
            with self.assertRaises(raynest.UsageError):
                wall.occluded([0, 0, 1], ends, margin=margin)

    def test_a_wall_ahead_counts_however_long_the_line(self):
        wall = self.client.mesh([[0.5, -5, -5], [0.5, 5, -5], [0.5, 0, 9.0]], [[0, 1, 2]])
        for length in (10, 1000, 6000, 50_000, 1e6):
            for dtype in (np.float32, np.float64):
                a, b = np.zeros(3, dtype), np.array([length, 0, 0], dtype)
                self.assertTrue(wall.occluded(a, b)[0], (length, dtype))
                self.assertTrue(wall.occluded(b, a, margin_distance=1e-3)[0], (length, dtype))
            self.assertEqual(wall.occluded(a, b, margin=1e-4)[0], length < 5000)
        self.assertTrue(wall.occluded([0.499, 0, 0], [6000, 0, 0])[0])
        # A point of the wall is seen from however far.
        self.assertFalse(wall.occluded(np.random.default_rng(9).uniform(1e5, 1e6, (500, 3)), [0.5, 0, 0]).any())

    def test_points_on_a_surface_do_not_hide_themselves(self):
        """Points of a bumpy ground, small and large, near and far: seen from above, as a trace finds them."""
        side = np.linspace(-1, 1, 40)
        x, z = (axis.ravel() for axis in np.meshgrid(side, side))
        ground = np.stack([x, 0.1 * np.sin(5 * x) * np.cos(4 * z), z], 1)
        i = np.arange(1600).reshape(40, 40)
        a, b, c, d = (part.ravel() for part in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
        faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
        chance = np.random.default_rng(4)
        for size in (0.01, 1, 100, 10_000):
            for place in ((0, 0, 0), (size * 30, size, -size * 50)):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    scene = self.client.mesh(ground * size + place, faces)
                    starts = chance.uniform(-0.9, 0.9, (4000, 3)) * size + place
                    starts[:, 1] = place[1] + size
                    seen = scene.trace(starts, [0, -1.0, 0], fields=("position", "ng"))
                    # To lights above, within 80 degrees of the normal: nothing is between.
                    over = seen["position"] + size * np.array([chance.uniform(-0.3, 0.3), 2, 0.1])
                    hidden = scene.occluded(seen["position"], over)
                    self.assertEqual(np.count_nonzero(hidden), 0, (size, place))
                    self.assertEqual(np.count_nonzero(scene.occluded(over, seen["position"])), 0)

    def test_a_line_that_grazes_the_surface_of_its_end_does_not_meet_it(self):
        """An eye over a plane of many triangles, and over a bowl, in which all points see each other."""
        chance = np.random.default_rng(5)
        i = np.arange(100 * 100).reshape(100, 100)
        faces = np.concatenate([np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], -1).reshape(-1, 3),
                                np.stack([i[:-1, :-1], i[1:, 1:], i[1:, :-1]], -1).reshape(-1, 3)])
        x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, 100), np.linspace(0, 1, 100)))
        for size, place in ((2000, (0, 0, 0)), (2000, (4.5e5, 5.4e6, 300.0)), (1e-3, (0, 0, 0))):
            for form in (0.03 * x + 0.017 * y, (x - 0.5)**2 + (y - 0.5)**2):
                vertices = np.stack([x, y, form], -1) * size + place
                scene = self.client.mesh(vertices, faces, origin=place)
                corners = vertices[faces[chance.integers(0, len(faces), 20000)]]
                on = (corners * chance.dirichlet([1, 1, 1], 20000)[:, :, None]).sum(1)
                eye = vertices[5050] + np.array([0, 0, 0.85e-3]) * size     # a person's height on 2 km
                for a, b in ((eye, on), (on, eye), *([(on, on[::-1])] if form[0] else [])):
                    self.assertEqual(np.count_nonzero(scene.occluded(a, b)), 0, (size, place, form[0]))

    def test_other_surfaces_hide_a_line_that_grazes_that_of_its_end(self):
        """A ground, and a kerb that stands 2 cm out of it: beyond the kerb it is hidden, before it not."""
        ground = [[-500, -500, 0], [500, -500, 0], [500, 500, 0], [-500, 500, 0]]
        kerb = [[100, -500, 0], [100, 500, 0], [100, 500, 0.02], [100, -500, 0.02]]
        scene = self.client.mesh(np.array([*ground, *kerb]) @ [[1, 0, 0.1], [0, 1, 0], [0, 0, 1]],
                                 [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
        places = np.stack([np.linspace(90, 110, 400), np.linspace(-40, 40, 400), np.zeros(400)], -1)
        eye, places = (each @ [[1, 0, 0.1], [0, 1, 0], [0, 0, 1]] for each in (np.array([-400, 0, 0.01]), places))
        for masks in (None, np.full(400, 3)):
            for a, b in ((eye, places), (places, eye)):
                np.testing.assert_array_equal(scene.occluded(a, b, mask=masks), places[:, 0] > 100)

    def test_occluded_warns_of_ends_that_are_nowhere(self):
        wall = self.client.mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]])
        behind = [[0, 0, -1]] * 4
        for nowhere in (np.nan, np.inf, -1e200):
            ends = np.array(behind, np.float64)
            ends[2, 2] = nowhere
            for lost in (ends, np.ma.masked_invalid(ends)):
                for a, b in (([0, 0, 1], lost), (lost, [0, 0, 1])):
                    for margin in ({}, {"margin_distance": 0.1}):
                        with self.assertWarnsRegex(raynest.RayWarning, "^1 of 4 .* first is 2$"):
                            hidden = wall.occluded(a, b, **margin)
                        self.assertEqual(hidden.tolist(), [True, True, False, True])
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a segment of no length is no mistake
            self.assertEqual(wall.occluded([0, 0, 1], [0, 0, 1]).tolist(), [False])

    def test_options_reach_the_daemon(self):
        rays = rain(2000)
        sums = [np.minimum(self.woods.trace(rays, intersector="procedural_mask",
                                            params={"pattern": "discs", "fill": fill})["t"],
                           1000).sum() for fill in (0.1, 0.9)]
        self.assertGreater(sums[0], sums[1])
        self.assertEqual(self.client.outcome["intersector"], "procedural_mask")
        for traversal in ("single", "stream"):
            named = self.woods.trace(rays, traversal=traversal)
            self.assertEqual(self.client.outcome["traversal"], traversal)
            self.same(named, self.woods.trace(rays))
        self.assertEqual(self.client.outcome["rays"], 2000)
        self.assertTrue(np.isinf(self.woods.trace(rays, mask=0)["t"]).all())
        self.woods.trace(rays, priority="low", deadline=30, epoch=1)
        for option, says in (("unheard", "this call has no option unheard. Besides"),
                             ("intersect", "did you mean intersector="), ("tmax", "a range each")):
            with self.assertRaisesRegex(TypeError, says):
                self.woods.trace(rays, **{option: 1})

    def test_names_that_only_the_client_needs_are_columns_of_the_query(self):
        for hidden in ([f"{n}" + 240 * "x" for n in range(240)], ["prim"], ["t", "t"]):
            with self.assertRaisesRegex(raynest.UsageError, "hidden: .* must be one of fields"):
                for _ in self.client.connection.exchange("Query", {"job": {"scene": "woods"}, "fields": ["t"], "hidden": hidden, "generator":
                                                                   {"kind": "camera", "settings": ["size=4x4"]}}):
                    pass
        self.assertGreater(self.client.ping(), 0)

    def test_a_misspelt_argument_is_answered_with_the_nearest(self):
        way = {"trajectory": ([0.0], [np.eye(4)])}
        still = raynest.sweeps.lidar([0], end=0, **way)
        for call, says in ((lambda: self.client.load("builtin:forest", nam="a"), r"load\(\) has no argument nam: did you mean name=\?"),
                           (lambda: self.client.mesh([], vertexes=1), "mesh.* did you mean vertices="), (lambda: raynest.connect(tokn="a"), "token="),
                           (lambda: generators.lidar([0], azimuth=1), "azimuths="), (lambda: generators.pinhole(1, lookat=1), "look_at="),
                           (lambda: generators.sweep([0], step_eror=1, **way), "step_error="), (lambda: raynest.sweeps.lidar([0], ende=1, **way), "end="),
                           (lambda: raynest.returns.measure(self.woods, still, divergenz=1), "divergence="),
                           (lambda: raynest.returns.measure(self.woods, still, hid=1), "hide=")):
            with self.assertRaisesRegex(TypeError, says):
                call()

    def test_tiny_windows_only_cost_time(self):
        rays = rain(60000)
        expected = self.woods.trace(rays, fields=FIELDS)
        for uri in (self.daemon.uri, self.socket):
            with raynest.connect(uri, window_bytes=64 << 10) as narrow:
                scene = narrow.scene("woods")
                self.same(scene.trace(rays, fields=FIELDS), expected)
                self.same(scene.trace(rays[:99], kind="multi", max_hits=256),
                          self.woods.trace(rays[:99], kind="multi", max_hits=256))

    def test_a_window_of_nothing_is_the_default(self):
        rays = rain(60000)
        for window in (0, None):
            with raynest.connect(self.daemon.uri, window_bytes=window) as client:
                self.same(client.scene("woods").trace(rays), self.woods.trace(rays))

    def test_progress_rises_to_the_end(self):
        seen = []
        self.woods.trace(rain(50000), fields=("t",), progress=lambda *news: seen.append(news))
        self.assertEqual(seen[-1], (50000, 50000, "tracing"))
        self.assertEqual(seen, sorted(seen))
        self.assertGreater(len(seen), 2)


if __name__ == "__main__":
    main()
