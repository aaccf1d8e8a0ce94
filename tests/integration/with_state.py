"""Shared by the tests of --state: a daemon with a state folder, and what lies in that."""
import contextlib
import json
import os
import pathlib
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time

import numpy

from daemon import PATIENCE, Client, Daemon, Programs, is_sanitized

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

    def start(self, *arguments, under=()):
        self.daemon = Daemon(self.raynestd, "--state", self.state, *arguments, under=under)
        self.addCleanup(self.daemon.folder.cleanup)
        self.addCleanup(self.daemon.process.wait)
        self.addCleanup(self.daemon.process.kill)
        self.client = Client(self.raynest, self.daemon.uri)
        return self.client

    def kill(self):
        self.daemon.process.kill()
        self.daemon.process.wait()

    def again(self, *arguments, under=()):
        self.kill()
        return self.start(*arguments, under=under)

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
        (blob,), = self.manifest("SELECT DISTINCT digest FROM scenes WHERE content = ?", digest)
        return blob

    def manifest(self, question, *values):
        with contextlib.closing(sqlite3.connect(f"file:{self.state}/manifest.sqlite?mode=ro", uri=True)) as manifest:
            return manifest.execute(question, values).fetchall()

    def damage(self, digest, at=None):
        """Flips a bit of a blob: of this byte, or of that in the middle."""
        with open(self.blobs / digest, "r+b") as blob:
            blob.seek(os.fstat(blob.fileno()).st_size // 2 if at is None else at)
            byte = blob.read(1)[0]
            blob.seek(-1, os.SEEK_CUR)
            blob.write(bytes([byte ^ 1]))

    def check(self):
        done = subprocess.run([self.raynestd, "check", self.state], capture_output=True, text=True, timeout=PATIENCE)
        return done.returncode, done.stdout

    def edits(self, name, keep, limit, daemon=None):
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
        uri = (daemon or self.daemon).uri
        return subprocess.Popen([sys.executable, "-c", script, uri, name, str(keep), str(limit)],
                                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                                env={**os.environ, "PYTHONPATH": str(package)})

    def strikes(self, kind, rounds, strike, restart):
        """Ends the daemon by `strike` among loads and kept edits, at random moments, until something is lost or
        `rounds` have passed. Returns what was lost: named by what had been answered and was not so after `restart`."""
        chance = random.Random(int(os.environ.get("RAYNEST_SEED", time.time())))
        twin = Daemon(self.raynestd)  # makes the same edits, and lives on
        self.addCleanup(twin.stop)

        def more(count):
            """The hashes that these many more edits make."""
            if count == 0:
                return []
            with self.edits("woods", False, count, twin) as edits:
                return [line.split()[1] for line in edits.communicate(timeout=4 * PATIENCE)[0].splitlines()]

        last = self.client.json("load", WOODS, "--name", "woods")["hash"]
        self.assertEqual(Client(self.raynest, twin.uri).json("load", WOODS, "--name", "woods")["hash"], last)
        # The same content, which no edit of the other may reach.
        loaded, gone, lost = {"still": self.client.json("load", WOODS, "--name", "still")["hash"]}, set(), []
        loads = edited = under_way = 0
        for number in range(1, rounds + 1):
            for name in list(loaded)[1:-6]:
                self.client.json("unload", name)
                del loaded[name]
                gone.add(name)
            started = {}
            for index in range(4):
                source = f"builtin:forest?trees={chance.randint(1, 30)}&seed={chance.randint(1, 9)}"
                name = f"s{number}-{index}"
                started[name] = self.client.start("--json", "load", source, "--name", name)
            with self.edits("woods", True, 1_000_000) as edits:
                # Every other time among edits, however slow the machine is.
                first = edits.stdout.readline() if number % 2 else ""
                time.sleep(chance.uniform(0, 1.2))
                strike()
                said = [line.split() for line in (first + edits.stdout.read()).splitlines()]
            for name, process in started.items():
                output, _ = process.communicate(timeout=PATIENCE)
                if process.returncode == 0:
                    loaded[name] = json.loads(output)["hash"]
                    loads += 1
            edited += len(said)
            restart()
            scenes = self.scenes()
            found = {name: scene["hash"] for name, scene in scenes.items()}
            lost += [f"the load of {name}" for name, digest in loaded.items() if found.get(name) != digest]
            lost += [f"the unload of {name}" for name in gone & set(found)]
            # Those without an answer, too, are there whole or not at all.
            lost += [f"the content of {name}" for name, digest in found.items()
                     if digest not in self.client.run("--json", "info", name).stdout]
            hashes = [last, *more(len(said))]
            self.assertEqual([digest for _, digest in said], hashes[1:])
            last = found["woods"]
            if last not in hashes:  # one that was on its way may be there without an answer
                under_way += 1
                hashes += more(1)
            self.assertIn(last, hashes)
            lost += [f"the edit to epoch {epoch}" for epoch, _ in said[hashes.index(last):]]
            if said and not lost:
                self.assertGreaterEqual(scenes["woods"]["epoch"], int(said[-1][0]))
            if lost:
                break
            self.assertEqual(self.blob_names(), {digest for digest, in self.manifest("SELECT digest FROM scenes")})
            del found["woods"]
            loaded |= found
        print(f"{number} {kind}: {loads} loads, {len(gone)} unloads and {edited} kept edits answered, "
              f"{len(lost)} lost; {under_way} edits under way were there", file=sys.stderr)
        if not lost:
            self.assertGreaterEqual(edited, rounds // 2)
            self.kill()
            self.assertEqual(self.check()[0], 0)
        return lost

    def preload(self, source, **environment):
        """Loads a library into the daemons that start from now on, which plants a fault in them."""
        compiler = shutil.which("cc") or shutil.which("g++")
        if not compiler or is_sanitized(self.raynestd):
            self.skipTest("needs a compiler, and no sanitizer")
        # LD_PRELOAD knows no spaces, which this test's folder has.
        library = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-"))) / "fault.so"
        subprocess.run([compiler, "-shared", "-fPIC", "-D_GNU_SOURCE", "-x", "c", "-", "-o", library, "-ldl"],
                       input=source, text=True, check=True)
        for name, value in {"LD_PRELOAD": str(library), **environment}.items():
            os.environ[name] = value
            self.addCleanup(os.environ.pop, name, None)
