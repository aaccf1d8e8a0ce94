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

from daemon import PATIENCE, Programs, main

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "client/python"))

import numpy as np
import raynest

SCENE = "builtin:forest?trees=2&seed=3"     # shells take an & for the end of a command


class Recipes(Programs):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest recipes ")))
        text = (ROOT / "server/OPERATING.md").read_text()
        self.blocks = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        self.environment = {
            **os.environ, "SCENE": SCENE, "RAYNEST_PYTHON": sys.executable, "PYTHONPATH": str(ROOT / "client/python"),
            "PATH": f"{pathlib.Path(self.raynest).resolve().parent}:{os.environ['PATH']}", "HOME": str(self.folder),
            "RAYNESTD": str(pathlib.Path(self.raynestd).resolve()), "TMPDIR": str(self.folder)}
        self.sh(f"raynest --local render '{SCENE}' --integrator path --spp 1 --size 320x256 -o one.exr")

    def block(self, kind, word):
        found, = [text for language, text in self.blocks if language == kind and word in text]
        return re.sub(r"--spp \d+", "--spp 1", found)

    def sh(self, script, *before, **more):
        done = subprocess.run([*(before or ("sh", "-ec")), script], cwd=self.folder, env={**self.environment, **more},
                              stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=10 * PATIENCE)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def needs(self, packages, *programs):
        missing = [program for program in programs if not shutil.which(program, path=os.environ["PATH"] + ":/usr/sbin")]
        if missing:
            self.skipTest(f"skipped: no {', '.join(missing)} here: apt install {packages}")

    def on_hosts(self, kind, script):
        """Runs a script on one of three hosts, which are network namespaces; with sshd, or with Slurm."""
        unshare = ("unshare", "--net", "--mount", "--uts", "--pid", "--fork", "--mount-proc", "--kill-child")
        self.needs("iproute2 util-linux", "ip", "unshare")
        tried = subprocess.run([*unshare, "sh", "-c", "mount -t tmpfs run /run && ip link add net type veth"], capture_output=True,
                               text=True)
        if tried.returncode:
            self.skipTest(f"skipped: no hosts can be made here: {tried.stderr.strip()}")
        return self.sh(script, *unshare, "sh", ROOT / "tests/integration/hosts.sh", self.folder, kind)

    def same(self):
        self.assertEqual((self.folder / "whole.exr").read_bytes(), (self.folder / "one.exr").read_bytes())

    def same_pixels(self, name="whole.exr"):
        """Files whose scenes have other names."""
        one, whole = (raynest.read_layers((self.folder / each).read_bytes()) for each in ("one.exr", name))
        self.assertEqual(list(one), list(whole))
        for layer in one:
            self.assertEqual(one[layer].tobytes(), whole[layer].tobytes(), layer)

    def test_an_array_of_jobs_without_slurm(self):
        if shutil.which("sbatch"):
            self.skipTest("skipped: Slurm is here, and runs it")
        script = self.block("sh", "--array")
        count = int(re.search(r"--array=1-(\d+)", script)[1])
        for i in range(1, count + 1):
            self.sh(script, SLURM_ARRAY_TASK_ID=str(i), SLURM_ARRAY_TASK_MAX=str(count))
        self.sh("raynest merge whole.exr part.*.exr")
        self.same()

    def test_slurm(self):
        self.needs("slurm-wlm munge", "slurmctld", "slurmd", "munged", "sbatch", "srun")
        with self.subTest("an array of jobs"):
            (self.folder / "array.sh").write_text(self.block("sh", "--array"))
            self.on_hosts("slurm", self.block("sh", "sbatch"))
            self.same()
        with self.subTest("a Dask cluster"):
            self.needs("python3-distributed", "dask-scheduler", "dask-worker")
            (self.folder / "whole.exr").unlink()
            (self.folder / "cluster.sh").write_text(self.block("sh", "--nodes"))
            self.on_hosts("slurm", "sbatch --wait cluster.sh || { cat slurm-*.out; exit 1; }")
            self.same_pixels()
            self.assertNotIn("on this machine", (self.folder / "slurm-1.out").read_text())

    def test_dask_over_ssh(self):
        self.needs("openssh-server python3-paramiko python3-distributed", "sshd", "dask-ssh", "ssh-keygen")
        try:
            import paramiko  # noqa: F401
        except ImportError:
            self.skipTest("skipped: dask-ssh needs paramiko: apt install python3-paramiko")
        (self.folder / ".ssh").mkdir()
        for name in ("host", "id_ed25519"):
            self.sh(f"ssh-keygen -q -t ed25519 -N '' -f .ssh/{name}")
        script = self.block("sh", "dask-ssh")
        self.assertEqual(script.count("forest.glb"), 2)
        script = script.replace("forest.glb", f"'{SCENE}'").replace("8192x8192", "320x256")
        said = self.on_hosts("ssh", script.replace("--spp 1", "--spp 1 --size 320x256"))
        self.same_pixels("forest.exr")
        self.assertEqual(len(np.load(self.folder / "hits.npz")["t"]), 320 * 256)

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

    def test_a_task_of_a_render_farm(self):
        line = self.block("sh", "%TASK%").replace("/shared/forest.glb", f"'{SCENE}' --size 320x256").replace("/shared/", "")
        for i in range(1, 9):
            self.sh(line.replace("%TASK%", str(i)))
        self.sh("raynest merge whole.exr part.*.exr")
        self.same()


if __name__ == "__main__":
    main()
