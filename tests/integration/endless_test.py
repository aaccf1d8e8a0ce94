#!/usr/bin/env python3
"""Tests rays that never end: through 9^16 spheres, with directions too short to tell one box from
another. A client that waits for them may stop waiting, and no other client is delayed.

  endless_test.py RAYNESTD RAYNEST
"""
import signal
import struct

from daemon import Client, Daemon, DaemonTest, PATIENCE, main, until
from npy import npy

ENDLESS = "5,5,5,-1e-45,-1e-45,-1e-45"
SHORT = "5,5,5,-1,-1,-1"
INFINITY = float("inf")


def save_rays(path, count, ray=ENDLESS):
    """Writes a .npy file with this many copies of a ray."""
    x, y, z, *direction = map(float, ray.split(","))
    data = struct.pack("<8f", x, y, z, 0, *direction, INFINITY)
    path.write_bytes(npy((count, 8), data * count))
    return path


def running_jobs(client):
    stats = client.json("stats")
    return stats["jobs_started"] - stats["jobs_ended"]


class Endless(DaemonTest):
    arguments = ("--threads", "2")  # independent of the machine

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.json("load", "builtin:flake?depth=16", "--name", "flake")
        cls.many = save_rays(cls.out / "rays.npy", 66000)

    def begin(self, *arguments):
        process = self.client.start("query", "flake", *arguments, "-o", self.out / "answer.npz")
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        return process

    def wait_for_jobs(self, count, client=None):
        client = client or self.client
        until(lambda: running_jobs(client) == count,
              lambda: f"{running_jobs(client)} jobs run, not {count}")

    def test_a_deadline_is_seen_within_a_ray(self):
        for traversal in ("auto", "single", "stream", "packet", "reference"):
            for kind in ("closest", "any", "multi", "all"):
                if kind in ("multi", "all") and traversal in ("stream", "packet"):
                    continue
                for rays in (("--ray", ENDLESS), ("--rays", self.many)):
                    with self.subTest(traversal=traversal, kind=kind, rays=rays[0]):
                        done = self.client.run("query", "flake", *rays, "--kind", kind, "--traversal",
                                               traversal, "--deadline", "0.1", "-o",
                                               self.out / "answer.npz")
                        self.assertEqual(done.returncode, 7, done.stderr)
                        self.assertIn("deadline", done.stderr)
        self.wait_for_jobs(0)

    def test_interrupting_the_client_ends_the_work(self):
        for rays in (("--ray", ENDLESS), ("--rays", self.many)):
            for how, code in ((signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)):
                with self.subTest(rays=rays[0], how=how):
                    process = self.begin(*rays)
                    self.wait_for_jobs(1)
                    process.send_signal(how)
                    self.assertEqual(process.wait(PATIENCE), code)
                    self.wait_for_jobs(0)

    def test_others_are_served_meanwhile(self):
        # More of them than the daemon has threads. The io thread tries each one first: it answers
        # the short ray, or leaves it to a spare thread.
        endless = [self.begin("--ray", ENDLESS) for _ in range(4)]
        self.wait_for_jobs(4)
        answer = self.client.run("query", "flake", "--ray", SHORT)
        self.assertEqual(answer.returncode, 0, answer.stderr)
        for process in endless:
            self.assertIsNone(process.poll())
            process.send_signal(signal.SIGINT)
        for process in endless:
            self.assertEqual(process.wait(PATIENCE), 130)
        self.wait_for_jobs(0)

    def test_others_are_served_while_whole_chunks_never_end(self):
        usual = {count: save_rays(self.out / f"{count}.npy", count, SHORT) for count in (200, 66000)}
        endless = [self.begin("--rays", self.many) for _ in range(2)]  # these hold all threads
        self.wait_for_jobs(2)
        for count, rays in usual.items():
            told = self.client.json("query", "flake", "--rays", rays, "-o", self.out / "usual.npz")
            self.assertEqual(told["rays"], count)
        for process in endless:
            self.assertIsNone(process.poll())

    def test_who_waits_for_a_thread_need_not_wait_for_it_to_be_told(self):
        few = save_rays(self.out / "few.npy", 200)
        endless = [self.begin("--rays", self.many) for _ in range(2)]  # these hold all threads
        self.wait_for_jobs(2)
        for rays in (few, self.many):
            with self.subTest(rays=rays.name):
                done = self.client.run("query", "flake", "--rays", rays, "--deadline", "0.1", "-o",
                                       self.out / "answer.npz")
                self.assertEqual(done.returncode, 7, done.stderr)
                self.assertIn("the request's deadline passed", done.stderr)  # the daemon's text
                job = self.client.json("query", "flake", "--rays", rays, "--detach")["job"]
                self.assertEqual(self.client.run("cancel", str(job)).returncode, 0)
                self.wait_for_jobs(2)
                process = self.begin("--rays", rays)
                self.wait_for_jobs(3)
                process.send_signal(signal.SIGINT)
                self.assertEqual(process.wait(PATIENCE), 130)
                self.wait_for_jobs(2)
        for process in endless:
            self.assertIsNone(process.poll())

    def test_a_detached_one_is_cancelled(self):
        job = self.client.json("query", "flake", "--rays", self.many, "--detach")["job"]
        self.wait_for_jobs(1)
        self.assertEqual(self.client.run("cancel", str(job)).returncode, 0)
        self.wait_for_jobs(0)

    def test_a_daemon_whose_clients_are_gone_ends_at_once(self):
        daemon = Daemon(self.raynestd)
        try:
            client = Client(self.raynest, daemon.uri)
            client.json("load", "builtin:flake?depth=16", "--name", "flake")
            process = client.start("query", "flake", "--rays", self.many, "-o", self.out / "gone.npz")
            self.wait_for_jobs(1, client)
            process.kill()
            process.communicate()
        finally:
            daemon.stop()

    def test_who_waits_for_a_daemon_that_ends_is_told(self):
        daemon = Daemon(self.raynestd, "--drain-ms-max", "300")
        self.addCleanup(daemon.folder.cleanup)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:flake?depth=16", "--name", "flake")
        waiting = [client.start("query", "flake", "--rays", self.many, "-o", self.out / "told.npz")
                   for _ in range(2)]
        self.wait_for_jobs(2, client)
        daemon.process.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.process.wait(PATIENCE), 3, daemon.log())
        for process in waiting:
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 6, errors)
            self.assertIn("shutting down", errors)

    def test_nobody_holds_a_thread_for_ever(self):
        daemon = Daemon(self.raynestd, "--chunk-ms-max", "200")
        try:
            client = Client(self.raynest, daemon.uri)
            client.json("load", "builtin:flake?depth=16", "--name", "flake")
            for rays in (("--ray", ENDLESS), ("--rays", self.many)):
                done = client.run("query", "flake", *rays, "-o", self.out / "held.npz")
                self.assertEqual(done.returncode, 5, done.stderr)
                self.assertIn("--chunk-ms-max 200", done.stderr)
                self.assertEqual(done.stderr.strip().count("\n"), 0, done.stderr)
        finally:
            daemon.stop()


if __name__ == "__main__":
    main()
