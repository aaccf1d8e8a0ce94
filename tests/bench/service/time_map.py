#!/usr/bin/env python3
"""How well counters tell time: correlations of heat maps of counters with one of measured time.

  time_map.py BIN_DIR [--json]      e.g. time_map.py build/bin

A line per built-in scene: the correlation of ranks (Spearman's) of each counter with time over all
pixels, and that of two maps of time, which no counter can pass by much.
"""
import argparse
import json
import pathlib
import sys

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests/integration"), str(ROOT / "client/python")]
from daemon import Daemon  # noqa: E402

import raynest  # noqa: E402

SCENES = ("builtin:forest", "builtin:terrain", "builtin:flake", "builtin:street")
METRICS = ("total", "boxes", "prims", "nodes", "instances")
SIZE = (320, 180)


def ranks(values):
    """Ranks from 0; equal values share the mean of theirs."""
    _, group, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts + 1) / 2)[group.ravel()]


def correlation(a, b):
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(np.corrcoef(ranks(a.ravel()), ranks(b.ravel()))[0, 1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    daemon = Daemon(options.bin / "raynestd", "--threads", "1")
    try:
        with raynest.connect(daemon.uri) as client:
            for source in SCENES:
                scene = client.load(source)
                first, again = (scene.heatmap(size=SIZE, metric="time") for _ in range(2))
                row = {"scene": scene.name, "median_ns": float(np.median(first)), "time": correlation(first, again),
                       **{metric: correlation(scene.heatmap(size=SIZE, metric=metric), first) for metric in METRICS}}
                print(json.dumps(row) if options.json else
                      "  ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value:10}" for key, value in row.items()),
                      flush=True)
    finally:
        daemon.stop()


if __name__ == "__main__":
    main()
