#!/usr/bin/env python3
"""The command line and the Python client promise the same: whom they send a token, what they keep in
hosts.toml, and how they show what a daemon sends.

  agree_test.py RAYNESTD RAYNEST FLATC
"""
import json
import os
import pathlib
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from unittest import mock

import numpy as np

import raynest
from both_clients import BothClients
from daemon import PATIENCE, Programs
from secure_daemon import Certificates, SecureDaemon, Tokens
from with_fake import WithFake, frame
from with_daemon import main

SECRET = "rnt_" + "5" * 64
# Colours a terminal, rings, deletes, and begins a control sequence of 8 bits.
EVIL = "a\x1b[31mb\x07c\x7fd\x9be"
SHOWN = "a?[31mb?c?d?e"
CONTROLS = tuple(chr(code) for code in (*range(10), *range(11, 32), *range(127, 160)))


class WithConfig(Programs):
    def setUp(self):
        self.out = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.config = self.out / "config"
        self.hosts = self.config / "raynest" / "hosts.toml"
        self.hosts.parent.mkdir(parents=True)
        self.both = BothClients(self.raynest, self.config)

    def write_hosts(self, text):
        self.hosts.touch(0o600)
        self.hosts.write_bytes(text if isinstance(text, bytes) else text.encode())

    def says(self, uri, code, *texts, without=(), **environment):
        for name, done in self.both.run(uri, **environment):
            with self.subTest(client=name, uri=uri):
                self.assertEqual(done.returncode, code, done.stderr)
                for text in texts:
                    self.assertIn(text, done.stdout + done.stderr)
                for text in without:
                    self.assertNotIn(text, done.stdout + done.stderr)


class Secrets(WithConfig):
    def test_a_token_goes_in_clear_text_to_loopback_addresses_only(self):
        for host in ("127.evil.invalid", "127.0.0.1.evil.invalid", "localhost.evil.invalid", "192.0.2.1",
                     "127.1", "0177.0.0.1", "[::2]", "[::ffff:192.0.2.1]", "0.0.0.0", "[::]"):
            self.says(f"tcp://{host}:9", 2, "is not sent to", RAYNEST_TOKEN=SECRET)

    def test_a_kept_token_is_no_less_secret(self):
        self.write_hosts(f'["tcp://127.evil.invalid:9"]\ntoken = "{SECRET}"\n')
        self.says("tcp://127.EVIL.invalid:9", 2, "is not sent to", without=[SECRET])

    def test_loopback_addresses_and_localhost_get_it(self):
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
            for host in ("127.0.0.1", "127.9.8.7", "LocalHost", "localhost", "[::1]", "[::ffff:127.0.0.1]"):
                self.says(f"tcp://{host}:{port}", 3, "cannot connect", RAYNEST_TOKEN=SECRET)

    def test_the_address_that_answers_counts_not_the_name_alone(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            uri = f"tcp://localhost:{server.getsockname()[1]}"
            with mock.patch("raynest._net.address.is_loopback", lambda host: False), \
                    self.assertRaisesRegex(raynest.UsageError, "is not sent to"):
                raynest.connect(uri, token=SECRET)
            accepted = server.accept()[0]
            self.assertEqual(accepted.recv(1), b"")

    def test_addresses_with_odd_hosts_are_refused_by_name(self):
        for uri in ("tls://a/../b:5", "tcp://a b:5", "tls://me@host:5", "tcp://[::1:5", "tcp://host:0",
                    "tls://host:65536", "tcp://:5"):
            self.says(uri, 2, "HOST:PORT with a port from 1 to 65535")

    def test_tcp_on_a_port_of_tls_is_told_after_one_try(self):
        """By raynestd, which answers in words, and by other servers' alert."""
        answers = {"raynestd": frame("Error", {"code": 1, "message": "this port is encrypted: connect to it "
                                               "with tls:// in place of tcp://", "closing": True}, 0),
                   "another": bytes.fromhex("15030100020246")}
        for server, answer in answers.items():
            tries = []
            with socket.create_server(("127.0.0.1", 0)) as listener:
                def serve(listener=listener, answer=answer, tries=tries):
                    while True:
                        try:
                            accepted = listener.accept()[0]
                        except OSError:
                            return
                        tries.append(1)
                        accepted.recv(4096)
                        accepted.sendall(answer)
                        accepted.close()
                thread = threading.Thread(target=serve)
                thread.start()
                with self.subTest(server=server):
                    self.says(f"tcp://127.0.0.1:{listener.getsockname()[1]}", 3,
                              "connect to it with tls:// in place of tcp://", without=["trying again"])
                listener.shutdown(socket.SHUT_RDWR)
                thread.join()
            self.assertEqual(len(tries), 2)  # one of each client


class Hosts(WithConfig):
    @classmethod
    def setUpClass(cls):
        folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.certificates = Certificates(cls.raynestd, folder / "tls", "localhost")
        tokens = Tokens(cls.raynestd, folder / "tokens")
        cls.secret = tokens.add("alice")
        cls.daemon = SecureDaemon(cls.raynestd, cls.certificates, "--tokens", tokens.file, "--client-ca",
                                  cls.certificates.ca, host="localhost")
        cls.addClassCleanup(cls.daemon.stop)
        cls.uri = f"tls://localhost:{cls.daemon.port}"

    def run_raynest(self, *arguments, words="", **environment):
        return subprocess.run([self.raynest, *map(str, arguments)], input=words, text=True,
                              env={**self.both.environment, **environment}, capture_output=True,
                              timeout=PATIENCE)

    def log_in(self, uri, *options):
        done = self.run_raynest(*options, "login", uri, words=self.secret + "\n")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_certificate_is_kept_without_a_token(self):
        none = self.run_raynest("--ca", self.certificates.ca, "login", self.uri, words="\n")
        self.assertEqual(none.returncode, 2)
        self.assertIn("no token came", none.stderr)
        done = self.run_raynest("--ca", self.certificates.ca, *self.certificates.client, "login", self.uri, words="\n")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("as CN=raynest-client", done.stdout)
        self.assertNotIn("token", self.hosts.read_text())
        self.says(self.uri, 0)

    def test_a_broken_line_does_not_block_the_others(self):
        entry = f'["{self.uri}"]\ntoken = "{self.secret}"\nca = "{self.certificates.ca}"\n'
        for broken, number in ((f"nonsense\n{entry}", 1), (entry + "token = broken\n", 4),
                               (entry + '["tls://other:1"\ntoken = "other"\n', 4),
                               (entry.encode() + b'name = "\xff"\n', 4)):
            self.write_hosts(broken)
            self.says(self.uri, 0, f"hosts.toml: line {number} cannot be read",
                      without=["broken", "nonsense"])

    def test_lines_below_a_broken_heading_are_nobody_s(self):
        self.write_hosts(f'["{self.uri}"]\nca = "{self.certificates.ca}"\n["tls://other:1"\n'
                         f'token = "{self.secret}"\n')
        self.says(self.uri, 4, "asks for a token")

    def test_names_are_compared_without_case(self):
        self.log_in(f"tls://LocalHost:{self.daemon.port}", "--ca", self.certificates.ca)
        self.says(self.uri, 0)
        self.says(f"tls://LOCALHOST:{self.daemon.port}", 0)
        self.write_hosts(f'["TLS://LOCALHOST:{self.daemon.port}"]\ntoken = "{self.secret}"\n'
                         f'ca = "{self.certificates.ca}"\n')
        self.says(self.uri, 0)

    def test_login_keeps_the_certificates_themselves(self):
        given = self.out / "given"
        given.mkdir()
        for name in ("ca.pem", "client-cert.pem", "client-key.pem"):
            shutil.copy(self.certificates.folder / name, given)
        self.log_in(self.uri, "--ca", given / "ca.pem", "--cert", given / "client-cert.pem", "--key",
                    given / "client-key.pem")
        shutil.rmtree(given)
        self.says(self.uri, 0)
        kept = sorted(file.name for file in self.hosts.parent.iterdir())
        host = f"localhost:{self.daemon.port}"
        self.assertEqual(kept, ["hosts.toml", f"{host}.ca.pem", f"{host}.cert.pem", f"{host}.key.pem"])
        for file in self.hosts.parent.iterdir():
            self.assertEqual(stat.S_IMODE(file.stat().st_mode), 0o600, file)
        # A folder that moves takes its copies along.
        moved = self.out / "moved"
        self.config.rename(moved)
        self.says(self.uri, 0, XDG_CONFIG_HOME=str(moved))

    def test_a_second_login_takes_the_place_of_the_first(self):
        self.log_in(self.uri, "--ca", self.certificates.ca)
        self.log_in(self.uri.upper().replace("TLS", "tls"), *self.certificates.client)
        self.assertEqual(self.hosts.read_text().count("token"), 1)
        self.assertEqual(len(list(self.hosts.parent.iterdir())), 4)
        self.says(self.uri, 0)

    def test_logout_removes_what_was_kept_of_one_daemon(self):
        others = '# mine\nbroken line\n["tls://other:1"]\ntoken = "other"\n'

        def by_command(uri):
            done = self.run_raynest("logout", uri)
            self.assertEqual(done.returncode, 0, done.stderr)
            return "logged out" in done.stdout

        def by_option(uri):
            done = self.run_raynest("--json", "logout", RAYNEST_SERVER=uri)
            return json.loads(done.stdout)["removed"]

        def by_python(uri):
            with mock.patch.dict(os.environ, {"XDG_CONFIG_HOME": str(self.config)}):
                return raynest.logout(uri)
        for log_out in (by_command, by_option, by_python):
            with self.subTest(log_out=log_out.__name__):
                self.write_hosts(others)
                self.log_in(self.uri, "--ca", self.certificates.ca, *self.certificates.client)
                self.says(self.uri, 0)
                self.assertTrue(log_out(self.uri.upper().replace("TLS", "tls")))
                self.assertEqual(self.hosts.read_text(), others)
                self.assertEqual([file.name for file in self.hosts.parent.iterdir()], ["hosts.toml"])
                self.assertEqual(stat.S_IMODE(self.hosts.stat().st_mode), 0o600)
                self.assertFalse(log_out(self.uri))
                self.says(self.uri, 4, "asks for a token", RAYNEST_CA=str(self.certificates.ca))

    def test_logout_leaves_files_from_elsewhere(self):
        ca = self.out / "ca.pem"
        shutil.copy(self.certificates.ca, ca)
        for name in (str(ca), "../../ca.pem"):
            self.write_hosts(f'["{self.uri}"]\ntoken = "x"\nca = "{name}"\n')
            self.assertIn("logged out", self.run_raynest("logout", self.uri).stdout)
            self.write_hosts(f'["{self.uri}"]\ntoken = "x"\nca = "{name}"\n')
            with mock.patch.dict(os.environ, {"XDG_CONFIG_HOME": str(self.config)}):
                self.assertTrue(raynest.logout(self.uri))
        self.assertTrue(ca.exists())

    def test_python_before_3_11_reads_what_login_writes(self):
        self.log_in(self.uri, "--ca", self.certificates.ca)
        before = raynest._net.hosts._parse(self.hosts.read_text())
        with mock.patch.dict(sys.modules, {"tomllib": None}):
            self.assertEqual(raynest._net.hosts._parse(self.hosts.read_text()), before)
        self.assertEqual(before.broken, [])

    def test_the_environment_counts_before_what_login_keeps(self):
        self.log_in(self.uri, "--ca", self.certificates.ca)
        self.says(self.uri, 0)
        self.says(self.uri, 4, "is unknown here", RAYNEST_TOKEN="rnt_" + "0" * 64)

    def test_a_token_is_one_word(self):
        self.says(self.uri, 2, "one word", RAYNEST_TOKEN="two words")
        self.says(self.uri, 0, RAYNEST_TOKEN=f" {self.secret}\n", RAYNEST_CA=str(self.certificates.ca))


class Documents(WithFake):
    EXPLAINED = {
        "ray": {"origin": [0, 0, 0], "direction": [0, 0, -1], "tmin": 0, "tmax": None}, "scene": EVIL,
        "epoch": 1, "intersector": EVIL, "target": EVIL, "levels": [], "left_out": 0, "steps": [],
        "totals": dict.fromkeys(("total", "boxes", "nodes", "prims", "leaves", "instances", "rejects"), 1),
        "hit": {"name": EVIL, "mesh": EVIL, "prim": 1, "geom": 0, "material": EVIL, "t": 1, "step": None,
                "position": [0, 0, 1]}, EVIL: [EVIL, {"deep": EVIL}]}
    RANKED = {
        "rays": 1, "camera": EVIL, "total": {"boxes": 1, "prims": 1}, "level": None,
        "instances": {"rows": [{"name": EVIL, "mesh": EVIL + "2", "share": 1, "wasted": 0, "path": 1,
                                "placements": 1, "work_per_ray": 1, "rays": 1}], "others": {"rows": 0, "share": 0},
                      "remainder": {"share": 0}},
        "meshes": {"rows": []}, "materials": {"rows": []},
        "findings": [{"finding": EVIL, "subject": EVIL, "figure": 1, "unit": EVIL, "side": EVIL,
                      "threshold": 1, "share": 1, "remedy": EVIL}]}

    def serve(self, document):
        text = document if isinstance(document, bytes) else json.dumps(document).encode()

        def script(peer):
            while True:
                name, _, _ = peer.read()
                if name == "Info":
                    peer.send("SceneInfo", {"name": "fake", "epoch": 1})
                elif name in ("Explain", "Blame"):
                    peer.send("Started", {"scene": "fake", "epoch": 1})
                    peer.send("Payload", {"width": 1, "height": 1, "encode": "json", "total": len(text)},
                              data=np.frombuffer(text, np.uint8))
                    peer.send("Done", {"rays": 1})
        return self.fake(script)

    def run_raynest(self, document, *arguments):
        return subprocess.run([WithConfig.raynest, "--server", self.serve(document), *arguments],
                              capture_output=True, text=True, timeout=PATIENCE, stdin=subprocess.DEVNULL)

    def assert_plain(self, text):
        self.assertEqual([c for c in CONTROLS if c in text], [])

    def test_documents_reach_a_terminal_without_control_characters(self):
        for document, arguments in ((self.EXPLAINED, ("explain", "fake", "--ray", "0,0,0,0,0,-1")),
                                    (self.RANKED, ("heatmap", "fake", "--top", "1"))):
            with self.subTest(arguments=arguments):
                done = self.run_raynest(document, *arguments)
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn(SHOWN, done.stdout)
                self.assert_plain(done.stdout + done.stderr)

    def test_json_escapes_them(self):
        done = self.run_raynest(self.EXPLAINED, "--json", "explain", "fake", "--ray", "0,0,0,0,0,-1")
        self.assert_plain(done.stdout)
        self.assertIn(r"a\u001b[31mb\u0007c\u007fd\u009be", done.stdout)
        self.assertEqual(json.loads(done.stdout), self.EXPLAINED)

    def test_python_s_documents_have_none(self):
        with raynest.connect(self.serve(self.EXPLAINED)) as client:
            document = raynest.Scene(client, "fake").explain([0, 0, 0, 0, 0, -1])
        self.assertEqual((document["hit"]["name"], document[SHOWN]), (SHOWN, [SHOWN, {"deep": SHOWN}]))
        with raynest.connect(self.serve(self.RANKED)) as client:
            document = raynest.Scene(client, "fake").blame(top=1)
        self.assertEqual(document["findings"][0]["remedy"], SHOWN)

    def test_a_document_without_end_or_floor_is_none(self):
        for text in (b"[" * 100_000, b'{"a":' * 100_000, b"{", b"\xff", b"[]" * 2):
            done = self.run_raynest(text, "--json", "explain", "fake", "--ray", "0,0,0,0,0,-1")
            self.assertEqual((done.returncode, done.stderr.count("\n")), (1, 1), done.stderr)
            with raynest.connect(self.serve(text)) as client, self.assertRaises(raynest.ProtocolError):
                raynest.Scene(client, "fake").explain([0, 0, 0, 0, 0, -1])

    def test_names_of_columns_are_plain(self):
        def script(peer):
            while True:
                name, _, _ = peer.read()
                if name == "Info":
                    peer.send("SceneInfo", {"name": "fake", "epoch": 1})
                elif name == "QueryRays":
                    peer.send("Started", {"scene": "fake", "epoch": 1})
                    peer.send("Chunk", {"count": 1}, **{EVIL: np.zeros(1, np.float32)})
        done = subprocess.run([WithConfig.raynest, "--server", self.fake(script), "query", "fake", "--ray",
                               "0,0,0,0,0,-1"], capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assert_plain(done.stdout + done.stderr)

    def test_errors_about_odd_file_names_are_one_plain_line(self):
        done = subprocess.run([WithConfig.raynest, "--local", "info", f"/none/{EVIL}\n.glb"],
                              capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assert_plain(done.stderr)


if __name__ == "__main__":
    main()
