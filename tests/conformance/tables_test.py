"""Brings tables with queries, by the command line and by Python, to the intersector of pack/.

usage: tables_test.py BUILD_DIR PACK_DIR      Exit code 77 (skipped) if this CPU does not run the pack.
"""

import json
import os
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest

BUILD, PACKS = pathlib.Path(sys.argv[1]), sys.argv[2]
BIN = BUILD / "bin"
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "client/python"))
try:
    import numpy as np
    import raynest
except ImportError:
    raynest = None


def write_npy(path, kind, values, shape):
    header = f"{{'descr': '<{kind}4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() +
                     struct.pack(f"<{len(values)}{kind}", *values))


class Tables(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.scratch = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest tables ")))
        ready = cls.scratch / "ready.json"
        cls.daemon = subprocess.Popen(
            [str(BIN / "raynestd"), "--listen", "tcp://127.0.0.1:0", "--http", "off", "--ready-file", str(ready),
             "--pack-dir", PACKS, "--state", str(cls.scratch / "state"), "--log-level", "error"],
            env=dict(os.environ, RAYNEST_BUILTIN_PACKS=str(BUILD / "lib/raynest")))
        cls.addClassCleanup(cls.daemon.wait, 60)
        cls.addClassCleanup(cls.daemon.terminate)
        while not ready.exists():
            try:
                raise AssertionError(f"the daemon ended with {cls.daemon.wait(0.05)}")
            except subprocess.TimeoutExpired:
                pass
        cls.uri = json.loads(ready.read_text())["listen"][0]
        # Eight spheres behind each other: the ray along x meets sixteen surfaces.
        write_npy(cls.scratch / "row.npy", "f", [v for x in range(8) for v in (x, 0, 0, 0.25)], (8, 4))
        cls.expect(0, "load", cls.scratch / "row.npy", "--primitive", "sphere", "--name", "row")

    @classmethod
    def expect(cls, code, *words):
        done = subprocess.run([str(BIN / "raynest"), "--server", cls.uri, *map(str, words)], capture_output=True,
                              text=True, timeout=120)
        if done.returncode != code:
            raise AssertionError(f"{words} gave {done.returncode}: {done.stdout}{done.stderr}")
        return done.stderr if code else done.stdout

    def query(self, *settings, code=0, fields="prim,passed,weight"):
        words = [word for setting in settings for word in ("--set", setting)]
        return self.expect(code, "query", "row", "--ray", "-1,0,0,1,0,0", "--kind", "all", "--intersector", "passed",
                           "--fields", fields, *words)

    def sums(self, *settings):
        row = json.loads(self.expect(0, "--json", "query", "row", "--ray", "-1,0,0,1,0,0", "--kind", "all",
                                     "--intersector", "passed", "--fields", "prim,passed,weight",
                                     *[word for setting in settings for word in ("--set", setting)]).split("\n")[0])
        return [hit["prim"] for hit in row["hits"]], row["passed"], row["weight"]

    def file(self, name, text):
        (self.scratch / name).write_text(text)
        return f"@{self.scratch / name}"

    def test_a_table_comes_from_text_or_npy(self):
        self.assertEqual(self.sums(), ([], 16, 0))
        self.assertEqual(self.sums("stops=" + self.file("ids.txt", "2, 5\n7\n")), ([2, 2, 5, 5, 7, 7], 10, 0))
        write_npy(self.scratch / "ids.npy", "i", [5], (1,))
        self.assertEqual(self.sums(f"stops=@{self.scratch / 'ids.npy'}", "weights=" + self.file("w", "0.5 0.25")),
                         ([5, 5], 14, 0.75))
        self.assertEqual(self.sums("stops=" + self.file("empty", "")), ([], 16, 0))

    def test_a_table_that_is_wrong_is_one_line(self):
        for name, text, code, says in (
                ("stops", "1 x", 5, "holds 'x'"), ("stops", "-1", 2, "value 0 of table 'stops' is -1"),
                ("weights", "0 0 2", 2, "value 2 of table 'weights' is 2: use a number from 0 to 1"),
                ("cull", "1", 2, "'cull' is no table: use none, back"), ("stops", "1 " * 8193, 5, "table_values_max")):
            told = self.query(f"{name}=" + self.file("bad", text), code=code)
            self.assertIn(says, told)
            self.assertEqual(told.count("\n"), 1)
        write_npy(self.scratch / "two.npy", "f", [1, 2], (1, 2))
        self.assertIn("has 2 dimensions; a table has one", self.query(f"stops=@{self.scratch}/two.npy", code=5))
        self.assertIn("nowhere", self.query("stops=@nowhere", code=5))
        self.assertIn("'stops' is a table", self.query("stops=1", code=2))

    def test_variants_lists_tables(self):
        told = self.expect(0, "variants")
        self.assertIn("--set weights=@FILE  (each 0..1)  weight of the first surface, the second, ...", told)
        variants = {each["name"]: each for each in json.loads(self.expect(0, "--json", "variants"))["variants"]}
        self.assertEqual([(each["type"], each["default"]) for each in variants["passed"]["params"][:2]],
                         [("table", []), ("table", [])])

    def test_a_heat_map_of_another_table_is_another_map(self):
        shot = ["--lookat", "-3,0.1,0,0,0,0", "--size", "16x16", "--intersector", "passed"]
        ids = self.file("all.txt", " ".join(map(str, range(8))))
        told = [self.expect(0, "--json", "heatmap", "row", *shot, "--metric", "rejects", *more, "-o",
                            self.scratch / "h.exr") for more in ([], ["--set", f"stops={ids}"],
                                                                 ["--diff", f"stops={ids}"])]
        free, stopped, difference = (json.loads(each.strip().split("\n")[-1])["mean"] for each in told)
        self.assertEqual(stopped, 0)
        self.assertGreater(free, 0)
        self.assertAlmostEqual(difference, free, places=5)

    @unittest.skipIf(raynest is None, "needs numpy")
    def test_python_takes_arrays(self):
        with raynest.connect(self.uri) as client:
            scene = client.scene("row")
            rays = np.array([[-1, 0, 0, 1, 0, 0]], np.float32)
            def ask(**params):
                return scene.trace(rays, kind="all", intersector="passed", fields=["prim", "passed"], params=params)
            self.assertEqual(ask(stops=np.array([2, 5]))["prim"].tolist(), [2, 2, 5, 5])
            self.assertEqual(ask(stops=[2], weights=(0.5, 1))["passed"].tolist(), [14])
            for bad in (np.zeros((2, 2)), ["x"], [[1], [2, 3]]):
                with self.assertRaisesRegex(raynest.UsageError, "a table is a list or an array"):
                    ask(stops=bad)
            with self.assertRaisesRegex(raynest.UsageError, "8193 values"):
                ask(stops=np.zeros(8193))
            with self.assertRaisesRegex(raynest.Error, "value 0 of table 'weights' is 2"):
                ask(weights=[2])


def runs_here():
    flags = pathlib.Path("/proc/cpuinfo").read_text()
    return all(f" {flag}" in flags for flag in ("avx2", "fma", "bmi2"))


if __name__ == "__main__":
    if not runs_here():
        print("skipped: the pack of the tests is for x86-64-v3")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
