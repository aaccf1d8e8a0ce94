#!/usr/bin/env python3
"""Tests `raynest heatmap --top`: rankings add up, and name what the file names.

  blame_test.py RAYNESTD RAYNEST
"""
import base64
import json
import re
import struct

import numpy

from daemon import DaemonTest, main
from picture_test import coloured_square

VIEW = ("--size", "96x54", "--lookat", "0,6,18,0,4,0")


class Rankings(DaemonTest):
    loads = {"woods": "builtin:forest?trees=20", "hills": "builtin:terrain?size=16"}

    def rank(self, *arguments, scene="woods"):
        return self.client.json("heatmap", scene, *VIEW, *arguments)

    def refused(self, *arguments, code=2, says=""):
        self.client.fails(code, says, "heatmap", *arguments)

    def test_shares_and_remainder_are_all_of_the_heat_map_s_work(self):
        self.client.json("heatmap", "woods", *VIEW, "-o", self.out / "h.npy")
        counts = numpy.load(self.out / "h.npy")
        for level in ((), ("--level", "1")):
            told = self.rank("--top", "3", *level)
            self.assertEqual(told["total"]["work"], int(counts.sum()))
            self.assertEqual(told["rays"], counts.size)
            for table in ("instances", "meshes", "materials"):
                part = told[table]
                work = sum(row["work"] for row in part["rows"])
                self.assertEqual(work + part["others"]["work"] + part["remainder"]["work"],
                                 told["total"]["work"])
                share = sum(row["share"] for row in part["rows"])
                self.assertAlmostEqual(share + part["others"]["share"] + part["remainder"]["share"], 1)
                self.assertLessEqual(len(part["rows"]), 3)
                ranks = [row["work"] for row in part["rows"]]
                self.assertEqual(ranks, sorted(ranks, reverse=True))
                for row in part["rows"]:
                    self.assertTrue(0 <= row["wasted"] <= 1 and row["hit_rays"] <= row["rays"] <= counts.size)
                    self.assertAlmostEqual(row["work_per_ray"] * row["rays"], row["work"], places=3)

    def test_what_is_wasted_is_a_share_of_the_row_s_own_work(self):
        for table in ("instances", "meshes"):
            rows = self.rank("--top", "100")[table]["rows"]
            self.assertTrue(any(row["wasted"] > row["share"] for row in rows), rows)

    def test_rows_are_named_as_paths_and_materials_are(self):
        told = self.rank("--top", "5")
        for row in told["instances"]["rows"]:
            name = self.client.run("path", "woods", row["path"]).stdout.strip()
            self.assertTrue(name.startswith(row["name"]), (name, row))
        known = {part["name"] for part in self.client.json("info", "woods", "--materials")["materials"]}
        self.assertTrue({row["name"] for row in told["materials"]["rows"] if row["name"]} <= known)
        known = {part["name"] for part in self.client.json("info", "woods", "--meshes")["meshes"]}
        self.assertTrue({row["name"] for row in told["meshes"]["rows"]} <= known)
        levels = {row["level"] for row in self.rank("--top", "50", "--level", "1")["instances"]["rows"]}
        self.assertEqual(levels, {1})

    def test_equal_names_are_told_apart(self):
        """Two meshes, nodes and materials of one name each."""
        square = b"".join(struct.pack("<3f", *p) for p in ((0, 0, 0), (1, 0, 0), (0, 1, 0)))
        uri = "data:application/octet-stream;base64," + base64.b64encode(square).decode()
        mesh = lambda material: {"name": "oak", "primitives": [{"attributes": {"POSITION": 0}, "material": material}]}
        (self.out / "oaks.gltf").write_text(json.dumps({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2]}],
            "nodes": [{"name": "oak", "mesh": 0}, {"name": "oak", "mesh": 1, "translation": [2, 0, 0]},
                      {"name": "oak", "mesh": 1, "translation": [0, 2, 0]}],
            "meshes": [mesh(0), mesh(1)], "materials": [{"name": "bark"}, {"name": "bark"}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36, "uri": uri}]}))
        self.client.json("load", self.out / "oaks.gltf", "--name", "oaks")
        view = ("--size", "64x64", "--lookat", "1,1,5,1,1,0")
        told = self.client.json("heatmap", "oaks", *view, "--top", "9")
        done = self.client.run("heatmap", "oaks", *view, "--top", "9", "-o", self.out / "oaks.html")
        report = (self.out / "oaks.html").read_text()
        self.assertEqual(done.returncode, 0, done.stderr)
        for table, key in (("instances", "path"), ("meshes", "index"), ("materials", "index")):
            numbers = [row[key] for row in told[table]["rows"] if row["name"]]
            self.assertGreater(len(numbers), 1, told[table])
            self.assertEqual(len(set(numbers)), len(numbers))
            for row in told[table]["rows"]:
                if row["name"]:
                    name = re.escape(row["name"])
                    self.assertRegex(done.stdout, rf"(?m)^{name} .*\b{row[key]} ")
                    self.assertRegex(report, rf"<td>{name}[^\n]*</td><td>{row[key]}</td>")
        crowded = self.rank("--top", "9")["findings"]
        self.assertTrue(all(isinstance(found.get("object", found.get("material")), int) for found in crowded))

    def test_the_same_request_gives_the_same_bytes(self):
        texts = {self.client.run("--json", "heatmap", "woods", *VIEW, "--top", "9").stdout for _ in range(3)}
        self.assertEqual(len(texts), 1)

    def test_text_and_picture_come_together(self):
        done = self.client.run("heatmap", "woods", *VIEW, "--top", "4", "-o", self.out / "h.npy")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("total per ray", done.stdout)
        for word in ("INSTANCE", "MESH", "MATERIAL", "SHARE", "WASTED", "WORK/RAY", "trees above", "diagnosis"):
            self.assertIn(word, done.stdout)

    def test_an_orthographic_camera_has_a_ranking(self):
        square = json.loads(coloured_square())
        square["cameras"] = [{"type": "orthographic", "orthographic": {"xmag": 2, "ymag": 2, "znear": 0.1, "zfar": 100}}]
        square["nodes"].append({"camera": 0, "translation": [0, 0, 5]})
        square["scenes"][0]["nodes"].append(len(square["nodes"]) - 1)
        (self.out / "flat.gltf").write_text(json.dumps(square))
        self.client.json("load", self.out / "flat.gltf", "--name", "flat")
        told = self.client.json("heatmap", "flat", "--size", "32x32", "--camera", "0", "--top", "2")
        self.assertEqual(told["rays"], 32 * 32)
        # The camera shows 4 x 4 units, the square 2 x 2.
        self.assertEqual(told["meshes"]["rows"][0]["hit_rays"], 16 * 16)

    def test_a_detached_ranking_is_fetched(self):
        job = self.client.run("heatmap", "woods", *VIEW, "--top", "4", "--detach").stdout.strip()
        self.client.run("wait", job)
        self.assertEqual(self.client.json("fetch", job), self.rank("--top", "4"))

    def test_bad_input_is_one_line(self):
        self.refused("woods", "--top", "4", "--level", "9", says="there is no level 9")
        self.refused("hills", "--top", "4", "--level", "1", says="level 1")
        self.refused("woods", "--top", "0", says="--top")
        self.refused("woods", "--level", "1", "-o", self.out / "h.npy", says="--top")
        self.refused("woods", says="--output, --top or --fail-if")
        self.refused("woods", "--top", "4", "--camera", "no such", says="no such")
        self.refused("nowhere", "--top", "4", code=5, says="nowhere")
        self.refused("woods", "--top", "4", "--size", "16384x16384", says="size")
        self.refused("woods", "--top", "4", "--size", "8000x8000", "--deadline", "0.05", code=7, says="deadline")


if __name__ == "__main__":
    main()
