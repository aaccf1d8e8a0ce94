#!/usr/bin/env python3
"""Lit pictures that are continued: equal bytes, and files from outside that are not to be trusted.

  resume_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import shutil
import struct
import subprocess

from daemon import DaemonTest, main, skip_sanitized
from exr import read_exr, with_values

AO = ("--integrator", "ao", "--size", "150x70")
PATH = ("--integrator", "path", "--size", "150x70")


class Resumed(DaemonTest):
    loads = {"woods": "builtin:forest?trees=30"}

    def render(self, name, *words):
        """Runs `raynest render woods`; returns the file's bytes."""
        self.client.json("render", "woods", "-o", self.out / name, *words)
        return (self.out / name).read_bytes()

    def decoders_work(self):
        """Page faults of the daemon's children that have ended: of processes that decode."""
        stat = pathlib.Path(f"/proc/{self.daemon.process.pid}/stat").read_text()
        return int(stat.rsplit(")", 1)[1].split()[8])

    def test_resume_gives_the_bytes_of_rendering_at_once(self):
        for words in ((*AO, "--lookat", "3,4,20,0,3,0", "--fov", "50"), (*PATH, "--set", "cutoff=0.3", "--sun", "200,30")):
            with self.subTest(words=words):
                whole = self.render("whole.exr", *words, "--spp", "12")
                part = self.render("part.exr", *words, "--spp", "5")
                self.client.json("resume", self.out / "part.exr", "--spp", "12")
                self.assertEqual(whole, (self.out / "part.exr").read_bytes())
        # A picture that its deadline ended, with tiles of different counts.
        done = self.client.run("render", "woods", *PATH, "--spp", "3000", "--deadline", "0.7", "-o", self.out / "late.exr")
        if done.returncode == 8:
            _, _, layers = read_exr((self.out / "late.exr").read_bytes())
            most = max(layers["samples"])
            self.client.json("resume", self.out / "late.exr", "--spp", str(most + 1), "-o", self.out / "full.exr")
            whole = self.render("whole.exr", *PATH, "--spp", str(most + 1))
            self.assertEqual(whole, (self.out / "full.exr").read_bytes())

    def test_what_cannot_be_resumed_is_refused(self):
        part = self.render("good.exr", *AO, "--spp", "4")
        self.client.fails(2, "ask for more than that", "resume", self.out / "good.exr", "--spp", "3")
        bad = self.out / "bad.exr"
        bad.write_bytes(part[:-200])
        self.client.fails(2, "damaged", "resume", bad, "--spp", "8")
        bad.write_bytes(part[:300])
        self.client.fails(5, "header", "resume", bad, "--spp", "8")
        bad.write_bytes(b"no picture")
        self.client.fails(5, "no EXR", "resume", bad, "--spp", "8")
        changed = part.replace(b"raynest:integrator\0string\0\2\0\0\0ao", b"raynest:integrator\0string\0\2\0\0\0xo")
        self.assertNotEqual(changed, part)
        bad.write_bytes(changed)
        self.client.fails(2, "unknown integrator 'xo'", "resume", bad, "--spp", "8")
        hash_at = part.index(b"raynest:hash\0string\0") + 24
        bad.write_bytes(part[:hash_at] + bytes(64) + part[hash_at + 64:])
        self.client.fails(2, "hash", "resume", bad, "--spp", "8")
        self.client.json("render", "woods", "-o", self.out / "primary.exr", "--size", "150x70")
        self.client.fails(5, "no lit picture", "resume", self.out / "primary.exr", "--spp", "8")
        self.client.fails(5, "nowhere", "resume", self.out / "good.exr", "--spp", "8", "--scene", "nowhere")
        self.assertTrue(self.daemon.alive())

    def test_hostile_files_end_in_a_line_and_the_daemon_goes_on(self):
        good = self.render("good.exr", *AO, "--spp", "4")
        window = good.index(b"dataWindow\0box2i\0") + len("dataWindow\0box2i\0") + 4
        shown = good.index(b"displayWindow\0box2i\0") + len("displayWindow\0box2i\0") + 4

        def of_size(width, height):
            box, data = struct.pack("<4i", 0, 0, width - 1, height - 1), bytearray(good)
            data[window:window + 16] = data[shown:shown + 16] = box
            return bytes(data)
        nan, infinity, below = (struct.pack("<f", value) for value in (float("nan"), float("inf"), -1.0))
        count = lambda number: struct.pack("<I", number)
        at_once = lambda value: {pixel: value for pixel in range(150 * 70)}
        cases = {
            "cut in the pixels": (good[:len(good) // 2], "damaged or cut short"),
            "cut in the table of blocks": (good[:good.index(b"raynest:width") + 60], "cut short"),
            "one pixel more": (of_size(151, 70), "the EXR has 151x70 pixels, not 150x70"),
            "a million a side": (of_size(1 << 20, 1 << 20), "the EXR has 1048576x1048576 pixels"),
            "two thousand million a side": (of_size(2**31 - 1, 2**31 - 1), "window"),
            "before zero": (of_size(-5, -5), "window"),
            "another layer": (good.replace(b"albedo.G\0", b"albedo.Q\0", 1), "other channels"),
            "a layer of another type": (good.replace(b"dropped\0\0\0\0\0", b"dropped\0\2\0\0\0", 1), "other channels"),
            "a layer twice": (good.replace(b"N.Y\0", b"N.X\0", 1), "other channels"),
            "blocks beyond the file": (good[:-len(good) // 3] + bytes(10), "damaged or cut short"),
            "not finite": (with_values(good, "R", {0: nan}), "layer R of pixel 0,0 is not finite"),
            "infinite": (with_values(good, "N.Z", {151: infinity}), "layer N.Z of pixel 1,1 is not finite"),
            "negative variance": (with_values(good, "variance", {149: below}), "variance of pixel 149,0 is negative"),
            "other counts in a tile": (with_values(good, "samples", {7: count(3)}), "different numbers of samples"),
            "all samples": (with_values(good, "samples", at_once(count(0xFFFFFFFF))), "more than 65536"),
            "too many": (with_values(good, "samples", at_once(count(9))), "has 9 samples of a pixel: ask for more"),
            "all dropped": (with_values(good, "dropped", {3: count(0xFFFFFFFF)}), "more than 65536"),
        }
        path = self.out / "hostile.exr"
        for name, (data, says) in cases.items():
            with self.subTest(name=name):
                self.assertNotEqual(data, good)
                path.write_bytes(data)
                done = self.client.run("resume", path, "--spp", "8", "-o", self.out / "never.exr")
                self.assertIn(done.returncode, (2, 5), done.stderr)
                self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                self.assertIn(says, done.stderr)
                self.assertFalse((self.out / "never.exr").exists())
                self.assertTrue(self.daemon.alive())
        # The same values, stored otherwise, are the same picture; the daemon still answers.
        path.write_bytes(with_values(good, "R", {}))
        self.client.json("resume", path, "--spp", "8")
        self.assertEqual(path.read_bytes(), self.render("whole.exr", *AO, "--spp", "8"))

    def test_a_file_is_decoded_in_a_process_of_its_own(self):
        skip_sanitized(self, self.raynestd, "has page faults of its own")
        self.render("part.exr", *AO, "--spp", "2")
        before = self.decoders_work()
        self.render("other.exr", *AO, "--spp", "2")
        self.assertEqual(self.decoders_work(), before)
        self.client.json("resume", self.out / "part.exr", "--spp", "4")
        # A start of the import process and the libraries of its decoders.
        self.assertGreater(self.decoders_work() - before, 1000)

    def test_a_full_disk_leaves_the_film_that_was_continued(self):
        small = self.out / "small"
        small.mkdir()
        if os.geteuid() != 0 or shutil.which("mount") is None or subprocess.run(
                ["mount", "-t", "tmpfs", "-o", "size=96k", "none", small], check=False, capture_output=True).returncode != 0:
            self.skipTest("needs a small file system")
        self.addCleanup(subprocess.run, ["umount", small], check=False)
        self.client.json("render", "woods", "--integrator", "ao", "--size", "30x30", "--spp", "2", "-o", small / "a.exr")
        before = (small / "a.exr").read_bytes()
        with self.assertRaises(OSError), open(small / "other", "wb", buffering=0) as other:
            while True:
                other.write(bytes(4096))
        self.client.fails(1, "a.exr: No space left on device", "resume", small / "a.exr", "--spp", "4")
        self.assertEqual(sorted(entry.name for entry in small.iterdir()), ["a.exr", "other"])
        self.assertEqual((small / "a.exr").read_bytes(), before)


if __name__ == "__main__":
    main()
