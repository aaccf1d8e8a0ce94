#!/usr/bin/env python3
"""What connections cost, and what happens when there are no descriptors left for more of them.

  connections_test.py RAYNESTD RAYNEST
"""
import contextlib
import pathlib
import resource
import select
import signal
import socket
import struct
import sys
import tempfile
import time
import unittest

from daemon import Client, Daemon, PATIENCE, is_sanitized, until

IDLE = 1000
IDLE_BYTES_MAX = 16 << 10
DESCRIPTORS = 64


def golden(name):
    """The bytes of a message, from tests/golden/frames.hex."""
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
    """The type of the next frame; None at the end of the stream."""
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


class Connections(unittest.TestCase):
    raynestd = None
    raynest = None

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
        client.json("load-test", "hills", "--clients", "8", "--seconds", "0.2")
        before = daemon.resident_bytes()
        crowd = [self.connect(daemon) for _ in range(IDLE)]
        self.assertEqual({read_frame(connection) for connection in crowd}, {WELCOME})
        each = (daemon.resident_bytes() - before) / IDLE
        print(f"{each:.0f} bytes per idle connection", file=sys.stderr)
        # A sanitizer puts something around every allocation, or several bytes beside each of it.
        self.assertLess(each, IDLE_BYTES_MAX * (8 if is_sanitized(self.raynestd) else 1))
        # They are served, and so are others beside them.
        crowd[IDLE // 2].sendall(PING)
        self.assertEqual(read_frame(crowd[IDLE // 2]), PONG)
        told = client.json("load-test", "hills", "--clients", "8", "--seconds", "0.2")
        self.assertGreater(told["daemon"]["requests"], 0)
        self.assertEqual(told["daemon"]["refused"], 0)

    def test_one_principal_leaves_connections_for_others(self):
        with tempfile.TemporaryDirectory() as folder:
            daemon = Daemon(self.raynestd, "--principal_connections_max", "5",
                            "--connections_max", "7", "--listen", f"unix:{folder}/socket")
            self.addCleanup(daemon.stop)
            crowd = [self.connect(daemon) for _ in range(5)]
            self.assertEqual({read_frame(connection) for connection in crowd}, {WELCOME})
            self.assertEqual(read_frame(self.connect(daemon)), ERROR)
            refused = Client(self.raynest, daemon.uri).run("scenes")
            self.assertEqual(refused.returncode, 6)
            self.assertIn("principal_connections_max", refused.stderr)
            self.assertEqual(Client(self.raynest, f"unix:{folder}/socket").run("scenes").returncode, 0)
            crowd[0].close()
            until(lambda: read_frame(self.connect(daemon)) == WELCOME)

    def test_answers_that_nobody_reads_are_bounded(self):
        daemon = Daemon(self.raynestd, "--slow_consumer_ms_max", "1500")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        before = daemon.resident_bytes()
        crowd = [self.connect(daemon) for _ in range(8)]
        flood = PING * 4096
        for connection in crowd:
            connection.setblocking(False)
        left = [flood] * len(crowd)
        # Until each was closed for not reading: one pause in what is sent may only mean that the
        # daemon had no processor, and that it can answer all of it into the kernel's buffers.
        sent, before_pause = 0, -1
        while client.json("stats")["slow_consumers"] < len(crowd):
            if sent != before_pause:
                before_pause, end = sent, time.monotonic() + PATIENCE
            self.assertLess(time.monotonic(), end)
            self.assertLess(sent, len(crowd) << 26)
            for k, connection in enumerate(crowd):
                with contextlib.suppress(OSError):  # full, or closed
                    while True:
                        count = connection.send(left[k])
                        sent += count
                        left[k] = left[k][count:] or flood
        if not is_sanitized(self.raynestd):  # which keeps what was freed
            self.assertLess(daemon.resident_bytes("VmHWM") - before, len(crowd) << 20)

    def test_a_closed_terminal_drains_as_sigterm_does(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "socket"
            daemon = Daemon(self.raynestd, "--listen", f"unix:{path}")
            self.addCleanup(daemon.folder.cleanup)
            self.assertTrue(path.exists())
            daemon.process.send_signal(signal.SIGHUP)
            self.assertEqual(daemon.process.wait(PATIENCE), 0)
            self.assertFalse(path.exists())

    def switches(self, daemon):
        """How often the daemon's io thread has given up the processor to wait."""
        status = pathlib.Path(f"/proc/{daemon.process.pid}/status").read_text()
        return int(status.split("voluntary_ctxt_switches:")[1].split()[0])

    def test_without_descriptors_accepting_waits_and_recovers(self):
        began = time.monotonic()
        daemon = Daemon(self.raynestd, under=("prlimit", f"--nofile={DESCRIPTORS}"))
        self.addCleanup(daemon.stop)
        crowd = [self.connect(daemon) for _ in range(DESCRIPTORS + 20)]
        until(lambda: "accept_failed" in daemon.log())
        until(lambda: len(select.select(crowd, [], [], 0)[0]) > 10)
        served = []
        for connection in crowd:
            connection.settimeout(0.05)
            try:
                if read_frame(connection) == WELCOME:
                    served.append(connection)
            except TimeoutError:
                pass
        waiting = [connection for connection in crowd if connection not in served]
        self.assertGreater(len(served), 10)
        self.assertGreater(len(waiting), 20)
        # It tries again a few times a second at most, and says so once a second at most.
        before = self.switches(daemon)
        paused = time.monotonic()
        time.sleep(2.2)
        tries = self.switches(daemon) - before
        self.assertLess(tries, 20 * (time.monotonic() - paused))
        lines = daemon.log().count("accept_failed")
        self.assertTrue(0 < lines <= 1 + time.monotonic() - began, lines)
        served[0].settimeout(PATIENCE)
        served[0].sendall(PING)
        self.assertEqual(read_frame(served[0]), PONG)
        for connection in served:
            connection.close()
        for connection in waiting:
            connection.settimeout(PATIENCE)
            self.assertEqual(read_frame(connection), WELCOME)
            connection.close()


if __name__ == "__main__":
    Connections.raynestd, Connections.raynest = sys.argv[1:3]
    unittest.main(argv=sys.argv[:1])
