#!/usr/bin/env python3
"""The HTTP port: the page, who may see it, and what a request may cost.

  http_test.py RAYNESTD RAYNEST
"""
import contextlib
import pathlib
import random
import re
import socket
import subprocess
import time

import websocket
from daemon import PATIENCE, Daemon, DaemonTest, main, until
from secure_daemon import Certificates
from websocket import get, host_of, place_of, raw, split, upgrade_request

WEB = pathlib.Path(__file__).resolve().parents[2] / "server" / "web"
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
         ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml", ".png": "image/png"}
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
          "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'")
FOREIGN = ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example:{port}", "localhost",
           "localhost:1", "127.0.0.2:{port}", "0.0.0.0:{port}", "[::]:{port}",
           "localhost:{port}.evil.example", "localhost.:{port}", "xn--localhost:{port}", ""]


class Http(DaemonTest):
    arguments = ("--http", "127.0.0.1:0", "--http-host", "ray.example", "--http-host", "one.example:8080",
                 "--http-ms-max", "1500")

    def setUp(self):
        self.http = self.daemon.http
        self.port = place_of(self.http)[1]

    def stat(self, name):
        return self.client.json("stats")[name]

    def refused(self, answer, status):
        code, headers, body = answer
        self.assertEqual(code, status, body)
        self.assertEqual(headers["content-type"], "text/plain; charset=utf-8")
        self.assertEqual(body.count(b"\n"), 1, "one line")
        return body.decode()

    def test_every_file_of_the_page(self):
        files = [path for path in WEB.rglob("*") if path.suffix in TYPES]
        self.assertIn(WEB / "index.html", files)
        for path in files:
            target = "/" + path.relative_to(WEB).as_posix()
            status, headers, body = get(self.http, target)
            self.assertEqual((status, body), (200, path.read_bytes()), target)
            self.assertEqual(headers["content-type"], TYPES[path.suffix])
            self.assertEqual(headers["content-security-policy"], POLICY)
            self.assertEqual(headers["x-content-type-options"], "nosniff")
            self.assertEqual(headers["referrer-policy"], "no-referrer")
            self.assertEqual(headers["cross-origin-resource-policy"], "same-origin")
            self.assertEqual(headers["cache-control"], "no-cache")
            self.assertNotIn("access-control-allow-origin", headers)
            # HEAD has the same headers and no body; a known ETag has no body either.
            self.assertEqual(get(self.http, target, "HEAD"), (200, headers, b""))
            status, same, body = get(self.http, target, headers=[f"If-None-Match: W/\"x\", {headers['etag']}"])
            self.assertEqual((status, same["etag"], body), (304, headers["etag"], b""))
            self.assertEqual(get(self.http, target, headers=['If-None-Match: "x"'])[0], 200)
        index = (WEB / "index.html").read_bytes()
        self.assertEqual(get(self.http, "/")[2], index)
        self.assertEqual(get(self.http, "/?scene=forest&x=%2f")[2], index)

    def test_nothing_else_is_served(self):
        for target in ("/nothing", "/../CMakeLists.txt", "/web/index.html", "/%2e%2e/x", "/index.html/",
                       "//index.html", "/server/web/index.html", "/protocol/messages.fbs", "/<b>"):
            self.assertIn("there is no", self.refused(get(self.http, target), 404), target)
        self.assertIn("evil.example", self.refused(get(self.http, "http://evil.example/"), 421))
        self.assertIn("'/'", self.refused(get(self.http, "*", "OPTIONS"), 400))
        self.refused(get(self.http, "/v1/stream"), 426)
        request = upgrade_request(self.http, target="/other")
        self.assertIn("/v1/stream", self.refused(split(raw(self.http, request)), 404))

    def test_health(self):
        self.assertEqual(get(self.http, "/healthz")[::2], (200, b"ok\n"))
        self.assertEqual(get(self.http, "/readyz")[::2], (200, b"ready\n"))
        self.assertEqual(get(self.http, "/healthz")[1]["cache-control"], "no-store")

    def test_a_request_changes_nothing(self):
        self.client.json("load", "builtin:flake?depth=1", "--name", "kept")
        before = self.client.json("scenes")
        for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "BREW"):
            answer = get(self.http, "/", method, headers=["Content-Length: 5"])
            self.refused(answer, 405)
            self.assertEqual(answer[1]["allow"], "GET, HEAD")
        self.assertIn("body", self.refused(get(self.http, headers=["Content-Length: 5"]), 413))
        self.refused(get(self.http, headers=["Transfer-Encoding: chunked"]), 413)
        for target in ("/unload?scene=kept", "/v1/unload", "/v1/scenes/kept"):
            self.refused(get(self.http, target), 404)
        after = self.client.json("scenes")
        names = [[scene["name"] for scene in listed] for listed in
                 (before if isinstance(before, list) else before["scenes"],
                  after if isinstance(after, list) else after["scenes"])]
        self.assertEqual(*names)

    def test_foreign_hosts(self):
        before = self.stat("http_foreign_hosts")
        for host in FOREIGN:
            host = host.format(port=self.port)
            lines = f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
            text = self.refused(split(raw(self.http, lines.encode())), 421)
            self.assertIn("--http-host", text)
            self.assertIn(f"http://127.0.0.1:{self.port}/", text)
        self.assertEqual(self.stat("http_foreign_hosts"), before + len(FOREIGN))
        for host in ("localhost:{port}", "LOCALHOST:{port}", "[::1]:{port}", "127.0.0.1:{port}",
                     "ray.example", "Ray.Example:9", "one.example:8080"):
            self.assertEqual(get(self.http, "/login.html", host=host.format(port=self.port))[0], 200, host)
        self.refused(get(self.http, host="one.example"), 421)
        self.refused(get(self.http, host="one.example:80"), 421)
        own = f"Host: 127.0.0.1:{self.port}\r\n"
        for hosts in ("", own + own, own + "Host: evil.example\r\n"):
            request = f"GET / HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n".encode()
            self.assertIn("Host", self.refused(split(raw(self.http, request)), 400))

    def test_foreign_origins(self):
        own = f"http://127.0.0.1:{self.port}"
        before = self.stat("http_foreign_origins")
        foreign = ["", "null", "http://evil.example", f"http://evil.example:{self.port}", own + "/",
                   "http://127.0.0.1", "http://127.0.0.1:1", f"http://localhost:{self.port}",
                   f"{own}.evil.example", f"file://127.0.0.1:{self.port}", f"ws://127.0.0.1:{self.port}",
                   f"http://x@127.0.0.1:{self.port}"]
        for origin in foreign:
            request = upgrade_request(self.http, origin=origin)
            self.assertIn("Origin", self.refused(split(raw(self.http, request)), 403), origin)
        twice = upgrade_request(self.http).replace(b"\r\n\r\n", f"\r\nOrigin: {own}\r\n\r\n".encode())
        self.refused(split(raw(self.http, twice)), 403)
        self.assertEqual(self.stat("http_foreign_origins"), before + len(foreign) + 1)
        self.refused(split(raw(self.http, upgrade_request(self.http, host="evil.example"))), 421)

    def test_a_header_over_the_limit(self):
        before = self.stat("http_refused")
        long = "X-Long: " + "x" * 8192
        self.assertIn("http_header_bytes_max = 8192", self.refused(get(self.http, headers=[long]), 431))
        many = [f"X-{i}: y" for i in range(2000)]
        self.refused(get(self.http, headers=many), 431)
        self.refused(get(self.http, "/" + "a" * 9000), 431)
        self.assertEqual(get(self.http, headers=["X-Long: " + "x" * 7000])[0], 200)
        self.assertEqual(self.stat("http_refused"), before + 3)

    def test_what_is_not_http(self):
        for request in (b"\r\n\r\nGET\r\n\r\n", b"GET /\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"\0\1\2\3\r\n\r\n",
                        b"GET / HTTP/1.1\r\nno colon\r\n\r\n", b"RYN1" + bytes(60),
                        b"GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
                        b"GET / HTTP/1.1\r\nHost: a\r\n\tb\0: c\r\n\r\n"):
            self.refused(split(raw(self.http, request)), 400)

    def test_damaged_requests_and_frames(self):
        """Good bytes, damaged with a fixed seed: whatever comes back, the daemon lives."""
        random_ = random.Random(26)
        masked = lambda text: bytes([0x81, 0x80 | len(text)]) + bytes(4) + text
        upgrade = upgrade_request(self.http)
        hello = masked(b'Hello 0 {"client":"fuzz"}')
        seeds = [b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % self.port, upgrade, upgrade + hello,
                 upgrade + hello + masked(b'Info 3 {"scene":"forest"}') + masked(b'Ping 4 {"payload":7}'),
                 upgrade + hello + bytes([0x82, 0xa0]) + bytes(4) + b"RYN1" + bytes(28)]
        for _ in range(150):
            data = bytearray(random_.choice(seeds))
            for _ in range(random_.randint(1, 6)):
                at = random_.randrange(len(data))
                kind = random_.randrange(4)
                if kind == 0:
                    data[at] = random_.randrange(256)
                elif kind == 1:
                    del data[at:at + random_.randint(1, 20)]
                elif kind == 2:
                    data[at:at] = data[max(0, at - 30):at]
                else:
                    data[at:at] = bytes(random_.randrange(256) for _ in range(random_.randint(1, 8)))
                data = data or bytearray(b"x")
            with socket.create_connection(place_of(self.http), timeout=PATIENCE) as connection:
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                try:
                    while connection.recv(65536):
                        pass
                except ConnectionError:
                    pass
        self.assertEqual(get(self.http, "/healthz")[0], 200)

    def test_a_connection_is_used_again(self):
        with socket.create_connection(place_of(self.http), timeout=PATIENCE) as connection:
            ask = f"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n\r\n".encode()
            connection.sendall(ask * 3)
            answer = b""
            while answer.count(b"ok\n") < 3:
                part = connection.recv(4096)
                self.assertTrue(part, answer)
                answer += part

    def test_slow_requests_end(self):
        before = self.stat("http_timeouts")
        start = time.monotonic()
        self.assertEqual(raw(self.http, b"GET / HTTP/1.1\r\nHo"), b"")
        # 1.5 s, with room for a busy machine.
        self.assertLess(time.monotonic() - start, 10)
        self.assertGreater(time.monotonic() - start, 1.0)
        until(lambda: self.stat("http_timeouts") == before + 1)
        # The same for a later request.
        later = self.answered(self.http, then=b"GET / HT")
        start = time.monotonic()
        self.assertEqual(later.recv(1), b"")
        self.assertTrue(1.0 < time.monotonic() - start < 10)

    def crowded(self, *arguments, places=8):
        """Starts a daemon with a few places for connections that have sent a request."""
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0", "--http-connections-max", str(places), *arguments)
        self.addCleanup(daemon.stop)
        return daemon.http

    def open(self, http, sent=b"", source=("", 0)):
        connection = socket.create_connection(place_of(http), PATIENCE, source)
        self.addCleanup(connection.close)
        connection.sendall(sent)
        return connection

    def answered(self, http, source=("", 0), then=b""):
        """Opens a connection that stays after its first answer, perhaps with a part of another request."""
        connection = self.open(http, f"GET /healthz HTTP/1.1\r\nHost: {host_of(http)}\r\n\r\n".encode(), source)
        self.assertIn(b" 200 OK", connection.recv(4096))
        connection.sendall(then)
        return connection

    def count(self, http, cause):
        text = get(http, "/metrics")[2].decode()
        return int(re.search(rf'ended_total{{cause="{cause}"}} (\d+)', text)[1])

    def test_half_requests_of_an_address_do_not_keep_it_out(self):
        http = self.crowded("--greeting-connections-max", "64", "--http-ms-max", "60000", places=64)
        crowd = [self.open(http, b"GET / HTTP/1.1\r\n") for _ in range(64)]
        time.sleep(0.2)  # until the daemon has read them
        for _ in range(5):
            self.assertEqual(get(http, "/healthz")[0], 200)
        self.assertGreater(self.count(http, "gave_way_greeting"), 0)
        self.assertEqual(crowd[0].recv(1), b"", "the oldest gave way")
        # The others have the time of a greeting.
        for connection in crowd[1:]:
            self.assertEqual(connection.recv(1), b"")

    def test_silent_peers_behind_a_handshake_do_not_fill_the_port(self):
        certificates = Certificates(self.raynestd, self.out / "tls")
        websocket.trusted.load_verify_locations(certificates.ca)
        daemon = Daemon(self.raynestd, "--http", "https://127.0.0.1:0", "--http-connections-max", "64",
                        "--greeting-connections-max", "64", *certificates.server)
        self.addCleanup(daemon.stop)
        crowd = [self.open(daemon.http, b"\x16\x03\x01") for _ in range(32)]
        for _ in range(32):
            crowd.append(websocket.connect(daemon.http))
            self.addCleanup(crowd[-1].close)
            crowd[-1].sendall(b"GET / HT")
        time.sleep(0.2)
        for _ in range(5):
            self.assertEqual(get(daemon.http, "/healthz")[0], 200)
        for connection in crowd:
            with contextlib.suppress(OSError):
                self.assertEqual(connection.recv(1), b"")
        ended = get(daemon.http, "/metrics")[2].decode()
        timeouts = int(re.search(r"^raynest_http_timeouts_total (\d+)", ended, re.M)[1])
        self.assertGreaterEqual(timeouts + self.count(daemon.http, "gave_way_greeting"), len(crowd))

    def test_too_many_connections(self):
        http = self.crowded("--http-ms-max", "60000")
        waiting = [self.answered(http) for _ in range(7)]
        busy = self.answered(http, then=b"GET / HTTP/1.1\r\n")
        self.assertEqual(get(http, "/healthz")[0], 200)
        self.assertEqual(waiting[0].recv(1), b"", "the one that waited longest")
        self.assertGreater(self.count(http, "gave_way_connections"), 0)
        waiting += [self.answered(http, then=b"GET / HTTP/1.1\r\n") for _ in range(24)]
        self.assertEqual(busy.recv(1), b"", "the oldest, as none waits")
        self.assertEqual(get(http, "/healthz")[0], 200)

    def test_the_address_with_most_connections_gives_way(self):
        # All loopback addresses count as one; a packet from another address of this machine stays on it, too.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(("192.0.2.1", 9))
            except OSError:
                self.skipTest("this machine has no address but loopback")
            own = probe.getsockname()[0]
        for then in (b"", b"GET / HTTP/1.1\r\n"):
            http = self.crowded("--http-ms-max", "60000")
            waiting = [self.answered(http) for _ in range(3)]
            crowd = [self.answered(http, (own, 0), then) for _ in range(5)]
            self.assertEqual(get(http, "/healthz")[0], 200, "another address")
            self.assertEqual(crowd[0].recv(1), b"", "the oldest")
            crowd += [self.answered(http, (own, 0), then) for _ in range(20)]
            for connection in waiting:
                connection.settimeout(0.1)
                self.assertRaises(TimeoutError, connection.recv, 1)


class Address(DaemonTest):
    """Where the port is, and that it is nowhere else."""
    arguments = ("--http", "[::1]:0")

    def start(self, *arguments):
        return subprocess.run([self.raynestd, "--listen", "tcp://127.0.0.1:0", "--cuda", "off", *arguments],
                              stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE,
                              check=False)

    def test_the_address_is_told(self):
        self.assertRegex(self.daemon.http, r"^http://\[::1\]:\d+$")
        self.assertEqual(get(self.daemon.http)[0], 200)
        line = next(line for line in self.daemon.log().splitlines() if " http " in line)
        self.assertIn(f"page={self.daemon.http}", line)
        self.assertIn("ssh -L", line)

    def test_an_address_that_cannot_be(self):
        taken = self.daemon.http.removeprefix("http://")
        refused = self.start("--http", taken)
        self.assertEqual(refused.returncode, 1)
        self.assertRegex(refused.stderr, r"^raynestd: cannot listen on http://.*--http another port")
        for address in ("0.0.0.0:31061", "[::]:31061", "192.0.2.1:80"):
            refused = self.start("--http", address)
            self.assertEqual(refused.returncode, 2, address)
            self.assertIn("ssh -L", refused.stderr)

    def test_the_default_port_may_be_taken(self):
        default = ("127.0.0.1", 31061)
        holder = socket.socket()
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            holder.bind(default)
            holder.listen()
        except OSError:
            pass  # somebody else has it, which does as well
        try:
            log = self.out / "log"
            with open(log, "wb") as output:
                daemon = subprocess.Popen([self.raynestd, "--listen", f"unix:{self.out}/second", "--cuda",
                                           "off", "--ready-file", self.out / "ready"], stderr=output)
            until((self.out / "ready").exists)
            self.assertIn('"http":"off"', (self.out / "ready").read_text())
            self.assertRegex(log.read_text(), r'http_off reason="cannot listen on http://127.0.0.1:31061: ')
            daemon.terminate()
            self.assertEqual(daemon.wait(timeout=PATIENCE), 0)
        finally:
            holder.close()

    def test_off(self):
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        self.assertEqual(daemon.http, "off")
        self.assertIsNone(re.search(" http ", daemon.log()))


if __name__ == "__main__":
    main()
