#!/usr/bin/env python3
"""A bad network under TLS, at bytes of the handshake and of every record: what arrives is right or is an
error, and the daemon releases all of it.

  tls_chaos_test.py RAYNESTD RAYNEST      RAYNEST_CHAOS_SEEDS: conversations, 60 if it is not set
"""
import collections
import os
import pathlib
import random
import sys
import tempfile

from daemon import Programs, is_sanitized, main, until
from link import DOWN, HARMLESS, HARMS, UP, Harm, Link
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens

SEEDS = int(os.environ.get("RAYNEST_CHAOS_SEEDS", "60"))


class TlsChaos(Programs):
    def setUp(self):
        self.out = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.certificates = Certificates(self.raynestd, self.out / "tls")
        self.tokens = Tokens(self.raynestd, self.out / "tokens")
        self.token = self.tokens.add("alice", "--role", "admin")
        self.daemon = SecureDaemon(self.raynestd, self.certificates, "--tokens", self.tokens.file)
        self.addCleanup(self.daemon.stop)
        self.local = SecureClient(self.raynest, self.daemon.tls, self.certificates.ca, self.token)
        self.assertEqual(self.local.run("load", "builtin:terrain?size=16", "--name", "hills").returncode, 0)

    def is_idle(self):
        """True if this question is the only connection, and no job runs."""
        stats = self.local.json("stats")
        return stats["connections_accepted"] == stats["connections_closed"] + 1 and \
            stats["jobs_started"] == stats["jobs_ended"]

    def ask(self, port):
        """A query through a link: its exit code and the bytes of its answer."""
        client = SecureClient(self.raynest, f"tls://127.0.0.1:{port}", self.certificates.ca, self.token)
        done = client.run("query", "hills", "--generate", "equirectangular", "size=60x30", "--fields",
                          "t,prim,position", "--deadline", "5", "-o", self.out / "hits.npz")
        answer = (self.out / "hits.npz").read_bytes() if done.returncode == 0 else b""
        (self.out / "hits.npz").unlink(missing_ok=True)
        return done.returncode, answer, done.stderr

    def test_what_arrives_is_right_or_an_error_and_all_is_released(self):
        with Link(self.daemon.port, record=True) as link:
            code, expected, said = self.ask(link.port)
            self.assertEqual(code, 0, said)
            longest = len(link.seen)
        self.assertGreater(longest, 20_000)
        until(self.is_idle)
        descriptors = self.descriptors()
        chance = random.Random(28)
        harms = collections.Counter()
        for seed in range(SEEDS // 4 if is_sanitized(self.raynestd) else SEEDS):
            kind = HARMS[seed % len(HARMS)]
            direction = UP if chance.random() < 0.4 else DOWN
            # Half of the bytes chosen lie in the handshake and the greeting.
            offset = chance.randrange(900 if direction == UP else 3000 if chance.random() < 0.5 else longest // 2)
            harm = Harm(kind, direction, offset)
            with self.subTest(seed=seed, kind=kind, direction=direction, offset=offset), \
                    Link(self.daemon.port, harm=harm) as link:
                code, answer, said = self.ask(link.port)
                harms[kind, harm.struck] += 1
                if kind in HARMLESS or not harm.struck:
                    self.assertEqual((code, answer), (0, expected), said)
                elif code == 0:
                    self.assertEqual(answer, expected)
                else:
                    self.assertEqual(said.count("\n"), 1, said)
                    self.assertIn(code, (1, 3, 4, 7), said)
                if kind == "flip" and harm.struck:
                    self.assertNotEqual(code, 0)
        print(f"tally: conversations over TLS through a bad network: {sum(harms.values())}: "
              f"{dict(harms)}; everything is released", file=sys.stderr)
        self.assertGreater(sum(count for (_, struck), count in harms.items() if struck), SEEDS // 8)
        until(self.is_idle)
        until(lambda: self.descriptors() <= descriptors)
        self.assertEqual(self.local.run("scenes").returncode, 0)

    def descriptors(self):
        return len(os.listdir(f"/proc/{self.daemon.process.pid}/fd"))


if __name__ == "__main__":
    main()
