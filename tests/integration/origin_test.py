#!/usr/bin/env python3
"""Tests scenes far from zero, queried in world coordinates from the command line and from Python;
and invalid rays.

  origin_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import re
import sys
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from raynest import generators
from raynest._requests.gltf import mesh_glb
from daemon import DaemonTest, main

FAR = np.array([5e5, 4.5e6, 100.0])
# A square of 20 cm, with corners that float32 cannot distinguish at that distance.
SQUARE = FAR + [[0.1, 0.1, 0], [0.3, 0.1, 0], [0.3, 0.3, 0], [0.1, 0.3, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]
ABOVE = FAR + [0.2, 0.25, 1]
DOWN = [0, 0, -1]


def words(*numbers):
    return ",".join(repr(float(x)) for x in np.ravel(numbers))


class Origin(DaemonTest):
    def setUp(self):
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)

    def test_a_mesh_from_python_is_hit_by_the_command_line(self):
        self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        ray = words(ABOVE, DOWN)
        line = self.client.json("query", "square", "--ray", ray, "--fields", "t,prim,position")
        hit, = line["hits"]
        self.assertEqual((hit["t"], hit["prim"]), (1, 1))
        np.testing.assert_allclose(hit["position"], ABOVE + DOWN, rtol=0, atol=1e-7)

        info = self.client.json("info", "square")
        self.assertEqual(info["origin"], FAR.tolist())
        np.testing.assert_allclose(info["box_min"], SQUARE[0], rtol=0, atol=1e-6)
        np.testing.assert_allclose(info["box_max"], SQUARE[2], rtol=0, atol=1e-6)
        told = self.python.scene("square").info
        for key in ("origin", "box_min", "box_max"):
            np.testing.assert_allclose(told[key], info[key], rtol=0, atol=1e-7)

    def test_a_file_from_the_command_line_is_hit_by_python(self):
        points = np.array([[*(FAR + [0.2, 0.2, 0]), 0.05], [*(FAR + [9.5, 0, 0]), 0.5]])
        np.save(self.out / "points.npy", points)
        self.client.json("load", self.out / "points.npy", "--primitive", "sphere", "--name", "balls",
                         "--origin", words(FAR))
        scene = self.python.scene("balls")
        self.assertEqual(scene.origin.tolist(), FAR.tolist())
        # Origins and directions in each form: (N, 6), (N, 8) and float32 directions from one point.
        start = FAR + [0.2, 0.2, 1]
        for rays in ((start, [DOWN]), ([[*start, *DOWN]],), ([[*start, 0, *DOWN, 9]],),
                     (start, np.array([DOWN], np.float32))):
            hit = scene.trace(*rays, fields=("t", "position"))
            np.testing.assert_allclose(hit["t"], 0.95, atol=1e-6)
            self.assertEqual(hit["position"].dtype, np.float64)
            np.testing.assert_allclose(hit["position"], [FAR + [0.2, 0.2, 0.05]], atol=1e-6)
        self.assertTrue(scene.occluded(start, start - [0, 0, 2])[0])
        # The position of a miss is 0, and only requested columns come.
        miss = scene.trace([[*start, 0, 0, 1]], fields=("position",))
        self.assertEqual((list(miss), miss["position"].tolist()), (["position"], [[0, 0, 0]]))
        (_, piece), = scene.stream([[*start, *DOWN]], fields=("position",))
        np.testing.assert_allclose(piece["position"], [FAR + [0.2, 0.2, 0.05]], atol=1e-6)

    def test_files_of_rays_and_columns_are_in_the_world(self):
        self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        hits = self.out / "hits.npz"
        for name, rays, more in (("six", [[*ABOVE, *DOWN]], ()),
                                 ("eight", [[*ABOVE, 0, *DOWN, 5]], ()),
                                 ("three", [DOWN], ("--from", words(ABOVE)))):
            np.save(self.out / f"{name}.npy", np.array(rays))
            done = self.client.run("query", "square", "--rays", self.out / f"{name}.npy", *more,
                                   "--fields", "t,position", "-o", hits)
            self.assertEqual(done.returncode, 0, done.stderr)
            with np.load(hits) as columns:
                self.assertEqual(sorted(columns), ["position", "t"])
                self.assertEqual(columns["position"].dtype, np.float64)
                np.testing.assert_allclose(columns["position"], [ABOVE + DOWN], atol=1e-7)

    def test_generators_and_cameras_stand_in_the_world(self):
        scene = self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        pose = np.column_stack([np.eye(3), ABOVE])
        for place in ({"pose": pose}, {"look_at": (ABOVE, ABOVE + DOWN)}):
            seen = scene.trace(generators.pinhole(9, size=(3, 3), **place),
                               fields=("t", "origin", "position"))
            self.assertEqual(seen["t"][4], 1)
            np.testing.assert_allclose(seen["origin"], [ABOVE] * 9, atol=1e-6)
            np.testing.assert_allclose(seen["position"][4], ABOVE + DOWN, atol=1e-6)
        look_at = words(ABOVE, ABOVE + DOWN)
        for place in ("pose=" + words(pose), "lookat=" + look_at):
            done = self.client.run("--json", "query", "square", "--generate", "pinhole", "size=3x3",
                                   "fx=9", place)
            self.assertEqual(json.loads(done.stdout.splitlines()[4])["hits"][0]["t"], 1)
        # Without a pose a sensor is at the world's zero, not at the scene's.
        lidar = scene.trace(generators.lidar([0], (0, 360, 4)), fields=("origin",))
        np.testing.assert_allclose(lidar["origin"], 0, atol=0.5)
        by_python = scene.render(look_at=(ABOVE, ABOVE + DOWN), size=(8, 8))
        picture = self.out / "picture.npy"
        done = self.client.run("render", "square", "--lookat", look_at, "--size", "8x8", "-o",
                               picture)
        self.assertEqual(done.returncode, 0, done.stderr)
        np.testing.assert_array_equal(np.load(picture), by_python)
        self.assertGreater(by_python[..., 3].max(), 0)

    def test_detached_answers_are_in_the_world(self):
        scene = self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        job = scene.trace([[*ABOVE, *DOWN]], fields=("t", "position"), detach=True).wait()
        np.testing.assert_allclose(job.fetch()["position"], [ABOVE + DOWN], atol=1e-7)
        hits = self.out / "fetched.npz"
        done = self.client.run("fetch", job.number, "-o", hits)
        self.assertEqual(done.returncode, 0, done.stderr)
        with np.load(hits) as columns:
            np.testing.assert_allclose(columns["position"], [ABOVE + DOWN], atol=1e-7)
        with self.assertRaisesRegex(raynest.UsageError, "answers in world coordinates"):
            scene.trace([[*ABOVE, *DOWN]], origin=(0, 0, 0), detach=True)

    def test_fetched_answers_are_those_of_the_call(self):
        scene = self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        rays = np.array([[*ABOVE, *DOWN], [*ABOVE, 0, 0, 1]])
        np.save(self.out / "rays.npy", rays)
        attached = scene.trace(rays, fields=("t", "position"))
        self.assertEqual(attached["position"][1].tolist(), [0, 0, 0])
        by_python = scene.trace(rays, fields=("t", "position"), detach=True).wait().number
        words = ("query", "square", "--rays", self.out / "rays.npy", "--fields", "t,position")
        for named in ((), ("-o", "any.npz")):
            by_shell = self.client.run(*words, "--detach", *named)
            self.assertEqual(by_shell.returncode, 0, by_shell.stderr)
            for number in (by_python, int(by_shell.stdout)):
                fetched = self.python.job(number).wait().fetch()
                self.assertEqual(list(fetched), list(attached))
                for name, column in attached.items():
                    np.testing.assert_array_equal(fetched[name], column)
                done = self.client.run("fetch", number, "-o", self.out / "f.npz")
                self.assertEqual(done.returncode, 0, done.stderr)
                with np.load(self.out / "f.npz") as columns:
                    self.assertEqual(sorted(columns), ["position", "t"])
                    np.testing.assert_array_equal(columns["position"], attached["position"])
            rows = self.client.run("--json", "fetch", int(by_shell.stdout)).stdout.splitlines()
            self.assertEqual([len(json.loads(row)["hits"]) for row in rows], [1, 0])
            self.assertEqual(rows, self.client.run("--json", *words).stdout.splitlines())

    def test_float32_rays_of_a_far_scene_are_warned_of(self):
        scene = self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        ray = np.array([[*ABOVE, *DOWN]])
        np.save(self.out / "coarse.npy", ray.astype(np.float32))
        np.save(self.out / "fine.npy", ray)
        says = r"1 of 1 rays? starts? so far .* float32 moves \w+ by up to 0\.25, .* as float64"
        coarse = ray.astype(np.float32)
        for call in (lambda: scene.trace(coarse),
                     lambda: scene.trace(coarse[:, :3], [DOWN]),
                     lambda: scene.trace(coarse[0, :3], [DOWN]),
                     lambda: list(scene.stream(coarse)),
                     lambda: scene.occluded(coarse[:, :3], coarse[:, :3] - np.float32(1)),
                     lambda: scene.occluded(coarse[:, :3], coarse[:, :3] - np.float32(1),
                                            margin_distance=0.1)):
            with self.assertWarnsRegex(raynest.RayWarning, says):
                call()
        for name in ("coarse", "fine"):
            done = self.client.run("query", "square", "--rays", self.out / f"{name}.npy")
            self.assertEqual((done.returncode, bool(re.search(says, done.stderr))),
                             (0, name == "coarse"))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene.trace(ray)
            self.python.mesh(SQUARE - FAR, FACES, "near").trace(coarse)

    def test_light_of_a_far_scene_is_warned_of(self):
        """Exact in float32, so that only rays between surfaces lose their place."""
        corners = np.array([1e5, 1e5, 1e5]) + [[0, 0, 0], [2, 0, 0], [2, 0, 2], [0, 0, 2]]
        self.python.mesh(corners, FACES, "plate")
        out = ("--size", "16x9", "--spp", "1", "-o", self.out / "plate.exr")
        for integrator in ("ao", "direct", "path"):
            notes = " ".join(self.client.json("render", "plate", "--integrator", integrator, *out)["notes"])
            self.assertIn("light starts beside the surfaces that it leaves", notes)
            self.assertIn("for example --origin 100000,100000,100000", notes)
        with self.assertWarnsRegex(raynest.RayWarning, "light starts beside"):
            self.python.scene("plate").render(integrator="path", spp=1, size=(16, 9))
        self.python.mesh(corners, FACES, "near plate", origin=(1e5, 1e5, 1e5))
        paths = {name: self.client.run("explain", name, "--integrator", "ao", "--pixel", "8,4", "--size", "16x9").stderr
                 for name in ("plate", "near plate")}
        self.assertIn("light starts beside the surfaces that it leaves", paths["plate"])
        self.assertEqual(paths["near plate"].count("light starts"), 0)
        with self.assertWarnsRegex(raynest.RayWarning, "light starts beside"):
            self.python.scene("plate").explain(pixel=(8, 4), size=(16, 9), integrator="ao")
        self.assertNotIn("light starts", " ".join(self.client.json("render", "near plate", "--integrator", "path", *out)["notes"]))

    def test_rays_that_lose_digits_on_their_way_are_counted(self):
        """Counts rays, names the first, and says what helps: the scene's origin where the scene is
        far, a nearer start where only the rays are."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.python.mesh((SQUARE - FAR) * 100 + FAR, FACES, "afar")
            self.python.mesh(SQUARE - FAR, FACES, "near")
        rays = np.tile([0.2, 0.1, 1, *DOWN], (4, 1))
        rays[2:, :3] += FAR + 1 / 3
        np.save(self.out / "rays.npy", rays)
        np.save(self.out / "rays32.npy", rays.astype(np.float32))
        moved = r"2 of 4 rays start so far .* moves them by up to 0\.0667, .* the first is ray 2\. "
        for scene, cli, python in (
                ("afar", "load the scene with --origin 500000,4500000,100$",
                 r"load the scene with origin=\(500000\.0, 4500000\.0, 100\.0\)$"),
                ("near", "start them nearer to the scene$", "start them nearer to the scene$")):
            by_python = self.python.scene(scene)
            for call in (by_python.trace, lambda rays: list(by_python.stream(rays)),
                         lambda rays: by_python.trace(rays[:, :3], rays[:, 3:]),
                         lambda rays: by_python.trace(rays, detach=True)):
                with self.assertWarnsRegex(raynest.RayWarning, moved + "To keep their digits " + python):
                    call(rays)
            done = self.client.run("query", scene, "--rays", self.out / "rays.npy")
            self.assertRegex(done.stderr, moved + "To keep their digits " + cli)
            done = self.client.run("query", scene, "--ray", words(rays[3]))
            self.assertRegex(done.stderr, "1 of 1 ray starts so far .*" + cli)
        with self.assertWarnsRegex(raynest.RayWarning, r"100\.0\) and pass the rays as float64$"):
            self.python.scene("afar").trace(rays.astype(np.float32))
        done = self.client.run("query", "afar", "--rays", self.out / "rays32.npy")
        self.assertRegex(done.stderr, "4500000,100 and save the rays as float64$")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.python.scene("near").trace(rays.astype(np.float32))
            self.python.scene("afar").trace(rays[:2])
        self.assertEqual(self.client.run("query", "near", "--rays", self.out / "rays32.npy").stderr, "")

    def test_a_sensor_that_loses_digits_on_its_way_is_told_of(self):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.python.mesh((SQUARE - FAR) * 100 + FAR, FACES, "afar")
            self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        place = ABOVE + 1 / 3
        for words_of in (lambda at: "lookat=" + words(at, at + DOWN),
                         lambda at: "pose=" + words(np.column_stack([np.eye(3), at]))):
            asked = ("--generate", "pinhole", "size=1x1", "fx=9", words_of(place))
            done = self.client.run("query", "afar", *asked)
            self.assertRegex(done.stderr, "the sensor stands so far .* moves it by up to 0.0*[1-9].* its digits load "
                             "the scene with --origin 500000,4500000,100$")
            self.assertEqual(self.client.run("query", "square", *asked).stderr, "")

    def test_a_scene_that_moves_takes_its_clients_along(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene = self.python.mesh(SQUARE, FACES, "moving", origin=FAR)
            other = raynest.connect(self.daemon.uri)
            self.addCleanup(other.close)
            other.mesh(SQUARE - FAR, FACES, "moving", replace=True)
            near = ABOVE - FAR
            self.assertEqual(scene.trace([[*near, *DOWN]], fields=("t",))["t"][0], 1)
            self.assertEqual(scene.origin.tolist(), [0, 0, 0])
            other.mesh(SQUARE, FACES, "moving", origin=FAR + 1, replace=True)
            hit = list(scene.stream([[*ABOVE, *DOWN]], fields=("t", "position")))[0][1]
            np.testing.assert_allclose(hit["position"], [ABOVE + DOWN], atol=1e-6)

    def test_an_origin_of_a_call_takes_the_place_of_the_scenes(self):
        scene = self.python.mesh(SQUARE, FACES, "square", origin=FAR)
        hit = scene.trace([[*(ABOVE - FAR), *DOWN]], fields=("t", "position"), origin=(0, 0, 0))
        np.testing.assert_allclose(hit["position"], [ABOVE - FAR + DOWN], atol=1e-6)

    def test_what_float32_loses_is_said(self):
        with self.assertWarnsRegex(raynest.SceneWarning, r"moves vertices by up to 0\.\d+ and leaves "
                                   r"2 of 2 triangles .* origin=\(500000\.0, 4500000\.0, 100\.0\)"):
            lost = self.python.mesh((SQUARE - FAR) / 2 + FAR, FACES, "lost")
        self.assertEqual(lost.info["degenerate_triangles"], 2)
        self.assertEqual(lost.info["unique_triangles"], 2)
        np.save(self.out / "far.npy", np.array([[*(FAR + 0.1), 0.05]]))
        done = self.client.run("load", self.out / "far.npy", "--primitive", "sphere")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("for example --origin 500000,4500000,100", done.stdout)
        with self.assertWarnsRegex(raynest.SceneWarning, r"with an origin near it, for example origin=\(500000,4500000,100\)"):
            self.python.load(self.out / "far.npy", "again", primitive="sphere")
        # Vertices and records that were rounded before they came, in a mesh, a .glb and a .npy.
        rough = np.random.default_rng(0).uniform(-10, 10, (300, 3))
        corners = np.arange(300).reshape(-1, 3)
        for origin, remedy in ((None, "as float64, with an origin near them, for example"), (FAR, "as float64$")):
            with self.assertWarnsRegex(raynest.SceneWarning, r"vertices are float32, .* by up to 0\.\d+; .*" + remedy):
                self.python.mesh((rough + FAR).astype(np.float32), corners, origin=origin)
        (self.out / "rough.glb").write_bytes(mesh_glb((rough + FAR).astype(np.float32), corners))
        np.save(self.out / "rough.npy", np.column_stack([rough + FAR, np.ones(300)]).astype(np.float32))
        for origin in (None, FAR):
            for name, options in (("rough.glb", {}), ("rough.npy", {"primitive": "sphere"})):
                with self.assertWarnsRegex(raynest.SceneWarning, "float32 coordinates of the file are so far"):
                    self.python.load(self.out / name, "rough", replace=True, origin=origin, **options)
        # A mesh near zero that its origin carries away.
        (self.out / "local.glb").write_bytes(mesh_glb(rough, corners))
        with self.assertWarnsRegex(raynest.SceneWarning, "rounding to float32 moves the scene's parts by up to 0"):
            self.python.load(self.out / "local.glb", "local", origin=FAR)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.python.load(self.out / "local.glb", "beside")
            # Numbers of few digits are what they say, in float32 as well.
            whole = (rough.round() + FAR).astype(np.float32)
            self.python.mesh(whole, corners)
            (self.out / "whole.glb").write_bytes(mesh_glb(whole, corners))
            self.python.load(self.out / "whole.glb", "whole")
            self.python.mesh(SQUARE, FACES, "kept", origin=FAR)
            self.python.mesh(SQUARE - FAR, FACES, "near")
            # A triangle that never had an area is counted but causes no warning.
            flat = self.python.mesh([[0, 0, 0.1], [1, 1, 0.1], [2, 2, 0.1], [0, 1, 0.1]],
                                    [[0, 1, 2], [0, 1, 3]], "flat")
        self.assertEqual(flat.info["degenerate_triangles"], 1)


class InvalidRays(DaemonTest):
    RAYS = np.array([[0, 50, 0, 0, -1, 0], [0, 50, 0, 0, 0, 0], [np.nan, 0, 0, 0, -1, 0],
                     [1, 50, 0, 0, 1, 0]])

    loads = {"hills": "builtin:terrain?size=8"}

    def test_the_command_line_says_how_many_and_which_is_first(self):
        rays = [word for ray in ("0,50,0,0,-1,0", "0,50,0,0,0,0", "1,50,0,0,1,0",
                                 "nan,50,0,0,-1,0") for word in ("--ray", ray)]
        done = self.client.run("--json", "query", "hills", *rays)
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        self.assertEqual([line.get("invalid") for line in lines], [None, True, None, True])
        self.assertNotIn("flags", lines[1])
        self.assertIn("2 of 4 rays are not valid and count as misses, the first is ray 1", done.stderr)
        summary = self.client.json("query", "hills", *rays, "-o", self.out / "hits.npz")
        self.assertEqual((summary["invalid"], summary["first_invalid"], summary["misses"]),
                         (2, 1, 3))

    def test_python_warns_and_counts_in_every_form(self):
        with raynest.connect(self.daemon.uri) as client:
            hills = client.scene("hills")
            eight = np.insert(self.RAYS, [3, 6], [0, np.inf], axis=1)
            eight[3, 3] = -1
            forms = (((self.RAYS,), 2, 1), ((eight,), 3, 1),
                     (([np.nan, 0, 0], np.ones((5, 3))), 5, 0))
            for kind in ("closest", "any", "multi", "all"):
                for rays, count, first in forms:
                    with self.assertWarnsRegex(raynest.RayWarning,
                                               f"{count} of .* first is ray {first}:"):
                        hills.trace(*rays, kind=kind)
                    self.assertEqual((client.outcome["invalid"], client.outcome["first_invalid"]),
                                     (count, first))
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                hills.trace(self.RAYS[:1])
                self.assertEqual(client.outcome["invalid"], 0)
                hills.trace(np.empty((0, 6)))
                self.assertEqual(client.outcome["invalid"], 0)
                self.assertEqual(hills.occluded([[0, 50, 0]], [[0, 50, 0]]).tolist(), [False])

    def test_many_chunks_and_parts_that_are_traced_again_count_once(self):
        with raynest.connect(self.daemon.uri) as client, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rays = np.tile([0.0, 50, 0, 0, -1, 0], (50_000, 1))
            rays[40_000::1000, 3:] = 0
            rays[123, 0] = np.inf
            for kind in ("closest", "all"):
                client.scene("hills").trace(rays, kind=kind, fields=("flags",))
                self.assertEqual((client.outcome["invalid"], client.outcome["first_invalid"]),
                                 (11, 123))

    def test_a_margin_may_be_a_distance(self):
        with raynest.connect(self.daemon.uri) as client:
            wall = client.mesh([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], [[0, 1, 2]], "wall")
            a, b = [0, 0, 0.5], [[0, 0, -1], [0, 0, -100], [0, 0, 0.4], [0, 0, 0.5]]
            self.assertEqual(wall.occluded(a, b).tolist(), [True, True, False, False])
            self.assertEqual(wall.occluded(a, b, margin_distance=0.4).tolist(),
                             [True, True, False, False])
            self.assertEqual(wall.occluded(a, b, margin_distance=0.6).tolist(),
                             [False, False, False, False])
            for wrong in ({"margin_distance": -1}, {"margin_distance": np.nan},
                          {"margin_distance": 1, "margin": 0.1}):
                with self.assertRaises(raynest.UsageError):
                    wall.occluded(a, b, **wrong)


if __name__ == "__main__":
    main()
