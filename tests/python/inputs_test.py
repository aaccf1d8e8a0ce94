#!/usr/bin/env python3
"""Tests inputs of the Python client: no rays, one ray, masked rays, pipes, file names that are not
UTF-8, and values of wrong types.

  inputs_test.py RAYNESTD RAYNEST FLATC
"""
import ast
import functools
import json
import os
import pathlib
import re
import subprocess
import sys
import types
import warnings
from unittest import mock

import numpy as np

import raynest
from raynest import generators
from raynest._requests import files
from with_daemon import WithDaemon, main

# A triangle as a .gltf of one file: positions (0,0,0) (1,0,0) (0,1,0) in a data URI.
TRIANGLE = json.dumps({
    "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3,
                   "min": [0, 0, 0], "max": [1, 1, 0]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,"
                 "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}).encode()

DOWN = [8, 50, -8, 0, -1, 0]


class Inputs(WithDaemon):
    # ---- rays -----------------------------------------------------------------------------------

    def test_no_rays_have_empty_columns(self):
        for rays in ([], np.empty((0, 6)), np.empty((0, 8), np.float32), ()):
            with self.subTest(rays=rays):
                hits = self.woods.trace(rays, fields=("t", "path", "ng"))
                self.assertEqual({name: column.shape for name, column in hits.items()},
                                 {"t": (0,), "path": (0,), "ng": (0, 3)})
                self.assertEqual((self.client.outcome["rays"], self.client.outcome["misses"]), (0, 0))
        self.assertEqual(self.woods.trace([], [])["t"].shape, (0,))
        self.assertEqual(self.woods.trace([], [0, 1, 0])["t"].shape, (0,))
        self.assertEqual(self.woods.occluded([], []).shape, (0,))
        self.assertEqual(self.woods.trace([], kind="multi")["ray_splits"].tolist(), [0])
        self.assertEqual(list(self.woods.stream([])), [])

    def test_one_ray_may_lack_its_brackets(self):
        one = self.woods.trace(DOWN)
        self.same(one, self.woods.trace([DOWN]))
        bounded = [8, 50, -8, 0, 0, -1, 0, np.inf]
        self.same(one, self.woods.trace(np.array(bounded)))
        with self.assertRaisesRegex(raynest.UsageError, r"shape \(7,\)"):
            self.woods.trace(np.zeros(7))
        with self.assertRaisesRegex(raynest.UsageError, r"shape \(3,\)"):
            self.woods.trace([1, 2, 3])

    def test_lines_of_sight_may_be_a_table(self):
        eyes = np.array([[8, 50, -8], [8, 60, -8], [0, 55, 0]], float)
        ends = np.array([[8, 0, -8], [8, 70, -8]], float)
        table = self.woods.occluded(eyes[:, None], ends[None])
        self.assertEqual(table.shape, (3, 2))
        for i, eye in enumerate(eyes):
            self.assertEqual(table[i].tolist(), self.woods.occluded(eye, ends).tolist())
        self.assertEqual(table[0].tolist(), [True, False])
        self.assertEqual(self.woods.occluded(eyes[:0, None], ends[None]).shape, (0, 2))
        for a, b in ((eyes[:, None], eyes[:, None, :2]), (eyes[:, None], ends[:, None])):
            with self.assertRaisesRegex(raynest.UsageError, "do not fit together"):
                self.woods.occluded(a, b)

    def test_a_single_invalid_ray_is_told_as_one(self):
        with self.assertWarnsRegex(raynest.RayWarning, "ray 1 is not valid and counts as a miss"):
            self.woods.trace([DOWN, [8, 50, -8, 0, 0, 0]])

    def test_a_mesh_must_say_which_triangles_it_has(self):
        points = np.eye(3)
        corners = [[0, 1, 2], [2, 1, 0]]
        for vertices, faces, says in (
                (points, np.ma.array(corners, mask=[[1, 0, 0], [0, 0, 0]]), "some faces are masked"),
                (np.ma.array(points, mask=points > 0), corners, "some vertices are masked"),
                (points, [[1, 2, 3]], "faces go from 1 to 3: .* 3 vertices, counted from 0")):
            with self.assertRaisesRegex(raynest.UsageError, says):
                self.client.mesh(vertices, faces)
        with self.assertRaisesRegex(raynest.UsageError, "origin of .* finite"):
            self.client.mesh(points, corners, origin=[1, 2, np.nan])
        self.client.mesh(np.ma.array(points), corners)  # masks nothing
        ragged = [[0, 0, 0], [1]]
        for make, says in (
                (lambda: self.client.mesh(ragged, corners), "^vertices must be numbers, in rows of one length"),
                (lambda: self.client.mesh(points, ragged), "^faces must be numbers, in rows of one length"),
                (lambda: self.woods.trace([DOWN] * 2, mask=ragged), "^mask must be numbers, in rows of one length"),
                (lambda: self.woods.trace([DOWN] * 2, time=ragged), "^time must be numbers, in rows of one length"),
                (lambda: self.woods.path_of(ragged), "^a path id must be numbers, in rows of one length")):
            with self.subTest(says=says), self.assertRaisesRegex(raynest.UsageError, says):
                make()
        with self.assertWarnsRegex(raynest.SceneWarning, "1 of 1 triangles .* scale it up"):
            self.client.mesh(points * 1e-25, [[0, 1, 2]])

    def test_vertices_that_no_face_uses_do_not_matter(self):
        """Range images mark what they did not see with NaN, and no face uses that."""
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan] * 3])
        with self.client.mesh(corners, [[0, 1, 2]]) as scene:
            self.assertAlmostEqual(scene.trace([0.2, 0.2, 1, 0, 0, -1])["t"][0], 1, places=6)
        with self.assertRaisesRegex(raynest.UsageError, "1 vertices that faces use .* first is 3"):
            self.client.mesh(corners, [[0, 1, 3]])
        far = np.array([[3e5, 5e6, 0], [3e5 + 1.3, 5e6, 0], [3e5, 5e6 + 1.7, 0], [0, 0, 0]])
        with self.assertWarnsRegex(raynest.SceneWarning, "rounding to float32 moves vertices"):
            self.client.mesh(far, [[0, 1, 2]]).close()

    def test_an_empty_scene_is_warned_of(self):
        (self.out / "empty.gltf").write_text('{"asset":{"version":"2.0"}}')
        with self.assertWarnsRegex(raynest.SceneWarning, "is empty: nothing can be hit"):
            self.client.load(self.out / "empty.gltf")

    def test_a_remedy_can_be_pasted(self):
        with self.assertWarnsRegex(raynest.RayWarning, r"take look_at=\(\(.*\), \(.*\)\)") as warned:
            self.woods.render(size=(8, 8), look_at=((0, 0, 8e20), (0, 0, 0)))
        places = re.search(r"look_at=(\(\(.*\)\))", str(warned.warning))[1]
        self.woods.render(size=(8, 8), look_at=ast.literal_eval(places))
        # An origin has few digits, and lies within the mesh's size of it.
        at = np.array([448123.13, 5412345.37, 312.11])
        with self.assertWarnsRegex(raynest.SceneWarning, re.escape("for example origin=(448120.0, 5412350.0, 310.0)")):
            self.client.mesh(at + [[0, 0, 0], [3, 0, 0], [0, 3, 0]], [[0, 1, 2]])

    def test_a_mesh_object_is_for_another_call(self):
        self.assertTrue(callable(raynest.compat.trimesh.RayMeshIntersector))
        mesh = types.SimpleNamespace(vertices=[[0, 0, 0]], faces=[[0, 0, 0]])
        with self.assertRaisesRegex(TypeError, r"Client.mesh\(\)"):
            self.client.load(mesh)

    def test_the_text_of_a_miss_has_the_id_of_one(self):
        paths = self.woods.trace([[0, 1000, 0, 0, 1, 0], [8, 50, -8, 0, -1, 0]])["path"]
        self.assertEqual(self.woods.path_ids(self.woods.path_of(paths)).tolist(), paths.tolist())

    def test_what_is_no_text_is_named(self):
        for call, says in ((lambda: self.woods.path_ids(5), r"path texts of type int: .*path_of\(\)"),
                           (lambda: self.woods.path_ids(b"stand"), "path texts of type bytes"),
                           (lambda: self.woods.export(None), "path of type NoneType")):
            with self.subTest(says), self.assertRaisesRegex(TypeError, says):
                call()
        self.assertEqual(self.woods.path_ids(iter([""])).tolist(), [2**64 - 1])

    def test_what_is_asked_twice_or_of_the_wrong_call_is_said(self):
        for call, says in (
                (lambda: self.woods.trace([DOWN], fields=("t", "t")), "'t' twice"),
                (lambda: list(self.woods.stream([np.array([DOWN])] * 2)), r"pass iter\(blocks\)"),
                (lambda: self.woods.trace([DOWN], detach=True, origin=(0, 0, 0)), "world"),
                (lambda: self.client.load("a.fbx"), "Blender")):
            with self.assertRaisesRegex(raynest.Error, says):
                call()

    def test_truncated_answers_are_warned_of(self):
        with self.assertWarnsRegex(raynest.RayWarning, "1 of 1 rays have more hits than max_hits"):
            self.woods.trace([DOWN], kind="all", max_hits=1)

    def test_addresses_that_are_none_are_said(self):
        for uri, says in (("unix:", "use tcp://HOST:PORT, tls://HOST:PORT, ssh://HOST or unix:PATH"),
                          ("/tmp/x/s", "did you mean unix:/tmp/x/s?")):
            with self.assertRaisesRegex(raynest.UsageError, says):
                raynest.connect(uri)

    def test_masked_rows_are_invalid_rays(self):
        rays = np.array([DOWN] * 4, np.float32)
        for kind in (np.float32, np.float64, np.int32):
            with self.subTest(kind=kind):
                masked = np.ma.array(rays.astype(kind))
                masked[1] = np.ma.masked
                masked[3, 4] = np.ma.masked
                hits = self.woods.trace(masked, fields=("t", "hit", "flags"))
                self.assertEqual((hits["flags"] & 1).tolist(), [0, 1, 0, 1])
                self.assertEqual((hits["hit"].dtype, hits["hit"].tolist()),
                                 (bool, [True, False, True, False]))
        unmasked = np.ma.array(rays)
        self.same(self.woods.trace(unmasked), self.woods.trace(rays))
        origins, ways = np.ma.array(rays[:, :3]), rays[:, 3:]
        origins[2] = np.ma.masked
        flags = self.woods.trace(origins, ways, fields=("flags",))["flags"]
        self.assertEqual((flags & 1).tolist(), [0, 0, 1, 0])

    # ---- files ----------------------------------------------------------------------------------

    def test_a_scene_comes_out_of_a_pipe(self):
        pipe = self.fed("piped.gltf", TRIANGLE)
        self.assertEqual(self.client.load(pipe, replace=True).name, "piped")
        pipe = self.fed("unending", TRIANGLE)
        self.assertEqual(self.client.load(pipe, replace=True).name, "unending")
        (self.out / "scene.json").write_bytes(TRIANGLE)
        self.assertEqual(self.client.load(self.out / "scene.json").name, "scene")
        with self.assertRaisesRegex(raynest.InvalidError, "/dev/zero brought no scene that is known"):
            self.client.load("/dev/zero")
        program = ("import raynest, sys; c = raynest.connect(sys.argv[1])\n"
                   "print(c.load(sys.argv[2], *sys.argv[3:]).info['unique_triangles'])")
        for source in ("-", "/dev/stdin", "/dev/fd/0"):
            done = subprocess.run([sys.executable, "-c", program, self.daemon.uri, source, "three"],
                                  input=TRIANGLE, capture_output=True, check=False)
            self.assertEqual((done.returncode, done.stdout), (0, b"1\n"), done.stderr)
        done = subprocess.run([sys.executable, "-c", program, self.daemon.uri, "-"],
                              input=TRIANGLE, capture_output=True, check=False)
        self.assertIn(b"UsageError: a scene of - has no name of its own: pass name=", done.stderr)

    def test_a_picture_that_leaves_the_folder_is_left_out(self):
        (self.out / "leaf.png").symlink_to("/etc/hostname")
        scene = {**json.loads(TRIANGLE), "images": [{"uri": "leaf.png"}]}
        (self.out / "linked.gltf").write_text(json.dumps(scene))
        with self.assertWarnsRegex(raynest.SceneWarning, "the picture leaf.png: link leaves the folder"):
            self.client.load(self.out / "linked.gltf")

    def test_a_source_that_is_no_scene_says_what_it_is(self):
        (self.out / "folder").mkdir()
        (self.out / "scan.glb.xz").write_bytes(b"\xfd7zXZ")
        (self.out / "empty.glb").write_bytes(b"")
        for source, says in (("folder", "is a folder; name the .glb"),
                             ("scan.glb.xz", "is packed; unpack it"), ("empty.glb", "is empty")):
            with self.assertRaisesRegex(raynest.InvalidError, says):
                self.client.load(self.out / source)
        with self.assertRaisesRegex(raynest.InvalidError, "/dev/null is empty"):
            self.client.load("/dev/null", "x")

    def test_a_pipe_without_an_end_is_refused(self):
        with mock.patch.object(files, "PIPED_BYTES_MAX", 1000):
            with self.assertRaisesRegex(raynest.InvalidError, "goes on after 1000 bytes"):
                files.read_file("/dev/zero", 1 << 40)
            self.assertEqual(len(files.read_file(str(self.fed("thousand", b"x" * 1000)), 1 << 40)), 1000)
        with self.assertRaisesRegex(raynest.InvalidError, "directory"):
            files.read_file(str(self.out), 1000)

    def test_names_need_not_be_utf8(self):
        folder = pathlib.Path(os.fsdecode(os.fsencode(self.out) + b"/caf\xe9"))
        folder.mkdir()
        path = folder / os.fsdecode(b"tr\xe8s.gltf")
        path.write_bytes(TRIANGLE)
        self.assertEqual(self.client.load(path).name, "tr?s")
        self.assertEqual(self.client.load(path, "très").name, "très")

    # ---- types ----------------------------------------------------------------------------------

    def test_wrong_types_are_told_clearly(self):
        for uri in (5, b"tcp://127.0.0.1:31060", pathlib.Path("x")):
            with self.assertRaisesRegex(TypeError, "uri of .*must be a text, as 'tcp://"):
                raynest.connect(uri)
        for source in (b"scene.glb", 5, [1]):
            with self.assertRaisesRegex(TypeError, "source of type .*must be a str or a path"):
                self.client.load(source)
        with self.assertRaisesRegex(TypeError, "instances of type bytes"):
            self.client.load("balls.npy", primitive="sphere", instances=b"places.npy")

    def test_truths_are_no_numbers(self):
        lidar, pose = generators.lidar([0], (0, 360, 4)), np.eye(3, 4)
        lit = {"size": (8, 8), "integrator": "path"}
        still = {"size": (8, 8), "trajectory": ([0.0], [pose])}
        self.assertEqual(len(self.woods.trace(DOWN, skip_hidden_boxes=True)["t"]), 1)
        for yes in (True, np.True_):
            calls = [(name, functools.partial(self.woods.trace, DOWN, **{name: yes}))
                     for name in ("epoch", "time", "mask", "deadline", "animation")]
            calls += [(name, functools.partial(self.woods.render, **lit, **{name: yes}))
                      for name in ("fov", "spp", "seed", "depth", "ao_distance", "environment_rotate", "noise", "exposure")]
            calls += [(name, functools.partial(self.woods.render, **still, **{name: yes})) for name in ("begin", "readout", "step_error")]
            calls += [(name, functools.partial(raynest.returns.measure, self.woods, lidar, **{name: yes}))
                      for name in ("divergence", "footprint", "returns", "resolution", "threshold", "noise", "seed")]
            calls += [("max_hits", lambda: self.woods.trace(DOWN, kind="all", max_hits=yes)),
                      ("margin", lambda: self.woods.occluded([[0, 0, 0]], [[1, 1, 1]], margin=yes)),
                      ("size", lambda: self.woods.render(size=(yes, yes))), ("range", lambda: self.woods.heatmap(size=(8, 8), range=(yes, yes))),
                      ("tile", lambda: self.woods.render(size=(8, 8), tile=(yes, 0, 2, 2))), ("top", lambda: self.woods.blame(top=yes)),
                      ("level", lambda: self.woods.blame(level=yes)), ("pixel", lambda: self.woods.explain(pixel=(yes, 1))),
                      ("steps", lambda: self.woods.explain(pixel=(1, 1), steps=yes)), ("time", lambda: self.woods.info_at(yes)),
                      ("path", lambda: self.woods.path(yes)), ("path", lambda: self.woods.path_of(yes)),
                      ("epoch", lambda: self.woods.path(1, epoch=yes)), ("job", lambda: self.client.job(yes)),
                      ("mask", lambda: self.client.load("builtin:forest?trees=2", "never", masks={"*": yes})),
                      ("mask", lambda: raynest.Place("a", mask=yes)), ("uid", lambda: raynest.Place("a", uid=yes)),
                      ("radii", lambda: raynest.Spheres([[0, 0, 0]], yes)), ("uids", lambda: raynest.Uids(yes)),
                      ("azimuths", lambda: generators.lidar([0], (0, 360, yes))), ("elevations", lambda: generators.lidar([yes])),
                      ("scans", lambda: generators.sweep([0], trajectory=([0.0], [pose]), scans=yes)),
                      ("begin", lambda: raynest.sweeps.lidar([0], begin=yes, trajectory=([0.0], [pose]))),
                      ("size", lambda: generators.camera(size=(yes, yes))), ("tmax", lambda: generators.camera(tmax=yes)),
                      ("samples", lambda: generators.hemisphere([[0, 0, 0]], [0, 1, 0], samples=yes)),
                      ("seed", lambda: generators.hemisphere([[0, 0, 0]], [0, 1, 0], samples=2, seed=yes)),
                      ("unit", lambda: self.client.load("builtin:forest?trees=2", unit=yes)), ("spacing", lambda: self.client.load("builtin:forest?trees=2", spacing=yes)),
                      ("reconnect", lambda: raynest.connect(self.daemon.uri, reconnect=yes))]
            with self.woods.edit() as edit:
                calls += [("mask", lambda: edit.set_mask(0, yes)), ("mask", lambda: edit.set_mask([0], [yes])),
                          ("uid", lambda: edit.set_uid(0, yes)), ("material", lambda: edit.set_material(0, yes)),
                          ("instance", lambda: edit.hide(yes)), ("instance", lambda: edit.hide([yes])),
                          ("mask", lambda: edit.add("woods", mask=yes)), ("epoch", lambda: self.woods.edit(epoch=yes))]
                for name, call in calls:
                    with self.subTest(name=name, yes=yes), self.assertRaisesRegex((raynest.UsageError, TypeError), name):
                        call()
        self.assertEqual(self.woods.info["epoch"], 1)

    def test_offsets_are_no_places(self):
        with self.woods.edit() as edit:
            for given in ((1, 0, 0), np.zeros((2, 3))):
                with self.assertRaisesRegex(raynest.UsageError, r"must be \(3, 4\) or \(4, 4\), .*; move\(\) takes offsets"):
                    edit.place([0, 1], given)

    def test_who_finds_no_daemon_reads_how_to_start_one(self):
        with self.assertRaisesRegex(raynest.ConnectError, "start a daemon with: raynestd --listen "
                                                          f"unix:{self.out}/nobody &"):
            raynest.connect(f"unix:{self.out}/nobody")
        (pathlib.Path(self.out) / "file").write_text("")
        with self.assertRaisesRegex(raynest.ConnectError, "it is no socket"):
            raynest.connect(f"unix:{self.out}/file")

    def test_the_daemon_is_quoted_in_this_packages_words(self):
        for refused, says in ((lambda: self.woods.trace(DOWN, epoch=9), "leave epoch= out"),
                              (lambda: self.client.scene("nowhere"),
                               r"see Client.scenes\(\), or Client.load\(\) it"),
                              (lambda: self.client.load("builtin:terrain?size=9", "woods"),
                               "another name=, or put it in the other's place with replace=True")):
            with self.assertRaisesRegex(raynest.Error, says):
                refused()
        self.woods.render(size=(8, 8), samples=4)
        self.assertIn("no effect with integrator primary: spp=",
                      self.client.outcome["notes"])

    def test_a_value_that_the_daemon_quotes_stands_as_it_was_given(self):
        with self.assertRaisesRegex(raynest.Error, "environment=none has no sky"):
            self.woods.render(size=(8, 8), integrator="path", spp=1, environment="none", sun=(130, 35))
        with self.assertWarnsRegex(raynest.RayWarning, "mask=00000000"):
            self.woods.render(size=(8, 8), mask=0)

    def test_an_edit_that_is_never_sent_is_told(self):
        scene = self.client.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        for edit in (lambda: scene.edit().hide(0), lambda: [scene.edit().hide(0)].clear()):
            with self.assertWarnsRegex(raynest.RayWarning, "outside of a `with` block changes nothing"):
                edit()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene.edit()
            with scene.edit() as edit:
                edit.show(0)
            del edit

    def test_more_parts_than_a_request_takes_are_refused_with_the_way_out(self):
        for key in ("hide", "only"):
            for many, noun in ((range(600), "number"), ([f"stand-{i}" for i in range(600)], "text")):
                with self.assertRaisesRegex(raynest.UsageError, rf"{key} names 600 parts by {noun}, .* = 512: let \* stand"):
                    self.woods.trace(DOWN, **{key: many})

    def test_sizes_may_be_whole_floats_and_a_setting_has_one_name(self):
        self.assertEqual(self.woods.render(size=(8.0, np.float32(6))).shape[:2], (6, 8))
        with self.assertRaisesRegex(raynest.UsageError, "spp and samples are two names"):
            self.woods.render(size=(8, 8), spp=4, samples=2)

    def test_generators_take_no_points_too(self):
        rays = generators.hemisphere([], [], samples=4)
        self.assertEqual(self.woods.trace(rays, reduce="hit_fraction")["hit_fraction"].shape, (0,))


if __name__ == "__main__":
    main()
