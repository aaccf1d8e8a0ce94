#!/usr/bin/env python3
"""Tests compositions (*.rnscene.json): what they place is hit where the same parts are hit when each is
moved by NumPy, their files come along, and damaged ones are refused with the place.

  composition_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import subprocess
import sys
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_files import WithFiles

RANDOM = np.random.default_rng(7)
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


def soup(count, seed):
    """Loose triangles about the origin: vertices (3N, 3), faces (N, 3)."""
    random = np.random.default_rng(seed)
    vertices = (random.uniform(-1, 1, (count, 1, 3)) + random.uniform(-0.4, 0.4, (count, 3, 3))).reshape(-1, 3)
    return vertices.astype(np.float32).astype(float), np.arange(3 * count).reshape(-1, 3)


def obj(vertices, faces, name=None):
    lines = [f"o {name}"] if name else []
    lines += ["v {!r} {!r} {!r}".format(*v) for v in vertices.tolist()]
    return "\n".join(lines + ["f {} {} {}".format(*(f + 1)) for f in faces]) + "\n"


def ply(vertices, faces):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n" + "".join(f"property double {a}\n" for a in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    return head + "".join("{!r} {!r} {!r}\n".format(*v) for v in vertices.tolist()) + "".join(
        "3 {} {} {}\n".format(*f) for f in faces.tolist())


def gltf(vertices, faces, **more):
    """A .gltf beside its .bin, with two nodes: "hull" holds the mesh, and "body" is the parent of it."""
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "body", "children": [1]}, {"name": "hull", "mesh": 0}, *more.pop("nodes", [])],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": "shape%20of.bin", "byteLength": 12 * len(vertices) + 12 * len(faces)}],
        "bufferViews": [{"buffer": 0, "byteLength": 12 * len(vertices)},
                        {"buffer": 0, "byteOffset": 12 * len(vertices), "byteLength": 12 * len(faces)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3",
                       "min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()},
                      {"bufferView": 1, "componentType": 5125, "count": 3 * len(faces), "type": "SCALAR"}], **more})


def binary(vertices, faces):
    return vertices.astype("<f4").tobytes() + faces.astype("<u4").tobytes()


def pose(x, y, z, turn=0.0, scale=1.0):
    """A turn about y, a scale, and an offset, (3, 4)."""
    c, s = np.cos(turn) * scale, np.sin(turn) * scale
    return np.array([[c, 0, s, x], [0, scale, 0, y], [-s, 0, c, z]])


def moved(matrix, vertices):
    return vertices @ np.asarray(matrix)[:, :3].T + np.asarray(matrix)[:, 3]


class Compositions(WithFiles):
    def write(self, name, data):
        return super().write(name, data if isinstance(data, (str, bytes)) else json.dumps({"rnscene": 1, **data}))

    def rays(self, count=4000, reach=14.0):
        aim = RANDOM.uniform([-reach, -1, -reach], [reach, 1.5, reach], (count, 3))
        eye = aim + RANDOM.uniform(-3, 3, (count, 3)) + [0, 8, 0]
        return np.hstack([eye, (aim - eye) / np.linalg.norm(aim - eye, axis=1)[:, None]])

    def check_same_hits(self, scene, vertices, faces):
        """Against one mesh of all triangles."""
        flat = self.python.mesh(vertices, faces)
        rays = self.rays()
        ours, theirs = scene.trace(rays, fields=("t",))["t"], flat.trace(rays, fields=("t",))["t"]
        self.assertGreater(np.isfinite(theirs).sum(), 200)
        # The same triangles, rounded at other places: a ray may pass an edge on the other side.
        self.assertLess((~np.isclose(ours, theirs, rtol=1e-4)).sum(), 6)

    def write_parts(self):
        self.ball, self.box, self.hull = soup(60, 1), soup(50, 2), soup(40, 3)
        self.write("parts/ball.obj", obj(*self.ball, name="skin"))
        self.write("parts/box.ply", ply(*self.box))
        self.write("cars/car.gltf", gltf(*self.hull))
        self.write("cars/shape of.bin", binary(*self.hull))

    def town(self):
        self.write_parts()
        self.places = [pose(-6, 0, 2, 0.4), pose(5, 0, -3, 1.2, 1.5), pose(0, 0, 6), pose(8, 0.2, 8, 2.0)]
        np.save(self.scenes / "boxes.npy", np.stack(self.places))
        return {
            "objects": {"ball": {"file": "parts/ball.obj"}, "box": {"file": "./parts/box.ply", "unit": 2},
                        "car": {"file": "cars/car.gltf"},
                        "pair": {"instances": [{"object": "ball", "translation": [0, 0, 2]},
                                               {"object": "car", "name": "left", "translation": [0, 0, -2], "scale": 0.5}]}},
            "instances": [{"object": "box", "matrices": "boxes.npy", "uid": 7},
                          {"object": "pair", "translation": [-5, 0, -6], "rotation": [0, np.sin(0.3), 0, np.cos(0.3)]},
                          {"object": "pair", "name": "far", "matrix": pose(9, 0, 0, 0.9).ravel().tolist(), "mask": "0x2"},
                          {"object": "car", "matrices": [pose(0, 0, 0).tolist(), pose(-9, 0, -9).ravel().tolist()]}],
            "cameras": [{"name": "gate", "eye": [0, 9, 20], "target": [0, 0, 0], "fov": 35}]}

    def meshes_of_town(self):
        pair_at, far_at = pose(-5, 0, -6, 0.6), pose(9, 0, 0, 0.9)
        parts = [(moved(place, 2 * self.box[0]), self.box[1]) for place in self.places]
        for outer in (pair_at, far_at):
            parts.append((moved(outer, self.ball[0] + [0, 0, 2]), self.ball[1]))
            parts.append((moved(outer, self.hull[0] / 2 + [0, 0, -2]), self.hull[1]))
        parts += [(self.hull[0], self.hull[1]), (self.hull[0] + [-9, 0, -9], self.hull[1])]
        starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
        return (np.concatenate([vertices for vertices, _ in parts]),
                np.concatenate([faces + start for (_, faces), start in zip(parts, starts)]))

    def test_the_parts_stand_where_they_are_placed(self):
        scene = self.load("town.rnscene.json", self.town())
        self.assertEqual(scene.name, "town")
        self.check_same_hits(scene, *self.meshes_of_town())
        self.assertEqual(scene.info["unique_triangles"], 150)
        self.assertEqual(scene.info["instanced_triangles"], 4 * 50 + 2 * 100 + 2 * 40)
        hit = scene.trace(self.rays(20000), fields=("path", "uid"))
        paths = {path for path in scene.path_of(np.unique(hit["path"])) if path}
        self.assertEqual({path for path in paths if path.startswith("box")}, {f"box#{i}" for i in range(4)})
        self.assertEqual({path for path in paths if path.startswith("far")}, {"far/ball", "far/left"})
        self.assertEqual({path for path in paths if path.startswith("car")}, {"car#0", "car#1"})
        self.assertEqual(set(hit["uid"][np.isin(hit["path"], np.arange(4))]), {7})
        # A mask of an instance: "far" alone has bit 1, and not bit 0.
        few = scene.trace(self.rays(20000), mask=0x1, fields=("path",))["path"]
        self.assertFalse([path for path in scene.path_of(np.unique(few)) if path and path.startswith("far")])
        self.assertEqual(list(scene.info["cameras"]), ["gate"])

    def test_the_command_line_and_the_daemons_folder_load_them_too(self):
        digest = self.load("town.rnscene.json", self.town()).info["hash"]
        made = self.client.json("load", self.scenes / "town.rnscene.json", "--name", "cli", "--replace")
        self.assertEqual(made["hash"], digest)
        made = self.client.json("load", "root:town.rnscene.json", "--replace")
        self.assertEqual((made["name"], made["hash"]), ("town", digest))
        with open(self.scenes / "town.rnscene.json", "rb") as file:
            done = subprocess.run([self.client.program, "load", "-", "--name", "piped", "--json"], stdin=file, cwd=self.scenes,
                                  env=self.client.environment, capture_output=True, text=True, check=False)
        self.assertEqual(json.loads(done.stdout)["hash"], digest, done.stderr)

    def test_a_composition_holds_another(self):
        town = self.town()
        inner = dict(town, cameras=[])
        self.write("inner/town.rnscene.json", json.dumps({"rnscene": 1, **inner}).replace("parts/", "../parts/"))
        # Names go up only within the scene's folder.
        for name in ("parts/ball.obj", "parts/box.ply", "cars/car.gltf", "cars/shape of.bin", "boxes.npy"):
            if not name.startswith("parts"):
                self.write(f"inner/{name}", (self.scenes / name).read_bytes())
        scene = self.load("outer.rnscene.json", {"objects": {"town": {"file": "inner/town.rnscene.json"}},
                                                 "instances": [{"object": "town", "translation": [1, 0, 0]}]})
        vertices, faces = self.meshes_of_town()
        self.check_same_hits(scene, vertices + [1, 0, 0], faces)
        path = scene.path_of(scene.trace(self.rays(), fields=("path",))["path"])
        self.assertTrue(any(text == "town/far/left" for text in path), set(path))

    def test_built_in_scenes_and_one_part_many_times(self):
        places = np.stack([pose(3 * i, 0, 3 * j) for i in range(40) for j in range(40)])[:, :, 3]
        np.save(self.scenes / "grid.npy", places)
        scene = self.load("many.rnscene.json", {"objects": {"flake": {"file": "builtin:flake?depth=1"}},
                                                "instances": [{"object": "flake", "matrices": "grid.npy"}]})
        one = self.python.load("builtin:flake?depth=1", name="one", replace=True)
        self.assertEqual(scene.info["instances"], 1600 * one.info["instances"])
        self.assertLess(scene.info["bytes"], one.info["bytes"] + 1600 * 400)
        ray = np.array([[3 * 17 + 0.1, 9, 3 * 22 + 0.05, 0, -1, 0]])
        self.assertEqual(scene.trace(ray, fields=("t",))["t"],
                         one.trace(ray - [3 * 17, 0, 3 * 22, 0, 0, 0], fields=("t",))["t"])

    def test_cameras_and_lights_come_along_from_one_place(self):
        self.write_parts()
        lit = json.loads(gltf(*self.hull, extensionsUsed=["KHR_lights_punctual"], cameras=[
            {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}],
            extensions={"KHR_lights_punctual": {"lights": [{"type": "point", "name": "lamp", "intensity": 9}]}}))
        lit["nodes"] += [{"name": "eye", "camera": 0, "translation": [0, 0, 5]},
                         {"extensions": {"KHR_lights_punctual": {"light": 0}}}]
        lit["scenes"][0]["nodes"] += [2, 3]
        self.write("cars/lit.gltf", json.dumps(lit))
        objects = {"car": {"file": "cars/lit.gltf"}}
        scene = self.load("one.rnscene.json", {"objects": objects, "instances": [
            {"object": "car", "translation": [1, 2, 3]}]})
        self.assertEqual(list(scene.info["cameras"]), ["car/eye"])
        middle = scene.trace(raynest.generators.camera(size=(3, 3), camera="car/eye"), fields=("origin", "direction"))
        np.testing.assert_allclose(middle["origin"][4], [1, 2, 8], atol=1e-6)
        np.testing.assert_allclose(middle["direction"][4], [0, 0, -1], atol=1e-6)
        with self.assertWarnsRegex(raynest.SceneWarning, "car: its lights are left out, for it stands at 2 places"):
            two = self.load("two.rnscene.json", {"objects": objects, "instances": [
                {"object": "car", "matrices": [pose(0, 0, 0).tolist(), pose(4, 0, 0).tolist()]}]})
        self.assertEqual(len(two.info["cameras"]), 0)

    def test_lights_of_the_composition_shine_as_those_of_a_file(self):
        self.write_parts()
        cone = {"innerConeAngle": np.radians(10), "outerConeAngle": np.radians(50)}
        colour = {"color": [1, 0.5, 0.25], "intensity": 90}
        lamps = [{"type": "point", "name": "lamp", "range": 40, **colour}, {"type": "spot", "spot": cone, **colour},
                 {"type": "directional", "intensity": 3}]
        ours = {"colour": [1, 0.5, 0.25], "intensity": 90}
        at = [1, 2, 8]
        compositions = [{"type": "point", "name": "lamp", "range": 40, "position": at, **ours},
                        {"type": "spot", "position": at, "direction": [0, 0, -9], "inner": 10, "outer": 50, **ours},
                        {"type": "directional", "direction": [0, 0, -0.5], "intensity": 3}]
        pictures = []
        for number, (lamp, light) in enumerate(zip(lamps, compositions)):
            lit = json.loads(gltf(*self.hull, extensionsUsed=["KHR_lights_punctual"], extensions={
                "KHR_lights_punctual": {"lights": [lamp]}}))
            lit["nodes"].append({"translation": [0, 0, 5], "extensions": {"KHR_lights_punctual": {"light": 0}}})
            lit["scenes"][0]["nodes"].append(2)
            self.write("cars/lit.gltf", json.dumps(lit))
            self.write("cars/bare.gltf", gltf(*self.hull))
            for origin in ([0, 0, 0], [1, 2, 3]):
                same = [self.load(f"{name}{number}-{origin[0]}.rnscene.json", {
                    "origin": origin, "objects": {"car": {"file": f"cars/{name}.gltf"}}, **more,
                    "instances": [{"object": "car", "translation": [1, 2, 3]}]}).render(
                        size=(32, 24), integrator="direct", spp=4, environment="none", encode="raw", look_at=((1, 2, 9), (1, 2, 3)))
                    for name, more in (("lit", {}), ("bare", {"lights": [light]}))]
                self.assertGreater(same[0].max(), 0)
                np.testing.assert_array_equal(*same)
            pictures.append(same[0])
        self.assertFalse(np.array_equal(pictures[0], pictures[1]))

    def test_surveyed_coordinates_keep_their_digits(self):
        self.write_parts()
        at = np.array([460_000.125, 100, 5_400_000.25])
        self.write("far.ply", ply(self.box[0] / 8 + at, self.box[1]))
        scene = self.load("survey.rnscene.json", {
            "origin": at.tolist(), "objects": {"near": {"file": "parts/box.ply"},
                                               "far": {"file": "far.ply", "origin": "auto"}},
            "instances": [{"object": "far"}, {"object": "near", "translation": (at + [0.5, 0, 0.5]).tolist()}]})
        self.assertEqual(scene.origin.tolist(), at.tolist())
        corner = (self.box[0][self.box[1]] / 8).mean(1)[3] + at
        hit = scene.trace(np.hstack([corner + [0, 0, 1e-3], [0, 0, -1]])[None], fields=("t",))["t"][0]
        self.assertLess(hit, 2e-3)

    def test_the_documents_example_and_schema(self):
        folder = pathlib.Path(__file__).parents[2] / "engine/assets/composition"
        text = (folder / "COMPOSITION.md").read_text(encoding="utf-8")
        example = text[text.index("```json") + 7:]
        example = example[:example.index("```")]
        self.write("parts/house.obj", obj(100 * self.box_of(3), np.arange(36).reshape(-1, 3)))
        self.write("parts/tree.ply", ply(*soup(20, 4)))
        np.save(self.scenes / "forest.npy", np.stack([pose(i, 0, 9) for i in range(5)]))
        scene = self.load("example.rnscene.json", example)
        paths = set(scene.path_of(np.arange(scene.info["instances"])))
        self.assertEqual(paths, {"ground", "garden/house", "garden/oak", *(f"tree#{i}" for i in range(5))})
        # Each kind of member is refused where the schema has none of its name, and the message lists those it has.
        schema = json.loads((folder / "composition.schema.json").read_text(encoding="utf-8"))
        kinds = schema["$defs"]
        at = [{"object": "a"}]
        for data, known in (
                ({"objects": {}, "instances": [], "zz": 1}, schema),
                ({"objects": {"a": {"file": "a.obj", "zz": 1}}, "instances": at}, kinds["file"]),
                ({"objects": {"a": {"instances": [], "zz": 1}}, "instances": at}, kinds["file"]),
                ({"objects": {"a": {"instances": [], "unit": 1}}, "instances": at}, kinds["group"]),
                ({"objects": {}, "instances": [{"object": "a", "zz": 1}]}, kinds["instance"]),
                ({"objects": {}, "instances": [], "cameras": [{"zz": 1}]}, kinds["camera"]),
                ({"objects": {}, "instances": [], "lights": [{"zz": 1}]}, kinds["light"])):
            with self.assertRaises(raynest.InvalidError) as caught:
                self.load("x.rnscene.json", data)
            told = set(str(caught.exception).split("which is none of ")[1].split(" [")[0].split(", "))
            wanted = set(known["properties"]) | ({"instances"} if known is kinds["file"] else set())
            self.assertEqual(told, wanted)

    @staticmethod
    def box_of(size):
        corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T * size
        return corners[RANDOM.integers(0, 8, 36)].astype(float)

    def refusals(self):
        tri = {"a": {"file": "a.obj"}}
        at = [{"object": "a"}]
        yield "{", "is not valid JSON"
        yield "[" * 100 + "]" * 100, "nested deeper"
        yield '{"rnscene": 1, "objects": {}, "objects": {}, "instances": []}', "'objects' twice"
        yield '{"objects": {}}', "begins with {\"rnscene\": 1"
        yield '{"rnscene": 2, "objects": {}, "instances": []}', "another version"
        yield '{"rnscene": 1e999}', "beyond 1e308"
        yield {"objects": tri, "instances": [{**at[0], "name": ""}]}, "an empty name"
        yield {"objects": tri, "instances": [{**at[0], "uid": 0xFFFFFFFF}]}, "stands for no user id"
        for table, words in (("turned", "last row is not 0 0 0 1"), ("nan", "last row is not 0 0 0 1"),
                             ("flat", "its shape is to be"), ("wide", "its shape is to be")):
            yield {"objects": tri, "instances": [{**at[0], "matrices": f"{table}.npy"}]}, words
        yield {"objects": tri}, "has no 'instances'"
        yield {"objects": tri, "instances": at, "light": 1}, "'light', which is none of"
        yield {"objects": {"a": {}}, "instances": at}, "objects.a has no 'file'"
        yield {"objects": {"a": {"file": "a.obj", "up": "x"}}, "instances": at}, "objects.a.up is neither"
        yield {"objects": {"a": {"file": "a.obj", "unit": -1}}, "instances": at}, "objects.a.unit is not above 0"
        yield {"objects": {"a": {"file": "gone.obj"}}, "instances": at}, "object 'a': there is no file 'gone.obj'"
        yield {"objects": {"a": {"file": "../../etc/passwd"}}, "instances": at}, "is no file beneath"
        yield {"objects": {"a": {"file": "/etc/passwd"}}, "instances": at}, "is no file beneath"
        yield {"objects": {"a": {"file": "broken.ply"}}, "instances": at}, "object 'a': broken.ply: "
        yield {"objects": {"a": {"file": "a.txt"}}, "instances": at}, "object 'a': "
        yield {"objects": {"a": {"file": "x.rnscene.json"}}, "instances": at}, "'x.rnscene.json' holds itself"
        yield {"objects": {"a": {"instances": at}}, "instances": at}, "the object 'a' holds itself"
        yield {"objects": {"a": {"instances": [{"object": "b"}]}, "b": {"instances": at}}, "instances": at}, "holds itself"
        yield {"objects": tri, "instances": [{"object": "b"}]}, "places 'b', which is none of its objects: 'a'"
        yield {"objects": tri, "instances": [{"object": "a", "matrix": [1] * 11}]}, "instances[0].matrix is no matrix"
        yield {"objects": tri, "instances": [{"object": "a", "matrix": [1] * 16}]}, "last row"
        yield {"objects": tri, "instances": [{"object": "a", "matrix": [0] * 12}]}, "singular"
        yield {"objects": tri, "instances": [{"object": "a", "translation": [1e30, 0, 0]}]}, "beyond 1e15"
        yield {"objects": tri, "instances": [{"object": "a", "translation": ["x", 0, 0]}]}, "no finite number"
        yield {"objects": tri, "instances": [{"object": "a", "rotation": [0, 0, 0, 0]}]}, "length 0"
        yield {"objects": tri, "instances": [{"object": "a", "scale": 2, "matrices": []}]}, "says twice where"
        yield {"objects": tri, "instances": [{"object": "a", "mask": "0xfffffffff"}]}, "instances[0].mask is no number"
        yield {"objects": tri, "instances": [{"object": "a", "matrices": "gone.npy"}]}, "no file 'gone.npy'"
        yield {"objects": tri, "instances": [{"object": "a", "matrices": "bad.npy"}]}, "(N, 3, 4)"
        yield {"objects": tri, "instances": at, "cameras": [{"eye": [0, 0, 0], "target": [0, 5, 0]}]}, "along its 'up'"
        lamp = {"type": "spot", "position": [0, 0, 0], "direction": [0, 0, 1]}
        for change, words in (({"type": "sun"}, "lights[0].type 'sun' is none of point, spot, directional"),
                              ({"direction": [0, 0, 0]}, "is no direction"), ({"intensity": -1}, "is not from 0 to 1e30"),
                              ({"intensity": 1e31}, "is not from 0 to 1e30"), ({"range": 1e300}, "is not from 0 to 1e30"),
                              ({"colour": [1, -1, 1]}, "negative or too bright"), ({"outer": 91}, "is not from 0 to 90"),
                              ({"inner": 50}, "wider than the 'outer'"), ({"type": "point"}, "has a 'direction'"),
                              ({"type": "directional"}, "has a 'position'"), ({"position": [1e30, 0, 0]}, "beyond 1e15"),
                              ({"colour": [1e30, 1, 1], "intensity": 1e30}, "too bright")):
            yield {"objects": tri, "instances": at, "lights": [{**lamp, **change}]}, words
        yield {"objects": tri, "instances": at, "lights": [{"type": "point", "position": [0, 0, 0], "inner": 1}]}, "no spot"
        # None of these files is there, and to look for each of them costs time.
        yield {"objects": {f"a{i}": {"file": f"{i}.obj"} for i in range(20000)}, "instances": []}, "names over"
        # Each level places the one below it a thousand times: 10^27 nodes with names of their own.
        many = [{"object": "", "matrices": [pose(i, 0, 0).tolist() for i in range(1000)]}]
        levels = {f"l{i}": {"instances": [{**many[0], "object": f"l{i - 1}" if i else "g"}]} for i in range(9)}
        yield {"objects": {"g": {"file": "two.gltf"}, **levels}, "instances": [{"object": "l8"}]}, "named nodes"

    def test_damaged_ones_are_refused_with_the_place(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        self.write("a.txt", "x")
        self.write("broken.ply", "ply\nformat ascii 1.0\n")
        self.write("two.gltf", gltf(TRIANGLE, np.array([[0, 1, 2]])))
        self.write("shape of.bin", binary(TRIANGLE, np.array([[0, 1, 2]])))
        np.save(self.scenes / "bad.npy", np.zeros((5, 7)))
        turned = np.eye(4)
        turned[3, 0] = 3
        np.save(self.scenes / "turned.npy", [np.eye(4), turned])
        np.save(self.scenes / "nan.npy", [np.diag([1, 1, 1, np.nan])])
        np.save(self.scenes / "flat.npy", np.eye(4)[:3].reshape(1, 12))
        np.save(self.scenes / "wide.npy", np.ones((2, 4, 3)))
        for data, words in self.refusals():
            with self.subTest(words):
                path = self.write("x.rnscene.json", data)
                done = self.client.run("load", path)
                self.assertEqual(done.returncode, 5, done)
                line, = done.stderr.splitlines()
                self.assertIn(words, line)
                with self.assertRaises(raynest.InvalidError) as caught:
                    self.python.load(path)
                self.assertIn(words, str(caught.exception))

    def test_user_ids_of_groups_of_one_and_of_many(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        self.write("one.gltf", gltf(TRIANGLE, np.array([[0, 1, 2]])))
        self.write("shape of.bin", binary(TRIANGLE, np.array([[0, 1, 2]])))
        self.write("inner.rnscene.json", {"objects": {"t": {"file": "a.obj"}}, "instances": [{"object": "t", "uid": 5}]})
        np.save(self.scenes / "table.npy", np.zeros((1, 3)))
        single = {"instances": [{"object": "t", "uid": 5}]}
        double = {"instances": [{"object": "t", "uid": 5}, {"object": "t", "uid": 6, "translation": [3, 0, 0]}]}
        alone = self.python.load(self.scenes / "one.gltf", replace=True).trace([.2, .2, 5, 0, 0, -1], fields=("uid",))["uid"][0]
        self.assertEqual(alone, 1)
        for name, objects, placed, wanted in (
                ("single", {"g": single}, {"object": "g"}, 5),
                ("twice", {"g": single}, {"object": "g", "matrices": [np.eye(4)[:3].tolist(), pose(0, 0, -1).tolist()]}, 5),
                ("deep", {"g": single, "h": {"instances": [{"object": "g"}]}}, {"object": "h"}, 5),
                ("double", {"g": double}, {"object": "g"}, 5),
                ("table", {"g": {"instances": [{"object": "t", "uid": 5, "matrices": "table.npy"}]}}, {"object": "g"}, 5),
                ("file", {"g": {"file": "inner.rnscene.json"}}, {"object": "g"}, 5),
                ("glTF", {"g": {"file": "one.gltf"}}, {"object": "g"}, alone),
                ("outer", {"g": single}, {"object": "g", "uid": 7}, 7),
                ("outer of many", {"g": double}, {"object": "g", "uid": 7}, 7)):
            with self.subTest(name):
                scene = self.load("x.rnscene.json", {"objects": {"t": {"file": "a.obj"}, **objects}, "instances": [placed]})
                self.assertEqual(scene.trace([.2, .2, 5, 0, 0, -1], fields=("uid",))["uid"][0], wanted)

    def test_coordinates_that_float32_rounds_are_told(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        far = [{"object": "t", "translation": [4_000_000.37, 0, 0]}]
        t = {"t": {"file": "a.obj"}}
        for data in ({"objects": t, "instances": far},
                     {"objects": {**t, "g": {"instances": far}}, "instances": [{"object": "g"}]}):
            with self.assertWarnsRegex(raynest.SceneWarning, "rounding to float32 moves .* 0.12, its size is 1"):
                self.load("x.rnscene.json", data)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.load("x.rnscene.json", {"objects": t, "instances": far, "origin": [4_000_000, 0, 0]})

    def test_options_of_a_load_that_it_says_itself(self):
        path = self.write("own.rnscene.json", self.town())
        for options in (["--unit", "mm"], ["--set-mask", "box=2"]):
            done = self.client.run("load", path, *options)
            self.assertEqual(done.returncode, 5, done)
            self.assertIn("it says itself", done.stderr)

    def test_files_of_nested_compositions_are_limited(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        for i in range(12):
            inner = f"c{i + 1}.rnscene.json" if i < 11 else "a.obj"
            self.write(f"c{i}.rnscene.json", {"objects": {"a": {"file": inner}}, "instances": [{"object": "a"}]})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with self.assertRaisesRegex(raynest.Error, "compositions nest deeper than 8"):
                self.python.load(self.scenes / "c0.rnscene.json")
            self.python.load(self.scenes / "c4.rnscene.json", replace=True)

    def test_the_order_of_objects_does_not_make_room_for_deeper_ones(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        for i in range(8):
            inner = f"d{i + 1}.rnscene.json" if i < 7 else "a.obj"
            self.write(f"d{i}.rnscene.json", {"objects": {"a": {"file": inner}}, "instances": [{"object": "a"}]})
        deep, shallow = {"file": "d0.rnscene.json"}, {"file": "d4.rnscene.json"}
        for objects in ({"one": shallow, "two": deep}, {"two": deep, "one": shallow}):
            with self.assertRaisesRegex(raynest.Error, "compositions nest deeper than 8"):
                self.load("both.rnscene.json", {"objects": objects, "instances": [{"object": name} for name in objects]})

    def test_groups_within_groups_are_limited(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        for depth in (33, 5000):
            groups = {f"g{i}": {"instances": [{"object": f"g{i + 1}"}]} for i in range(depth)}
            groups[f"g{depth}"] = {"file": "a.obj"}
            with self.assertRaisesRegex(raynest.Error, "groups nest deeper than 32"):
                self.load("deep.rnscene.json", {"objects": groups, "instances": [{"object": "g0"}]})

    def test_surveyed_parts_in_groups_keep_their_digits(self):
        self.write_parts()
        at = np.array([4_600_000.0, 100, 5_400_000])
        self.write("far.ply", ply(self.box[0] / 8 + at, self.box[1]))
        far = {"file": "far.ply", "origin": "auto"}
        self.write("inner.rnscene.json", {"objects": {"far": far}, "instances": [{"object": "far"}]})
        group = {"instances": [{"object": "far"}, {"object": "far", "translation": [0, 0.5, 0]}]}
        alone = self.load("alone.rnscene.json", {"origin": at.tolist(), "objects": {"far": far}, **group})
        aim = self.rays(3000, 0.2)[:, 3:]
        rays = np.hstack([at + RANDOM.uniform(-0.2, 0.2, (3000, 3)) - 3 * aim, aim])
        wanted = alone.trace(rays, fields=("t", "prim"))
        self.assertGreater(np.isfinite(wanted["t"]).sum(), 1000)
        inner = {"file": "inner.rnscene.json"}
        for objects, instances in (({"far": far, "both": group}, [{"object": "both"}]),
                                   ({"far": inner}, group["instances"])):
            scene = self.load("grouped.rnscene.json", {"origin": at.tolist(), "objects": objects, "instances": instances})
            hits = scene.trace(rays, fields=("t", "prim"))
            self.assertLess((hits["prim"] != wanted["prim"]).sum(), 6)
            self.assertLess((~np.isclose(hits["t"], wanted["t"], rtol=1e-4)).sum(), 6)

    def test_groups_far_from_zero_keep_their_own_coordinates(self):
        """An edit that places a group says where its zero is, near or far."""
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        for at in (5, 1000):
            scene = self.load("row.rnscene.json", {
                "objects": {"a": {"file": "a.obj"}, "row": {"instances": [{"object": "a", "translation": [at, 0, 0]}]}},
                "instances": [{"object": "row", "name": "st"}]})
            with scene.edit() as edit:
                edit.place("st", np.eye(3, 4))
            ray = [[at + 0.2, 0.2, 3, 0, 0, -1]]
            self.assertEqual(scene.trace(ray, fields=("t",))["t"], [3], at)
            with scene.edit() as edit:
                edit.move("st", np.diag([-1.0, 1, -1, 1]), frame="own")
            self.assertEqual(scene.trace([[-at - 0.2, 0.2, 3, 0, 0, -1]], fields=("t",))["t"], [3], at)

    def test_a_group_that_places_nothing_is_empty(self):
        self.write_parts()
        for places in ([], [{"object": "car", "matrices": []}]):
            scene = self.load("none.rnscene.json", {
                "objects": {"car": {"file": "cars/car.gltf"}, "none": {"instances": places}, "ball": {"file": "parts/ball.obj"}},
                "instances": [{"object": "none"}, {"object": "ball"}]})
            self.assertEqual(scene.info["instanced_triangles"], 60)

    def test_a_table_beside_records_and_heights_places_nothing(self):
        (self.scenes / "points").mkdir(exist_ok=True)
        np.save(self.scenes / "points/balls.npy", np.array([[0, 0, 0, 1.0], [5, 0, 0, 1]], np.float32))
        np.save(self.scenes / "points/ground.npy", np.zeros((8, 8), np.float32))
        np.save(self.scenes / "points/table.npy", np.array([[20.0, 0, 0], [30, 0, 0]]))
        scene = self.load("points/all.rnscene.json", {
            "objects": {"balls": {"file": "balls.npy", "primitive": "sphere"}, "ground": {"file": "ground.npy", "primitive": "heights"}},
            "instances": [{"object": "balls"}, {"object": "ground", "translation": [0, -9, 0]}]})
        down = [[x, 9.0, z, 0, -1, 0] for x, z in ((0, 0), (5, 0), (20, 0), (3, 3))]
        np.testing.assert_allclose(scene.trace(down, fields=("t",))["t"], [8, 8, np.inf, 18], rtol=1e-6)

    def test_a_composition_that_many_objects_name_is_made_once(self):
        self.write("a.obj", obj(TRIANGLE, np.array([[0, 1, 2]])))
        for i in range(7):  # 20^6 compositions if each object made its own
            objects = {f"o{k}": {"file": f"m{i + 1}.rnscene.json" if i < 6 else "a.obj"} for k in range(20)}
            self.write(f"m{i}.rnscene.json", {"objects": objects, "instances": [{"object": name} for name in objects]})
        scene = self.python.load(self.scenes / "m0.rnscene.json")
        self.assertEqual(scene.info["instanced_triangles"], 20 ** 7)


if __name__ == "__main__":
    main()
