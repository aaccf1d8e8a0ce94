"""Shared by the tests of the Python client against a real daemon."""
import sys

import numpy as np

import daemon
import raynest
from daemon import DaemonTest

MISS = {"t": np.inf, "prim": 2**32 - 1, "geom": 2**32 - 1, "path": 2**64 - 1, "inst": 2**32 - 1,
        "uid": 2**32 - 1, "material": 2**32 - 1, "uv": 0, "ng": 0, "front": 0, "position": 0,
        "hit": 0}
FIELDS = ("t", "prim", "geom", "path", "inst", "uid", "uv", "ng", "front", "position", "material",
          "hit", "flags", "total")


def rain(count, seed=1):
    """Rays (count, 8) from the sky, some of them to the side; float32, of the form that travels."""
    chance = np.random.default_rng(seed)
    rays = np.zeros((count, 8), np.float32)
    rays[:, :3] = chance.uniform(-60, 60, (count, 3))
    rays[:, 1] = 60
    rays[:, 4:7] = chance.normal(0, 0.3, (count, 3))
    rays[:, 5] = -1
    rays[:, 7] = np.inf
    rays[::7, 5] = 1
    return rays


class WithDaemon(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.cli = cls.client
        cls.client = cls.enterClassContext(raynest.connect(cls.daemon.uri))
        cls.woods = cls.client.load("builtin:forest?trees=20", "woods")

    def same(self, a, b):
        self.assertEqual(a.keys(), b.keys())
        for name in a:
            self.assertEqual(a[name].dtype, b[name].dtype, name)
            np.testing.assert_array_equal(a[name], b[name], name)


def main():
    """Runs the tests of a file that was called with RAYNESTD RAYNEST FLATC."""
    del sys.argv[3:4]
    daemon.main()
