#!/usr/bin/env python3
"""Scenes that move, through a daemon: what tracing loses by edits, what an edit costs, and a lidar in traffic.

  moving.py RAYNESTD drive          rays traced after 1,000 edits, over the same scene built afresh: objects drive
  moving.py RAYNESTD swap           the same where objects change places
  moving.py RAYNESTD edit           an edit there and back over a ping, both in turns
  moving.py RAYNESTD lidar [SECONDS]  10 sweeps a second among 50 moving cars (600 s)

Needs PYTHONPATH=client/python. Prints a line of JSON.
"""
import argparse
import contextlib
import json
import os
import pathlib
import statistics
import sys
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / folder) for folder in ("tests/integration", "client/python", "client/python/examples")]
from daemon import Daemon  # noqa: E402
import raynest  # noqa: E402
import street  # noqa: E402

STANDING, MOVERS, RAYS = 5000, 50, 1 << 17
EDITS, STOPS, LAPS = 1000, 10, 9
FIELD = 200.0           # metres: objects stand within so many, along each axis
STEP = 0.2              # metres that a mover drives from edit to edit
ROUND_TRIPS = 1000
LIDAR = argparse.Namespace(rate=10, channels=64, azimuths=1800)
CARS, SPEED = 50, 12.0


def cpu_clock(pid):
    """Returns a function that tells the CPU seconds of a process and of this one."""
    clock = ~pid << 3 | 2   # that of pthread_getcpuclockid(3), for a process
    return lambda: time.clock_gettime(clock) + time.process_time()


def ball(rings=16, around=24):
    """A sphere of triangles: (vertices, faces)."""
    up = np.linspace(0, np.pi, rings + 1)
    turn = np.arange(around) * 2 * np.pi / around
    vertices = np.stack([np.outer(np.sin(up), np.cos(turn)), np.outer(np.cos(up), np.ones(around)),
                         np.outer(np.sin(up), np.sin(turn))], -1).reshape(-1, 3)
    first = np.arange(rings * around).reshape(rings, around)
    right = np.roll(first, -1, axis=1)
    quads = np.stack([first, right, right + around, first + around], -1).reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def refits(raynestd, drive):
    """Movers of many sizes drive through the field, or change places, by edits of the scene of one daemon. After every
    hundredth edit another daemon builds the same scene afresh, and the same rays are traced in both, in turns. The
    ratio of a stop is the median of its laps, by CPU. Every hit is compared."""
    draw = np.random.default_rng(1)
    placed = np.zeros((STANDING + MOVERS, 3, 4))
    placed[:, [0, 1, 2], [0, 1, 2]] = draw.uniform(0.3, 3, len(placed))[:, None]
    placed[:, :, 3] = draw.uniform(0, FIELD, (len(placed), 3))
    movers = np.arange(MOVERS) + STANDING
    headings = draw.uniform(0, 2 * np.pi, MOVERS)
    steps = STEP * np.stack([np.cos(headings), 0 * headings, np.sin(headings)], -1)
    origins, ways = draw.uniform(0, FIELD, (RAYS, 3)), draw.normal(size=(RAYS, 3))
    rays = np.concatenate([origins, ways / np.linalg.norm(ways, axis=1)[:, None]], 1).astype(np.float32)
    edited, fresh = Daemon(raynestd), Daemon(raynestd)
    clocks = cpu_clock(edited.process.pid), cpu_clock(fresh.process.pid)
    ratios, since = [], []
    with raynest.connect(edited.uri) as one, raynest.connect(fresh.uri) as other:
        scene = one.scene_of({"ball": ball()}, {"field": ("ball", placed)})
        for _ in range(STOPS):
            for _ in range(EDITS // STOPS):
                at = placed[movers, :, 3]
                placed[movers, :, 3] = (at + steps) % FIELD if drive else draw.permutation(at)
                with scene.edit() as edit:
                    edit.place(movers, placed[movers])
            since.append(edit.refits)
            with other.scene_of({"ball": ball()}, {"field": ("ball", placed)}) as again:
                hits = [side.trace(rays, fields=("t", "prim", "inst")) for side in (scene, again)]
                assert all((hits[0][name] == hits[1][name]).all() for name in hits[0]), "the two scenes differ"
                laps = []
                for lap in range(LAPS):
                    seconds = [0.0, 0.0]
                    for place in (0, 1) if lap % 2 else (1, 0):
                        before = clocks[place]()
                        (scene, again)[place].trace(rays, fields=("t",))
                        seconds[place] = clocks[place]() - before
                    laps.append(seconds[1] / seconds[0])
            ratios.append(statistics.median(laps))
    edited.stop()
    fresh.stop()
    return {"edits": EDITS, "rebuilds": edit.rebuilds, "edits_since_then": since,
            "hit": round(float((hits[0]["t"] < np.inf).mean()), 2), "rate_over_fresh": spread(ratios),
            "of_each_stop": [round(ratio, 3) for ratio in ratios]}


def edit_over_ping(raynestd):
    daemon = Daemon(raynestd)
    trips = {"ping": [], "edit": []}
    with raynest.connect(daemon.uri) as client:
        scene = client.load("builtin:street", "street")
        for number in range(ROUND_TRIPS):
            trips["ping"].append(client.ping())
            began = time.perf_counter()
            with scene.edit() as edit:
                edit.move("car-7", (0.01 if number % 2 else -0.01, 0, 0))
            trips["edit"].append(time.perf_counter() - began)
    daemon.stop()
    medians = {name: statistics.median(seconds) for name, seconds in trips.items()}
    return {"round_trips": ROUND_TRIPS, **{f"{name}_us": round(1e6 * value) for name, value in medians.items()},
            "edit_over_ping": round(medians["edit"] / medians["ping"], 2)}


class Watched:
    """A scene that adds up the CPU of its edits: from the first of a batch to its answer."""

    def __init__(self, scene, clock):
        self.trace, self.edits, self._edit, self._clock = scene.trace, 0.0, scene.edit, clock

    @contextlib.contextmanager
    def edit(self):
        before = self._clock()
        with self._edit() as edit:
            yield edit
        self.edits += self._clock() - before


def machine_cpu():
    """CPU seconds that all processes of the machine have used; niced ones, too."""
    user, nice, system = map(int, pathlib.Path("/proc/stat").read_text(encoding="utf-8").split()[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def lidar(raynestd, seconds):
    """As examples/street.py: all cars are moved before each sweep. A sweep is late when it is whole more than one
    period after the moment at which a real one would be. Sweeps that were not begun in time are missing."""
    daemon, period = Daemon(raynestd), 1 / LIDAR.rate
    clock, traffic, took, late = cpu_clock(daemon.process.pid), street.Traffic(CARS, SPEED), [], 0
    with raynest.connect(daemon.uri) as client:
        scene = Watched(client.load(f"builtin:street?cars={CARS}", "street"), clock)
        before, machine, begin = clock(), machine_cpu(), time.perf_counter()
        due = int(seconds * LIDAR.rate)
        for number in range(due):
            expected = begin + number * period
            time.sleep(max(0, expected - time.perf_counter()))
            began = time.perf_counter()
            if began > begin + seconds:
                break
            street.sweep_of(scene, traffic, LIDAR, number * period, 1)
            took.append(time.perf_counter() - began)
            late += time.perf_counter() > expected + 2 * period
        used, machine, lasted = clock() - before, machine_cpu() - machine, time.perf_counter() - begin
    daemon.stop()
    return {"sweeps": len(took), "late": late, "missing": due - len(took),
            "sweep_ms": spread([1e3 * value for value in took]),
            "edits_of_cpu": round(scene.edits / used, 3), "cores": os.cpu_count(),
            "cores_used": round(used / lasted, 2), "cores_that_others_used": round((machine - used) / lasted, 2)}


def spread(values):
    """Median, least, most."""
    return [round(value, 3) for value in (statistics.median(values), min(values), max(values))]


def main():
    raynestd, what, *seconds = sys.argv[1:]
    acts = {"drive": lambda: refits(raynestd, True), "swap": lambda: refits(raynestd, False),
            "edit": lambda: edit_over_ping(raynestd), "lidar": lambda: lidar(raynestd, float((seconds or [600])[0]))}
    print(json.dumps(acts[what]()))


if __name__ == "__main__":
    main()
