#!/usr/bin/env python3
"""Tests the page over https, its logins, and what each role may do on every transport.

  page_login_test.py RAYNESTD RAYNEST
"""
import contextlib
import pathlib
import re
import signal
import socket
import ssl
import time

import websocket
from daemon import PATIENCE, Daemon, main, until
from secure_daemon import Certificates, SecureDaemon
from websocket import WebSocket, connect, get, greeted, host_of, place_of, post, raw, split, upgrade_request
from with_page import ROLES, WithPage

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Rows of the request table: name, role.
REQUESTS = re.findall(r"^RAYNEST_REQUEST\(\d+, (\w+), \w+, \w+, (\w+),",
                      (ROOT / "protocol/lists/requests.def").read_text(), re.MULTILINE)
FORM = (ROOT / "server/web/login.html").read_bytes()
PAGE = (ROOT / "server/web/index.html").read_bytes()
OPEN = ("/healthz", "/readyz", "/login.html", "/login.js", "/session.js", "/dom.js", "/theme.js",
        "/settings.js", "/style.css", "/icon.svg")
CLOSED = ("/", "/index.html", "/main.js", "/raynest.js", "/metrics", "/v1/login")


class PageTest(WithPage):
    # ---- https

    def test_the_page_is_served_over_https(self):
        self.assertRegex(self.http, r"^https://127\.0\.0\.1:\d+$")
        cookie = self.log_in(self.http, token=self.secrets["user"])
        status, headers, body = get(self.http, headers=cookie)
        self.assertEqual((status, body), (200, PAGE))
        self.assertIn("connect-src 'self'", headers["content-security-policy"])
        with greeted(self.http, headers=cookie) as stream:
            stream.say("Load", 1, {"source": "builtin:terrain?size=8", "name": "hills"})
            loaded = stream.answer(1)[-1]
            self.assertEqual(loaded[0], "Loaded", loaded)
            frames = stream.ask("Query", 2, {"job": {"scene": "hills"}, "fields": ["t"], "generator":
                                             {"kind": "camera", "settings": ["size=64x64"]}})
            self.assertEqual(frames[-1][0], "Done", frames[-1])
            # A large frame arrives whole, and the daemon sees whose it is.
            stream.say("Ping", 3, {"payload": 7})
            self.assertEqual(stream.hear()[0], "Pong")
            rows = self.client("admin").json("admin", "connections")["connections"]
            self.assertIn(("test-user", "user", "https"),
                          [(row["principal"], row["role"], row["transport"]) for row in rows])
            stream.ask("Unload", 4, {"scene": "hills"})

    def test_an_origin_counts_with_its_scheme(self):
        cookie = self.log_in(self.http, token=self.secrets["user"])
        plain = self.own_daemon("--http", "127.0.0.1:0")
        for http, headers in ((self.http, cookie), (plain.http, [])):
            own, other = (f"{scheme}://{host_of(http)}" for scheme in
                          (("https", "http") if http == self.http else ("http", "https")))
            WebSocket(http, origin=own, headers=headers).close()
            answer = split(raw(http, upgrade_request(http, origin=other, headers=headers)))
            self.assertEqual(answer[0], 403)
            self.assertIn(f"its Origin must be {own}".encode(), answer[2])
            self.assertEqual(post(http, "/v1/logout", origin=other)[0], 403)

    def test_the_names_of_the_certificate_are_hosts_of_the_page(self):
        port = place_of(self.http)[1]
        for host, status in ((f"gpu.example.org:{port}", 200), (f"GPU.example.org:{port}", 200),
                             (f"{socket.gethostname()}:{port}", 200), (f"localhost:{port}", 200),
                             (f"[::1]:{port}", 200), ("gpu.example.org", 421),
                             (f"cpu.example.org:{port}", 421), (f"x.gpu.example.org:{port}", 421)):
            self.assertEqual(get(self.http, "/login.html", host=host)[0], status, host)

    def test_a_star_of_a_certificate_is_one_name(self):
        certificates = Certificates(self.raynestd, self.out / "star", "*.wild.example")
        daemon = SecureDaemon(self.raynestd, certificates, "--http", "https://127.0.0.1:0")
        self.addCleanup(daemon.stop)
        websocket.trusted.load_verify_locations(certificates.ca)
        port = place_of(daemon.http)[1]
        for host, status in (("a.wild.example", 200), ("A.wild.example", 200), ("a.b.wild.example", 421),
                             ("wild.example", 421), (".wild.example", 421), ("a.tame.example", 421)):
            self.assertEqual(get(daemon.http, "/login.html", host=f"{host}:{port}")[0], status, host)

    def test_plain_text_on_the_encrypted_port_and_tls_on_the_plain_one_are_told_apart(self):
        text = raw(self.http.replace("https", "http"), b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        self.assertEqual(split(text)[0], 400)
        self.assertIn(b"open it with https://", text)
        until(lambda: "it does not speak TLS" in self.daemon.log())
        plain = self.own_daemon("--http", "127.0.0.1:0")
        with self.assertRaises(ssl.SSLError):
            get(plain.http.replace("http", "https"))
        self.assertEqual(get(plain.http, "/healthz")[0], 200)

    def test_a_handshake_that_stops_ends_in_time(self):
        begun = time.monotonic()
        for first in (b"", b"\x16\x03\x01", b"\x16\x03\x01\x02\x00\x01"):
            self.assertEqual(raw(self.http.replace("https", "http"), first), b"")
        self.assertLess(time.monotonic() - begun, 3 * 2 + 5)  # greeting_ms_max is 2 s
        self.assertEqual(get(self.http, "/healthz")[0], 200)

    def test_old_versions_of_tls_are_refused(self):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        context.set_ciphers("ALL@SECLEVEL=0")
        context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
        with socket.create_connection(place_of(self.http), PATIENCE) as plain, \
                self.assertRaises(OSError):
            context.wrap_socket(plain)

    def test_a_header_of_ten_megabytes_is_refused(self):
        answer = get(self.http, headers=["X-Long: " + "x" * 9000])
        self.assertEqual(answer[0], 431)
        with websocket.connect(self.http) as connection:
            with contextlib.suppress(OSError):
                connection.sendall(b"GET / HTTP/1.1\r\n" + b"X: xxxxxxxxxxx\r\n" * (10 << 16))
            self.assertEqual(split(connection.recv(65536))[0], 431)
        self.assertEqual(get(self.http, "/healthz")[0], 200)

    def test_renewed_certificates_are_served_after_sighup(self):
        certificates = Certificates(self.raynestd, self.out / "renewed")
        websocket.trusted.load_verify_locations(certificates.ca)
        daemon = SecureDaemon(self.raynestd, certificates, "--http", "https://127.0.0.1:0")
        self.addCleanup(daemon.stop)

        def serial():
            with websocket.connect(daemon.http) as connection:
                return connection.getpeercert()["serialNumber"]
        before = serial()
        Certificates.renew(self.raynestd, certificates.folder)
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: serial() != before)

    def test_beyond_loopback_it_is_encrypted_and_asks_who_comes(self):
        own = self.certificates.server
        for says, arguments in (
                ("ssh -L", ("--http", "0.0.0.0:0")), ("pass --insecure", ("--http", "[::]:0")),
                ("needs --tls-cert", ("--http", "https://127.0.0.1:0")),
                ("give --tokens FILE", ("--http", "https://0.0.0.0:0", *own)),
                ("is not an address", ("--http", "ftp://127.0.0.1:0"))):
            with self.assertRaisesRegex(RuntimeError, re.escape(says)):
                Daemon(self.raynestd, *arguments)
        daemon = self.own_daemon("--http", "https://0.0.0.0:0")
        self.assertEqual(get(daemon.http.replace("0.0.0.0", "127.0.0.1"), "/healthz")[0], 200)
        address = self.client("user", daemon).json("open")["address"]
        self.assertTrue(address.startswith(daemon.http.replace("0.0.0.0", "127.0.0.1")), address)
        insecure = Daemon(self.raynestd, "--http", "0.0.0.0:0", "--insecure", "--http-host", "gpu")
        self.addCleanup(insecure.stop)
        self.assertEqual(get(insecure.http, "/login.html", host="gpu")[0], 200)
        self.assertEqual(get(insecure.http, host="gpu")[0], 401, "it lacks encryption, but still asks who comes")
        self.assertEqual(get(insecure.http, host="192.0.2.1")[0], 421)

    # ---- logins

    def test_who_is_not_logged_in_sees_the_form_and_nothing_else(self):
        port = place_of(self.http)[1]
        strangers = [[], ["Cookie: raynest=1"], [f"Cookie: __Host-raynest-{port}="],
                     [f"Cookie: __Host-raynest-{port}={'0' * 64}"], ["Authorization: Basic eDp5"]]
        for headers in strangers:
            for path in OPEN:
                self.assertEqual(get(self.http, path, headers=headers)[0], 200, path)
            for path in CLOSED:
                status, answered, body = get(self.http, path, headers=headers)
                self.assertEqual(status, 401, path)
                self.assertEqual(answered["cache-control"], "no-store")
                self.assertEqual(answered["www-authenticate"], "Bearer")
                if path in ("/", "/index.html"):
                    self.assertEqual(body, FORM)
                else:
                    self.assertEqual(body.count(b"\n"), 1, body)
            self.assertEqual(split(raw(self.http, upgrade_request(self.http, headers=headers)))[0], 401)
        for headers in (self.log_in(self.http, token=self.secrets["viewer"]),
                        ["Authorization: Bearer " + self.secrets["viewer"]]):
            for path in OPEN + CLOSED:
                self.assertEqual(get(self.http, path, headers=headers)[0], 200, path)
            with greeted(self.http, headers=headers) as stream:
                stream.say("Ping", 1)
                self.assertEqual(stream.hear()[0], "Pong")

    def test_a_login_is_sent_by_post_from_the_page_alone(self):
        token = "token=" + self.secrets["user"]
        for status, answer in (
                (405, get(self.http, "/v1/login?" + token, "PUT")),
                (401, get(self.http, "/v1/login?" + token)),
                (405, get(self.http, "/v1/logout")),
                (403, post(self.http, "/v1/login", token, origin="")),
                (403, post(self.http, "/v1/login", token, origin="https://evil.example")),
                (403, post(self.http, "/v1/login", token, origin="null")),
                (413, post(self.http, "/v1/login", "token=" + "x" * 5000)),
                (400, post(self.http, "/v1/login", "")), (400, post(self.http, "/v1/login", "tok=1")),
                (400, post(self.http, "/v1/login", token + "&code=1")),
                (401, post(self.http, "/v1/login", "token=" + self.secrets["user"][:40]))):
            self.assertEqual(answer[0], status, answer)
            self.assertNotIn("set-cookie", answer[1])
            self.assertEqual(answer[2].count(b"\n"), 1)
        chunked = (f"POST /v1/login HTTP/1.1\r\nHost: {host_of(self.http)}\r\nOrigin: {self.http}\r\n"
                   f"Transfer-Encoding: chunked\r\n\r\n").encode()
        self.assertEqual(split(raw(self.http, chunked))[0], 413)

    def test_a_body_that_waits_to_be_asked_for_is_asked_for(self):
        token = "token=" + self.secrets["user"]
        with connect(self.http) as connection:
            connection.sendall(f"POST /v1/login HTTP/1.1\r\nHost: {host_of(self.http)}\r\nOrigin: {self.http}\r\n"
                               f"Content-Length: {len(token)}\r\nExpect: 100-continue\r\n\r\n".encode())
            self.assertEqual(split(connection.recv(4096))[0], 100)
            connection.sendall(token.encode())
            self.assertIn("set-cookie", split(connection.recv(4096))[1])

    def test_a_login_ends_after_its_time(self):
        daemon = self.own_daemon("--http", "https://127.0.0.1:0", "--page-login-ms-max", "1000")
        cookie = self.log_in(daemon.http, token=self.secrets["user"])
        with greeted(daemon.http, headers=cookie) as stream:
            until(lambda: self.who(daemon.http, cookie) == 401)
            self.assertTrue(self.hears_of_the_end(stream))

    def test_a_login_beside_another_counts_as_none(self):
        mine, = self.log_in(self.http, token=self.secrets["user"])
        other, = self.log_in(self.http, token=self.secrets["viewer"])
        name, _, secret = mine.rpartition("; ")[2].partition("=")
        for pair in ((secret, "zzz"), ("zzz", secret), (other.rpartition("=")[2], secret)):
            both = "; ".join(f"{name}={each}" for each in pair)
            status, headers, body = get(self.http, "/v1/login", headers=["Cookie: " + both])
            self.assertEqual((status, headers["set-cookie"].split(";")[0]), (400, name + "="), body)
            self.assertEqual(post(self.http, "/v1/login", "code=1", headers=["Cookie: " + both])[0], 400)
        self.assertEqual(self.who(self.http, [f"Cookie: {name}={secret}; {name}={secret}"])["principal"], "test-user")
        self.assertEqual(post(self.http, "/v1/login", "token=" + self.secrets["viewer"], headers=[mine])[0], 200)
        self.assertEqual(self.who(self.http, [mine]), 401)

    def test_the_cookie_of_another_daemon_is_none(self):
        other = self.own_daemon("--http", "https://127.0.0.1:0")
        cookie = self.log_in(other.http, token=self.secrets["user"])
        self.assertEqual(self.who(self.http, cookie), 401)
        renamed = cookie[0].replace(str(place_of(other.http)[1]), str(place_of(self.http)[1]))
        self.assertEqual(self.who(self.http, [renamed]), 401)
        self.assertEqual(self.who(other.http, cookie)["principal"], "test-user")

    def test_a_revoked_token_ends_the_open_page_within_a_second(self):
        secret = self.tokens.add("mallory")
        until(lambda: self.client(secret).run("scenes").returncode == 0)
        cookie = self.log_in(self.http, token=secret)
        with greeted(self.http, headers=cookie) as stream:
            begun = time.monotonic()
            self.tokens.revoke("mallory")
            self.assertTrue(self.hears_of_the_end(stream))
            # Twice the second: this machine is shared.
            self.assertLess(time.monotonic() - begun, 2)
        self.assertEqual(self.who(self.http, cookie), 401)

    def test_a_logout_ends_the_login_and_its_connections(self):
        cookies = [self.log_in(self.http, token=self.secrets["user"]) for _ in range(2)]
        with greeted(self.http, headers=cookies[0]) as left, \
                greeted(self.http, headers=cookies[1]) as kept:
            status, headers, _ = post(self.http, "/v1/logout", headers=cookies[0])
            self.assertEqual(status, 200)
            self.assertIn("Max-Age=0", headers["set-cookie"])
            self.assertTrue(self.hears_of_the_end(left))
            kept.say("Ping", 1)
            self.assertEqual(kept.hear()[0], "Pong")
        self.assertEqual([self.who(self.http, cookie) == 401 for cookie in cookies], [True, False])
        self.assertEqual(post(self.http, "/v1/logout")[0], 200)

    def test_wrong_tokens_have_to_wait_here_too(self):
        daemon = self.own_daemon("--http", "https://127.0.0.1:0")
        attempts = (lambda: post(daemon.http, "/v1/login", "token=rnt_1"),
                    lambda: post(daemon.http, "/v1/login", "code=1"),
                    lambda: get(daemon.http, "/metrics", headers=["Authorization: Bearer rnt_1"]))
        answers = []
        # The wait is longer after each, so that it is met at last, however slow the machine is.
        until(lambda: answers.append(attempts[len(answers) % 3]()) or answers[-1][0] == 429)
        self.assertEqual([status for status, _, _ in answers[:5]], [401] * 5)
        self.assertGreater(int(answers[-1][1]["retry-after"]), 0)
        # The same wait meets the command line; right tokens and health do not wait.
        until(lambda: self.client("wrong", daemon).run("scenes").returncode == 6)
        self.assertEqual([get(daemon.http, path)[0] for path in ("/healthz", "/readyz")], [200, 200])
        right = ["Authorization: bEARER  " + self.secrets["viewer"]]
        self.assertEqual(get(daemon.http, "/metrics", headers=right)[0], 200)
        until(lambda: self.client("wrong", daemon).run("scenes").returncode == 6)
        self.assertEqual(post(daemon.http, "/v1/login", "token=" + self.secrets["user"])[0], 200)

    def test_no_secret_reaches_the_log(self):
        cookie = self.log_in(self.http, token=self.secrets["user"])
        code = self.code(self.client("user"))
        self.log_in(self.http, code=code)
        log = self.daemon.log()
        self.assertRegex(log, "login .*transport=https")
        for secret in (self.secrets["user"], code, cookie[0].rpartition("=")[2], "rnt_"):
            self.assertNotIn(secret, log)

    def test_a_certificate_of_the_browser_is_a_principal(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--client-ca", self.certificates.ca,
                              "--http", "https://127.0.0.1:0")
        self.addCleanup(daemon.stop)
        self.assertEqual(self.who(daemon.http), 401)
        context = ssl.create_default_context(cafile=self.certificates.ca)
        context.load_cert_chain(self.certificates.client[1], self.certificates.client[3])
        with socket.create_connection(place_of(daemon.http), PATIENCE) as plain, \
                context.wrap_socket(plain, server_hostname="localhost") as connection:
            connection.sendall(f"GET /v1/login HTTP/1.1\r\nHost: {host_of(daemon.http)}\r\n"
                               "Connection: close\r\n\r\n".encode())
            answer = b""
            while part := connection.recv(65536):
                answer += part
        self.assertIn(b'"principal":"CN=raynest-client","role":"user","login":false', answer)

    # ---- roles

    def test_every_role_and_every_request_on_every_transport(self):
        """The table of requests.def, over WebSocket with and without TLS, and on a Unix socket."""
        self.assertGreater(len(REQUESTS), 15)
        plain = self.own_daemon("--http", "127.0.0.1:0")
        rows = 0
        for role in ROLES:
            bearer = ["Authorization: Bearer " + self.secrets[role]]
            by_cookie = self.log_in(plain.http, token=self.secrets[role])
            for http, headers in ((self.http, bearer), (plain.http, bearer), (plain.http, by_cookie)):
                with greeted(http, headers=headers) as stream:
                    for number, (name, needed) in enumerate(REQUESTS, 1):
                        with self.subTest(role=role, request=name, http=http):
                            if name == "Load":
                                message = {"source": "builtin:flake?depth=0"}
                            else:
                                message = {"act": "connections"} if name == "Admin" else {}
                            stream.say(name, number, message)
                            answer = stream.answer(number)[-1]
                            refused = answer[0] == "Error" and answer[2]["name"] == "NOT_ALLOWED"
                            self.assertEqual(refused, ROLES.index(role) < ROLES.index(needed), answer)
                            rows += 1
        self.assertEqual(rows, 9 * len(REQUESTS))

    def test_every_sender_and_every_route(self):
        plain = self.own_daemon("--http", "127.0.0.1:0")
        closed = self.own_daemon("--http", "127.0.0.1:0", "--anonymous", "off")
        bearers = {role: ["Authorization: Bearer " + self.secrets[role]] for role in ROLES}
        for http, senders in ((self.http, {"nobody": []}), (plain.http, {"anybody": []}),
                              (closed.http, {"nobody": []})):
            for sender, headers in {**senders, **bearers}.items():
                for path in OPEN + CLOSED:
                    knows = sender != "nobody" or path in OPEN
                    self.assertEqual(get(http, path, headers=headers)[0], 200 if knows else 401,
                                     (http, sender, path))


if __name__ == "__main__":
    main()
