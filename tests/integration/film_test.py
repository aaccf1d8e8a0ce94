#!/usr/bin/env python3
"""Lit pictures: layers, tone maps, passes, tiles, deadlines, resume, and equal bytes.

  film_test.py RAYNESTD RAYNEST
"""
import base64
import hashlib
import json
import os
import shutil
import struct
import subprocess

from daemon import Client, Daemon, DaemonTest, PATIENCE, main, until
from exr import read_exr, read_texts
from npy import read_npy

LAYERS = ["R", "G", "B", "A", "albedo.R", "albedo.G", "albedo.B", "N.X", "N.Y", "N.Z", "Z", "P.X", "P.Y",
          "P.Z", "instance", "mesh", "material", "samples", "variance", "dropped"]
VIEW = ("--size", "150x70")
AO = ("--integrator", "ao", *VIEW)
PATH = ("--integrator", "path", *VIEW)
# Hours of work on any machine, in many chunks.
ENDLESS = ("--integrator", "path", "--size", "256x256", "--spp", "65536")
MISS = 0xFFFFFFFF

OPEN_IN_BLENDER = """
import sys
import bpy
source, folder = sys.argv[sys.argv.index("--") + 1:]
scene = bpy.context.scene
scene.use_nodes = True
nodes, links = scene.node_tree.nodes, scene.node_tree.links
nodes.clear()
picture = nodes.new("CompositorNodeImage")
picture.image = bpy.data.images.load(source)
print("OPENED", picture.image.type, sorted(output.name for output in picture.outputs))
composite = nodes.new("CompositorNodeComposite")
render = scene.render
render.resolution_x, render.resolution_y, render.resolution_percentage = 150, 70, 100
settings = render.image_settings
settings.file_format, settings.color_depth, settings.color_mode, settings.exr_codec = "OPEN_EXR", "32", "RGBA", "ZIP"
for name in ("Combined", "albedo", "N", "Depth"):
    links.new(picture.outputs[name], composite.inputs["Image"])
    render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
"""


class Films(DaemonTest):
    loads = {"woods": "builtin:forest?trees=30"}

    def render(self, name, *words, code=0):
        """Runs `raynest render woods`; returns the file's bytes and what was told."""
        path = self.out / name
        done = self.client.run("--json", "render", "woods", "-o", path, *words)
        self.assertEqual(done.returncode, code, done.stderr)
        told = json.loads(done.stdout) if done.stdout else None
        return path.read_bytes() if path.exists() else b"", told

    def test_an_exr_has_all_layers_and_what_made_it(self):
        for integrator in ("ao", "path"):
            with self.subTest(integrator=integrator):
                file, told = self.render("a.exr", "--integrator", integrator, *VIEW, "--spp", "5", "--seed", "3")
                width, height, layers = read_exr(file)
                self.assertEqual((width, height, sorted(layers)), (150, 70, sorted(LAYERS)))
                self.assertEqual(set(layers["samples"]), {5})
                self.assertEqual(set(layers["dropped"]), {0})
                self.assertEqual((told["samples"], told["dropped"], told["incomplete"]), (5, 0, False))
                # The finished picture's error, whenever progress was looked at: root mean square over mean luminance.
                light = sum(weight * sum(layers[name]) for weight, name in ((0.2126, "R"), (0.7152, "G"), (0.0722, "B")))
                squares, count = sum(layers["variance"]) / (5 - 1), width * height
                self.assertAlmostEqual(told["noise"] / ((squares / count) ** 0.5 / (light / count)), 1, 3)
                seen = [mesh != MISS for mesh in layers["mesh"]]
                self.assertIn(True, seen)
                self.assertIn(False, seen)
                for hit, depth, instance, *normal in zip(seen, layers["Z"], layers["instance"], layers["N.X"],
                                                         layers["N.Y"], layers["N.Z"]):
                    self.assertEqual(hit, depth < 1e9)
                    self.assertEqual(hit, instance != MISS)
                    self.assertLess(sum(x * x for x in normal), 1.001)
                self.assertTrue(all(0 <= x <= 1.001 for x in layers["albedo.G"]))
                texts = read_texts(file)
                for key, value in (("integrator", integrator), ("seed", "3"), ("spp", "5"),
                                   ("hash", told["hash"]), ("epoch", "1"), ("intersector", told["intersector"]),
                                   ("camera", told["camera"])):
                    self.assertEqual(texts["raynest:" + key], value)

    def test_equal_requests_give_equal_bytes_whatever_the_threads_and_the_way(self):
        words = (*PATH, "--spp", "9")
        once, _ = self.render("b.exr", *words)
        passes, _ = self.render("c.exr", *words, "--progressive")
        self.assertEqual(once, passes)
        late, _ = self.render("d.exr", *words, "--deadline", "1000")
        self.assertEqual(once, late)
        other, _ = self.render("e.exr", *words, "--seed", "1")
        self.assertNotEqual(once, other)
        # Another daemon, with another number of threads.
        daemon = Daemon(self.raynestd, "--threads", "1")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:forest?trees=30", "--name", "woods")
        client.json("render", "woods", "-o", self.out / "f.exr", *words)
        self.assertEqual(once, (self.out / "f.exr").read_bytes())
        for traversal in ("single", "stream"):
            again, _ = self.render("g.exr", *words, "--traversal", traversal)
            self.assertEqual(once, again, traversal)

    def test_noise_ends_tiles_early_and_the_same_ones_each_time(self):
        words = (*AO, "--spp", "256", "--noise", "0.12")
        once, told = self.render("n.exr", *words)
        _, _, layers = read_exr(once)
        counts = set(layers["samples"])
        self.assertTrue(all(count % 16 == 0 for count in counts), counts)
        self.assertGreater(len(counts), 1)
        self.assertLess(min(counts), 256)
        self.assertFalse(told["incomplete"])
        passes, _ = self.render("o.exr", *words, "--progressive")
        self.assertEqual(once, passes)

    def test_a_deadline_that_leaves_pixels_without_a_sample_is_told(self):
        for deadline in ("0.1", "0.2", "0.4", "0.8", "1.6", "3.2"):  # a busy machine has not one sample in the first
            done = self.client.run("--json", "render", "woods", "-o", self.out / "early.png", "--integrator", "path",
                                   "--spp", "65536", "--size", "1600x1600", "--deadline", deadline)
            if done.returncode != 7:
                break
        self.assertEqual(done.returncode, 8, done.stderr)
        told = json.loads(done.stdout)
        self.assertEqual((told["samples"], told["incomplete"]), (0, True))

    def test_tone_maps_and_exposure(self):
        pictures = {}
        for tonemap in ("agx", "aces", "reinhard", "none"):
            file, _ = self.render("t.npy", *PATH, "--tonemap", tonemap, "--exposure", "1")
            pictures[tonemap] = read_npy(file)[2]
        self.assertEqual(len({bytes(p) for p in pictures.values()}), 4)
        dark, _ = self.render("t.npy", *PATH, "--tonemap", "none", "--exposure", "-3")
        self.assertLess(sum(read_npy(dark)[2]), sum(pictures["none"]))
        automatic, _ = self.render("t.npy", *PATH)
        brightness = sum(read_npy(automatic)[2]) / (150 * 70 * 4)
        self.assertTrue(60 < brightness < 220, brightness)
        self.client.fails(2, "unknown tonemap 'film'", "render", "woods", "-o", self.out / "x.png", *PATH, "--tonemap", "film")
        self.client.fails(2, "stops", "render", "woods", "-o", self.out / "x.png", *PATH, "--exposure", "bright")
        png, _ = self.render("p.png", *PATH)
        for text in (b"raynest:hash", b"raynest:integrator", b"raynest:seed"):
            self.assertIn(text, png)

    def test_a_deadline_gives_the_picture_so_far(self):
        done = self.client.run("render", "woods", *ENDLESS, "--deadline", "3", "-o", self.out / "so.exr", timeout=4 * PATIENCE)
        self.assertEqual(done.returncode, 8, done.stderr)
        self.assertIn("fewer samples than", done.stderr)
        width, height, layers = read_exr((self.out / "so.exr").read_bytes())
        self.assertEqual((width, height), (256, 256))
        self.assertGreater(max(layers["samples"]), 0)
        done = self.client.run("render", "woods", *ENDLESS, "--traversal", "reference", "--deadline", "0.001", "-o", self.out / "none.exr")
        self.assertEqual(done.returncode, 7, done.stderr)
        self.assertFalse((self.out / "none.exr").exists())

    def test_progressive_pictures_replace_the_file_as_they_come(self):
        path = self.out / "growing.png"
        process = self.client.start("render", "woods", "--integrator", "path", "--size", "400x300", "--spp", "4096",
                                    "--progressive", "-o", path)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        seen = set()

        def has_changed():
            if path.exists():
                data = path.read_bytes()
                self.assertTrue(data.startswith(b"\x89PNG") and data.endswith(b"IEND\xae\x42\x60\x82"))
                seen.add(hashlib.sha256(data).digest())
            return len(seen) >= 3
        until(has_changed, lambda: f"{len(seen)} pictures came", 4 * PATIENCE)

    def test_a_cancelled_job_ends_soon(self):
        process = self.client.start("render", "woods", *ENDLESS, "-o", self.out / "never.png")
        jobs = lambda: [job for job in self.client.json("jobs")["jobs"] if job["kind"] == "render"]
        until(lambda: jobs() and jobs()[0]["done"] > 0, patience=2 * PATIENCE)
        process.kill()
        process.communicate()
        until(lambda: not jobs(), patience=PATIENCE)
        self.assertFalse((self.out / "never.png").exists())

    def test_a_detached_job_shows_its_picture_so_far(self):
        job = str(self.client.json("render", "woods", "--integrator", "path", "--size", "300x200", "--spp", "65536", "--detach",
                                   "-o", "x.png")["job"])
        path = self.out / "sofar.png"

        def fetched():
            done = self.client.run("fetch", job, "-o", path)
            self.assertIn(done.returncode, (6, 8), done.stderr)
            return done.returncode == 8 and done
        done = until(fetched, patience=4 * PATIENCE)
        self.assertIn(f"job {job} goes on", done.stderr)
        self.assertTrue(path.read_bytes().startswith(b"\x89PNG"))
        self.client.run("cancel", job)
        # A finished one is what an attached one is.
        words = (*AO, "--spp", "4")
        attached, _ = self.render("att.exr", *words)
        job = str(self.client.json("render", "woods", *words, "--detach", "-o", "x.exr")["job"])
        self.client.json("wait", job)
        self.client.json("fetch", job, "-o", self.out / "det.exr")
        self.assertEqual((self.out / "det.exr").read_bytes(), attached)

    def test_every_camera_has_a_file(self):
        views = [{"type": "perspective", "perspective": {"yfov": 0.5 + 0.2 * i, "znear": 0.1}} for i in range(3)]
        positions = struct.pack("<9f", -1, -1, -4, 1, -1, -4, 0, 1, -4)
        (self.out / "three.gltf").write_text(json.dumps({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2, 3]}], "cameras": views,
            "nodes": [{"mesh": 0}, *({"camera": i, "name": f"c{i}"} for i in range(3))],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," +
                         base64.b64encode(positions).decode()}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                           "min": [-1, -1, -4], "max": [1, 1, -4]}]}))
        self.client.json("load", self.out / "three.gltf", "--name", "three")
        done = self.client.run("render", "three", *AO, "--cameras", "all", "-o", self.out / "cam.png")
        self.assertEqual(done.returncode, 0, done.stderr)
        files = [(self.out / f"cam.{i}.png").read_bytes() for i in range(3)]
        self.assertEqual(len(set(files)), 3)
        self.client.json("load", "builtin:flake?depth=2", "--name", "flake")
        self.client.fails(5, "no cameras", "render", "flake", *AO, "--cameras", "all", "-o", self.out / "cam.png")

    def test_bad_requests_are_refused_in_a_line(self):
        to = ("-o", self.out / "x.png")
        self.client.fails(2, "use one of primary, ao", "render", "woods", *to, "--integrator", "magic")
        self.client.fails(2, "", "render", "woods", *to, *AO, "--spp", "0")
        self.client.fails(2, "", "render", "woods", *to, *AO, "--spp", "100000")
        self.client.fails(2, "", "render", "woods", *to, *PATH, "--sun", "10")
        self.client.fails(2, "", "render", "woods", *to, *PATH, "--sun", "0,100")
        self.client.fails(5, "missing.exr", "render", "woods", *to, *PATH, "--env", self.out / "missing.exr")
        (self.out / "not.exr").write_bytes(b"not a picture")
        self.client.fails(2, "not.exr is neither an EXR nor an HDR", "render", "woods", *to, *PATH, "--env", self.out / "not.exr")
        self.assertTrue(self.daemon.alive())

    def test_hostile_pictures_of_the_surroundings_are_refused_in_a_line(self):
        good, _ = self.render("good.exr", *AO, "--spp", "1")
        header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n"
        for name, data, says in (("bomb.hdr", header % (60000, 60000), "60000 x 60000 pixels"),
                                 ("large.hdr", header % (16384, 16384), "MiB decoded are allowed"),
                                 ("cut.hdr", header % (64, 64) + bytes(100), "damaged or cut short"),
                                 ("cut.exr", good[:len(good) // 2], ""),
                                 ("magic.exr", good[:4], "header cannot be read"),
                                 ("noise.exr", good[:200] + bytes(i * 37 % 251 for i in range(5000)), "")):
            with self.subTest(name=name):
                (self.out / name).write_bytes(data)
                self.client.fails(2, says, "render", "woods", "-o", self.out / "x.png", *PATH, "--env", self.out / name)
                self.assertFalse((self.out / "x.png").exists())
                self.assertTrue(self.daemon.alive())

    def test_a_picture_of_the_surroundings_lights_the_scene(self):
        def hdr(red, green, blue, size=(8, 4)):
            """A Radiance file of one colour, each a power of two."""
            exponent = 129
            pixel = bytes([int(128 * red), int(128 * green), int(128 * blue), exponent])
            return (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (size[1], size[0])) + pixel * (size[0] * size[1])
        (self.out / "red.hdr").write_bytes(hdr(1, 0, 0))
        file, _ = self.render("red.exr", *PATH, "--env", self.out / "red.hdr")
        _, _, layers = read_exr(file)
        self.assertGreater(sum(layers["R"]), 100)
        self.assertEqual(sum(layers["G"]), 0)
        self.client.json("resume", self.out / "red.exr", "--spp", "20", "--env", self.out / "red.hdr")
        (self.out / "green.hdr").write_bytes(hdr(0, 1, 0))
        self.client.fails(2, "was lit by another picture than --env", "resume", self.out / "red.exr", "--spp", "24", "--env", self.out / "green.hdr")
        self.client.fails(2, "--env", "resume", self.out / "red.exr", "--spp", "24")

    def test_a_full_disk_leaves_the_old_file(self):
        if os.geteuid() != 0 or shutil.which("mount") is None:
            self.skipTest("needs a small file system")
        small = self.out / "small"
        small.mkdir()
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", small], check=False,
                          capture_output=True).returncode != 0:
            self.skipTest("needs a small file system")
        self.addCleanup(subprocess.run, ["umount", small], check=False)
        (small / "a.exr").write_bytes(b"old")
        self.client.fails(1, "", "render", "woods", *AO, "-o", small / "a.exr")
        self.assertEqual(sorted(entry.name for entry in small.iterdir()), ["a.exr"])
        self.assertEqual((small / "a.exr").read_bytes(), b"old")

    def test_blender_opens_the_file(self):
        """Its layers have names that Blender knows, and its pixels are ours."""
        if shutil.which("blender") is None:
            self.skipTest("Blender is not installed: apt-get install --no-install-recommends blender")
        file, _ = self.render("blend.exr", *PATH, "--spp", "4")
        program = self.out / "open.py"
        program.write_text(OPEN_IN_BLENDER)
        done = subprocess.run(["blender", "--background", "--factory-startup", "--python-exit-code", "1", "--python",
                               program, "--", self.out / "blend.exr", self.out], capture_output=True, text=True,
                              timeout=8 * PATIENCE, check=False)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIn("OPENED MULTILAYER ['Alpha', 'Combined', 'Depth', 'N', 'P', 'albedo']", done.stdout)
        _, _, layers = read_exr(file)
        for output, channels in (("Combined", "RGBA"), ("albedo", ("albedo.R", "albedo.G", "albedo.B")),
                                 ("N", ("N.X", "N.Y", "N.Z")), ("Depth", "ZZZ")):
            with self.subTest(output=output):
                width, height, seen = read_exr((self.out / f"{output}.exr").read_bytes())
                self.assertEqual((width, height), (150, 70))
                for theirs, ours in zip("RGBA", channels):
                    self.assertEqual(list(seen[theirs]), list(layers[ours]))


if __name__ == "__main__":
    main()
