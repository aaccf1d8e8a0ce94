#!/usr/bin/env python3
"""The recipes of server/OPERATING.md for many hosts, run as they stand there, but for fewer samples.

  recipes_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

from daemon import Programs, main

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENE = "builtin:forest?trees=20"


class Recipes(Programs):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest recipes ")))
        text = (ROOT / "server/OPERATING.md").read_text()
        self.blocks = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        self.environment = {
            **os.environ, "SCENE": SCENE, "RAYNEST_PYTHON": sys.executable, "PYTHONPATH": str(ROOT / "client/python"),
            "PATH": f"{pathlib.Path(self.raynest).resolve().parent}:{os.environ['PATH']}", "HOME": str(self.folder)}
        self.sh(f"raynest --local render '{SCENE}' --integrator path --spp 1 --size 320x256 -o one.exr")

    def block(self, kind, word):
        found, = [text for language, text in self.blocks if language == kind and word in text]
        return found.replace("--spp 64", "--spp 1")

    def sh(self, script, **more):
        done = subprocess.run(["sh", "-ec", script], cwd=self.folder, env={**self.environment, **more},
                              stdin=subprocess.DEVNULL, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def same(self):
        self.assertEqual((self.folder / "whole.exr").read_bytes(), (self.folder / "one.exr").read_bytes())

    def test_an_array_of_jobs(self):
        script = self.block("sh", "SBATCH")
        count = int(re.search(r"--array=1-(\d+)", script)[1])
        for i in range(1, count + 1):
            self.sh(script, SLURM_ARRAY_TASK_ID=str(i), SLURM_ARRAY_TASK_MAX=str(count))
        self.sh("raynest merge whole.exr part.*.exr")
        self.same()

    @unittest.skipUnless(shutil.which("parallel"), "GNU parallel is not here: apt install parallel")
    def test_gnu_parallel(self):
        self.sh(self.block("sh", "parallel --jobs"))
        self.same()

    def test_a_job_of_kubernetes(self):
        try:
            import yaml
        except ImportError:
            self.skipTest("PyYAML is not here: apt install python3-yaml")
        job = yaml.safe_load(self.block("yaml", "kind: Job"))
        self.assertEqual((job["apiVersion"], job["kind"], job["spec"]["completionMode"]), ("batch/v1", "Job", "Indexed"))
        container, = job["spec"]["template"]["spec"]["containers"]
        line, = container["args"]
        self.assertEqual(container["command"], ["sh", "-c"])
        shared = str(self.folder)
        line = line.replace("/shared/forest.glb", f"'{SCENE}' --size 320x256").replace("/shared", f"'{shared}'")
        for i in range(job["spec"]["completions"]):
            self.sh(line, JOB_COMPLETION_INDEX=str(i))
        self.sh("raynest merge whole.exr part.*.exr")
        self.same()


if __name__ == "__main__":
    main()
