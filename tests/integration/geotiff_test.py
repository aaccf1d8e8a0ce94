#!/usr/bin/env python3
"""Tests heights in a TIFF, written here by struct: where the surface lies, by its georeference, in
all kinds of numbers, strips and tiles; and damaged files.

  geotiff_test.py RAYNESTD RAYNEST
"""
import pathlib
import struct
import subprocess
import sys
import warnings
import zlib

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_files import WithFiles

NONE = 0xFFFFFFFF
RANDOM = np.random.default_rng(5)
HEIGHTS = np.round(RANDOM.uniform(100, 160, (37, 29)))
SCALE = (2.0, 3.0, 0.0)
TIE = (0, 0, 0, 500_000.0, 5_300_000.0, 0)  # the outer corner of height (0, 0)
SHORT, LONG, ASCII, DOUBLE = 3, 4, 2, 12
LETTERS = {SHORT: "H", LONG: "I", DOUBLE: "d"}


def tiff(heights=HEIGHTS, kind="f4", order="<", tile=None, rows_per_strip=10, packed=False, georeference=True,
         no_data=None, keys=(), more=()):
    """A TIFF of one band. `tile`: the side of tiles; else strips. `keys`: GeoKeys (id, value)."""
    heights = np.asarray(heights)
    data = heights.astype(order + kind)
    if tile:
        padded = np.zeros([-(-side // tile) * tile for side in data.shape], data.dtype)
        padded[:data.shape[0], :data.shape[1]] = data
        parts = [padded[r:r + tile, c:c + tile].tobytes() for r in range(0, padded.shape[0], tile)
                 for c in range(0, padded.shape[1], tile)]
    else:
        parts = [data[r:r + rows_per_strip].tobytes() for r in range(0, len(data), rows_per_strip)]
    if packed:
        parts = [zlib.compress(part) for part in parts]
    starts = np.cumsum([8] + [len(part) for part in parts])
    tags = {256: (LONG, [heights.shape[1]]), 257: (LONG, [heights.shape[0]]), 258: (SHORT, [8 * data.itemsize]),
            259: (SHORT, [8 if packed else 1]), 262: (SHORT, [1]), 277: (SHORT, [1]),
            339: (SHORT, [{"u": 1, "i": 2, "f": 3}[kind[0]]])}
    where, sizes = starts[:-1].tolist(), [len(part) for part in parts]
    tags |= ({322: (SHORT, [tile]), 323: (SHORT, [tile]), 324: (LONG, where), 325: (LONG, sizes)} if tile else
             {278: (LONG, [rows_per_strip]), 273: (LONG, where), 279: (LONG, sizes)})
    if georeference:
        tags |= {33550: (DOUBLE, SCALE), 33922: (DOUBLE, TIE)}
    if keys:
        tags[34735] = (SHORT, [1, 1, 0, len(keys), *(n for key, value in keys for n in (key, 0, 1, value))])
    if no_data is not None:
        tags[42113] = (ASCII, no_data.encode() + b"\0")
    tags |= dict(more)
    body = b"".join(parts)
    body += b"\0" * (len(body) % 2)
    table, extra = b"", b""
    at = 8 + len(body) + 2 + 12 * len(tags) + 4
    for tag, (type_, values) in sorted(tags.items()):
        raw = values if type_ == ASCII else struct.pack(order + str(len(values)) + LETTERS[type_], *values)
        if len(raw) <= 4:
            slot = raw.ljust(4, b"\0")
        else:
            slot = struct.pack(order + "I", at + len(extra))
            extra += raw + b"\0" * (len(raw) % 2)
        table += struct.pack(order + "HHI", tag, type_, len(values)) + slot
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8 + len(body))
    return head + body + struct.pack(order + "H", len(tags)) + table + struct.pack(order + "I", 0) + extra


def down(east, north):
    """Rays straight down on points of the map."""
    east, north = np.broadcast_arrays(np.asarray(east, float), np.asarray(north, float))
    rays = np.zeros((east.size, 6))
    rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 4] = east.ravel(), 1000, -north.ravel(), -1
    return rays


class Geotiff(WithFiles):
    def load(self, data, name="dem.tif", **options):
        return super().load(name, data, **options)

    def middles(self, heights=HEIGHTS, shift=0.5):
        """East, north and height of all inner heights: an edge of the surface may pass a ray."""
        rows, columns = np.meshgrid(np.arange(1, heights.shape[0] - 1), np.arange(1, heights.shape[1] - 1), indexing="ij")
        return (TIE[3] + (columns + shift) * SCALE[0], TIE[4] - (rows + shift) * SCALE[1], heights[1:-1, 1:-1])

    def check(self, scene, *places):
        east, north, height = places or self.middles()
        hit = scene.trace(down(east, north), fields=("t",))["t"]
        np.testing.assert_allclose(1000 - hit, height.ravel(), atol=1e-2)

    def test_heights_stand_where_the_map_says(self):
        for name, data in {
                "float32": tiff(), "float64": tiff(kind="f8"), "big-endian": tiff(order=">", kind="i2"),
                "uint8": tiff(kind="u1"), "int32": tiff(kind="i4"), "uint16 packed": tiff(kind="u2", packed=True),
                "tiles": tiff(tile=16), "packed tiles": tiff(tile=16, packed=True, kind="i2"),
                "one strip": tiff(rows_per_strip=37)}.items():
            with self.subTest(name):
                scene = self.load(data)
                self.check(scene)
                self.assertEqual(scene.info["unique_triangles"], 2 * 36 * 28)
                # Chosen, so that the map's coordinates keep their digits.
                self.assertGreater(np.abs(scene.origin).max(), 1e6)

    def test_tiles_that_are_left_out(self):
        """GDAL's SPARSE_OK: tiles without bytes have no known heights, or 0 in a file that knows no holes."""
        for no_data, is_hole in (("-9999", True), ("nan", True), (None, False)):
            data = bytearray(tiff(tile=16, no_data=no_data))
            table, = struct.unpack_from("<I", data, 4)
            for slot in range(table + 2, table + 2 + 12 * struct.unpack_from("<H", data, table)[0], 12):
                tag, _, _, at = struct.unpack_from("<HHII", data, slot)
                if tag in (324, 325):
                    struct.pack_into("<I", data, at, 0)  # the first tile's
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                scene = self.load(bytes(data))
            self.assertEqual(any("256 heights are not known" in str(warning.message) for warning in told), is_hole)
            hit = scene.trace(down(TIE[3] + 10.2, TIE[4] - 15.4), fields=("t",))["t"]
            self.assertEqual([bool(np.isfinite(t) and abs(t - 1000) < 0.01) for t in hit], [not is_hole])

    def test_with_z_up_hits_are_in_the_maps_coordinates(self):
        scene = self.load(tiff(), up="z")
        east, north, height = self.middles()
        east, north = np.broadcast_arrays(east, north)
        rays = np.zeros((east.size, 6))
        rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 5] = east.ravel(), north.ravel(), 1000, -1
        hit = scene.trace(rays, fields=("t",))["t"]
        np.testing.assert_allclose(1000 - hit, height.ravel(), atol=1e-2)
        self.assertEqual(scene.info["up"], "z")

    def test_a_number_may_be_a_point(self):
        self.check(self.load(tiff(keys=[(1024, 1), (1025, 2)])), *self.middles(shift=0))

    def test_a_transformation_in_place_of_a_scale(self):
        turned = [0, 3.0, 0, 500_000, 2.0, 0, 0, 5_300_000, 0, 0, 0, 0, 0, 0, 0, 1]
        scene = self.load(tiff(georeference=False, more=[(34264, (DOUBLE, turned))]))
        rows, columns = np.meshgrid(np.arange(1, 36), np.arange(1, 28), indexing="ij")
        self.check(scene, 500_000 + (rows + 0.5) * 3, 5_300_000 + (columns + 0.5) * 2, HEIGHTS[1:-1, 1:-1])

    def test_heights_that_are_not_known_are_holes(self):
        heights = HEIGHTS.copy()
        heights[5, 7] = -3.4028234663852886e38
        heights[20, 11] = np.nan
        with self.assertWarnsRegex(raynest.SceneWarning, "2 heights are not known"):
            scene = self.load(tiff(heights, no_data="-3.40282346638529e+38"))
        self.assertEqual(scene.info["unique_triangles"], 2 * (36 * 28 - 8))
        hit = scene.trace(down(TIE[3] + 7.5 * 2, TIE[4] - 5.5 * 3), fields=("prim",))
        self.assertEqual(hit["prim"][0], NONE)

    def test_units(self):
        feet = self.load(tiff(keys=[(1024, 1), (3076, 9002)]))
        east, north, height = self.middles()
        hit = feet.trace(down(0.3048 * east, 0.3048 * north), fields=("t",))["t"]
        np.testing.assert_allclose(1000 - hit, 0.3048 * height.ravel(), atol=1e-2)
        with self.assertWarnsRegex(raynest.SceneWarning, "EPSG:9036.*taken for metres"):
            self.check(self.load(tiff(keys=[(1024, 1), (3076, 9036)])))
        kilometres = self.load(tiff(keys=[(3076, 9036)]), unit=1000)
        self.assertAlmostEqual(np.ptp([kilometres.info["box_min"][0], kilometres.info["box_max"][0]]), 28 * 2 * 1000, delta=1)

    def test_heights_may_have_another_unit_than_the_map(self):
        east, north, height = self.middles()
        for keys, unit, across, tall in (([(3076, 9003), (4099, 9001)], None, 1200 / 3937, 1),
                                         ([(3076, 9001), (4099, 9002)], None, 1, 0.3048),
                                         ([(4099, 9002)], None, 1, 0.3048),
                                         ([(3076, 9002)], None, 0.3048, 0.3048),
                                         ([(3076, 9036), (4099, 9001)], 1000, 1000, 1)):
            with self.subTest(keys=keys):
                scene = self.load(tiff(keys=keys), **({} if unit is None else {"unit": unit}))
                hit = scene.trace(down(across * east, across * north), fields=("t",))["t"]
                np.testing.assert_allclose(1000 - hit, tall * height.ravel(), atol=1e-2)
        with self.assertWarnsRegex(raynest.SceneWarning, "heights is EPSG:5103.*the map's"):
            self.check(self.load(tiff(keys=[(4099, 5103)])))

    def test_heights_keep_their_digits(self):
        exact = np.full((4, 4), 8848.0004)
        scene = self.load(tiff(exact, kind="f8"), origin=(TIE[3], 8848, -TIE[4]))
        hit = scene.trace([TIE[3] + 3, 8850, 4.5 - TIE[4], 0, -1, 0], fields=("t",))["t"][0]
        self.assertAlmostEqual(8850 - hit, 8848.0004, delta=1e-5)
        whole = np.full((4, 4), 16777216)
        whole[1, 1] = 16777217
        with self.assertWarnsRegex(raynest.SceneWarning, "1 height is not known"):
            self.load(tiff(whole, kind="i4", no_data="16777217"))

    def test_faces_look_up_where_rows_go_north_too(self):
        north = [2.0, 0, 0, 500_000, 0, 3.0, 0, 5_300_000, 0, 0, 0, 0, 0, 0, 0, 1]
        for data in (tiff(), tiff(georeference=False, more=[(34264, (DOUBLE, north))])):
            scene = self.load(data)
            middle = (np.array(scene.info["box_min"]) + scene.info["box_max"]) / 2
            hit = scene.trace(down(middle[0], -middle[2]), fields=("ng", "front"))
            self.assertGreater(hit["ng"][0][1], 0)
            self.assertTrue(hit["front"][0])

    def test_files_that_are_cut_short_are_refused(self):
        # The numbers behind the tags come last, as GDAL writes them.
        point = tiff(keys=[(1024, 1), (1025, 2)], no_data="-9999")
        whole = self.load(point)
        self.assertTrue(np.abs(whole.origin).max() > 1e6)
        for cut in range(1, 90, 4):
            with self.subTest(cut=cut), self.assertRaisesRegex(raynest.InvalidError, "cut short|damaged|is no TIFF"):
                self.load(point[:-cut])

    def test_a_tiff_without_a_map(self):
        with self.assertWarnsRegex(raynest.SceneWarning, "no place on a map"):
            scene = self.load(tiff(georeference=False))
        np.testing.assert_allclose(scene.info["box_max"][::2], [28, 36])
        spaced = self.load(tiff(georeference=False), spacing=5)
        np.testing.assert_allclose(spaced.info["box_max"][::2], [140, 180])
        self.assertEqual(spaced.origin.tolist(), [0, 0, 0])

    def test_the_command_line_and_a_pipe(self):
        path = self.write("cli.tif", tiff())
        made = self.client.json("load", path, "--name", "cli", "--replace")
        self.assertEqual(made["unique_triangles"], 2 * 36 * 28)
        with open(path, "rb") as file:
            done = subprocess.run([self.client.program, "load", "-", "--name", "piped"], stdin=file,
                                  env=self.client.environment, capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_damaged_files_and_options(self):
        good = tiff(packed=True)
        huge = tiff(more=[(256, (LONG, [1 << 30]))])
        tiles = tiff(tile=16, more=[(322, (LONG, [1 << 20])), (323, (LONG, [1 << 20]))])
        for data, options, words in (
                (b"II*\0", (), "is no TIFF"), (good[:40], (), "is no TIFF"), (good[:-200], (), "TIFF"),
                (good[:9] + b"\xff" * 60 + good[69:], (), "is damaged"), (huge, (), "at most"),
                (tiles, (), "tiles of"), (tiff(more=[(277, (SHORT, [3]))]), (), "has 3 bands"),
                (tiff(more=[(258, (SHORT, [64])), (339, (SHORT, [1]))]), (), "64 bits"),
                (tiff(more=[(258, (SHORT, [1]))]), (), "1 bits"), (tiff(HEIGHTS[:1]), (), "no grid"),
                (tiff(keys=[(1024, 2)]), (), "in degrees"), (tiff(keys=[(2048, 4326)]), (), "in degrees"),
                (tiff(keys=[(1024, 3)]), (), "middle of the Earth"), (tiff(no_data="-9,999"), (), "is no number"),
                (tiff(georeference=False, more=[(34264, (DOUBLE, [1.0] * 16))]), (), "on a line"),
                (tiff(more=[(42112, (ASCII, b'<Item name="SCALE" role="scale">2</Item>\0'))]), (), "a scale or an offset"), (tiff(more=[(259, (SHORT, [9999]))]), (), "is damaged"),
                (tiff(), ("--spacing", "2"), "leave out --spacing")):
            with self.subTest(words):
                done = self.client.run("load", self.write("bad.tif", data), *options)
                self.assertEqual(done.returncode, 5, done)
                line, = done.stderr.splitlines()
                self.assertIn(words, line)
        # No cut and no changed byte brings more than a refusal or a scene.
        for _ in range(60):
            data = bytearray(good)
            data[RANDOM.integers(0, len(data))] = RANDOM.integers(0, 256)
            done = self.client.run("load", self.write("bad.tif", bytes(data)), "--name", "bad", "--replace")
            self.assertIn(done.returncode, (0, 5), done)


if __name__ == "__main__":
    main()
