#!/usr/bin/env python3
"""Bad input to lit pictures: each is mended with one line, or refused with one line and the right
exit code; nothing is half-written, and the daemon stays.

  bad_light_test.py RAYNESTD RAYNEST
"""
import base64
import json
import math
import os
import struct
import subprocess
import zlib

from daemon import DaemonTest, PATIENCE, main, until
from exr import read_exr, with_values

VIEW = ("--size", "48x32", "--lookat", "0,0,4,0,0,0")
PATH = ("--integrator", "path", *VIEW, "--spp", "4")
INTEGRATORS = ("ao", "direct", "path")


def png(width, height, rows=None):
    """A grey PNG; its header may claim more than its rows hold."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    if rows is None:
        rows = (b"\0" + b"\x80" * width) * height
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def square(material=None, normals=(0, 0, 1) * 4, light=None, height=0.5, images=()):
    """A glTF of a square around zero that faces +Z, with texture coordinates. Each image is a texture."""
    places = (-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0)
    binary = struct.pack("<12f", *places) + struct.pack("<12f", *normals) + struct.pack("<8f", 0, 1, 1, 1, 1, 0, 0, 0)
    binary += struct.pack("<6H", 0, 1, 2, 0, 2, 3)
    views = [(0, 48), (48, 48), (96, 32), (128, 12)]
    accessors = [{"bufferView": i, "componentType": 5126, "count": 4, "type": kind}
                 for i, kind in enumerate(("VEC3", "VEC3", "VEC2"))]
    accessors[0].update(min=[-1, -1, 0], max=[1, 1, 0])
    accessors.append({"bufferView": 3, "componentType": 5123, "count": 6, "type": "SCALAR"})
    file = {
        "asset": {"version": "2.0"}, "materials": [material or {}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}],
        "buffers": [{"byteLength": len(binary),
                     "uri": "data:application/octet-stream;base64," + base64.b64encode(binary).decode()}],
        "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in views],
        "accessors": accessors}
    if images:
        file["images"] = [{"uri": uri} for uri in images]
        file["textures"] = [{"source": i} for i in range(len(images))]
    if light is not None:
        file["extensionsUsed"] = ["KHR_lights_punctual"]
        file["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
        file["nodes"].append({"name": "lamp", "translation": [0, 0, height], "extensions": {"KHR_lights_punctual": {"light": 0}}})
    return file


def textured(name):
    return {"name": "board", "pbrMetallicRoughness": {name: {"index": 0}}}


class BadLight(DaemonTest):
    def load(self, file, picture=None):
        """Loads a glTF as `bad`, with its picture a.png; returns the warnings."""
        (self.out / "bad.gltf").write_text(json.dumps(file))
        if picture is not None:
            (self.out / "a.png").write_bytes(picture)
        return self.client.json("load", self.out / "bad.gltf", "--name", "bad", "--replace")["warnings"]

    def rendered(self, *words):
        """Renders `bad` with all integrators: every value must be finite. Returns the layers of the last."""
        for integrator in INTEGRATORS:
            done = self.client.run("--json", "render", "bad", "-o", self.out / "a.exr", *VIEW, "--integrator", integrator, "--spp",
                                   "4", *words)
            self.assertEqual(done.returncode, 0, done.stderr)
            _, _, layers = read_exr((self.out / "a.exr").read_bytes())
            for name, values in layers.items():
                self.assertTrue(all(map(math.isfinite, values)), f"{integrator}: layer {name}")
        return layers, json.loads(done.stdout)

    def refused(self, code, says, *words):
        self.client.fails(code, says, *words)
        self.assertTrue(self.daemon.alive())

    def test_textures_that_cannot_be_used_are_left_out_with_a_line_each(self):
        whole = png(64, 64)
        cases = {
            "missing": (None, "names the file 'a.png', which is missing"),
            "empty": (b"", "picture 0 ('a.png')"),
            "no picture": (b"no picture at all", "not a PNG, JPEG or WebP"),
            "cut short": (whole[:len(whole) // 2], "damaged or cut short"),
            "broken": (whole[:50] + b"\xff" * 8 + whole[58:], "damaged or cut short"),
            "zero-size": (png(0, 0, b"\0"), "header"),
            "huge": (png(20000, 20000, b"\0"), "20000 x 20000 pixels; at most 16384 a side"),
            "much decoded": (png(16384, 16384, b"\0"), "MiB decoded are allowed"),
        }
        for slot in ("baseColorTexture", "metallicRoughnessTexture"):
            for name, (data, says) in cases.items():
                with self.subTest(slot=slot, name=name):
                    (self.out / "a.png").unlink(missing_ok=True)
                    lines = self.load(square(textured(slot), images=["a.png"]), data)
                    self.assertEqual(len(lines), 1, lines)
                    self.assertIn(says, lines[0])
                    self.assertIn("material 0 ('board') is shown without it", lines[0])
                    self.rendered()
        # Many materials, one bad texture: still one line.
        file = square(textured("baseColorTexture"), images=["a.png"])
        file["materials"] *= 5
        lines = self.load(file, b"none")
        self.assertEqual(len(lines), 1, lines)
        self.assertIn("and 4 others are shown without it", lines[0])

    def test_lights_that_make_no_sense_are_left_out_with_a_line(self):
        nan = json.dumps(square(light={"type": "point", "intensity": 12345.5}))
        for number, code, says in (("1e999", 5, "is not valid JSON"), ("NaN", 5, "is not valid JSON"),
                                   ("-1", 0, "negative, not finite or beyond"), ("1e300", 0, "light 0 has a colour or intensity"),
                                   ("3e38", 0, "beyond 1e+30 and is left out")):
            with self.subTest(number=number):
                (self.out / "bad.gltf").write_text(nan.replace("12345.5", number))
                done = self.client.run("--json", "load", self.out / "bad.gltf", "--name", "bad", "--replace")
                self.assertEqual(done.returncode, code, done.stderr)
                self.assertIn(says, done.stdout + done.stderr)
                if code == 0:
                    self.assertEqual(len(json.loads(done.stdout)["warnings"]), 1)
                    self.rendered()

    def test_normals_that_are_none_do_no_harm(self):
        nan = float("nan")
        none, odd = "triangles are 0 or not finite; such faces are shown flat", "point against the faces"
        for name, normals, says in (("zero", (0, 0, 0) * 4, none), ("one zero", (0, 0, 0) + (0, 0, 1) * 3, none),
                                    ("nan", (nan, 0, 1) * 4, none), ("infinite", (math.inf, 0, 0) * 4, none),
                                    ("huge", (3e38, 3e38, 3e38) * 4, ""), ("tiny", (0, 0, 1e-44) * 4, ""),
                                    ("along the surface", (1, 0, 0) * 4, ""), ("backwards", (0, 0, -1) * 4, odd)):
            with self.subTest(name=name):
                lines = self.load(square(normals=normals, material={"pbrMetallicRoughness": {"roughnessFactor": 0.2}}))
                self.assertEqual(len(lines), 1 if says else 0, lines)
                self.assertIn(says, "".join(lines))
                layers, told = self.rendered("--env", "sky")
                self.assertEqual(told["dropped"], 0)
                self.assertGreater(max(layers["R"]), 0)
                self.assertLess(max(layers["R"]), 1e6)

    def test_factors_out_of_range_are_mended_with_a_line(self):
        for pbr, says in (({"roughnessFactor": -3}, "roughnessFactor"), ({"roughnessFactor": 1e308}, "roughnessFactor"),
                          ({"metallicFactor": 77}, "metallicFactor"), ({"baseColorFactor": [1, 2]}, "baseColorFactor"),
                          ({"baseColorFactor": [1e308, 0, 0, 1]}, "base colour"), ({"baseColorFactor": [5, 5, 5, 1]}, "base"),
                          ({"baseColorFactor": [-1, 0, 0, 1]}, "base")):
            with self.subTest(pbr=pbr):
                lines = self.load(square({"pbrMetallicRoughness": pbr}))
                self.assertEqual(len(lines), 1, lines)
                self.assertIn(says, lines[0])
                self.assertEqual(self.rendered("--env", "sky")[1]["dropped"], 0)
        # No roughness at all is a mirror.
        self.load(square({"pbrMetallicRoughness": {"roughnessFactor": 0, "metallicFactor": 1}}))
        self.assertEqual(self.rendered("--env", "sky")[1]["dropped"], 0)

    def test_sizes_and_samples_that_make_no_picture_are_refused(self):
        self.load(square())
        to = ("render", "bad", "-o", self.out / "x.png", "--integrator", "path")
        for size in ("0x0", "0x9", "9x0", "-1x9", "99999999999x9", "16385x9", "9", "x", "nanx2"):
            self.refused(2, "--size", *to, "--size", size)
        for spp in ("0", "-1", "65537", "99999999999999999999", "1e3", "nan", ""):
            self.refused(2, "--spp", *to, "--spp", spp)
        for option, value in (("--depth", "-1"), ("--depth", "99999999"), ("--noise", "-1"), ("--noise", "nan"), ("--exposure", "nan"),
                              ("--exposure", "1e9"), ("--ao-distance", "nan"), ("--ao-distance", "-1"), ("--sun", "nan,nan"),
                              ("--sun", "0,91"), ("--fov", "0"), ("--fov", "nan"), ("--fov", "180")):
            self.refused(2, option[2:], *to, option, value)
        self.assertFalse((self.out / "x.png").exists())
        (self.out / "lit.exr").unlink(missing_ok=True)
        self.client.json("render", "bad", *PATH, "-o", self.out / "lit.exr")
        for spp in ("0", "65537", "x"):
            self.refused(2, "--spp", "resume", self.out / "lit.exr", "--spp", spp)

    def test_an_environment_that_is_no_picture_is_refused(self):
        self.load(square())
        (self.out / "empty.exr").write_bytes(b"")
        (self.out / "text.hdr").write_bytes(b"some words")
        (self.out / "zero.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 0\n")
        (self.out / "below.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y -5 +X -5\n")
        (self.out / "grey.png").write_bytes(png(8, 8))
        for name, code, says in (("empty.exr", 5, "is empty"), ("text.hdr", 2, "neither an EXR nor an HDR"),
                                 ("grey.png", 2, "neither an EXR nor an HDR"), ("zero.hdr", 2, "zero.hdr"),
                                 ("below.hdr", 2, "below.hdr"), ("absent.exr", 5, "absent.exr"), (".", 5, "")):
            with self.subTest(name=name):
                self.refused(code, says, "render", "bad", "-o", self.out / "x.png", *PATH, "--env", self.out / name)
        self.assertFalse((self.out / "x.png").exists())
        # The brightest that counts as light.
        bright = self.out / "bright.hdr"
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
        bright.write_bytes(header + bytes((255, 255, 255, 220)) * 32)
        layers, told = self.rendered("--env", bright)
        self.assertEqual(told["dropped"], 0)
        self.assertGreater(min(layers["R"]), 1e26)

    def test_pixels_of_an_environment_that_are_not_finite_light_nothing(self):
        self.load(square())
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
        grey, infinite = bytes((128, 128, 128, 129)), b"\xff" * 4
        file = self.out / "some.hdr"
        file.write_bytes(header + grey * 3 + infinite + grey * 28)
        layers, told = self.rendered("--env", file)
        self.assertIn("the environment has 1 pixel of 32 whose values are infinite or no numbers: they light nothing",
                      " ".join(told["notes"]))
        self.assertLess(max(layers["R"]), 2)
        # Nothing of them is left, not even a ring around them.
        file.write_bytes(header + grey * 3 + bytes(4) + grey * 28)
        black, told = self.rendered("--env", file)
        self.assertEqual(layers["R"], black["R"])
        self.assertNotIn("the environment has", " ".join(told["notes"]))

    def test_pixels_of_an_exr_that_are_not_finite_light_nothing(self):
        self.load(square())
        self.client.json("render", "bad", *PATH, "--env", "sky", "-o", self.out / "plain.exr")
        grey = (self.out / "plain.exr").read_bytes()
        width, height, _ = read_exr(grey)
        for channel in "RGB":
            grey = with_values(grey, channel, dict.fromkeys(range(width * height), struct.pack("<f", 0.5)))
        file, out = self.out / "odd.exr", self.out / "a.exr"

        def lit_by(picture):
            file.write_bytes(picture)
            told = self.client.json("render", "bad", *PATH, "--env", file, "-o", out)
            self.assertEqual(told["dropped"], 0)
            return " ".join(told["notes"]), [read_exr(out.read_bytes())[2][channel] for channel in "RGB"]

        # As where they are black.
        black = grey
        for channel in "RGB":
            black = with_values(black, channel, dict.fromkeys((5, 6, 7), bytes(4)))
        notes, dark = lit_by(black)
        self.assertNotIn("the environment has", notes)
        for channel in "RGB":
            odd = enumerate((math.inf, math.nan, 1e30), 5)
            notes, light = lit_by(with_values(grey, channel, {pixel: struct.pack("<f", value) for pixel, value in odd}))
            self.assertIn(f"the environment has 3 pixels of {width * height} whose values are infinite or no numbers", notes)
            self.assertEqual(light, dark)

    def test_a_picture_of_the_surroundings_is_turned(self):
        """A mirror that faces the camera shows what lies behind it: red where the picture is red."""
        self.load(square({"pbrMetallicRoughness": {"roughnessFactor": 0, "metallicFactor": 1}}))
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
        red, blue = bytes((128, 0, 0, 129)), bytes((0, 0, 128, 129))
        view = ("--size", "9x9", "--lookat", "0,0,4,0,0,0", "--fov", "1", "--integrator", "path")
        file, out = self.out / "two.hdr", self.out / "turned.exr"
        file.write_bytes(header + (blue * 5 + red * 2 + blue) * 4)  # columns 5 and 6, the middle of the right half, look to +Z

        def reds(*words):
            self.client.json("render", "bad", *view, "--spp", "4", "--env", file, "-o", out, *words)
            layers = read_exr(out.read_bytes())[2]
            return sum(layers["R"]) / (sum(layers["R"]) + sum(layers["B"]))
        self.assertGreater(reds(), 0.9)
        # Those 90 degrees clockwise before it are blue, and come to +Z when the picture turns on.
        for turn, share in ((90, 0), (-90, 0), (180, 0), (360, 1), (-360, 1)):
            self.assertAlmostEqual(reds("--env-rotate", turn), share, delta=0.1, msg=turn)
        file.write_bytes(header + (blue * 3 + red * 2 + blue * 3) * 4)
        self.assertGreater(reds("--env-rotate", 90), 0.9)
        self.assertLess(reds("--env-rotate=-90"), 0.1)
        # A picture that is continued stands as before.
        self.client.json("render", "bad", *view, "--spp", "4", "--env", file, "--env-rotate", "90", "-o", out)
        self.client.json("resume", out, "--env", file, "--spp", "8")
        resumed = out.read_bytes()
        self.client.json("render", "bad", *view, "--env", file, "--env-rotate", "90", "--spp", "8", "-o", out)
        self.assertEqual(resumed, out.read_bytes())
        self.refused(2, "--env-rotate turns a picture: give one with --env, or place the sun of the sky with --sun",
                     "render", "bad", *view, "--env-rotate", "90", "-o", out)
        for wrong in ("nan", "361", "x"):
            self.refused(2, "--env-rotate", "render", "bad", *view, "--env", file, "--env-rotate", wrong, "-o", out)

    def test_the_default_sun_gives_the_faces_of_a_box_a_tone_each(self):
        self.client.json("load", self.box(), "--name", "bad", "--replace")
        self.client.json("render", "bad", "--integrator", "path", "--spp", "64", "--size", "96x64", "-o", self.out / "box.exr")
        layers = read_exr((self.out / "box.exr").read_bytes())[2]
        tones = []
        for axis in "XYZ":
            face = [value for value, along in zip(layers["G"], layers["N." + axis]) if along > 0.999]
            self.assertGreater(len(face), 300)
            tones.append(sum(face) / len(face))
        tones.sort()
        for darker, brighter in zip(tones, tones[1:]):
            self.assertGreater(brighter, 1.25 * darker, tones)

    def box(self):
        """A cube without a camera: a square six times."""
        file, half = square({"doubleSided": True}), math.sqrt(0.5)
        turns = ((0, 0, 0, 1), (0, 1, 0, 0), (half, 0, 0, half), (-half, 0, 0, half), (0, half, 0, half), (0, -half, 0, half))
        ways = ((0, 0, 1), (0, 0, -1), (0, -1, 0), (0, 1, 0), (1, 0, 0), (-1, 0, 0))
        file["nodes"] = [{"mesh": 0, "rotation": turn, "translation": way} for turn, way in zip(turns, ways)]
        (self.out / "box.gltf").write_text(json.dumps(file))
        return self.out / "box.gltf"

    def test_samples_that_are_not_finite_are_counted_dropped_and_shown(self):
        self.load(square(light={"type": "point", "intensity": 1e30}, height=1e-5))
        near = ("--integrator", "path", "--size", "48x32", "--lookat", "0,0,0.0001,0,0,0")
        for name in ("a.exr", "a.png"):
            done = self.client.run("--json", "render", "bad", *near, "--spp", "4", "-o", self.out / name)
            self.assertEqual(done.returncode, 0, done.stderr)
            told = json.loads(done.stdout)
            self.assertGreater(told["dropped"], 0)
            self.assertIn(f"{told['dropped']} samples were not finite and count for nothing", " ".join(told["notes"]))
        _, _, layers = read_exr((self.out / "a.exr").read_bytes())
        self.assertEqual(sum(layers["dropped"]), told["dropped"])
        for dropped, samples in zip(layers["dropped"], layers["samples"]):
            self.assertEqual(dropped + samples, 4)
        for values in layers.values():
            self.assertTrue(all(map(math.isfinite, values)))
        done = self.client.run("render", "bad", *near, "--spp", "4", "-o", self.out / "a.png")
        self.assertIn("were not finite", done.stderr)
        # Such a file continues like any other.
        self.client.json("resume", self.out / "a.exr", "--spp", "8")
        resumed = (self.out / "a.exr").read_bytes()
        self.client.json("render", "bad", *near, "--spp", "8", "-o", self.out / "whole.exr")
        self.assertEqual(resumed, (self.out / "whole.exr").read_bytes())

    def test_a_full_device_is_a_line(self):
        self.load(square())
        for name in ("png", "exr"):
            full = self.out / f"full.{name}"
            full.symlink_to("/dev/full")
            self.client.fails(1, "No space left on device", "render", "bad", *PATH, "-o", full)
        with open("/dev/full", "wb") as device:
            done = subprocess.run([self.raynest, "render", "bad", *PATH, "-o", "-"], stdout=device, stderr=subprocess.PIPE, text=True,
                                  env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri), timeout=PATIENCE, check=False)
        self.assertEqual((done.returncode, done.stderr.count("\n")), (1, 1), done.stderr)
        self.assertTrue(self.daemon.alive())

    def test_a_client_that_vanishes_leaves_nothing_behind(self):
        self.load(square())
        jobs = lambda: [job for job in self.client.json("jobs")["jobs"] if job["kind"] == "render"]
        for name in ("gone.png", "gone.exr"):
            process = self.client.start("render", "bad", "--integrator", "path", "--size", "256x256", "--spp", "65536", "--progressive",
                                        "-o", self.out / name)
            until(lambda: jobs() and jobs()[0]["done"] > 0, patience=2 * PATIENCE)
            process.kill()
            process.communicate()
            until(lambda: not jobs())
        left = [entry.name for entry in self.out.iterdir() if "gone" in entry.name]
        for name in left:  # whole pictures of a pass, or none
            self.assertIn(name, ("gone.png", "gone.exr"))
        self.rendered()


if __name__ == "__main__":
    main()
