#!/usr/bin/env python3
"""Tests raynest-load-test: its counts agree with the daemon's, and it reports refusals.

  load_test_test.py RAYNESTD RAYNEST

Rates and times depend on the machine; only counts and orders are asserted.
"""
import json
import signal
import time
import unittest

from daemon import LONG, PATIENCE, Client, Daemon, DaemonTest, load_test_of, main


class LoadTest(DaemonTest):
    loads = {"hills": "builtin:terrain?size=32"}

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.load_test = load_test_of(cls.client)

    def check(self, told):
        for side in ("daemon", "asio_echo", "blocking_echo"):
            row = told[side]
            self.assertGreater(row["requests"], 0, side)
            self.assertEqual((row["refused"], row["missed"]), (0, 0), side)
            self.assertTrue(0 < row["p50_us"] <= row["p99_us"] <= row["p999_us"] <=
                            row["max_us"], row)
            self.assertAlmostEqual(row["rays_per_second"] / row["requests_per_second"],
                                   told["rays"], delta=1e-6 * told["rays"])
            bytes_each = told["request_bytes"] + told["reply_bytes"]
            self.assertAlmostEqual(row["bytes_per_second"] / row["requests_per_second"],
                                   bytes_each, delta=0.05 * bytes_each)
        self.assertGreater(told["ratio_to_asio_echo"], 0)

    def test_a_closed_loop_counts_what_the_daemon_counts(self):
        before = self.client.json("stats")
        told = self.load_test.json("hills", "--clients", "3", "--rays", "100",
                                "--seconds", "0.4")
        after = self.client.json("stats")
        self.check(told)
        self.assertEqual((told["clients"], told["rays"], told["kind"]), (3, 100, "closest"))
        rays = after["rays"] - before["rays"]
        jobs = after["jobs_started"] - before["jobs_started"]
        self.assertEqual(rays, 100 * jobs)
        # The warm-up turn is not in the answer.
        self.assertLess(told["daemon"]["requests"], jobs)
        self.assertEqual(after["jobs_started"], after["jobs_ended"])

    def test_an_open_loop_sends_at_its_rate(self):
        told = self.load_test.json("hills", "--clients", "2", "--rate", "100",
                                "--seconds", "1")
        self.check(told)
        for side in ("daemon", "asio_echo", "blocking_echo"):
            self.assertTrue(90 <= told[side]["requests"] <= 101, told[side])

    @unittest.skipUnless(LONG, "takes seconds; run with --long")
    def test_a_low_rate_holds_from_turn_to_turn(self):
        told = self.load_test.json("hills", "--clients", "2", "--rate", "1",
                                "--seconds", "3")
        for side in ("daemon", "asio_echo", "blocking_echo"):
            self.assertTrue(2 <= told[side]["requests"] <= 4, told[side])
            self.assertLess(told[side]["requests_per_second"], 2, told[side])

    @unittest.skipUnless(LONG, "takes seconds; run with --long")
    def test_a_daemon_that_freezes_is_seen_to_be_late_for_all_that_was_due(self):
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=32", "--name", "hills")
        testing = load_test_of(client).start("--json", "hills", "--clients", "2", "--rate", "200",
                               "--seconds", "3")

        # Freeze the daemon repeatedly, so that some counted turn meets a freeze. Each is shorter
        # than the time that a turn may catch up.
        while testing.poll() is None:
            daemon.process.send_signal(signal.SIGSTOP)
            time.sleep(1)
            daemon.process.send_signal(signal.SIGCONT)
            time.sleep(0.2)
        output, errors = testing.communicate(timeout=PATIENCE)
        self.assertEqual(testing.returncode, 0, errors)
        told = json.loads(output)["daemon"]
        self.assertGreater(told["p99_us"], 500_000)
        self.assertGreaterEqual(told["requests"], 590)
        self.assertEqual(told["missed"], 0)

    @unittest.skipUnless(LONG, "takes seconds; run with --long")
    def test_a_rate_out_of_reach_is_told(self):
        done = self.load_test.run("hills", "--rate", "10000000", "--seconds", "0.1",
                               timeout=2 * PATIENCE)
        self.assertEqual(done.returncode, 0, done.stderr)
        title, *sides, verdict = done.stdout.splitlines()
        self.assertEqual(title.split()[-1], "MISSED")
        for side in sides:
            p50, *_, missed = side.split()[-8:]
            self.assertGreater(float(p50), 1e6, side)  # late by seconds, as long as the test ran
            self.assertTrue(100_000 < int(missed) <= 1_000_000, side)  # 1/10 s of requests
        self.assertRegex(verdict, r"; raynestd answered \d+ of 1e\+07 requests per second: lower")

    def test_over_a_unix_socket_and_with_other_kinds(self):
        client = load_test_of(Client(self.raynest, self.socket))
        self.check(client.json("hills", "--kind", "any", "--seconds", "0.2"))
        self.check(client.json("hills", "--fields", "t,prim", "--rays", "16384",
                               "--seconds", "0.3"))

    def test_a_daemon_that_refuses_everything_is_busy(self):
        done = self.load_test.run("hills", "--seconds", "0.2", "--clients", "2",
                               "--deadline", "0.001", "--rays", "16384",
                               "--traversal", "reference")
        self.assertEqual(done.returncode, 7, done.stderr)
        self.assertIn("deadline", done.stderr)

    def test_the_controls_answer_what_the_daemon_does_and_refuse_nothing(self):
        # With one job at a time, most requests of these clients are refused.
        daemon = Daemon(self.raynestd, "--total-jobs-max", "1")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=32", "--name", "hills")
        told = load_test_of(client).json("hills", "--clients", "32", "--rays", "16384",
                           "--seconds", "0.2")
        for side in ("asio_echo", "blocking_echo"):
            self.assertGreater(told[side]["requests"], 0, told)
            self.assertEqual(told[side]["refused"], 0, told)
        self.assertGreater(told["reply_bytes"], 16384)
        self.assertGreater(told["ratio_to_asio_echo"], 0)

        job = client.json("render", "hills", "--size", "4096x4096", "--traversal", "reference",
                          "--detach")["job"]
        done = load_test_of(client).run("hills", "--clients", "8", "--seconds", "0.2")
        self.assertEqual((done.returncode, done.stdout), (6, ""), done.stderr)
        self.assertRegex(done.stderr, r"\Araynest: all requests were refused: .*\n\Z")
        client.json("cancel", job)

    def test_an_unknown_scene_or_intersector_is_told_at_once(self):
        for words, code in ((("no-such",), 5), (("hills", "--intersector", "no-such"), 5)):
            self.load_test.fails(code, "", *words)

    def test_everything_has_bounds(self):
        for word, value in (("--clients", 0), ("--clients", 1001), ("--rays", 0), ("--rays", 16385), ("--seconds", 0),
                            ("--seconds", "nan"), ("--rate", 0), ("--rate", -3)):
            self.load_test.fails(2, word, "hills", f"{word}={value}")
        self.load_test.fails(2, "SCENE is required")
        self.assertIn("raynest-load-test forest", self.load_test.run("--help").stdout)


if __name__ == "__main__":
    main()
