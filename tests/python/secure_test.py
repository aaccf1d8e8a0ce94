"""The Python client over TLS, with tokens and shared scenes.

  secure_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import shutil
import socket
import ssl
import tempfile
import threading
import warnings
from unittest import mock

import numpy as np

import raynest
from raynest._net.access import Access
from raynest._net.tls import _context
from daemon import Programs, until
from secure_daemon import Certificates, SecureDaemon, Tokens, fake_ssh
from with_daemon import main

RAYS = np.tile(np.float32([0, 50, 0, 0, -1, 0]), (200_000, 1))


class Secure(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        os.environ["XDG_CONFIG_HOME"] = str(cls.out / "config")
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls")
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.secrets = {name: cls.tokens.add(name, "--role", role)
                       for name, role in (("alice", "user"), ("bob", "user"), ("vera", "viewer"))}
        cls.daemon = SecureDaemon(cls.raynestd, cls.certificates, "--tokens", cls.tokens.file,
                                  "--client-ca", cls.certificates.ca, "--listen",
                                  "tls://127.0.0.2:0")
        cls.addClassCleanup(cls.daemon.stop)

    def setUp(self):
        # A right token ends the wait that wrong tokens of another test have caused.
        until(lambda: self.connect_or_none("alice"))

    def connect(self, name="", **options):
        options.setdefault("ca", str(self.certificates.ca))
        client = raynest.connect(options.pop("uri", self.daemon.tls),
                                 token=self.secrets.get(name, name), **options)
        self.addCleanup(client.close)
        return client

    def test_rays_and_hits_are_the_same_as_over_plain_tcp(self):
        alice = self.connect("alice")
        self.assertEqual((alice.connection.daemon.principal, alice.connection.daemon.role),
                         ("alice", "user"))
        hills = alice.load("builtin:terrain?size=64", "hills", share="public")
        over_tls = hills.trace(RAYS, fields=("t", "prim", "position"))
        with raynest.connect(self.daemon.uri) as plain:
            over_tcp = plain.scene("alice/hills").trace(RAYS, fields=("t", "prim", "position"))
        for column, values in over_tcp.items():
            np.testing.assert_array_equal(over_tls[column], values)
        for first, columns in hills.stream(RAYS, fields=("t",)):
            np.testing.assert_array_equal(columns["t"], over_tcp["t"][first:first + len(columns["t"])])
        self.assertGreater(alice.ping(), 0)

    def test_a_stream_that_is_left_early_is_cancelled(self):
        alice = self.connect("alice")
        hills = alice.load("builtin:terrain?size=64", "left")
        for _ in hills.stream(RAYS, fields=("t", "position", "ng")):
            break
        self.assertEqual(len(hills.trace(RAYS[:5])["t"]), 5)

    def test_certificates_and_tokens_are_checked(self):
        other = Certificates(self.raynestd, self.out / "other")
        wrong_name = next(uri for uri in self.daemon.listen if "127.0.0.2" in uri)
        plain = self.daemon.tls.replace("tls://", "tcp://")
        for kind, says, options in (
                (raynest.errors.ConnectError, "no CA known here", {"ca": ""}),
                (raynest.errors.ConnectError, "no CA known here", {"ca": str(other.ca)}),
                (raynest.errors.ConnectError, "is not for 127.0.0.2", {"uri": wrong_name}),
                (raynest.errors.ConnectError, "does not speak TLS",
                 {"uri": self.daemon.uri.replace("tcp://", "tls://")}),
                (raynest.errors.ConnectError, "with tls://", {"uri": plain}),
                (raynest.errors.UsageError, "/none: No such file", {"ca": "/none"}),
                (raynest.errors.UsageError, "no CA certificate",
                 {"ca": str(self.certificates.client[3])}),
                (raynest.errors.UsageError, "/none: No such file", {"cert": "/none", "key": "/none"}),
                (raynest.errors.UsageError, "belong together", {"cert": "/none"}),
                (raynest.errors.UsageError, "is not sent to",
                 {"uri": "tcp://192.0.2.1:1", "name": "alice"}),
                (raynest.errors.NotAllowedError, "asks for a token", {}),
                (raynest.errors.NotAllowedError, "is unknown here", {"name": "rnt_1"}),
                (raynest.errors.NotAllowedError, "refuses this client's certificate",
                 {"cert": str(other.client[1]), "key": str(other.client[3])})):
            with self.subTest(says=says, **options), self.assertRaisesRegex(kind, says):
                self.connect(**options)
        self.connect("alice")  # forgets the failures

    def test_an_argument_comes_before_the_environment_and_that_before_what_is_kept(self):
        kept = self.out / "config" / "raynest" / "hosts.toml"
        kept.parent.mkdir(parents=True)
        self.addCleanup(shutil.rmtree, kept.parent)
        kept.write_text(f'["{self.daemon.tls}"]\ntoken = "{self.secrets["vera"]}"\n')
        kept.chmod(0o600)

        def who(**options):
            with raynest.connect(self.daemon.tls, ca=str(self.certificates.ca), **options) as client:
                return client.connection.daemon.principal
        self.assertEqual(who(), "vera")
        with mock.patch.dict(os.environ, RAYNEST_TOKEN=self.secrets["bob"]):
            self.assertEqual(who(), "bob")
            self.assertEqual(who(token=self.secrets["alice"]), "alice")
        for mode in (0o644, 0o640):
            kept.chmod(mode)
            with self.assertRaisesRegex(raynest.UsageError, "chmod 600"):
                who()

    def test_a_client_certificate_is_a_principal(self):
        robot = self.connect(cert=str(self.certificates.client[1]),
                             key=str(self.certificates.client[3]))
        self.assertEqual(robot.connection.daemon.principal, "CN=raynest-client")

    def test_a_scene_is_shared_with_the_principals_that_were_named(self):
        alice = self.connect("alice")
        _, cert, _, key = self.certificates.sign("whole", "/O=Lab/CN=robot")
        whole = self.connect(cert=str(cert), key=str(key))
        self.assertEqual(whole.connection.daemon.principal, "CN=robot,O=Lab")
        part = self.connect(cert=str(self.certificates.sign("part", "/CN=robot")[1]), key=str(key))

        def load(share):
            alice.load("builtin:terrain?size=8", "named", share=share)
            return [name for name, client in (("whole", whole), ("part", part), ("bob", self.connect("bob")))
                    if any(scene["name"] == "alice/named" for scene in client.scenes())]
        for unclear in ("CN=robot,O=Lab", "CN = robot", "bob,,eve"):
            with self.assertRaises(raynest.errors.Error):
                load(unclear)
        self.assertEqual(load(["CN=robot,O=Lab"]), ["whole"])
        self.assertEqual(load("bob,CN=robot\\,O=Lab"), ["whole", "bob"])
        self.assertEqual(load("bob,CN=robot"), ["part", "bob"])
        self.assertEqual(load(["bob"]), ["bob"])

    def test_verification_can_be_turned_off_with_a_warning(self):
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            self.connect("alice", ca="", verify=False)
        self.assertTrue(any("is trusted" in str(warning.message) for warning in seen))

    def test_a_revoked_token_ends_the_connection(self):
        secret = self.tokens.add("guest")
        until(lambda: self.connect_or_none(secret))
        guest = self.connect(secret)
        self.tokens.revoke("guest")

        def ended():
            try:
                guest.stats()
            except raynest.errors.Error as error:
                return error
            return None
        self.assertIn("is admitted no more", str(until(ended)))

    def connect_or_none(self, secret):
        try:
            return self.connect(secret)
        except (raynest.errors.NotAllowedError, raynest.errors.BusyError):
            return None

    def test_scenes_are_their_owners_until_they_are_shared(self):
        alice, bob, vera = (self.connect(name) for name in ("alice", "bob", "vera"))
        alice.load("builtin:terrain?size=8", "car")
        with self.assertRaises(raynest.errors.InvalidError):
            bob.scene("alice/car")
        alice.load("builtin:terrain?size=8", "car", share=["bob"])
        self.assertEqual(bob.scene("car").name, "alice/car")
        with self.assertRaises(raynest.errors.InvalidError):
            vera.scene("alice/car")
        with self.assertRaises(raynest.errors.NotAllowedError):
            vera.load("builtin:terrain?size=8")
        shares = {scene["name"]: scene["share"] for scene in alice.scenes()}
        self.assertEqual(shares["car"], "bob")
        # A mesh without a name is this connection's.
        box = bob.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        self.assertEqual(box.trace([[0.2, 0.2, 1, 0, 0, -1]])["prim"].tolist(), [0])

    def test_ssh_reaches_the_unix_socket_of_another_machine(self):
        path = self.out / "socket"
        daemon = SecureDaemon(self.raynestd, self.certificates, "--listen", f"unix:{path}")
        self.addCleanup(daemon.stop)
        programs = fake_ssh(self.out / "bin", "me@gpu", "2222")
        before = os.environ["PATH"]
        self.addCleanup(os.environ.__setitem__, "PATH", before)
        os.environ["PATH"] = f"{programs}:{before}"
        client = raynest.connect(f"ssh://me@gpu:2222{path}")
        self.assertEqual(client.connection.daemon.role, "admin")
        hills = client.load("builtin:terrain?size=64", "far")
        self.assertEqual(len(hills.trace(RAYS, fields=("t",))["t"]), len(RAYS))
        tunnels = self.children("ssh")
        self.assertEqual(len(tunnels), 1)
        client.close()
        until(lambda: not self.children("ssh"))
        for uri, kind, says in ((f"ssh://-oProxyCommand=x{path}", raynest.errors.UsageError, "is not ssh://"),
                                (f"ssh://gpu{path}", raynest.errors.ConnectError, "ssh to gpu failed")):
            with self.assertRaisesRegex(kind, says):
                raynest.connect(uri)
        os.environ["PATH"] = str(self.out)
        with self.assertRaisesRegex(raynest.errors.ConnectError, "cannot start ssh"):
            raynest.connect(f"ssh://gpu{path}")

    @staticmethod
    def children(name):
        """Process ids of this process's children that run a program of this name."""
        found = []
        for entry in pathlib.Path("/proc").glob("[0-9]*"):
            try:
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except (OSError, IndexError):
                continue
            if parent == os.getpid() and any(word.endswith(f"/{name}".encode()) for word in words):
                found.append(int(entry.name))
        return found

    def test_a_server_that_stops_within_the_handshake_is_left(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            uri = f"tls://127.0.0.1:{server.getsockname()[1]}"
            accepted = []
            thread = threading.Thread(target=lambda: accepted.append(server.accept()[0].close()))
            thread.start()
            with self.assertRaises(raynest.errors.ConnectError):
                self.connect(uri=uri)
            thread.join()

    def test_an_old_version_of_tls_is_refused(self):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
        with socket.create_connection(("127.0.0.1", self.daemon.port)) as plain, \
                self.assertRaises(OSError):
            context.wrap_socket(plain)
        self.assertEqual(_context(Access()).minimum_version, ssl.TLSVersion.TLSv1_2)   # this package's too


if __name__ == "__main__":
    main()
