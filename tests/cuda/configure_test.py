#!/usr/bin/env python3
"""Without a working nvcc, RAYNEST_CUDA=AUTO is off with one line that gives the reason, and the
rest is configured; RAYNEST_CUDA=ON is an error with the same reason.

  configure_test.py SOURCE_DIR CMAKE [CMAKE_OPTION...]
"""
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

SOURCE, CMAKE, OPTIONS = "", "", []


class Configured(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest configure ")))

    def configure(self, *options, source=None, **environment):
        return subprocess.run([CMAKE, "-G", "Ninja", "-S", source or SOURCE, "-B", self.folder / "build",
                               "-DRAYNEST_TESTS=OFF", "-DRAYNEST_BENCH=OFF", *OPTIONS, *options],
                              env={**os.environ, **environment}, capture_output=True, text=True, timeout=300,
                              check=False)

    def is_off(self, why, *options, **more):
        done = self.configure(*options, **more)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        said = [line for line in done.stdout.splitlines() if line.startswith("-- CUDA:")]
        self.assertEqual(said, [f"-- CUDA: off, {why}"])
        ninja = (self.folder / "build/build.ninja").read_text()
        self.assertIn("raynest-pack-v3", ninja)
        self.assertNotIn("raynest-pack-cuda", ninja)

        demanded = self.configure("-DRAYNEST_CUDA=ON", *options, **more)
        self.assertNotEqual(demanded.returncode, 0)
        self.assertIn(f"RAYNEST_CUDA=ON, but {why};", " ".join(demanded.stderr.split()))

    def nvcc(self, script):
        """Writes a replacement for nvcc."""
        program = self.folder / "nvcc"
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        return program

    def test_no_nvcc_at_all(self):
        folders = *os.environ["PATH"].split(":"), "/usr/local/cuda/bin", "/usr/local/bin", "/usr/bin", "/bin"
        hidden = {folder for folder in folders if (pathlib.Path(folder) / "nvcc").exists()}
        if "/usr/bin" in hidden:
            self.skipTest("nvcc is beside the compiler and cannot be hidden alone")
        self.is_off("no nvcc found", f"-DCMAKE_IGNORE_PATH={';'.join(hidden)}", CUDA_PATH="")

    def test_an_nvcc_that_is_not_there(self):
        missing = self.folder / "nowhere/nvcc"
        self.is_off(f"{missing} does not exist", f"-DRAYNEST_NVCC={missing}")

    def test_one_of_cuda_11(self):
        old = self.nvcc("echo 'Cuda compilation tools, release 11.8, V11.8.89'")
        self.is_off(f"{old} belongs to CUDA 11.8; C++20 needs 12", f"-DRAYNEST_NVCC={old}")

    def test_one_that_does_not_compile(self):
        broken = self.nvcc("echo 'Cuda compilation tools, release 13.0, V13.0.88'; test $# = 1")
        self.is_off(f"{broken} does not compile", f"-DRAYNEST_NVCC={broken}")

    def test_sources_with_a_comma(self):
        source = self.folder / "sources, mine"
        source.symlink_to(SOURCE)
        self.is_off(f"nvcc rejects commas in a folder's name: {source}",
                    f"-DRAYNEST_NVCC={self.nvcc('exit 0')}", source=source)

    def test_one_that_does_not_start(self):
        broken = self.nvcc("exit 127")
        self.is_off(f"{broken} does not compile", f"-DRAYNEST_NVCC={broken}")


if __name__ == "__main__":
    SOURCE, CMAKE, *OPTIONS = sys.argv[1:]
    unittest.main(argv=sys.argv[:1], verbosity=2)
