#!/usr/bin/env python3
"""Animations: nodes, skins and targets of a glTF at any time, against float64; films; faults.

  animation_test.py RAYNESTD RAYNEST FLATC
"""
import json
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import raynest
from raynest._requests.explain import receive_document
from with_daemon import WithDaemon, main

TIMES = (0.0, 0.25, 0.5, 1.0, 1.375, 2.0)
TURN = [[0, 0, 0, 1], [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)], [0, 1, 0, 0]]  # 0, 90 and 180 degrees about y


class Gltf:
    """A glTF with one buffer."""

    def __init__(self):
        self.data = b""
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
                     "accessors": [], "bufferViews": [], "animations": []}

    def accessor(self, values, kind, component=5126):
        dtype = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[component]
        values = np.ascontiguousarray(values, dtype)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        count = values.size if kind == "SCALAR" else len(values)
        self.json["accessors"].append({"bufferView": len(self.json["bufferViews"]) - 1, "componentType": component,
                                       "count": count, "type": kind, "min": [], "max": []})
        for key in ("min", "max"):
            del self.json["accessors"][-1][key]
        if kind == "VEC3":
            self.json["accessors"][-1].update(min=values.min(0).tolist(), max=values.max(0).tolist())
        return len(self.json["accessors"]) - 1

    def mesh(self, corners, faces, **attributes):
        primitive = {"attributes": {"POSITION": self.accessor(corners, "VEC3")},
                     "indices": self.accessor(np.ravel(faces), "SCALAR", 5125)}
        primitive["attributes"].update(attributes)
        self.json["meshes"].append({"primitives": [primitive]})
        return len(self.json["meshes"]) - 1

    def node(self, root=True, **node):
        self.json["nodes"].append(node)
        if root:
            self.json["scenes"][0]["nodes"].append(len(self.json["nodes"]) - 1)
        return len(self.json["nodes"]) - 1

    def animate(self, name, *channels):
        """Channels are (node, path, times, values, interpolation)."""
        made = {"name": name, "channels": [], "samplers": []}
        for node, path, times, values, interpolation in channels:
            kind = {"rotation": "VEC4", "weights": "SCALAR"}.get(path, "VEC3")
            made["samplers"].append({"input": self.accessor(times, "SCALAR"), "output": self.accessor(values, kind),
                                     "interpolation": interpolation})
            made["channels"].append({"sampler": len(made["samplers"]) - 1, "target": {"node": node, "path": path}})
        self.json["animations"].append(made)

    def write(self, path):
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps({key: value for key, value in self.json.items() if value != []}).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + b"\0" * (-len(self.data) % 4)
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 28 + len(text) + len(data)) +
                         struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(data)) + b"BIN\0" + data)
        return path


CORNERS = np.array([[x, y, z] for x in (-.5, .5) for y in (0, .8) for z in (-.4, .4)])
FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]
MOVES = np.array([[0, 0, 0], [3, 1, 0], [3, 1, 4]], float)
CUBIC = np.array([[0, 0, 0], [0, 0, 0], [1, 2, 0], [0, 1, 0], [2, 2, 2], [-1, 0, 3], [1, 0, 1], [4, 0, 0], [0, 0, 0]], float)


def travelling():
    """A box on a turning arm, beside one that does not move and one that steps."""
    gltf = Gltf()
    mesh = gltf.mesh(CORNERS, FACES)
    box = gltf.node(root=False, name="box", mesh=mesh, translation=[1, 0, 0])
    arm = gltf.node(name="arm", children=[box], translation=[0, .5, 0])
    gltf.node(name="still", mesh=mesh, translation=[-4, 0, 0])
    step = gltf.node(name="step", mesh=mesh, translation=[0, 0, -4])
    curve = gltf.node(name="curve", mesh=mesh, scale=[1, 2, 1])
    gltf.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": .1}}]
    eye = gltf.node(name="eye", camera=0, translation=[0, 2, 9])
    gltf.animate("Drive", (arm, "rotation", [0, 1, 2], TURN, "LINEAR"), (arm, "translation", [0, 1, 2], MOVES, "LINEAR"),
                 (step, "translation", [.5, 1.5], [[0, 0, -4], [0, 3, -4]], "STEP"),
                 (curve, "translation", [0, 1, 2], CUBIC, "CUBICSPLINE"),
                 (eye, "translation", [0, 2], [[0, 2, 9], [5, 2, 9]], "LINEAR"))
    gltf.animate("Rest", (step, "scale", [0, .5], [[1, 1, 1], [2, 2, 2]], "LINEAR"))
    return gltf


def matrix(t, q, s):
    x, y, z, w = np.asarray(q, float) / np.linalg.norm(q)
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn * s, t
    return made


def linear(times, values, t):
    return np.array([np.interp(t, times, column) for column in np.asarray(values, float).T])


def slerp(t):
    """TURN at a time: so many degrees about y."""
    angle = np.pi / 2 * t
    return [0, np.sin(angle / 2), 0, np.cos(angle / 2)]


def hermite(t):
    """CUBIC at a time (glTF 2.0, appendix C.5)."""
    i = min(int(t), 1)
    u, (a, leaves), (arrives, b) = t - i, CUBIC[3 * i + 1:3 * i + 3], CUBIC[3 * i + 3:3 * i + 5]
    return ((2 * u**3 - 3 * u**2 + 1) * a + (u**3 - 2 * u**2 + u) * leaves + (3 * u**2 - 2 * u**3) * b +
            (u**3 - u**2) * arrives)


def poses(t):
    """The outermost placements at a time, by the name of their node."""
    arm = matrix(linear([0, 1, 2], MOVES, t), slerp(t), [1, 1, 1])
    return {"arm/box": arm @ matrix([1, 0, 0], [0, 0, 0, 1], [1, 1, 1]),
            "still": matrix([-4, 0, 0], [0, 0, 0, 1], [1, 1, 1]),
            "step": matrix([0, 3 if t >= 1.5 else 0, -4], [0, 0, 0, 1], [1, 1, 1]),
            "curve": matrix(hermite(t), [0, 0, 0, 1], [1, 2, 1])}


def rays_at(points, normals):
    """A ray to each point, from a little way off."""
    rays = np.zeros((len(points), 8), np.float32)
    rays[:, :3], rays[:, 4:7], rays[:, 7] = points + .25 * normals, -normals, np.inf
    return rays


RNG = np.random.default_rng(5)
RAIN = np.zeros((4000, 8), np.float32)
RAIN[:, :3] = RNG.uniform((-6, -1, -6), (6, 6, 10), (4000, 3))
RAIN[:, 4:7] = RNG.normal(size=(4000, 3))
RAIN[:, 7] = np.inf


class Animation(WithDaemon):
    def load(self, gltf, name, **options):
        with tempfile.TemporaryDirectory() as folder:
            return self.client.load(str(gltf.write(Path(folder) / f"{name}.glb")), replace=True, **options)

    def same_hits(self, at, scene, time, fresh, **options):
        """Bit for bit, and some of each."""
        fields = ("t", "prim", "path", "ng", "position")
        played, loaded = (each.trace(RAIN, fields=fields, **more) for each, more in ((scene, {"time": time, **options}),
                                                                                    (fresh, {})))
        self.assertGreater(np.isfinite(played["t"]).sum(), 50)
        for field in fields:
            np.testing.assert_array_equal(played[field], loaded[field], f"{at}: {field}")

    def test_info_names_them(self):
        info = self.load(travelling(), "drive").info
        self.assertEqual(info["animations"], ["Drive", "Rest"])
        self.assertEqual(info["animation_seconds"], [2.0, .5])

    def test_the_end_is_where_the_file_says(self):
        gltf = Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES))
        gltf.animate("", (box, "translation", [0, .7], [[0, 0, 0], [0, 1, 0]], "LINEAR"))  # 0.7 in float32 is less
        scene = self.load(gltf, "short")
        self.assertLess(scene.info["animation_seconds"][0], .7)
        down = np.array([[0, 5, 0, 0, -1, 0]])
        self.assertAlmostEqual(float(scene.trace(down, time=.7)["t"][0]), 5 - 1.8, delta=1e-5)
        for time in (.7001, -1e-3):
            with self.assertRaisesRegex(raynest.Error, "is outside it"):
                scene.trace(down, time=time)
        with self.assertRaisesRegex(raynest.Error, "no animation 'x'; it has number 0"):
            scene.trace(down, time=.5, animation="x")

    def test_the_automatic_camera_of_a_film_stands_still(self):
        gltf = Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES))
        gltf.animate("Come", (box, "translation", [0, 1], [[0, 0, 0], [.3, .2, 0]], "LINEAR"))
        scene = self.load(gltf, "coming")
        options = {"size": (48, 36), "integrator": "ao", "spp": 1}
        told = []
        for time in (None, 0, 1):
            layers = scene.render(**options, **({} if time is None else {"time": time, "animation": "Come"}))
            told.append((layers.texts["raynest:camera_to_world"], layers.texts.get("raynest:time"),
                         layers.texts.get("raynest:animation"), np.asarray(layers["rgba"])))
        self.assertEqual([camera for camera, *_ in told], [told[0][0]] * 3)
        self.assertEqual([tuple(words) for _, *words, _ in told], [(None, None), ("0", "Come"), ("1", "Come")])
        np.testing.assert_array_equal(told[1][-1], told[0][-1])
        self.assertTrue((told[2][-1] != told[1][-1]).any())
        with tempfile.TemporaryDirectory() as folder:
            note = self.cli.run("heatmap", "coming", "--time", "0.5", "--size", "8x8", "-o", Path(folder) / "a.png")
        self.assertIn("the scene is at a moment of its animation: its trees", note.stderr)

    def test_box_and_placements_at_a_moment(self):
        scene = self.load(travelling(), "drive")
        loaded = scene.info
        for time in TIMES:
            with self.subTest(time=time):
                wanted = {}
                for name, to_world in poses(time).items():
                    corners = CORNERS @ to_world[:3, :3].T + to_world[:3, 3]
                    wanted[name] = np.array([corners.min(0), corners.max(0)])
                whole = np.array([min(box[0][i] for box in wanted.values()) for i in range(3)]
                                 + [max(box[1][i] for box in wanted.values()) for i in range(3)])
                for info in (scene.info_at(time), scene.info_at(time, "Drive"), scene.info_at(time, 0),
                             self.cli.json("info", "drive", "--time", time)):
                    np.testing.assert_allclose([*info["box_min"], *info["box_max"]], whole, atol=1e-5)
                    for same in ("hash", "epoch", "refits", "rebuilds", "animations"):
                        self.assertEqual(info[same], loaded[same])
                document, _ = receive_document(self.client.connection, "Structure",
                                               {"scene": "drive", "kind": "placements", "timed": True, "time": time},
                                               None, 0.0, None)
                self.assertEqual({row["name"] for row in document["rows"]}, set(wanted))
                for row in document["rows"]:
                    box = np.reshape(row["box"], (2, 3))
                    # It holds the box of the mesh, turned, which is larger than what is in it.
                    self.assertTrue((box[0] <= wanted[row["name"]][0] + 1e-5).all(), row)
                    self.assertTrue((box[1] >= wanted[row["name"]][1] - 1e-5).all(), row)
                    np.testing.assert_allclose(box.mean(0), wanted[row["name"]].mean(0), atol=1e-5)
        self.assertEqual(scene.info, loaded)
        said = self.cli.run("info", "drive", "--time", "2").stdout
        self.assertIn("moment       2.0 s of its animation", said)
        for words, arguments in (("runs from 0 to 2", ("--time", "2.5")), ("no animation 'x'; it has 'Drive', 'Rest'",
                                 ("--time", "1", "--animation", "x")), ("--time", ("--animation", "Rest")),
                                 ("excludes", ("--time", "1", "--meshes"))):
            refused = self.cli.run("info", "drive", *arguments)
            self.assertEqual(refused.returncode, 2, refused.stderr)
            self.assertIn(words, refused.stderr)

    def test_a_file_whose_z_points_up_plays_as_it_is_loaded(self):
        gltf = travelling()
        gltf.json["scenes"][0]["extras"] = {"raynest": {"up": "z"}}
        turned, scene = self.load(gltf, "turned"), self.load(travelling(), "drive")
        for time in TIMES:
            at = [np.reshape([*each.info_at(time)["box_min"], *each.info_at(time)["box_max"]], (2, 3))
                  for each in (turned, scene)]
            np.testing.assert_allclose(at[0][:, [0, 2]], at[1][:, [0, 1]], atol=1e-5)
            np.testing.assert_allclose(at[0][:, 1], -at[1][::-1, 2], atol=1e-5)
        np.testing.assert_allclose(turned.info["box_min"], turned.info_at(0)["box_min"], atol=1e-5)

    def test_a_table_of_targets_that_a_small_file_asks_for_is_refused(self):
        gltf = Gltf()
        mesh = gltf.mesh(CORNERS, FACES)
        primitive = gltf.json["meshes"][mesh]["primitives"][0]
        gltf.json["meshes"][mesh]["primitives"] = [{**primitive, "mode": 0} for _ in range(2000)]
        gltf.json["meshes"][mesh]["primitives"][0]["targets"] = [{} for _ in range(2000)]
        node = gltf.node(name="box", mesh=mesh)
        gltf.animate("", (node, "weights", [0], np.zeros(2000), "LINEAR"))
        with self.assertRaisesRegex(raynest.Error, "decode to more than"):  # 2,000 targets of 2,000 parts
            self.load(gltf, "targets")

    def test_nodes_are_where_float64_says_and_hits_equal_those_of_a_scene_loaded_there(self):
        scene = self.load(travelling(), "drive")
        before = scene.trace(RAIN, fields=("t",))["t"]
        for time in TIMES:
            with self.subTest(time=time):
                for name, to_world in poses(time).items():
                    top = (to_world @ [0, .8, 0, 1])[:3]
                    # The middle of the box's top, met from above.
                    hit = scene.trace(rays_at(top[None], np.array([[0, 1., 0]])), fields=("t", "path"), time=time)
                    self.assertEqual(scene.path_of(int(hit["path"][0])), name)
                    self.assertAlmostEqual(float(hit["t"][0]), .25, delta=1e-5)
                if time not in (0.0, 1.0, 2.0):
                    continue
                # At keys the numbers are those of the file, so the bits are those of a load.
                still = travelling()
                del still.json["animations"]
                for node in still.json["nodes"]:
                    if node["name"] == "arm":
                        node.update(rotation=np.float32(TURN[int(time)]).tolist(), translation=linear([0, 1, 2], MOVES, time).tolist())
                    elif node["name"] == "step":
                        node["translation"] = [0, 3 if time >= 1.5 else 0, -4]
                    elif node["name"] == "curve":
                        node["translation"] = hermite(time).tolist()
                self.same_hits(time, scene, time, self.load(still, "still"))
        np.testing.assert_array_equal(scene.trace(RAIN, fields=("t",))["t"], before)  # it is as it was

    def test_the_other_animation_by_name_and_number(self):
        scene = self.load(travelling(), "drive")
        top = rays_at(np.array([[0, 1.6, -4.]]), np.array([[0, 1., 0]]))
        for animation in ("Rest", "1", 1):
            self.assertAlmostEqual(float(scene.trace(top, time=.5, animation=animation)["t"][0]), .25, delta=1e-5)

    def test_cameras_move(self):
        scene = self.load(travelling(), "drive")
        still, moved = (scene.render(size=(64, 48), time=time) for time in (0.0, 2.0))
        self.assertFalse(np.array_equal(still, moved))
        eye = scene.render(size=(64, 48), time=2.0, look_at=((5, 2, 9), (5, 2, 8)), fov=np.degrees(1))
        self.assertLess((np.abs(moved.astype(int) - eye).max(axis=-1) > 2).mean(), .02)

    def test_an_edit_says_which_animations_it_loses(self):
        self.load(travelling(), "drive")
        scene = self.client.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="still", keep=True)
        with scene.edit() as edit:
            edit.add("drive", (5, 0, 0), name="car")
        self.assertEqual(edit.notes, ["the animations of 'car' do not play here: what an edit adds is moved by edits"])
        with scene.edit() as edit:
            edit.move("car", (0, 1, 0))
        self.assertEqual(edit.notes, [])
        # However many there are, and whatever they are called.
        with scene.edit() as edit:
            for number in range(500):
                edit.add("drive", (5, number, 0), name=f"{number} " + 80 * "n")
            edit.add("drive", name=4000 * "x")
        self.assertEqual(len(edit.notes), 1)
        self.assertLess(len(edit.notes[0]), 300)
        self.assertRegex(edit.notes[0], "n' and 500 more do not play here")

    def test_lights_move(self):
        gltf = Gltf()
        gltf.node(name="floor", mesh=gltf.mesh(np.array([[-5, 0, -3], [5, 0, -3], [5, 0, 3], [-5, 0, 3]], float), [[0, 2, 1], [0, 3, 2]]))
        lamp = gltf.node(name="lamp", translation=[-4, 1, 0], extensions={"KHR_lights_punctual": {"light": 0}})
        gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 50}]}}
        gltf.json["extensionsUsed"] = ["KHR_lights_punctual"]
        gltf.animate("Carry", (lamp, "translation", [0, 2], [[-4, 1, 0], [4, 1, 0]], "LINEAR"))
        scene = self.load(gltf, "torch")
        for time, brightest in ((None, -4), (0.0, -4), (1.0, 0), (2.0, 4)):
            seen = scene.render(look_at=((0, 12, 0), (0, 0, 0), (0, 0, -1)), fov=60, size=(96, 64), integrator="direct",
                                environment="none", spp=1, encode="raw", **({} if time is None else {"time": time}))
            row = np.asarray(seen, float)[32, :, :3].sum(axis=1)
            place = (np.argmax(row) + .5 - 48) / 64 * 2 * 12 * np.tan(np.radians(30))
            self.assertAlmostEqual(place, brightest, delta=.5, msg=f"at {time}")

    def skinned(self, morph):
        """A strip of two segments that bends at its middle, or grows by targets."""
        gltf = Gltf()
        n = 24
        x, z = np.meshgrid(np.linspace(0, 2, n), np.linspace(-.5, .5, n), indexing="ij")
        corners = np.stack([x, np.zeros_like(x), z], -1).reshape(-1, 3)
        faces = [[i * n + j, i * n + j + 1, (i + 1) * n + j] for i in range(n - 1) for j in range(n - 1)]
        faces += [[(i + 1) * n + j, i * n + j + 1, (i + 1) * n + j + 1] for i in range(n - 1) for j in range(n - 1)]
        share = np.clip(corners[:, 0] - .5, 0, 1)
        normals = np.tile([0., 1, 0], (len(corners), 1))
        if morph:
            lift, slide = np.zeros_like(corners), np.zeros_like(corners)
            lift[:, 1], slide[:, 0] = share, 1.5
            mesh = gltf.mesh(corners, faces, NORMAL=gltf.accessor(normals, "VEC3"))
            gltf.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": gltf.accessor(each, "VEC3")} for each in (lift, slide)]
            gltf.json["meshes"][0]["weights"] = [0, .25]
            node = gltf.node(name="strip", mesh=mesh, translation=[0, 1, 0])
            gltf.animate("Wave", (node, "weights", [0, 1, 2], [0, .25, 1, 0, 2, 1], "LINEAR"))

            def expected(t):
                weights = linear([0, 1, 2], [[0, .25], [1, 0], [2, 1]], t)
                return corners + weights[0] * lift + weights[1] * slide + (0, 1, 0)
            return gltf, expected, np.array(faces)
        weights = np.stack([1 - share, share, share * 0, share * 0], -1)
        joints = np.tile([0, 1, 0, 0], (len(corners), 1))
        mesh = gltf.mesh(corners, faces, NORMAL=gltf.accessor(normals, "VEC3"),
                         JOINTS_0=gltf.accessor(joints, "VEC4", 5123), WEIGHTS_0=gltf.accessor(weights, "VEC4"))
        tip = gltf.node(root=False, name="tip", translation=[1, 0, 0])
        foot = gltf.node(name="foot", children=[tip], translation=[0, .5, 0])
        bind = np.stack([np.eye(4).T, matrix([-1, 0, 0], [0, 0, 0, 1], [1, 1, 1]).T])
        gltf.json["skins"] = [{"joints": [foot, tip], "inverseBindMatrices": gltf.accessor(bind.reshape(2, 16), "MAT4")}]
        gltf.node(name="strip", mesh=mesh, skin=0)
        bend = [[0, 0, 0, 1], [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)], [0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)]]
        gltf.animate("Bend", (tip, "rotation", [0, 1, 2], bend, "LINEAR"), (foot, "translation", [0, 2], [[0, .5, 0], [1, .5, 0]], "LINEAR"))

        def expected(t):
            angle = np.pi / 4 * t
            at_foot = matrix([t / 2, .5, 0], [0, 0, 0, 1], [1, 1, 1])
            at_tip = at_foot @ matrix([1, 0, 0], [0, 0, np.sin(angle / 2), np.cos(angle / 2)], [1, 1, 1])
            maps = np.stack([at_foot, at_tip @ matrix([-1, 0, 0], [0, 0, 0, 1], [1, 1, 1])])
            points = np.concatenate([corners, np.ones((len(corners), 1))], 1)
            return np.einsum("vj,jab,vb->va", weights[:, :2], maps, points)[:, :3]
        return gltf, expected, np.array(faces)

    def test_skins_and_targets_are_where_float64_says(self):
        for morph in (False, True):
            gltf, expected, faces = self.skinned(morph)
            scene = self.load(gltf, "strip")
            for time in TIMES:
                with self.subTest(morph=morph, time=time):
                    corners = expected(time)[faces]
                    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
                    hits = scene.trace(rays_at(corners.mean(1), normals), fields=("t", "prim", "ng"), time=time)
                    np.testing.assert_array_equal(hits["prim"], np.arange(len(faces)))
                    np.testing.assert_allclose(hits["t"], .25, atol=1e-5)
                    np.testing.assert_allclose(np.abs((hits["ng"] * normals).sum(1)), 1, atol=1e-3)

    def test_the_first_pose_equals_the_scene_as_it_was_loaded(self):
        for morph in (False, True):
            scene = self.load(self.skinned(morph)[0], "strip")
            for column in ("t", "prim", "ng", "position"):
                np.testing.assert_array_equal(scene.trace(RAIN, fields=(column,), time=0)[column],
                                              scene.trace(RAIN, fields=(column,))[column])

    def test_pictures_and_heat_maps_have_a_time(self):
        scene = self.load(travelling(), "drive")
        for answer in (lambda **o: scene.render(size=(64, 48), integrator="direct", spp=2, encode="raw", **o),
                       lambda **o: scene.heatmap(size=(64, 48), **o)):
            self.assertTrue(np.array_equal(answer(time=.5), answer(time=.5)))
            self.assertFalse(np.array_equal(answer(), answer(time=1.0)))

    def test_an_edit_of_what_does_not_move_is_there_at_each_time(self):
        scene = self.load(travelling(), "drive")
        ray = rays_at(np.array([[-4, 5.8, 0.]]), np.array([[0, 1., 0]]))
        self.assertFalse(np.isfinite(scene.trace(ray, time=1.0)["t"][0]) and scene.trace(ray, time=1.0)["t"][0] < 1)
        with scene.edit() as edit:
            edit.move("still", (0, 5, 0))
            edit.remove("step")
        self.assertAlmostEqual(float(scene.trace(ray, time=1.0)["t"][0]), .25, delta=1e-5)
        for name, to_world in poses(1.0).items():
            if name in ("arm/box", "curve"):  # whose numbers the removed one has changed
                top = rays_at((to_world @ [0, .8, 0, 1])[:3][None], np.array([[0, 1., 0]]))
                hit = scene.trace(top, fields=("t", "path"), time=1.0)
                self.assertEqual(scene.path_of(int(hit["path"][0])), name)

    def test_the_daemon_keeps_the_last_few_alone(self):
        scene = self.load(self.skinned(True)[0], "strip")
        for time in np.linspace(0, 1, 6):
            scene.trace(RAIN[:8], time=float(time))
        stats = self.client.stats()
        self.assertGreaterEqual(stats["memory_used_bytes"], stats["scene_bytes"] + 4 * scene.info["bytes"])
        for time in np.linspace(1.1, 2, 12):
            scene.trace(RAIN[:8], time=float(time))
        self.assertLess(self.client.stats()["memory_used_bytes"], stats["scene_bytes"] + 5 * scene.info["bytes"])

    def test_what_cannot_be_is_refused_in_one_line(self):
        scene = self.load(travelling(), "drive")
        still = self.client.load("builtin:flake?depth=1", "still", replace=True)
        for on, options, says in ((scene, {"time": -1}, "runs from 0 to 2 s; -1 is outside"),
                                  (scene, {"time": 2.5}, "2.5 is outside"), (scene, {"time": float("nan")}, "finite"),
                                  (scene, {"time": 0, "animation": "Walk"}, "it has 'Drive', 'Rest'"),
                                  (scene, {"time": 0, "animation": "2"}, "no animation '2'"),
                                  (scene, {"animation": "Rest"}, "no moment"), (still, {"time": 0}, "no animation")):
            with self.subTest(options=options), self.assertRaises(raynest.Error) as caught:
                on.trace(RAIN[:1], **options)
            self.assertIn(says, str(caught.exception))

    def test_damaged_channels_are_left_out_and_the_scene_stays(self):
        for damage, says in ((lambda a: a["channels"][0]["target"].update(path="colour"), "does not move"),
                             (lambda a: a["channels"][0]["target"].update(node=99), "lacks"),
                             (lambda a: a["samplers"][0].update(output=0), "keys cannot be read"),
                             (lambda a: a["samplers"][0].update(interpolation="WILD"), "keys cannot be read"),
                             (lambda a: a["channels"][0].update(sampler=77), "no sampler")):
            gltf = travelling()
            damage(gltf.json["animations"][0])
            info = self.load(gltf, "damaged").info
            self.assertTrue(any(says in line for line in info["warnings"]), info["warnings"])
            self.assertEqual(info["animations"], ["Drive", "Rest"])

    def test_a_film_and_its_pictures(self):
        with tempfile.TemporaryDirectory() as folder:
            source = travelling().write(Path(folder) / "drive.glb")
            run = lambda *words: subprocess.run([str(Path(self.raynest).resolve()), "--local", *words], capture_output=True, text=True, cwd=folder)
            made = run("animate", str(source), "-o", "frame.png", "--fps", "4", "--to", "1", "--size", "64x48")
            self.assertEqual((made.returncode, made.stderr), (0, ""))
            pictures = [raynest.images.read_png(path) if hasattr(raynest.images, "read_png") else path.read_bytes()
                        for path in sorted(Path(folder).glob("frame.*.png"))]
            self.assertEqual(len(pictures), 5)
            self.assertEqual(len({bytes(each) if isinstance(each, bytes) else each.tobytes() for each in pictures}), 5)
            if shutil.which("ffmpeg") is None:
                made = run("animate", str(source), "-o", "film.mp4", "--size", "64x48")
                self.assertIn("apt install ffmpeg", made.stderr)
                return
            made = run("animate", str(source), "-o", "film.mp4", "--fps", "4", "--size", "65x49")
            self.assertEqual((made.returncode, made.stderr), (0, ""))
            self.assertGreater((Path(folder) / "film.mp4").stat().st_size, 500)


if __name__ == "__main__":
    main()
