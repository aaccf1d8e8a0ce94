"""Builds the intersector and the primitive of engine/INTERSECTORS.md outside the tree, against the
installed headers, and queries them by name: in the conformance matrix (no BVH, one BVH, under
instances) and through a daemon. Builds and runs the program of engine/EMBEDDING.md.

usage: own_pack_test.py SOURCE_DIR BUILD_DIR CMAKE
"""

import json
import os
import pathlib
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest

SOURCE, BUILD, CMAKE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
BIN = BUILD / "bin"


def run(*command, **options):
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, timeout=600, **options
    )
    if done.returncode != 0:
        raise AssertionError(f"{command} gave {done.returncode}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


def files_of_the_page(name="INTERSECTORS.md"):
    """Returns {file name: text} of every fenced block that follows a line with a file name."""
    page = (SOURCE / "engine" / name).read_text()
    return dict(re.findall(r"^`([\w.]+)`\n```\w*\n(.*?)^```", page, re.M | re.S))


def write_npy(path, rows, shape):
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(128 - 10 - 1) + "\n"
    values = [value for row in rows for value in row]
    path.write_bytes(
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + struct.pack(f"<{len(values)}f", *values)
    )


class OwnPack(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.scratch = pathlib.Path(tempfile.mkdtemp(prefix="raynest own pack "))  # spaces on purpose
        cls.addClassCleanup(shutil.rmtree, cls.scratch)
        project = cls.scratch / "project"
        project.mkdir()
        for name, text in files_of_the_page().items():
            (project / name).write_text(text)
        run(CMAKE, "--install", BUILD, "--prefix", cls.scratch / "installed")
        run(CMAKE, "-S", project, "-B", cls.scratch / "build", "-G", "Ninja",
            f"-DCMAKE_PREFIX_PATH={cls.scratch / 'installed'}", "-DCMAKE_CXX_FLAGS=-Wall -Wextra")
        run(CMAKE, "--build", cls.scratch / "build")
        cls.packs = cls.scratch / "build"
        cls.start_daemon()

    def test_the_page_names_all_files(self):
        names = set(files_of_the_page())
        self.assertEqual(names, {"clip_plane.h", "intersectors.def", "CMakeLists.txt", "disc.h", "primitives.def"})

    def test_a_pack_exports_one_symbol(self):
        for pack in self.packs.glob("*.so"):
            symbols = run("nm", "-D", "--defined-only", pack).split("\n")
            self.assertEqual([line.split()[2] for line in symbols if line], ["raynest_pack"])

    def test_it_equals_the_reference_at_every_depth(self):
        told = run(BIN / "conformance", "--pack-dir", self.packs, "--intersector", "clip_plane", "--edge-rays", "50000",
                   env=dict(os.environ, RAYNEST_BUILTIN_PACKS=str(BUILD / "lib/raynest")))
        closing = told.strip().split("\n")[-1]
        self.assertRegex(closing, r"^conformance: [1-9]\d* comparisons, .* [1-9]\d* hits, 0 differing rays, 0 failures")

    def test_a_wrong_line_in_the_list_is_one_readable_error(self):
        project = self.scratch / "wrong"
        shutil.copytree(self.scratch / "project", project)
        (project / "intersectors.def").write_text("RAYNEST_INTERSECTOR(clip_plane, ClipPlane, primitives)\n")
        run(CMAKE, "-S", project, "-B", project / "build", "-G", "Ninja",
            f"-DCMAKE_PREFIX_PATH={self.scratch / 'installed'}")
        built = subprocess.run([CMAKE, "--build", project / "build"], capture_output=True, text=True, timeout=300)
        self.assertNotEqual(built.returncode, 0)
        self.assertIn("the row and the type disagree about `boxes`", built.stdout)


    # Query through a daemon that was started with --pack-dir.

    @classmethod
    def start_daemon(cls):
        ready = cls.scratch / "ready.json"
        cls.daemon = subprocess.Popen(
            [str(BIN / "raynestd"), "--listen", "tcp://127.0.0.1:0", "--ready-file", str(ready),
             "--pack-dir", str(cls.packs), "--state", str(cls.scratch / "state"), "--log-level", "error"],
            env=dict(os.environ, RAYNEST_BUILTIN_PACKS=str(BUILD / "lib/raynest")))
        cls.addClassCleanup(cls.daemon.wait, 20)
        cls.addClassCleanup(cls.daemon.terminate)
        for _ in range(600):
            if ready.exists():
                break
            if cls.daemon.poll() is not None:
                raise AssertionError("the daemon ended before it was ready")
            try:
                cls.daemon.wait(0.05)
            except subprocess.TimeoutExpired:
                pass
        cls.uri = json.loads(ready.read_text())["listen"][0]

    def raynest(self, *words):
        return run(BIN / "raynest", "--server", self.uri, *words)

    def hits(self, *words):
        lines = self.raynest("--json", "query", *words).strip().split("\n")
        return [json.loads(line) for line in lines]

    def test_variants_lists_it_with_its_parameter_and_output(self):
        told = json.loads(self.raynest("--json", "variants"))
        text = json.dumps(told)
        for word in ("clip_plane", "height", "clipped", "removes what lies above"):
            self.assertIn(word, text)

    def test_a_plane_through_instanced_trees_removes_what_is_above(self):
        self.raynest("load", "builtin:forest?trees=40", "--name", "small")
        down = ["--ray", "0.3,60,0.2,0,-1,0"]
        whole = self.hits("small", *down)[0]["hits"]
        cut = self.hits("small", *down, "--intersector", "clip_plane", "--set", "height=-1000")[0]["hits"]
        self.assertEqual(len(whole), 1)
        self.assertEqual(cut, [])
        asked = self.raynest("query", "small", *down, "--intersector", "clip_plane", "--set", "height=-1000",
                             "--fields", "t,clipped")
        self.assertIn("clipped", asked)
        self.assertRegex(asked, r"0\s+-\s+[1-9]")  # a miss, and how many surfaces the plane removed

    def test_a_primitive_of_our_own_in_a_list_in_a_bvh_and_under_instances(self):
        discs = [(x, y, 0, 0.5, 0, 0, 1) for x in range(8) for y in range(8)]
        write_npy(self.scratch / "discs.npy", discs, (64, 7))
        shift = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2]
        raised = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4]
        write_npy(self.scratch / "two.npy", [shift, raised], (2, 3, 4))
        self.raynest("load", str(self.scratch / "discs.npy"), "--primitive", "disc", "--name", "flat")
        self.raynest("load", str(self.scratch / "discs.npy"), "--primitive", "disc", "--name", "twice",
                     "--instances", str(self.scratch / "two.npy"))
        rays = ["--ray", "3.2,4.1,9,0,0,-1", "--ray", "3.5,4.5,9,0,0,-1", "--ray", "5,2,9,0.1,0,-1"]
        def clip(height):
            return ["--intersector", "clip_plane", "--set", f"height={height}"]

        for scene, t in (("flat", 9), ("twice", 5)):
            tree = self.hits(scene, *rays, *clip(100))
            without_tree = self.hits(scene, *rays, *clip(100), "--traversal", "reference")
            self.assertEqual(tree, without_tree)
            self.assertEqual(tree[0]["hits"][0]["prim"], 3 * 8 + 4)
            self.assertAlmostEqual(tree[0]["hits"][0]["t"], t, places=5)
            self.assertEqual(tree[1]["hits"], [])  # between the discs
        self.assertEqual(self.hits("twice", *rays[:2], *clip(3))[0]["hits"], [])

    def test_the_program_of_the_page_finds_the_packs_of_its_installation(self):
        project = self.scratch / "embed"
        project.mkdir()
        for name, text in files_of_the_page("EMBEDDING.md").items():
            (project / name).write_text(text)
        run(CMAKE, "-S", project, "-B", project / "build", "-G", "Ninja",
            f"-DCMAKE_PREFIX_PATH={self.scratch / 'installed'}")
        run(CMAKE, "--build", project / "build")
        clean = {name: value for name, value in os.environ.items() if not name.startswith("RAYNEST_")}
        for more in ([], [self.packs]):
            told = run(project / "build/embed", *more, cwd=self.scratch, env=clean).split("\n")
            self.assertRegex(told[0], r"^opaque on v[234]$")
            self.assertEqual([line.split(":")[0] for line in told[1:5]], ["ray 0", "ray 21", "ray 42", "ray 63"])
            for line in told[1:5]:
                self.assertRegex(line, r"t 50, triangle [01], path 0$")
            # The squares lie 20 m apart: the program's own intersector removes the first.
            self.assertEqual(told[5], "below: t 70, path 1, 1 removed")

    def test_auto_is_the_intersector_that_knows_the_primitive(self):
        write_npy(self.scratch / "two.npy", [(0, 0, 0, 1, 0, 0, 1), (0, 0, -1, 1, 0, 0, 1)], (2, 7))
        self.raynest("load", str(self.scratch / "two.npy"), "--primitive", "disc", "--name", "pair")
        told = self.raynest("info", "pair")
        self.assertRegex(told, r"(?m)^records +2 disc$")
        self.assertRegex(told, r"(?m)^intersector +auto is clip_plane$")
        self.assertEqual(json.loads(self.raynest("--json", "info", "pair"))["intersector"], "clip_plane")
        # A rising ray from below: the plane at height 0 removes nothing.
        ray = ["--ray", "0,-0.5,3,0,0,-1"]
        self.assertEqual(self.hits("pair", *ray)[0]["hits"][0]["prim"], 0)
        self.assertRegex(self.raynest("explain", "pair", *ray), r"(?m)^hit .* disc 0, t 3,")

    def test_an_intersector_that_does_not_know_the_primitive_says_so(self):
        write_npy(self.scratch / "one.npy", [(0, 0, 0, 1, 0, 0, 1)], (1, 7))
        self.raynest("load", str(self.scratch / "one.npy"), "--primitive", "disc", "--name", "one")
        done = subprocess.run([str(BIN / "raynest"), "--server", self.uri, "query", "one", "--ray", "0,0,1,0,0,-1",
                               "--intersector", "opaque"], capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 5)
        self.assertIn("was not compiled for primitives of type disc: use clip_plane", done.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
