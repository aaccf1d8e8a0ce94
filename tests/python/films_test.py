#!/usr/bin/env python3
"""Lit pictures in Python: layers as arrays, refined ones, files of surroundings, deadlines.

  films_test.py RAYNESTD RAYNEST FLATC
"""
import contextlib
import warnings

import numpy as np

import raynest
from raynest._requests.exr import read_exr
from with_daemon import WithDaemon, main

VIEW = {"size": (90, 50), "look_at": ([0, 6, 18], [0, 4, 0])}
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes([128, 0, 0, 129]) * 8


class Films(WithDaemon):
    def test_a_lit_picture_is_arrays_by_layer(self):
        layers = self.woods.render(integrator="path", spp=4, seed=2, **VIEW)
        self.assertIsInstance(layers, raynest.Layers)
        shapes = {name: (array.shape, array.dtype.str) for name, array in layers.items()}
        one = ((50, 90), "<f4")
        three = ((50, 90, 3), "<f4")
        ids = ((50, 90), "<u4")
        self.assertEqual(shapes, {"rgba": ((50, 90, 4), "<f4"), "albedo": three, "N": three, "P": three,
                                  "Z": one, "variance": one, "instance": ids, "mesh": ids,
                                  "material": ids, "samples": ids, "dropped": ids})
        self.assertTrue((layers["samples"] == 4).all())
        self.assertTrue(layers.last)
        self.assertEqual(layers.texts["raynest:seed"], "2")
        self.assertEqual(self.client.outcome["samples"], 4)
        hit = layers["mesh"] != 0xFFFFFFFF
        self.assertTrue(hit.any())
        # Positions lie on the rays: as far from the eye as depth, along the view axis, says.
        away = layers["P"][hit] - np.array([0, 6, 18], np.float32)
        axis = np.array([0, -2, -18]) / np.hypot(2, 18)
        np.testing.assert_allclose(away @ axis, layers["Z"][hit], rtol=1e-4)

    def test_paths_of_a_pixel_are_its_light(self):
        layers = self.woods.render(integrator="path", spp=3, seed=2, environment="sky", **VIEW)
        told = [self.woods.explain(pixel=(40, 30), integrator="path", sample=s, seed=2, environment="sky",
                                   **VIEW) for s in range(3)]
        np.testing.assert_allclose(np.mean([path["radiance"] for path in told], axis=0),
                                   layers["rgba"][30, 40, :3], rtol=1e-4, atol=1e-6)
        self.assertEqual(told[0]["rays"][0]["kind"], "camera")
        for wrong in ({"integrator": "primary"}, {"integrator": "path", "environment": "x.hdr"},
                      {"integrator": "path", "sample": -1}):
            with self.assertRaises(raynest.UsageError):
                self.woods.explain(pixel=(1, 1), **wrong)
        with self.assertRaises(raynest.UsageError):
            self.woods.explain([0, 0, 0, 1, 0, 0], integrator="path")

    def test_hidden_things_are_not_met(self):
        rays = raynest.generators.camera(size=(64, 48), look_at=VIEW["look_at"])
        seen = self.woods.trace(rays, fields=("inst", "object"))
        inst = np.unique(seen["inst"][seen["inst"] != 2**32 - 1])
        less = self.woods.trace(rays, fields=("inst", "object"), hide=[f"inst={inst[0]}"])
        self.assertNotIn(inst[0], less["inst"])
        only = self.woods.trace(rays, fields=("inst", "object"), only=f"inst={inst[0]}")
        self.assertEqual(set(only["inst"]) - {2**32 - 1}, {inst[0]})
        for wrong in ("inst=", "inst=x", "path=x", "oak"):
            with self.assertRaises(raynest.UsageError):
                self.woods.trace(rays, hide=[wrong])
        for wrong in (2**32, f"inst={2**32}", f"object={2**32}", f"inst={2**32 - 1}"):
            with self.assertRaises(raynest.Error):
                self.woods.trace(rays, hide=[wrong])

    def test_the_arrays_are_those_of_the_file(self):
        words = {"integrator": "ao", "spp": 3, **VIEW}
        layers = self.woods.render(**words)
        file = self.woods.render(encode="exr", **words)
        again = raynest.read_layers(file)
        self.assertEqual(set(again), set(layers))
        for name, array in layers.items():
            np.testing.assert_array_equal(again[name], array)
        picture = self.woods.render(encode="raw", **words)
        self.assertIsInstance(picture, raynest.Image)
        self.assertEqual(picture.shape, (50, 90, 4))
        job = self.woods.render(detach=True, **words)
        job.wait()
        self.assertEqual(job.fetch(), file)

    def test_a_stream_refines_to_the_same_picture(self):
        words = {"integrator": "path", "spp": 10, **VIEW}
        frames = list(self.woods.render_stream(**words))
        self.assertEqual([int(frame["samples"].max()) for frame in frames], [1, 2, 4, 8, 10])
        self.assertEqual([frame.last for frame in frames], [False] * 4 + [True])
        whole = self.woods.render(**words)
        for name, array in whole.items():
            np.testing.assert_array_equal(frames[-1][name], array)
        images = list(self.woods.render_stream(encode="raw", **words))
        self.assertEqual([image.shape for image in images], [(50, 90, 4)] * 5)
        # Leaving the loop cancels the job, and the connection goes on.
        for _ in self.woods.render_stream(integrator="path", spp=65536, size=(256, 256)):
            break
        self.assertGreater(self.client.ping(), 0)

    def test_surroundings_are_a_word_bytes_or_a_file(self):
        words = {"integrator": "path", "spp": 2, **VIEW}
        red = self.woods.render(environment=HDR, **words)["rgba"]
        self.assertGreater(red[..., 0].max(), 0)
        self.assertEqual(red[..., 1].max(), 0)
        (self.out / "red.hdr").write_bytes(HDR)
        np.testing.assert_array_equal(self.woods.render(environment=self.out / "red.hdr", **words)["rgba"], red)
        np.testing.assert_array_equal(self.woods.render(environment=HDR.replace(b"#?RADIANCE", b"#?RGBE"), **words)["rgba"], red)
        # Two halves; a turn by half of one exchanges them.
        words["look_at"] = ((0, 90, 0), (0, 99, 0), (0, 0, -1))  # at nothing but the surroundings
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n"
        bright, dim, infinite = b"\x80\x80\x80\x81", b"\x40\x40\x40\x81", b"\xff" * 4
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one = self.woods.render(environment=header + (bright * 2 + dim * 2) * 2, environment_rotate=180, **words)["rgba"]
            other = self.woods.render(environment=header + (dim * 2 + bright * 2) * 2, **words)["rgba"]
        np.testing.assert_allclose(one, other, atol=1e-3)
        self.assertGreater(one[..., 0].max(), 1.5 * one[..., 0].min())
        with self.assertWarnsRegex(raynest.RayWarning, "1 pixel of 8 whose values are infinite"):
            self.woods.render(environment=header + bright * 7 + infinite, **words)
        with self.assertRaisesRegex(raynest.UsageError, "environment_rotate= turns a picture: give one with environment="):
            self.woods.render(environment="sky", environment_rotate=180, **words)
        with self.assertRaisesRegex(raynest.UsageError, "environment_rotate"):
            self.woods.render(environment_rotate=180)
        dark = self.woods.render(environment="none", **words)["rgba"]
        self.assertEqual(dark[..., :3].max(), 0)
        with self.assertRaises(raynest.UsageError):
            self.woods.render(environment=b"nothing", **words)

    def test_a_deadline_gives_what_there_is_and_a_warning(self):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            layers = self.woods.render(integrator="path", spp=65536, size=(200, 100), deadline=1)
        self.assertTrue(any("fewer" in str(one.message) for one in caught))
        self.assertLess(layers["samples"].max(), 65536)
        self.assertTrue(self.client.outcome["incomplete"])

    def test_a_deadline_that_leaves_pixels_without_a_sample_is_told(self):
        # On a busy machine not one sample is made in a tenth of a second, which is an error.
        for deadline in (0.1, 0.2, 0.4, 0.8, 1.6, 3.2):
            with contextlib.suppress(raynest.DeadlineError), self.assertWarnsRegex(raynest.RayWarning, "fewer than"):
                self.woods.render(integrator="path", spp=65536, size=(1600, 1600), deadline=deadline, encode="png")
                break
        self.assertEqual(self.client.outcome["samples"], 0)
        self.assertTrue(self.client.outcome["incomplete"])
        self.woods.render(size=(16, 16))  # a picture without samples is not incomplete
        self.assertNotIn("incomplete", self.client.outcome)

    def test_mistakes_are_told(self):
        for words in ({"integrator": "ao", "spp": -1}, {"integrator": "path", "depth": 5000},
                      {"depth": 3}, {"environment": "sky"}, {"encode": "layers"},
                      {"integrator": "path", "sun": (1, 2, 3)}, {"integrator": "magic"}):
            with self.subTest(words=words), self.assertRaises((raynest.UsageError, raynest.InvalidError, ValueError)):
                self.woods.render(**VIEW, **words)
        for elevation in (91, -90.5, np.nan):
            with self.assertRaisesRegex(raynest.UsageError, "^sun of .*: its elevation must lie between"):
                self.woods.render(integrator="path", sun=(0, elevation), **VIEW)
        with self.assertRaises(raynest.UsageError):
            next(iter(self.woods.render_stream(integrator="primary", **VIEW)))

    def test_a_broken_exr_is_a_protocol_error(self):
        file = self.woods.render(integrator="ao", spp=1, encode="exr", **VIEW)
        for size in (0, 3, 8, 100, 500, len(file) - 5):
            with self.assertRaises(raynest.ProtocolError):
                read_exr(file[:size], 1 << 20)
        with self.assertRaises(raynest.ProtocolError):
            read_exr(file, 100)
        # The places of its four blocks stand before them; two are exchanged.
        table = next(at for at in range(len(file)) if file[at:at + 8] == (at + 32).to_bytes(8, "little"))
        moved = file[:table] + file[table + 8:table + 16] + file[table:table + 8] + file[table + 16:]
        with self.assertRaises(raynest.ProtocolError):
            read_exr(moved, 1 << 20)

    def test_positions_are_in_the_world_and_those_of_misses_are_zero(self):
        origin = np.array([5e5, 100.0, 4e6])
        corners = origin + [[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]
        square = self.client.mesh(corners, [[0, 1, 2], [0, 2, 3]], "far square", origin=tuple(origin))
        for height, fov in ((4, 0), (4000, 0.04)):
            layers = square.render(integrator="ao", spp=1, size=(64, 32), look_at=(origin + [0, height, 0.1], origin), fov=fov)
            missed = layers["mesh"] == 0xFFFFFFFF
            self.assertTrue(missed.any() and not missed.all())
            self.assertEqual(np.abs(layers["P"][missed]).max(), 0)
            self.assertLess(np.abs(layers["P"][~missed] - origin).max(), 1.01)

    def test_tiles_are_pixels_of_the_whole(self):
        view = {**VIEW, "size": (203, 97)}
        tiles = ((0, 0, 203, 16), (64, 8, 100, 40), (7, 5, 13, 11), (202, 96, 1, 1))
        for options in ({"integrator": "ao"}, {"integrator": "direct"}, {"integrator": "path", "seed": 9}):
            whole = self.woods.render(**options, spp=5, **view)
            for x, y, width, height in tiles:
                self.same(self.woods.render(**options, spp=5, tile=(x, y, width, height), **view), {
                    name: layer[y:y + height, x:x + width] for name, layer in whole.items()})
        lit = {"integrator": "path", "spp": 2, "encode": "raw", "exposure": 1.5}
        for ask in (self.woods.render, self.woods.heatmap, lambda **more: self.woods.render(**lit, **more)):
            whole = np.asarray(ask(**view))
            for x, y, width, height in tiles:
                np.testing.assert_array_equal(np.asarray(ask(tile=(x, y, width, height), **view)),
                                              whole[y:y + height, x:x + width])
        noisy = {"integrator": "path", "spp": 48, "noise": 0.2, **view}
        whole, tile = self.woods.render(**noisy), self.woods.render(tile=(64, 8, 139, 24), **noisy)
        self.same(tile, {name: layer[8:32, 64:] for name, layer in whole.items()})
        self.assertGreater(len(np.unique(tile["samples"])), 1)

    def test_a_tile_is_refused_where_it_is_no_part_of_the_whole(self):
        for said, options in (
                ("exposure", {"integrator": "path", "encode": "png", "tile": (0, 0, 8, 8)}),
                ("multiples of 64 and 8", {"integrator": "path", "noise": 0.1, "tile": (8, 0, 64, 8)}),
                ("must lie within", {"tile": (0, 0, 91, 8)}), ("must lie within", {"tile": (0, 50, 8, 1)}),
                ("must lie within", {"tile": (0, 0, 0, 8)}), ("must be", {"tile": (0, 0, 8)})):
            with self.assertRaisesRegex(raynest.UsageError, said):
                self.woods.render(**options, **VIEW)
        with self.assertRaisesRegex(raynest.UsageError, "the legend and the document"):
            self.woods.heatmap(encode="png", tile=(0, 0, 8, 8), **VIEW)


if __name__ == "__main__":
    main()
