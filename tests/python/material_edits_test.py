#!/usr/bin/env python3
"""Edits of materials: of the meshes at the named places, and of nothing else.

  material_edits_test.py RAYNESTD RAYNEST FLATC
"""
import pathlib
import tempfile

import numpy as np

import raynest
from animation_test import Gltf
from with_daemon import WithDaemon, main

CORNERS = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]
MATERIALS = [{"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}},
             {"name": "blue", "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 1, 1]}},
             {"name": "lamp", "emissiveFactor": [1, 1, 1]},
             {"name": "glass", "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, .5]}},
             {"name": "twice"}, {"name": "twice"}]
RED, BLUE, LAMP = 0, 1, 2
SQUARES = {"a": -9, "b": -6, "c": -3, "pair/left": 0, "pair/right": 3, "pane": 6}   # their x


def file_of(folder, materials):
    """Squares by name: a, b, c share a mesh, and so do the two of a group; a pane is of glass."""
    gltf = Gltf()
    meshes = []
    for material in materials:
        meshes.append(gltf.mesh(CORNERS, FACES))
        gltf.json["meshes"][-1]["primitives"][0]["material"] = material
    gltf.json["materials"] = MATERIALS
    for name in "abc":
        gltf.node(name=name, mesh=meshes[0], translation=[SQUARES[name], 0, 0])
    pair = [gltf.node(root=False, name=name, mesh=meshes[1], translation=[SQUARES[f"pair/{name}"], 0, 0])
            for name in ("left", "right")]
    gltf.node(name="pair", children=pair)
    gltf.node(name="pane", mesh=meshes[2], translation=[SQUARES["pane"], 0, 0])
    return gltf.write(pathlib.Path(folder) / "squares.glb")


class MaterialEdits(WithDaemon):
    def load(self, name="squares", materials=(RED, RED, 3)):
        with tempfile.TemporaryDirectory() as folder:
            return self.client.load(str(file_of(folder, materials)), name, replace=True)

    def seen(self, scene):
        """The material of each square, and all else that rays find."""
        rays = np.array([[x + .3, .2, 9, 0, 0, -1] for x in SQUARES.values()])
        found = scene.trace(rays, fields=("material", "t", "prim", "path", "uv", "base_colour"))
        return dict(zip(SQUARES, found["material"].tolist())), found

    def test_meshes_that_change_alike_become_one(self):
        scene = self.load()
        meshes = scene.info["meshes"]
        with scene.edit() as edit:
            edit.set_material(["a", "c"], "blue")
            edit.set_vertices("pair", np.array(CORNERS) * .5)
        self.assertEqual(scene.info["meshes"], meshes + 1)
        self.assertEqual([self.seen(scene)[0][name] for name in "abc"], [BLUE, RED, BLUE])
        with scene.edit() as edit:
            edit.set_vertices(["a", "b"], np.array(CORNERS) * .2)
        self.assertEqual(scene.info["meshes"], meshes + 2)  # a has one, b and c keep theirs
        # Within groups that are placed many times, too.
        street = self.client.load("builtin:street?cars=12", "painted", replace=True)
        cars, before = [f"car-{number}" for number in range(0, 12, 2)], street.info
        rays = np.random.default_rng(3).uniform(-60, 60, (20000, 6))
        rays[:, 1], rays[:, 3:] = 30, (0, -1, 0)
        was = street.trace(rays, fields=("t", "path", "material"))
        with street.edit() as edit:
            edit.set_material(cars, "blue")
        self.assertLess(street.info["meshes"], 2 * before["meshes"])
        self.assertLess(street.info["bytes"], 2 * before["bytes"])
        now = street.trace(rays, fields=("t", "path", "material"))
        for name in ("t", "path"):
            np.testing.assert_array_equal(now[name], was[name], name)
        painted = np.array([text.split("/")[0] in cars for text in street.path_of(now["path"])])
        self.assertGreater(painted.sum(), 10)
        np.testing.assert_array_equal(now["material"][~painted], was["material"][~painted])
        self.assertEqual(len(np.unique(now["material"][painted])), 1)

    def test_of_some_placements_of_a_mesh_and_of_all(self):
        scene = self.load()
        was, before = self.seen(scene)
        self.assertEqual(was, {**dict.fromkeys(SQUARES, RED), "pane": 3})
        with scene.edit() as edit:
            edit.set_material("b", "blue")
        self.assertEqual(edit.instances, 1)
        now, after = self.seen(scene)
        self.assertEqual(now, {**was, "b": BLUE})
        for name in ("t", "prim", "path", "uv"):
            np.testing.assert_array_equal(after[name], before[name], name)
        np.testing.assert_array_equal(after["base_colour"][1], [0, 0, 1])
        # All placements of one mesh keep sharing it: the scene does not grow.
        grown = scene.info["bytes"]
        with scene.edit() as edit:
            edit.set_material("pair*", BLUE)
        self.assertEqual(self.seen(scene)[0], {**was, "b": BLUE, "pair/left": BLUE, "pair/right": BLUE})
        self.assertEqual(scene.info["bytes"], grown)
        # The last one of a batch counts, and what is of its own does not grow again.
        with scene.edit() as edit:
            edit.set_material("b", "blue").set_material("b", "red").set_material("pair", "red")
        self.assertEqual(self.seen(scene)[0], was)
        self.assertEqual(scene.info["bytes"], grown)

    def test_pictures_are_those_of_a_scene_loaded_so(self):
        scene, wanted = self.load(), self.load("wanted", (LAMP, BLUE, 3))
        with scene.edit() as edit:
            edit.set_material(["a", "b", "c"], "lamp").set_material("pair", "blue")
        for options in ({}, {"integrator": "path", "spp": 4, "environment": "none"}):
            made, other = (each.render(size=(64, 64), **options) for each in (scene, wanted))
            if options:
                made, other = made["rgba"], other["rgba"]
            self.assertGreater(np.unique(other).size, 5)
            np.testing.assert_array_equal(made, other)

    def test_kept_ones_and_the_command_line(self):
        scene = self.load()
        self.assertEqual(self.cli.json("edit", "squares", "--set-material", "c=blue", "--set-material", "a=1")["instances"], 2)
        now = self.client.scene("squares")
        self.assertEqual([self.seen(now)[0][name] for name in "abc"], [BLUE, RED, BLUE])
        for text, words in (("c=green", "the scene has none of that name or number; it has 6"), ("c=6", "none of that name or"),
                            ("c=twice", "which 2 have: give its number"), ("c=glass", "rays may pass through it"),
                            ("pane=red", "rays may pass through it"), ("c=", "a material is missing"), ("c", "is not PATH=")):
            refused = self.cli.run("edit", "squares", "--set-material", text)
            self.assertIn(words, refused.stderr)
            self.assertEqual(refused.returncode, 2, text)
        self.assertEqual(self.client.scene("squares").info["epoch"], now.info["epoch"])

    def test_what_python_refuses(self):
        scene = self.load()
        for wrong, error in ((1.5, TypeError), (True, TypeError), (None, TypeError), (-1, raynest.UsageError),
                             (2**32 - 1, raynest.UsageError), ("", raynest.UsageError)):
            with self.subTest(wrong=wrong), self.assertRaises(error), scene.edit() as edit:
                edit.set_material("a", wrong)
        self.assertEqual(self.seen(scene)[0]["a"], RED)


if __name__ == "__main__":
    main()
