#!/usr/bin/env python3
"""The cost and the gain of the state folder: a load with it over one without, the first ray of a scene after a
restart over its first load, and how many kept edits there are in a second.

  state.py RAYNESTD RAYNEST [SCENES] [FOLDER] [SOURCE]

SCENES: 20. FOLDER: where the state lies, /dev/shm by default. SOURCE: what is loaded, with {} for a number that
tells the scenes apart: "builtin:forest?trees=400&seed={}" has 10 MB.
"""
import json
import pathlib
import statistics
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / "tests/integration"), str(ROOT / "client/python")]
from daemon import Daemon  # noqa: E402
import raynest  # noqa: E402

LOADS = 7
EDITORS, EDITS = 16, 200
FOREST = "builtin:forest?trees=400&seed={}"


def timed(act):
    began = time.perf_counter()
    act()
    return time.perf_counter() - began


def first_ray(client, name):
    client.scene(name).trace([[0, 50, 0, 0, -1, 0]])


def load_ratio(raynestd, folder, source):
    """Loads alternate between two daemons."""
    plain, stored = Daemon(raynestd), Daemon(raynestd, "--state", f"{folder}/ratio")
    laps = []
    with raynest.connect(plain.uri) as a, raynest.connect(stored.uri) as b:
        for lap in range(LOADS):
            # Another order each time.
            order = [(a, 0), (b, 1)] if lap % 2 else [(b, 1), (a, 0)]
            seconds = [0, 0]
            for client, place in order:
                seconds[place] = timed(lambda: client.load(source.format(100 + lap), name=f"s{lap}"))
            laps.append(seconds[1] / seconds[0])
    plain.stop()
    stored.stop()
    return statistics.median(laps), min(laps), max(laps)


def kept_edits(raynestd, folder):
    """As many connections as EDITORS, each of which moves an instance of its own scene EDITS times and waits for each
    answer: per second, kept and not."""
    daemon, rates = Daemon(raynestd, "--state", f"{folder}/edits"), {}
    for keep in (True, False):
        with_scenes = []
        for number in range(EDITORS):
            client = raynest.connect(daemon.uri)
            with_scenes.append((client, client.load(FOREST.format(number + EDITORS * keep), name=f"e{number}{keep}")))
        start = threading.Barrier(EDITORS + 1)

        def act(scene):
            start.wait()
            for i in range(EDITS):
                with scene.edit(keep=keep) as edit:
                    edit.move(0, [0, 0.001 * (i % 2 * 2 - 1), 0])

        threads = [threading.Thread(target=act, args=(scene,)) for _, scene in with_scenes]
        for thread in threads:
            thread.start()
        start.wait()
        began = time.perf_counter()
        for thread in threads:
            thread.join()
        rates["kept" if keep else "not kept"] = round(EDITORS * EDITS / (time.perf_counter() - began))
        for client, _ in with_scenes:
            client.close()
    daemon.stop()
    return rates


def restart(raynestd, folder, scenes, source):
    state = f"{folder}/restart"
    daemon = Daemon(raynestd, "--state", state)
    with raynest.connect(daemon.uri) as client:
        loads = [timed(lambda: client.load(source.format(number), name=f"s{number}")) for number in range(scenes)]
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
    source = sys.argv[5] if len(sys.argv) > 5 else FOREST
    with tempfile.TemporaryDirectory(prefix="raynest-state-", dir=sys.argv[4] if len(sys.argv) > 4 else "/dev/shm") as folder:
        median, least, most = load_ratio(raynestd, folder, source)
        print(json.dumps({"load_with_over_without": [round(value, 3) for value in (median, least, most)],
                          **restart(raynestd, folder, scenes, source),
                          "edits_per_second": kept_edits(raynestd, folder)}, indent=1))


if __name__ == "__main__":
    main()
