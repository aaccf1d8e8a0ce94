#!/usr/bin/env python3
"""Sends bad scene files through the whole system: from the uploading client to the daemon.

  hostile_test.py RAYNESTD RAYNEST

Every file ends in one clear line and exit code 5, or in a load. The daemon stays alive and small,
and serves another client meanwhile.
"""
import collections
import concurrent.futures
import pathlib
import sys
import tempfile
import threading
import time

from daemon import SHARED_SCENES, Client, Daemon, Programs, main

RESIDENT_GROWTH_MAX = 512 << 20
CUTS = 200


class Hostile(Programs):
    def setUp(self):
        if not SHARED_SCENES.is_dir():
            self.skipTest(f"skipped: {SHARED_SCENES} is not there")
        self.daemon = Daemon(self.raynestd, "--scene-root", SHARED_SCENES)
        self.addCleanup(self.daemon.stop)
        self.client = Client(self.raynest, self.daemon.uri)
        self.client.json("load", "builtin:terrain?size=16", "--name", "other")
        self.before = self.daemon.resident_bytes()
        self.slowest_answer = self.answers = 0
        self.done = threading.Event()
        self.other = threading.Thread(target=self.serve_another)
        self.other.start()
        self.addCleanup(self.end_other)

    def serve_another(self):
        """Sends requests meanwhile, as another client."""
        while not self.done.is_set():
            begin = time.monotonic()
            self.client.json("query", "other", "--ray", "0,1000,0,0,-1,0")
            self.slowest_answer = max(self.slowest_answer, time.monotonic() - begin)
            self.answers += 1
            self.done.wait(0.1)

    def end_other(self):
        self.done.set()
        self.other.join()

    def load(self, source, name):
        begin = time.monotonic()
        done = self.client.run("load", source, "--name", name, "--replace")
        seconds = time.monotonic() - begin
        if done.returncode == 0:
            self.client.run("unload", name)
        return source, done.returncode, done.stderr, seconds

    def load_all(self, sources):
        """Loads two files at a time; counts the exit codes."""
        answered = self.answers
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            results = list(pool.map(self.load, sources, [f"scene-{i}" for i in range(len(sources))]))
        for source, code, errors, _ in results:
            with self.subTest(source=str(source)):
                self.assertIn(code, (0, 5), errors)
                if code == 5:
                    self.assertEqual(errors.count("\n"), 1, errors)
                    self.assertTrue(errors.startswith("raynest: "), errors)
        self.assertTrue(self.daemon.alive(), self.daemon.log())
        self.assertTrue(self.other.is_alive())
        self.assertGreater(self.answers, answered)
        # Compare the peak of resident memory, not the current value.
        growth = self.daemon.resident_bytes("VmHWM") - self.before
        self.assertLess(growth, RESIDENT_GROWTH_MAX)
        counts = collections.Counter(code for _, code, _, _ in results)
        print(f"{len(results)} files: {counts[5]} refused, {counts[0]} loaded; slowest "
              f"{max(seconds for *_, seconds in results):.2f} s; daemon grew {growth >> 20} MiB; "
              f"another client waited {self.slowest_answer:.2f} s at most", file=sys.stderr)
        return counts

    def hostile_files(self):
        return sorted(path for path in (SHARED_SCENES / "hostile").rglob("*")
                      if path.suffix in (".gltf", ".glb"))

    def test_uploaded_hostile_files(self):
        counts = self.load_all(self.hostile_files())
        self.assertGreater(counts[5], 0)

    def test_hostile_files_beneath_the_daemons_folder(self):
        counts = self.load_all([f"root:{path.relative_to(SHARED_SCENES)}"
                                for path in self.hostile_files()])
        self.assertGreater(counts[5], 0)

    def test_good_files_cut_anywhere(self):
        with tempfile.TemporaryDirectory(prefix="raynest-cut-") as folder:
            sources = []
            good = [path for path in SHARED_SCENES.rglob("small/**/*")
                    if path.suffix in (".glb", ".gltf")]
            for path in good:
                data = path.read_bytes()
                for i in range(CUTS // len(good)):
                    cut = pathlib.Path(folder) / f"{path.stem}-{i}{path.suffix}"
                    cut.write_bytes(data[:len(data) * i * len(good) // CUTS])
                    sources.append(cut)
            counts = self.load_all(sources)
            self.assertEqual(counts[0], 0)


if __name__ == "__main__":
    main()
