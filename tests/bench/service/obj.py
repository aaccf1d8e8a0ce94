#!/usr/bin/env python3
"""An OBJ of a million triangles: the CPU of a load, with its tree, over that of Assimp's import, which builds none.

  obj.py RAYNESTD RAYNEST     needs assimp: apt install assimp-utils
"""
import json
import pathlib
import resource
import statistics
import subprocess
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / "tests/integration"), str(ROOT / "client/python")]
from daemon import Daemon  # noqa: E402
import raynest  # noqa: E402

SIDE, LAPS = 708, 5


def grid(path, side):
    """Writes side x side vertices of a hilly ground."""
    x, z = np.meshgrid(np.arange(side), np.arange(side))
    vertices = np.stack([x * 0.123456, 5 * np.sin(x * 0.05) * np.cos(z * 0.03), z * 0.123456], -1).reshape(-1, 3)
    corner = np.arange(1, side * side + 1).reshape(side, side)
    a, b, c, d = (corner[y:y + side - 1, x:x + side - 1].ravel() for y in (0, 1) for x in (0, 1))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    with open(path, "w") as file:
        np.savetxt(file, vertices, "v %.6f %.6f %.6f")
        np.savetxt(file, faces, "f %d %d %d")
    return len(faces)


def cpu(act):
    """Seconds of user and system time of the processes that `act` starts and ends."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    act()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def load(raynestd, path):
    daemon = Daemon(raynestd)
    with raynest.connect(daemon.uri) as client:
        scene = client.load(path)
        tree = scene.info["build_seconds"]
    daemon.stop()
    return tree


def main():
    raynestd = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        large, small = f"{folder}/large.obj", f"{folder}/small.obj"
        triangles = grid(large, SIDE)
        grid(small, 2)
        laps, trees = [], []
        for _ in range(LAPS):
            theirs = cpu(lambda: subprocess.run(["assimp", "info", large, "-r"], check=True, capture_output=True))
            ours = cpu(lambda: trees.append(load(raynestd, large))) - cpu(lambda: load(raynestd, small))
            laps.append(ours / theirs)
    print(json.dumps({"triangles": triangles, "load_over_assimp": [round(value, 2) for value in (
        statistics.median(laps), min(laps), max(laps))], "tree_seconds": round(statistics.median(trees), 2)}))


if __name__ == "__main__":
    main()
