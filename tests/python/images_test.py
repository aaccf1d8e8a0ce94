#!/usr/bin/env python3
"""Tests pictures and heat maps as arrays: their files, what they answer, and how Jupyter shows them.

  images_test.py RAYNESTD RAYNEST FLATC
"""
import copy
import html.parser
import pickle
import struct
import zlib

import numpy as np

import raynest
from raynest._requests.job import signed_statistics
from with_daemon import WithDaemon, main

VIEW = {"size": (64, 36), "look_at": ([0, 6, 18], [0, 4, 0])}


def read_png(data):
    """Pixels of a PNG whose rows have no filter, as Image.png() writes it."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, parts = 8, {}
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        parts[kind] = data[at + 8:at + 8 + size]
        check, = struct.unpack_from(">I", data, at + 8 + size)
        assert check == zlib.crc32(kind + parts[kind])
        at += 12 + size
    width, height = struct.unpack_from(">II", parts[b"IHDR"])
    rows = np.frombuffer(zlib.decompress(parts[b"IDAT"]), np.uint8).reshape(height, 1 + 4 * width)
    assert (rows[:, 0] == 0).all()
    return rows[:, 1:].reshape(height, width, 4)


class Pictures(WithDaemon):
    def test_statistics_of_a_difference_are_signed(self):
        less = self.woods.heatmap(intersector="opaque", diff={"intersector": "alpha_mask"}, **VIEW)
        heat = self.client.outcome["heat"]
        counts = np.asarray(less).astype(np.int64)
        self.assertLess(heat["min"], 0)
        for name, share in (("p50", 50), ("p90", 90), ("p99", 99)):
            self.assertEqual(heat[name], np.percentile(counts, share, method="inverted_cdf"), name)
        self.assertEqual((heat["min"], heat["max"]), (counts.min(), counts.max()))
        below = signed_statistics({"range_low": -9.0, **dict.fromkeys(("min", "p50", "p90", "p99", "max"), 2**32 - 5)})
        self.assertEqual({below[name] for name in ("min", "p50", "p90", "p99", "max")}, {-5})

    def test_a_picture_is_an_array_and_a_png(self):
        picture = self.woods.render(**VIEW)
        self.assertIsInstance(picture, raynest.Image)
        self.assertEqual((picture.shape, picture.dtype), ((36, 64, 4), np.uint8))
        np.testing.assert_array_equal(read_png(picture.png()), picture)
        self.assertEqual(picture._repr_png_(), picture.png())
        self.assertIsNone(picture[0]._repr_png_())
        with self.assertRaisesRegex(raynest.UsageError, "whole picture"):
            picture[0].png()
        self.assertIs(type(picture.mean()), np.float64)


class HeatMaps(WithDaemon):
    def test_counts_are_an_array_that_numpy_takes(self):
        heat = self.woods.heatmap(**VIEW)
        self.assertIsInstance(heat, raynest.Heatmap)
        self.assertEqual((heat.shape, heat.dtype), ((36, 64), np.uint32))
        self.assertIs(type(heat.counts), np.ndarray)
        self.assertIs(type(heat + 1), np.ndarray)
        self.assertIs(type(heat.max()), np.uint32)
        self.assertEqual(heat.max(), heat.outcome["heat"]["max"])
        self.assertEqual(heat.outcome["heat"]["p90"], np.percentile(heat, 90, method="inverted_cdf"))

    def test_a_png_has_the_colours_asked_for(self):
        heat = self.woods.heatmap(metric="prims", palette="viridis", **VIEW)
        whole = self.woods.heatmap(metric="prims", palette="viridis", encode="png", **VIEW)
        self.assertEqual(heat.png(), whole)
        gray = self.woods.heatmap(metric="prims", palette="gray", range=(0, 9), encode="png", **VIEW)
        self.assertEqual(heat.png(palette="gray", range=(0, 9)), gray)
        self.assertNotEqual(gray, whole)
        with self.assertRaisesRegex(TypeError, "palette, scale, range"):
            heat.png(colour="red")

    def test_the_same_rays_are_ranked_and_explained(self):
        heat = self.woods.heatmap(intersector="opaque", **VIEW)
        told = heat.top(3)
        self.assertEqual(told["total"]["work"], int(heat.sum()))
        self.assertEqual(len(told["meshes"]["rows"]), 3)
        self.assertEqual(told["intersector"], "opaque")
        y, x = np.unravel_index(heat.argmax(), heat.shape)
        self.assertEqual(heat.explain(int(x), int(y))["totals"]["total"], heat.max())
        self.assertEqual(heat.top(1, level=1)["level"], 1)
        with self.assertRaisesRegex(raynest.UsageError, "outside"):
            heat.explain(64, 0)

    def test_jupyter_shows_a_map_with_its_numbers(self):
        heat = self.woods.heatmap(**VIEW)
        self.assertEqual(heat._repr_png_(), heat.png())
        page = heat._repr_html_()
        self.assertIn("data:image/png;base64,", page)
        self.assertIn(f"max {heat.max()}", page)
        self.assertIn("woods epoch 1", page)
        for part in (heat[3:5], copy.copy(heat), pickle.loads(pickle.dumps(heat))):
            self.assertIsNone(part._repr_png_())
            self.assertIsNone(part._repr_html_())
            with self.assertRaisesRegex(raynest.UsageError, "without the view"):
                part.top()

    def test_names_are_text_in_jupyter(self):
        name = "<img src=x onerror=alert(1)>"
        scene = self.client.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name=name)
        self.addCleanup(scene.unload)
        page = scene.heatmap(size=(16, 9))._repr_html_()
        images = []
        parser = html.parser.HTMLParser()
        parser.handle_starttag = lambda tag, attributes: images.append(dict(attributes)) if tag == "img" else None
        parser.feed(page)
        self.assertEqual([image["src"][:5] for image in images], ["data:"])
        self.assertNotIn("<img src=x", page)

    def test_without_the_daemon_numbers_are_shown(self):
        client = raynest.connect(self.daemon.uri)
        heat = client.scene("woods").heatmap(**VIEW)
        client.close()
        self.assertIsNone(heat._repr_png_())
        self.assertIsNone(heat._repr_html_())
        self.assertIn("Heatmap", repr(heat))

    def test_an_exr_of_every_level_is_received_whole(self):
        self.assertEqual(self.woods.heatmap(encode="exr", **VIEW)[:4], b"\x76\x2f\x31\x01")

    def test_a_detached_map_is_counts(self):
        heat = self.woods.heatmap(**VIEW)
        fetched = self.woods.heatmap(detach=True, **VIEW).wait().fetch()
        np.testing.assert_array_equal(heat, fetched)
        with self.assertRaisesRegex(raynest.UsageError, "without the view"):
            fetched.png()


class Differences(WithDaemon):
    def test_a_difference_is_signed(self):
        masked = self.woods.heatmap(**VIEW).astype(np.int64)
        opaque = self.woods.heatmap(intersector="opaque", **VIEW)
        difference = self.woods.heatmap(diff={"intersector": "opaque"}, **VIEW)
        self.assertEqual(difference.dtype, np.int32)
        np.testing.assert_array_equal(difference, masked - opaque)
        back = self.woods.heatmap(intersector="opaque", diff={"intersector": "alpha_mask"}, **VIEW)
        np.testing.assert_array_equal(back, -difference)
        heat = self.client.outcome["heat"]
        self.assertEqual((heat["min"], heat["max"]), (back.min(), back.max()))
        self.assertLess(heat["min"], 0)
        fetched = self.woods.heatmap(diff={"intersector": "opaque"}, detach=True, **VIEW).wait().fetch()
        np.testing.assert_array_equal(fetched, difference)

    def test_scenes_and_parameters_are_compared(self):
        grove = self.client.load("builtin:forest?trees=8", "grove")
        masked = self.woods.heatmap(**VIEW).astype(np.int64)
        difference = self.woods.heatmap(diff=grove, **VIEW)
        np.testing.assert_array_equal(difference, masked - grove.heatmap(**VIEW))
        self.assertEqual(difference._repr_png_(), self.woods.heatmap(diff=grove, encode="png", **VIEW))
        strict = self.woods.heatmap(params={"cutoff": 0.9}, **VIEW)
        difference = self.woods.heatmap(diff={"params": {"cutoff": 0.9}}, **VIEW)
        np.testing.assert_array_equal(difference, masked - strict)

    def test_what_cannot_be_compared_is_refused(self):
        with self.assertRaisesRegex(raynest.UsageError, "diff of 3"):
            self.woods.heatmap(diff=3)
        with self.assertRaisesRegex(TypeError, "no option colour"):
            self.woods.heatmap(diff={"colour": 1})
        with self.assertRaises(raynest.UsageError):
            self.woods.heatmap(diff={"params": {"cutof": 1}}, **VIEW)
        with self.assertRaises(ValueError):
            self.woods.heatmap(size=(9, 9)) - self.woods.heatmap(size=(8, 8))


if __name__ == "__main__":
    main()
