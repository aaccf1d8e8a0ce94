#!/usr/bin/env python3
"""Tests a daemon whose GPU fails half way: the same bytes, a note, and a new worker.

  faults_test.py RAYNESTD RAYNEST PACK      PACK is the cuda pack over tests/cuda/fake_runtime

Ends with a table of the faults.
"""
import array
import collections
import concurrent.futures
import itertools
import json
import os
import re
import signal
import sys
import time
import unittest

from cuda_daemon import (FRAME, PATIENCE, PROGRAMS, RAYS, CudaTest, device_workers, npy, until,
                         write_rays)

TALLY = collections.defaultdict(lambda: [0, 0, 0])  # jobs, chunks traced again, differing bytes
SOON = ("--cuda-retry-ms", "200", "--cuda-retry-ms-max", "200")
DEVICE_CALLS = 4  # calls in flight
SMALL_CALLS = ("--cuda-rays-max", str(FRAME))


class FaultTest(CudaTest):
    """Each fault has a scene of its own: a scene that ends three processes is left to the CPU."""
    arguments = (*SOON, *SMALL_CALLS, "--cuda-call-ms-max", "60000")
    seeds = itertools.count(100)

    def setUp(self):
        self.wait_until_up()

    def fresh_scene(self):
        scene = f"woods{next(self.seeds)}"
        self.client.json("load", f"builtin:forest?trees=5&seed={scene[5:]}", "--name", scene)
        return scene

    def survive(self, fault, says, *options):
        """Runs a job that meets the fault: its answer is the CPU's, and a note gives the reason."""
        scene = self.fresh_scene()
        _, expected = self.query("cpu", *options, scene=scene)
        self.wait_until_up()
        self.inject(fault)
        told, answer = self.query("auto", *options, scene=scene)
        self.assertFalse(self.fault.exists(), "no call met the fault")
        different = sum(a != b for a, b in zip(answer, expected)) + abs(len(answer) - len(expected))
        self.assertEqual((told["worker_reason"], len(told["notes"])), ("", 1), told)
        again, chunks = self.fallen_back(told)
        self.assertEqual(told["worker"], "cpu" if again == chunks else "mixed")
        if SMALL_CALLS[0] in self.arguments:
            self.assertEqual(chunks, -(-RAYS // FRAME))
        self.assertIn(says, told["notes"][0])
        tally = TALLY[fault]
        tally[:] = tally[0] + 1, tally[1] + again, tally[2] + different
        self.assertEqual(different, 0)
        return scene, answer

    def fallen_back(self, told):
        """Returns (chunks that fell back, chunks) from the job's note."""
        return tuple(map(int, re.match(r"(\d+) of (\d+) chunks fell back to the CPU, with the same answers",
                                       told["notes"][0]).groups()))


class Faults(FaultTest):
    """Each fault hits a job half way; the next process works."""
    # A fault to inject, and the text of the reply.
    FAULTS = (
        ("cudaLaunchKernel 719 3", "cudaErrorLaunchFailure"),
        ("cudaStreamSynchronize 700 3", "cudaErrorIllegalAddress"),
        ("cudaMemcpyAsync 700 3", "cudaErrorIllegalAddress"),
        ("cudaMemcpyAsync(back) garbage 3", "hits that are impossible"),
        ("cudaLaunchKernel kill 3", "was ended by a signal (Killed)"),
    )
    KINDS = (("--kind", "any"), (), ("--kind", "multi", "--max-hits", "3"))
    # Each fault with one kind of query, and one fault with all kinds.
    CASES = (*zip(FAULTS, itertools.cycle(KINDS)), (FAULTS[3], KINDS[1]), (FAULTS[3], KINDS[2]))

    def test_a_job_ends_with_the_same_bytes_and_a_note(self):
        for (fault, says), kind in self.CASES:
            with self.subTest(fault=fault, kind=kind):
                self.wait_until_up()
                faults, starts = self.metric("cuda_faults"), self.metric("cuda_starts")
                scene, answer = self.survive(fault, says, *kind)
                self.assertEqual(self.metric("cuda_faults"), faults + 1)
                self.wait_until_up()
                self.assertEqual(self.metric("cuda_starts"), starts + 1)
                told, again = self.query("auto", *kind, scene=scene)
                self.assertEqual((told["worker"], told["notes"], again), ("cuda", [], answer))

    def test_so_does_one_whose_scene_does_not_get_there(self):
        for fault, says in (("cudaMemcpy 700 3", "cudaErrorIllegalAddress"),
                            ("cudaMalloc kill 3", "was ended by a signal (Killed)")):
            with self.subTest(fault=fault):
                faults = self.metric("cuda_faults")
                self.survive(fault, says)
                self.assertEqual(self.metric("cuda_faults"), faults + 1)
                self.wait_until_up()

    def test_a_picture_does(self):
        for scene in (self.fresh_scene(), self.fresh_scene()):
            files = []
            for worker in ("cpu", "auto"):
                self.wait_until_up()
                if worker == "auto":
                    self.inject("cudaLaunchKernel 719 6")  # two launches per call
                files.append(self.out / f"{worker}.png")
                told = self.client.json("render", scene, "-o", files[-1], "--size", "400x300",
                                        "--worker", worker)
            self.assertIn("cudaErrorLaunchFailure", told["notes"][0])
            self.assertEqual(files[0].read_bytes(), files[1].read_bytes())

    def test_so_do_rays_that_the_daemon_makes(self):
        points = self.out / "points.npy"
        points.write_bytes(npy((8, 6), array.array("f", (0, 9, 0, 0, -1, 0) * 8).tobytes()))
        for options, fault in (
                (("camera", "size=400x300", "--fields", "t,position,direction"), "cudaLaunchKernel 719 6"),
                (("camera", "size=400x300", "--reduce", "visible_pixels"), "cudaLaunchKernel 719 6"),
                (("equirectangular", "size=400x200", "--fields", "t,ng"), "cudaLaunchKernel 719 3"),
                # A point's rays are several calls.
                (("hemisphere", f"points={points}", "samples=40000", "--reduce", "hit_fraction"),
                 "cudaLaunchKernel 719 3")):
            with self.subTest(options=options):
                scene = self.fresh_scene()
                answers = []
                for worker in ("cpu", "auto"):
                    self.wait_until_up()
                    if worker == "auto":
                        self.inject(fault)
                    file = self.out / f"{worker}.npz"
                    told = self.client.json("query", scene, "--generate", *options, "-o", file, "--worker",
                                            worker)
                    answers.append(file.read_bytes())
                self.assertIn("cudaErrorLaunchFailure", told["notes"][0])
                self.assertEqual(*answers)

    def test_where_cuda_was_demanded_it_is_an_error_to_try_again(self):
        scene = self.fresh_scene()
        self.inject("cudaLaunchKernel 700")
        render = ("render", scene, "-o", self.out / "x.png", "--worker", "cuda")
        self.refused(6, "cudaErrorIllegalAddress", *render)
        # Meanwhile the worker is started again.
        done = self.client.run(*render)
        self.assertIn(done.returncode, (0, 6), done.stderr)
        self.wait_until_up()
        told, _ = self.query("cuda", scene=scene)
        self.assertEqual(told["worker"], "cuda")

    def test_a_worker_killed_from_outside_comes_back(self):
        scene = self.fresh_scene()
        _, expected = self.query("cpu", scene=scene)
        workers = device_workers(self.daemon.process.pid)
        self.assertEqual(len(workers), 1)
        os.kill(workers[0], signal.SIGKILL)
        _, answer = self.query("auto", scene=scene)
        self.assertEqual(answer, expected)
        self.wait_until_up()
        self.assertIn("was ended by a signal", self.daemon.log())
        self.assertEqual(len(device_workers(self.daemon.process.pid)), 1)

    def test_a_worker_that_does_not_start_is_started_again(self):
        self.inject("cudaGetDeviceProperties 35")
        os.kill(device_workers(self.daemon.process.pid)[0], signal.SIGKILL)
        self.query("auto")
        self.wait_until_up()
        self.assertIn("cudaErrorInsufficientDriver", self.daemon.log())

    def test_a_scene_that_ends_one_process_after_the_other_is_left_to_the_cpu(self):
        """Most of its chunks do no harm."""
        bad = self.fresh_scene()
        for _ in range(3):
            self.wait_until_up()
            told, _ = self.query("auto", scene=bad)
            self.assertEqual(told["worker"], "cuda")
            self.inject("cudaLaunchKernel 719 3")
            self.query("auto", scene=bad)
            self.assertFalse(self.fault.exists(), "no call met the fault")
        self.wait_until_up()
        told, _ = self.query("auto", scene=bad)
        self.assertEqual(told["worker"], "cpu")
        self.assertIn("cudaErrorLaunchFailure", told["worker_reason"])
        told, _ = self.query("cuda")  # others go on
        self.assertEqual(told["worker"], "cuda")

    def test_many_clients_and_a_fault(self):
        scene = self.fresh_scene()
        _, expected = self.query("cpu", scene=scene)
        running = []
        for i in range(6):
            file = self.out / f"many{i}.npz"
            running.append((file, self.client.start("--json", "query", scene, "--rays", self.rays,
                                                    "-o", file)))
        time.sleep(0.2)
        self.inject("cudaMemcpyAsync kill")
        for file, process in running:
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 0, errors)
            self.assertEqual(file.read_bytes(), expected)
        if self.fault.exists():  # all jobs ended before the fault
            self.fault.unlink()


class LargeCalls(FaultTest):
    """Waiting frames go in one call, and all of them are traced again."""
    arguments = (*SOON, "--cuda-call-ms-max", "60000")

    def test_a_call_of_many_frames_ends_with_the_same_bytes_and_a_note(self):
        write_rays(self.rays, copies=3)
        rays = 3 * RAYS
        scene = self.fresh_scene()
        _, expected = self.query("cpu", scene=scene)
        before = self.metric("bytes_received")
        self.inject("cudaMalloc hold")  # the first calls wait for the scene
        file = self.out / "auto.npz"
        running = self.client.start("--json", "query", scene, "--rays", self.rays, "-o", file, "--worker", "auto")
        until(lambda: self.metric("bytes_received") - before > 24 * rays)
        self.inject(f"cudaLaunchKernel 719 {DEVICE_CALLS + 3}")  # after the waiting calls
        output, errors = running.communicate(timeout=PATIENCE)
        self.assertEqual(running.returncode, 0, errors)
        again, chunks = self.fallen_back(json.loads(output))
        self.assertGreater(again, 1)
        self.assertLessEqual(chunks, -(-rays // FRAME))
        self.assertEqual(file.read_bytes(), expected)


class Hang(FaultTest):
    """A worker that gets no processor time for so long is lost, too, so there may be more faults
    than one."""
    arguments = (*SOON, *SMALL_CALLS, "--cuda-call-ms-max", "5000")

    def test_a_job_ends_with_the_same_bytes_and_a_note(self):
        for call in ("cudaStreamSynchronize", "cudaLaunchKernel", "cudaMemcpyAsync"):
            with self.subTest(call=call):
                faults = self.metric("cuda_faults")
                self.survive(f"{call} hang 3", "no answer within 5000 ms")
                self.assertGreater(self.metric("cuda_faults"), faults)
                self.wait_until_up()


class HangingLoad(FaultTest):
    """Loading may take the time of a call plus the time for its bytes; a job's deadline waits
    for it."""
    arguments = (*SOON, *SMALL_CALLS, "--cuda-call-ms-max", "5000", "--cuda-start-ms-max", "600000")

    def test_a_job_ends_with_the_same_bytes_and_a_note(self):
        self.survive("cudaMemcpy hang 3", "no answer within 5")


class OutOfMemory(FaultTest):
    """Running out of memory, for a launch or on the host, is not a fault of the device."""

    def drop(self, scene):
        self.inject("cudaLaunchKernel 2")
        told, answer = self.query("auto", scene=scene)
        self.assertFalse(self.fault.exists(), "no call met the fault")
        return told, answer

    def is_resident(self, scene):
        """Checks whether a scene is traced without being loaded first. If not, it is lost."""
        self.inject("cudaMalloc 700")
        told, _ = self.query("auto", scene=scene)
        if there := self.fault.exists():
            self.fault.unlink()
            self.assertEqual(told["worker"], "cuda")
        return there

    def test_a_launch_without_memory_drives_out_what_is_idle_and_is_made_again(self):
        _, expected = self.query("cpu")
        other = self.fresh_scene()
        for scene in (other, "woods"):
            self.query("cuda", scene=scene)
        faults = self.metric("cuda_faults")
        for driven_out in range(8):
            told, answer = self.drop("woods")
            self.assertEqual(answer, expected)
            if told["notes"]:  # nothing is left to evict
                break
            self.assertEqual(told["worker"], "cuda")
        self.assertGreaterEqual(driven_out, 2)  # the scene of the probe, and the other one
        self.assertIn(told["worker"], ("cpu", "mixed"))
        self.assertIn("out of device memory (cudaErrorMemoryAllocation", told["notes"][0])
        self.assertEqual(self.metric("cuda_faults"), faults)
        self.assertFalse(self.is_resident(other))

    def test_a_host_without_memory_drives_out_nothing(self):
        self.wait_until_up()
        there = self.fresh_scene()
        self.query("cuda", scene=there)
        faults = self.metric("cuda_faults")
        self.survive("cudaMalloc throw", "the host has no memory left")
        self.assertEqual(self.metric("cuda_faults"), faults)
        self.assertTrue(self.is_resident(there))


class OthersMeanwhile(FaultTest):
    """A slow device delays only the jobs that use it."""
    arguments = (*SOON, "--cuda-call-ms-max", "1000000")

    def test_a_job_of_the_cpu_does_not_wait_for_a_worker_that_stands_still(self):
        worker = device_workers(self.daemon.process.pid)[0]
        os.kill(worker, signal.SIGSTOP)
        waiting = self.client.start("query", "woods", "--rays", self.rays, "-o", self.out / "x.npz")
        until(lambda: [job for job in self.client.json("jobs")["jobs"] if job["kind"] == "query"])
        for _ in range(5):
            self.client.json("render", "woods", "--size", "64x64", "-o", self.out / "x.png",
                             "--worker", "cpu")
        self.assertIsNone(waiting.poll(), "the job on the device should wait")
        os.kill(worker, signal.SIGKILL)
        _, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual(waiting.returncode, 0, errors)
        self.assertIn("was ended by a signal", errors)

    def test_a_worker_that_ends_while_it_has_nothing_to_do_is_missed(self):
        faults = self.metric("cuda_faults")
        os.kill(device_workers(self.daemon.process.pid)[0], signal.SIGKILL)
        until(lambda: self.metric("cuda_faults") > faults)
        self.wait_until_up()
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")


class OthersOnTheWay(FaultTest):
    """While a scene loads, calls of others go on, and a call that waits for its turn does not
    wait for ever."""
    arguments = (*SOON, *SMALL_CALLS, "--cuda-call-ms-max", "8000")

    @unittest.skipIf("RAYNEST_PATIENCE" in os.environ,
                     "with sanitizers a query takes longer than the difference of the two timeouts")
    def test_calls_go_on_and_who_waits_for_too_long_goes_to_the_cpu(self):
        scene = self.fresh_scene()
        _, expected = self.query("cpu", scene=scene)
        # Loading 280 MB may take four seconds longer than loading a few.
        self.client.json("load", "builtin:terrain?size=1448", "--build", "fast", "--name", "hills")
        self.query("cuda")
        faults = self.metric("cuda_faults")
        self.inject("cudaMalloc hold")
        first = self.client.start("query", "hills", "--rays", self.rays, "-o", self.out / "x.npz")
        until(lambda: [job for job in self.client.json("jobs")["jobs"] if job["kind"] == "query"])
        # Submit it at once, so that its own timeout ends well before that of the loading scene.
        with concurrent.futures.ThreadPoolExecutor(1) as thread:
            waiting = thread.submit(self.query, "auto", scene=scene)
            told, _ = self.query("cuda")
            self.assertEqual((told["worker"], first.poll()), ("cuda", None))
            told, answer = waiting.result()
        self.assertIn("other scenes are being uploaded to it", told["notes"][0])
        self.assertEqual((answer, first.poll()), (expected, None))
        self.fault.unlink()
        _, errors = first.communicate(timeout=PATIENCE)
        self.assertEqual((first.returncode, self.metric("cuda_faults")), (0, faults), errors)


class Breaker(CudaTest):
    """A device in another process's exclusive use may be free later."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaSetDevice 46"}
    arguments = ("--cuda-retry-ms", "50", "--cuda-retry-ms-max", "300", "--log-level", "debug")

    def test_it_is_left_alone_for_twice_as_long_each_time(self):
        def pauses():
            return re.findall(r"cuda_down.*retry_ms=(\d+)", self.daemon.log())
        until(lambda: len(pauses()) >= 5, self.daemon.log)
        self.assertEqual(pauses()[:5], ["50", "100", "200", "300", "300"])
        self.assertIn("cudaErrorDevicesUnavailable", self.daemon.log())
        self.refused(6, "the CUDA worker: ", "render", "woods", "-o", self.out / "x.png", "--worker", "cuda")


def print_tally():
    print("\nfault, the call that meets it     jobs  chunks traced again  bytes that differ")
    for fault, numbers in [*sorted(TALLY.items()), ("all", map(sum, zip(*TALLY.values())))]:
        print("{:<34}{:>4}{:>21}{:>19}".format(fault, *numbers))


if __name__ == "__main__":
    PROGRAMS[:] = sys.argv[1:4]
    del sys.argv[1:4]
    result = unittest.main(exit=False).result
    if TALLY:
        print_tally()
    sys.exit(not result.wasSuccessful())
