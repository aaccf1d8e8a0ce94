#!/usr/bin/env python3
"""Tests the CUDA worker of a real daemon: the same answers, and the behaviour when something fails.

  worker_test.py RAYNESTD RAYNEST PACK          PACK is the cuda pack over tests/cuda/fake_runtime, which
                                                fails on demand
  worker_test.py RAYNESTD RAYNEST PACK gpu      PACK is the real one: same answers only, for 10^7 rays;
                                                exit code 77 (skipped) where there is no GPU
"""
import os
import pathlib
import signal
import sys
import tempfile
import unittest

import cuda_daemon
from cuda_daemon import PROGRAMS, Client, CudaTest, Daemon, device_workers, until, why_no_worker, write_rays

RAYS_ON_GPU = 1_250_000  # rays of each of eight


class SameAnswers(CudaTest):
    """Calls are half as large as usual, so that small pictures take several."""
    arguments = (*CudaTest.arguments, "--cuda-rays-max", "65536")

    def setUp(self):
        self.wait_until_up()

    def test_queries_are_the_cpus_byte_for_byte(self):
        for options in ((), ("--kind", "any"), ("--kind", "multi", "--max-hits", "5"),
                        ("--intersector", "opaque"),
                        ("--intersector", "procedural_mask", "--set", "pattern=noise",
                         "--set", "on=all"),
                        ("--set", "cutoff=0.9", "--set", "cull=back"), ("--mask", "0x1")):
            with self.subTest(options=options):
                told, ours = self.query("cpu", *options)
                self.assertEqual(told["worker"], "cpu")
                calls = self.metric("cuda_calls")
                told, theirs = self.query("cuda", *options)
                self.assertEqual((told["worker"], told["target"], told["notes"]),
                                 ("cuda", "cuda", []))
                self.assertGreater(self.metric("cuda_calls"), calls)
                self.assertEqual(ours, theirs)

    def test_pictures_and_cameras_are_the_cpus_byte_for_byte(self):
        for command, ending in ((("render",), "png"), (("render",), "exr")):
            with self.subTest(command=command, ending=ending):
                files = {}
                for worker in ("cpu", "cuda"):
                    file = self.out / f"{worker}.{ending}"
                    told = self.client.json(*command, "woods", "-o", file, "--size", "167x109",
                                            "--worker", worker)
                    self.assertEqual(told["worker"], worker)
                    files[worker] = file.read_bytes()
                self.assertEqual(files["cpu"], files["cuda"])
        # The last options need several calls, of whole bands of tiles in frames that are not whole.
        for options in (("--generate", "pinhole", "size=151x111", "fx=90"),
                        ("--generate", "camera", "size=151x111"),
                        ("--generate", "equirectangular", "size=200x100"),
                        ("--generate", "camera", "size=320x240"),
                        ("--generate", "camera", "size=2056x40"),
                        ("--generate", "camera", "size=320x240", "--kind", "multi")):
            with self.subTest(options=options):
                answers = []
                for worker in ("cpu", "cuda"):
                    file = self.out / f"{worker}.npz"
                    told = self.client.json("query", "woods", *options, "-o", file, "--worker", worker)
                    self.assertEqual(told["worker"], worker)
                    answers.append(file.read_bytes())
                self.assertEqual(*answers)

    def test_a_call_is_larger_than_a_frame(self):
        for command, size, count in ((("render",), "256x512", 2),
                                     (("query", "--generate", "camera"), "320x480", 3),
                                     (("query", "--reduce", "visible_pixels", "--generate", "camera"),
                                      "256x512", 2)):
            with self.subTest(command=command):
                calls = self.metric("cuda_calls")
                size = ("--size", size) if command == ("render",) else (f"size={size}",)
                self.client.json(command[0], "woods", *command[1:], *size, "--worker", "cuda",
                                 "-o", self.out / ("x.png" if command == ("render",) else "x.npz"))
                self.assertEqual(self.metric("cuda_calls") - calls, count)

    def test_auto_follows_its_rule_and_says_why(self):
        told, _ = self.query("auto")
        self.assertEqual((told["worker"], told["worker_reason"]), ("cuda", "cuda: at least 65536 rays"))
        for options, reason in ((("--size", "64x64"), "fewer than 65536 rays"),
                                (("--size", "640x480", "--traversal", "stream"),
                                 "traversal stream is the CPU's")):
            told = self.client.json("render", "woods", "-o", self.out / "x.png", *options)
            self.assertEqual((told["worker"], told["worker_reason"]), ("cpu", "cpu: " + reason))
        told, _ = self.query("auto", "--kind", "all")
        self.assertEqual(told["worker"], "cpu")
        self.assertIn("no kernel for intersector 'alpha_mask' and query all", told["worker_reason"])
        told = self.client.json("heatmap", "woods", "-o", self.out / "x.png", "--size", "640x480")
        self.assertEqual(told["worker"], "cpu")
        self.assertIn("counters", told["worker_reason"])

    def test_what_only_a_cpu_does_is_refused_where_cuda_was_demanded(self):
        picture = ("-o", self.out / "x.png", "--worker", "cuda")
        self.refused(5, "counters are defined by the CPU's traversal", "heatmap", "woods", *picture)
        self.refused(5, "traversal reference is the CPU's", "render", "woods", *picture,
                     "--traversal", "reference")
        self.refused(5, "no kernel", "query", "woods", "--rays", self.rays, "--kind", "all",
                     "-o", self.out / "x.npz", "--worker", "cuda")
        self.refused(2, "use one of auto, cpu, cuda", "render", "woods", "-o", self.out / "x.png",
                     "--worker", "tpu")

    def test_a_few_rays_go_there_where_it_was_demanded(self):
        ray = ("query", "woods", "--ray", "0.3,1000,0.4,0,-1,0", "--json")
        ours = self.client.run(*ray)
        calls = self.metric("cuda_calls")
        self.assertEqual(self.client.run(*ray, "--worker", "cuda").stdout, ours.stdout)
        self.assertEqual(self.metric("cuda_calls"), calls + 1)


class NotPinned(CudaTest):
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaHostRegister 1"}

    def test_it_works_and_says_so(self):
        self.wait_until_up()
        self.assertIn("memory not pinned: cudaErrorUnknown", self.daemon.log())
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")


class LittleMemory(CudaTest):
    """Memory for the slots, the probe's scene and one of the two forests, but not both."""
    scenes = (("builtin:forest?trees=20", "woods"), ("builtin:forest?trees=20&seed=2", "park"),
              ("builtin:terrain?size=512", "hills"))
    environment = {"RAYNEST_FAKE_CUDA_MEMORY": 64_000_000}

    def test_scenes_take_turns_and_what_never_fits_runs_on_the_cpu(self):
        self.wait_until_up()
        for scene in ("woods", "park", "woods", "park"):
            _, expected = self.query("cpu", scene=scene)
            told, answer = self.query("cuda", scene=scene)
            self.assertEqual((told["worker"], answer), ("cuda", expected), scene)
        _, expected = self.query("cpu", scene="hills")
        told, answer = self.query("auto", scene="hills")
        self.assertEqual((told["worker"], answer), ("cpu", expected))
        self.assertIn("out of device memory (cudaErrorMemoryAllocation", told["notes"][0])
        # The failure is remembered for some seconds: a job within that time does not try.
        until(lambda: "out of device memory" in self.query("auto", scene="hills")[0]["worker_reason"])
        self.refused(6, "out of device memory", "render", "hills", "-o", self.out / "x.png",
                     "--worker", "cuda")
        # Lack of memory is not a fault of the device.
        self.assertEqual(self.metric("cuda_faults"), 0)
        told, _ = self.query("cuda", scene="woods")
        self.assertEqual(told["worker"], "cuda")


class Edits(CudaTest):
    """An edited scene sends the worker what has changed since a scene that it has."""
    scenes = (("builtin:forest?trees=3000", "woods"), ("builtin:forest?trees=3000&seed=2", "park"))

    def setUp(self):
        self.wait_until_up()

    def edit(self, *options):
        self.client.json("edit", "woods", *options)

    def sent(self, scene="woods"):
        """Traces a scene on both, with equal answers. Returns the bytes of scenes that the worker was sent."""
        before = self.metric("cuda_upload_bytes")
        _, expected = self.query("cpu", scene=scene)
        told, answer = self.query("cuda", scene=scene)
        self.assertEqual((told["worker"], told["notes"]), ("cuda", []))
        self.assertEqual(answer, expected)
        return self.metric("cuda_upload_bytes") - before

    def test_what_has_not_changed_is_not_sent_again(self):
        whole = self.client.json("info", "woods")["bytes"]
        self.assertIn(self.sent(), (0, whole))
        self.assertEqual(self.sent(), 0)
        self.edit("--move", "birch-17=0,0,2.5")
        moved = self.sent()
        self.assertTrue(0 < moved < whole / 20, f"{moved} of {whole} bytes")
        # The worker has not seen the scenes between these two.
        for birch in (1, 3, 17):
            self.edit("--move", f"birch-{birch}=0,0,2.5")
        self.edit("--hide", "oak-1*")
        self.assertTrue(0 < self.sent() < whole / 4)
        self.edit("--add", "park=500,0,0")
        self.assertGreater(self.sent(), whole)

    def test_a_new_process_gets_the_whole_scene(self):
        self.sent()
        starts = self.metric("cuda_starts")
        os.kill(device_workers(self.daemon.process.pid)[0], signal.SIGKILL)
        until(lambda: self.metric("cuda_starts") > starts)
        self.wait_until_up()
        self.edit("--move", "birch-3=0,0,1.5")
        self.assertGreaterEqual(self.sent(), self.client.json("info", "woods")["bytes"])


class EditsOfEvictedScenes(Edits):
    """The device has room for one of the forests alone."""
    environment = {"RAYNEST_FAKE_CUDA_MEMORY": 64_000_000}
    scenes = (("builtin:forest?trees=20", "woods"), ("builtin:forest?trees=20&seed=2", "park"))

    def test_what_has_not_changed_is_not_sent_again(self):
        whole = self.client.json("info", "woods")["bytes"]
        self.sent()
        self.assertGreater(self.sent("park"), whole / 2)
        self.edit("--move", "birch-3=0,0,2.5")
        self.assertGreaterEqual(self.sent(), whole)


class LongRays(CudaTest):
    """Rays that meet all 9^7 spheres of a scene."""
    scenes = (*CudaTest.scenes, ("builtin:flake?depth=7", "flake"), ("builtin:flake?depth=8", "blizzard"))

    def test_they_are_the_cpus_and_no_fault_of_the_device(self):
        self.wait_until_up()
        write_rays(self.rays, endless_every=16384)
        for options in ((), ("--kind", "any"), ("--kind", "multi", "--max-hits", "3")):
            with self.subTest(options=options):
                _, expected = self.query("cpu", *options, scene="flake")
                told, answer = self.query("auto", *options, scene="flake")
                self.assertEqual(answer, expected)
                self.assertEqual(told["worker"], "cpu")
                self.assertIn("rays meet too much of the scene for it", told["notes"][0])
        self.refused(5, "rays meet too much of the scene for it", "query", "flake", "--rays",
                     self.rays, "-o", self.out / "x.npz", "--worker", "cuda")
        self.assertEqual(self.metric("cuda_faults"), 0)
        write_rays(self.rays)
        told, _ = self.query("auto", scene="flake")
        self.assertEqual(told["worker"], "cuda")

    def test_once_given_up_they_are_not_in_the_way_of_who_waits_for_the_gpu(self):
        self.wait_until_up()
        many = self.out / "many.npy"
        write_rays(many, endless_every=4096)
        refusals, rays = self.metric("cuda_refusals"), self.metric("rays")
        endless = self.client.start("query", "blizzard", "--rays", many, "-o", self.out / "x.npz",
                                    "--worker", "auto")
        self.addCleanup(endless.communicate)
        self.addCleanup(endless.kill)
        until(lambda: self.metric("cuda_refusals") > refusals + 3)  # as many as the calls in flight
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")
        self.assertEqual(self.metric("rays") - rays, cuda_daemon.RAYS, "the other job has no answer yet")


class DeepScene(CudaTest):
    scenes = (("builtin:flake?depth=12", "flake"),)

    def test_a_scene_deeper_than_the_device_takes_runs_on_the_cpu(self):
        self.wait_until_up()
        self.assertGreater(self.client.json("info", "flake")["levels"], 8)
        _, expected = self.query("cpu", scene="flake")
        told, answer = self.query("auto", scene="flake")
        self.assertEqual((told["worker"], answer), ("cpu", expected))
        self.assertIn("nested too deep for it: 12 levels, at most 8", told["worker_reason"])
        self.assertEqual(told["notes"], [])  # the scene was not even sent to the device
        self.refused(5, "nested too deep", "render", "flake", "-o", self.out / "x.png",
                     "--worker", "cuda")


class NeverUp(CudaTest):
    """A device that no process can use: jobs run on the CPU and give the reason; `cuda` is
    refused."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaSetDeviceFlags 35"}
    reason = "cudaErrorInsufficientDriver"
    code = 5  # not worth a retry

    def test_jobs_run_on_the_cpu(self):
        until(lambda: "cuda_down" in self.daemon.log())
        told, _ = self.query("auto")
        self.assertEqual((told["worker"], told["notes"]), ("cpu", []))
        self.assertRegex(told["worker_reason"], f"cpu: .*({self.reason}|it starts)")
        self.refused(self.code, "the CUDA worker: ", "render", "woods", "-o", self.out / "x.png",
                     "--worker", "cuda")
        self.assertEqual(self.metric("cuda_starts"), 0)
        # The log has it once, however often the worker is tried.
        self.assertEqual(self.daemon.log().count(self.reason), 1, self.daemon.log())


class NoCode(NeverUp):
    """A GPU older than those that the pack is compiled for."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaFuncGetAttributes 209"}
    reason = "cudaErrorNoKernelImageForDevice"


class SmallDaemon(CudaTest):
    """The slots are part of --memory: they leave most of it to scenes and jobs."""
    arguments = (*CudaTest.arguments, "--memory", "96M")

    def test_jobs_run_on_both_with_the_same_bytes(self):
        self.wait_until_up()
        for options in ((), ("--kind", "multi", "--max-hits", "8")):
            _, expected = self.query("cpu", *options)
            told, answer = self.query("cuda", *options)
            self.assertEqual((told["worker"], told["notes"], answer), ("cuda", [], expected))
        self.assertLess(self.metric("memory_used_bytes"), 48 << 20)


class TooSmallDaemon(CudaTest):
    arguments = ("--memory", "48M")
    scenes = (("builtin:flake?depth=1", "woods"),)

    def test_it_has_no_worker_and_says_what_to_do(self):
        until(lambda: "cuda_down" in self.daemon.log())
        told, _ = self.query("auto")
        self.assertEqual(told["worker"], "cpu")
        says = "a call takes 13107200 bytes, more than a quarter of raynestd's --memory; give the daemon four times that"
        self.refused(5, says, "render", "woods", "-o", self.out / "x.png", "--worker", "cuda")
        self.assertIn(says, self.daemon.log())


class NoSlots(NeverUp):
    environment = {"RAYNEST_FAKE_CUDA_MEMORY": 1000}
    reason = "cudaErrorMemoryAllocation"
    code = 6


class WrongAnswers(NeverUp):
    """Its answers are plausible but not the CPU's: rays do not arrive."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaMemcpyAsync garbage"}
    reason = "are not those of the CPU"
    code = 6


class WrongPack(unittest.TestCase):
    def setUp(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.pack = folder / "pack.so"

    def render(self, cuda, *options):
        """Returns a daemon with this pack, and the result of a client's command."""
        daemon = Daemon(PROGRAMS[0], "--cuda", cuda, "--cuda-start-ms-max", "1000000")
        self.addCleanup(daemon.stop)
        client = Client(PROGRAMS[1], daemon.uri)
        client.json("load", "builtin:terrain?size=16", "--name", "hills")
        return daemon, client.run("render", "hills", "-o", self.pack.with_name("x.png"), *options)

    def test_a_file_that_is_no_pack_leaves_the_cpu(self):
        self.pack.write_text("no module")
        daemon, done = self.render(self.pack)
        self.assertEqual(done.returncode, 0, done.stderr)
        until(lambda: "cuda_down" in daemon.log())
        self.assertIn("pack.so", daemon.log())

    def test_a_pipe_is_no_pack(self):
        os.mkfifo(self.pack)
        daemon, _ = self.render(self.pack)
        until(lambda: "cuda_down" in daemon.log())
        self.assertIn("pack.so: it is no regular file", daemon.log())

    def test_off_is_off(self):
        daemon, done = self.render("off", "--worker", "cuda")
        self.assertEqual(done.returncode, 5)
        self.assertIn("this daemon has no CUDA worker", done.stderr)
        self.assertEqual(device_workers(daemon.process.pid), [])


if __name__ == "__main__":
    PROGRAMS[:] = sys.argv[1:4]
    on_gpu = sys.argv[4:5] == ["gpu"]
    del sys.argv[1:5 if on_gpu else 4]
    if on_gpu:
        cuda_daemon.RAYS = RAYS_ON_GPU
        trial = Daemon(PROGRAMS[0], "--cuda", PROGRAMS[2])
        try:
            code = why_no_worker(trial)
        finally:
            trial.stop()
        if code:
            sys.exit(code)
    unittest.main(defaultTest="SameAnswers" if on_gpu else None)
