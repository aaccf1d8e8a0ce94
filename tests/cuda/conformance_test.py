#!/usr/bin/env python3
"""Checks that tests/conformance compares a GPU's answers, whose pack has no reference of its own:
over the fake of the CUDA runtime, with few rays.

  conformance_test.py CONFORMANCE PACK_DIR

Exit code 77 (skipped) if this machine does not run v3.
"""
import os
import re
import subprocess
import sys
import unittest

CONFORMANCE, PACK_DIR = "", ""
INTERSECTOR = "procedural_mask"


def compare(*targets, intersector=INTERSECTOR, **environment):
    """Returns (exit code, output)."""
    *others, tested = targets
    words = [word for target in others for word in ("--against", target)]
    done = subprocess.run([CONFORMANCE, *words, "--target", tested, "--pack-dir", PACK_DIR, "--intersector",
                           intersector, "--rays", "100", "--edge-rays", "1000"],
                          env={**os.environ, **environment}, capture_output=True, text=True, timeout=500, check=False)
    return done.returncode, done.stdout


class Compared(unittest.TestCase):
    def test_it_is_held_to_another_target_s_reference(self):
        code, said = compare("v3", "cuda")
        self.assertEqual(code, 0, said)
        comparisons, hits, differences = map(int, re.search(
            rf"^cuda +{INTERSECTOR} +(\d+) comparisons +\d+ rays +(\d+) hits (\d+) differences", said, re.M).groups())
        self.assertGreater(comparisons, 50)
        self.assertGreater(hits, 100)  # sanitizer builds compare fewer rays
        self.assertEqual(differences, 0)

    def test_a_wrong_answer_is_seen(self):
        code, said = compare("v3", "cuda", RAYNEST_FAKE_CUDA_ALWAYS="cudaMemcpyAsync(back) garbage")
        self.assertEqual(code, 1, said)
        self.assertRegex(said, rf"cuda +{INTERSECTOR} .* [1-9]\d* differences")

    def test_without_such_a_target_it_fails(self):
        for targets in (("cuda",), ("v2", "cuda")):  # v2 rounds differently
            with self.subTest(targets=targets):
                code, said = compare(*targets)
                if "no kernel pack for target v2" in said:
                    self.skipTest("this build has no v2")
                self.assertEqual(code, 1, said)
                self.assertIn("no reference to compare it with", said)
                self.assertIn("target cuda: nothing was compared", said)

    def test_a_named_target_without_the_intersector_fails(self):
        for targets in (("v3", "cuda"), ("v3",)):
            with self.subTest(targets=targets):
                code, said = compare(*targets, intersector="nowhere")
                self.assertEqual(code, 1, said)
                self.assertIn(f"target {targets[-1]}: nothing was compared", said)


if __name__ == "__main__":
    CONFORMANCE, PACK_DIR = sys.argv[1:]
    if compare("v3", intersector="nowhere")[0] == 77:
        print("skipped: this machine does not run v3")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
