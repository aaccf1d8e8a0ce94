"""Many hosts: what dealing out costs with 1 to 4 workers on this machine, and on paper with 10,000.

  hosts.py scene RAYNESTD [WORKERS [MEGABYTES]]   how a scene travels, beside a plain copy to as many processes
  hosts.py points [ITEMS]                         items that wait instead of tracing, measured and by the model
  hosts.py model                                  the model alone: where hosts without end lead

Items that wait leave the two cores to Dask, as tracing on other hosts would.
"""
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from typing import NamedTuple

import distributed
import numpy as np

import raynest.dask as many
from raynest._travel import PIECE_BYTES
from raynest._travel import Files
from raynest._workers import item

NOWHERE = many.prepare("/nowhere")     # a scene that no item asks for

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
    files, numbers = Files(source, host._elsewhere), range(len(source.files()))
    files.need(numbers)
    return sum(piece.nbytes for number in numbers for piece in files.read(number))


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


# ---- the model ----------------------------------------------------------------------------------

class Costs(NamedTuple):
    """Seconds, of the one client and the one scheduler unless it says otherwise."""

    item: float = 2e-3          # an item that does nothing, whichever of the two is the slower
    late: float = 10e-3         # a worker's thread, from an answer to its next item
    byte: float = 2e-9          # an answer's, through the client
    link: float = 1 / 1.25e9    # a byte's through a host's network, here 10 Gbit/s


def seconds(costs, items, work, answer, threads):
    """How long `items` items of `work` seconds take, whose answers have so many bytes."""
    client = items * (costs.item + answer * costs.byte)
    return max(client, -(-items // threads) * (work + costs.late)) + costs.late


def scene_seconds(costs, size, hosts, piece=PIECE_BYTES):
    """How long a scene takes to all hosts: the client sends it once, and each piece lies on one host."""
    holders = min(hosts, -(-size // piece))
    return size * costs.link + max(size, hosts * size / holders) * costs.link


def wait(_host, _source, options):
    time.sleep(options["work"])
    return np.zeros(options["answer"], np.uint8)


def dealt(cluster, items, work, answer):
    parts = [many.Part({"work": work, "answer": answer}) for _ in range(items)]
    begin = time.perf_counter()
    for _ in many.Deal(cluster.client, cluster.setup, NOWHERE, wait, parts, 60.0, None).answers():
        pass
    return time.perf_counter() - begin


def measured(cluster):
    """The costs, of items that do nothing, of ones with large answers, and of ones after another."""
    dealt(cluster, 50, 0, 0)
    item = dealt(cluster, 500, 0, 0) / 500
    byte = max(0.0, dealt(cluster, 100, 0, 4 << 20) / 100 - item) / (4 << 20)
    return Costs(item=item, byte=byte, late=max(0.0, dealt(cluster, 30, 0.1, 0) / 30 - 0.1))


def points(items=200):
    print("| workers | seconds of an item | its answer | measured | by the model | ratio |\n| --- | --- | --- | --- | --- | --- |")
    costs = None
    for workers in 1, 2, 3, 4:
        with Cluster("raynestd", workers) as cluster:
            costs = costs or measured(cluster)
            for work, answer in ((0.002, 0), (0.05, 0), (0.05, 2 << 20)):
                took, told = dealt(cluster, items, work, answer), seconds(costs, items, work, answer, workers)
                print(f"| {workers} | {work} | {answer >> 10} KiB | {took:.2f} s | {told:.2f} s | {told / took:.2f} |", flush=True)
    print(f"\nan item {1e3 * costs.item:.1f} ms, between items {1e3 * costs.late:.1f} ms, a byte {1e9 * costs.byte:.1f} ns")


def model(costs=Costs(), threads=16, size=500_000_000, answer=2 << 20):
    """How long the scene takes to so many hosts, and the share of time in which they trace."""
    print("| hosts | scene of 500 MB | items of 1 s | of 1 s, 2 MiB back | of 60 s | of 60 s, 2 MiB back | ends at |\n"
          "| --- | --- | --- | --- | --- | --- | --- |")
    for hosts in 1, 10, 30, 100, 1000, 10000:
        shares = []
        for work, back in ((1, 0), (1, answer), (60, 0), (60, answer)):
            items = 100 * hosts * threads
            shares.append(100 * work / seconds(costs, items, work, back, hosts * threads))
        ends = ("the scheduler" if costs.item > answer * costs.byte else "the client") if shares[1] < 0.9 else "nothing"
        print(f"| {hosts} | {scene_seconds(costs, size, hosts):.1f} s | " +
              " | ".join(f"{100 * share:.0f} %" for share in shares) + f" | {ends} |")


if __name__ == "__main__":
    names = {"scene": scene, "points": points, "model": model}
    words = sys.argv[2:]
    names[sys.argv[1]](*(int(word) if word.isdigit() else word for word in words))
