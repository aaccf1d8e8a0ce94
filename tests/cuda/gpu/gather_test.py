#!/usr/bin/env python3
"""Tests gather.sh and driver.py on a machine without a GPU, on the fake of the CUDA runtime.

  gather_test.py BUILD_DIR FAKE_PACK HAS_CUDA(0|1)

Exit code 77 (skipped) if the build has no CUDA.
"""
import itertools
import json
import math
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "integration"))  # gathered beside the driver
import driver  # noqa: E402
import served  # noqa: E402
sys.path.insert(0, str(HERE.parents[2] / ".ci"))
from lists import Lists  # noqa: E402

BUILD, FAKE = "", ""
BYTES_MAX = 96 << 20
VARIANTS = len(Lists(HERE.parents[2]).intersectors)


def start(*command, **environment):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300, check=False,
                          env={**os.environ, **environment})


def driver_or_c_library(line):
    return re.match(r"\s*(libc|libm|libdl|librt|libpthread|libcuda)\.so", line)


class Gathered(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        cls.out = pathlib.Path(cls.folder.name) / "to the GPU"
        cls.gathered = cls.gather()

    @classmethod
    def gather(cls):
        return start("bash", HERE / "gather.sh", cls.out, RAYNEST_BUILD=BUILD)

    def drive(self, *arguments, **environment):
        """Returns (exit code, rows, stderr)."""
        done = start(sys.executable, self.out / "driver.py", *arguments, **environment)
        return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], done.stderr

    def drive_fake(self, *arguments, **environment):
        return self.drive("--pack", FAKE, *arguments, **environment)

    def test_what_is_gathered_is_small_and_only_into_an_empty_folder(self):
        self.assertEqual(self.gathered.returncode, 0, self.gathered.stdout + self.gathered.stderr)
        files = [file for file in self.out.rglob("*") if file.is_file()]
        self.assertLess(sum(file.stat().st_size for file in files), BYTES_MAX)
        for file in files:
            if file.parent.name == "bin" or ".so" in file.name:
                found = start("ldd", file, LD_LIBRARY_PATH=str(self.out / "lib")).stdout
                for line in found.splitlines():
                    if "=>" in line and not driver_or_c_library(line):
                        self.assertIn(str(self.out), line, file)
        again = self.gather()
        self.assertEqual(again.returncode, 1)
        self.assertIn("is not empty", again.stderr)

    def test_without_a_gpu_one_line_says_so(self):
        code, rows, said = self.drive(CUDA_VISIBLE_DEVICES="")
        self.assertEqual((code, rows), (2, []))
        self.assertRegex(said, r"\Adriver\.py: raynest-bench-cuda: no GPU: cudaError\w+: .+\n\Z")

    def test_the_answers_of_all_variants_are_compared(self):
        code, rows, said = self.drive_fake("--count", "512", "check")
        self.assertEqual((code, said), (0, ""))
        asked = {(row["scene"], row["variant"], row["query"]) for row in rows if row["what"] == "check"}
        scenes = {arena.stem for arena in (self.out / "scenes").glob("*.arena")}
        self.assertEqual(scenes, {"forest", "trees", "trees-flat", "cards", "terrain", "flake"})
        self.assertEqual(len(asked), len(scenes) * VARIANTS * 3)
        verdict = rows[-1]
        self.assertTrue(verdict["passed"])
        self.assertEqual((verdict["differing"], verdict["failures"]), (0, []))
        self.assertEqual(verdict["compared"], 512 * sum(row["what"] == "check" for row in rows))
        self.assertGreater(verdict["hitting"], verdict["compared"] / 3)

    def test_a_copy_that_brings_garbage_is_seen(self):
        code, rows, _ = self.drive_fake("--count", "512", "check",
                                        RAYNEST_FAKE_CUDA_ALWAYS="cudaMemcpyAsync(back) garbage")
        self.assertEqual(code, 1)
        self.assertFalse(rows[-1]["passed"])
        self.assertGreater(rows[-1]["differing"], 0)

    def test_the_answers_of_a_daemon_are_compared(self):
        code, rows, said = self.drive_fake("--count", "1024", "daemon")
        self.assertEqual((code, said), (0, ""))
        compared = [row for row in rows if row["what"] == "daemon"]
        self.assertEqual(len(compared), len(served.SCENES) * VARIANTS * (3 * 3 + 1))
        self.assertEqual({row["count"] for row in compared}, {1024})
        self.assertTrue(all(row["hitting"] > 0 for row in compared), compared)
        verdict = rows[-1]
        self.assertEqual((verdict["differing"], verdict["compared"]), (0, 1024 * len(compared)))
        self.assertGreaterEqual(len(compared) * math.isqrt(driver.SERVED_RAYS) ** 2, 10**7)

    def test_a_wrong_answer_of_a_daemon_is_seen(self):
        fault = self.out.parent / "wrong"
        fault.write_text("cudaMemcpyAsync garbage 27")  # after those of the probe
        code, rows, _ = self.drive_fake("--count", "1024", "daemon", RAYNEST_FAKE_CUDA=str(fault))
        self.assertEqual(code, 1)
        self.assertFalse(fault.exists(), "no call met the fault")
        [wrong] = [row for row in rows if row["what"] == "daemon" and row["differing"]]
        self.assertEqual(wrong["rays"], "sent")
        self.assertFalse(rows[-1]["passed"])

    def test_a_job_that_loses_its_worker_is_told_of(self):
        code, rows, said = self.drive_fake("killed")
        self.assertEqual((code, said), (0, ""))
        [row] = [row for row in rows if row["what"] == "killed"]
        self.assertIn(row["worker"], ("mixed", "cpu"))
        self.assertIn("was ended by a signal (Killed)", row["note"])
        self.assertEqual((row["later"], row["differing"]), ("cuda", 0))

    def test_a_worker_that_does_not_start_fails_its_stages(self):
        code, rows, _ = self.drive_fake("killed", RAYNEST_FAKE_CUDA_ALWAYS="cudaMemcpyAsync garbage")
        self.assertEqual(code, 1)
        [failure] = rows[-1]["failures"]
        self.assertRegex(failure, "killed: the worker does not start: .*not those of the CPU")

    def test_a_kernel_that_fails_ends_its_stage_and_not_the_next(self):
        fault = self.out.parent / "fault"
        fault.write_text("cudaLaunchKernel 719 30")
        code, rows, _ = self.drive_fake("--count", "64", "--rounds", "1", "time", "check",
                                        RAYNEST_FAKE_CUDA=str(fault))
        self.assertEqual(code, 1)
        self.assertFalse(rows[-1]["passed"])
        [failure] = rows[-1]["failures"]
        self.assertRegex(failure, "time: .*starting a call: cudaErrorLaunchFailure")
        self.assertGreater(rows[-1]["compared"], 0)

    def test_times_are_told_for_every_variant(self):
        code, rows, said = self.drive_fake("--count", "256", "--rounds", "2", "time")
        self.assertEqual((code, said), (0, ""))
        times = [row for row in rows if row["what"] == "time"]
        for row in times:
            self.assertEqual(row["device"], "a fake of the tests")
            for number in (row["kernel_mrays"], row["kernel_over_opaque"], row["pinned_over_limit"],
                           row["frames_over_limit"], *row["pinned_mrays"].values(), *row["bus_mrays"].values()):
                self.assertGreater(number, 0)
            if row["variant"] == "opaque":
                self.assertEqual(row["kernel_over_opaque"], 1)
        goals = rows[-1]["goals"]
        self.assertEqual([goal["of"] for goal in goals], [len(times) // VARIANTS, 2 * len(times) // VARIANTS, len(times), len(times)])
        # Times frames of the daemon and larger chunks, each with one, two and four in flight.
        self.assertEqual({way for row in times for way in row["pinned_mrays"]},
                         {f"{slots} x {rays}" for slots in (1, 2, 4) for rays in (1 << 14, 1 << 17)})

    def test_memory_that_is_not_pinned_is_told_and_not_judged(self):
        code, rows, said = self.drive_fake("--count", "256", "--rounds", "1", "check", "time",
                                           RAYNEST_FAKE_CUDA_ALWAYS="cudaHostRegister 1")
        self.assertEqual((code, said), (0, ""))
        for row in rows:
            if row["what"] in ("check", "time"):
                self.assertRegex(row["not_pinned"], "^cudaError")
        self.assertNotIn("over_limit", str(rows[-1]["goals"]))
        self.assertIn("from pinned memory: cudaError", str(rows[-1]["not_measured"]))

    def test_a_goal_is_met_by_the_worst_row(self):
        def judged(*masks):
            rows = [{"what": "time", "scene": "s", "rays": "r", "query": f"q{i}", "variant": "alpha_mask",
                     "kernel_over_opaque": over, "pinned_over_limit": pinned} for i, (over, pinned) in enumerate(masks)]
            return {goal["goal"].split()[0]: (goal["met"], goal["worst"], goal["at"]) for goal in driver.judge(rows)}
        self.assertEqual(judged((1.2, 0.9), (1.3, 0.8)),
                         {"kernel_over_opaque": (True, 1.3, "s r q1 alpha_mask"),
                          "pinned_over_limit": (True, 0.8, "s r q1 alpha_mask")})
        self.assertEqual(judged((1.2, 0.7), (1.4, 0.9)),
                         {"kernel_over_opaque": (False, 1.4, "s r q1 alpha_mask"),
                          "pinned_over_limit": (False, 0.7, "s r q0 alpha_mask")})
        self.assertEqual(judged(), {})

    def test_what_the_machine_lacks_is_skipped_in_words(self):
        code, rows, _ = self.drive_fake("sanitize", PATH=os.defpath)
        skipped = [row for row in rows if "skipped" in row and row["what"] == "sanitize"]
        self.assertEqual(code, 0)
        self.assertEqual(rows[-1]["skipped"], [row["what"] for row in skipped])

    def test_sanitizers_look_at_triangles_and_records_and_at_rays_of_both_kinds(self):
        tool = self.out.parent / "compute-sanitizer"
        tool.write_text('#!/bin/bash\n[[ $1 == --tool && $3 == --error-exitcode ]] && exec "${@:5}"\n')
        tool.chmod(0o755)
        code, rows, said = self.drive_fake("sanitize", PATH=f"{tool.parent}:{os.defpath}")
        self.assertEqual((code, said), (0, ""))
        looked = [(row["tool"], row["scene"], row["rays"]) for row in rows if row["what"] == "sanitize"]
        self.assertEqual(looked, list(itertools.product(("memcheck", "initcheck"), ("trees", "flake"),
                                                        ("random", "camera"))))
        self.assertEqual({row["kernels"] for row in rows if row["what"] == "sanitize"}, {3 * VARIANTS})

    def test_an_unknown_stage_is_refused(self):
        code, _, said = self.drive_fake("profile")
        self.assertEqual(code, 2)
        self.assertIn("there is no stage profile; there are check, sanitize, conformance, daemon, killed, time", said)


if __name__ == "__main__":
    BUILD, FAKE = sys.argv[1:3]
    if sys.argv[3] == "0":
        print("skipped: this build has no CUDA, so there is nothing to gather")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1])
