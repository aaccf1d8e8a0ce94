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


if __name__ == "__main__":
    BIN_DIR = sys.argv.pop(1)
    unittest.main()
