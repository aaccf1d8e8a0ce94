#!/usr/bin/env python3
"""The bench of many hosts at small scale: its tables are whole. No time is asserted.

  hosts_test.py RAYNESTD
"""
import os
import pathlib
import subprocess
import sys
import unittest

HOSTS = pathlib.Path(__file__).resolve().parent / "hosts.py"
PACKAGE = HOSTS.parents[3] / "client/python"
try:
    import distributed  # noqa: F401
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(77)


def lines(*words):
    run = subprocess.run([sys.executable, HOSTS, *words], stdout=subprocess.PIPE, text=True, timeout=300, check=True,
                         env={**os.environ, "PYTHONPATH": str(PACKAGE)})
    return run.stdout.splitlines()


class Hosts(unittest.TestCase):
    def test_the_model_ends_where_its_costs_say(self):
        rows = {int(row[0]): row for row in (line.strip("| ").split(" | ") for line in lines("model")[2:])}
        self.assertEqual(list(rows), [1, 10, 30, 100, 1000, 10000])
        self.assertEqual(rows[1][-1], "nothing")
        # 500 items a second of 1 s each are 500 of 1600 threads.
        self.assertEqual(rows[100][2], "31 %")
        self.assertEqual(rows[10000][4], "19 %")

    def test_it_is_measured_beside_the_model(self):
        rows = lines("points", "8")
        self.assertEqual(sum(row.startswith(f"| {workers} |") for row in rows for workers in (1, 2, 3, 4)), 12)

    def test_a_scene_travels(self):
        rows = lines("scene", RAYNESTD, "2", "20")
        self.assertEqual(len(rows), 3)
        self.assertTrue(all(row.startswith("20 MB to 2 workers: plain ") for row in rows), rows)


if __name__ == "__main__":
    RAYNESTD = sys.argv.pop(1)
    unittest.main()
