#!/usr/bin/env python3
"""Times a million rays from Python and from the C++ client: same daemon, in turns."""
import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

import raynest
import terminal

PROGRAM = """
import sys, numpy, raynest
hits = raynest.connect(sys.argv[1]).scene(sys.argv[2]).trace(numpy.load(sys.argv[3]),
                                                            fields=("t", "prim"))
numpy.savez(sys.argv[4], **hits)
"""


def options():
    parser = terminal.parser(__doc__, "bench.py builtin:forest --raynest build/bin/raynest")
    parser.add_argument("--raynest", default="raynest", metavar="PROGRAM",
                        help="the C++ client (%(default)s)")
    parser.add_argument("--rays", type=terminal.count, default=1_000_000, help="(%(default)s)")
    parser.add_argument("--rounds", type=terminal.count, default=5,
                        help="the best of so many (%(default)s)")
    return parser.parse_args()


def rain(scene, count):
    """Rays from the sky, straight down, in random order: float32 (count, 8)."""
    low, high = np.array(scene.info["box_min"]), np.array(scene.info["box_max"])
    rays = np.zeros((count, 8), np.float32)
    rays[:, :3] = np.random.default_rng(1).uniform(low, high, (count, 3))
    rays[:, 1] = high[1] + 1
    rays[:, 5], rays[:, 7] = -1, np.inf
    return rays


def measured(run):
    """Wall seconds, and CPU seconds of this process and its children."""
    def cpu():
        usage = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return sum(each.ru_utime + each.ru_stime for each in usage)
    wall, used = time.perf_counter(), cpu()
    run()
    return time.perf_counter() - wall, cpu() - used


def main():
    chosen = options()
    with raynest.connect(chosen.server) as client, tempfile.TemporaryDirectory() as folder:
        scene = terminal.scene(client, chosen.source)
        rays = rain(scene, chosen.rays)
        six = np.ascontiguousarray(rays[:, [0, 1, 2, 4, 5, 6]], np.float64)
        file, ours, theirs = (os.path.join(folder, name) for name in
                              ("rays.npy", "python.npz", "raynest.npz"))
        np.save(file, rays)
        query = [chosen.raynest, "--server", client.uri, "query", scene.name, "--rays", file,
                 "--fields", "t,prim", "-o", theirs]
        python = [sys.executable, "-c", PROGRAM, client.uri, scene.name, file, ours]
        contestants = {
            "raynest query": lambda: subprocess.run(query, check=True, capture_output=True),
            "a Python program that does the same": lambda: subprocess.run(python, check=True),
            "trace(), float32 (N, 8)": lambda: scene.trace(rays, fields=("t", "prim")),
            "trace(), float64 (N, 6)": lambda: scene.trace(six, fields=("t", "prim"))}
        best = {}
        for _ in range(chosen.rounds):
            for name, run in contestants.items():
                best[name] = min(best.get(name, (np.inf, np.inf)), measured(run))
        baseline = best["raynest query"][0]
        print(f"{chosen.rays:,} rays through {scene.name}, columns t and prim, best of "
              f"{chosen.rounds}")
        for name, (wall, used) in best.items():
            print(f"{name:36} {1000 * wall:8.1f} ms, {1000 * used:6.1f} ms of CPU, "
                  f"{wall / baseline:5.2f} times raynest query")
        with np.load(ours) as a, np.load(theirs) as b:
            if not all(np.array_equal(a[name], b[name]) for name in ("t", "prim")):
                raise raynest.FailedError("the answers differ")


if __name__ == "__main__":
    terminal.run(main)
