#!/usr/bin/env python3
"""Tests raynest export: a scene that is written and loaded again has the same hits in every bit, names,
masks and pictures; what a file cannot say is told with its count.

  export_test.py RAYNESTD RAYNEST
"""
import base64
import json
import pathlib
import struct
import sys
import threading
import warnings
from unittest import mock

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_files import WithFiles

HITS = ["t", "prim", "path", "uv"]


def rays_at(info, count=4000, seed=3):
    """Rays (N, 6) through the scene's box from around it, in the world."""
    random = np.random.default_rng(seed)
    low, high = np.array(info["box_min"]), np.array(info["box_max"])
    size = np.maximum(high - low, 1e-3)
    starts = (low + high) / 2 + random.normal(size=(count, 3)) * size
    ends = low + random.uniform(size=(count, 3)) * size
    return np.hstack([starts, ends - starts])


def obj(vertices, faces):
    return "\n".join(["v {!r} {!r} {!r}".format(*v) for v in vertices.tolist()]
                     + ["f {} {} {}".format(*face) for face in (faces + 1).tolist()]) + "\n"


class Export(WithFiles):
    def source(self, source, **options):
        return self.python.load(source, name=f"s{len(self.python.scenes())}", **options)

    def same_hits(self, before, after, intersector="opaque", t_alone=False):
        rays = rays_at(before.info)
        fields = ["t", "prim"] if t_alone else HITS
        one, two = (scene.trace(rays, fields=fields, intersector=intersector) for scene in (before, after))
        self.assertGreater(np.isfinite(one["t"]).sum(), 50)
        for field in fields:
            self.assertEqual(one[field].tobytes(), two[field].tobytes(), field)
        for key in ("instanced_triangles", "instances", "unique_triangles"):
            self.assertEqual(before.info[key], after.info[key], key)
        return one

    def export(self, scene, name="out.glb"):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            made = scene.export(self.scenes / name)
        self.assertEqual([str(note.message) for note in notes], made["notes"])
        return made

    def json_of(self, path):
        data = pathlib.Path(path).read_bytes()
        self.assertEqual(struct.unpack("<4sII", data[:12]), (b"glTF", 2, len(data)))
        return json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])

    def test_builtin_scenes(self):
        for source in ("builtin:street", "builtin:forest?trees=30", "builtin:terrain?size=32"):
            with self.subTest(source):
                before = self.source(source)
                made = self.export(before)
                after = self.source(made["glb"])
                self.same_hits(before, after)
                self.assertEqual(before.info["cameras"], after.info["cameras"])

    def soup(self, count, seed):
        random = np.random.default_rng(seed)
        vertices = random.uniform(-1, 1, (count, 1, 3)) + random.uniform(-0.4, 0.4, (count, 3, 3))
        return vertices.reshape(-1, 3).astype(np.float32).astype(float), np.arange(3 * count).reshape(-1, 3)

    def test_colours_beyond_gltf_are_told(self):
        made = self.export(self.source("builtin:forest?trees=3"))
        self.assertIn("2 materials have a base colour beyond 1", " ".join(made["notes"]))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.source(made["glb"])

    def test_meshes_points_and_coordinates_of_surveys(self):
        vertices, faces = self.soup(400, 1)
        before = self.load("soup.obj", obj(vertices, faces))
        self.same_hits(before, self.source(self.export(before)["glb"]), t_alone=True)
        # The composition keeps the origin, without which float32 would round.
        far = np.array([500_000.25, 120.0, -5_300_000.75])
        before = self.load("far.obj", obj(vertices + far, faces), origin=tuple(far))
        made = self.export(before, "far.rnscene.json")
        after = self.source(self.scenes / "far.rnscene.json")
        np.testing.assert_array_equal(after.origin, far)
        rays = rays_at(before.info) + np.hstack([far, np.zeros(3)]) * (np.abs(rays_at(before.info)[:, :3]).max() < 1e5)
        one, two = (scene.trace(rays, fields=("t", "prim")) for scene in (before, after))
        self.assertGreater(np.isfinite(one["t"]).sum(), 50)
        self.assertEqual(one["t"].tobytes(), two["t"].tobytes())
        self.assertEqual(pathlib.Path(made["glb"]).name, "far.glb")

    def test_spheres_come_back(self):
        flake = self.source("builtin:flake?depth=2")
        made = self.export(flake)
        self.assertRegex(" ".join(made["notes"]), r"^[0-9]+ spheres are written as points with _RADIUS")
        self.same_hits(flake, self.source(made["glb"]))
        random = np.random.default_rng(3)
        rows = ["{} {} {} {} {} {} {}".format(*random.uniform(-9, 9, 3), random.uniform(0.2, 0.6), *random.integers(0, 256, 3))
                for _ in range(800)]
        names = [*(f"property float {name}" for name in ("x", "y", "z", "radius")),
                 *(f"property uchar {name}" for name in ("red", "green", "blue"))]
        lines = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *names, "end_header", *rows]
        before = self.load("cloud.ply", "\n".join(lines) + "\n")
        for name in ("alone.glb", "spheres.rnscene.json"):
            self.export(before, name)
            after = self.source(self.scenes / name)
            rays = rays_at(before.info)
            one, two = (scene.trace(rays, fields=("t", "prim", "ng", "base_colour", "hit")) for scene in (before, after))
            self.assertGreater(one["hit"].sum(), 50)
            for field in one:
                self.assertEqual(one[field].tobytes(), two[field].tobytes(), field)

    def test_spheres_of_a_file_are_checked(self):
        def points(radii, count=2, kind=5126):
            data = np.arange(3 * count, dtype=np.float32).tobytes() + np.asarray(radii).tobytes()
            uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
            return json.dumps({
                "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"mode": 0, "attributes": {"POSITION": 0, "_RADIUS": 1}}]}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"},
                              {"bufferView": 1, "componentType": kind, "count": len(radii), "type": "SCALAR"}],
                "bufferViews": [{"buffer": 0, "byteLength": 12 * count},
                                {"buffer": 0, "byteOffset": 12 * count, "byteLength": len(data) - 12 * count}],
                "buffers": [{"uri": uri, "byteLength": len(data)}]})
        good = self.load("points.gltf", points(np.float32([0.5, 0.25])))
        hit = good.trace([[0, 1, 9, 0, 0, -1], [3, 4, 9, 0, 0, -1]], fields=("t", "prim"))
        np.testing.assert_array_equal(hit["t"], np.float32([6.5, 3.75]))
        np.testing.assert_array_equal(hit["prim"], [0, 1])
        for radii, kind, why in (([np.nan, 1], 5126, "_RADIUS of nan"), ([0, 1], 5126, "_RADIUS of 0"),
                                 ([-1, 1], 5126, "_RADIUS of -1"), ([np.inf, 1], 5126, "_RADIUS of inf"),
                                 ([1, 1, 1], 5126, "has 2 vertices but 3 elements of _RADIUS")):
            with self.subTest(why), self.assertRaisesRegex(raynest.errors.Error, why):
                self.load("bad.gltf", points(np.float32(radii), kind=kind))
        with self.assertRaisesRegex(raynest.errors.Error, "_RADIUS of the wrong type"):
            self.load("bad.gltf", points(np.uint16([1, 1, 1, 1][:2]), kind=5123))

    def test_what_is_composed_edited_and_masked(self):
        for name, seed in (("a", 1), ("b", 2)):
            self.write(f"{name}.obj", obj(*self.soup(60, seed)))
        town = {"rnscene": 1, "objects": {"a": {"file": "a.obj"}, "b": {"file": "b.obj"},
                                          "pair": {"instances": [{"object": "a"}, {"object": "b", "translation": [3, 0, 0]}]}},
                "instances": [{"object": "pair"}, {"object": "pair", "name": "turned", "rotation": [0, 0.6, 0, 0.8],
                                                   "translation": [0, 0, 9], "mask": 2}]}
        before = self.load("town.rnscene.json", json.dumps(town))
        with before.edit() as edit:
            edit.move("pair/a", (0, 2, 0))
        made = self.export(before)
        self.assertEqual(made["epoch"], 2)
        after = self.source(made["glb"])
        rays = rays_at(before.info)
        for mask in (0xFFFFFFFF, 1, 2):
            one, two = (scene.trace(rays, fields=("t", "prim"), mask=mask) for scene in (before, after))
            np.testing.assert_allclose(one["t"], two["t"], rtol=1e-5)
        self.assertEqual(before.info["instanced_triangles"], after.info["instanced_triangles"])
        for text in ("turned/a", "pair/b"):
            self.assertEqual(len(after.path_ids([text])), 1)

    def test_colours_of_vertices_come_back(self):
        vertices, faces = self.soup(200, 5)
        shades = np.random.default_rng(2).uniform(0, 1, (len(vertices), 3))
        lines = ["v {!r} {!r} {!r} {:.4f} {:.4f} {:.4f}".format(*v, *c) for v, c in zip(vertices.tolist(), shades)]
        before = self.load("shades.obj", "\n".join(lines + ["f {} {} {}".format(*(f + 1)) for f in faces]) + "\n")
        after = self.source(self.export(before)["glb"])
        rays = rays_at(before.info)
        one, two = (scene.trace(rays, fields=("base_colour", "hit")) for scene in (before, after))
        self.assertGreater(one["base_colour"][one["hit"]].std(), 0.1)
        np.testing.assert_array_equal(one["base_colour"], two["base_colour"])

    def test_a_scene_that_is_edited_meanwhile_is_exported(self):
        self.write("part.obj", obj(*self.soup(4000, 6)))
        before = self.load("edited.rnscene.json", json.dumps({"rnscene": 1, "objects": {"part": {"file": "part.obj"}},
                                                              "instances": [{"object": "part"}]}))
        stop = threading.Event()

        def edit_on():
            with raynest.connect(self.daemon.uri) as other:
                scene = other.scene("edited")
                while not stop.is_set():
                    with scene.edit() as edit:
                        edit.move(0, (0, 0.01, 0))
        editor = threading.Thread(target=edit_on)
        editor.start()
        try:
            for i in range(5):
                made = self.export(before, f"live{i}.rnscene.json")
                self.assertEqual(self.client.run("export", "edited", "-o", self.scenes / f"shell{i}.rnscene.json").returncode, 0)
        finally:
            stop.set()
            editor.join()
        self.assertGreater(made["epoch"], 1)
        self.source(self.scenes / "live0.rnscene.json")

    def test_names_that_are_lost_are_told(self):
        self.write("a.glb", pathlib.Path(self.export(self.load("a.obj", obj(*self.soup(20, 1))), "a.glb")["glb"]).read_bytes())
        town = {"rnscene": 1, "objects": {"a": {"file": "a.glb"}, "pair": {"instances": [{"object": "a", "name": "one"}]}},
                "instances": [{"object": "pair", "name": "north"}, {"object": "pair", "name": "south"}]}
        notes = " ".join(self.export(self.load("deep.rnscene.json", json.dumps(town)))["notes"])
        self.assertIn("names above shared parts are left out", notes)
        self.assertIn("the user ids of 2 instances become others", notes)

    def test_materials_keep_what_they_say(self):
        extensions = {
            "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25},
            "KHR_materials_sheen": {"sheenColorFactor": [1, 0.5, 0.25], "sheenRoughnessFactor": 0.75},
            "KHR_materials_specular": {"specularFactor": 0.125, "specularColorFactor": [2, 1, 0]},
            "KHR_materials_iridescence": {"iridescenceFactor": 0.375, "iridescenceIor": 1.5,
                                          "iridescenceThicknessMinimum": 200, "iridescenceThicknessMaximum": 500},
            "KHR_materials_anisotropy": {"anisotropyStrength": 0.625, "anisotropyRotation": 1.5},
            "KHR_materials_emissive_strength": {"emissiveStrength": 4}, "KHR_materials_ior": {"ior": 1.75},
            "KHR_materials_transmission": {"transmissionFactor": 0.5}}
        material = {"name": "skin", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True,
                    "emissiveFactor": [1, 0.5, 0.25], "extensions": extensions,
                    "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 0.75], "metallicFactor": 0.25,
                                             "roughnessFactor": 0.5}}
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
        text = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0, "name": "skin"}], "materials": [material],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
                "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,"
                             + base64.b64encode(corners.tobytes()).decode()}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0],
                               "max": [1, 1, 0]}]}
        before = self.load("skin.gltf", json.dumps(text))
        written, = self.json_of(self.export(before)["glb"])["materials"]
        self.assertEqual(written, material)

    def test_a_moment_of_an_animation(self):
        scene = self.source("builtin:forest?trees=20&wind=1")
        rays = rays_at(scene.info)
        wanted = [scene.trace(rays, fields=("t",), time=time, intersector="opaque")["t"] for time in (0.25, 1.5)]
        self.assertGreater((wanted[0] != wanted[1]).sum(), 50)
        self.client.json("export", scene.name, "-o", self.scenes / "late.rnscene.json", "--time", 1.5, "--animation", 0)
        for time, path, t in ((0.25, self.scenes / "early.glb", wanted[0]), (None, self.scenes / "late.rnscene.json", wanted[1])):
            if time is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    scene.export(path, time=time)
            found = self.source(path).trace(rays, fields=("t",), intersector="opaque")["t"]
            np.testing.assert_array_equal(np.isfinite(found), np.isfinite(t))
            np.testing.assert_allclose(found[np.isfinite(t)], t[np.isfinite(t)], rtol=1e-5)
        for words, said in ((("--time", "1e9"), "runs from 0"), (("--animation", "0"), "--time")):
            done = self.client.run("export", scene.name, "-o", self.scenes / "never.glb", *words)
            self.assertIn(said, done.stderr)
            self.assertNotEqual(done.returncode, 0)

    def test_the_command_line_and_what_is_refused(self):
        self.load("soup.obj", obj(*self.soup(20, 3)))
        made = self.client.json("export", "soup", "-o", self.scenes / "cli.rnscene.json")
        self.assertEqual(pathlib.Path(made["glb"]).stat().st_size, made["bytes"])
        self.assertEqual(self.client.run("load", self.scenes / "cli.rnscene.json", "--name", "again").returncode, 0)
        for words, code, said in ((["nobody", "-o", "x.glb"], 5, "nobody"), (["soup", "-o", "x.obj"], 2, ".glb"),
                                  (["soup", "-o", "/no/such/x.glb"], 1, "/no/such"), (["soup"], 2, "-o")):
            done = self.client.run("export", *words)
            self.assertIn(said, done.stderr)
            self.assertEqual(done.returncode, code, done.stderr)
        with self.assertRaisesRegex(raynest.UsageError, "must end with .glb"):
            self.python.scene("soup").export("x.obj")
        for name in ("12:30.rnscene.json", "a\\b.rnscene.json"):
            with self.assertRaisesRegex(raynest.UsageError, "a composition cannot name"):
                self.python.scene("soup").export(self.scenes / name)
            refused = self.client.run("export", "soup", "-o", self.scenes / name)
            self.assertEqual((refused.returncode, "a composition cannot name" in refused.stderr), (2, True), refused.stderr)
        # A .glb of somebody else stays; that of the same composition is replaced.
        theirs = self.scenes / "theirs.glb"
        theirs.write_bytes(b"theirs")
        done = self.client.run("export", "soup", "-o", self.scenes / "theirs.rnscene.json")
        self.assertEqual(done.returncode, 2)
        self.assertIn("theirs.glb exists", done.stderr)
        with self.assertRaisesRegex(raynest.UsageError, "theirs.glb' exists"):
            self.python.scene("soup").export(self.scenes / "theirs.rnscene.json")
        self.assertEqual(theirs.read_bytes(), b"theirs")
        done = self.client.run("export", "soup", "-o", self.scenes / "cli.rnscene.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("cli.glb", done.stdout + done.stderr)
        self.assertEqual(self.python.scene("soup").export(self.scenes / "cli.rnscene.json")["glb"], str(self.scenes / "cli.glb"))
        # A scene that is replaced meanwhile by one with another origin is not written in two halves.
        self.python.load(self.scenes / "soup.obj", name="moves")
        scene = self.python.scene("moves")
        file = scene._file

        def meanwhile(message, progress):
            if message["format"] == "rnscene.json":
                self.python.load(self.scenes / "soup.obj", name="moves", replace=True, origin=(1, 0, 0))
            return file(message, progress)
        with mock.patch.object(scene, "_file", meanwhile), self.assertRaisesRegex(raynest.InvalidError, "was replaced while"):
            scene.export(self.scenes / "moves.rnscene.json")
        self.assertFalse((self.scenes / "moves.glb").exists())


if __name__ == "__main__":
    main()
