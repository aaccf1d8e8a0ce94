#!/usr/bin/env python3
"""The service benchmark at small scale: what it compares, and that both sides answer alike. No time is
asserted.

  service_test.py BIN_DIR
"""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

PAGE = pathlib.Path(__file__).resolve().parent / "page.py"
SERVICE = pathlib.Path(__file__).resolve().parent / "service.py"
BIN_DIR = ""
OPPONENTS = {"sockets": "", "null": "sockets", "sockets_short": "", "null_short": "sockets_short",
             "sockets_fan": "", "null_fan": "sockets_fan", "in_process": "", "service": "in_process",
             "in_process_lidar": "", "service_lidar": "in_process_lidar"}


class Service(unittest.TestCase):
    def test_each_side_is_timed_and_set_against_its_control(self):
        with tempfile.TemporaryDirectory() as folder:
            for transport, options in (("tcp", ()), ("unix", ("--unix", f"{folder}/socket"))):
                with self.subTest(transport=transport):
                    run = subprocess.run(
                        [sys.executable, SERVICE, BIN_DIR, "--json", "--rounds", "1", "--count", "65536",
                         *options], stdout=subprocess.PIPE, text=True, timeout=300, check=True)
                    rows = [json.loads(line) for line in run.stdout.splitlines()]
                    self.assertEqual({(row["scene"], row["rays"]) for row in rows},
                                     {("terrain", "primary"), ("terrain", "diffuse"), ("forest", "diffuse")})
                    for row in rows:
                        self.assertEqual(row["transport"], transport)
                        self.assertEqual(row["against"], OPPONENTS[row["side"]])
                        self.assertEqual("cpu_ratio" in row, row["against"] != "")
                        self.assertGreater(row["cpu_ns_per_ray"], 0)
                    self.assertEqual(len(rows), 3 * len(OPPONENTS))

    def test_each_figure_of_the_page_is_told(self):
        run = subprocess.run([sys.executable, PAGE, BIN_DIR, "--json", "--rounds", "1"],
                             stdout=subprocess.PIPE, text=True, timeout=300, check=True)
        ratios = {row["figure"]: row["ratio"] for row in map(json.loads, run.stdout.splitlines())}
        self.assertEqual(list(ratios), ["first_coarse", "coarse_rays", "orbit", "health"])
        self.assertTrue(all(ratio > 0 for ratio in ratios.values()), ratios)
        self.assertLessEqual(ratios["coarse_rays"], 1)


if __name__ == "__main__":
    BIN_DIR = sys.argv.pop(1)
    unittest.main()
