#!/usr/bin/env python3
"""Tests what is said beside a picture: notes about options without effect, about cameras that see
nothing, about samples that are missing; what may continue a picture; what a file says of itself.

  notes_test.py RAYNESTD RAYNEST
"""
import base64
import json
import signal
import struct

import numpy

from daemon import Client, Daemon, DaemonTest, PATIENCE, main, until
from exr import read_exr, read_texts

VIEW = ("--size", "64x36", "--lookat", "0,6,18,0,4,0")
SIZE = ("--size", "64x36")
LIT = ("--integrator", "path", *VIEW)


def triangles(*names):
    """A glTF of a mesh of one triangle for each name; "" leaves the name out."""
    positions = struct.pack("<9f", -1, -1, 0, 1, -1, 0, 0, 1, 0)
    named = [{"name": name} if name else {} for name in names]
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [*range(len(names))]}],
        "nodes": [{"mesh": i, "translation": [2.5 * i, 0, 0]} for i in range(len(names))],
        "materials": named,
        "meshes": [{**name, "primitives": [{"attributes": {"POSITION": 0}, "material": i}]}
                   for i, name in enumerate(named)],
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(positions).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [-1, -1, 0], "max": [1, 1, 0]}]})


def png_chunks(data, wanted):
    """Returns the chunks of a kind of a PNG."""
    chunks, at = [], 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == wanted:
            chunks.append(data[at + 8:at + 8 + length])
        at += 12 + length
    return chunks


def png_texts(data):
    """Returns the uncompressed text chunks of a PNG."""
    parts = [chunk.partition(b"\0") for chunk in png_chunks(data, b"tEXt")]
    return {key.decode(): value.decode() for key, _, value in parts}


class Notes(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.json("load", "builtin:forest?trees=20", "--name", "woods")
        cls.three = cls.out / "three.gltf"
        cls.three.write_text(triangles("", "left", "left"))

    def says(self, code, says, *arguments, client=None):
        """Runs a command that ends with `code`; returns its stderr, in which all of `says` stand."""
        done = (client or self.client).run(*arguments)
        self.assertEqual(done.returncode, code, f"{arguments}: {done.stdout}{done.stderr}")
        for words in (says,) if isinstance(says, str) else says:
            self.assertIn(words, done.stderr + done.stdout)
        return done.stderr

    def test_options_without_effect_are_named(self):
        to = ("-o", self.out / "a.png")
        woods = ("render", "woods", *VIEW)
        error = self.says(0, "no effect with integrator primary: --env, --env-rotate, --sun, --noise, --tonemap", *woods, "--sun", "130,35",
                          "--noise", "0.1", "--tonemap", "agx", "--env", "sky", "--env-rotate", "-5", *to)
        self.assertEqual(error.count("\n"), 1, error)
        self.says(0, "no effect with integrator ao: --depth, --env, --sun", *woods, "--integrator", "ao", "--spp", "1",
                  "--sun", "130,35", "--env", "sky", "--depth", "3", *to)
        self.says(0, "no effect with integrator path: --ao-distance; no effect on an EXR, which is linear: --exposure",
                  *woods, "--integrator", "path", "--spp", "1", "--ao-distance", "2", "--exposure", "1", "-o", self.out / "a.exr")
        quiet = self.says(0, "", *woods, "--integrator", "path", "--spp", "1", "--depth", "3", "--sun", "130,35", "--exposure", "1", *to)
        self.assertNotIn("no effect", quiet)
        self.assertNotIn("no effect", self.says(0, "", "resume", self.out / "a.exr", "--spp", "2"))

    def test_a_mask_that_hides_all_is_blamed_and_not_the_camera(self):
        for command in ("render", "heatmap"):
            error = self.says(0, "no instance shares a bit with --mask 00000000", command, "woods", *VIEW, "--mask", "0", "-o", self.out / "m.png")
            self.assertNotIn("--lookat", error)
        self.says(0, "sees nothing; to frame the scene take --lookat", "render", "woods", *SIZE, "--lookat", "0,9000,0,0,9999,1",
                  "-o", self.out / "m.png")

    def test_a_picture_that_frames_the_scene_blames_what_was_asked_for(self):
        """Small triangles far apart, between which all rays of few pixels pass."""
        name = self.out / "thin.obj"
        name.write_text("".join(f"v {x} 0 0\nv {x + 0.01} 0 0\nv {x} 0.01 0\nf -3 -2 -1\n" for x in range(0, 1400, 7)))
        for words, says in (((), "no ray met anything; ask for more pixels"),
                            (("--mask", "1"), "--mask leaves nothing to see, or the parts are too small for its pixels"),
                            (("--intersector", "procedural_mask", "--mask", "1"), "--mask or the intersector procedural_mask leaves")):
            error = self.says(0, "nothing, though it frames the scene: " + says, "render", name, "--size", "8x8", *words,
                              "-o", self.out / "thin.png")
            self.assertNotIn("--lookat", error)
        self.client.json("load", self.three, "--name", "unseen")
        self.client.json("edit", "unseen", "--hide", "*")
        self.says(0, "all instances are hidden by masks of their own", "render", "unseen", *SIZE, "-o", self.out / "unseen.png")

    def test_what_is_complete_or_cut_short_blames_no_camera(self):
        file = self.out / "full.exr"
        self.client.json("render", "woods", *LIT, "--spp", "4", "-o", file)
        told = self.client.json("resume", file, "--spp", "4")
        self.assertEqual((told["rays"], told["seconds"]), (0, 0))
        self.assertNotIn("sees nothing", " ".join(told["notes"]))
        late = self.out / "late.exr"
        error = self.says(8, ("fewer samples than the 65536 per pixel", f"raynest resume {late} --spp 65536 adds the others"),
                          "render", "woods", *LIT, "--spp", "65536", "--deadline", "1", "-o", late)
        self.assertNotIn("sees nothing", error)
        self.assertRegex(error, r"pixels have \d+ to \d+ of 65536 samples, [\d.]+ on average")

    def test_a_picture_of_a_file_names_the_file_to_continue_it(self):
        late = self.out / "file.exr"
        self.says(8, f"raynest resume {late} --spp 65536 adds the others", "render", self.three, *SIZE,
                  "--integrator", "path", "--spp", "65536", "--deadline", "1", "-o", late)
        error = self.says(5, ("file.exr was made of 'three-", "with --scene"), "resume", late, "--spp", "65536")
        self.assertNotIn("raynest load", error)
        few = self.out / "few.exr"
        self.client.json("render", self.three, *SIZE, "--integrator", "path", "--spp", "1", "-o", few)
        self.says(0, "", "resume", few, "--spp", "2", "--scene", self.three)

    def test_what_cannot_continue_a_picture(self):
        file = self.out / "lit.exr"
        self.client.json("render", "woods", *LIT, "--spp", "2", "--env", "sky", "-o", file)
        for other in ("none", self.out / "absent.hdr"):
            self.says(2, f"was lit with --env sky, not {other}: leave --env out", "resume", file, "--spp", "4", "--env", other)
        self.client.json("load", self.three, "--name", "three")
        self.says(2, "was made of another scene, or the scene has changed since", "resume", file, "--spp", "4", "--scene", "three")
        hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n"
        (self.out / "a.hdr").write_bytes(hdr + bytes([128, 128, 128, 129] * 2))
        (self.out / "b.hdr").write_bytes(hdr + bytes([128, 128, 128, 128] * 2))
        self.client.json("render", "woods", *LIT, "--spp", "2", "--env", self.out / "a.hdr", "-o", file)
        self.says(2, "was lit by another picture than --env names", "resume", file, "--spp", "4", "--env", self.out / "b.hdr")
        self.client.json("resume", file, "--spp", "4", "--env", self.out / "a.hdr")
        self.client.json("render", "woods", *VIEW, "-o", file)
        self.says(5, "is no lit picture", "resume", file, "--spp", "4")

    def test_a_wanted_error_has_samples_to_reach_it(self):
        told = self.client.json("render", self.three, *SIZE, "--integrator", "ao", "--noise", "0.004", "-o", self.out / "n.exr")
        samples = numpy.array(self.layer("n.exr", "samples"))
        self.assertGreater(samples.max(), 16)
        self.assertLessEqual(samples.max(), 1024)
        self.assertIn("ask for more --spp than 1024", " ".join(told["notes"]))
        self.says(0, ("the error is still above --noise 0.0001", "ask for more --spp than 32"), "render", "woods", *LIT,
                  "--noise", "0.0001", "--spp", "32", "-o", self.out / "n.exr")

    def layer(self, name, layer):
        return read_exr((self.out / name).read_bytes())[2][layer]

    def test_pngs_and_exrs_say_what_made_them(self):
        self.client.json("heatmap", "woods", *VIEW, "--diff", "mask=1", "-o", self.out / "h.png")
        texts = png_texts((self.out / "h.png").read_bytes())
        self.assertEqual((texts["raynest:scene"], texts["raynest:metric"], texts["raynest:other_mask"]), ("woods", "total", "1"))
        self.assertIn("raynest:range", texts)
        for count in ("traversed", "necessary"):
            for name, read in (("h.png", png_texts), ("h.exr", read_texts)):
                self.client.json("heatmap", "woods", *VIEW, "--count", count, "-o", self.out / name)
                self.assertEqual(read((self.out / name).read_bytes())["raynest:count"], count)
        for name, read in (("p.png", png_texts), ("p.exr", read_texts)):
            self.client.json("render", "woods", *VIEW, "-o", self.out / name)
            texts = read((self.out / name).read_bytes())
            self.assertEqual((texts["raynest:scene"], texts["raynest:integrator"]), ("woods", "primary"))

    def test_the_legend_names_scene_and_camera(self):
        """The pictures are the same, so only their legends can differ."""
        self.client.json("load", "builtin:forest?trees=20", "--name", "grove")

        def shown(scene, look_at):
            self.client.json("heatmap", scene, *SIZE, "--lookat", look_at, "-o", self.out / "l.png")
            return b"".join(png_chunks((self.out / "l.png").read_bytes(), b"IDAT"))
        first = shown("woods", "0,6,18,0,4,0")
        self.assertEqual(first, shown("woods", "0,6,18,0,4,0"))
        self.assertNotEqual(first, shown("grove", "0,6,18,0,4,0"))
        self.assertNotEqual(first, shown("woods", "0,6,18,0,2,-18"))
        self.client.json("unload", "grove")

    def test_a_difference_names_what_differs_and_shows_how_much(self):
        told = self.client.json("heatmap", "woods", *VIEW, "--diff", "mask=1", "-o", self.out / "d.png")
        self.assertIn("mask FFFFFFFF less that of 'woods'", told["notes"][0])
        self.assertTrue(told["notes"][0].endswith("mask 00000001"), told["notes"])
        # One tree in a wide picture: few pixels differ, by much.
        few = ("--size", "256x144", "--lookat", "0,6,400,0,4,0")
        told = self.client.json("heatmap", "woods", *few, "--diff", "intersector=opaque", "-o", self.out / "d.npy")
        differences = abs(numpy.load(self.out / "d.npy").astype(numpy.int64))
        self.assertEqual(numpy.percentile(differences, 99, method="inverted_cdf"), 0)
        self.assertEqual(told["range_high"], numpy.percentile(differences[differences > 0], 99, method="inverted_cdf"))
        self.assertGreater(told["range_high"], 1)

    def test_a_ranking_is_of_one_scene(self):
        for more in ((), ("-o", self.out / "d.png")):
            self.says(2, "--top ranks the work of one scene and --diff compares two", "heatmap", "woods", *VIEW, "--top", "3",
                      "--diff", "intersector=opaque", *more)
        page = self.out / "d.html"
        self.client.json("heatmap", "woods", *VIEW, "--diff", "intersector=opaque", "--top", "3", "-o", page)
        text = page.read_text()
        for heading in ("Diagnosis", "Instances", "Meshes"):
            self.assertIn(f"<h2>{heading} (woods epoch 1, alpha_mask alone)</h2>", text)
        self.assertIn("<h2>Counters per ray, difference</h2>", text)
        self.assertIn("figure:first-child img { background", text)
        self.client.json("heatmap", "woods", *VIEW, "-o", page)
        self.assertIn("<h2>Diagnosis</h2>", page.read_text())

    def test_rankings_tell_the_nameless_apart_and_what_to_mend_first(self):
        self.client.json("load", self.three, "--name", "nameless", "--replace")
        numbers = self.client.run("info", "nameless", "--meshes").stdout
        self.assertIn("#0", numbers)
        ranked = self.client.run("heatmap", "nameless", *SIZE, "--top", "5").stdout
        self.assertRegex(ranked.split("MESH")[1], r"(?m)^#0 ")
        self.assertNotIn("without a name", ranked)
        done = self.client.run("heatmap", "woods", *VIEW, "--top", "5").stdout
        findings = done.split("diagnosis:")[1].strip().splitlines()
        document = self.client.json("heatmap", "woods", *VIEW, "--top", "5")["findings"]
        for line, finding in zip(findings, document, strict=True):
            self.assertIn(f"; {100 * finding['share']:.1f} % of all work; ", line)

    def test_files_of_other_programs_are_refused_at_once(self):
        (self.out / "x.fbx").write_text("v 0 0 0\n")
        client = Client(self.raynest, self.daemon.uri)
        for command in (("info",), ("render", "-o", "x.png"), ("heatmap", "-o", "x.png")):
            process = client.start(command[0], "x.fbx", *command[1:], cwd=self.out)
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 5, errors)
            self.assertIn("from there as .glb", errors)


class Endings(DaemonTest):
    """Detached jobs of a daemon that ends."""

    def start(self, milliseconds, samples):
        daemon = Daemon(self.raynestd, "--drain-ms-max", str(milliseconds))
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:forest?trees=20", "--name", "woods")
        job = client.json("render", "woods", "--integrator", "path", "--size", "128x72", "--spp", str(samples), "--detach",
                          "-o", "x.exr")["job"]
        return daemon, client, job

    def test_a_running_one_is_waited_for(self):
        daemon, client, job = self.start(int(1000 * PATIENCE), 256)
        waiting = client.start("wait", str(job))
        until(lambda: [each for each in client.json("jobs")["jobs"] if each["kind"] == "wait"])
        daemon.process.send_signal(signal.SIGTERM)
        output, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual((waiting.returncode, errors), (0, ""), output)
        self.assertIn("is done", output)
        self.assertEqual(daemon.process.wait(PATIENCE), 0, daemon.log())
        daemon.folder.cleanup()

    def test_one_that_takes_too_long_is_told(self):
        daemon, client, job = self.start(300, 65536)
        waiting = client.start("wait", str(job))
        until(lambda: [each for each in client.json("jobs")["jobs"] if each["kind"] == "wait"])
        daemon.process.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.process.wait(PATIENCE), 3, daemon.log())
        self.assertIn("drain_took_too_long", daemon.log())
        _, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual(waiting.returncode, 6, errors)
        self.assertIn("start this again", errors)
        daemon.folder.cleanup()


if __name__ == "__main__":
    main()
