#!/usr/bin/env python3
"""The flood of one peer fills neither the log nor the CPU, and hides nobody else.

  flood_test.py RAYNESTD RAYNEST
"""
import contextlib
import fcntl
import json
import os
import pathlib
import re
import subprocess
import tempfile
import time

import websocket
from connections_test import ERROR, HELLO, WELCOME, read_frame
from daemon import PATIENCE, Client, Programs, main, until
from secure_daemon import Certificates, SecureDaemon, Tokens
from websocket import HEADER, Closed, greeted, host_of, post

COUNT = 40            # requests that one connection sends
LINES_PER_SECOND = 6  # for one source and event, with the line that says what was left out
DAMAGED_MAX = 64      # for a connection in a minute
CONTROL_FRAMES_MAX = 1000
PING = 2


class StandingReader(Programs):
    def test_a_reader_of_the_log_that_stands_still_holds_nobody_up(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-test-")))
        reader, writer = os.pipe()
        self.addCleanup(os.close, reader)
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 8192)
        daemon = subprocess.Popen(
            [self.raynestd, "--listen", "tcp://127.0.0.1:0", "--http", "off", "--cuda", "off", "--log-level", "debug",
             "--ready-file", folder / "ready"], stdin=subprocess.DEVNULL, stdout=writer, stderr=writer)
        os.close(writer)
        self.addCleanup(daemon.wait)
        self.addCleanup(daemon.kill)
        until((folder / "ready").exists)
        client = Client(self.raynest, json.loads((folder / "ready").read_text())["listen"][0])
        # A fast machine loads so many in a second that most of their lines are left out as a flood.
        number = 0
        while not client.json("stats")["log_lines_lost"]:
            self.assertLess(number, 2000)
            client.json("load", "builtin:flake", "--name", f"flake-{number}")
            number += 1
        self.assertIn(b" started ", os.read(reader, 1 << 16))
        # Lines that were left out are counted once there is room.
        client.json("unload", "flake-0")
        self.assertIn(b"log_lines_lost", os.read(reader, 1 << 16))
        daemon.terminate()
        daemon.wait(PATIENCE)


class Flood(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest-test-")))
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls")
        websocket.trusted.load_verify_locations(cls.certificates.ca)
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.secrets = {name: cls.tokens.add(name, "--role", role) for name, role in
                       (("eve", "viewer"), ("vera", "viewer"), ("bob", "user"), ("ops", "admin"))}
        cls.daemon = SecureDaemon(cls.raynestd, cls.certificates, "--tokens", cls.tokens.file, "--log-level",
                                  "debug", "--http", "https://127.0.0.1:0")
        cls.addClassCleanup(cls.daemon.stop)
        cls.http = cls.daemon.http

    def bearer(self, name):
        return ["Authorization: Bearer " + self.secrets[name]]

    def stream(self, name):
        stream = greeted(self.http, headers=self.bearer(name))
        self.addCleanup(stream.close)
        return stream

    def lines(self, event):
        return re.findall(rf" {event} (.*)", self.daemon.log())

    def are_bounded(self, *floods, count=COUNT):
        """Calls each (event, flood), which causes `count` lines of the event: few are written, the rest is
        counted."""
        seen = {event: len(self.lines(event)) for event, _ in floods}
        begun = time.monotonic()
        for _, flood in floods:
            flood()
        took = time.monotonic() - begun

        def told(event):
            return self.lines(event)[seen[event]:]

        def counted(event):
            left_out = sum(int(number) for number in re.findall(r"left_out=(\d+)", "\n".join(told(event))))
            return left_out + sum("left_out=" not in line for line in told(event)) >= count
        for event, _ in floods:
            until(lambda: counted(event), lambda: "\n".join([event, *told(event)]))
            if count > LINES_PER_SECOND * (took + 1):  # else all may be written: no second had too many
                self.assertIn("left_out=", "".join(told(event)))
            self.assertLessEqual(len(told(event)), LINES_PER_SECOND * (took + 2), event)

    def connect(self, uri):
        """Connects to tcp:// or tls://."""
        http = uri.replace("tcp://", "http://").replace("tls://", "https://")
        connection = websocket.connect(http)
        self.addCleanup(connection.close)
        return connection

    def nonsense(self):
        connection = self.connect(self.daemon.uri)
        connection.sendall(b"GET / HTTP/1.1\r\n" * 4)
        while connection.recv(4096):
            pass

    # ---- the log

    def test_a_stranger_writes_few_lines_and_hides_nobody(self):
        def flood():
            with websocket.connect(self.http) as stranger:
                ask = f"GET /main.js HTTP/1.1\r\nHost: {host_of(self.http)}\r\n\r\n".encode()
                for _ in range(20):
                    stranger.sendall(ask * 20)
                    answer = b""
                    while answer.count(b"HTTP/1.1 401") < 20:
                        answer += stranger.recv(65536)
        self.are_bounded(("login_refused", flood), count=400)
        # Somebody else in the midst of it has a line.
        eve, vera = self.stream("eve"), self.stream("vera")

        def interrupted():
            for number in range(1, COUNT + 1):
                eve.say("Load", number, {"source": "builtin:flake"})
            vera.say("Load", 1, {"source": "builtin:flake"})
            self.assertEqual(vera.answer(1)[-1][2]["name"], "NOT_ALLOWED")
            for _ in range(COUNT):
                eve.hear()
        self.are_bounded(("request_refused", interrupted))
        self.assertIn("principal=vera", "".join(self.lines("request_refused")))
        self.assertIn("most_of=eve", "".join(self.lines("request_refused")))

    def test_every_event_that_a_client_causes_is_bounded(self):
        bob, ops = self.stream("bob"), self.stream("ops")

        def flood(stream, name, message):
            for number in range(1, COUNT + 1):
                stream.say(name, number, message(number))
                stream.answer(number)
        loaded = {"source": "builtin:flake?depth=1"}
        self.are_bounded(
            ("loaded", lambda: flood(bob, "Load", lambda i: {**loaded, "name": f"s{i}"})),
            ("job", lambda: flood(bob, "Load", lambda _: loaded)),
            ("unloaded", lambda: flood(bob, "Unload", lambda i: {"scene": f"s{i}"})),
            ("refused", lambda: flood(bob, "Info", lambda _: {"scene": "none"})),
            ("admin", lambda: flood(ops, "Admin", lambda _: {"act": "connections"})),
            ("login", lambda: [post(self.http, "/v1/login", "token=" + self.secrets["bob"]) for _ in range(COUNT)]),
            ("greeted", lambda: [self.stream("bob").close() for _ in range(COUNT)]),
            ("closing", lambda: [self.nonsense() for _ in range(COUNT)]))

    # ---- damaged messages

    def test_who_sends_many_damaged_messages_is_closed(self):
        with self.stream("bob") as stream:
            for number in range(1, DAMAGED_MAX + 1):
                stream.send(f"Ping {number} x" if number % 2 else f"Pong2 {number} {{}}")
                self.assertFalse(stream.hear()[2]["closing"])
            stream.say("Ping", 99)
            self.assertEqual(stream.hear()[0], "Pong", "as many as that may come")
            stream.send("Ping 100 x")
            self.assertEqual(stream.hear()[:2], ("Error", 100))
            error = stream.hear()[2]
            self.assertEqual((error["name"], error["closing"]), ("BAD_FRAME", True))
            self.assertIn("more than 64 damaged messages", error["message"])
            self.assertRaises(Closed, stream.hear)

    def test_who_sends_many_damaged_frames_is_closed(self):
        daemon = SecureDaemon(self.raynestd, self.certificates)
        self.addCleanup(daemon.stop)
        for uri in (daemon.uri, daemon.tls):
            connection = self.connect(uri)
            connection.sendall(HELLO)
            self.assertEqual(read_frame(connection), WELCOME)
            for number in range(1, DAMAGED_MAX + 2):
                connection.sendall(HEADER.pack(b"RYN1", PING, 0, 8, 0, 0, number) + b"\xff" * 8)
                self.assertEqual(read_frame(connection), ERROR)
            self.assertEqual([read_frame(connection), read_frame(connection)], [ERROR, None])

    def test_who_sends_many_control_frames_is_closed(self):
        for kind in (websocket.PING, websocket.PONG):
            stream = self.stream("bob")
            for _ in range(CONTROL_FRAMES_MAX):
                stream.send(b"", kind)
            stream.say("Ping", 99)
            while stream.receive()[0] != websocket.TEXT:
                pass
            with self.assertRaises((Closed, OSError)):
                for _ in range(CONTROL_FRAMES_MAX):
                    stream.send(b"", kind)
                    stream.socket.settimeout(0.01)
                    with contextlib.suppress(TimeoutError):
                        stream.receive()
        self.assertIn("more than 1000 control frames came in a minute", self.daemon.log())

    def test_a_damaged_message_costs_as_little_as_a_good_one(self):
        clock = pathlib.Path(f"/proc/{self.daemon.process.pid}/task/{self.daemon.process.pid}/schedstat")
        streams = [self.stream("bob") for _ in range(10)]

        def cost(message):
            """CPU time of the io thread, in ns."""
            before = int(clock.read_text().split()[0])
            for stream in streams:
                for number in range(1, DAMAGED_MAX - 9):
                    stream.send(message.format(number))
                    stream.hear()
            return int(clock.read_text().split()[0]) - before
        good = cost("Ping {} {{}}")
        self.assertLess(cost("Ping {} x"), 6 * good)

    def test_json_of_many_strings_is_refused_before_it_is_parsed(self):
        stream = self.stream("bob")
        for fields in ('"",' * 20_000 + '""', "{}," * 20_000 + "{}", "0," * 30_000 + "0"):
            stream.send(f'Query 7 {{"fields":[{fields}]}}')
            name, _, message, _ = stream.hear()
            self.assertEqual((name, "too many strings or values" in message["message"]), ("Error", True))


if __name__ == "__main__":
    main()
