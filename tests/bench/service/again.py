#!/usr/bin/env python3
"""The cost of content that the daemon has already: mesh() of a million triangles for the second time, over the first.

  again.py RAYNESTD

Needs PYTHONPATH=client/python. Prints a line of JSON: the ratio of the medians, by the clock.
"""
import json
import pathlib
import statistics
import sys
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / folder) for folder in ("tests/integration", "client/python")]
from daemon import Daemon  # noqa: E402
import raynest  # noqa: E402

SIDE, ROUNDS = 708, 5      # 2 * 707^2 triangles


def terrain(seed):
    """Vertices and faces of heights that no other seed has."""
    heights = np.random.default_rng(seed).random(SIDE * SIDE)
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    first = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    faces = np.concatenate([np.stack([first, first + 1, first + SIDE], -1),
                            np.stack([first + 1, first + SIDE + 1, first + SIDE], -1)])
    return np.stack([x.ravel(), y.ravel(), heights], -1).astype(np.float32), faces.astype(np.uint32)


def main():
    seconds = [], []
    daemon = Daemon(sys.argv[1])
    with raynest.connect(daemon.uri) as client:
        for seed in range(ROUNDS):
            vertices, faces = terrain(seed)
            scenes = []
            for taken in seconds:
                begun = time.perf_counter()
                scenes.append(client.mesh(vertices, faces))
                taken.append(time.perf_counter() - begun)
            for scene in scenes:
                scene.close()
    daemon.stop()
    first, second = map(statistics.median, seconds)
    print(json.dumps({"figure": "again", "triangles": len(faces), "ratio": second / first, "first_s": first,
                      "each": [b / a for a, b in zip(*seconds)]}))


if __name__ == "__main__":
    main()
