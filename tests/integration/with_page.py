"""A daemon with its page over https and tokens for each role, for tests of the page's logins."""
import json
import pathlib
import tempfile

import websocket
from daemon import Programs, until
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens
from websocket import get, post

ROLES = ("viewer", "user", "admin")


class WithPage(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls", "gpu.example.org")
        websocket.trusted.load_verify_locations(cls.certificates.ca)
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.secrets = {role: cls.tokens.add("test-" + role, "--role", role) for role in ROLES}
        cls.daemon = cls.make_daemon("--http", "https://127.0.0.1:0")
        cls.addClassCleanup(cls.daemon.stop)
        cls.http = cls.daemon.http

    @classmethod
    def make_daemon(cls, *arguments):
        return SecureDaemon(cls.raynestd, cls.certificates, "--tokens", cls.tokens.file, *arguments)

    def own_daemon(self, *arguments):
        daemon = self.make_daemon(*arguments)
        self.addCleanup(daemon.stop)
        return daemon

    def setUp(self):
        # A right token ends the wait that wrong tokens of another test have caused.
        until(lambda: post(self.http, "/v1/login", "token=" + self.secrets["user"])[0] == 200)

    def client(self, name=None, daemon=None):
        return SecureClient(self.raynest, (daemon or self.daemon).tls, self.certificates.ca,
                            self.secrets.get(name, name))

    def log_in(self, http, **proof):
        """Returns the cookie as a header."""
        (name, value), = proof.items()
        status, headers, body = post(http, "/v1/login", f"{name}={value}" + "&agreed=yes" * (name == "code"))
        self.assertEqual(status, 200, body)
        cookie, *attributes = headers["set-cookie"].split("; ")
        self.assertIn("HttpOnly", attributes)
        self.assertIn("SameSite=Strict", attributes)
        self.assertEqual("Secure" in attributes, http.startswith("https://"))
        self.assertNotIn(value, cookie)
        return [f"Cookie: theme=dark; {cookie}"]

    def code(self, client):
        address = client.json("open")["address"]
        return address.rpartition("code=")[2]

    def who(self, http, headers=()):
        status, _, body = get(http, "/v1/login", headers=headers)
        return json.loads(body) if status == 200 else status

    def hears_of_the_end(self, stream):
        """True if the daemon says NOT_ALLOWED and closes."""
        try:
            while True:
                name, _, message, _ = stream.hear()
                if name == "Error":
                    self.assertEqual((message["name"], message["closing"]), ("NOT_ALLOWED", True))
                    said = True
        except websocket.Closed:
            return said
