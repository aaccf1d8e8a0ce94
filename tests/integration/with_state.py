"""Shared by the tests of --state: a daemon with a state folder, and what lies in that."""
import contextlib
import os
import pathlib
import sqlite3
import subprocess
import sys
import tempfile

import numpy

from daemon import PATIENCE, Client, Daemon, Programs

WOODS = "builtin:forest?trees=40"


class WithState(Programs):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.state = self.folder / "state"
        self.blobs = self.state / "blobs"
        self.daemon = None
        rays = numpy.random.default_rng(1).uniform(-20, 20, size=(5000, 6)).astype(numpy.float32)
        rays[:, 2] += 10
        self.rays = self.folder / "rays.npy"
        numpy.save(self.rays, rays)

    def start(self, *arguments):
        self.daemon = Daemon(self.raynestd, "--state", self.state, *arguments)
        self.addCleanup(self.daemon.folder.cleanup)
        self.addCleanup(self.daemon.process.wait)
        self.addCleanup(self.daemon.process.kill)
        self.client = Client(self.raynest, self.daemon.uri)
        return self.client

    def kill(self):
        self.daemon.process.kill()
        self.daemon.process.wait()

    def again(self, *arguments):
        self.kill()
        return self.start(*arguments)

    def refused(self, *arguments):
        """Starts a daemon that must end with 1, and returns its one line."""
        done = subprocess.run([self.raynestd, "--listen", "tcp://127.0.0.1:0", "--http", "off", "--cuda", "off",
                               "--state", self.state, *arguments], stdin=subprocess.DEVNULL,
                              capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        return done.stderr

    def scenes(self, client=None):
        return {scene["name"]: scene for scene in (client or self.client).json("scenes")["scenes"]}

    def hits(self, scene, client=None):
        file = self.folder / "hits.npz"
        file.unlink(missing_ok=True)
        done = (client or self.client).run("--quiet", "query", scene, "--rays", self.rays, "-o", file)
        self.assertEqual(done.returncode, 0, done.stderr)
        with numpy.load(file) as columns:
            return {name: columns[name].tobytes() for name in columns}

    def files(self):
        return {file.relative_to(self.state).as_posix(): file.read_bytes()
                for file in self.state.rglob("*") if file.is_file() and file.name != "lock"}

    def blob_names(self):
        return {file.name for file in self.blobs.iterdir()}

    def blob_of(self, digest):
        """The name of the blob that a scene of this hash has: one of the arena's bytes, trees included."""
        manifest = sqlite3.connect(f"file:{self.state}/manifest.sqlite?mode=ro", uri=True)
        with contextlib.closing(manifest):
            (blob,), = manifest.execute("SELECT DISTINCT digest FROM scenes WHERE content = ?", (digest,))
        return blob

    def damage(self, digest):
        with open(self.blobs / digest, "r+b") as blob:
            blob.seek(os.fstat(blob.fileno()).st_size // 2)
            byte = blob.read(1)[0]
            blob.seek(-1, os.SEEK_CUR)
            blob.write(bytes([byte ^ 1]))

    def check(self):
        done = subprocess.run([self.raynestd, "check", self.state], capture_output=True, text=True, timeout=PATIENCE)
        return done.returncode, done.stdout

    def edits(self, name, keep, limit):
        """Starts a client that makes the same edit again and again, and prints epoch and hash of each."""
        script = """
import sys, raynest
uri, name, keep, limit = sys.argv[1:]
with raynest.connect(uri) as client:
    scene = client.scene(name)
    for _ in range(int(limit)):
        with scene.edit(keep=keep == "True") as edit:
            edit.move(0, (0.01, 0, 0)).move(1, (0, 0, 0.01))
        assert str(edit.kept) == keep
        print(edit.epoch, edit.hash, flush=True)
"""
        package = pathlib.Path(__file__).parents[2] / "client" / "python"
        return subprocess.Popen([sys.executable, "-c", script, self.daemon.uri, name, str(keep), str(limit)],
                                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                                env={**os.environ, "PYTHONPATH": str(package)})
