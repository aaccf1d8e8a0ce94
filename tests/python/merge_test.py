#!/usr/bin/env python3
"""Joins parts whatever form their rows have; files that were damaged on their way are refused in a line.

  merge_test.py RAYNESTD RAYNEST FLATC
"""
import json
import pathlib
import random
import struct
import sys
import zlib

import numpy as np

import raynest
from raynest._pictures import read_png
from raynest._requests.png import unfiltered
from raynest.merge import merge
from with_daemon import WithDaemon, main

CAMERA = ("--generate", "camera", "size=16x8", "--fields", "t,position")
SIZE = ("--size", "24x32")
MADE = {"heat.exr": ("heatmap", "woods", *SIZE, "--metric", "boxes.1"), "difference.exr": ("heatmap", "woods", *SIZE, "--diff", "mask=1"),
        "lit.exr": ("render", "woods", *SIZE, "--integrator", "ao", "--spp", "1"), "picture.png": ("render", "woods", *SIZE),
        "rows.npz": ("query", "woods", *CAMERA), "hits.npz": ("query", "woods", *CAMERA, "--kind", "all"),
        "seen.npz": ("query", "woods", *CAMERA[:-2], "--reduce", "visible_pixels")}
OUT = {".exr": (".exr", ".npy"), ".png": (".png", ".npy"), ".npz": (".npz", ".ply")}


class Merging(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.cli.environment.update(PYTHONPATH=str(pathlib.Path(raynest.__file__).parents[1]), RAYNEST_PYTHON=sys.executable)


def pixels_of(path):
    part = read_png(str(path), path.read_bytes())
    return unfiltered(part.body[2], part.request["width"])


def refiltered(data, kind):
    """The PNG with another filter of its first row; nothing lies above it."""
    chunks, at, packed = [], 8, b""
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        packed += body if name == b"IDAT" else b""
        chunks += [] if name == b"IDAT" else [(name, body)]
        at += 12 + size
    width = struct.unpack(">I", chunks[0][1][:4])[0]
    rows = zlib.decompress(packed)
    first = unfiltered(rows[:1 + 4 * width], width)[0].astype(int)
    left = np.vstack([np.zeros((1, 4), int), first[:-1]])
    row = (first - (0, left, 0, left // 2, left)[kind]) % 256
    rows = bytes([kind]) + row.astype(np.uint8).tobytes() + rows[1 + 4 * width:]
    chunks.insert(-1, (b"IDAT", zlib.compress(rows)))
    return data[:8] + b"".join(struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
                               for name, body in chunks)


class Joined(Merging):
    def test_the_first_row_of_a_part_may_have_any_filter(self):
        parts = [self.out / f"{i}.png" for i in (1, 2)]
        for i, path in enumerate(parts, 1):
            self.cli.json("render", "woods", *SIZE, "-o", path, "--part", f"{i}/2")
        wanted = np.vstack([pixels_of(path) for path in parts])
        self.assertGreater(len(np.unique(wanted.reshape(-1, 4), axis=0)), 10)
        data = parts[1].read_bytes()
        for kind in range(5):
            parts[1].write_bytes(refiltered(data, kind))
            np.testing.assert_array_equal(np.vstack([pixels_of(path) for path in parts]), wanted)
            whole = self.out / "whole.png"
            merge(str(whole), list(map(str, parts)))
            data_of_whole = whole.read_bytes()
            at = data_of_whole.index(b"IDAT") - 4
            size = struct.unpack_from(">I", data_of_whole, at)[0]
            rows = zlib.decompress(data_of_whole[at + 8:at + 8 + size])
            np.testing.assert_array_equal(unfiltered(rows, wanted.shape[1]), wanted, f"filter {kind}")


class Damaged(Merging):
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

    def test_a_file_that_is_empty(self):
        empty = self.out / "empty.npz"
        for data in (b"", b"\x93NUMPY"):
            empty.write_bytes(data)
            with self.assertRaisesRegex(raynest.InvalidError, "^.*empty.npz: is no part, made with --part: it is empty, or no .npz$"):
                merge(str(self.out / "whole.npz"), [str(empty)])

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

    def test_a_part_of_no_rays_has_no_rows(self):
        path, _ = next(found for found in self.parts() if found[0].name == "rows.npz")
        with np.load(path) as file:
            columns = {name: file[name] for name in file.files}
        said = json.loads(columns["part"].tobytes())
        columns["part"] = np.frombuffer(json.dumps({**said, "count": 0}).encode(), np.uint8)
        bad = self.out / "none.npz"
        np.savez(bad, **columns)
        with self.assertRaisesRegex(raynest.InvalidError, f"^{bad}: is no part, .*: it has 128 rows for 0 rays"):
            merge(str(self.out / "whole.npz"), [str(bad), str(path)])

    def part(self, name, more=(), **said):
        """A file of columns whose part says something else."""
        path, _ = next(found for found in self.parts() if found[0].name == name)
        with np.load(path) as file:
            columns = {**{each: file[each] for each in file.files}, **dict(more)}
        columns["part"] = np.frombuffer(json.dumps({**json.loads(columns["part"].tobytes()), **said}).encode(), np.uint8)
        np.savez(self.out / "said.npz", **columns)
        return str(self.out / "said.npz")

    def test_what_a_part_says_of_itself_is_checked(self):
        for key in ("fields", "reduce", "first", "count", "of"):
            for value in (5, -1, 1e30, None, "x", ["x"], [5], {"a": 1}):
                for out in (".npz", ".ply"):
                    with self.subTest(key, value=value, out=out):
                        try:
                            merge(str(self.out / ("whole" + out)), [self.part("rows.npz", **{key: value})], [])
                        except (raynest.InvalidError, raynest.UsageError) as error:
                            self.assertNotIn("\n", str(error))

    def test_pixels_beyond_what_is_counted_are_refused(self):
        many = {"path": np.array([1, 1], np.uint64), "pixels": np.full(2, 2**32 - 1, np.uint32)}
        with self.assertRaisesRegex(raynest.InvalidError, "8589934590 pixels of one path .* at most 4294967295"):
            merge(str(self.out / "whole.npz"), [self.part("seen.npz", many)], [])

    def test_a_part_is_not_overwritten_by_the_whole(self):
        for path, data in self.parts():
            link = path.with_name("link" + path.suffix)
            link.symlink_to(path)
            for out in (path, link):
                with self.assertRaisesRegex(raynest.UsageError, "is one of the parts"):
                    merge(str(out), [str(path)], [])
            self.assertEqual(path.read_bytes(), data)
            link.unlink()

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
