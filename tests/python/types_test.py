#!/usr/bin/env python3
"""The Python client is typed. Exit code 77 (skipped) where mypy is missing.

  types_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import unittest

from daemon import run_tests

CLIENT = pathlib.Path(__file__).resolve().parents[2] / "client" / "python"


class Types(unittest.TestCase):
    def test_its_types_are_right(self):
        if importlib.util.find_spec("mypy") is None:
            self.skipTest("skipped: there is no mypy")
        with tempfile.TemporaryDirectory() as cache:
            checked = subprocess.run(
                [sys.executable, "-m", "mypy", "--cache-dir", cache, "raynest"], cwd=CLIENT,
                capture_output=True, text=True, check=False)
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)


if __name__ == "__main__":
    del sys.argv[1:4]
    run_tests()
