#!/usr/bin/env python3
"""Requests that proxies send or change: who counts as local, whose word counts, and what ends a connection.

  proxy_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import unittest

import websocket
from daemon import PATIENCE, Daemon, Programs, main, until
from secure_daemon import Certificates, Tokens
from websocket import WebSocket, get, greeted, host_of, place_of, post, raw, split, upgrade_request

ROOT = pathlib.Path(__file__).resolve().parents[2]
NGINX = shutil.which("nginx") or shutil.which("/usr/sbin/nginx")
NAME = "gpu.example.org"
# A header each of which only proxies send.
TRACES = ["Forwarded: for=192.0.2.1", "X-Forwarded-For: 127.0.0.1", "X-Forwarded-Proto: http",
          "X-Forwarded-Host: localhost", "X-Real-IP: 127.0.0.1", "Via: 1.1 proxy", "CF-Connecting-IP: 192.0.2.1"]


def exchange(http, *lines, body=b""):
    """Sends a request, line by line, and returns the statuses of all answers until the daemon closes."""
    answers = raw(http, "\r\n".join([*lines, "", ""]).encode("latin-1") + body)
    return [int(status) for status in re.findall(rb"HTTP/1\.[01] (\d+) ", answers)]


class ProxyTest(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest-test-")))
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.bearer = ["Authorization: Bearer " + cls.tokens.add("alice")]
        cls.secret = cls.bearer[0].rpartition(" ")[2]

    def start(self, *arguments, tokens=True):
        if tokens:
            arguments = ("--tokens", self.tokens.file, *arguments)
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0", "--http-host", NAME, *arguments)
        self.addCleanup(daemon.stop)
        return daemon

    def who(self, http, headers=(), host=None):
        status, _, body = get(http, "/v1/login", headers=headers, host=host)
        return json.loads(body)["principal"] if status == 200 else status

    def stream(self, http, headers=(), host=None, origin=None):
        """The status of an upgrade to a WebSocket."""
        try:
            WebSocket(http, headers=headers, host=host, origin=origin).close()
            return 101
        except ConnectionError as refused:
            return refused.args[0]

    # ---- who is local

    def test_a_request_from_elsewhere_needs_a_token_whatever_loopback_needs(self):
        for tokens in (True, False):
            http = self.start(tokens=tokens).http
            self.assertEqual(self.who(http), "127.0.0.1", "local and without a token")
            self.assertEqual(self.stream(http), 101)
            elsewhere = [([trace], None) for trace in TRACES] + [([], NAME), ([], NAME + ":80")]
            for headers, host in elsewhere:
                with self.subTest(tokens=tokens, headers=headers, host=host):
                    self.assertEqual(self.who(http, headers, host), 401)
                    self.assertEqual(self.stream(http, headers, host), 401)
                    self.assertEqual(get(http, "/", headers=headers, host=host)[0], 401)
                    self.assertEqual(get(http, "/metrics", headers=headers, host=host)[0], 401)
                    self.assertEqual(get(http, "/login.html", headers=headers, host=host)[0], 200)
                    if tokens:
                        self.assertEqual(self.who(http, [*headers, *self.bearer], host), "alice")
                        self.assertEqual(self.stream(http, [*headers, *self.bearer], host), 101)
            said = get(http, "/main.js", host=NAME)[2]
            self.assertIn(b"asks for a token", said)
            self.assertEqual(b"--tokens FILE" in said, not tokens)

    def test_a_login_is_enough_from_elsewhere(self):
        http = self.start().http
        login = ["X-Forwarded-For: 192.0.2.1"]
        status, headers, _ = post(http, "/v1/login", "token=" + self.secret, headers=login)
        self.assertEqual(status, 200)
        cookie = ["Cookie: " + headers["set-cookie"].split(";")[0]]
        self.assertEqual(self.who(http, login + cookie), "alice")
        self.assertEqual(self.stream(http, login + cookie), 101)

    def test_who_is_no_trusted_proxy_cannot_choose_sender_scheme_or_host(self):
        daemon = self.start("--trusted-proxy", "192.0.2.0/24")
        lies = ["X-Forwarded-For: 203.0.113.77", "X-Forwarded-Proto: https", f"X-Forwarded-Host: {NAME}"]
        self.assertEqual(self.who(daemon.http, lies), 401)
        self.assertEqual(self.stream(daemon.http, lies + self.bearer, origin=f"https://{NAME}"), 403)
        status, headers, _ = post(daemon.http, "/v1/login", "token=" + self.secret, headers=lies)
        self.assertEqual(status, 200)
        self.assertNotIn("Secure", headers["set-cookie"])
        self.assertIn("peer=127.0.0.1", daemon.log())
        self.assertNotIn("203.0.113.77", daemon.log())

    # ---- a trusted proxy

    def test_a_trusted_proxy_tells_sender_scheme_and_host(self):
        daemon = self.start("--trusted-proxy", "192.0.2.0/24", "--trusted-proxy", "127.0.0.1")
        told = ["X-Forwarded-For: 127.0.0.1, 203.0.113.5, 192.0.2.9", "X-Forwarded-Proto: https",
                f"X-Forwarded-Host: {NAME}"]
        self.assertEqual(self.who(daemon.http, told), 401)
        until(lambda: re.search("login_refused peer=203.0.113.5 ", daemon.log()))
        origin = f"https://{NAME}"
        for status, sent in ((200, origin), (200, origin + ":443"), (403, f"http://{NAME}"),
                             (403, daemon.http)):
            code, headers, _ = post(daemon.http, "/v1/login", "token=" + self.secret, headers=told, origin=sent)
            self.assertEqual(code, status, sent)
            if status == 200:
                cookie, *attributes = headers["set-cookie"].split("; ")
                self.assertTrue(cookie.startswith("__Host-raynest-"), cookie)
                self.assertIn("Secure", attributes)
        login = told + ["Cookie: " + cookie]
        self.assertEqual(self.stream(daemon.http, login, origin=origin), 101)
        self.assertEqual(self.stream(daemon.http, login, origin=f"http://{NAME}"), 403)
        # Its host is judged like Host, and the tail of its list is its own.
        foreign = told[:2] + ["X-Forwarded-Host: evil.example"]
        self.assertEqual(get(daemon.http, "/login.html", headers=foreign)[0], 421)
        for empty in ("", f"{NAME},", ":443"):
            status, _, said = get(daemon.http, "/login.html", headers=[*told[:2], f"X-Forwarded-Host: {empty}"])
            self.assertEqual((status, b"host is empty" in said), (421, True), said)
        with greeted(daemon.http, headers=login, origin=origin):
            with WebSocket(daemon.http, headers=login, origin=origin):
                until(lambda: "login peer=203.0.113.5 transport=http principal=alice" in daemon.log())

    def test_wrong_tokens_wait_by_the_address_that_a_trusted_proxy_tells(self):
        http = self.start("--trusted-proxy", "127.0.0.1").http

        def wrong(address):
            return get(http, "/metrics", headers=["X-Forwarded-For: " + address,
                                                  "Authorization: Bearer wrong"])[0]
        for _ in range(5):
            self.assertEqual(wrong("203.0.113.5"), 401)
        self.assertEqual(wrong("203.0.113.5"), 429)
        self.assertEqual(wrong("203.0.113.6"), 401)

    def test_trust_is_withdrawn_by_reload_and_given_by_a_restart(self):
        config = self.out / "raynestd.toml"
        told = ["X-Forwarded-For: 203.0.113.5", "X-Forwarded-Proto: https"]

        def write(proxies):
            config.write_text(f'http-host = "{NAME}"\ntokens = "tokens"\ntrusted-proxy = {proxies}\n'
                              'http = "127.0.0.1:0"\n')

        def is_trusted(daemon):
            answer = post(daemon.http, "/v1/login", "token=" + self.secret, headers=told,
                          origin="https://" + host_of(daemon.http))
            return answer[0] == 200

        def reloaded(daemon):
            seen = daemon.log().count(" reloaded ")
            daemon.process.send_signal(signal.SIGHUP)
            until(lambda: daemon.log().count(" reloaded ") > seen)
            return daemon.log()
        write('["127.0.0.1", "10.0.0.0/8"]')
        daemon = Daemon(self.raynestd, "--config", config, "--http", "127.0.0.1:0")
        self.addCleanup(daemon.stop)
        self.assertTrue(is_trusted(daemon))
        # A page that came by the proxy leaves with it; one that came by itself comes back.
        page, silent = (WebSocket(daemon.http, headers=[*told, *self.bearer], origin="https://" + host_of(daemon.http))
                        for _ in range(2))
        self.addCleanup(page.close)
        self.addCleanup(silent.close)
        page.say("Hello", 0, {"client": "test"})
        self.assertEqual(page.hear()[0], "Welcome")
        reloaded(daemon)
        page.say("Ping", 1)
        self.assertEqual(page.hear()[0], "Pong")
        write('["10.0.0.0/8"]')
        self.assertRegex(reloaded(daemon), "changed=trusted-proxy")
        self.assertFalse(is_trusted(daemon))
        for peer in (page, silent):     # the second has not said Hello
            name, _, error, _ = peer.hear()
            self.assertEqual((name, error["name"], error["closing"]), ("Error", "NOT_ALLOWED", True))
        write('["127.0.0.1"]')
        self.assertRegex(reloaded(daemon), "restart_needed options=[^ ]*trusted-proxy")
        self.assertFalse(is_trusted(daemon))

    # ---- requests that two programs might read differently

    def test_the_usual_port_is_left_out_of_an_origin(self):
        http = self.start().http
        for host, origin, status in ((NAME + ":80", f"http://{NAME}", 101), (NAME, f"http://{NAME}:80", 101),
                                     (NAME, f"HTTP://{NAME.upper()}", 101), (NAME + ":443", f"http://{NAME}", 403),
                                     (NAME + ":80", f"https://{NAME}", 403), (NAME, f"http://{NAME}:81", 403),
                                     (NAME, NAME, 403), (NAME, f"http://{NAME}/", 403)):
            self.assertEqual(self.stream(http, self.bearer, host, origin), status, (host, origin))
        refusal = raw(http, upgrade_request(http, host=NAME, origin=f"https://{NAME}", headers=self.bearer))
        self.assertIn(b"--trusted-proxy", refusal)

    def test_an_absolute_target_is_answered_for_its_host(self):
        http = self.start().http
        own, close = "Host: " + host_of(http), "Connection: close"
        for target, status in ((http + "/", 200), (http, 200), (http + "/healthz", 200),
                               (f"http://{NAME}/login.html", 200), ("http://evil.example/login.html", 421),
                               ("http:///login.html", 421), ("ftp://localhost/", 400), ("localhost:1", 400)):
            self.assertEqual(exchange(http, f"GET {target} HTTP/1.1", own, close), [status], target)
        # The target's host is the one that is answered. Beside a foreign Host header the request is
        # remote: a proxy may have passed it on. Two headers, or none, are refused.
        target = f"GET {http}/ HTTP/1.1"
        self.assertEqual(exchange(http, target, "Host: evil.example", close), [401])
        self.assertEqual(exchange(http, target.replace("/ ", "/login.html "), "Host: evil.example", close), [200])
        self.assertEqual(exchange(http, f"GET http://{NAME}/ HTTP/1.1", own, close), [401])
        self.assertEqual(exchange(http, target, own, own, close), [400])
        self.assertEqual(exchange(http, target, close), [400])
        self.assertEqual(exchange(http, target.replace("1.1", "1.0")), [200])

    def test_any_transfer_coding_ends_the_connection(self):
        http = self.start().http
        own, origin = "Host: " + host_of(http), "Origin: " + http
        inner = f"GET /healthz HTTP/1.1\r\n{own}\r\n\r\n".encode()
        for coding in ("chunked", "xchunked", "identity", "gzip, chunked", "chunked, identity", "\tchunked", ""):
            for first in (["GET /healthz HTTP/1.1"], ["POST /v1/login HTTP/1.1", origin],
                          ["POST /v1/login HTTP/1.1", origin, "Content-Length: 4"],
                          ["GET /v1/stream HTTP/1.1", origin, "Connection: Upgrade", "Upgrade: websocket",
                           "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]):
                with self.subTest(coding=coding, first=first):
                    answered = exchange(http, *first, own, f"Transfer-Encoding: {coding}", body=b"0\r\n\r\n" + inner)
                    self.assertEqual(len(answered), 1, answered)
                    self.assertIn(answered[0], (400, 413))

    def test_two_lengths_and_odd_lines_end_the_connection(self):
        http = self.start().http
        own, origin = "Host: " + host_of(http), "Origin: " + http
        inner = f"GET /healthz HTTP/1.1\r\n{own}\r\n\r\n".encode()
        for lines in (["POST /v1/login HTTP/1.1", own, origin, "Content-Length: 0", f"Content-Length: {len(inner)}"],
                      ["POST /v1/login HTTP/1.1", own, origin, "Content-Length: 0, 45"],
                      ["POST /v1/login HTTP/1.1", own, origin, "Content-Length: +45"],
                      ["GET /healthz HTTP/1.1", own, f"Content-Length: {len(inner)}"],
                      ["GET /healthz HTTP/1.1", own.replace(":", " :")], ["GET /healthz HTTP/1.1", own, own],
                      ["GET /healthz HTTP/1.1", own, "X: a\0b"], ["GET /healthz  HTTP/1.1", own]):
            with self.subTest(lines=lines):
                answered = exchange(http, *lines, body=inner)
                self.assertEqual(len(answered), 1, answered)
                self.assertIn(answered[0], (400, 413))

    def test_probes_reach_health_under_any_host(self):
        http = self.start("--anonymous", "off").http
        for path in ("/healthz", "/readyz"):
            for lines in (["GET {} HTTP/1.0"], ["HEAD {} HTTP/1.0"], ["GET {} HTTP/1.1", "Host: 10.2.3.4:31061"],
                          ["GET {} HTTP/1.1", "Host: evil.example", "User-Agent: kube-probe/1.30"],
                          ["GET {} HTTP/1.1", "Host: ", "Via: 1.1 proxy"]):
                lines = [line.format(path) for line in lines]
                self.assertEqual(exchange(http, *lines, "Connection: close"), [200], lines)
            # A request of HTTP/1.1 has a Host, and none has two.
            self.assertEqual(exchange(http, f"GET {path} HTTP/1.1", "Connection: close"), [400])
            self.assertEqual(exchange(http, f"GET {path} HTTP/1.0", "Host: a", "Host: b"), [400])
        for path in ("/", "/login.html", "/metrics", "/healthz/", "/v1/login"):
            self.assertEqual(exchange(http, f"GET {path} HTTP/1.0"), [400], path)
            self.assertEqual(get(http, path, host="evil.example")[0], 421, path)


@unittest.skipUnless(NGINX, "nginx is not installed")
class Nginx(Programs):
    """A real nginx that ends TLS, with the server block of OPERATING.md."""
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest-test-")))
        cls.out.chmod(0o755)
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls", NAME)
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.secret = cls.tokens.add("alice")
        manual = (ROOT / "server/OPERATING.md").read_text()
        toml = re.search(r"```toml\n(.*?trusted-proxy.*?)```", manual, re.DOTALL).group(1)
        (cls.out / "raynestd.toml").write_text(toml.replace("/etc/raynest", str(cls.out)))
        cls.daemon = Daemon(cls.raynestd, "--config", cls.out / "raynestd.toml", "--http", "127.0.0.1:0")
        cls.addClassCleanup(cls.daemon.stop)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        block = re.search(r"```nginx\n(.*?)```", manual, re.DOTALL).group(1)
        for was, now in (("listen 443", f"listen 127.0.0.1:{port}"), ("127.0.0.1:31061", host_of(cls.daemon.http)),
                         ("/etc/raynest", str(cls.out))):
            assert was in block, was
            block = block.replace(was, now)
        config = cls.out / "nginx.conf"
        paths = "".join(f"{kind}_temp_path {cls.out}/{kind};\n" for kind in
                        ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
        config.write_text(f"{'user root;' if os.geteuid() == 0 else ''}\ndaemon off;\nworker_processes 1;\n"
                          f"pid {cls.out}/nginx.pid;\nevents {{ worker_connections 128; }}\n"
                          f"http {{\naccess_log off;\n{paths}{block}}}\n")
        with open(cls.out / "nginx.log", "wb") as log:
            cls.nginx = subprocess.Popen([NGINX, "-e", "stderr", "-p", cls.out, "-c", config],
                                         stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        cls.addClassCleanup(cls.stop_nginx)
        websocket.trusted.load_verify_locations(cls.certificates.ca)
        cls.page = f"https://127.0.0.1:{port}"
        until(cls.answers, lambda: (cls.out / "nginx.log").read_text())

    @classmethod
    def stop_nginx(cls):
        cls.nginx.terminate()  # the master ends its worker
        cls.nginx.wait(timeout=PATIENCE)

    @classmethod
    def answers(cls):
        try:
            socket.create_connection(place_of(cls.page), PATIENCE).close()
            return True
        except OSError:
            return False

    def test_page_login_and_websocket_through_nginx(self):
        status, _, body = get(self.page, "/", host=NAME)
        self.assertEqual((status, body), (401, (ROOT / "server/web/login.html").read_bytes()))
        origin = [f"Host: {NAME}", f"Origin: https://{NAME}"]
        form = "token=" + self.secret
        request = "\r\n".join(["POST /v1/login HTTP/1.1", *origin, "Connection: close",
                               f"Content-Length: {len(form)}", "", form])
        status, headers, _ = split(raw(self.page, request.encode()))
        self.assertEqual(status, 200)
        cookie, *attributes = headers["set-cookie"].split("; ")
        self.assertTrue(cookie.startswith("__Host-raynest-"), cookie)
        self.assertIn("Secure", attributes)
        login = ["Cookie: " + cookie]
        status, _, body = get(self.page, "/", host=NAME, headers=login)
        self.assertEqual((status, body), (200, (ROOT / "server/web/index.html").read_bytes()))
        with greeted(self.page, host=NAME, headers=login) as stream:
            loaded = stream.ask("Load", 1, {"source": "builtin:flake?depth=1", "name": "flake"})[-1]
            self.assertEqual(loaded[0], "Loaded", loaded)
        # Nobody is admitted without a login, from another page, or under another name.
        for status, request in ((401, {}), (401, {"headers": ["X-Forwarded-For: 127.0.0.1"]}),
                                (401, {"headers": ["X-Forwarded-Host: localhost", "X-Forwarded-Proto: http"]}),
                                (403, {"headers": login, "origin": f"http://{NAME}"}),
                                (403, {"headers": login, "origin": "https://evil.example"})):
            with self.assertRaisesRegex(ConnectionError, str(status)):
                WebSocket(self.page, host=NAME, **request)
        self.assertEqual(get(self.page, "/", host="evil.example", headers=login)[0], 421)
        self.assertEqual(get(self.page, "/readyz", host="evil.example")[0], 200)
        # The request of a browser that names the port.
        with greeted(self.page, host=NAME + ":443", origin=f"https://{NAME}", headers=login):
            pass

    def test_nginx_and_the_daemon_agree_where_a_request_ends(self):
        for coding in ("chunked", "xchunked", "chunked, identity"):
            inner = f"GET /main.js HTTP/1.1\r\nHost: {NAME}\r\n\r\n"
            request = (f"POST /v1/login HTTP/1.1\r\nHost: {NAME}\r\nOrigin: https://{NAME}\r\nConnection: close\r\n"
                       f"Content-Length: {5 + len(inner)}\r\nTransfer-Encoding: {coding}\r\n\r\n0\r\n\r\n{inner}")
            answered = raw(self.page, request.encode())
            self.assertEqual(answered.count(b"HTTP/1.1 "), 1, answered)
            self.assertIn(split(answered)[0] // 100, (4, 5))


if __name__ == "__main__":
    main()
