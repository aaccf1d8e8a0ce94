#!/usr/bin/env python3
"""raynest-bench-light and light.py on a small scene: each row is there and makes sense.

  light_test.py BIN_DIR
"""
import json
import pathlib
import subprocess
import sys
import unittest

BIN = pathlib.Path(sys.argv[1])
SCENE = "builtin:forest?trees=20"


def rows(*command):
    done = subprocess.run([str(x) for x in command], stdout=subprocess.PIPE, check=True, text=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


class Light(unittest.TestCase):
    def test_each_target_is_compared_with_the_baseline(self):
        found = rows(BIN / "raynest-bench-light", "--scene", SCENE, "--width", 320, "--height", 180, "--tiles", 2,
                     "--spp", 2, "--rounds", 1, "--json")
        self.assertEqual(found[0]["target"], "baseline")
        self.assertGreater(len(found), 1)
        for row in found:
            self.assertGreater(row["rays"], 1024)
            self.assertTrue(0 < row["share"] < 1, row)
            self.assertGreater(row["traversal_over_stream"], 0)
            # Hits of v2 differ in their last bits.
            if row["target"] != "v2":
                self.assertTrue(row["same_bytes_as_first"], row)

    def test_what_a_daemon_shows(self):
        threads, first = rows(sys.executable, pathlib.Path(__file__).parent / "light.py", BIN, SCENE, "--only",
                              "threads,first", "--rounds", 1, "--size", "64x64", "--frame", "128x64", "--spp", 4,
                              "--json")
        self.assertGreater(threads["cpu_of_two_over_one"], 0.2)
        self.assertTrue(0 < first["first_over_whole"] <= 1, first)

    def test_an_unknown_target_is_refused(self):
        done = subprocess.run([BIN / "raynest-bench-light", "--scene", SCENE, "--target", "v9"],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertIn("v9", done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
