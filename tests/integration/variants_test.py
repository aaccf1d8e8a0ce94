#!/usr/bin/env python3
"""Tests KHR_materials_variants: a load chooses one by name, in compositions too, and content that differs by
its variant alone is different content.

  variants_test.py RAYNESTD RAYNEST
"""
import base64
import json
import pathlib
import sys
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import DaemonTest, main

CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], "<f4").tobytes()
RAY = [[0, 0, 1, 0, 0, -1]]


def shoe(**change):
    """A triangle of material `plain`, which is red in the variants "beach" and "street", blue in "midnight"."""
    mappings = [{"material": 1, "variants": [0, 2]}, {"material": 2, "variants": [1]}]
    variants = [{"name": "beach"}, {"name": "midnight"}, {"name": "street"}, {"name": "bare"}]
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": "shoe", "mesh": 0}],
        "extensionsUsed": ["KHR_materials_variants"],
        "extensions": {"KHR_materials_variants": {"variants": change.get("variants", variants)}},
        "materials": [{"name": name} for name in ("plain", "red", "blue")],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0, "extensions": {
            "KHR_materials_variants": {"mappings": change.get("mappings", mappings)}}}]}],
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,"
                     + base64.b64encode(CORNERS).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [-1, -1, 0], "max": [1, 1, 0]}]})


class Variants(DaemonTest):
    def setUp(self):
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)
        self.file = self.out / "shoe.gltf"
        self.file.write_text(shoe())

    def material(self, name):
        index = int(self.python.scene(name).trace(RAY, fields=["material"])["material"][0])
        return self.python.scene(name).materials[index]["name"]

    def load(self, source, name, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return self.python.load(source, name, replace=True, **options)

    def test_a_load_chooses_a_variant(self):
        hashes = set()
        # Each of them once more: the daemon has the files by then, and must not confuse them.
        for variant, material in 2 * [("", "plain"), ("beach", "red"), ("midnight", "blue"), ("street", "red"),
                                      ("bare", "plain")]:
            scene = self.load(self.file, f"v{variant}", variant=variant)
            self.assertEqual(self.material(scene.name), material, variant)
            hashes.add(scene.info["hash"])
        self.assertEqual(len(hashes), 5)
        self.client.run("load", self.file, "--name", "cli", "--variant", "midnight")
        self.assertEqual(self.material("cli"), "blue")
        told = self.client.json("info", "cli")
        self.assertEqual((told["variants"], told["variant"], told["warnings"]),
                         (["beach", "midnight", "street", "bare"], "midnight", []))
        self.assertRegex(self.client.run("info", "cli").stdout,
                         r"(?m)^variants +beach, midnight \(chosen\), street, bare$")
        told = self.python.scene("v").info
        self.assertEqual((told["variants"], told["variant"], told["warnings"]),
                         (["beach", "midnight", "street", "bare"], "", []))
        # An edit keeps them.
        self.client.run("edit", "cli", "--set-mask", "*=1")
        self.assertEqual(self.client.json("info", "cli")["variant"], "midnight")

    def test_a_composition_chooses_for_each_object(self):
        town = self.out / "town.rnscene.json"
        town.write_text(json.dumps({
            "rnscene": 1,
            "objects": {"a": {"file": "shoe.gltf", "variant": "beach"}, "b": {"file": "shoe.gltf"}},
            "instances": [{"object": "a"}, {"object": "b", "translation": [5, 0, 0]}]}))
        scene = self.load(town, "town")
        rays = [RAY[0], [5, 0, 1, 0, 0, -1]]
        names = [scene.materials[int(i)]["name"] for i in scene.trace(rays, fields=["material"])["material"]]
        self.assertEqual(names, ["red", "plain"])
        with self.assertRaisesRegex(raynest.Error, "their masks and variants"):
            self.load(town, "town", variant="beach")

    def test_what_is_not_there_is_refused(self):
        for source, variant, said in (
                (self.file, "night", "has no variant 'night': it has 'beach', 'midnight', 'street', 'bare'"),
                (self.file, "x\n" * 300, "variant"), ("builtin:street", "beach", "variant= is for glTF files")):
            with self.subTest(source=source, variant=variant), self.assertRaisesRegex(raynest.Error, said):
                self.load(source, "refused", variant=variant)
        plain = self.out / "none.gltf"
        plain.write_text(shoe(variants=[]))
        with self.assertRaisesRegex(raynest.Error, "has no KHR_materials_variants: leave out variant="):
            self.load(plain, "refused", variant="beach")

    def test_what_is_odd_is_told(self):
        first, second = {"material": 1, "variants": [0]}, {"material": 2, "variants": [0]}
        twice = [{"name": "beach"}, {"name": "beach"}]
        for number, (change, material, said) in enumerate((
                ({"variants": twice}, "red", "several of its variants are named 'beach': the first is chosen"),
                ({"mappings": [first, second]}, "red", "maps a variant twice; the first one counts"),
                ({"mappings": [first, {"material": 2, "variants": [4]}]}, "red", "not one of the file's 4"),
                ({"mappings": [{"variants": [0]}]}, "plain", "maps variants to no material"))):
            with self.subTest(said):
                self.file.write_text(shoe(**change))
                scene = self.load(self.file, f"odd{number}", variant="beach")
                self.assertEqual(self.material(scene.name), material)
                self.assertIn(said, "\n".join(scene.info["warnings"]))

    def test_damaged_lists_choose_nothing(self):
        for number, change in enumerate((
                {"mappings": 7}, {"mappings": [7, None, {}]}, {"mappings": [{"material": "x", "variants": [0]}]},
                {"mappings": [{"material": 1, "variants": 0}]}, {"mappings": [{"material": 1, "variants": ["0"]}]})):
            with self.subTest(change):
                self.file.write_text(shoe(**change))
                self.assertEqual(self.material(self.load(self.file, f"d{number}", variant="beach").name), "plain")
        self.file.write_text(shoe(mappings=[{"material": 99, "variants": [0]}]))
        with self.assertRaisesRegex(raynest.Error, "material"):
            self.load(self.file, "d", variant="beach")


if __name__ == "__main__":
    main()
