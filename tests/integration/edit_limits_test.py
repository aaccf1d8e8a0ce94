#!/usr/bin/env python3
"""Edits and poses that stand for more than the daemon may take: refused before they are made, whatever few bytes ask
for them.

  edit_limits_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import struct
import sys
import tempfile

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import DaemonTest, IMPORTS_GROW, main, skip_sanitized

MEMORY = 512 << 20
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]


def skinned(side, nodes):
    """A glTF of a grid of side x side vertices, placed by so many nodes, whose one joint moves for a second."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    corner = np.arange(side * side).reshape(side, side)
    a, b, c, d = (corner[i:i + side - 1, j:j + side - 1].ravel() for i in (0, 1) for j in (0, 1))
    weights = np.zeros((side * side, 4))
    weights[:, 0] = 1
    arrays = ((np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1).astype("<f4"), 5126, "VEC3"),
              (np.concatenate([np.stack([a, b, c], 1), np.stack([d, c, b], 1)]).ravel().astype("<u4"), 5125, "SCALAR"),
              (np.zeros((side * side, 4), "u1"), 5121, "VEC4"), (weights.astype("<f4"), 5126, "VEC4"),
              (np.array([0, 1], "<f4"), 5126, "SCALAR"), (np.array([[0, 0, 0], [0, 0, 5]], "<f4"), 5126, "VEC3"))
    blob, views, accessors = b"", [], []
    for number, (array, kind, shape) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes})
        bounds = {"min": np.atleast_1d(array.min(0)).tolist(), "max": np.atleast_1d(array.max(0)).tolist()}
        accessors.append({"bufferView": number, "componentType": kind, "count": len(array), "type": shape, **bounds})
        blob += array.tobytes() + bytes(-array.nbytes % 4)
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(nodes + 1))}],
        "nodes": [{"name": "joint"}, *({"name": f"n{i}", "mesh": 0, "skin": 0} for i in range(nodes))],
        "skins": [{"joints": [0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}, "indices": 1}]}],
        "animations": [{"channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
                        "samplers": [{"input": 4, "output": 5}]}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(blob)}]}).encode()
    text += b" " * (-len(text) % 4)
    return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(blob), b"BIN\0") + blob)


class Limited(DaemonTest):
    arguments = ("--memory", "512M")

    def setUp(self):
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)

    def check_refused(self, scene, says, change):
        before = scene.info["epoch"]
        with self.assertRaisesRegex(raynest.Error, says), scene.edit() as edit:
            change(edit)
        self.assertEqual(self.python.scene(scene.name).info["epoch"], before)
        self.check_memory()

    def check_memory(self):
        self.assertLess(self.daemon.resident_bytes("VmHWM"), MEMORY)
        self.assertLess(self.client.json("stats")["memory_used_bytes"], MEMORY)


class EditLimits(Limited):
    def test_memory_that_is_kept_for_speed_gives_way(self):
        """Each edited scene keeps its epoch before, whose memory the next edit takes; together they would be too much."""
        scenes = [self.python.load(f"builtin:forest?trees={10_000 + i}", f"woods-{i}") for i in range(18)]
        self.assertGreater(2 * sum(scene.info["bytes"] for scene in scenes), 0.7 * MEMORY)
        for turn in range(3):
            for scene in scenes:
                with scene.edit() as edit:
                    edit.move(0, (0, 0.5, 0))
                self.assertEqual(edit.epoch, turn + 2)
        self.check_memory()
        for scene in scenes:
            scene.unload()

    def test_user_ids_of_all_that_a_forest_places(self):
        forest = self.python.load("builtin:forest?trees=500000", "large")
        self.check_refused(forest, "user ids of more than 1048576", lambda edit: edit.set_uid("*", 5))

    def test_names_of_what_is_added(self):
        forest = self.python.load("builtin:forest?trees=360", "forest")
        base = self.python.scene_of({"t": TRIANGLE}, name="base")
        self.check_refused(base, "the changed scene takes 2.* GiB",
                           lambda edit: edit.add(forest, np.zeros((500, 3)), "f"))
        # Fewer are made, and counted.
        with base.edit() as edit:
            edit.add(forest, np.zeros((3, 3)), "f")
        self.check_memory()
        self.assertEqual(base.path_of(base.path_ids("f#2/birch-1/leaves#0")), "f#2/birch-1/leaves#0")

    def test_a_material_of_countless_spheres(self):
        flake = self.python.load("builtin:flake?depth=16", "flake")
        path = self.out / "few.obj"
        (self.out / "few.mtl").write_text("newmtl red\n")
        path.write_text("mtllib few.mtl\no t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\no u\nf 1 3 2\n")
        base = self.python.load(path)
        with base.edit() as edit:
            edit.add(flake, name="f")
        self.check_refused(base, "without triangles", lambda edit: edit.set_material("f", 0))
        with base.edit() as edit:
            edit.set_material("t", 0)

    def test_many_changes_of_many_instances(self):
        parts = self.python.scene_of({"t": TRIANGLE}, {"t": ("t", np.random.default_rng(1).random((100_000, 3)))}, name="many")

        def change(edit):
            for _ in range(20):
                edit.move("*", (1, 0, 0))
                edit.set_mask("*", 3)

        with parts.edit() as edit:
            change(edit)
        self.check_memory()
        self.assertEqual(edit.instances, 100_000)


class MeshesAtManyPlaces(Limited):
    def test_a_mesh_that_changes_at_each_of_its_places(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "skin.glb"
            path.write_bytes(skinned(300, 40))
            scene = self.python.load(path)
        rays = [[1, 1, 9, 0, 0, -1]]
        with scene.edit() as edit:
            edit.add(scene, (50, 0, 0), "again")
        # A pose changes all of them alike, so that it takes one copy.
        np.testing.assert_allclose(scene.trace(rays, time=0.25)["t"], [7.75])
        self.check_memory()
        x, y = np.meshgrid(np.arange(300.), np.arange(300.))
        vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)

        def change(edit):
            for place in range(20):
                edit.set_vertices(place, vertices + (0, 0, place))
        self.check_refused(scene, "the changed scene", change)


if __name__ == "__main__":
    main()
