#!/usr/bin/env python3
"""Runs every kernel of the CUDA worker through a daemon, over triangles with and without instances
and over spheres: the same rays on the CPU and on the worker give the same bytes.

  every_kernel_test.py RAYNESTD RAYNEST PACK          PACK is the cuda pack over tests/cuda/fake_runtime: few rays
  every_kernel_test.py RAYNESTD RAYNEST PACK gpu      PACK is the real one: 10^7 rays and more; exit code 77
                                                      (skipped) where there is none
"""
import array
import itertools
import pathlib
import random
import sys
import tempfile
import unittest

from cuda_daemon import Client, Daemon, npy, why_no_worker

DAEMON = CLIENT = None
RAYS = 5_000  # rays of a query
RAYS_ON_GPU, TOTAL_ON_GPU = 200_000, 10**7
KINDS = ("closest",), ("any",), ("multi", "--max-hits", "5")
# Make it cut the scenes' surfaces, whatever their materials state.
SETTINGS = {"procedural_mask": ("--set", "on=all", "--set", "pattern=noise")}


def rays_around(count):
    """Returns rays in all directions, from far and near: a flake fits into a unit sphere."""
    chance = random.Random(1)
    values = array.array("f")
    for _ in range(count):
        far = chance.choice((2, 20))
        values.extend((chance.uniform(-far, far), chance.uniform(0, far), chance.uniform(-far, far),
                       chance.gauss(0, 1), chance.gauss(-0.5, 1), chance.gauss(0, 1)))
    return npy((count, 6), values.tobytes())


class EveryKernel(unittest.TestCase):
    SCENES = {"woods": "builtin:forest?trees=20", "hills": "builtin:terrain?size=256", "flake": "builtin:flake?depth=5"}

    def setUp(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.rays = folder / "rays.npy"
        self.rays.write_bytes(rays_around(RAYS))
        for name, source in self.SCENES.items():
            CLIENT.json("load", source, "--name", name)

    def query(self, worker, scene, *options):
        """Returns (the command's JSON, the file's bytes)."""
        file = self.rays.with_name("answers.npz")
        told = CLIENT.json("query", scene, "--rays", self.rays, "-o", file, "--worker", worker, *options)
        return told, file.read_bytes()

    def test_its_answers_are_the_cpus(self):
        intersectors = [variant["name"] for variant in CLIENT.json("variants")["variants"]
                        if "cuda" in variant["targets"]]
        self.assertGreaterEqual(set(intersectors), {"opaque", "alpha_mask", "procedural_mask"})
        asked = 0
        for scene, intersector, kind in itertools.product(self.SCENES, intersectors, KINDS):
            options = ("--intersector", intersector, *SETTINGS.get(intersector, ()), "--kind", *kind)
            with self.subTest(scene=scene, options=options):
                _, expected = self.query("cpu", scene, *options)
                told, answer = self.query("cuda", scene, *options)
                self.assertEqual((told["worker"], told["intersector"], told["notes"]), ("cuda", intersector, []))
                self.assertGreater(told["rays"] - told["misses"], RAYS // 50)
                self.assertEqual(answer, expected)
                asked += told["rays"]
        print(f"{asked} rays, {len(intersectors) * len(KINDS)} kernels on {len(self.SCENES)} scenes")
        if RAYS == RAYS_ON_GPU:
            self.assertGreaterEqual(asked, TOTAL_ON_GPU)


if __name__ == "__main__":
    raynestd, raynest, pack, *where = sys.argv[1:]
    if where == ["gpu"]:
        RAYS = RAYS_ON_GPU
    DAEMON = Daemon(raynestd, "--cuda", pack)
    try:
        if code := why_no_worker(DAEMON):
            sys.exit(code)
        CLIENT = Client(raynest, DAEMON.uri)
        unittest.main(argv=sys.argv[:1])
    finally:
        DAEMON.stop()
