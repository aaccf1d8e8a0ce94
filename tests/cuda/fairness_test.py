#!/usr/bin/env python3
"""Tests how jobs share a GPU and leave its queue: counts calls while the fake GPU is held.

  fairness_test.py RAYNESTD RAYNEST PACK      PACK is the cuda pack over tests/cuda/fake_runtime
"""
import signal
import sys
import time
import unittest

from cuda_daemon import FRAME, PATIENCE, PROGRAMS, RAYS, Client, CudaTest, second_principal, until, write_rays

SLOTS = 4  # calls in flight
TASKS = SLOTS + 1  # tasks of one job on the device


class HeldTest(CudaTest):
    def setUp(self):
        self.wait_until_up()
        self.query("cuda")
        self.calls = self.metric("cuda_calls")

    def tearDown(self):
        self.fault.unlink(missing_ok=True)

    def made_calls(self):
        return self.metric("cuda_calls") - self.calls

    def begin(self, client, *arguments):
        """Starts a client whose job waits for the GPU."""
        jobs = len(client.json("jobs")["jobs"])
        process = client.start(*arguments)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        until(lambda: len(client.json("jobs")["jobs"]) > jobs)
        return process

    def render(self, size, *options):
        return ("render", "woods", "--size", size, "-o", self.out / "x.png", "--worker", "cuda", *options)


class Waiting(HeldTest):
    @classmethod
    def setUpClass(cls):
        options, token = second_principal(PROGRAMS[0], cls.addClassCleanup)
        cls.arguments = (*CudaTest.arguments, "--cuda-rays-max", str(FRAME), *options)
        super().setUpClass()
        cls.other = Client(PROGRAMS[1], cls.daemon.uri, token)

    def end_early(self, process, code):
        """Checks that a job ends after its started calls; the rest of its 64 calls is never
        made."""
        self.fault.unlink()
        _, errors = process.communicate(timeout=PATIENCE)
        self.assertEqual(process.returncode, code, errors)
        until(lambda: not self.client.json("jobs")["jobs"])
        self.assertLessEqual(self.made_calls(), TASKS)

    def test_a_cancelled_job_makes_no_further_calls(self):
        self.inject("cudaLaunchKernel hold")
        process = self.begin(self.client, *self.render("1024x1024"))
        process.send_signal(signal.SIGINT)
        time.sleep(1)
        self.end_early(process, 130)

    def test_nor_does_one_whose_deadline_passed(self):
        self.inject("cudaLaunchKernel hold")
        process = self.begin(self.client, *self.render("1024x1024", "--deadline", "0.5"))
        process.wait(PATIENCE)  # it is told while its calls are held
        self.end_early(process, 7)

    def test_a_principal_with_many_jobs_does_not_keep_another_waiting(self):
        """60 calls of 12 jobs wait. A principal that asks for 4 has them after about as many of
        the others."""
        self.inject("cudaLaunchKernel hold")
        for _ in range(12):
            self.begin(self.client, *self.render("640x512"))
        one = self.begin(self.other, *self.render("256x256"))
        self.fault.unlink()
        _, errors = one.communicate(timeout=PATIENCE)
        calls = self.made_calls()
        self.assertEqual(one.returncode, 0, errors)
        self.assertLess(calls, 12 * TASKS - SLOTS)


class Gathered(HeldTest):
    def test_frames_that_wait_go_in_one_call(self):
        many = self.out / "many.npy"
        write_rays(many, copies=4)
        frames = 4 * RAYS // FRAME + 1
        files = [self.out / f"{worker}.npz" for worker in ("cpu", "cuda")]
        ask = ("query", "woods", "--rays", many, "--kind", "any")
        self.client.json(*ask, "-o", files[0], "--worker", "cpu")
        self.inject("cudaLaunchKernel hold")
        received = self.metric("bytes_received")
        process = self.begin(self.client, *ask, "-o", files[1], "--worker", "cuda")
        until(lambda: self.metric("bytes_received") - received > (frames - 2) * FRAME * 24)
        self.fault.unlink()
        _, errors = process.communicate(timeout=PATIENCE)
        self.assertEqual(process.returncode, 0, errors)
        self.assertEqual(files[0].read_bytes(), files[1].read_bytes())
        self.assertLess(self.made_calls(), frames - 4)


if __name__ == "__main__":
    PROGRAMS[:] = sys.argv[1:4]
    del sys.argv[1:4]
    unittest.main()
