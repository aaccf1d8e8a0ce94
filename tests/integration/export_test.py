#!/usr/bin/env python3
"""Tests raynest export: a scene that is written and loaded again has the same hits in every bit, names,
masks and pictures; what a file cannot say is told with its count.

  export_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import DaemonTest

HITS = ["t", "prim", "path", "u", "v"]


def rays_at(info, count=4000, seed=3):
    """Rays (N, 6) through the scene's box from around it, in the world."""
    random = np.random.default_rng(seed)
    low, high = np.array(info["bounds"]["min"]), np.array(info["bounds"]["max"])
    size = np.maximum(high - low, 1e-3)
    starts = (low + high) / 2 + random.normal(size=(count, 3)) * size
    ends = low + random.uniform(size=(count, 3)) * size
    return np.hstack([starts, ends - starts])


class Export(DaemonTest):
    def setUp(self):
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)
        folder = tempfile.TemporaryDirectory(prefix="raynest export ")
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def load(self, source, **options):
        return self.python.load(source, name=f"s{len(self.python.scenes())}", replace=True, **options)

    def write(self, name, text):
        path = self.folder / name
        path.write_text(text)
        return path

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
            made = scene.export(self.folder / name)
        self.assertEqual([str(note.message) for note in notes], made["notes"])
        return made

    def json_of(self, path):
        data = pathlib.Path(path).read_bytes()
        self.assertEqual(struct.unpack("<4sII", data[:12]), (b"glTF", 2, len(data)))
        return json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])

    def test_builtin_scenes(self):
        for source in ("builtin:street", "builtin:forest?trees=30", "builtin:terrain?size=32", "builtin:flake?depth=2"):
            with self.subTest(source):
                before = self.load(source)
                made = self.export(before)
                after = self.load(made["glb"])
                self.same_hits(before, after)
                self.assertEqual(before.info["cameras"], after.info["cameras"])


if __name__ == "__main__":
    DaemonTest.raynestd, DaemonTest.raynest = sys.argv[1:3]
    unittest.main(argv=sys.argv[:1])
