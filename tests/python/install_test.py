#!/usr/bin/env python3
"""The Python client as a package: it installs. Exit code 77 (skipped) where setuptools, wheel or
ensurepip are missing.

  install_test.py RAYNESTD RAYNEST FLATC      (uses none of them)
"""
import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

from daemon import run_tests

CLIENT = pathlib.Path(__file__).resolve().parents[2] / "client" / "python"


class Install(unittest.TestCase):
    def test_it_installs_into_a_virtual_environment(self):
        for module in ("setuptools", "wheel", "ensurepip"):
            if importlib.util.find_spec(module) is None:
                self.skipTest(f"skipped: there is no {module}")
        with tempfile.TemporaryDirectory(prefix="raynest package ") as name:
            folder = pathlib.Path(name)
            # A copy: setuptools builds within the folder.
            shutil.copytree(CLIENT, folder / "source")
            subprocess.run([sys.executable, "-m", "venv", "--system-site-packages",
                            folder / "venv"], check=True)
            python = folder / "venv" / "bin" / "python"
            environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
            subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
                            "--no-build-isolation", folder / "source"], check=True, env=environment)
            program = ("import raynest, raynest.compat.trimesh, pathlib\n"
                       "print(pathlib.Path(raynest.__file__).parent)\n"
                       "print(sorted(path.name for path in "
                       "pathlib.Path(raynest.__file__).parent.iterdir()))")
            said = subprocess.run([python, "-c", program], check=True, env=environment, cwd=folder,
                                  capture_output=True, text=True).stdout.splitlines()
            self.assertIn(str(folder / "venv"), said[0])
            for file in ("messages.fbs", "py.typed"):
                self.assertIn(file, said[1])


if __name__ == "__main__":
    del sys.argv[1:4]
    run_tests()
