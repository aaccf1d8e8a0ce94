#!/usr/bin/env python3
"""Detached jobs: they give what the call would have given, outlive their client, and end when told.

  jobs_test.py RAYNESTD RAYNEST FLATC
"""
import numpy as np

import raynest
from raynest import generators
from daemon import PATIENCE
from with_daemon import FIELDS, WithDaemon, main, rain

# A thousand million rays: minutes of work, in pieces that are soon told to stop.
ENDLESS = generators.hemisphere(np.full((20000, 3), 3.0), [0, 1, 0], samples=65536)


class Jobs(WithDaemon):
    arguments = ("--principal-result-bytes-max", "1G")

    def endless(self):
        job = self.woods.trace(ENDLESS, reduce="hit_fraction", detach=True)
        self.addCleanup(self.forget, job)
        return job

    def forget(self, job):
        try:
            job.cancel()
        except raynest.InvalidError:
            pass

    def test_fetch_gives_the_columns_of_the_call(self):
        rays = rain(50000)
        for options in ({"fields": FIELDS}, {"kind": "any"}, {"kind": "multi", "max_hits": 3},
                        {"kind": "all", "max_hits": 16, "fields": ("t", "flags")},
                        {"kind": "all"},
                        {"reduce": "visible_pixels"}):
            expected = self.woods.trace(rays, **options)
            outcome = self.client.outcome
            job = self.woods.trace(rays, detach=True, **options)
            self.assertIsInstance(job, raynest.Job)
            self.assertIs(job.wait(), job)
            self.assertEqual((job.info["done"], job.info["total"]), (50000, 50000))
            for _ in range(2):  # as often as asked
                news = []
                fetched = job.fetch(progress=lambda *now: news.append(now))
                self.assertTrue(all(done <= total and total for done, total, _ in news), news)
                self.same(fetched, expected)
                self.assertEqual(list(fetched), list(expected))
            for name in ("rays", "hits", "misses", "epoch", "intersector"):
                self.assertEqual(self.client.outcome[name], outcome[name], name)

    def test_fetch_gives_the_columns_of_a_generator(self):
        points = generators.hemisphere(np.zeros((20, 3)) + [0, 3, 0], [0, 1, 0], samples=300)
        for rays, options in ((generators.camera(size=(200, 100)), {}),
                              (points, {"reduce": "hit_fraction"}),
                              (points, {"kind": "any"})):
            self.same(self.woods.trace(rays, detach=True, **options).wait().fetch(),
                      self.woods.trace(rays, **options))

    def test_fetch_gives_the_pixels_of_the_call(self):
        for draw in (self.woods.render, self.woods.heatmap):
            for encode in ("raw", "png"):
                options = {"size": (640, 360), "encode": encode}
                expected, fetched = draw(**options), draw(detach=True, **options).wait().fetch()
                if encode == "raw":
                    self.assertEqual((fetched.shape, fetched.dtype),
                                     (expected.shape, expected.dtype))
                    np.testing.assert_array_equal(fetched, expected)
                else:
                    self.assertEqual(fetched, expected)
        self.assertEqual(self.client.outcome["heat"]["metric"], "total")

    def test_a_job_outlives_its_connection(self):
        rays = rain(30000)
        with raynest.connect(self.daemon.uri) as client:
            number = client.scene("woods").trace(rays, detach=True).number
        job = self.client.job(number).wait(deadline=PATIENCE)
        self.assertEqual(job.info["state"], "done")
        self.same(job.fetch(), self.woods.trace(rays))

    def test_jobs_lists_what_runs_and_what_is_kept(self):
        runs, kept = self.endless(), self.woods.trace(rain(9), detach=True).wait()
        jobs = {job["job"]: job for job in self.client.jobs()}
        self.assertEqual([jobs[job.number]["state"] for job in (runs, kept)], ["running", "done"])
        self.assertEqual(jobs[runs.number]["total"], ENDLESS.count)
        self.assertEqual([jobs[kept.number][name] for name in ("kind", "scene", "detached")],
                         ["query", "woods", True])
        with self.assertRaisesRegex(raynest.BusyError, "not done yet"):
            runs.fetch()

    def test_more_jobs_than_a_page_are_all_listed(self):
        made = [self.woods.trace(rain(1), detach=True).wait() for _ in range(70)]
        listed = [job["job"] for job in self.client.jobs()]
        self.assertEqual(listed, sorted(set(listed)))
        self.assertLessEqual({job.number for job in made}, set(listed))

    def test_a_job_that_is_cancelled_is_gone(self):
        runs, kept = self.endless(), self.woods.trace(rain(9), detach=True).wait()
        runs.cancel()
        kept.cancel()
        for call in (runs.wait, runs.fetch, kept.wait, kept.fetch):
            with self.assertRaisesRegex(raynest.CancelledError, "was cancelled"):
                call()
        for call in (runs.cancel, kept.cancel, lambda: kept.info, lambda: self.client.job(kept.number)):
            with self.assertRaises(raynest.InvalidError) as caught:
                call()
            self.assertEqual((caught.exception.name, caught.exception.exit_code),
                             ("JOB_UNKNOWN", 5))

    def test_the_end_of_a_wait_is_not_the_end_of_its_job(self):
        job = self.endless()
        with self.assertRaisesRegex(raynest.DeadlineError, f"^job {job.number} still runs; wait again"):
            job.wait(deadline=0.1)
        self.assertEqual(job.info["state"], "running")

        class Enough(Exception):
            pass

        def leave(_, total, __):
            raise Enough(total)
        with self.assertRaises(Enough) as left:
            job.wait(progress=leave)
        self.assertEqual(left.exception.args, (ENDLESS.count,))
        self.assertEqual(job.info["state"], "running")
        self.assertFalse(self.client.connection.closed)

    def test_why_a_job_failed_is_raised(self):
        job = self.woods.trace(generators.camera(size=(16384, 4096)), reduce="visible_pixels",
                               detach=True, deadline=0.2)
        for call in (job.wait, job.fetch):
            with self.assertRaises(raynest.DeadlineError) as caught:
                call()
            self.assertEqual(caught.exception.name, "DEADLINE")

    def test_what_cannot_be_detached_is_said(self):
        with self.assertRaisesRegex(raynest.UsageError, "needs rays"):
            self.woods.trace(np.zeros((0, 6)), detach=True)
        with self.assertRaisesRegex(raynest.UsageError, "unheard"):
            self.woods.trace(rain(100_000), fields=("unheard",), detach=True)
        with self.assertRaisesRegex(raynest.BusyError, "--principal-result-bytes-max"):
            self.woods.render(size=(8192, 8192), encode="exr", detach=True)
        with self.assertRaisesRegex(TypeError, "detach"):
            next(self.woods.stream(rain(9), detach=True))
        # A job of another owner is no business of this one, but an administrator's.
        with raynest.connect(self.socket) as other:
            job = other.scene("127.0.0.1/woods").trace(rain(9), detach=True).wait()
            with self.assertRaises((raynest.NotAllowedError, raynest.InvalidError)):
                self.client.job(job.number).fetch()
            job = self.woods.trace(rain(9), detach=True).wait()
            self.assertEqual(other.job(job.number).fetch()["t"].shape, (9,))


if __name__ == "__main__":
    main()
