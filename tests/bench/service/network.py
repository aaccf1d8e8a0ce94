#!/usr/bin/env python3
"""Measures the service on a network with attackers, newcomers and a slow line: ratios within one run.

  network.py RAYNESTD RAYNEST [PART...] [--seconds N] [--idle N]      one JSON object per part

attackers    throughput of 50 clients beside 1,000 slow peers of the TLS port (half a handshake, a byte a
             second, back at once when closed), over that beside a process that uses as much CPU
handshakes   p99 of a connected client beside 2,000 TLS handshakes in 10 s, over its p99 beside a process
             that uses as much CPU
largest      p99 of a connected client beside a viewer who sends the largest requests in a loop, over its p99 beside
             a process that uses as much CPU
crowd        p99 of a connected client beside 100 WebSockets of a viewer that send the texts which are dearest to
             read, over its p99 beside a process that uses as much CPU
line         1 M rays through 50 ms and 100 Mbit/s: bytes of rays per second over that rate
idle         resident bytes of the daemon per idle TLS connection
"""
import argparse
import contextlib
import json
import multiprocessing
import os
import pathlib
import resource
import socket
import ssl
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests/integration"), str(ROOT / "client/python"), str(pathlib.Path(__file__).parent)]

import raynest  # noqa: E402
from connections_test import HELLO, read_frame  # noqa: E402
from link import Link  # noqa: E402
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens  # noqa: E402
from tls import children_cpu, daemon_cpu  # noqa: E402
from turns import dearest_texts  # noqa: E402
from websocket import WebSocket  # noqa: E402

RAY = np.float32([[0, 500, 0, 0, -1, 0]])
PLACES = ("--connections-max", "20000", "--principal-connections-max", "20000")


class Bench:
    def __init__(self, words):
        self.words = words
        folder = tempfile.TemporaryDirectory()
        self.folder, self.out = folder, pathlib.Path(folder.name)
        self.certificates = Certificates(words.raynestd, self.out / "tls")
        self.tokens = Tokens(words.raynestd, self.out / "tokens")
        self.token = self.tokens.add("client")
        self.viewer = self.tokens.add("viewer", "--role", "viewer")
        self.token_file = self.out / "token"
        self.token_file.touch(0o600)
        self.token_file.write_text(self.token)
        self.ca = str(self.certificates.ca)
        self.context = ssl.create_default_context(cafile=self.ca)

    @contextlib.contextmanager
    def daemon(self, *arguments):
        daemon = SecureDaemon(self.words.raynestd, self.certificates, *PLACES, *arguments)
        client = SecureClient(self.words.raynest, daemon.tls, self.ca, self.token)
        try:
            if client.run("load", "builtin:terrain", "--name", "hills", "--share", "public").returncode != 0:
                raise SystemExit("the scene is not loaded")
            yield daemon
        finally:
            daemon.stop()

    # ---- attackers

    def busy(self, uri):
        """Queries per second of 50 clients."""
        load_test = pathlib.Path(self.words.raynest).with_name("raynest-load-test")
        done = subprocess.run([load_test, "--ca", self.ca, "--token-file", self.token_file, "--server", uri, "--json", "hills",
                               "--clients", "50", "--seconds", str(self.words.seconds), "--rays", "1000"],
                              capture_output=True, text=True, check=True)
        return json.loads(done.stdout)["daemon"]["requests_per_second"]

    def attackers(self):
        with self.daemon() as daemon:
            rates = {"beside": [], "alone": []}
            for _ in range(3):
                used, tries = multiprocessing.Value("d", 0.0), multiprocessing.Value("q", 0)
                for name, target, arguments in (("beside", attack, (daemon.port, used, tries)),
                                                ("alone", burn_like, (used,))):
                    process = multiprocessing.Process(target=target, args=arguments, daemon=True)
                    process.start()
                    time.sleep(4)
                    rates[name].append(self.busy(daemon.uri))
                    process.terminate()
                    process.join()
            medians = {name: statistics.median(row) for name, row in rates.items()}
            return {**medians, "attackers_cpu": used.value, "connections_tried": tries.value,
                    "ratio": medians["beside"] / medians["alone"]}

    # ---- handshakes

    def handshakes(self):
        with self.daemon() as daemon:
            return self.late(daemon, shake_hands, daemon.port, self.ca, 2000)

    # ---- largest requests

    def largest(self):
        # The attacker's jobs have their memory; the client's answers need some, too.
        with self.daemon("--http", "127.0.0.1:0", "--memory", "12G", "--tokens", self.tokens.file) as daemon:
            return self.late(daemon, ask_for_most, daemon.http, self.viewer)

    def crowd(self):
        with self.daemon("--http", "127.0.0.1:0", "--tokens", self.tokens.file) as daemon:
            return self.late(daemon, ask_from_many, daemon.http, self.viewer)

    def late(self, daemon, attacker, *arguments, seconds=10.0):
        """The p99 of a client beside an attacker, over that beside the same CPU."""
        scene = raynest.connect(daemon.tls, ca=self.ca, token=self.token).scene("hills")

        def p99(until):
            trips = []
            while not until.is_set():
                begun = time.perf_counter()
                scene.trace(RAY, fields=("t",))
                trips.append(time.perf_counter() - begun)
                time.sleep(0.002)
            return 1e3 * sorted(trips)[int(0.99 * len(trips))], len(trips)

        def beside(target, *given):
            before = daemon_cpu(daemon.process.pid) + children_cpu()
            process = multiprocessing.Process(target=target, args=given)
            ended = threading.Event()
            process.start()
            threading.Thread(target=lambda: (process.join(), ended.set())).start()
            late, trips = p99(ended)
            process.join()
            return late, trips, daemon_cpu(daemon.process.pid) + children_cpu() - before

        rows = []
        for _ in range(3):
            late, trips, used = beside(attacker, *arguments, seconds)
            alone, _, _ = beside(burn_all, seconds, used)
            rows.append({"p99_ms": late, "p99_ms_beside_cpu": alone, "ratio": late / alone,
                         "cpu_seconds": used, "trips": trips})
        return {"rounds": rows, "ratio": statistics.median(row["ratio"] for row in rows)}

    # ---- a long line

    def line(self):
        rate = 12.5e6
        chance = np.random.default_rng(1)
        rays = np.zeros((1_000_000, 6), np.float32)
        rays[:, [0, 2]] = chance.uniform(-400, 400, (len(rays), 2))
        rays[:, 1], rays[:, 4] = 500, -1
        with self.daemon() as daemon, Link(daemon.port, round_trip=0.05, rate=rate) as link:
            scene = raynest.connect(f"tls://127.0.0.1:{link.port}", ca=self.ca, token=self.token).scene("hills")
            rows = []
            for _ in range(3):
                begun = time.perf_counter()
                hits = scene.trace(rays, fields=("t", "prim"))
                seconds = time.perf_counter() - begun
                rows.append(rays.nbytes / seconds / rate)
                assert len(hits["t"]) == len(rays)
            return {"bytes": rays.nbytes, "ratio": statistics.median(rows), "rounds": rows}

    # ---- idle connections

    def idle(self):
        count = self.words.idle
        with self.daemon("--greeting-connections-max", str(count)) as daemon:
            before, crowd = daemon.resident_bytes(), []
            for _ in range(count):
                plain = socket.create_connection(("127.0.0.1", daemon.port), 60)
                plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                wrapped = self.context.wrap_socket(plain, server_hostname="localhost")
                wrapped.sendall(HELLO)
                read_frame(wrapped)
                crowd.append(wrapped)
            each = (daemon.resident_bytes() - before) / count
            client = SecureClient(self.words.raynest, daemon.tls, self.ca, self.token)
            answers = client.run("scenes").returncode == 0
            for connection in crowd:
                connection.close()
            return {"connections": count, "idle_bytes": each, "answers": answers}


def attack(port, used, tries):
    """1,000 connections that send a byte of a handshake each second; `used` is the share of a CPU that this
    process takes, `tries` counts its connections."""
    begun, crowd = time.monotonic(), {}
    while True:
        while len(crowd) < 1000:
            try:
                peer = socket.create_connection(("127.0.0.1", port), 5)
            except OSError:
                break
            peer.setblocking(False)
            crowd[peer] = 0
            tries.value += 1
        for peer in list(crowd):
            try:
                peer.send(bytes.fromhex("16030102000100")[crowd[peer] % 7:][:1])
                crowd[peer] += 1
                if peer.recv(10) == b"":
                    raise ConnectionResetError
            except BlockingIOError:
                continue
            except OSError:
                peer.close()
                del crowd[peer]
        used.value = time.process_time() / (time.monotonic() - begun)
        time.sleep(1)


def burn_like(used):
    burn(3600, 3600 * used.value)


def shake_hands(port, ca, count, seconds):
    context = ssl.create_default_context(cafile=ca)
    begun = time.monotonic()
    for i in range(count):
        time.sleep(max(0.0, begun + seconds * i / count - time.monotonic()))
        with socket.create_connection(("127.0.0.1", port), 30) as plain, \
                context.wrap_socket(plain, server_hostname="localhost"):
            pass


def ask_for_most(http, token, seconds):
    """Asks for the largest films and pictures, eight in one packet, and cancels them."""
    job = {"scene": "hills"}
    film = {"job": job, "integrator": "ao", "samples": 1, "width": 4096, "height": 4096, "encode": "raw"}
    asked = (("Render", film), ("Render", {"job": job, "width": 8192, "height": 8192, "encode": "raw"}),
             ("Heatmap", {"job": job, "width": 4096, "height": 4096, "encode": "raw"}),
             ("Structure", {"scene": "hills", "kind": "boxes", "count": 16384, "depth_max": 32}))
    with WebSocket(http, headers=["Authorization: Bearer " + token]) as peer:
        peer.say("Hello", 0, {"client": "attacker"})
        begun, number = time.monotonic(), 0
        while time.monotonic() - begun < seconds:
            numbers = range(number + 1, number + 9)
            number += 8
            for i in numbers:
                peer.say(asked[i % len(asked)][0], i, asked[i % len(asked)][1])
            time.sleep(0.05)
            for i in numbers:
                peer.say("Cancel", i, {})
            open_ones = set(numbers)
            while open_ones:
                name, request, _, _ = peer.hear()
                if name in ("Error", "Done"):
                    open_ones.discard(request)


def ask_from_many(http, token, seconds, count=100):
    text = dict(dearest_texts())["numbers with exponents"]
    with contextlib.ExitStack() as all_of_them:
        peers = [all_of_them.enter_context(WebSocket(http, headers=["Authorization: Bearer " + token])) for _ in range(count)]
        for peer in peers:
            peer.say("Hello", 0, {"client": "attacker"})
            peer.hear()
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            for peer in peers:
                peer.send("Query 2 " + text)
            for peer in peers:
                while peer.hear()[0] != "Error":
                    pass


def burn_all(seconds, cpu_seconds):
    """Uses CPU evenly on every core, as much in all as the attacker and the daemon did."""
    cores = os.cpu_count()
    others = [multiprocessing.Process(target=burn, args=(seconds, cpu_seconds / cores)) for _ in range(cores)]
    for process in others:
        process.start()
    for process in others:
        process.join()


def burn(seconds, cpu_seconds):
    """Uses CPU of one core evenly."""
    begun, used = time.monotonic(), time.process_time()
    share = min(1.0, cpu_seconds / seconds)
    while time.monotonic() - begun < seconds:
        if time.process_time() - used > share * (time.monotonic() - begun):
            time.sleep(0.001)


def main():
    parts = ("attackers", "handshakes", "largest", "crowd", "line", "idle")
    made = argparse.ArgumentParser()
    made.add_argument("raynestd")
    made.add_argument("raynest")
    made.add_argument("parts", nargs="*", default=parts)
    made.add_argument("--seconds", type=int, default=5)
    made.add_argument("--idle", type=int, default=10000)
    words = made.parse_args()
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    bench = Bench(words)
    for part in words.parts:
        print(json.dumps({"part": part, **getattr(bench, part)()}), flush=True)


if __name__ == "__main__":
    main()
