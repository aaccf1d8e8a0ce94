#!/usr/bin/env python3
"""Measures the cost of TLS: ratios over plain TCP, taken in turns within one run.

  tls.py RAYNESTD RAYNEST [--rays N] [--rounds N] [--idle N]      one JSON object

cpu_ratio         CPU of both processes for N closest hits (t, prim) on the terrain, rays from a file
round_trip_ratio  median time of one ray there and back on an open connection
idle_bytes        resident memory of the daemon per idle connection, over TLS and over TCP
"""
import argparse
import json
import pathlib
import resource
import socket
import ssl
import statistics
import sys
import tempfile
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests/integration"), str(ROOT / "client/python")]

import raynest  # noqa: E402
from connections_test import HELLO, read_frame  # noqa: E402
from secure_daemon import Certificates, SecureClient, SecureDaemon  # noqa: E402


def daemon_cpu(pid):
    """Seconds of CPU that the daemon's threads have used, to the nanosecond; none of them has ended."""
    return sum(int(file.read_text().split()[0])
               for file in pathlib.Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


def children_cpu():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def query_cpu(daemon, client, rays, out):
    before = daemon_cpu(daemon.process.pid) + children_cpu()
    done = client.run("query", "hills", "--rays", rays, "--fields", "t,prim", "-o", out, timeout=600)
    assert done.returncode == 0, done.stderr
    return daemon_cpu(daemon.process.pid) + children_cpu() - before


def idle_bytes(daemon, port, count, context):
    before = daemon.resident_bytes()
    crowd = []
    for _ in range(count):
        connection = socket.create_connection(("127.0.0.1", port), 60)
        if context:
            connection = context.wrap_socket(connection, server_hostname="localhost")
        connection.sendall(HELLO)
        read_frame(connection)
        crowd.append(connection)
    each = (daemon.resident_bytes() - before) / count
    for connection in crowd:
        connection.close()
    time.sleep(1)
    return each


def main():
    made = argparse.ArgumentParser()
    made.add_argument("raynestd")
    made.add_argument("raynest")
    made.add_argument("--rays", type=int, default=1_000_000)
    made.add_argument("--rounds", type=int, default=15)
    made.add_argument("--idle", type=int, default=1000)
    words = made.parse_args()
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder)
        certificates = Certificates(words.raynestd, out / "tls")
        daemon = SecureDaemon(words.raynestd, certificates, "--threads", "1", "--connections-max",
                              "20000", "--principal-connections-max", "20000",
                              "--greeting-connections-max", "20000")
        try:
            uris = {"tcp": daemon.uri, "tls": daemon.tls}
            clients = {name: SecureClient(words.raynest, uri, certificates.ca) for name, uri in uris.items()}
            clients["tcp"].run("load", "builtin:terrain", "--name", "hills")
            chance = np.random.default_rng(1)
            rays = np.zeros((words.rays, 6), np.float32)
            rays[:, [0, 2]] = chance.uniform(-400, 400, (words.rays, 2))
            rays[:, 1] = 500
            rays[:, 3:] = chance.normal(0, 0.2, (words.rays, 3))
            rays[:, 4] = -1
            np.save(out / "rays.npy", rays)
            cpu = {name: [] for name in uris}
            for _ in range(words.rounds):
                for name in uris:
                    cpu[name].append(query_cpu(daemon, clients[name], out / "rays.npy", out / "a.npz"))
            trips = {name: [] for name in uris}
            opened = {name: raynest.connect(uri, ca=str(certificates.ca)).scene("hills")
                      for name, uri in uris.items()}
            for _ in range(150 * words.rounds):
                for name, scene in opened.items():
                    begun = time.perf_counter()
                    scene.trace(rays[:1], fields=("t",))
                    trips[name].append(time.perf_counter() - begun)
            context = ssl.create_default_context(cafile=certificates.ca)
            tcp_port = int(daemon.uri.rsplit(":", 1)[1])
            idle = {"tls": idle_bytes(daemon, daemon.port, words.idle, context),
                    "tcp": idle_bytes(daemon, tcp_port, words.idle, None)}
            least = {name: min(values) for name, values in cpu.items()}
            medians = {name: statistics.median(values) for name, values in trips.items()}
            print(json.dumps({
                "rays": words.rays, "cpu_seconds": least, "cpu_ratio": least["tls"] / least["tcp"],
                "round_trip_us": {name: value * 1e6 for name, value in medians.items()},
                "round_trip_ratio": medians["tls"] / medians["tcp"],
                "idle_connections": words.idle, "idle_bytes": idle}))
        finally:
            daemon.stop()


if __name__ == "__main__":
    main()
