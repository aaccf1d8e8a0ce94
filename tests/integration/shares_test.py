"""Checks that a principal that fills a table, queue, pool or budget of the daemon keeps nobody else out.

server/SHARES.md lists them; those that need sockets and processes are here.
"""
import contextlib
import pathlib
import socket
import tempfile
import threading

from daemon import IMPORTS_GROW, PATIENCE, Programs, main, skip_sanitized, until
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens

HEAVY = "builtin:terrain?size=3000"  # many seconds, and more than a GiB, for an import


def children(pid):
    """Returns the process ids of the daemon's import children."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and b"--import-child" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
    return found


def private_bytes(pid):
    """Returns the memory of a process besides its programs and libraries; 0 if it has ended."""
    with contextlib.suppress(OSError):
        for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("RssAnon:"):
                return int(line.split()[1]) * 1024
    return 0


class SharesTest(Programs):
    @classmethod
    def setUpClass(cls):
        out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest-shares-")))
        cls.certificates = Certificates(cls.raynestd, out / "tls")
        cls.tokens = Tokens(cls.raynestd, out / "tokens")
        cls.secrets = {name: cls.tokens.add(name) for name in ("eve", "mallory", "alice")}

    def start(self, *arguments):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--tokens", self.tokens.file, *arguments)
        self.addCleanup(daemon.stop)
        return daemon

    def client(self, daemon, name):
        return SecureClient(self.raynest, daemon.tls, self.certificates.ca, self.secrets[name])

    def ends_well(self, client, *arguments):
        done = client.run(*arguments)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done

    def background(self, client, *arguments):
        """Starts a command that ends with the test."""
        process = client.start(*arguments)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        return process

    def fill(self, client, kind, trees):
        """Loads scenes until one is refused; returns that command."""
        for number in range(100):
            done = client.run("load", f"builtin:forest?trees={trees}&seed={number}", "--name", f"{kind}{number}")
            if done.returncode != 0:
                return done
        return self.fail("all scenes fit")

    def test_users_that_fill_the_memory_with_scenes_stop_nobody_elses_queries_and_loads(self):
        daemon = self.start("--memory", "256M", "--principal-scene-bytes-max", "1000000000000")
        alice = self.client(daemon, "alice")
        for greedy in ("eve", "mallory"):
            refused = self.fill(self.client(daemon, greedy), greedy, 3000)
            self.assertEqual(refused.returncode, 6, refused.stderr)
            self.assertIn("of raynestd's --memory", refused.stderr)
            self.assertIn(f"{greedy} may take now", refused.stderr)
            self.assertIn("raynest unload NAME", refused.stderr)
            self.ends_well(alice, "load", "builtin:flake", "--name", f"of-{greedy}")
            self.ends_well(alice, "query", f"of-{greedy}", "--generate", "equirectangular", "size=100x100")
            self.ends_well(alice, "unload", f"of-{greedy}")

    def test_quotas_of_scenes_and_answers_are_by_default_shares_of_the_memory(self):
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        daemon = self.start("--memory", "256M")
        refused = self.fill(self.client(daemon, "eve"), "quota", 3000)
        self.assertEqual(refused.returncode, 6, refused.stderr)
        self.assertIn("--principal-scene-bytes-max 134217728", refused.stderr)

    def test_users_whose_imports_take_long_keep_nobody_else_from_loading(self):
        daemon = self.start("--memory", "16G")
        for greedy in ("eve", "mallory"):
            for number in range(3):
                self.background(self.client(daemon, greedy), "load", HEAVY, "--name", f"{greedy}{number}")
        until(lambda: len(children(daemon.process.pid)) == 4)
        self.ends_well(self.client(daemon, "alice"), "load", "builtin:flake")
        # None of them had to end for that.
        self.assertEqual(len(children(daemon.process.pid)), 4)

    def test_the_memory_of_imports_counts(self):
        daemon = self.start("--memory", "256M")
        peak, ended = [0], threading.Event()

        def watch():
            while not ended.wait(0.005):
                peak[0] = max(peak[0], sum(map(private_bytes, children(daemon.process.pid))))
        watcher = threading.Thread(target=watch)
        watcher.start()
        self.addCleanup(watcher.join)
        self.addCleanup(ended.set)
        eve = self.client(daemon, "eve")
        loads = [eve.start("load", f"builtin:terrain?size=1800&seed={number}", "--name", f"t{number}")
                 for number in range(2)]
        for load in loads:
            _, errors = load.communicate(timeout=PATIENCE)
            self.assertEqual(load.returncode, 6, errors)
            self.assertIn("of raynestd's --memory", errors)
        self.assertGreater(peak[0], 16 << 20)
        # The daemon looks at a child every millisecond; on a busy machine less often.
        self.assertLess(peak[0], 512 << 20)
        self.assertEqual(eve.json("stats")["memory_used_bytes"], 0)
        self.ends_well(eve, "load", "builtin:flake")

    def test_one_address_full_of_connections_keeps_no_token_out(self):
        daemon = self.start("--principal-connections-max", "6", "--connections-max", "12",
                            "--give-way-ms", "600000")
        host, port = daemon.uri.rsplit("/", 1)[1].split(":")
        crowd = [socket.create_connection((host, int(port)), timeout=PATIENCE) for _ in range(20)]
        for connection in crowd:
            self.addCleanup(connection.close)
        # They send no Hello; those that come later take their places from them.
        self.ends_well(self.client(daemon, "alice"), "scenes")


if __name__ == "__main__":
    main()
