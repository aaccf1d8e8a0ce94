#!/usr/bin/env python3
"""A peer stays admitted only while the same rule would admit it again: each kind of admission, and each
change of tokens, certificates, roles and options.

  readmission_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time

import websocket
from connections_test import ERROR, HELLO, PING, PONG, WELCOME, read_frame
from daemon import PATIENCE, Programs, main, until
from secure_daemon import Certificates, SecureClient, Tokens, command
from websocket import Closed, WebSocket, get, post

# A job that does not end by itself.
ENDLESS = {"job": {"scene": "f", "detach": True}, "integrator": "path", "width": 256, "height": 256,
           "samples": 65536}


class Page:
    """A WebSocket of somebody, with a detached job of its own."""

    def __init__(self, http, headers=()):
        self.stream = WebSocket(http, headers=headers)
        self.stream.say("Hello", 0, {"client": "test"})
        name, _, welcome, _ = self.stream.hear()
        assert name == "Welcome", (name, welcome)
        self.principal = welcome["principal"]

    def detach(self):
        loaded = self.stream.ask("Load", 1, {"source": "builtin:flake?depth=1", "name": "f"})[-1]
        assert loaded[0] == "Loaded", loaded
        answer = self.stream.ask("Render", 2, ENDLESS)[-1]
        assert answer[0] == "Detached", answer
        return answer[2]["job"]

    def answers(self):
        self.stream.say("Ping", 9)
        return self.stream.hear()[0] == "Pong"

    def ends(self):
        """Waits for the last error and the end."""
        name, _, message, _ = self.stream.hear()
        assert (name, message["name"], message["closing"]) == ("Error", "NOT_ALLOWED", True), message
        try:
            self.stream.hear()
        except Closed:
            return True
        return False

    def close(self):
        self.stream.close()


class Plain:
    """A connection without a token: tcp://, or tls:// with a certificate."""

    def __init__(self, uri, context=None):
        place = uri.rsplit("/", 1)[1].rsplit(":", 1)
        self.socket = socket.create_connection((place[0], int(place[1])), PATIENCE)
        if context:
            self.socket = context.wrap_socket(self.socket, server_hostname="localhost")
        self.socket.sendall(HELLO)
        assert read_frame(self.socket) == WELCOME

    def answers(self):
        self.socket.sendall(PING)
        return read_frame(self.socket) == PONG

    def ends(self):
        return read_frame(self.socket) == ERROR and read_frame(self.socket) is None

    def close(self):
        self.socket.close()


class Readmission(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls")
        cls.others = Certificates(cls.raynestd, cls.out / "others")
        robot = cls.certificates.sign("robot", "/CN=robot")
        cls.anybody = ssl.create_default_context(cafile=cls.certificates.ca)
        cls.robot = ssl.create_default_context(cafile=cls.certificates.ca)
        cls.robot.load_cert_chain(robot[1], robot[3])

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.tokens = Tokens(self.raynestd, self.folder / "tokens")
        self.secret = self.tokens.add("alice")
        self.config = self.folder / "raynestd.toml"
        self.options = {"tls-cert": self.certificates.folder / "cert.pem",
                        "tls-key": self.certificates.folder / "key.pem",
                        "client-ca": self.certificates.ca, "tokens": self.tokens.file,
                        "anonymous": "user"}
        self.write()
        ready = self.folder / "ready"
        with open(self.folder / "log", "wb") as log:
            self.process = subprocess.Popen(
                [self.raynestd, "--config", self.config, "--ready-file", ready, "--cuda", "off",
                 "--threads", "1", "--listen", "tcp://127.0.0.1:0", "--listen", "tls://127.0.0.1:0",
                 "--listen", f"unix:{self.folder}/socket", "--http", "https://127.0.0.1:0"],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self.addCleanup(self.end)
        content = json.loads(until(lambda: ready.exists() and ready.read_text()))
        self.tcp, self.tls, _ = content["listen"]
        self.http = content["http"]
        self.root = SecureClient(self.raynest, f"unix:{self.folder}/socket")
        self.open_all()

    def end(self):
        # The second signal ends the jobs that have no end.
        self.process.send_signal(signal.SIGTERM)
        time.sleep(0.1)
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(PATIENCE)

    def write(self, **changes):
        """Writes the configuration; None leaves an option out."""
        options = self.options | {name.replace("_", "-"): value for name, value in changes.items()}
        self.config.write_text("".join(f'{name} = "{value}"\n' for name, value in options.items() if value))

    def reload(self, **changes):
        self.write(**changes)
        self.process.send_signal(signal.SIGHUP)

    def open_all(self):
        """Opens a connection of each kind, and starts a detached job of each principal."""
        bearer = [f"Authorization: Bearer {self.secret}"]
        self.trust(self.anybody)
        cookie = post(self.http, "/v1/login", "token=" + self.secret)[1]["set-cookie"].split(";")[0]
        self.cookie = [f"Cookie: {cookie}"]
        self.peers = {"token": Page(self.http, bearer), "cookie": Page(self.http, self.cookie)}
        jobs = {"token's job": self.peers["token"].detach()}
        self.code = self.peers["token"].stream.ask("Page", 5)[-1][2]["code"]
        self.trust(self.robot)
        self.peers["certificate"] = Page(self.http)
        self.assertEqual(self.peers["certificate"].principal, "CN=robot")
        jobs["certificate's job"] = self.peers["certificate"].detach()
        self.peers["certificate over tls"] = Plain(self.tls, self.robot)
        self.trust(self.anybody)
        self.peers["nothing"] = Plain(self.tcp)
        loopback = SecureClient(self.raynest, self.tcp)
        loopback.json("load", "builtin:flake?depth=1", "--name", "f")
        jobs["nothing's job"] = loopback.json("render", "f", "--size", "256x256", "--samples", "65536",
                                              "--integrator", "path", "--detach")["job"]
        self.jobs = {int(number): name for name, number in jobs.items()}
        for peer in self.peers.values():
            self.addCleanup(peer.close)

    @staticmethod
    def trust(context):
        """Sets as whom the functions of websocket.py connect."""
        websocket.trusted = context

    def running(self):
        jobs = self.root.json("jobs")["jobs"]
        return {self.jobs[int(job["job"])] for job in jobs if job["state"] not in ("done", "failed")}

    def expect(self, *ended):
        """Waits until these kinds have ended, and checks that the others go on."""
        begun = time.monotonic()
        for name, peer in self.peers.items():
            if name in ended:
                self.assertTrue(peer.ends(), name)
        stay = {f"{name}'s job" for name in ("token", "certificate", "nothing")} - set(ended)
        until(lambda: self.running() == stay, lambda: f"{self.running()} run, {stay} should")
        print(f"{self.id().rpartition('.')[2]}: {time.monotonic() - begun:.2f} s", file=sys.stderr)
        for name, peer in self.peers.items():
            if name not in ended:
                self.assertTrue(peer.answers(), name)
        self.assertEqual(get(self.http, "/v1/login", headers=self.cookie)[0], 401 if "cookie" in ended else 200)
        self.assertEqual(post(self.http, "/v1/login", "code=" + self.code + "&agreed=yes")[0], 401 if "token" in ended else 200)

    TOKEN = ("token", "token's job", "cookie")
    CERTIFICATE = ("certificate", "certificate over tls", "certificate's job")

    def test_a_revoked_token(self):
        self.tokens.revoke("alice")
        self.expect(*self.TOKEN)

    def test_another_role(self):
        text = self.tokens.file.read_text()
        self.assertIn("token user ", text)
        self.tokens.file.write_text(text.replace("token user ", "token viewer "))
        self.expect(*self.TOKEN)

    def test_another_token_file(self):
        other = Tokens(self.raynestd, self.folder / "other")
        other.add("bob")
        self.reload(tokens=other.file)
        self.expect(*self.TOKEN)

    def test_a_certificate_that_is_shut_out(self):
        command(self.raynestd, "token", "revoke", "--cert", "CN=robot", "--unlisted", "--tokens",
                self.tokens.file)
        self.expect(*self.CERTIFICATE)

    def test_another_ca(self):
        self.reload(client_ca=self.others.ca)
        self.expect(*self.CERTIFICATE)

    def test_other_content_of_the_ca_file(self):
        copy = self.folder / "ca.pem"
        copy.write_bytes(self.certificates.ca.read_bytes())
        self.reload(client_ca=copy)
        until(lambda: "reloaded" in (self.folder / "log").read_text())
        self.assertTrue(all(peer.answers() for peer in self.peers.values()), "the same CA lets them stay")
        copy.write_bytes(self.others.ca.read_bytes())
        self.process.send_signal(signal.SIGHUP)
        self.expect(*self.CERTIFICATE)

    def test_no_ca(self):
        self.reload(client_ca=None)
        self.expect(*self.CERTIFICATE)

    def test_nobody_anonymous(self):
        self.reload(anonymous="off")
        self.expect("nothing", "nothing's job")

    def test_a_reload_that_changes_nothing(self):
        self.reload()
        until(lambda: "reloaded" in (self.folder / "log").read_text())
        self.expect()

    def test_many_connections_are_asked_in_several_turns(self):
        many = {f"certificate {number}": Plain(self.tls, self.robot) for number in range(40)}
        for peer in many.values():
            self.addCleanup(peer.close)
        self.peers |= many
        self.reload()
        until(lambda: "reloaded" in (self.folder / "log").read_text())
        self.expect()
        self.tokens.revoke("alice")
        self.expect(*self.TOKEN)
        for name in self.TOKEN:
            self.peers.pop(name, None)
        self.reload(client_ca=self.others.ca)
        for name in ("certificate", "certificate over tls", *many):
            self.assertTrue(self.peers[name].ends(), name)
        self.assertTrue(self.peers["nothing"].answers())

    def test_a_connection_before_its_hello_meets_the_new_rule(self):
        place = self.tcp.rsplit("/", 1)[1].rsplit(":", 1)
        early = socket.create_connection((place[0], int(place[1])), PATIENCE)
        self.addCleanup(early.close)
        self.reload(anonymous="off")
        self.expect("nothing", "nothing's job")
        try:
            early.sendall(HELLO)
            self.assertIn(read_frame(early), (ERROR, None))
        except OSError:
            pass  # its time for a Hello was over


if __name__ == "__main__":
    main()
