#!/usr/bin/env python3
"""Reloads: security options are judged against what is open, and each option works as at a start.

  reload_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import re
import signal
import subprocess
import tempfile

import websocket
from daemon import PATIENCE, Programs, main, until
from secure_daemon import Certificates, SecureClient, Tokens
from websocket import get, post

ROOT = pathlib.Path(__file__).resolve().parents[2]


class Reloads(Programs):
    @classmethod
    def setUpClass(cls):
        folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.certificates = Certificates(cls.raynestd, folder / "tls")
        cls.ca = cls.certificates.ca
        websocket.trusted.load_verify_locations(cls.ca)

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.tokens = Tokens(self.raynestd, self.folder / "tokens")
        self.secret = self.tokens.add("alice")
        self.config = self.folder / "raynestd.toml"
        self.reloads = 0

    TLS = property(lambda self: {"tls-cert": str(self.certificates.folder / "cert.pem"),
                                 "tls-key": str(self.certificates.folder / "key.pem")})

    def write(self, **options):
        self.config.write_text("".join(f"{name.replace('_', '-')} = {json.dumps(value)}\n"
                                       for name, value in options.items()))

    def start(self, *listen, http="off", **options):
        """Starts a daemon; `options` are those of its file. Port 0 stays in the file, as listen and http do."""
        self.fixed = {"listen": [*listen, f"unix:{self.folder}/socket"], "http": http, "cuda": "off"}
        ready = self.folder / "ready"
        self.write(**self.fixed, **options)
        with open(self.folder / "log", "wb") as log:
            self.process = subprocess.Popen([self.raynestd, "--config", self.config, "--ready-file", ready],
                                            stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self.addCleanup(self.end)
        content = json.loads(until(lambda: ready.exists() and ready.read_text()))
        self.uris = {uri.split(":")[0]: uri for uri in content["listen"]}
        self.http = content["http"]

    def end(self):
        self.process.terminate()
        self.process.wait(PATIENCE)

    def log(self, event):
        """Returns the lines of an event."""
        return re.findall(rf"^\S+ \S+ {event} .*$", (self.folder / "log").read_text(), re.MULTILINE)

    def reload(self, fixed=None, **options):
        """Reloads, and returns the names that the log says changed, and those that need a restart."""
        self.write(**(self.fixed if fixed is None else fixed), **options)
        waiting = len(self.log("restart_needed"))
        self.process.send_signal(signal.SIGHUP)
        self.reloads += 1
        line = until(lambda: self.log("reloaded")[self.reloads - 1:])[0]
        changed = re.search(r' changed=("[^"]*"|\S*)', line)[1].strip('"')
        needed = self.log("restart_needed")[waiting:]
        return changed, re.search(r" options=(\S*)", needed[0])[1] if needed else ""

    def code(self, transport, token=None):
        """The exit code of a command, or the status of the page: of a stranger, or with a token."""
        if transport == "http":
            headers = [f"Authorization: Bearer {token}"] if token else []
            return {200: 0, 401: 4}[get(self.http, "/v1/login", headers=headers)[0]]
        return SecureClient(self.raynest, self.uris[transport], self.ca, token).run("scenes").returncode

    def strangers(self):
        transports = [name for name in ("tcp", "tls") if name in self.uris] + ["http"]
        return {name: self.code(name) for name in transports}

    # ---- what is open to whom

    def test_taking_tls_and_tokens_out_of_the_file_opens_nothing(self):
        security = {**self.TLS, "tokens": str(self.tokens.file)}
        self.start("tcp://127.0.0.1:0", "tls://127.0.0.1:0", http="https://127.0.0.1:0", **security)
        before = {"tcp": 0, "tls": 4, "http": 4}
        self.assertEqual(self.strangers(), before)
        changed, needed = self.reload({**self.fixed, "listen": ["tcp://127.0.0.1:0"], "http": "127.0.0.1:0"},
                                      log_level="debug")
        self.assertEqual((changed, needed), ("log-level", "tls-cert,tls-key,tokens,listen,http"))
        self.assertEqual(self.strangers(), before)
        self.assertIn("tls://", self.log("restart_needed")[0])
        self.assertEqual(self.code("tls", self.secret), 0)
        self.assertEqual(SecureClient(self.raynest, self.uris["tls"], self.ca, "rnt_wrong").run("scenes").returncode, 4)
        # The tokens are still watched, and an administrator is told.
        self.tokens.revoke("alice")
        until(lambda: self.code("tls", self.secret) == 4)
        said = SecureClient(self.raynest, self.uris["unix"]).run("admin", "reload")
        self.assertEqual(said.returncode, 0, said.stderr)
        self.assertIn("wait for a restart: tls-cert,tls-key,tokens", said.stdout)

    def test_options_that_weaken_one_address_wait_for_a_restart(self):
        """On every transport; reload_test.cpp has the table of all options and transports."""
        security = {**self.TLS, "client-ca": str(self.ca), "tokens": str(self.tokens.file), "anonymous": "off"}
        self.start("tcp://127.0.0.1:0", "tls://127.0.0.1:0", http="127.0.0.1:0", **security)
        before = {"tcp": 4, "tls": 4, "http": 4}
        self.assertEqual(self.strangers(), before)
        for name in security:
            left = {key: value for key, value in security.items()
                    if key != name and not (name.startswith("tls-") and key in (*self.TLS, "client-ca"))}
            with self.subTest(removed=name):
                if name == "client-ca":
                    self.assertEqual(self.reload(**left), ("client-ca", ""))
                    self.assertEqual(self.reload(**security), ("client-ca", ""))
                elif name.startswith("tls-"):
                    # With tls:// in it the file would be invalid.
                    plain = {**self.fixed, "listen": ["tcp://127.0.0.1:0", f"unix:{self.folder}/socket"]}
                    self.assertEqual(self.reload(plain, **left), ("", "tls-cert,tls-key,client-ca,listen"))
                else:
                    self.assertEqual(self.reload(**left), ("", name))
                self.assertEqual(self.strangers(), before)
                self.assertEqual([self.code(each, self.secret) for each in ("tcp", "tls", "http")], [0, 0, 0])

    def test_options_that_close_are_taken_at_once(self):
        self.start("tcp://127.0.0.1:0", "tls://127.0.0.1:0", http="127.0.0.1:0", **self.TLS)
        self.assertEqual(self.strangers(), {"tcp": 0, "tls": 0, "http": 0})
        self.assertEqual(self.reload(**self.TLS, tokens=str(self.tokens.file)), ("tokens", ""))
        self.assertEqual(self.strangers(), {"tcp": 0, "tls": 4, "http": 0})
        self.assertEqual(self.code("tls", self.secret), 0)
        self.assertEqual(self.reload(**self.TLS, tokens=str(self.tokens.file), anonymous="off"), ("anonymous", ""))
        self.assertEqual(self.strangers(), {"tcp": 4, "tls": 4, "http": 4})
        self.assertEqual(len(self.log("open")), 3 * 4)  # at the start, and after each of these

    def test_options_that_only_a_restart_takes_are_named(self):
        self.start("tcp://127.0.0.1:0")
        self.assertEqual(self.reload(insecure=True, socket_mode="0666"), ("", "insecure,socket-mode"))
        self.assertEqual(self.reload(), ("", ""))

    def test_a_check_says_what_is_open_to_whom(self):
        self.write(listen=["tls://0.0.0.0:1", f"unix:{self.folder}/s"], http="127.0.0.1:2", **self.TLS,
                   client_ca=str(self.ca), tokens=str(self.tokens.file), anonymous="viewer", socket_mode="0666")
        done = subprocess.run([self.raynestd, "--config", self.config, "--check-config"], capture_output=True,
                              text=True, stdin=subprocess.DEVNULL, timeout=PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stdout.splitlines(), [
            "tls://0.0.0.0:1 would be open to tokens; certificates",
            f"unix:{self.folder}/s would be open to tokens; the daemon's user and root as admin; other users of "
            "this machine as viewer",
            "127.0.0.1:2 would be open to tokens; this machine as viewer", "the configuration is valid"])

    # ---- options that come by a reload work as at a start

    def test_tokens_that_come_by_a_reload_are_watched(self):
        for missing in ("", str(self.folder / "nosuch")):
            with self.subTest(missing=missing):
                brief = self.tokens.add("brief", "--expires", "4s")
                if not self.reloads:
                    self.start("tls://127.0.0.1:0", "tcp://127.0.0.1:0", **self.TLS)
                elif missing:
                    changed, _ = self.reload(**self.TLS, tokens=missing)
                    self.assertEqual(changed, "")
                self.reload(**self.TLS, tokens=str(self.tokens.file))
                self.assertEqual(self.code("tls", brief), 0)
                until(lambda: self.code("tls", brief) == 4)
                self.assertEqual(self.code("tls", self.secret), 0)
                self.tokens.revoke("alice")
                until(lambda: self.code("tls", self.secret) == 4)
                self.secret = self.tokens.add("alice")
                until(lambda: self.code("tls", self.secret) == 0)
                self.tokens.revoke("brief")

    def test_logins_of_the_page_take_new_limits(self):
        self.start("tcp://127.0.0.1:0", http="127.0.0.1:0", tokens=str(self.tokens.file))
        login = post(self.http, "/v1/login", "token=" + self.secret)
        cookie = [f"Cookie: {login[1]['set-cookie'].split(';')[0]}"]
        client = SecureClient(self.raynest, self.uris["tcp"], None, self.secret)
        code = client.json("open")["address"].rpartition("code=")[2]

        def is_known():
            return json.loads(get(self.http, "/v1/login", headers=cookie)[2])["login"]
        self.assertTrue(is_known())
        changed, _ = self.reload(tokens=str(self.tokens.file), page_login_ms_max=1, page_code_ms_max=1)
        self.assertEqual(changed, "page-code-ms-max,page-login-ms-max")
        self.assertFalse(is_known())
        self.assertEqual(post(self.http, "/v1/login", "code=" + code)[0], 401)

    def test_kept_answers_take_a_new_time(self):
        self.start("tcp://127.0.0.1:0")
        client = SecureClient(self.raynest, self.uris["tcp"])
        client.json("load", "builtin:flake?depth=1", "--name", "f")
        job = client.json("render", "f", "--size", "8x8", "--detach")["job"]
        self.assertEqual(client.run("wait", job).returncode, 0)
        self.reload(result_ms_max=1)
        until(lambda: client.json("jobs")["jobs"] == [])

    def test_limits_take_effect_at_once(self):
        self.start("tcp://127.0.0.1:0", http="127.0.0.1:0")
        client = SecureClient(self.raynest, self.uris["tcp"])
        client.json("load", "builtin:flake?depth=1", "--name", "f")
        render = ("render", "f", "--size", "64x64", "-o", self.folder / "f.png")
        self.assertEqual(client.run(*render).returncode, 0)
        for option, value, refused in (
                ("principal-rays-max", 1, lambda: client.run(*render).returncode == 5),
                ("principal-jobs-max", 1, lambda: self.two_jobs(client) == 6),
                ("total-jobs-max", 1, lambda: self.two_jobs(client) == 6),
                ("principal-scenes-max", 1,
                 lambda: client.run("load", "builtin:flake?depth=2", "--name", "g").returncode == 6),
                ("principal-scene-bytes-max", 1,
                 lambda: client.run("load", "builtin:flake?depth=2", "--name", "g").returncode in (5, 6)),
                ("principal-result-bytes-max", 1,
                 lambda: client.run("render", "f", "--size", "64x64", "--detach").returncode == 6),
                ("http-header-bytes-max", 200,
                 lambda: get(self.http, "/healthz", headers=["X: " + "x" * 400])[0] == 431)):
            with self.subTest(option=option):
                self.assertEqual(self.reload(**{option: value}), (option, ""))
                self.assertTrue(refused())
                self.reload()
                self.assertEqual(client.run(*render).returncode, 0)
                self.assertEqual(get(self.http, "/healthz", headers=["X: " + "x" * 400])[0], 200)

    def two_jobs(self, client):
        """The exit code of a second job while one runs."""
        first = client.json("render", "f", "--size", "256x256", "--samples", "65536",
                            "--integrator", "path", "--detach")["job"]
        try:
            return client.run("render", "f", "--size", "8x8", "-o", self.folder / "second.png").returncode
        finally:
            client.run("cancel", first)
            until(lambda: client.json("jobs")["jobs"] == [])

    def test_names_and_the_form_of_the_log_take_effect_at_once(self):
        self.start("tcp://127.0.0.1:0", http="127.0.0.1:0")
        self.assertEqual(get(self.http, "/style.css", host="gpu.invalid")[0], 421)
        self.assertEqual(self.reload(http_host=["gpu.invalid"])[0], "http-host")
        self.assertEqual(get(self.http, "/style.css", host="gpu.invalid")[0], 200)
        self.write(**self.fixed, log_format="json")
        self.process.send_signal(signal.SIGHUP)
        until(lambda: '"event":"reloaded"' in (self.folder / "log").read_text())


if __name__ == "__main__":
    main()
