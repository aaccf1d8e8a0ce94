#!/usr/bin/env python3
"""The CUDA worker of a real daemon: same answers, and what happens when something is amiss.

  worker_test.py RAYNESTD RAYNEST PACK          PACK is the cuda pack over tests/cuda/fake_runtime, which
                                                fails on demand
  worker_test.py RAYNESTD RAYNEST PACK gpu      PACK is the real one: same answers only, for 10^7 rays;
                                                exit code 77 (skipped) where its GPU does not start
"""
import array
import os
import pathlib
import random
import signal
import sys
import tempfile
import time
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "integration"))
from daemon import PATIENCE, Client, Daemon, until  # noqa: E402
from npy import npy  # noqa: E402

RAYS = 70_000  # of a query: more than the 65,536 from which on auto takes a GPU
RAYS_ON_GPU = 1_250_000  # of each of eight
RAYNESTD = RAYNEST = PACK = None


def write_rays(path, seed=1, endless_every=None):
    """Rays from above the built-in forest, of all directions downward, as a .npy of RAYS x 6. Of the endless ones
    the directions are too short to tell a box from another."""
    chance = random.Random(seed)
    values = array.array("f")
    for number in range(RAYS):
        if endless_every and number % endless_every == 0:
            values.extend((5, 5, 5, -1e-45, -1e-45, -1e-45))
            continue
        values.extend((chance.uniform(-20, 20), 30, chance.uniform(-20, 20),
                       chance.gauss(0, 0.4), -1, chance.gauss(0, 0.4)))
    path.write_bytes(npy((RAYS, 6), values.tobytes()))


def children(pid):
    """Process ids of the daemon's children that are device workers."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and b"--device-worker" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except (OSError, IndexError):
            pass
    return found


class CudaTest(unittest.TestCase):
    """A daemon with a fake GPU for each class."""
    environment = {}
    arguments = ("--cuda_retry_ms", "200", "--cuda_retry_ms_max", "1000",
                 "--cuda_call_ms_max", "60000")
    scenes = (("builtin:forest?trees=20", "woods"),)

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="raynest test ")
        cls.out = pathlib.Path(cls.folder.name)
        cls.fault = cls.out / "fault"
        words = [f"{key}={value}" for key, value in cls.environment.items()]
        cls.daemon = Daemon(RAYNESTD, "--threads", "2", "--cuda", PACK, *cls.arguments,
                            under=("env", f"RAYNEST_FAKE_CUDA={cls.fault}", *words))
        cls.client = Client(RAYNEST, cls.daemon.uri)
        for source, name in cls.scenes:
            cls.client.json("load", source, "--name", name)
        cls.rays = cls.out / "rays.npy"
        write_rays(cls.rays)

    @classmethod
    def tearDownClass(cls):
        cls.daemon.stop()
        cls.folder.cleanup()

    def metric(self, name):
        return self.client.json("stats")[name]

    def wait_until_up(self):
        until(lambda: "cuda" in self.client.json("variants")["variants"][0]["targets"],
              self.daemon.log)

    def query(self, worker, *options, scene="woods"):
        """(what the command told, the file's bytes) of RAYS rays."""
        file = self.out / f"{worker}.npz"
        told = self.client.json("query", scene, "--rays", self.rays, "-o", file, "--worker", worker,
                                *options)
        return told, file.read_bytes()

    def refused(self, code, says, *command):
        done = self.client.run(*command)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertIn(says, done.stderr)


class SameAnswers(CudaTest):
    def setUp(self):
        self.wait_until_up()

    def test_queries_are_the_cpus_byte_for_byte(self):
        for options in ((), ("--kind", "any"), ("--kind", "multi", "--max-hits", "5"),
                        ("--intersector", "opaque"), ("--precision", "fast"),
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
                self.assertGreaterEqual(self.metric("cuda_calls") - calls, RAYS // 16384)
                self.assertEqual(ours, theirs)

    def test_pictures_and_cameras_are_the_cpus_byte_for_byte(self):
        for command, ending in ((("render",), "png"), (("render",), "exr")):
            with self.subTest(command=command, ending=ending):
                files = {}
                for worker in ("cpu", "cuda"):
                    file = self.out / f"{worker}.{ending}"
                    told = self.client.json(*command, "woods", "-o", file, "--size", "333x217",
                                            "--worker", worker)
                    self.assertEqual(told["worker"], worker)
                    files[worker] = file.read_bytes()
                self.assertEqual(files["cpu"], files["cuda"])
        for options in (("--generate", "pinhole", "size=301x221", "fx=180"),
                        ("--generate", "camera", "size=301x221"),
                        ("--generate", "equirectangular", "size=400x200")):
            with self.subTest(options=options):
                answers = []
                for worker in ("cpu", "cuda"):
                    file = self.out / f"{worker}.npz"
                    told = self.client.json("query", "woods", *options, "-o", file, "--worker", worker)
                    self.assertEqual(told["worker"], worker)
                    answers.append(file.read_bytes())
                self.assertEqual(*answers)

    def test_auto_follows_its_rule_and_says_why(self):
        told, _ = self.query("auto")
        self.assertEqual((told["worker"], told["worker_reason"]), ("cuda", "cuda: at least 65536 rays"))
        for options, reason in ((("--size", "64x64"), "fewer than 65536 rays"),
                                (("--size", "640x480", "--traversal", "batch"),
                                 "traversal batch is the CPU's")):
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


class FaultTest(CudaTest):
    soon = ("--cuda_retry_ms", "200", "--cuda_retry_ms_max", "200")
    arguments = (*soon, "--cuda_call_ms_max", "60000")

    def setUp(self):
        self.wait_until_up()
        # So that the scene counts as one that does no harm.
        until(lambda: self.query("auto")[0]["worker"] == "cuda", self.daemon.log)

    def inject(self, fault):
        # In one step, so that it is never read half.
        draft = self.out / "draft"
        draft.write_text(fault)
        draft.rename(self.fault)


class Faults(FaultTest):
    """Each fault hits a job half way; the next process is sound."""
    # What is injected, and what the reply says of it.
    FAULTS = (
        ("cudaLaunchKernel 719", "cudaErrorLaunchFailure"),
        ("cudaStreamSynchronize 700", "cudaErrorIllegalAddress"),
        ("cudaMemcpyAsync 700", "cudaErrorIllegalAddress"),
        ("cudaMemcpyAsync(back) garbage", "answers that cannot be"),
        ("cudaLaunchKernel kill", "was ended by a signal (Killed)"),
    )

    def test_a_job_ends_with_the_same_bytes_and_a_note(self):
        _, expected = self.query("cpu", "--kind", "any")
        for fault, says in self.FAULTS:
            with self.subTest(fault=fault):
                self.wait_until_up()
                faults, starts = self.metric("cuda_faults"), self.metric("cuda_starts")
                self.inject(fault)
                told, answer = self.query("auto", "--kind", "any")
                self.assertFalse(self.fault.exists(), "the fault was not met")
                self.assertEqual(answer, expected)
                self.assertIn(told["worker"], ("mixed", "cpu"))
                self.assertEqual((told["worker_reason"], len(told["notes"])), ("", 1))
                self.assertIn("fell back to the CPU, with the same answers", told["notes"][0])
                self.assertIn(says, told["notes"][0])
                self.assertEqual(self.metric("cuda_faults"), faults + 1)
                self.wait_until_up()
                self.assertEqual(self.metric("cuda_starts"), starts + 1)
                told, answer = self.query("auto", "--kind", "any")
                self.assertEqual((told["worker"], told["notes"], answer), ("cuda", [], expected))

    def test_where_cuda_was_demanded_it_is_an_error_to_try_again(self):
        self.inject("cudaLaunchKernel 700")
        self.refused(6, "cudaErrorIllegalAddress", "render", "woods", "-o", self.out / "x.png",
                     "--worker", "cuda")
        # Meanwhile it is started again.
        done = self.client.run("render", "woods", "-o", self.out / "x.png", "--worker", "cuda")
        self.assertIn(done.returncode, (0, 6), done.stderr)
        self.wait_until_up()
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")

    def test_a_worker_killed_from_outside_comes_back(self):
        _, expected = self.query("cpu")
        workers = children(self.daemon.process.pid)
        self.assertEqual(len(workers), 1)
        os.kill(workers[0], signal.SIGKILL)
        _, answer = self.query("auto")
        self.assertEqual(answer, expected)
        self.wait_until_up()
        self.assertIn("was ended by a signal", self.daemon.log())
        self.assertEqual(len(children(self.daemon.process.pid)), 1)

    def test_a_worker_that_does_not_start_is_started_again(self):
        self.inject("cudaGetDeviceProperties 35")
        os.kill(children(self.daemon.process.pid)[0], signal.SIGKILL)
        self.query("auto")
        self.wait_until_up()
        self.assertIn("cudaErrorInsufficientDriver", self.daemon.log())

    def test_a_scene_that_ends_one_process_after_the_other_is_left_to_the_cpu(self):
        self.client.json("load", "builtin:forest?trees=21", "--name", "bad")
        for _ in range(3):
            self.wait_until_up()
            self.inject("cudaLaunchKernel 719")
            self.query("auto", scene="bad")
            self.assertFalse(self.fault.exists(), "the fault was not met")
        self.wait_until_up()
        told, _ = self.query("auto", scene="bad")
        self.assertEqual(told["worker"], "cpu")
        self.assertIn("cudaErrorLaunchFailure", told["worker_reason"])
        told, _ = self.query("cuda")  # others go on
        self.assertEqual(told["worker"], "cuda")

    def test_many_clients_and_a_fault(self):
        _, expected = self.query("cpu")
        running = []
        for i in range(6):
            file = self.out / f"many{i}.npz"
            running.append((file, self.client.start("--json", "query", "woods", "--rays", self.rays,
                                                    "-o", file)))
        time.sleep(0.2)
        self.inject("cudaMemcpyAsync kill")
        for file, process in running:
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 0, errors)
            self.assertEqual(file.read_bytes(), expected)
        if self.fault.exists():  # they had all ended before it
            self.fault.unlink()


class Hang(FaultTest):
    """A worker that gets no processor for so long is lost, too: there may be more faults than one."""
    arguments = (*FaultTest.soon, "--cuda_call_ms_max", "2000")

    def test_a_job_ends_with_the_same_bytes_and_a_note(self):
        _, expected = self.query("cpu", "--kind", "any")
        faults = self.metric("cuda_faults")
        self.inject("cudaStreamSynchronize hang")
        told, answer = self.query("auto", "--kind", "any")
        self.assertEqual(answer, expected)
        self.assertIn(told["worker"], ("mixed", "cpu"))
        self.assertIn("fell back to the CPU, with the same answers", told["notes"][0])
        self.assertIn("no answer within 2000 ms", told["notes"][0])
        self.assertGreater(self.metric("cuda_faults"), faults)
        until(lambda: not self.fault.exists())
        self.wait_until_up()


class OthersMeanwhile(FaultTest):
    """What the device takes its time for holds up nobody else."""
    arguments = (*FaultTest.soon, "--cuda_call_ms_max", "1000000")

    def test_a_job_of_the_cpu_does_not_wait_for_a_worker_that_stands_still(self):
        worker = children(self.daemon.process.pid)[0]
        os.kill(worker, signal.SIGSTOP)
        waiting = self.client.start("query", "woods", "--rays", self.rays, "-o", self.out / "x.npz")
        until(lambda: [job for job in self.client.json("jobs")["jobs"] if job["kind"] == "query"])
        for _ in range(5):
            self.client.json("render", "woods", "--size", "64x64", "-o", self.out / "x.png",
                             "--worker", "cpu")
        self.assertIsNone(waiting.poll(), "the job on the device was to wait")
        os.kill(worker, signal.SIGKILL)
        _, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual(waiting.returncode, 0, errors)
        self.assertIn("was ended by a signal", errors)

    def test_a_worker_that_ends_while_it_has_nothing_to_do_is_missed(self):
        faults = self.metric("cuda_faults")
        os.kill(children(self.daemon.process.pid)[0], signal.SIGKILL)
        until(lambda: self.metric("cuda_faults") > faults)
        self.wait_until_up()
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")


class HangingStart(CudaTest):
    """That the daemon ends in time nevertheless, tearDownClass sees."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaMemcpy hang"}
    arguments = (*CudaTest.arguments, "--cuda_start_ms_max", "1000000")

    def test_jobs_do_not_wait_for_it(self):
        told, _ = self.query("auto")
        self.assertEqual((told["worker"], told["worker_reason"]), ("cpu", "cpu: it starts"))


class NotPinned(CudaTest):
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaHostRegister 1"}

    def test_it_works_and_says_so(self):
        self.wait_until_up()
        self.assertIn("memory not pinned: cudaErrorUnknown", self.daemon.log())
        told, _ = self.query("cuda")
        self.assertEqual(told["worker"], "cuda")


class LittleMemory(CudaTest):
    """Room for the slots, the probe's scene and one of the two forests, not both."""
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
        # It is remembered for some seconds: a job that comes in time does not try.
        until(lambda: "out of device memory" in self.query("auto", scene="hills")[0]["worker_reason"])
        self.refused(6, "out of device memory", "render", "hills", "-o", self.out / "x.png",
                     "--worker", "cuda")
        # That was no fault of the device.
        self.assertEqual(self.metric("cuda_faults"), 0)
        told, _ = self.query("cuda", scene="woods")
        self.assertEqual(told["worker"], "cuda")


class LongRays(CudaTest):
    """Rays that meet all 9^7 spheres of a scene."""
    scenes = (("builtin:flake?depth=7", "flake"),)

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


class DeepScene(CudaTest):
    scenes = (("builtin:flake?depth=12", "flake"),)

    def test_a_scene_deeper_than_the_device_takes_runs_on_the_cpu(self):
        self.wait_until_up()
        self.assertGreater(self.client.json("info", "flake")["levels"], 8)
        _, expected = self.query("cpu", scene="flake")
        told, answer = self.query("auto", scene="flake")
        self.assertEqual((told["worker"], answer), ("cpu", expected))
        self.assertIn("nested too deep for it: 12 levels, at most 8", told["worker_reason"])
        self.assertEqual(told["notes"], [])  # the scene was not even handed over
        self.refused(5, "nested too deep", "render", "flake", "-o", self.out / "x.png",
                     "--worker", "cuda")


class NeverUp(CudaTest):
    """A device that no process can use: jobs run on the CPU and say why, cuda demanded is refused."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaSetDeviceFlags 35"}
    reason = "cudaErrorInsufficientDriver"
    code = 5  # not to be tried again

    def test_jobs_run_on_the_cpu(self):
        until(lambda: "cuda_down" in self.daemon.log())
        told, _ = self.query("auto")
        self.assertEqual((told["worker"], told["notes"]), ("cpu", []))
        self.assertRegex(told["worker_reason"], f"cpu: .*({self.reason}|it starts)")
        self.refused(self.code, "the CUDA worker: ", "render", "woods", "-o", self.out / "x.png",
                     "--worker", "cuda")
        self.assertEqual(self.metric("cuda_starts"), 0)
        # Said once, however often it is tried.
        self.assertEqual(self.daemon.log().count(self.reason), 1, self.daemon.log())


class NoSlots(NeverUp):
    environment = {"RAYNEST_FAKE_CUDA_MEMORY": 1000}
    reason = "cudaErrorMemoryAllocation"
    code = 6


class WrongAnswers(NeverUp):
    """Its answers are possible, but not the CPU's: rays do not arrive."""
    environment = {"RAYNEST_FAKE_CUDA_ALWAYS": "cudaMemcpyAsync garbage"}
    reason = "are not those of the CPU"
    code = 6


class WrongPack(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.pack = pathlib.Path(folder.name) / "pack.so"

    def render(self, cuda, *options):
        """A daemon with this pack, and what a command of its client came to."""
        daemon = Daemon(RAYNESTD, "--cuda", cuda, "--cuda_start_ms_max", "1000000")
        self.addCleanup(daemon.stop)
        client = Client(RAYNEST, daemon.uri)
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
        self.assertEqual(children(daemon.process.pid), [])


def gpu_starts():
    """Says how it went; a first start translates kernels, which takes its time."""
    daemon = Daemon(RAYNESTD, "--cuda", PACK)
    end = time.monotonic() + max(120, PATIENCE)
    while not any(word in daemon.log() for word in ("cuda_up", "cuda_down")) and time.monotonic() < end:
        time.sleep(0.1)
    print(*(line for line in daemon.log().splitlines() if "cuda_" in line), sep="\n")
    up = "cuda_up" in daemon.log()
    daemon.stop()
    return up


if __name__ == "__main__":
    RAYNESTD, RAYNEST, PACK = sys.argv[1:4]
    on_gpu = sys.argv[4:5] == ["gpu"]
    del sys.argv[1:5 if on_gpu else 4]
    if on_gpu:
        RAYS = RAYS_ON_GPU
        if not gpu_starts():
            sys.exit(77)
    unittest.main(defaultTest="SameAnswers" if on_gpu else None)
