#!/usr/bin/env python3
"""Tests TLS from the command line: certificates, verification, and what does not fit.

  tls_test.py RAYNESTD RAYNEST
"""
import array
import contextlib
import pathlib
import signal
import socket
import ssl
import stat
import subprocess
import tempfile
import threading
import time
import warnings

from daemon import Daemon, PATIENCE, Programs, closed_port, main, until
from link import Link
from npy import npy
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens, command

RAY = "0,50,0,0,-1,0"
GREETING_SECONDS = 2  # greeting_ms_max


def openssl(*arguments, **options):
    return subprocess.run(["openssl", *map(str, arguments)], text=True, errors="replace",
                          stdin=options.pop("stdin", subprocess.DEVNULL), stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, timeout=PATIENCE, **options)


class Tls(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls", "gpu.example.org")
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.token = cls.tokens.add("alice")
        cls.daemon = SecureDaemon(cls.raynestd, cls.certificates, "--tokens", cls.tokens.file,
                                  "--listen", "tls://127.0.0.2:0")
        cls.addClassCleanup(cls.daemon.stop)
        cls.client = SecureClient(cls.raynest, cls.daemon.tls, cls.certificates.ca, cls.token)

    def refused(self, client, code, says, *arguments):
        client.fails(code, says, *(arguments or ("scenes",)))

    def not_started(self, code, says, *arguments):
        done = subprocess.run([self.raynestd, "--cuda", "off", "--http", "off",
                               *map(str, arguments)], text=True, stdin=subprocess.DEVNULL,
                              capture_output=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertIn(says, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)

    def signed(self, name, subject, extension, key="key.pem", days="9"):
        """Returns a certificate that the CA makes for a key of its folder."""
        folder, made = self.certificates.folder, self.out / f"{name}.pem"
        for words in (("req", "-new", "-key", folder / key, "-subj", subject, "-addext", extension, "-out",
                       self.out / f"{name}.csr"),
                      ("x509", "-req", "-in", self.out / f"{name}.csr", "-CA", folder / "ca.pem", "-CAkey",
                       folder / "ca-key.pem", "-days", days, "-copy_extensions", "copy", "-out", made)):
            done = openssl(*words)
            self.assertEqual(done.returncode, 0, done.stdout)
        return made

    def refuses_server(self, context, says):
        """A client refuses a server that greets with `context`."""
        with socket.create_server(("127.0.0.1", 0)) as server:
            def serve():
                with server.accept()[0] as plain, contextlib.suppress(OSError):
                    context.wrap_socket(plain, server_side=True)
            thread = threading.Thread(target=serve)
            thread.start()
            self.addCleanup(thread.join)
            uri = f"tls://127.0.0.1:{server.getsockname()[1]}"
            self.refused(SecureClient(self.raynest, uri, self.certificates.ca), 3, says)

    # ---- certificates

    def test_tls_init_makes_private_files_for_all_names_and_overwrites_nothing(self):
        folder = self.certificates.folder
        names = {"ca.pem", "ca-key.pem", "cert.pem", "key.pem", "client-cert.pem", "client-key.pem"}
        self.assertEqual({file.name for file in folder.iterdir()}, names)
        for file in folder.iterdir():
            self.assertEqual(stat.S_IMODE(file.stat().st_mode), 0o600, file)
        self.assertEqual(stat.S_IMODE(folder.stat().st_mode), 0o700)
        shown = openssl("x509", "-in", folder / "cert.pem", "-noout", "-ext",
                        "subjectAltName").stdout
        for name in ("DNS:gpu.example.org", "DNS:localhost", "DNS:" + socket.gethostname(),
                     "IP Address:127.0.0.1", "IP Address:0:0:0:0:0:0:0:1"):
            self.assertIn(name, shown)
        before = {file: file.read_bytes() for file in folder.iterdir()}
        done = subprocess.run([self.raynestd, "tls", "init", folder], text=True,
                              capture_output=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 1)
        self.assertIn("is not overwritten", done.stderr)
        self.assertEqual({file: file.read_bytes() for file in folder.iterdir()}, before)
        checked = openssl("verify", "-CAfile", folder / "ca.pem", "-x509_strict",
                          folder / "cert.pem", folder / "client-cert.pem")
        self.assertEqual(checked.returncode, 0, checked.stdout)

    def test_renewed_certificates_are_served_after_sighup(self):
        certificates = Certificates(self.raynestd, self.out / "renewed")
        daemon = SecureDaemon(self.raynestd, certificates)
        self.addCleanup(daemon.stop)
        context = ssl.create_default_context(cafile=certificates.ca)

        def serial():
            with socket.create_connection(("127.0.0.1", daemon.port)) as plain, \
                    context.wrap_socket(plain, server_hostname="localhost") as wrapped:
                return wrapped.getpeercert()["serialNumber"]

        before = serial()
        names = openssl("x509", "-in", certificates.folder / "cert.pem", "-noout", "-ext",
                        "subjectAltName").stdout
        command(self.raynestd, "tls", "renew", certificates.folder)
        self.assertEqual(openssl("x509", "-in", certificates.folder / "cert.pem", "-noout", "-ext",
                                 "subjectAltName").stdout, names)
        self.assertEqual(serial(), before)
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: serial() != before)
        # A file that became unusable changes nothing, and the log says so.
        renewed = serial()
        (certificates.folder / "cert.pem").write_text("no certificate\n")
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: "certificate_unusable" in daemon.log())
        self.assertEqual(serial(), renewed)

    # ---- from the command line

    def test_a_scene_is_loaded_and_queried_over_tls(self):
        self.assertEqual(self.client.run("load", "builtin:terrain?size=64", "--name",
                                         "hills").returncode, 0)
        over_tls = self.client.run("query", "hills", "--generate", "equirectangular",
                                   "size=700x400", "--fields", "t,prim,position", "-o",
                                   self.out / "a.npz")
        self.assertEqual(over_tls.returncode, 0, over_tls.stderr)
        self.assertIn("280,000 rays", over_tls.stdout)
        listed = self.client.json("scenes")["scenes"]
        self.assertEqual([(scene["name"], scene["owner"]) for scene in listed],
                         [("hills", "alice")])

    def test_the_certificate_must_be_signed_by_a_known_ca_for_this_name(self):
        uri = self.daemon.tls
        unknown = "no CA known here has signed"
        self.refused(SecureClient(self.raynest, uri, None, self.token), 3, unknown)
        other = Certificates(self.raynestd, self.out / "other")
        self.refused(SecureClient(self.raynest, uri, other.ca, self.token), 3, unknown)
        second = next(uri for uri in self.daemon.listen if "127.0.0.2" in uri)
        self.refused(SecureClient(self.raynest, second, self.certificates.ca, self.token), 3,
                     "is not for 127.0.0.2")
        self.refused(SecureClient(self.raynest, uri, self.out / "none.pem", self.token), 2,
                     "none.pem: No such file")
        self.refused(SecureClient(self.raynest, uri, self.certificates.folder, self.token), 2,
                     "it is a folder")
        self.refused(SecureClient(self.raynest, uri, self.certificates.folder / "key.pem", self.token), 2,
                     "no CA certificate in PEM form")
        # localhost leads to this daemon, whose certificate here has another name.
        folder = self.certificates.folder
        for name, code in (("gpu.example.org", 3), ("localhost", 0)):
            made = self.signed("named", "/CN=localhost", f"subjectAltName=DNS:{name}")
            named = Daemon(self.raynestd, "--listen", "tls://127.0.0.1:0", "--tls-cert", made,
                           "--tls-key", folder / "key.pem", "--http", "off")
            self.addCleanup(named.stop)
            port = next(uri for uri in named.listen if uri.startswith("tls://")).rsplit(":", 1)[1]
            done = SecureClient(self.raynest, f"tls://localhost:{port}", self.certificates.ca).run("scenes")
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertEqual("is not for localhost" in done.stderr, code == 3, done.stderr)
        unverified = SecureClient(self.raynest, second, None, self.token)
        done = unverified.run("--tls-verify", "off", "scenes")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("is trusted", done.stderr)

    def test_an_expired_certificate_is_refused_by_both_ends(self):
        folder = self.certificates.folder
        expired = self.signed("old", "/CN=old", "subjectAltName=IP:127.0.0.1", days="-1")
        self.not_started(1, "has expired", "--listen", "tls://127.0.0.1:0", "--tls-cert", expired,
                         "--tls-key", folder / "key.pem")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(expired, folder / "key.pem")
        self.refuses_server(context, "has expired")

    def test_a_key_must_be_private_and_fit_its_certificate(self):
        other = Certificates(self.raynestd, self.out / "unfit")
        listen = ("--listen", "tls://127.0.0.1:0", "--tls-cert", self.certificates.folder / "cert.pem")
        self.not_started(1, "client-cert.pem: this certificate is not for servers: its extended key usage "
                         "lacks serverAuth", "--listen", "tls://127.0.0.1:0", "--tls-cert",
                         self.certificates.folder / "client-cert.pem", "--tls-key",
                         self.certificates.folder / "client-key.pem")
        self.not_started(1, "does not fit the certificate", *listen, "--tls-key",
                         other.folder / "key.pem")
        (other.folder / "key.pem").chmod(0o644)
        self.not_started(1, "chmod 600", *listen, "--tls-key", other.folder / "key.pem")
        self.not_started(1, "none: No such file", "--listen", "tls://127.0.0.1:0",
                         "--tls-cert", self.out / "none", "--tls-key", other.folder / "key.pem")
        self.not_started(1, "no certificate in PEM form", "--listen", "tls://127.0.0.1:0",
                         "--tls-cert", other.folder / "key.pem", "--tls-key", other.folder / "key.pem")

    def test_what_listens_beyond_loopback_is_encrypted_and_asks_who_comes(self):
        for code, says, arguments in (
                (2, "pass --insecure", ("--listen", "tcp://0.0.0.0:0")),
                (2, "needs --tls-cert and --tls-key", ("--listen", "tls://127.0.0.1:0")),
                (2, "belong together", ("--tls-cert", self.certificates.folder / "cert.pem")),
                (2, "give --tokens FILE", ("--listen", "tls://0.0.0.0:0",
                                           *self.certificates.server))):
            self.not_started(code, says, *arguments)
        daemon = Daemon(self.raynestd, "--listen", "tcp://0.0.0.0:0", "--insecure")
        daemon.stop()

    # ---- what does not fit

    def test_plain_text_on_the_tls_port_and_tls_on_the_plain_port_are_told_apart(self):
        plain = self.daemon.tls.replace("tls://", "tcp://")
        self.refused(SecureClient(self.raynest, plain), 3, "connect to it with tls://")
        encrypted = self.daemon.uri.replace("tcp://", "tls://")
        self.refused(SecureClient(self.raynest, encrypted, self.certificates.ca), 3,
                     "does not speak TLS")
        with closed_port() as nobody:
            self.refused(SecureClient(self.raynest, nobody.replace("tcp://", "tls://")), 3,
                         "cannot connect")

    def probe(self, *arguments, **options):
        return openssl("s_client", "-connect", f"127.0.0.1:{self.daemon.port}", "-CAfile",
                       self.certificates.ca, *arguments, **options)

    def test_old_versions_and_weak_ciphers_are_refused(self):
        for arguments in (("-tls1_1",), ("-tls1",), ("-tls1_2", "-cipher", "AES128-SHA"),
                          ("-tls1_2", "-cipher", "ECDHE-ECDSA-AES128-SHA"),
                          ("-tls1_2", "-cipher", "AES128-GCM-SHA256")):
            done = self.probe(*arguments, "-cipher", "ALL@SECLEVEL=0") if len(arguments) == 1 \
                else self.probe(*arguments)
            self.assertIn("Cipher is (NONE)", done.stdout, arguments)
        for arguments in (("-tls1_2",), ("-tls1_3",)):
            done = self.probe(*arguments, "-verify_return_error")
            self.assertIn("Verification: OK", done.stdout, arguments)
            self.assertIn("Compression: NONE", done.stdout)

    def test_a_renegotiation_is_refused(self):
        asks = self.out / "renegotiate"
        asks.write_text("R\n")
        with open(asks, encoding="utf-8") as stdin:
            done = self.probe("-tls1_2", stdin=stdin)
        self.assertRegex(done.stdout, "no renegotiation|RENEGOTIATING")
        self.assertNotIn("Verification: OK\n---\nRENEGOTIATING\nVerification", done.stdout)
        self.assertEqual(self.client.run("scenes").returncode, 0)

    def test_probes(self):
        """The questions of a scanner, as arguments of openssl s_client and what its answer says."""
        shown = {
            "TLS 1.3": (("-tls1_3",), "Protocol  : TLSv1.3|New, TLSv1.3"),
            "TLS 1.2": (("-tls1_2",), "New, TLSv1.2"),
            "no TLS 1.1": (("-tls1_1", "-cipher", "ALL@SECLEVEL=0"), r"Cipher is \(NONE\)"),
            "no TLS 1.0": (("-tls1", "-cipher", "ALL@SECLEVEL=0"), r"Cipher is \(NONE\)"),
            "the server chooses AES-128 first": (("-tls1_3",), "TLS_AES_128_GCM_SHA256"),
            "though the client prefers another": (
                ("-tls1_3", "-ciphersuites", "TLS_CHACHA20_POLY1305_SHA256:TLS_AES_128_GCM_SHA256"),
                "Cipher is TLS_AES_128_GCM_SHA256"),
            "forward secrecy": (("-tls1_2",), "ECDHE"),
            "a temporary key of a good curve": (("-tls1_2",), "Temp Key: (X25519|ECDH, prime256v1)"),
            "no compression": (("-tls1_2",), "Compression: NONE"),
            "secure renegotiation is known": (("-tls1_2",), "Secure Renegotiation IS supported"),
            "no session is resumed": (("-tls1_2", "-reconnect"), "(?s)^(?!.*Reused)"),
            "no tickets of TLS 1.3": (("-tls1_3",), "(?s)^(?!.*NewSessionTicket|.*Post-Handshake New Session)"),
            "no early data": (("-tls1_3",), "Early data was not sent"),
            "no client certificate is asked for": (("-tls1_2",), "No client certificate CA names sent"),
            "the chain verifies": (("-verify_return_error",), "Verification: OK"),
            "for this name": (("-verify_return_error", "-verify_hostname", "gpu.example.org"), "Verification: OK"),
            "for no other": (("-verify_return_error", "-verify_hostname", "cpu.example.org"), "ostname mismatch"),
            "a name that it does not know": (("-servername", "elsewhere.example"), "Verification: OK"),
            "no protocol of applications": (("-alpn", "h2,http/1.1"), "No ALPN negotiated"),
        }
        for cipher in ("NULL", "aNULL", "eNULL", "EXPORT", "RC4", "3DES", "MD5", "CAMELLIA", "SEED", "ARIA",
                       "PSK", "SRP", "kRSA", "kDHE", "AES128-SHA", "ECDHE-ECDSA-AES256-SHA384", "AES128-CCM"):
            shown[f"no {cipher}"] = (("-tls1_2", "-cipher", f"{cipher}:@SECLEVEL=0"),
                                     r"Cipher is \(NONE\)|no cipher match|Error with command|no ciphers available")
        for what, (arguments, pattern) in shown.items():
            with self.subTest(what):
                self.assertRegex(self.probe(*arguments).stdout, pattern)
        self.assertEqual(self.client.run("scenes").returncode, 0)

    def test_each_failed_handshake_has_one_line_in_the_log(self):
        def lines():
            return [line for line in self.daemon.log().splitlines() if " handshake_failed " in line]
        other = Certificates(self.raynestd, self.out / "unknown ca")
        for reason, attempt in (
                ("it does not speak TLS", lambda: SecureClient(
                    self.raynest, self.daemon.tls.replace("tls://", "tcp://")).run("scenes")),
                ("unknown ca", lambda: SecureClient(self.raynest, self.daemon.tls, other.ca).run("scenes")),
                ("unsupported protocol", lambda: self.probe("-tls1_1", "-cipher", "ALL@SECLEVEL=0")),
                ("no shared cipher", lambda: self.probe("-tls1_2", "-cipher", "AES128-SHA"))):
            with self.subTest(reason):
                before = len(lines())
                attempt()
                line = until(lambda: len(lines()) > before and lines()[-1])
                self.assertIn(reason, line)
                self.assertIn("peer=127.0.0.1", line)
                self.assertEqual(len(lines()), before + 1)

    def test_a_daemon_that_speaks_old_tls_alone_is_left(self):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.certificates.folder / "cert.pem", self.certificates.folder / "key.pem")
        context.set_ciphers("ALL:@SECLEVEL=0")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
        self.refuses_server(context, "TLS")

    def test_a_handshake_that_stops_ends_in_time(self):
        hello = bytes.fromhex("160301020001")  # a ClientHello that never comes whole
        crowd = [socket.create_connection(("127.0.0.1", self.daemon.port), timeout=PATIENCE)
                 for _ in range(8)]
        for i, connection in enumerate(crowd):
            self.addCleanup(connection.close)
            connection.sendall(hello[:i])
        begun = time.monotonic()
        for connection in crowd:
            with self.subTest():
                try:
                    self.assertEqual(connection.recv(100), b"")
                except ConnectionResetError:
                    pass
        self.assertLess(time.monotonic() - begun, GREETING_SECONDS + 3)
        self.assertEqual(self.client.run("scenes").returncode, 0)

    def test_a_hello_of_ten_megabytes_ends_the_connection(self):
        context = ssl.create_default_context(cafile=self.certificates.ca)
        with socket.create_connection(("127.0.0.1", self.daemon.port), PATIENCE) as plain, \
                context.wrap_socket(plain, server_hostname="localhost") as wrapped:
            header = b"RYN1" + (1).to_bytes(2, "little") + bytes(2) + \
                (10 << 20).to_bytes(4, "little") + bytes(20)
            wrapped.sendall(header)
            answer = b""
            while part := wrapped.recv(4096):
                answer += part
        self.assertIn(b"LIMIT_EXCEEDED", answer)

    def test_a_long_upload_waits_for_a_slow_line(self):
        """The rays fill the buffers of both ends many times over."""
        count = 100_000
        rays = array.array("f", (value for i in range(count)
                                 for value in (i % 97 - 48, 50, i % 89 - 44, 0, -1, 0)))
        file = self.out / "many.npy"
        file.write_bytes(npy((count, 6), rays.tobytes()))
        self.assertEqual(self.client.run("load", "builtin:terrain?size=8", "--name", "slope").returncode, 0)
        self.addCleanup(self.client.run, "unload", "slope")
        answers = []
        with Link(self.daemon.port, rate=8e6, buffer=4096) as link:
            for number, uri in enumerate((f"tls://127.0.0.1:{link.port}", self.daemon.uri)):
                client = SecureClient(self.raynest, uri, self.certificates.ca, self.token)
                out = self.out / f"many{number}.npz"
                done = client.run("query", "slope", "--rays", file, "--fields", "t,prim", "-o", out)
                self.assertEqual(done.returncode, 0, done.stderr)
                answers.append(out.read_bytes())
        self.assertEqual(*answers)

    def test_what_is_sent_cannot_be_read_on_the_way(self):
        """A capture of the line holds the names over TCP, and none of them over TLS."""
        words = (b"secretvalley", b"terrain", b"raynest", b"RYN1")
        for uri, client in ((self.daemon.uri, lambda uri: SecureClient(self.raynest, uri)),
                            (self.daemon.tls, lambda uri: SecureClient(
                                self.raynest, uri, self.certificates.ca, self.token))):
            scheme, port = uri.split("://")[0], int(uri.rsplit(":", 1)[1])
            with Link(port, record=True) as link:
                done = client(f"{scheme}://127.0.0.1:{link.port}").run(
                    "load", "builtin:terrain?size=8", "--name", "secretvalley")
                self.assertEqual(done.returncode, 0, done.stderr)
                seen = link.seen
            self.assertGreater(len(seen), 500)
            for word in words:
                self.assertEqual(word in seen, scheme == "tcp", (scheme, word))
            self.assertNotIn(self.token.encode(), seen)
            self.assertNotIn(b"alice", seen)

    # ---- mutual TLS

    def test_a_client_certificate_makes_the_principal(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--client-ca", self.certificates.ca)
        self.addCleanup(daemon.stop)
        client = SecureClient(self.raynest, daemon.tls, self.certificates.ca)
        loaded = client.run(*self.certificates.client, "load", "builtin:terrain?size=8")
        self.assertEqual(loaded.returncode, 0, loaded.stderr)
        self.assertIn("CN=raynest-client", client.run(*self.certificates.client, "scenes").stdout)
        self.refused(client, 4, "asks for a client certificate")
        other = Certificates(self.raynestd, self.out / "strangers")
        self.refused(client, 4, "refuses this client's certificate", *other.client, "scenes")
        self.refused(client, 4, "refuses this client's certificate", *self.expired_client(), "scenes")
        # A server certificate is not one for clients.
        self.refused(client, 4, "refuses this client's certificate", "--cert",
                     self.certificates.folder / "cert.pem", "--key",
                     self.certificates.folder / "key.pem", "scenes")

    def expired_client(self):
        """Options for a certificate of a client whose time is over."""
        made = self.signed("late", "/CN=late", "extendedKeyUsage=clientAuth", "client-key.pem", "-1")
        return "--cert", made, "--key", self.certificates.folder / "client-key.pem"

    def test_a_certificate_gets_its_role_from_the_token_file(self):
        tokens = Tokens(self.raynestd, self.out / "roles of certificates")
        command(self.raynestd, "token", "add", "--cert", "CN=raynest-client", "--role", "viewer",
                "--tokens", tokens.file)
        daemon = SecureDaemon(self.raynestd, self.certificates, "--client-ca", self.certificates.ca,
                              "--tokens", tokens.file)
        self.addCleanup(daemon.stop)
        client = SecureClient(self.raynest, daemon.tls, self.certificates.ca)
        self.refused(client, 4, "needs the role user", *self.certificates.client, "load",
                     "builtin:terrain?size=8")


if __name__ == "__main__":
    main()
