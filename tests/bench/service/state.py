#!/usr/bin/env python3
"""The cost and the gain of the state folder, as ratios: a load with it over one without, and the first ray of
a scene after a restart over its first load.

  state.py RAYNESTD RAYNEST [SCENES] [FOLDER]     20 scenes; FOLDER: of the state, by default one on /dev/shm
"""
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / "tests/integration"), str(ROOT / "client/python")]
from daemon import Daemon  # noqa: E402
import raynest  # noqa: E402

LOADS = 7


def source(number, trees=400):
    return f"builtin:forest?trees={trees}&seed={number}"


def timed(act):
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


def first_ray(client, name):
    client.scene(name).trace([[0, 50, 0, 0, -1, 0]])


def load_ratio(raynestd, folder):
    """Loads alternate between two daemons."""
    plain, stored = Daemon(raynestd), Daemon(raynestd, "--state", f"{folder}/ratio")
    laps = []
    with raynest.connect(plain.uri) as a, raynest.connect(stored.uri) as b:
        for lap in range(LOADS):
            # Another order each time.
            order = [(a, 0), (b, 1)] if lap % 2 else [(b, 1), (a, 0)]
            seconds = [0, 0]
            for client, place in order:
                seconds[place] = timed(lambda: client.load(source(100 + lap), name=f"s{lap}"))
            laps.append(seconds[1] / seconds[0])
    plain.stop()
    stored.stop()
    return statistics.median(laps), min(laps), max(laps)


def restart(raynestd, folder, scenes):
    state = f"{folder}/restart"
    daemon = Daemon(raynestd, "--state", state)
    with raynest.connect(daemon.uri) as client:
        loads = [timed(lambda: client.load(source(number), name=f"s{number}")) for number in range(scenes)]
        total = sum(scene["bytes"] for scene in client.scenes())
    daemon.process.kill()
    daemon.process.wait()
    began = time.perf_counter()
    daemon = Daemon(raynestd, "--state", state)
    with raynest.connect(daemon.uri) as client:
        assert len(client.scenes()) == scenes
        names = time.perf_counter() - began
        rays = [timed(lambda: first_ray(client, f"s{number}")) for number in range(scenes)]
        again = [timed(lambda: first_ray(client, f"s{number}")) for number in range(scenes)]
    daemon.stop()
    ratios = [ray / load for ray, load in zip(rays, loads)]
    return {"scenes": scenes, "bytes": total, "start_to_names_seconds": round(names, 3),
            "first_load_seconds": round(statistics.median(loads), 3),
            "first_ray_seconds": round(statistics.median(rays), 4),
            "next_ray_seconds": round(statistics.median(again), 4),
            "first_ray_over_first_load": [round(value, 3) for value in (statistics.median(ratios), min(ratios), max(ratios))]}


def main():
    raynestd = sys.argv[1]
    scenes = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    with tempfile.TemporaryDirectory(prefix="raynest-state-", dir=sys.argv[4] if len(sys.argv) > 4 else "/dev/shm") as folder:
        median, least, most = load_ratio(raynestd, folder)
        print(json.dumps({"load_with_over_without": [round(value, 3) for value in (median, least, most)],
                          **restart(raynestd, folder, scenes)}, indent=1))


if __name__ == "__main__":
    main()
