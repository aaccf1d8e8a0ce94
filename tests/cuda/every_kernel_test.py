#!/usr/bin/env python3
"""Every kernel of the CUDA worker through a daemon, over triangles with and without instances and over spheres: the
same rays to the CPU and to it, byte for byte.

  every_kernel_test.py RAYNESTD RAYNEST PACK          PACK is the cuda pack over tests/cuda/fake_runtime: few rays
  every_kernel_test.py RAYNESTD RAYNEST PACK gpu      PACK is the real one: 10^7 rays and more; exit code 77
                                                      (skipped) where its GPU does not start
"""
import array
import itertools
import random
import sys
import unittest

import worker_test
from npy import npy

RAYS = 5_000  # of a query
RAYS_ON_GPU, TOTAL_ON_GPU = 200_000, 10**7
KINDS = ("closest",), ("any",), ("multi", "--max-hits", "5")
PRECISIONS = "watertight", "fast"
# So that one cuts what the scenes are made of, whatever their materials say.
SETTINGS = {"procedural_mask": ("--set", "on=all", "--set", "pattern=noise")}


def rays_around(count):
    """Of all directions, from far and near: what a flake is made of lies within a unit."""
    chance = random.Random(1)
    values = array.array("f")
    for _ in range(count):
        far = chance.choice((2, 20))
        values.extend((chance.uniform(-far, far), chance.uniform(0, far), chance.uniform(-far, far),
                       chance.gauss(0, 1), chance.gauss(-0.5, 1), chance.gauss(0, 1)))
    return npy((count, 6), values.tobytes())


class EveryKernel(worker_test.CudaTest):
    scenes = (("builtin:forest?trees=20", "woods"), ("builtin:terrain?size=256", "hills"),
              ("builtin:flake?depth=5", "flake"))

    def test_its_answers_are_the_cpus(self):
        self.wait_until_up()
        self.rays.write_bytes(rays_around(RAYS))
        intersectors = [variant["name"] for variant in self.client.json("variants")["variants"]
                        if "cuda" in variant["targets"]]
        self.assertGreaterEqual(set(intersectors), {"opaque", "alpha_mask", "procedural_mask"})
        asked = 0
        for (_, scene), intersector, kind, precision in itertools.product(self.scenes, intersectors, KINDS, PRECISIONS):
            options = ("--intersector", intersector, *SETTINGS.get(intersector, ()), "--kind", *kind,
                       "--precision", precision)
            with self.subTest(scene=scene, options=options):
                _, expected = self.query("cpu", *options, scene=scene)
                told, answer = self.query("cuda", *options, scene=scene)
                self.assertEqual((told["worker"], told["intersector"], told["precision"], told["notes"]),
                                 ("cuda", intersector, precision, []))
                self.assertGreater(told["rays"] - told["misses"], RAYS // 50)
                self.assertEqual(answer, expected)
                asked += told["rays"]
        print(f"{asked} rays, {len(intersectors) * len(KINDS) * len(PRECISIONS)} kernels on {len(self.scenes)} scenes")
        if RAYS == RAYS_ON_GPU:
            self.assertGreaterEqual(asked, TOTAL_ON_GPU)


if __name__ == "__main__":
    worker_test.RAYNESTD, worker_test.RAYNEST, worker_test.PACK = sys.argv[1:4]
    if sys.argv[4:] == ["gpu"]:
        RAYS = RAYS_ON_GPU
        if not worker_test.gpu_starts():
            sys.exit(77)
    unittest.main(argv=sys.argv[:1])
