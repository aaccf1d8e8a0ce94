"""Draws the stream of items of a lit picture whose cluster loses a worker: a row for each worker, a bar for each item.

  stream.py RAYNESTD OUT.svg [WORKERS [SPP]]     the worker of the second row is killed after a third of the items

The picture is compared with that of one daemon, byte by byte.
"""
import os
import signal
import sys
import time
import warnings
from html import escape

import numpy as np

import raynest
import raynest.dask as many
from raynest._workers import Host
from hosts import Cluster

SCENE = "builtin:forest"
SIZE = (640, 512)
ROWS_OF_ITEM = 8
COLOURS = {"an item": "#7da7d9", "an item that had been dealt to the killed worker": "#e0762f", "lost with the worker": "#c9c9c9"}
LEFT, WIDTH, ROW, TOP = 90, 880, 30, 46


class Stream:
    """Has the bars of all workers (row, first second, last second, kind), and when a worker was killed."""

    def __init__(self, cluster, ask):
        client, self.workers = cluster.client, cluster.workers()
        victim = self.workers[1]
        pid, = client.run(os.getpid, workers=[victim]).values()
        client.get_task_stream(count=1)      # the scheduler notes them from now on
        begin, self.killed, theirs = time.time(), 0.0, set()

        def progress(done, total, _stage):
            if 3 * done >= total and not self.killed:
                theirs.update(client.processing()[victim])
                os.kill(pid, signal.SIGKILL)
                self.killed = time.time() - begin
        self.answer = ask(progress)
        self.seconds = time.time() - begin
        self.bars, free = [], 0.0
        for task in client.get_task_stream(start=begin - 1):
            if not str(task["key"]).startswith("raynest-"):
                continue
            row = self.workers.index(task["worker"])
            for each in task["startstops"]:
                if each["action"] == "compute":
                    again = task["key"] in theirs and row != 1
                    self.bars.append((row, each["start"] - begin, each["stop"] - begin, list(COLOURS)[again]))
                    if row == 1:
                        free = max(free, each["stop"] - begin)
        if theirs:      # Dask tells nothing of what had not ended
            self.bars.append((1, free, self.killed, list(COLOURS)[2]))


def drawn(stream, title):
    scale = WIDTH / stream.seconds
    height = TOP + ROW * len(stream.workers) + 62
    bottom = TOP + ROW * len(stream.workers)
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {LEFT + WIDTH + 20} {height}" font-family="sans-serif" '
             'font-size="12"><rect width="100%" height="100%" fill="#fff"/>',
             f'<text x="{LEFT}" y="18" font-size="14" font-weight="bold">{escape(title)}</text>']
    for row in range(len(stream.workers)):
        lines.append(f'<text x="{LEFT - 8}" y="{TOP + ROW * row + 19}" text-anchor="end">worker {row + 1}</text>')
    for row, first, last, kind in stream.bars:
        lines.append(f'<rect x="{LEFT + scale * first:.1f}" y="{TOP + ROW * row + 4}" width="{scale * (last - first):.1f}" '
                     f'height="{ROW - 8}" fill="{COLOURS[kind]}" stroke="#fff" stroke-width=".7"/>')
    at = LEFT + scale * stream.killed
    lines.append(f'<path d="M{at:.1f} {TOP - 6}V{bottom}" stroke="#b00" stroke-width="1.5"/>'
                 f'<text x="{at + 4:.1f}" y="{TOP - 6}" fill="#b00">worker 2 is killed, {stream.killed:.1f} s</text>')
    lines.append(f'<path d="M{LEFT} {bottom}H{LEFT + WIDTH}" stroke="#444"/>')
    step = next(step for step in (0.5, 1, 2, 5, 10, 20, 50, 100) if stream.seconds / step <= 12)
    for tick in np.arange(0, stream.seconds, step):
        x = LEFT + scale * tick
        lines.append(f'<path d="M{x:.1f} {bottom}v5" stroke="#444"/><text x="{x:.1f}" y="{bottom + 18}" '
                     f'text-anchor="middle">{tick:g}{" s" if tick == 0 else ""}</text>')
    x = LEFT
    for kind, colour in COLOURS.items():
        lines.append(f'<rect x="{x}" y="{height - 22}" width="16" height="12" fill="{colour}"/>'
                     f'<text x="{x + 22}" y="{height - 12}">{kind}</text>')
        x += 50 + 5.9 * len(kind)
    return "\n".join(lines) + "</svg>\n"


def main(raynestd, out, workers=4, spp=8):
    lit = {"size": SIZE, "integrator": "path", "spp": spp, "item_samples": SIZE[0] * ROWS_OF_ITEM * spp}
    warnings.simplefilter("ignore", raynest.RayWarning)
    with Host(many.Setup(raynestd, "worker", ("--threads", "2")), "alone").client() as daemon:
        one = daemon.load(SCENE).render(size=SIZE, integrator="path", spp=spp)
    with Cluster(raynestd, workers) as cluster:
        many.render(cluster.client, SCENE, **{**lit, "spp": 1, "item_samples": 4096}, setup=cluster.setup)     # all load it
        stream = Stream(cluster, lambda progress: many.render(cluster.client, SCENE, **lit, setup=cluster.setup,
                                                              progress=progress))
    differ = sum(int((np.asarray(one[name]).view("u1") != np.asarray(stream.answer[name]).view("u1")).sum()) for name in one)
    title = f"A picture of {SIZE[0]}x{SIZE[1]} with {spp} samples on {workers} workers, which share two cores"
    with open(out, "w", encoding="utf-8") as file:
        file.write(drawn(stream, title))
    print(f"{len(stream.bars)} bars, {stream.seconds:.1f} s, killed at {stream.killed:.1f} s, {differ} bytes differ")


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(int, sys.argv[3:]))
