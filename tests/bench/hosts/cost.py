"""Measures what dealing out costs: CPU time of all processes, of a cluster of two workers and of one daemon with two threads.

  cost.py RAYNESTD [ROUNDS [RAYS [SPP]]]         by turns; RAYS is a multiple of 2048

A worker's daemon has one thread. Bytes are what the same arrays cost over a plain socket of the loopback; useful is the
CPU time of the cluster's daemons.
"""
import os
import socket
import sys
import threading
import time
import warnings

import numpy as np

import raynest
import raynest.dask as many
from raynest import generators
from raynest._workers import Host
from hosts import Cluster

SCENE = "builtin:forest"
FIELDS = ("t", "prim")
SIZE = (256, 256)
TICK = os.sysconf("SC_CLK_TCK")


def cpu_of(pid):
    """Seconds of a process and of all its children, and those of daemons alone."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
        name, _, numbers = file.read().rpartition(")")
    mine = sum(map(int, numbers.split()[11:15])) / TICK
    total = np.array([mine, mine if "(raynestd" in name else 0.0])
    for thread in os.listdir(f"/proc/{pid}/task"):
        with open(f"/proc/{pid}/task/{thread}/children", encoding="ascii") as file:
            for child in file.read().split():
                total += cpu_of(child)
    return total


def spent(work):
    """Seconds of CPU of this process and its children, those of daemons alone, and seconds."""
    cpu, begin = cpu_of(os.getpid()), time.perf_counter()
    work()
    seconds = time.perf_counter() - begin
    time.sleep(0.3)     # what goes on after the answer counts, too
    return *(cpu_of(os.getpid()) - cpu), seconds


def of_bytes(count):
    """Seconds of CPU in which so many bytes pass a socket."""
    data = np.random.default_rng(1).integers(0, 255, count, np.uint8)
    with socket.create_server(("127.0.0.1", 0)) as server:
        to = socket.create_connection(server.getsockname())
        there, _ = server.accept()
        begin = time.process_time()
        sending = threading.Thread(target=to.sendall, args=(data,))
        sending.start()
        room = memoryview(np.empty(count, np.uint8)).cast("B")
        while room:
            room = room[there.recv_into(room):]
        sending.join()
        seconds = time.process_time() - begin
        to.close()
        there.close()
    return seconds


def main(raynestd, rounds=5, count=2 << 20, spp=64):
    warnings.simplefilter("ignore", raynest.RayWarning)
    lit = {"size": SIZE, "integrator": "path", "spp": spp}
    chance = np.random.default_rng(2)
    rays = np.concatenate([chance.uniform(-40, 40, (count, 3)) + (0, 30, 0), chance.normal(size=(count, 3))], axis=1)
    rays = rays.astype(np.float32)
    made = generators.camera(size=(2048, count // 2048))
    requests = {
        "made rays, t and prim": (count, 8, lambda scene: scene.trace(made, fields=FIELDS),
                                  lambda *to, **how: many.trace(*to, made, fields=FIELDS, **how)),
        "made rays, visible_pixels": (count, 0, lambda scene: scene.trace(made, reduce="visible_pixels"),
                                      lambda *to, **how: many.reduce(*to, made, "visible_pixels", **how)),
        "sent rays, t and prim": (count, 32, lambda scene: scene.trace(rays, fields=FIELDS),
                                  lambda *to, **how: many.trace(*to, rays, fields=FIELDS, **how)),
        f"path, {spp} samples": (spp * SIZE[0] * SIZE[1], 0, lambda scene: scene.render(**lit),
                                 lambda *to, **how: many.render(*to, **lit, **how))}
    print("| request | CPU ns per ray, one daemon | cluster | more | of which bytes | useful CPU | time over one's |\n"
          "| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    alone_host = Host(many.Setup(raynestd, "worker", ("--threads", "2")), "alone")
    with alone_host.client() as one, Cluster(raynestd, 2) as cluster:
        scene = one.load(SCENE)
        for name, (weight, each, alone, dealt) in requests.items():
            def at_once():
                alone(scene)

            def on_all():
                dealt(cluster.client, SCENE, setup=cluster.setup)
            at_once(), on_all()
            found = np.array([(*spent(at_once), *spent(on_all)) for _ in range(rounds)])
            cpu, _, seconds, cpu_all, daemons, seconds_all = np.median(found, axis=0)
            print(f"| {name} | {1e9 * cpu / weight:.0f} | {1e9 * cpu_all / weight:.0f} | {1e9 * (cpu_all - cpu) / weight:.0f} | "
                  f"{1e9 * of_bytes(each * count) / count if each else 0:.0f} | {daemons / cpu_all:.3f} | "
                  f"{seconds_all / seconds:.2f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
