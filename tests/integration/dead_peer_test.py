#!/usr/bin/env python3
"""A client whose network is gone is found within 20 s, by probes of TCP; one that pauses stays.

  dead_peer_test.py RAYNESTD RAYNEST      needs network namespaces; else skipped
"""
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest

from daemon import PATIENCE, Programs, main, until
from secure_daemon import Certificates, SecureClient, SecureDaemon

HERE = pathlib.Path(__file__).resolve().parent
FOUND_SECONDS = 20
# A client that greets over TLS, says so, and then neither sends nor reads.
IDLE = f"""
import socket, ssl, sys, time
sys.path.insert(0, {str(HERE)!r})
from connections_test import HELLO, read_frame
context = ssl.create_default_context(cafile=sys.argv[2])
plain = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
wrapped = context.wrap_socket(plain, server_hostname="localhost")
wrapped.sendall(HELLO)
read_frame(wrapped)
print("greeted", flush=True)
time.sleep(600)
"""
# Runs its arguments in a network of their own, whose loopback is up.
ALONE = ("unshare", "--map-root-user", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")


def has_namespaces():
    if not all(map(shutil.which, ("unshare", "nsenter", "ip"))):
        return False
    return subprocess.run([*ALONE, "true"], capture_output=True, check=False).returncode == 0


@unittest.skipUnless(has_namespaces(), "no network namespaces here")
class DeadPeer(Programs):
    def test_a_dead_network_is_found_and_a_pause_is_none(self):
        out = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        certificates = Certificates(self.raynestd, out / "tls")
        daemon = SecureDaemon(self.raynestd, certificates, "--listen", f"unix:{out}/socket",
                              "--give-way-ms", "600000", under=ALONE)
        self.addCleanup(daemon.stop)
        inside = ("nsenter", "--target", str(daemon.process.pid), "--user", "--net", "--preserve-credentials")
        admin = SecureClient(self.raynest, f"unix:{out}/socket")

        def greeted():
            rows = admin.json("admin", "connections")["connections"]
            return sum(row["transport"] == "tls" and row["role"] != "" for row in rows)

        idle = subprocess.Popen([*inside, sys.executable, "-c", IDLE, str(daemon.port), str(certificates.ca)],
                                stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})
        self.addCleanup(idle.stdout.close)
        self.addCleanup(idle.wait)
        self.addCleanup(idle.kill)
        self.assertEqual(idle.stdout.readline(), "greeted\n")
        self.assertEqual(greeted(), 1)
        idle.send_signal(signal.SIGSTOP)
        time.sleep(FOUND_SECONDS + 2)
        self.assertEqual(greeted(), 1, "a client that pauses answers probes")
        subprocess.run([*inside, "ip", "link", "set", "lo", "down"], check=True)
        begun = time.monotonic()
        until(lambda: greeted() == 0, patience=FOUND_SECONDS + PATIENCE)
        seconds = time.monotonic() - begun
        print(f"a dead network was found after {seconds:.1f} s", file=sys.stderr)
        self.assertLess(seconds, FOUND_SECONDS)
        self.assertGreater(seconds, 5)


if __name__ == "__main__":
    main()
