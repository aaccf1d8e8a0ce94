#!/usr/bin/env python3
"""/metrics counts who is not allowed and whose connection the daemon ends.

  metrics_kills_test.py RAYNESTD RAYNEST
"""
import contextlib
import ctypes
import socket
import struct
import tempfile
import time

from connections_test import ERROR, HELLO, WELCOME, read_frame
from daemon import Client, Daemon, PATIENCE, Programs, main, second_principal, until
from metrics_test import scrape
from secure_daemon import Certificates, command
from websocket import WebSocket, get, greeted, host_of, place_of

SO_ATTACH_FILTER = 26  # Python has no name for it
ENDED = "raynest_connections_ended_total{{cause=\"{}\"}}".format
REJECTED = "raynest_rejected_total{{reason=\"{}\"}}".format


class Kills(Programs):
    @classmethod
    def setUpClass(cls):
        """Lets a client vanish, which the daemon finds out while the other tests run."""
        cls.lonely = Daemon(cls.raynestd, "--http", "127.0.0.1:0")
        cls.addClassCleanup(cls.lonely.stop)
        Client(cls.raynest, cls.lonely.uri).json("load", "builtin:forest?trees=400", "--name", "forest")
        gone = greeted(cls.lonely.http)
        cls.addClassCleanup(gone.close)
        # The daemon alone sends from now on: what the client sent would acknowledge frames.
        gone.say("Heatmap", 1, {"job": {"scene": "forest"}, "width": 2048, "height": 2048, "encode": "raw"})
        assert gone.hear()[0] == "Started"
        # A socket filter drops all that the daemon sends, as a network that has gone does.
        cls.drop_all = ctypes.create_string_buffer(struct.pack("HBBI", 6, 0, 0, 0))  # BPF: return 0
        gone.socket.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER,
                               struct.pack("HL", 1, ctypes.addressof(cls.drop_all)))

    def start(self, *arguments, token=None):
        """Starts a daemon with a page, and returns it and a client."""
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0", *arguments)
        self.addCleanup(daemon.stop)
        return daemon, Client(self.raynest, daemon.uri, token)

    def connect(self, daemon):
        connection = socket.create_connection(place_of(daemon.uri.replace("tcp", "http")), timeout=PATIENCE)
        self.addCleanup(connection.close)
        connection.sendall(HELLO)
        return connection

    def rises(self, daemon, name, cause=None):
        """Repeats `cause` until a value of /metrics, 0 so far, rises; without one, it may have risen already."""
        if cause:
            self.assertEqual(scrape(daemon.http)[name], 0, name)
        until(lambda: cause and cause() or scrape(daemon.http)[name] > 0, lambda: f"{name} stays 0: {daemon.log()}")

    def test_things_of_another_principal(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        daemon, bob = self.start(*options, token=token)
        bob.json("load", "builtin:terrain?size=8", "--name", "hills", "--share", "public")
        stranger = Client(self.raynest, daemon.uri)
        self.rises(daemon, REJECTED("not_allowed"),
                   lambda: self.assertEqual(stranger.run("unload", "hills").returncode, 4))

    def test_a_token_that_is_wrong(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        daemon, wrong = self.start(*options, token=token[:-4] + "AAAA")
        self.rises(daemon, "raynest_logins_refused_total",
                   lambda: self.assertNotEqual(wrong.run("scenes").returncode, 0))

    def test_requests_that_a_viewer_may_not_send(self):
        daemon, viewer = self.start("--anonymous", "viewer")
        self.rises(daemon, "raynest_requests_refused_total",
                   lambda: self.assertEqual(viewer.run("load", "builtin:terrain?size=8").returncode, 4))
        self.assertGreater(scrape(daemon.http)[REJECTED("not_allowed")], 0)

    def test_a_connection_gives_way_to_a_newcomer(self):
        daemon, _ = self.start("--give-way-ms", "50", "--connections-max", "4")
        crowd = [self.connect(daemon) for _ in range(3)]
        self.assertEqual({read_frame(guest) for guest in crowd}, {WELCOME})
        self.rises(daemon, ENDED("gave_way_connections"), lambda: read_frame(self.connect(daemon)) and None)

    def test_a_newcomer_is_refused_where_nobody_pauses(self):
        daemon, _ = self.start("--give-way-ms", "600000", "--connections-max", "1")
        self.assertEqual(read_frame(self.connect(daemon)), WELCOME)
        self.rises(daemon, "raynest_connections_total{result=\"rejected_limit\"}",
                   lambda: self.assertEqual(read_frame(self.connect(daemon)), ERROR))

    def test_a_connection_without_hello_gives_way_to_another(self):
        daemon, _ = self.start("--greeting-connections-max", "1")
        place = place_of(daemon.uri.replace("tcp", "http"))

        def two_silent():
            for _ in range(2):
                self.addCleanup(socket.create_connection(place, timeout=PATIENCE).close)
        self.rises(daemon, ENDED("gave_way_greeting"), two_silent)

    def test_one_that_pauses_gives_way_to_the_end_of_the_daemon(self):
        daemon, client = self.start("--give-way-ms", "500")
        self.paused_readers(daemon, client)
        # This query keeps the daemon while it drains: its ray does not come, but its client moves frames.
        lively = greeted(daemon.http)
        self.addCleanup(lively.close)
        lively.say("Query", 1, {"job": {"scene": "hills"}, "fields": ["t"], "ray_count": 1})
        self.assertEqual(lively.hear()[0], "Started")
        daemon.process.terminate()
        self.rises(daemon, ENDED("gave_way_draining"), lambda: lively.say("Ping", 0))
        lively.close()
        self.assertEqual(daemon.process.wait(timeout=PATIENCE), 0)

    def test_a_job_gives_way_to_that_of_a_newcomer(self):
        daemon, client = self.start("--give-way-ms", "50", "--total-jobs-max", "1")
        client.json("load", "builtin:terrain?size=8", "--name", "hills")
        paused = greeted(daemon.http)
        self.addCleanup(paused.close)
        # The ray of this query does not come.
        paused.say("Query", 1, {"job": {"scene": "hills"}, "fields": ["t"], "ray_count": 1})
        self.assertEqual(paused.hear()[0], "Started")
        self.rises(daemon, ENDED("gave_way_jobs"),
                   lambda: client.run("query", "hills", "--ray", "0,9,0,0,-1,0") and None)

    def paused_readers(self, daemon, client, count=2):
        """Starts queries whose answers nobody reads; the daemon has more of them than its sockets take."""
        client.json("load", "builtin:terrain?size=8", "--name", "hills")
        for _ in range(count):
            paused = client.start("query", "hills", "--generate", "equirectangular", "size=2000x1000",
                                  "--fields", "t,path,position,ng,uv")
            self.addCleanup(paused.communicate)
            self.addCleanup(paused.kill)
        until(lambda: scrape(daemon.http)["raynest_memory_used_bytes"] > count * (8 << 20))

    def test_readers_that_pause_give_way_to_a_load(self):
        daemon, client = self.start("--memory", "128M", "--give-way-ms", "200")
        # The scene takes 33 MiB and its import up to 65; the readers leave it less than 30.
        self.paused_readers(daemon, client, 11)
        self.rises(daemon, ENDED("gave_way_memory"), lambda: client.run("load", "builtin:terrain") and None)

    def test_a_closing_client_that_does_not_read_is_cut_off(self):
        daemon, client = self.start()
        client.json("load", "builtin:terrain?size=8", "--name", "hills")
        deaf = WebSocket(daemon.http, receive_bytes=4096)
        self.addCleanup(deaf.close)
        deaf.say("Hello", 0, {"client": "deaf"})
        # The answer fills its credit, twice what the kernel takes for a client that does not read.
        deaf.say("Query", 1, {"job": {"scene": "hills"}, "fields": ["t", "path", "position", "ng", "uv"],
                              "generator": {"kind": "equirectangular", "settings": ["size=2000x1000"]}})
        sent = lambda: scrape(daemon.http)["raynest_frame_bytes_total{direction=\"sent\"}"]

        def stuck():
            before = sent()
            time.sleep(0.5)
            return before == sent() > 1 << 16
        until(stuck)
        deaf.send("nonsense")
        self.rises(daemon, "raynest_slow_consumer_disconnects_total")

    def test_an_administrator_ends_a_connection(self):
        with tempfile.TemporaryDirectory() as folder:
            daemon, _ = self.start("--listen", f"unix:{folder}/socket")
            guest = greeted(daemon.http)
            self.addCleanup(guest.close)
            admin = Client(self.raynest, f"unix:{folder}/socket")
            self.rises(daemon, ENDED("kicked"), lambda: self.assertEqual(
                admin.run("admin", "kick", "127.0.0.1").returncode, 0))

    def test_a_token_that_is_revoked_ends_its_connection(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        daemon, _ = self.start(*options, token=token)
        bob = WebSocket(daemon.http)
        self.addCleanup(bob.close)
        bob.say("Hello", 0, {"client": "test", "token": token})
        self.assertEqual(bob.hear()[0], "Welcome")
        command(self.raynestd, "token", "revoke", "bob", *options)
        self.rises(daemon, ENDED("revoked"))

    def test_a_handshake_that_fails(self):
        with tempfile.TemporaryDirectory() as folder:
            certificates = Certificates(self.raynestd, f"{folder}/tls")
            daemon, _ = self.start("--listen", "tls://127.0.0.1:0", *certificates.server)
            place = place_of(next(uri for uri in daemon.listen if uri.startswith("tls")).replace("tls", "http"))

            def nonsense():
                with socket.create_connection(place, timeout=PATIENCE) as plain:
                    plain.sendall(b"nonsense" * 8)
                    plain.recv(4096)
            self.rises(daemon, "raynest_handshakes_failed_total", nonsense)

    def test_http_connections_that_are_too_many_or_too_slow(self):
        daemon, _ = self.start("--http-connections-max", "2")
        ask = f"GET /healthz HTTP/1.1\r\nHost: {host_of(daemon.http)}\r\n\r\n".encode()

        def three_stay():
            for _ in range(3):
                stays = socket.create_connection(place_of(daemon.http), timeout=PATIENCE)
                self.addCleanup(stays.close)
                stays.sendall(ask)
                self.assertIn(b"200 OK", stays.recv(4096))
        self.rises(daemon, ENDED("gave_way_connections"), three_stay)
        # Strangers who are silent, or stop within a request, have the time of a greeting.
        for sent in (b"", b"GET / HTTP/1.1\r\n"):
            before = scrape(daemon.http)["raynest_http_timeouts_total"]
            with socket.create_connection(place_of(daemon.http), timeout=PATIENCE) as stranger:
                stranger.sendall(sent)
                with contextlib.suppress(ConnectionResetError):
                    self.assertEqual(stranger.recv(4096), b"")
            until(lambda: scrape(daemon.http)["raynest_http_timeouts_total"] > before)
        before = scrape(daemon.http)["raynest_http_refused_total{reason=\"request\"}"]
        self.assertEqual(get(daemon.http, "/nothing")[0], 404)
        self.assertEqual(scrape(daemon.http)["raynest_http_refused_total{reason=\"request\"}"], before + 1)

    def test_vanished_client_is_found(self):
        """Runs last: a client counts as gone after 20 s."""
        until(lambda: scrape(self.lonely.http)[ENDED("lost")] > 0, self.lonely.log, patience=PATIENCE + 45)


if __name__ == "__main__":
    main()
