#!/usr/bin/env python3
"""The forms that arguments may have, and what is said about others.

  forms_test.py RAYNESTD RAYNEST FLATC
"""
import copy
import io

import numpy as np

import raynest
from daemon import Daemon
from raynest import generators
from with_daemon import WithDaemon, main

DOWN = [[8, 50, -8, 0, -1, 0]]
CORNERS = np.eye(3)
FACE = [[0, 1, 2]]
RAY = [[0.2, 0.2, 5, 0, 0, -1]]


class Mesh:
    """Has what a mesh of trimesh has."""

    vertices = CORNERS
    faces = FACE


class Forms(WithDaemon):
    def test_what_is_hidden_may_be_numbers_arrays_and_paths(self):
        plain = self.woods.trace(DOWN, fields=("inst", "t", "path"))
        number = int(plain["inst"][0])
        path = self.woods.path_of(plain["path"])[0]
        other = int(self.woods.trace(DOWN, fields=("inst",), hide=f"inst={number}")["inst"][0])
        self.assertNotEqual(other, number)
        for form in (number, np.uint32(number), [number], {number}, np.array([number, 0]), np.array([[number]]),
                     path.split("/")[0], np.array([f"inst={number}"])):
            with self.subTest(form=form):
                self.assertEqual(self.woods.trace(DOWN, fields=("inst",), hide=form)["inst"][0], other)
                self.assertEqual(self.woods.trace(DOWN, fields=("inst",), only=form)["inst"][0], number)
        for part in (path, [path], np.array([path]), f"path={plain['path'][0]}"):
            with self.subTest(part=part):
                self.assertNotIn(plain["path"][0], self.woods.trace(DOWN, fields=("path",), hide=part)["path"])
                self.same(dict(self.woods.trace(DOWN, fields=("inst", "t", "path"), only=part)), dict(plain))
        for nothing in (None, [], (), np.array([], int)):
            self.assertEqual(self.woods.trace(DOWN, fields=("inst",), hide=nothing)["inst"][0], number)

    def test_a_list_that_came_out_empty_does_not_show_everything(self):
        for nothing in ([], (), set(), np.array([], int)):
            for call in (lambda: self.woods.trace(DOWN, only=nothing), lambda: self.woods.heatmap(size=(8, 8), only=nothing),
                         lambda: self.woods.heatmap(size=(8, 8), diff={"only": nothing})):
                with self.assertRaisesRegex(raynest.UsageError, "only names no part"):
                    call()

    def test_the_number_0_is_an_instance(self):
        ground = [[30, 50, 30, 0, -1, 0]]
        self.assertEqual(self.woods.trace(ground, fields=("inst",))["inst"][0], 0)
        for form in (0, np.array([0]), "inst=0"):
            self.assertNotEqual(self.woods.trace(ground, fields=("inst",), hide=form)["inst"][0], 0)
        picture = self.woods.heatmap(size=(8, 8), hide=0, diff={"hide": [0]})
        self.assertFalse(np.any(picture))

    def test_other_forms_are_told_those_that_there_are(self):
        for wrong in (1.5, True, b"inst=1", {"inst": 1}, [None], [[1]], np.array([1.0]), object()):
            for key in ("hide", "only"):
                with self.subTest(wrong=wrong), \
                        self.assertRaisesRegex(TypeError, f"{key} of .*'inst=3', 'object=2', the text of a path"):
                    self.woods.trace(DOWN, **{key: wrong})
        for wrong, says in (("inst=x", "behind its '='"), (-1, "a whole number from 0"), ("nowhere", "'nowhere'"),
                            ("inst=4294967296", "'inst=4294967296': .* from 0 to 4294967295 "), (2**32, "hide of 4294967296"),
                            ("object=4294967296", "'object=4294967296'"), ("path=" + "9" * 5000, "hide of 'path=99"),
                            (f"path={2**64}", f"'path={2**64}': .* from 0 to {2**64 - 1} ")):
            with self.assertRaisesRegex(raynest.UsageError, says):
                self.woods.trace(DOWN, hide=wrong)

    def test_a_copy_of_a_scene_holds_it_too(self):
        first = self.client.mesh(CORNERS, FACE)
        twin = copy.copy(first)
        del twin
        self.client.mesh(CORNERS * 2, FACE)
        self.assertEqual(first.trace(RAY, fields=("prim",))["prim"][0], 0)
        twin = copy.copy(first)
        name = first.name
        first.close()
        self.assertEqual(twin.trace(RAY, fields=("prim",))["prim"][0], 0)
        np.testing.assert_array_equal(twin.origin, first.origin)
        twin.close()
        self.assertNotIn(name, [scene["name"] for scene in self.client.scenes()])

    def test_whole_numbers_may_be_floats_without_a_fraction(self):
        self.assertEqual(generators.hemisphere([0, 0, 0], [0, 1, 0], samples=1000.0).count, 1000)
        self.assertEqual(generators.lidar([0.0], np.array([0, 360, 8.0])).count, 8)
        for wrong in (1.5, np.nan, np.inf, "3"):
            with self.assertRaisesRegex(raynest.UsageError, "samples of .*whole number"):
                generators.hemisphere([0, 0, 0], [0, 1, 0], samples=wrong)

    def test_messages_name_the_way_out(self):
        sweep = generators.lidar([0.0], (0, 360, 4))
        for call, kind, says in (
                (lambda: self.woods.trace(sweep, tmax=5), TypeError, "a generator takes tmin= and tmax="),
                (lambda: self.woods.trace(DOWN, feilds=("t",)), TypeError, r"did you mean fields=\? Besides its own"),
                (lambda: self.woods.trace(DOWN, intersecter="opaque"), TypeError, "did you mean intersector"),
                (lambda: self.client.load("builtin:forest", "x", masks=3), raynest.UsageError, "dict of patterns"),
                (lambda: self.client.load(b"glTF\2\0\0\0"), TypeError, "write these bytes to a file"),
                (lambda: self.client.load(io.BytesIO(b"glTF")), TypeError, "write what it holds to a file"),
                (lambda: self.client.load(3), TypeError, "type int: it must be a str or a path$"),
                (lambda: self.client.load(b"woods.glb"), TypeError, r"os.fsdecode\(\)"),
                (lambda: self.client.load("scan.laz"), raynest.InvalidError, "laszip"),
                (lambda: self.client.load("SCAN.E57"), raynest.InvalidError, "points have no surface"),
                (lambda: self.client.load("dem.asc"), raynest.InvalidError, "gdal_translate"),
                (lambda: self.client.load("berlin.epw"), raynest.InvalidError, "directions"),
                (lambda: self.client.load("sky.hdr"), raynest.InvalidError, "environment="),
                (lambda: self.client.load("car.fbx"), raynest.InvalidError, "Blender"),
                (lambda: self.client.load("scan.las.gz"), raynest.InvalidError, "is packed; unpack it"),
                (lambda: self.client.load("car.unknown"), raynest.InvalidError, "trimesh"),
                (lambda: self.client.mesh(Mesh()), TypeError, r"pass mesh.vertices and mesh.faces"),
                (lambda: self.client.mesh(CORNERS), TypeError, "vertices and faces"),
                (lambda: self.woods.trace(DOWN, kind="all", max_hits=10**9), raynest.UsageError, "to 65536")):
            with self.subTest(says=says), self.assertRaisesRegex(kind, says):
                call()

    def test_after_a_restart_the_error_says_so(self):
        daemon = Daemon(self.raynestd)
        client = raynest.connect(daemon.uri, reconnect=60)
        self.addCleanup(client.close)
        scene = client.mesh(CORNERS, FACE, "named")
        with self.assertRaises(raynest.InvalidError) as before:
            client.scene("unknown")
        self.assertNotIn("restarted", str(before.exception))
        daemon.stop()
        again = Daemon(self.raynestd, "--listen", daemon.uri)
        self.addCleanup(again.stop)
        with self.assertRaisesRegex(raynest.InvalidError, "the daemon was restarted") as after:
            scene.trace(RAY)
        self.assertEqual(after.exception.name, "SCENE_UNKNOWN")


if __name__ == "__main__":
    main()
