#!/usr/bin/env python3
"""Tests the cost of connections, and the behaviour when no descriptors are left for more of them.

  connections_test.py RAYNESTD RAYNEST
"""
import contextlib
import pathlib
import resource
import socket
import struct
import sys
import tempfile
import time

from daemon import (Client, Daemon, IMPORTS_GROW, PATIENCE, Programs, is_sanitized, load_test_of, main, skip_sanitized,
                    until)

IDLE = 1000
IDLE_BYTES_MAX = 16 << 10
DESCRIPTORS = 64


def golden(name):
    """Returns the bytes of a message from tests/golden/frames.hex."""
    lines = (pathlib.Path(__file__).parents[1] / "golden" / "frames.hex").read_text().splitlines()
    rows = lines[lines.index("frame " + name) + 1:]
    data = b""
    for row in rows:
        if row.startswith("frame "):
            break
        data += bytes.fromhex(row[6:53]) if row.strip() else b""
    return data


HELLO = golden("Hello")
PING = golden("Ping")
WELCOME, PONG, ERROR = 129, 130, 131


def read_frame(connection):
    """Returns the type of the next frame; None at the end of the stream."""
    def read(count):
        data = b""
        while len(data) < count:
            piece = connection.recv(count - len(data))
            if not piece:
                return None
            data += piece
        return data
    header = read(32)
    if header is None:
        return None
    _, kind, _, control, _, bulk, _ = struct.unpack("<IHHIIQQ", header)
    read(control + bulk)
    return kind


class Connections(Programs):
    def connect(self, daemon):
        host, port = daemon.uri.removeprefix("tcp://").rsplit(":", 1)
        connection = socket.create_connection((host, int(port)), timeout=PATIENCE)
        self.addCleanup(connection.close)
        connection.sendall(HELLO)
        return connection

    def test_an_idle_connection_costs_little_memory(self):
        if min(resource.getrlimit(resource.RLIMIT_NOFILE)) < IDLE + 100:
            resource.setrlimit(resource.RLIMIT_NOFILE,
                               (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=16", "--name", "hills")
        load_test_of(client).json("hills", "--clients", "8", "--seconds", "0.2")
        before = daemon.resident_bytes()
        crowd = [self.connect(daemon) for _ in range(IDLE)]
        self.assertEqual({read_frame(connection) for connection in crowd}, {WELCOME})
        each = (daemon.resident_bytes() - before) / IDLE
        print(f"{each:.0f} bytes per idle connection", file=sys.stderr)
        # A sanitizer surrounds every allocation, or adds several bytes to each.
        self.assertLess(each, IDLE_BYTES_MAX * (8 if is_sanitized(self.raynestd) else 1))
        # Idle connections are served, and so are others beside them.
        crowd[IDLE // 2].sendall(PING)
        self.assertEqual(read_frame(crowd[IDLE // 2]), PONG)
        told = load_test_of(client).json("hills", "--clients", "8", "--seconds", "0.2")
        self.assertGreater(told["daemon"]["requests"], 0)
        self.assertEqual(told["daemon"]["refused"], 0)

    def test_one_principal_leaves_connections_for_others(self):
        with tempfile.TemporaryDirectory() as folder:
            daemon = Daemon(self.raynestd, "--principal-connections-max", "5",
                            "--connections-max", "7", "--give-way-ms", "600000",
                            "--listen", f"unix:{folder}/socket")
            self.addCleanup(daemon.stop)
            crowd = [self.connect(daemon) for _ in range(5)]
            self.assertEqual({read_frame(connection) for connection in crowd}, {WELCOME})
            self.assertEqual(read_frame(self.connect(daemon)), ERROR)
            refused = Client(self.raynest, daemon.uri).run("scenes")
            self.assertEqual(refused.returncode, 6)
            self.assertIn("--principal-connections-max", refused.stderr)
            self.assertEqual(Client(self.raynest, f"unix:{folder}/socket").run("scenes").returncode, 0)
            crowd[0].close()
            until(lambda: read_frame(self.connect(daemon)) == WELCOME)

    def test_answers_that_nobody_reads_are_bounded(self):
        daemon = Daemon(self.raynestd, "--give-way-ms", "300", "--connections-max", "12")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        before = daemon.resident_bytes()
        crowd = [self.connect(daemon) for _ in range(8)]
        flood = PING * 4096
        for connection in crowd:
            connection.setblocking(False)
        left = [flood] * len(crowd)
        # Send until the sockets take no more, however often it is tried. A single pause may only
        # mean that the daemon had no processor time, while it can still answer everything into the
        # kernel's buffers.
        sent, before_pause, pauses = 0, -1, 0
        while pauses < 10:
            pauses = pauses + 1 if sent == before_pause else 0
            before_pause = sent
            self.assertLess(sent, len(crowd) << 26)
            self.assertEqual(client.json("stats")["gave_way_connections"], 0)
            for k, connection in enumerate(crowd):
                with contextlib.suppress(BlockingIOError):
                    while True:
                        count = connection.send(left[k])
                        sent += count
                        left[k] = left[k][count:] or flood
        if not is_sanitized(self.raynestd):  # sanitizers keep freed memory
            self.assertLess(daemon.resident_bytes("VmHWM") - before, len(crowd) << 20)
        # The connections may stay like that while nobody needs their places.
        newcomers = []
        for _ in crowd:
            until(lambda: newcomers.append(self.connect(daemon)) or
                  read_frame(newcomers[-1]) == WELCOME)
        until(lambda: client.run("scenes").returncode == 0)
        self.assertGreaterEqual(client.json("stats")["gave_way_connections"], len(crowd) - 1)

    def test_a_command_whose_output_pauses_goes_on(self):
        """A command behaves as in `raynest query ... | less`."""
        daemon = Daemon(self.raynestd, "--give-way-ms", "50")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=16", "--name", "hills")
        rays = 600 * 500
        paused = client.start("query", "hills", "--generate", "equirectangular", "size=600x500",
                              "--fields", "t,path,position,ng,uv")
        self.addCleanup(paused.kill)
        before = -1  # until the daemon has no more room for answers
        while (traced := client.json("stats")["rays"]) != before or not traced:
            before = traced
            client.json("query", "hills", "--ray", "0,1000,0,0,-1,0")
            before += 1
        self.assertLess(traced, rays)
        output, errors = paused.communicate(timeout=PATIENCE)
        self.assertEqual(paused.returncode, 0, errors)
        self.assertGreaterEqual(output.count("\n"), rays)
        self.assertEqual(client.json("stats")["gave_way_connections"], 0)

    def test_readers_that_pause_give_way_to_a_load(self):
        """Checks that a scene fits once those have gone that pause: the import alone knows its
        size."""
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        daemon = Daemon(self.raynestd, "--memory", "128M", "--give-way-ms", "500")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=8", "--name", "hills")
        # The import takes about 65 MiB; readers that pause leave it no more than 40.
        for _ in range(10):
            paused = client.start("query", "hills", "--generate", "equirectangular",
                                  "size=2000x1000", "--fields", "t,path,position,ng,uv")
            self.addCleanup(paused.communicate)
            self.addCleanup(paused.kill)

        def loaded():
            done = client.run("load", "builtin:terrain", "--name", "land")
            if done.returncode != 0:
                self.assertEqual(done.returncode, 6, done.stderr)
            return done.returncode == 0

        def has_given_way():
            """True once a load has ended a reader. On a slow machine a load may come before the readers
            have filled the memory; its scene makes room for them again."""
            if loaded():
                client.json("unload", "land")
            return client.json("stats")["gave_way_memory"] >= 1

        until(has_given_way)
        until(loaded)

    def switches(self, daemon):
        """Returns how often the daemon's io thread has yielded the processor to wait."""
        status = pathlib.Path(f"/proc/{daemon.process.pid}/status").read_text()
        return int(status.split("voluntary_ctxt_switches:")[1].split()[0])

    def test_without_descriptors_newcomers_hear_that_the_daemon_is_full(self):
        began = time.monotonic()
        daemon = Daemon(self.raynestd, "--give-way-ms", "600000",
                        under=("prlimit", f"--nofile={DESCRIPTORS}"))
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        crowd = [self.connect(daemon) for _ in range(DESCRIPTORS + 20)]
        heard = [read_frame(connection) for connection in crowd]
        served = [connection for connection, kind in zip(crowd, heard) if kind == WELCOME]
        self.assertEqual(set(heard), {WELCOME, ERROR})
        self.assertGreater(len(served), 10)
        refused = client.run("scenes")
        self.assertEqual(refused.returncode, 6, refused.stderr)
        self.assertIn("the daemon has no free connections", refused.stderr)
        self.assertIn("ulimit -n", refused.stderr)
        # The daemon does not spin for a descriptor, and logs this at most once a second.
        before = self.switches(daemon)
        until(lambda: time.monotonic() - began > 0.5)
        self.assertLess(self.switches(daemon) - before, 20)
        lines = daemon.log().count("descriptors_used_up")
        self.assertTrue(0 < lines <= 1 + time.monotonic() - began, lines)
        # An import has descriptors of its own, also when its connection took the last of the others.
        served.pop().close()
        until(lambda: client.run("scenes").returncode == 0)
        loaded = client.run("load", "builtin:terrain?size=16")
        self.assertEqual(loaded.returncode, 0, loaded.stderr)
        for connection in served:
            connection.sendall(PING)
            self.assertEqual(read_frame(connection), PONG)
            connection.close()
        until(lambda: client.run("load", "builtin:terrain?size=16").returncode == 0)

    def test_without_descriptors_who_pauses_gives_way(self):
        daemon = Daemon(self.raynestd, "--give-way-ms", "50",
                        under=("prlimit", f"--nofile={DESCRIPTORS}"))
        self.addCleanup(daemon.stop)
        crowd = [self.connect(daemon) for _ in range(DESCRIPTORS)]
        for newcomer in range(5):
            until(lambda: read_frame(self.connect(daemon)) == WELCOME)
        self.assertEqual(read_frame(crowd[0]), WELCOME)
        self.assertEqual(read_frame(crowd[0]), ERROR)
        self.assertIsNone(read_frame(crowd[0]))


if __name__ == "__main__":
    main()
