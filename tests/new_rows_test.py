#!/usr/bin/env python3
"""Things are one row each, and what they do: adds one of each kind to a copy of the tree (added_rows.py). With
tests/run.sh --long it builds the copy and uses them from the command line, from Python and in the documents.

  new_rows_test.py SOURCE_DIR BUILD_DIR CMAKE
"""
import array
import base64
import json
import os
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import zlib

from added_rows import ADDITIONS, Tree, run

SOURCE, BUILD, CMAKE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]


def png_mean(path):
    """Means of R, G, B and A of an 8-bit RGBA picture."""
    data, at, packed = path.read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height = struct.unpack(">II", body[:8])
        if kind == b"IDAT":
            packed += body
        at += 12 + length
    raw, stride, rows = zlib.decompress(packed), 4 * width, [bytes(4 * width)]
    for y in range(height):
        kind, line = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        for x in range(stride):
            left, corner = (line[x - 4], rows[-1][x - 4]) if x >= 4 else (0, 0)
            up = rows[-1][x]
            paeth = min((left, up, corner), key=lambda p, c=left + up - corner: abs(c - p))
            line[x] = (line[x] + (0, left, up, (left + up) // 2, paeth)[kind]) & 255
        rows.append(bytes(line))
    return [sum(sum(row[c::4]) for row in rows[1:]) / (width * height) for c in range(4)]


def lit_scene(material, light):
    """A square of two metres that faces +z; a light stands far in front of it."""
    points = array.array("f", [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0]).tobytes()
    return json.dumps({
        "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [light]}},
        "buffers": [{"byteLength": len(points), "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(points).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": len(points)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3"}],
        "materials": [material], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"mesh": 0}, {"translation": [0, 0, 100], "extensions": {"KHR_lights_punctual": {"light": 0}}}]})


class Written(unittest.TestCase):
    """The copy of the tree, with what is added to it."""

    @classmethod
    def setUpClass(cls):
        cls.scratch = pathlib.Path(tempfile.mkdtemp(prefix="raynest-rows-"))
        cls.addClassCleanup(shutil.rmtree, cls.scratch)
        cls.tree = Tree(SOURCE, cls.scratch / "tree")
        for add in ADDITIONS:
            add(cls.tree)
        run(sys.executable, cls.tree.root / ".ci/lists.py")
        run(sys.executable, cls.tree.root / ".ci/lists.py", "--check")

    def page(self):
        return (self.tree.root / "protocol/PROTOCOL.md").read_text()

    def test_documents_have_the_rows(self):
        for row in ("| `pairs` | u32 | pairs of nodes per ray |", "| `square_on` |", "| Echo | 40 |", "| `half` | x / 2 |",
                    "| `twice` | `environment`", "| `echoes_max` | 256 |", "`paper`", "| 24 | TOO_LOUD | 5 | speak lower |", "| `miss_fraction` | miss_fraction f32 |", "| `idle` | nobody |"):
            self.assertIn(row, self.page())


@unittest.skipUnless("RAYNEST_LONG" in os.environ, "tests/run.sh --long builds the copy")
class NewRows(Written):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        build = cls.scratch / "build"
        target = "v3" if "avx2" in pathlib.Path("/proc/cpuinfo").read_text() else "v2"
        run(CMAKE, "-S", cls.tree.root, "-B", build, "-G", "Ninja", "-C", SOURCE / ".ci/release.cmake",
            f"-DRAYNEST_TARGETS={target}", "-DRAYNEST_CUDA=OFF", "-DRAYNEST_WERROR=ON", "-DRAYNEST_TESTS=OFF",
            "-DRAYNEST_BENCH=OFF")
        run(CMAKE, "--build", build, "--target", "raynestd", "raynest", "raynest_packs")
        cls.bin = build / "bin"
        cls.server = f"unix:{cls.scratch}/socket"
        environment = {**os.environ, "RAYNEST_BUILTIN_PACKS": str(build / "lib/raynest")}
        cls.daemon = subprocess.Popen([cls.bin / "raynestd", "--listen", cls.server, "--ready-file",
                                       cls.scratch / "ready", "--log-level", "warn"], env=environment)
        cls.addClassCleanup(cls.daemon.wait)
        cls.addClassCleanup(cls.daemon.terminate)
        until = time.monotonic() + 60
        while not (cls.scratch / "ready").exists():
            if cls.daemon.poll() is not None or time.monotonic() > until:
                raise AssertionError("the daemon does not start")
            time.sleep(0.05)
        cls.raynest("load", "builtin:forest?trees=20", "--name", "woods")

    @classmethod
    def raynest(cls, *words):
        return run(cls.bin / "raynest", "--server", cls.server, *words)

    def python(self, program):
        return run(sys.executable, "-c", "import sys, raynest; from raynest import generators\n"
                   "client = raynest.connect(sys.argv[1]); woods = client.scene('woods')\n" + program, self.server,
                   env={**os.environ, "PYTHONPATH": str(self.tree.root / "client/python")})

    def test_a_counter_is_a_column_and_a_metric(self):
        self.assertIn("| pairs ", self.raynest("heatmap", "--help"))
        self.raynest("heatmap", "woods", "--metric", "pairs", "--size", "32x32", "-o", self.scratch / "pairs.png")
        table = self.raynest("query", "woods", "--ray", "8,50,-8,0,-1,0", "--fields", "nodes,pairs", "--json")
        self.assertRegex(table, r'"nodes":[1-9]')
        told = self.python("c = woods.trace([8, 50, -8, 0, -1, 0], fields=('nodes', 'pairs'))\n"
                           "print(c['nodes'][0] > 0, c['pairs'][0] == 2 * c['nodes'][0], c['pairs'].dtype)")
        self.assertEqual(told.split(), ["True", "True", "uint32"])

    def test_a_generator_makes_rays(self):
        self.assertRegex(self.raynest("query", "--help"), r"square_on +size, camera, lookat, pose, scale, range")
        self.raynest("query", "woods", "--generate", "square_on", "size=4x4", "scale=2", "--fields", "direction",
                     "-o", self.scratch / "rays.npz")
        told = self.python("rays = generators.square_on(size=(4, 4), scale=2)\n"
                           "print(woods.trace(rays, fields=('direction',))['direction'][0].tolist())")
        self.assertEqual(told.strip(), "[0.0625, -0.0625, -1.0]")
        refused = subprocess.run([self.bin / "raynest", "--server", self.server, "query", "woods", "--generate",
                                  "square_on"], capture_output=True, text=True)
        self.assertEqual(refused.returncode, 2)
        self.assertIn("generator square_on needs scale", refused.stderr)

    def mean_of(self, name, material, light):
        """Mean red and green of a picture that the square fills."""
        scene = self.scratch / f"{name}.gltf"
        scene.write_text(lit_scene(material, light))
        self.raynest("load", scene, "--name", name)
        return self.picture_of(name)

    def picture_of(self, scene):
        picture = self.scratch / f"{pathlib.Path(scene).stem}.png"
        self.raynest("render", scene, "--integrator", "direct", "--spp", "4", "--size", "8x8", "--lookat",
                     "0,0,2,0,0,0", "--fov", "40", "--env", "none", "--tonemap", "none", "--exposure", "0",
                     "-o", picture)
        return png_mean(picture)

    def test_a_material_and_a_light_of_a_file_are_named_by_extras(self):
        point = {"type": "point", "intensity": 1}
        glow = {"extensions": {"RAYNEST_materials_glow": {"glowFactor": 1}}, "extras": {"raynest": {"material": "glow"}}}
        self.assertEqual([round(x) for x in self.mean_of("glowing", glow, point)][:2], [255, 0])
        plain = {"pbrMetallicRoughness": {"metallicFactor": 0}}
        even = {**point, "extras": {"raynest": {"light": "even", "gain": 3}}}
        self.assertLess(self.mean_of("dark", plain, point)[1], 10)
        self.assertGreater(self.mean_of("even", plain, even)[1], 200)
        # An export has them, too.
        for name, shown in (("glowing", 0), ("even", 1)):
            again = self.scratch / f"{name}-again.glb"
            self.raynest("export", name, "-o", again)
            self.assertEqual(self.raynest("info", again, "--json").count("not supported"), 0)
            self.assertGreater(self.picture_of(again)[shown], 200)

    def test_a_request_is_answered(self):
        told = self.python("print(client.connection.ask('Echo', {'text': 'hello'}, 'Echoed')['text'])\n"
                           "try: client.connection.ask('Echo', {'text': '\\x07'}, 'Echoed')\n"
                           "except raynest.UsageError as error: print(str(error).partition(' [request')[0])")
        self.assertEqual(told.splitlines(), ["hello", "`text` is not printable UTF-8"])

    def test_an_error_has_its_code_and_class(self):
        told = self.python("try: client.connection.ask('Echo', {'text': 'HELLO'}, 'Echoed')\n"
                           "except raynest.InvalidError as error: print(error.name, str(error).partition(' [request')[0])")
        self.assertEqual(told.strip(), "TOO_LOUD it shouts")

    def test_a_reducer_answers(self):
        self.assertIn("miss_fraction", self.raynest("query", "--help"))
        told = self.python("from raynest import generators\n"
                           "points = [[x, 0.01, 0.5] for x in range(-9, 9)]\n"
                           "above = generators.hemisphere(points, [[0, 1, 0]] * 18, samples=256)\n"
                           "hit, miss = (woods.trace(above, reduce=name)[name] for name in ('hit_fraction', 'miss_fraction'))\n"
                           "print(abs(hit + miss - 1).max() < 1e-6, 0 < miss.mean() < 1)")
        self.assertEqual(told.split(), ["True", "True"])

    def test_an_intersector_hides_triangles(self):
        self.assertIn("sees triangles of even numbers", self.raynest("variants"))
        told = self.python("import numpy as np\n"
                           "rays = generators.pinhole(64, size=(64, 64), look_at=((0, 2, 20), (0, 2, 0)))\n"
                           "all_of, even = (woods.trace(rays, fields=('hit', 'prim'), intersector=name) for name in ('opaque', 'even_triangles'))\n"
                           "print((all_of['prim'][all_of['hit'] != 0] % 2).any(), (even['prim'][even['hit'] != 0] % 2).any(), even['hit'].any())")
        self.assertEqual(told.split(), ["True", "False", "True"])

    def test_a_backend_is_asked(self):
        self.assertIn("idle", self.raynest("query", "--help"))
        told = self.python("woods.trace([8, 50, -8, 0, -1, 0], worker='auto'); print(client.outcome['worker'])\n"
                           "try: woods.trace([8, 50, -8, 0, -1, 0], worker='idle')\n"
                           "except raynest.Error as error: print(str(error).partition(' [request')[0])")
        self.assertEqual(told.splitlines()[0], "cpu")
        self.assertIn("the idle worker: it does nothing", told)

    def test_an_integrator_reads_its_settings_and_no_others(self):
        self.assertRegex(self.raynest("render", "--help"), r"twice\s+\(two\s+bounces\)")
        shown = (self.bin / "raynest", "--server", self.server, "render", "woods", "--integrator", "twice", "--spp", "1",
                 "--size", "8x8", "-o", self.scratch / "twice.png")
        for option, idle in ((("--env", "sky"), False), (("--ao-distance", "2"), True)):
            said = subprocess.run([*map(str, shown), *option], capture_output=True, text=True)
            self.assertEqual((said.returncode, "no effect" in said.stderr), (0, idle), said.stderr)

    def test_a_setting_of_an_integrator_reaches_it(self):
        self.assertRegex(self.raynest("render", "--help"), r"--turns NUMBER in \[1, 4\]\s+for\s+twice:\s+how\s+often\s+a\s+path\s+turns\s+\(2\)")
        lit = ("render", "woods", "--integrator", "twice", "--spp", "4", "--size", "16x16")
        pictures = []
        for words in ((), ("--turns", "2"), ("--turns", "4")):
            self.raynest(*lit, *words, "-o", self.scratch / "turns.exr")
            pictures.append((self.scratch / "turns.exr").read_bytes())
        self.assertEqual(pictures[0], pictures[1])
        self.assertNotEqual(pictures[0], pictures[2])
        said = subprocess.run([self.bin / "raynest", "--server", self.server, *lit, "--turns", "5", "-o", self.scratch / "no.exr"],
                              capture_output=True, text=True)
        self.assertEqual(said.returncode, 2, said.stderr)
        told = self.python("lit = dict(integrator='twice', spp=4, size=(16, 16))\n"
                           "two, four = (woods.render(**lit, turns=turns)['rgba'] for turns in (None, 4))\n"
                           "print((two != four).any())\n"
                           "try: woods.render(**lit, turns=5)\n"
                           "except raynest.UsageError as error: print(str(error))\n"
                           "print('turns, for twice: how often a path turns (2)' in woods.render.__doc__)")
        self.assertEqual(told.splitlines(), ["True", "turns of 5: it must be a whole number from 0 to 4", "True"])
        self.assertIn('turns: {"field": "turns", "option": "--turns"', (self.tree.root / "server/web/lists.js").read_text())

    def test_a_tone_map_and_a_palette_draw(self):
        self.assertIn("half", self.raynest("render", "--help"))
        for words in (("render", "woods", "--integrator", "ao", "--spp", "1", "--tonemap", "half"),
                      ("heatmap", "woods", "--palette", "paper")):
            self.raynest(*words, "--size", "32x32", "-o", self.scratch / "look.png")

    def test_a_limit_is_an_option(self):
        self.assertRegex(run(self.bin / "raynestd", "--help"), "--echoes-max UINT=256 ")

    def test_a_command_runs(self):
        self.assertEqual(self.raynest("beat"), "it beats\n")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
