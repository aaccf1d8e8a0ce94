#!/usr/bin/env python3
"""Tests tokens, roles, shared scenes and administration from the command line.

  tokens_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import re
import socket
import stat
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

from connections_test import HELLO, WELCOME, read_frame
from daemon import LONG, PATIENCE, Programs, main, until
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens, command, fake_ssh

RAY = "0,50,0,0,-1,0"


class TokensTest(Programs):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="raynest test ")
        cls.addClassCleanup(cls.folder.cleanup)
        cls.out = pathlib.Path(cls.folder.name)
        cls.certificates = Certificates(cls.raynestd, cls.out / "tls")
        cls.tokens = Tokens(cls.raynestd, cls.out / "tokens")
        cls.secrets = {name: cls.tokens.add(name, "--role", role)
                       for name, role in (("alice", "user"), ("bob", "user"), ("vera", "viewer"),
                                          ("root", "admin"))}
        cls.socket = f"unix:{cls.out}/socket"
        cls.daemon = SecureDaemon(cls.raynestd, cls.certificates, "--tokens", cls.tokens.file,
                                  "--listen", cls.socket, "--log-level", "debug")
        cls.addClassCleanup(cls.daemon.stop)

    def setUp(self):
        # A right token ends the wait that wrong tokens of another test have caused.
        self.says(self.client("alice").run("scenes"), 0)

    def client(self, name=None, daemon=None, **options):
        return SecureClient(self.raynest, (daemon or self.daemon).tls, self.certificates.ca,
                            self.secrets.get(name, name), **options)

    def says(self, done, code, *texts):
        self.assertEqual(done.returncode, code, done.stderr)
        for text in texts:
            self.assertIn(text, done.stdout + done.stderr)
        return done

    # ---- the token file

    def test_a_token_is_shown_once_and_kept_as_a_hash(self):
        self.assertEqual(stat.S_IMODE(self.tokens.file.stat().st_mode), 0o600)
        content = self.tokens.file.read_text()
        for name, secret in self.secrets.items():
            self.assertRegex(secret, "^rnt_[0-9a-f]{64}$")
            self.assertNotIn(secret, content)
            self.assertIn(name, content)
        listed = command(self.raynestd, "token", "list", "--tokens", self.tokens.file)
        self.assertIn("vera\tviewer\tnever", listed)
        for arguments, code in ((("add", "alice"), 1), (("add", "no/name"), 2), (("add",), 2),
                                (("add", "x", "--role", "king"), 2), (("revoke", "nobody"), 5),
                                (("add", "x", "--expires", "soon"), 2),
                                (("add", "x", "--quota", "jobs=many"), 2)):
            done = subprocess.run([self.raynestd, "token", *arguments, "--tokens", self.tokens.file],
                                  text=True, capture_output=True, timeout=PATIENCE)
            self.assertEqual(done.returncode, code, arguments)
            self.assertEqual(done.stderr.count("\n"), 1)
        self.assertEqual(self.tokens.file.read_text(), content)

    def test_a_token_file_that_others_can_read_is_refused(self):
        tokens = Tokens(self.raynestd, self.out / "open")
        secret = tokens.add("alice")
        tokens.file.chmod(0o644)
        done = subprocess.run([self.raynestd, "--listen", "tcp://127.0.0.1:0", "--http", "off",
                               "--cuda", "off", "--tokens", tokens.file], text=True,
                              capture_output=True, timeout=PATIENCE)
        self.says(done, 1, "other users may read", "chmod 600")
        given = self.out / "given"
        given.write_text(secret)
        for mode in (0o644, 0o640, 0o604):
            given.chmod(mode)
            self.says(self.client().run("--token-file", given, "scenes"), 2, "chmod 600")
        given.chmod(0o600)
        self.says(self.client().run("--token-file", given, "scenes"), 4, "is unknown here")

    def test_a_token_is_needed_whole_and_of_this_daemon(self):
        foreign = Tokens(self.raynestd, self.out / "foreign").add("alice")
        self.says(self.client("alice").run("scenes"), 0)  # forgets failures of other tests
        self.says(self.client().run("scenes"), 4, "asks for a token", "RAYNEST_TOKEN")
        for wrong in (self.secrets["alice"][:36], foreign, "rnt_", "x" * 200):
            self.says(self.client(wrong).run("scenes"), 4, "is unknown here")
        self.says(self.client("alice").run("scenes"), 0)
        self.says(self.client("two words").run("scenes"), 2, "holds no token")

    def test_wrong_tokens_have_to_wait(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--tokens", self.tokens.file)
        self.addCleanup(daemon.stop)
        codes = []
        # The wait is longer after each, so that it is met at last, however slow the machine is.
        until(lambda: codes.append(self.client("wrong", daemon).run("scenes").returncode) or
              codes[-1] == 6)
        self.assertEqual(codes[:5], [4] * 5)
        # Others behind the same address are let in meanwhile.
        self.says(self.client("alice", daemon).run("scenes"), 0)

    def test_an_expired_token_ends_its_connections(self):
        secret = self.tokens.add("guest", "--expires", "3s")
        self.addCleanup(self.tokens.revoke, "guest")
        until(lambda: self.client(secret).run("load", "builtin:terrain?size=64", "--name", "hills").returncode == 0)
        busy = self.client(secret).start("render", "hills", "--size", "4096x4096", "--traversal", "reference",
                                         "-o", self.out / "never.png")
        self.addCleanup(busy.communicate)
        self.addCleanup(busy.kill)
        self.assertEqual(busy.wait(PATIENCE), 4, "one that was open before")
        until(lambda: self.client(secret).run("scenes").returncode == 4)
        self.says(self.client("alice").run("scenes"), 0)

    def test_a_list_of_connections_has_more_than_one_page(self):
        place = ("127.0.0.1", int(self.daemon.uri.rsplit(":", 1)[1]))
        crowd = [socket.create_connection(place, PATIENCE) for _ in range(130)]
        for connection in crowd:
            self.addCleanup(connection.close)
        rows = until(lambda: [row for row in self.client("root").json("admin", "connections")["connections"]]
                     if self.client("root").json("stats")["connections_open"] > 130 else None)
        self.assertGreater(len({row["connection"] for row in rows}), 130)

    def test_a_revoked_token_ends_its_connections_within_a_second(self):
        secret = self.tokens.add("mallory")
        client = self.client(secret)
        until(lambda: client.run("load", "builtin:terrain?size=64", "--name", "hills").returncode == 0)
        busy = client.start("render", "hills", "--size", "4096x4096", "--traversal", "reference",
                            "-o", self.out / "never.png")
        self.addCleanup(busy.communicate)
        self.addCleanup(busy.kill)
        until(lambda: any(row["principal"] == "mallory"
                          for row in self.client("root").json("admin", "connections")["connections"]))
        begun = time.monotonic()
        self.tokens.revoke("mallory")
        until(lambda: busy.poll() is not None)
        # Twice the second: this machine is shared.
        self.assertLess(time.monotonic() - begun, 2)
        self.assertEqual(busy.returncode, 4, busy.stderr.read())
        self.says(client.run("scenes"), 4, "was revoked")

    def test_no_token_reaches_the_log(self):
        for name in self.secrets:
            self.client(name).run("scenes")
        self.client("wrongsecretword").run("scenes")
        log = self.daemon.log()
        self.assertIn("login_refused", log)
        self.assertIn("principal=alice", log)
        for secret in (*self.secrets.values(), "wrongsecretword", "rnt_"):
            self.assertNotIn(secret, log)
        self.client("alice").run("scenes")

    # ---- where clients find their token

    def test_login_keeps_a_token_for_later_commands(self):
        home = self.out / "home"
        home.mkdir()
        client = self.client(home=home)
        login = client.start("login", self.daemon.tls, stdin=subprocess.PIPE)
        said, errors = login.communicate(self.secrets["alice"] + "\n", timeout=PATIENCE)
        self.assertEqual(login.returncode, 0, errors)
        self.assertIn("as alice (user)", said)
        kept = home / ".config" / "raynest" / "hosts.toml"
        self.assertEqual(stat.S_IMODE(kept.stat().st_mode), 0o600)
        self.says(client.run("scenes"), 0)
        # It keeps the CA too, and a wrong token is not kept.
        bare = SecureClient(self.raynest, self.daemon.tls, home=home)
        self.says(bare.run("scenes"), 0)
        before = kept.read_text()
        wrong = client.start("login", self.daemon.tls, stdin=subprocess.PIPE)
        wrong.communicate("nothing\n", timeout=PATIENCE)
        self.assertEqual(wrong.returncode, 4)
        for endless, said in (("/dev/zero", "longer than 4096 bytes"), ("/dev/null", "no token came")):
            with open(endless, "rb") as file:
                wrong = client.start("login", self.daemon.tls, stdin=file)
                _, errors = wrong.communicate(timeout=PATIENCE)
            self.assertEqual(wrong.returncode, 2, errors)
            self.assertIn(said, errors)
        self.assertEqual(kept.read_text(), before)
        # A file that is named comes before RAYNEST_TOKEN, and that before what login has kept.
        given = self.out / "root"
        given.write_text(self.secrets["root"])
        given.chmod(0o600)

        def owner(client, *options):
            self.says(client.run(*options, "load", "builtin:terrain?size=8", "--name", "mine"), 0)
            found = [scene["name"] for scene in self.client("root").json("scenes")["scenes"] if "mine" in scene["name"]]
            self.says(client.run(*options, "unload", "mine"), 0)
            return found
        self.assertEqual(owner(bare), ["alice/mine"])
        both = SecureClient(self.raynest, self.daemon.tls, token=self.secrets["bob"], home=home)
        self.assertEqual(owner(both), ["bob/mine"])
        self.assertEqual(owner(both, "--token-file", given), ["mine"])
        for mode in (0o644, 0o640):
            kept.chmod(mode)
            self.says(bare.run("scenes"), 2, "chmod 600")
        self.client("alice").run("scenes")

    def test_a_token_is_not_sent_where_others_can_read_it(self):
        client = SecureClient(self.raynest, "tcp://192.0.2.1:31060", None, self.secrets["alice"])
        self.says(client.run("scenes"), 2, "is not sent to", "use tls://")

    # ---- roles and scenes

    def test_viewers_ask_and_users_load(self):
        self.says(self.client("bob").run("load", "builtin:terrain?size=8", "--name", "shown",
                                         "--share", "public"), 0)
        vera = self.client("vera")
        self.says(vera.run("query", "bob/shown", "--ray", RAY), 0)
        self.says(vera.run("load", "builtin:terrain?size=8"), 4, "needs the role user")
        self.says(vera.run("unload", "bob/shown"), 4, "needs the role user")
        for name in ("vera", "bob"):
            self.says(self.client(name).run("admin", "connections"), 4, "needs the role admin")
        self.says(self.client("bob").run("unload", "shown"), 0)

    def test_two_teams_do_not_see_each_others_scenes(self):
        alice, bob, vera = (self.client(name) for name in ("alice", "bob", "vera"))
        for client, size in ((alice, 8), (bob, 16)):
            self.says(client.run("load", f"builtin:terrain?size={size}", "--name", "car"), 0)
        triangles = [client.json("info", "car")["unique_triangles"] for client in (alice, bob)]
        self.assertNotEqual(*triangles)
        unknown, hidden = (re.sub(r"\[request \w+\]", "", self.says(bob.run("info", name), 5).stderr)
                           for name in ("alice/cab", "alice/car"))
        self.assertEqual(hidden, unknown.replace("cab", "car"))
        self.assertEqual([scene["name"] for scene in bob.json("scenes")["scenes"]], ["car"])
        # Shared with bob alone.
        self.says(alice.run("load", "builtin:terrain?size=8", "--name", "car", "--share", "bob"), 0)
        self.says(bob.run("query", "alice/car", "--ray", RAY), 0)
        self.says(vera.run("query", "alice/car", "--ray", RAY), 5)
        names = {scene["name"]: scene["share"] for scene in bob.json("scenes")["scenes"]}
        self.assertEqual(names, {"car": "", "alice/car": "bob"})
        self.says(bob.run("unload", "alice/car"), 4, "only its owner may unload it")
        # Equal content of another owner is not told of.
        loaded = bob.json("load", "builtin:terrain?size=8", "--name", "copy")
        self.assertTrue(loaded["reused"])  # bob may see alice's
        loaded = self.client("root").json("load", "builtin:terrain?size=16", "--name", "mine")
        self.assertTrue(loaded["reused"])  # an administrator sees all
        self.assertEqual(bob.json("stats")["scenes"], 2)  # not alice's
        self.assertGreaterEqual(self.client("root").json("stats")["scenes"], 4)
        for client in (alice, bob, self.client("root")):
            self.says(client.run("unload", "--all"), 0)

    def test_jobs_of_others_are_not_listed(self):
        alice = self.client("alice")
        self.says(alice.run("load", "builtin:terrain?size=64", "--name", "secret"), 0)
        number = alice.json("render", "secret", "--size", "64x64", "--detach")["job"]
        self.assertIn(number, [job["job"] for job in alice.json("jobs")["jobs"]])
        self.assertEqual(self.client("bob").json("jobs")["jobs"], [])
        self.assertIn(number, [job["job"] for job in self.client("root").json("jobs")["jobs"]])
        for act in ("wait", "cancel", "fetch"):
            arguments = ("-o", self.out / "never.png") if act == "fetch" else ()
            there, nowhere = (re.sub(r" \[request \w+\]", "", self.says(
                self.client("bob").run(act, job, *arguments), 5).stderr) for job in (number, 987654))
            self.assertEqual(there, nowhere.replace("987654", str(number)))
        self.says(alice.run("unload", "secret"), 0)

    def test_a_private_scene_answers_as_late_as_an_unknown_one(self):
        sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client" / "python"))
        try:
            import raynest
        except ImportError as error:
            self.skipTest(f"no numpy: {error}")
        self.says(self.client("alice").run("load", "builtin:terrain?size=8", "--name", "vault"), 0)
        self.addCleanup(self.client("alice").run, "unload", "vault")
        with raynest.connect(self.daemon.tls, token=self.secrets["bob"],
                             ca=str(self.certificates.ca)) as bob:
            def seconds(name, planted):
                """The time of an answer, of which `planted` seconds are wasted on purpose."""
                begun = time.perf_counter()
                try:
                    bob.connection.ask("Info", {"scene": name}, "SceneInfo")
                    self.fail(name)
                except raynest.errors.InvalidError:
                    pass
                end = time.perf_counter() + planted
                while time.perf_counter() < end:
                    pass
                return time.perf_counter() - begun

            def ratios(rounds):
                """Medians over that of an unknown scene: a private one, and an unknown one with 5 % more."""
                usual = statistics.median(seconds("alice/vaulu", 0) for _ in range(100))
                series = {"unknown": ("alice/vaulu", 0), "private": ("alice/vault", 0),
                          "planted": ("alice/vaulu", 0.05 * usual)}
                times = {name: [] for name in series}
                for i in range(rounds):
                    # Each comes first, second and third equally often.
                    for name in (list(series) * 2)[i % 3:i % 3 + 3]:
                        times[name].append(seconds(*series[name]))
                medians = {name: statistics.median(each) for name, each in times.items()}
                return {name: medians[name] / medians["unknown"] for name in ("private", "planted")}

            # A busy machine blurs both: then the measurement is taken again.
            for _ in range(3):
                found = ratios(10_000 if LONG else 2_000)
                print(f"private over unknown {found['private']:.4f}, with 5 % planted {found['planted']:.4f}",
                      file=sys.stderr)
                if abs(found["private"] - 1) < 0.02 < found["planted"] - 1:
                    return
        self.fail(f"{found}")

    # ---- administration

    def test_an_administrator_lists_and_ends_connections(self):
        idle = SecureClient(self.raynest, self.daemon.tls, self.certificates.ca, self.secrets["bob"])
        self.says(idle.run("load", "builtin:terrain?size=64", "--name", "busy"), 0)
        busy = idle.start("render", "busy", "--size", "4096x4096", "--traversal", "reference", "-o",
                          self.out / "never.png")
        self.addCleanup(busy.communicate)
        self.addCleanup(busy.kill)
        root = self.client("root")

        def rows():
            return [row for row in root.json("admin", "connections")["connections"]
                    if row["principal"] == "bob" and row["jobs"]]
        row = until(rows)[0]
        self.assertEqual((row["role"], row["transport"], row["peer"]), ("user", "tls", "127.0.0.1"))
        looks = root.json("top", "--once")["principals"]
        bob, = (use for use in looks if use["principal"] == "bob")
        self.assertEqual((bob["role"], bob["jobs"], bob["scenes"]), ("user", 1, 1))
        self.assertGreaterEqual(bob["connections"], 1)
        self.assertIn("PRINCIPAL", root.run("top", "--once").stdout)
        own, = idle.json("top", "--once")["principals"]
        self.assertEqual((own["principal"], own["connections"]), ("bob", None))
        self.says(root.run("admin", "kick", row["connection"]), 0, "1 connection ended")
        self.assertEqual(busy.wait(PATIENCE), 4)
        self.says(root.run("admin", "kick", "nobody"), 5, "nobody is called 'nobody' here")
        self.says(root.run("admin", "quota", "bob", "jobs=lots"), 2, "not a quota")
        self.says(idle.run("unload", "busy"), 0)

    def test_quotas_come_from_the_token_and_from_administrators(self):
        secret = self.tokens.add("small", "--quota", "rays=100")
        self.addCleanup(self.tokens.revoke, "small")
        client = self.client(secret)
        until(lambda: client.run("load", "builtin:terrain?size=8", "--name", "few").returncode == 0)
        many = ("query", "few", "--generate", "equirectangular", "size=64x32", "-o",
                self.out / "few.npz")
        self.says(client.run(*many), 5, "2048 rays")
        self.says(self.client("root").run("admin", "quota", "small", "rays=1000000"), 0)
        # It counts before the token's, on new connections too, until the daemon ends.
        self.says(client.run(*many), 0)
        self.says(client.run("unload", "few"), 0)

    def test_shares_of_the_cpu_are_of_principals_not_of_connections(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--tokens", self.tokens.file, "--threads", "1")
        self.addCleanup(daemon.stop)
        clients = {name: SecureClient(self.raynest, daemon.uri, None, self.secrets[name])
                   for name in ("alice", "bob")}
        self.says(clients["alice"].run("load", "builtin:terrain?size=256", "--name", "hills", "--share", "public"), 0)
        admin = SecureClient(self.raynest, daemon.uri, None, self.secrets["root"])
        for name in ("alice",) * 4 + ("bob",):
            process = clients[name].start("render", "alice/hills", "--integrator", "ao", "--size", "256x256", "--spp", "65536", "-o",
                                          "/dev/null")
            self.addCleanup(process.communicate)
            self.addCleanup(process.kill)

        def made():
            """Samples of each principal, all at one moment; None until each of the five jobs has some."""
            jobs = admin.json("jobs")["jobs"]
            if len(jobs) < 5 or not all(job["done"] for job in jobs):
                return None
            return {name: sum(job["done"] for job in jobs if job["owner"] == name) for name in clients}
        begun = until(made)
        # Some turns bring many samples: of few turns the shares say little.
        ended = until(lambda: (now := made()) and all(now[name] >= begun[name] + 300 for name in now) and now)
        ratio = (ended["bob"] - begun["bob"]) / (ended["alice"] - begun["alice"])
        print(f"one connection of bob has {ratio:.2f} of the samples of alice's four", file=sys.stderr)
        self.assertGreater(ratio, 0.45)  # shares of connections would be a quarter

    def test_bandwidth_is_a_principals_own_over_all_its_connections(self):
        """Two connections of a principal share its bytes per second; another principal is not slowed."""
        rate, size = 500_000, 2_000_000
        secret = self.tokens.add("slow", "--quota", f"second_bytes={rate}")
        self.addCleanup(self.tokens.revoke, "slow")
        slow, fast = self.client(secret), self.client("bob")
        for client in (slow, fast):
            until(lambda: client.run("load", "builtin:terrain?size=8", "--name", "wide").returncode == 0)

        def start(client):
            """Two queries at once, whose answers have 16 bytes a ray."""
            return [client.start("query", "wide", "--generate", "equirectangular", f"size={size // 16 // 100}x100",
                                 "--fields", "t,position", "-o", self.out / f"{client is slow}{i}.npz") for i in range(2)]

        def end(running):
            for process in running:
                said = process.communicate(timeout=PATIENCE)
                self.assertEqual(process.returncode, 0, said)
        begun = time.monotonic()
        slowed = start(slow)
        end(start(fast))
        self.assertEqual([process.poll() for process in slowed], [None, None], "they have bytes to wait for, and the other has none")
        end(slowed)
        # A busy machine makes it longer, and nothing shorter.
        self.assertGreater(time.monotonic() - begun, 2 * size / rate * 0.75)
        for client in (slow, fast):
            self.says(client.run("unload", "wide"), 0)

    def test_the_daemons_own_user_administers_over_the_unix_socket(self):
        local = SecureClient(self.raynest, self.socket)
        told = local.json("admin", "connections")["connections"]
        self.assertTrue(any(row["transport"] == "unix" and row["role"] == "admin" for row in told))
        self.says(local.run("admin", "reload"), 0, "were read again")
        loopback = SecureClient(self.raynest, self.daemon.uri)
        self.says(loopback.run("admin", "connections"), 4, "needs the role admin")
        for wrong in (("kick",), ("reload", "x"), ("dance",)):
            self.says(local.run("admin", *wrong), 2)

    def test_ssh_reaches_the_unix_socket_of_another_machine(self):
        programs = fake_ssh(self.out / "bin", "me@gpu", "2222")
        path = self.socket.removeprefix("unix:")
        client = SecureClient(self.raynest, "tcp://127.0.0.1:1")
        client.environment["PATH"] = f"{programs}:{os.environ['PATH']}"
        self.says(client.run("--server", f"ssh://me@gpu:2222{path}", "admin", "connections"), 0,
                  "unix")
        self.says(client.run("--server", f"ssh://-oProxyCommand=x{path}", "scenes"), 2,
                  "is not ssh://")
        client.environment["PATH"] = str(self.out)
        self.says(client.run("--server", f"ssh://gpu{path}", "scenes"), 3, "cannot start ssh")

    def test_anonymous_clients_get_the_role_of_the_option(self):
        for word, code in (("off", 4), ("viewer", 4), ("user", 0)):
            daemon = SecureDaemon(self.raynestd, self.certificates, "--anonymous", word)
            done = SecureClient(self.raynest, daemon.uri).run("load", "builtin:terrain?size=8")
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertIn({"off": "asks for a token", "viewer": "needs the role user",
                           "user": ""}[word], done.stderr)
            daemon.stop()

    def test_metrics_take_a_token_where_nobody_is_let_in_without_one(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--anonymous", "off", "--tokens",
                              self.tokens.file, "--http", "127.0.0.1:0")
        self.addCleanup(daemon.stop)

        def status(path, token=None):
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            try:
                request = urllib.request.Request(daemon.http + path, headers=headers)
                with urllib.request.urlopen(request, timeout=PATIENCE) as reply:
                    return reply.status
            except urllib.error.HTTPError as error:
                return error.code
        self.assertEqual(status("/metrics"), 401)
        self.assertEqual(status("/metrics", "rnt_1"), 401)
        self.assertEqual(status("/metrics", self.secrets["vera"]), 200)
        self.assertEqual([status(path) for path in ("/healthz", "/readyz")], [200, 200])

    def test_a_drain_ends_the_daemon(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--tokens", self.tokens.file)
        self.says(self.client("root", daemon).run("admin", "drain"), 0)
        self.assertEqual(daemon.process.wait(PATIENCE), 0)
        daemon.folder.cleanup()

    def test_an_administrator_finds_a_place_in_a_full_daemon(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--connections-max", "3",
                              "--give-way-ms", "600000", "--listen", f"unix:{self.out}/reserved")
        self.addCleanup(daemon.stop)
        crowd = [socket.create_connection(("127.0.0.1", int(daemon.uri.rsplit(":", 1)[1])), PATIENCE)
                 for _ in range(2)]
        for connection in crowd:
            self.addCleanup(connection.close)
            connection.sendall(HELLO)
            self.assertEqual(read_frame(connection), WELCOME)
        self.says(SecureClient(self.raynest, daemon.uri).run("scenes"), 6, "--connections-max")
        local = SecureClient(self.raynest, f"unix:{self.out}/reserved")
        self.assertEqual(len(local.json("admin", "connections")["connections"]), 3)
        self.says(local.run("admin", "kick", "127.0.0.1"), 0, "2 connections ended")


if __name__ == "__main__":
    main()
