"""How a scene reaches many hosts, measured with workers on this machine.

  hosts.py scene RAYNESTD [WORKERS [MEGABYTES]]    beside a plain copy of as many bytes to as many processes
"""
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import distributed
import numpy as np

import raynest.dask as many
from raynest._workers import info_of, item

TAKE = """
import socket, sys
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as s:
    room = memoryview(bytearray(int(sys.argv[2])))
    while room:
        room = room[s.recv_into(room):]
    s.sendall(b".")
"""


def plain_copy(data, workers):
    """Seconds in which `workers` processes have the bytes, each over a loopback socket of its own."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        takers = [subprocess.Popen([sys.executable, "-c", TAKE, str(server.getsockname()[1]), str(len(data))])
                  for _ in range(workers)]
        sockets = [server.accept()[0] for _ in takers]
        begin = time.perf_counter()

        def give(to):
            to.sendall(data)
            to.recv(1)
        threads = [threading.Thread(target=give, args=(each,)) for each in sockets]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        seconds = time.perf_counter() - begin
    for taker, each in zip(takers, sockets):
        each.close()
        taker.wait()
    return seconds


class Cluster:
    """A scheduler and workers, each with a daemon of its own."""

    def __init__(self, raynestd, workers):
        self.folder = tempfile.TemporaryDirectory(prefix="raynest-bench-")
        self.file = Path(self.folder.name) / "scheduler.json"
        self.environment = {**os.environ, "RAYNESTD": raynestd}
        self.processes = [self.start("dask_scheduler", "--host", "tcp://127.0.0.1", "--port", "0", "--no-show")]
        while not self.file.exists():
            time.sleep(0.05)
        self.client = distributed.Client(scheduler_file=str(self.file), set_as_default=False)
        self.processes += [self.start("dask_worker", "--no-nanny", "--nthreads", "1", "--local-directory",
                                      self.folder.name) for _ in range(workers)]
        self.client.wait_for_workers(workers, timeout=60)
        self.setup = many.Setup(raynestd, "worker", ("--threads", "1"))

    def start(self, module, *words):
        return subprocess.Popen([sys.executable, "-m", f"distributed.cli.{module}", *words, "--no-dashboard",
                                 "--scheduler-file", str(self.file)], env=self.environment, stdin=subprocess.DEVNULL,
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def workers(self):
        return list(self.client.scheduler_info()["workers"])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.client.close(timeout=2)
        for process in self.processes:
            process.kill()
            process.wait()
        self.folder.cleanup()


def fetched(host, source, _options):
    """An item that fetches a scene's files, and loads nothing."""
    return sum(piece.nbytes for number in range(len(source.files())) for piece in host._read(source, number))


def on_all(cluster, scene, method):
    """Seconds until every worker has carried out the item."""
    begin = time.perf_counter()
    parts = [many.Part({}, source=scene.source) for _ in cluster.workers()]
    missing = cluster.client.submit(item, many.VERSION, cluster.setup, scene.source, method, None, {}, pure=False).result()
    scene.send(cluster.client, missing[1].keys, cluster.workers())
    sent = time.perf_counter() - begin
    done = [cluster.client.submit(item, many.VERSION, cluster.setup, scene.source, method, None, {}, pure=False,
                                  workers=[worker]) for worker in cluster.workers()]
    cluster.client.gather(done)
    return sent, time.perf_counter() - begin


def scene(raynestd, workers=4, megabytes=500):
    triangles = megabytes * 1_000_000 // 48
    chance = np.random.default_rng(1)
    corners = chance.uniform(-50, 50, (triangles, 1, 3)).astype("f4") + chance.uniform(
        -1, 1, (triangles, 3, 3)).astype("f4")
    faces = np.arange(corners.shape[0] * 3, dtype=np.uint32).reshape(-1, 3)
    for round in range(3):
        prepared = many.prepare(corners.reshape(-1, 3), faces)
        data = np.concatenate([np.zeros(0, np.uint8), *prepared._pieces.values()]).tobytes()
        plain = plain_copy(data, workers)
        with Cluster(raynestd, workers) as cluster:
            cluster.client.gather([cluster.client.submit(int, 1, workers=[w], pure=False) for w in cluster.workers()])
            sent, seconds = on_all(cluster, prepared, fetched)
            print(f"{len(data) / 1e6:.0f} MB to {workers} workers: plain {plain:.2f} s, client {sent:.2f} s, all {seconds:.2f} s, {plain / seconds:.2f}", flush=True)
        del prepared


if __name__ == "__main__":
    scene(sys.argv[2], *map(int, sys.argv[3:]))
