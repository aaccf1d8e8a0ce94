#!/usr/bin/env python3
"""The bench of many hosts at small scale: its tables are whole. No time is asserted.

  hosts_test.py RAYNESTD
"""
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree

FOLDER = pathlib.Path(__file__).resolve().parent
PACKAGE = FOLDER.parents[2] / "client/python"
try:
    import distributed  # noqa: F401
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(77)


def lines(*words, program="hosts.py"):
    run = subprocess.run([sys.executable, FOLDER / program, *words], stdout=subprocess.PIPE, text=True, timeout=300, check=True,
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

    def test_the_costs_have_a_row_for_each_request(self):
        rows = lines(RAYNESTD, "1", str(1 << 16), "1", program="cost.py")
        self.assertEqual([row.split(" | ")[0] for row in rows[2:]],
                         ["| made rays, t and prim", "| made rays, visible_pixels", "| sent rays, t and prim", "| path, 1 samples"])
        for row in rows[2:]:
            self.assertGreater(float(row.split(" | ")[2]), 0, row)

    def test_a_stream_is_drawn(self):
        with tempfile.TemporaryDirectory() as folder:
            picture = pathlib.Path(folder) / "stream.svg"
            told, = lines(RAYNESTD, str(picture), "3", "1", program="stream.py")
            self.assertRegex(told, r"^\d+ bars, .*, killed at .*, 0 bytes differ$")
            drawn = xml.etree.ElementTree.parse(picture).getroot()
        texts = [each.text for each in drawn.iter("{http://www.w3.org/2000/svg}text")]
        self.assertLess({"worker 1", "worker 2", "worker 3", "lost with the worker"}, set(texts))


if __name__ == "__main__":
    RAYNESTD = sys.argv.pop(1)
    unittest.main()
