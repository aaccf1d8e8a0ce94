#!/usr/bin/env python3
"""Files that were damaged on their way: `raynest merge` and `query` say so in a line, whatever has become of them.

  merge_test.py RAYNESTD RAYNEST FLATC
"""
import pathlib
import random
import sys

import numpy as np

import raynest
from raynest.merge import merge
from with_daemon import WithDaemon, main

CAMERA = ("--generate", "camera", "size=16x8", "--fields", "t,position")
SIZE = ("--size", "24x32")
MADE = {"heat.exr": ("heatmap", "woods", *SIZE, "--metric", "boxes.1"), "difference.exr": ("heatmap", "woods", *SIZE, "--diff", "mask=1"),
        "lit.exr": ("render", "woods", *SIZE, "--integrator", "ao", "--spp", "1"), "picture.png": ("render", "woods", *SIZE),
        "rows.npz": ("query", "woods", *CAMERA), "hits.npz": ("query", "woods", *CAMERA, "--kind", "all"),
        "seen.npz": ("query", "woods", *CAMERA[:-2], "--reduce", "visible_pixels")}
OUT = {".exr": (".exr", ".npy"), ".png": (".png", ".npy"), ".npz": (".npz", ".ply")}


class Damaged(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.cli.environment.update(PYTHONPATH=str(pathlib.Path(raynest.__file__).parents[1]), RAYNEST_PYTHON=sys.executable)

    def parts(self):
        """Files that are all parts of their whole."""
        for name, words in MADE.items():
            path = self.out / name
            if not path.exists():
                self.cli.json(*words, "-o", path, "--part", "1/1")
            yield path, path.read_bytes()

    def refused(self, path, data, out):
        """True if the damaged file is refused; it is by a line that names it, or it becomes something."""
        bad = path.with_name("bad" + path.suffix)
        bad.write_bytes(data)
        limits = ["boxes.max<0"] if path.name == "heat.exr" and out == ".exr" else []
        try:
            merge(str(self.out / ("whole" + out)), [str(bad)], limits)
        except raynest.InvalidError as error:
            self.assertTrue(str(error).startswith(str(bad)) or "a part is missing" in str(error), error)
            self.assertNotIn("\n", str(error))
            return True
        except raynest.UsageError as error:     # what is asked for is not in it
            self.assertRegex(str(error), "the heat map has no|these parts")
        return False

    def test_a_file_that_was_cut(self):
        for path, data in self.parts():
            for length in (0, 1, 7, 8, 20, *range(50, len(data), len(data) // 9), len(data) - 30):
                for out in OUT[path.suffix]:
                    with self.subTest(path.name, length=length, out=out):
                        self.assertTrue(self.refused(path, data[:length], out))

    def test_a_file_with_other_bytes(self):
        chance = random.Random(1)
        for path, data in self.parts():
            for round in range(120):
                damaged = bytearray(data)
                damaged[chance.randrange(min(len(data), 1500) if round % 2 else len(data))] ^= chance.randrange(1, 256)
                for out in OUT[path.suffix]:
                    with self.subTest(path.name, round=round, out=out):
                        found = self.refused(path, damaged, out)
                        self.assertTrue(found or path.suffix != ".png")

    def test_what_a_heat_map_shows_is_gone(self):
        """Nothing but the names in its header tells what the counts are."""
        whole = {path.name: (path, data) for path, data in self.parts()}
        path, data = whole["heat.exr"]
        self.assertEqual(data.count(b"\0L1.boxes\0"), 1)
        for out in (".exr", ".npy"):
            self.assertTrue(self.refused(path, data.replace(b"\0L1.boxes\0", b"\0L1.bozes\0"), out))
        for before, after in ((b"compression\0compression\0\1\0\0\0\3", b"compression\0compression\0\1\0\0\0\4"),
                              (b"compression\0", b"compressiom\0")):
            self.assertIn(before, data)
            for name in ("heat.exr", "lit.exr"):
                path, data = whole[name]
                self.assertTrue(self.refused(path, data.replace(before, after, 1), ".exr"))

    def test_commands_end_with_the_code_of_a_file(self):
        for path, data in self.parts():
            bad = path.with_name("cut" + path.suffix)
            bad.write_bytes(data[:len(data) // 2])
            self.cli.fails(5, f"cut{path.suffix}: is no part, made with --part: ", "merge", self.out / ("no" + path.suffix), bad)
        rays, times = self.out / "rays.npy", self.out / "times.npy"
        np.save(rays, np.float32([[0, 9, 0, 0, -1, 0]] * 9))
        np.save(times, np.zeros(9))
        for path in (rays, times):
            data = path.read_bytes()
            for length in (0, 5, 60, len(data) - 3):
                path.write_bytes(data[:length])
                with self.subTest(path.name, length=length):
                    self.cli.fails(5, f"{path.name}", "query", "woods", "--rays", rays, "--times", times, "-o", self.out / "no.npz")
                path.write_bytes(data)


if __name__ == "__main__":
    main()
