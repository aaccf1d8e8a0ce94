#!/usr/bin/env python3
"""Checks a picture's contents: each channel of an EXR by its name, and the counts of a heat map.

  picture_test.py RAYNESTD RAYNEST
"""
import base64
import json
import pathlib
import struct

from daemon import DaemonTest, main
from exr import read_exr
from npy import read_npy

COLOUR = (0.75, 0.5, 0.25, 1.0)
SQUARE = (-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0)


def coloured_square():
    """Returns a glTF: two triangles in the plane z = 0 whose base colour differs in each
    channel."""
    positions = struct.pack("<18f", *SQUARE)
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": COLOUR}}],
        "buffers": [{"byteLength": len(positions),
                     "uri": "data:application/octet-stream;base64," + base64.b64encode(positions).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": len(positions)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3",
                       "min": [-1, -1, 0], "max": [1, 1, 0]}]})


class ImageModule(DaemonTest):
    """Its 250 libraries take a second to load, during which a thread that loads them does nothing else."""
    loads = {"flake": "builtin:flake"}

    def test_a_request_that_is_refused_has_not_loaded_it(self):
        maps = pathlib.Path(f"/proc/{self.daemon.process.pid}/maps")
        for words in (("render", "flake"), ("heatmap", "flake")):
            done = self.client.run(*words, "--camera", "nobody", "-o", self.out / "a.png")
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertNotIn("raynest-images", maps.read_text(), words)
        for words in (("render", "flake"), ("heatmap", "flake")):
            self.client.json(*words, "--size", "8x8", "-o", self.out / "a.png")
        self.assertIn("raynest-images", maps.read_text())


class Pictures(DaemonTest):
    VIEW = ("--size", "40x36", "--lookat", "0,0,4,0,0,0", "--fov", "45")

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        (cls.out / "square.gltf").write_text(coloured_square())
        cls.client.json("load", cls.out / "square.gltf", "--name", "square")

    def test_channels_of_an_exr_have_the_surface_s_colour_by_name(self):
        told = self.client.json("render", "square", "-o", self.out / "a.exr", *self.VIEW)
        width, height, channels = read_exr((self.out / "a.exr").read_bytes())
        self.assertEqual((width, height, sorted(channels)), (40, 36, ["A", "B", "G", "R"]))
        # The ray of the middle pixel is perpendicular to the square.
        middle = [channels[name][18 * 40 + 20] for name in "RGBA"]
        for value, expected in zip(middle, COLOUR):
            self.assertAlmostEqual(value, expected, delta=0.01)
        self.assertEqual([channels[name][0] for name in "RGBA"],
                         [0, 0, 0, 0])
        self.assertEqual((told["hits"], told["misses"]), (sum(a == 1 for a in channels["A"]), channels["A"].count(0)))
        self.assertTrue(0 < told["misses"] < told["rays"] == 40 * 36)

    def test_the_exr_of_a_heat_map_has_the_counts_of_the_raw_one(self):
        for ending in ("exr", "npy"):
            told = self.client.json("heatmap", "square", "--metric", "prims", "-o", self.out / f"h.{ending}", *self.VIEW)
            self.assertEqual(told["rays"], 40 * 36)
        width, height, channels = read_exr((self.out / "h.exr").read_bytes())
        _, shape, counts = read_npy((self.out / "h.npy").read_bytes())
        self.assertEqual((height, width), shape)
        metrics = ["nodes", "boxes", "leaves", "prims", "instances", "instance_misses", "rejects", "box_hits",
                   "prim_hits", "total"]
        self.assertEqual(sorted(channels), sorted(metrics + [f"L{level}.{metric}" for level in (0, 1)
                                                             for metric in metrics]))
        for metric in metrics:
            levels = zip(channels[f"L0.{metric}"], channels[f"L1.{metric}"])
            self.assertEqual(list(channels[metric]), [sum(pixel) for pixel in levels])
        self.client.json("heatmap", "square", "--metric", "prims", "-o", self.out / "again.exr", *self.VIEW)
        self.assertEqual((self.out / "h.exr").read_bytes(), (self.out / "again.exr").read_bytes())
        self.assertEqual(tuple(channels["prims"]), tuple(counts))
        self.assertGreater(max(counts), 0)

    def test_the_levels_of_a_map_add_up_to_the_whole(self):
        self.client.json("load", "builtin:flake?depth=3", "--name", "flake")
        depth = self.client.json("info", "flake")["levels"]
        self.client.json("heatmap", "flake", "-o", self.out / "f.exr", "--size", "48x32")
        _, _, channels = read_exr((self.out / "f.exr").read_bytes())
        for metric in ("boxes", "prims", "box_hits", "instances", "total"):
            levels = [channels[f"L{level}.{metric}"] for level in range(depth)]
            self.assertEqual(list(channels[metric]), [sum(pixel) for pixel in zip(*levels)])
        self.assertGreater(max(channels[f"L{depth - 1}.prims"]), 0)
        self.client.json("heatmap", "flake", "-o", self.out / "f.npy", "--size", "48x32", "--metric", "boxes.1")
        _, _, counts = read_npy((self.out / "f.npy").read_bytes())
        self.assertEqual(tuple(counts), tuple(channels["L1.boxes"]))

    def test_a_level_that_the_scene_lacks_is_refused(self):
        for arguments in (("heatmap", "square", "-o", self.out / "x.png", "--metric", "boxes.2"),
                          ("query", "square", "--ray", "0,0,5,0,0,-1", "--fields", "boxes.2")):
            self.client.fails(2, "'boxes.2': the scene has 2 levels, 0 to 1", *arguments)


if __name__ == "__main__":
    main()
