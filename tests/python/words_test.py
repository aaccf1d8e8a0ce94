#!/usr/bin/env python3
"""The command line and Python say the same thing with the same word and type.

  words_test.py RAYNESTD RAYNEST FLATC
"""
import base64
import json
import math
from unittest import mock

import numpy as np

import raynest
from raynest import _limits
from with_daemon import WithDaemon, main

DOWN = ["0.3,50,0.4,0,-1,0", "0,50,0,0,1,0"]  # a hit and a miss


def subtrees():
    """Two equal subtrees of two triangles each, in which all names differ."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    data = "data:application/octet-stream;base64," + base64.b64encode(corners.tobytes()).decode()
    return {
        "asset": {"version": "2.0"}, "buffers": [{"uri": data, "byteLength": corners.nbytes}],
        "bufferViews": [{"buffer": 0, "byteLength": corners.nbytes}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [0, 0, 0], "max": [1, 1, 0]}],
        "materials": [{"name": "felt", "alphaMode": "MASK"}],
        "meshes": [{"name": "flag", "primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"name": "a", "children": [2, 3]},
                  {"name": "b", "translation": [9, 0, 0], "children": [4, 5]},
                  {"name": "x", "mesh": 0}, {"name": "y", "mesh": 0, "translation": [0, 0, -5]},
                  {"name": "p", "mesh": 0}, {"name": "17", "mesh": 0, "translation": [0, 0, -5]}]}


class Words(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        file = cls.out / "pair.gltf"
        file.write_text(json.dumps(subtrees()))
        np.save(cls.out / "balls.npy", np.array([[0, 0, 0, 1], [5, 0, 0, 2]], np.float32))
        cls.pair = cls.client.load(file)
        cls.balls = cls.client.load(cls.out / "balls.npy", primitive="sphere")
        cls.scenes = (cls.woods, cls.pair, cls.balls)

    def equal(self, python, cli, where=""):
        """As JSON reads them: the same keys, and values of the same type."""
        self.assertIs(type(python), type(cli), f"{where}: {python!r} and {cli!r}")
        if isinstance(cli, dict):
            self.assertEqual(sorted(python), sorted(cli), where)
            for key in cli:
                self.equal(python[key], cli[key], f"{where}.{key}")
        elif isinstance(cli, list):
            self.assertEqual(len(python), len(cli), where)
            for i, (a, b) in enumerate(zip(python, cli)):
                self.equal(a, b, f"{where}[{i}]")
        elif not where.endswith("seconds"):
            self.assertEqual(python, cli, where)
            if isinstance(cli, float):
                self.assertFalse(cli == 0 and math.copysign(1, cli) < 0, f"{where} is -0")

    def test_scenes_are_described_alike(self):
        for scene in self.scenes:
            cli = self.cli.json("info", scene.name)
            cli.pop("epo")      # a request of its own, which `info` sends besides
            self.equal(dict(scene.info), cli, scene.name)
            loaded = self.cli.json("info", scene.name, "--meshes", "--materials")
            self.equal({"meshes": scene.meshes, "materials": scene.materials}, loaded, scene.name)
            self.assertEqual(cli["meshes"], len(loaded["meshes"]))
            self.assertEqual(cli["materials"], len(loaded["materials"]))
            self.assertEqual(cli["instanced_triangles"],
                             sum(m["triangles"] * m["placements"] for m in loaded["meshes"]))
            self.assertEqual(len(cli["box_min"]), 3)
        self.equal(self.client.scenes(), self.cli.json("scenes")["scenes"])

    def test_meshes_and_materials_have_the_names_of_the_file(self):
        self.assertEqual(self.pair.meshes, [
            {"name": "flag", "triangles": 1, "records": 0, "placements": 4}])
        self.assertEqual(self.pair.materials, [
            {"name": "felt", "alpha_mode": "MASK", "triangles": 1, "placements": 4}])
        self.assertEqual(self.balls.meshes, [
            {"name": "spheres", "triangles": 0, "records": 2, "placements": 1}])
        self.assertEqual(self.balls.info["records"], {"sphere": 2})
        table = self.cli.run("info", "pair", "--meshes").stdout.splitlines()
        self.assertEqual(table[1].split(), ["flag", "1", "0", "4"])
        self.assertIn("2 sphere", self.cli.run("info", "balls").stdout)

    def test_a_list_of_parts_goes_on_from_page_to_page(self):
        document = subtrees()
        document["materials"] *= 300
        (self.out / "many.gltf").write_text(json.dumps(document))
        many = self.client.load(self.out / "many.gltf")
        self.assertEqual(len(many.materials), 300)
        self.assertEqual(len(self.cli.json("info", "many", "--materials")["materials"]), 300)

    def test_paths_are_named_alike_and_found_by_their_texts(self):
        texts = {0: "a/x", 1: "a/y", 2: "b/p", 3: "b/%317"}
        for path, text in texts.items():
            cli = self.cli.json("path", "pair", path)
            self.equal(self.pair.path(path), cli)
            self.equal(self.pair.path(text), cli)
            self.equal(self.cli.json("path", "pair", text), cli)
            self.assertEqual((cli["path"], cli["name"]), (path, text))
            self.assertEqual("/".join(step["name"] for step in cli["steps"]), text)
            self.assertEqual(self.cli.run("path", "pair", path).stdout, text + "\n")
            self.assertEqual(self.cli.run("path", "pair", text).stdout, f"{path}\n")
        # The second of two equal subtrees has the nodes of its own.
        self.assertEqual([step["node"] for step in self.pair.path(3)["steps"]], [1, 5])
        self.assertEqual(self.pair.path_of(list(texts)), list(texts.values()))
        with mock.patch.object(_limits, "structure_paths_max", 3):     # for one request
            self.assertEqual(self.pair.path_of(list(texts)), list(texts.values()))
        np.testing.assert_array_equal(self.pair.path_ids(list(texts.values())), list(texts))
        self.assertEqual(self.pair.path_ids("b/p"), 2)
        self.equal(self.woods.path(7), self.cli.json("path", "woods", 7))
        miss = self.cli.json("path", "pair", 2**64 - 1)
        self.equal(miss, {"path": 2**64 - 1, "name": self.pair.path_of(2**64 - 1), "steps": []})
        for wrong in ("a", "a/p", 4, "99999999999999999999"):
            self.assertEqual(self.cli.run("path", "pair", wrong).returncode, 2)
            with self.assertRaises(raynest.UsageError):
                self.pair.path(wrong)

    def test_user_ids_are_nodes(self):
        rays = np.array([[0.2, 0.2, 9, 0, 0, -1], [9.2, 0.2, 9, 0, 0, -1], [9.2, 0.2, -1, 0, 0, -1]])
        hits = self.pair.trace(rays, fields=("uid", "path"))
        self.assertEqual(hits["uid"].tolist(), [2, 4, 5])
        self.assertEqual(self.pair.path_of(hits["path"]), ["a/x", "b/p", "b/%317"])

    def test_masks_choose_placements(self):
        rays = np.array([[0.2, 0.2, 9, 0, 0, -1], [9.2, 0.2, 9, 0, 0, -1]])
        rules = {"b*": 0x2, "*x": 0x4}
        file = self.out / "pair.gltf"
        masked = self.client.load(file, "masked", masks=rules)
        for mask, seen in ((0x1, [False, False]), (0x2, [False, True]), (0x4, [True, False]),
                           (0x6, [True, True])):
            hits = masked.trace(rays, kind="any", mask=mask)["hit"]
            # a/y stands behind a/x, and keeps all bits.
            behind = masked.trace(rays, mask=mask, fields=("path",))["path"]
            self.assertEqual([bool(h) for h in hits], [True, seen[1]])
            self.assertEqual(masked.path_of(behind[:1]), ["a/x" if seen[0] else "a/y"])
        words = [word for glob, mask in rules.items() for word in ("--set-mask", f"{glob}={mask:x}")]
        cli = self.cli.json("load", file, "--name", "masked", *words)
        self.assertEqual(cli["hash"], masked.info["hash"])
        self.assertNotEqual(cli["hash"], self.pair.info["hash"])
        warned = self.client.load(file, "warned", masks=[("nothing", 1)])
        self.assertIn("'nothing=1' changes nothing", str(warned.info["warnings"]))
        for rule in ("=1", "a", "a=", "a=xyz", "a=123456789"):
            done = self.cli.run("load", file, "--set-mask", rule)
            self.assertEqual((done.returncode, "raynest load --help" in done.stderr), (2, True))
        for masks in ({"": 1}, {"a": -1}, {"a": 2**32}, {"a": 0.5}, [("a",)], ["ab"], [(1, 1)]):
            with self.assertRaises(raynest.UsageError):
                self.client.load(file, "never", masks=masks)

    def test_masks_reach_into_built_in_scenes(self):
        def leaf(scene):
            return next(i for i in range(500) if scene.path_of(i).count("/") == 1)
        tree = self.woods.path_of(leaf(self.woods)).split("/")[0]
        masked = self.client.load("builtin:forest?trees=20", "one", masks={"*": 1, f"{tree}*": 2})
        rays = raynest.generators.camera(size=(64, 36))
        seen = masked.trace(rays, mask=2, fields=("path",))["path"]
        names = masked.path_of(np.unique(seen[seen != 2**64 - 1]))
        self.assertTrue(all(name.startswith(tree) for name in names), names)

    def test_variants_are_described_alike(self):
        self.equal(self.client.variants(), self.cli.json("variants")["variants"])
        # The defaults that are shown can be passed back.
        rays = np.array([[0.2, 0.2, 9, 0, 0, -1]])
        for variant in self.client.variants():
            params = {param["name"]: param["default"] for param in variant["params"]}
            default = self.pair.trace(rays, intersector=variant["name"])
            self.same(self.pair.trace(rays, intersector=variant["name"], params=params), default)

    def test_hits_are_the_same_numbers_and_a_hit_is_true_or_false(self):
        rays = np.array([[float(x) for x in ray.split(",")] for ray in DOWN])
        words = [word for ray in DOWN for word in ("--ray", ray)]
        done = self.cli.run("--json", "query", "woods", *words, "--fields", "t,path,uid,uv")
        lines = [json.loads(line) for line in done.stdout.splitlines()]
        hits = self.woods.trace(rays, fields=("t", "path", "uid", "uv", "hit"))
        hit = lines[0]["hits"][0]
        for key in ("t", "path", "uid"):
            self.assertEqual(np.array(hit[key]).astype(hits[key].dtype), hits[key][0], key)
        self.assertEqual(lines[1]["hits"], [])
        self.assertEqual(hits["hit"].tolist(), [1, 0])
        for fields in (("--kind", "any"), ("--fields", "t,hit")):
            done = self.cli.run("--json", "query", "woods", *words, *fields)
            for line, expected in zip(map(json.loads, done.stdout.splitlines()), (True, False)):
                found = [line["hit"]] if "hit" in line else [h["hit"] for h in line["hits"]]
                self.assertTrue(all(value is expected for value in found), line)
        # Straight down the axis: a normal has zeros, none of them negative.
        done = self.cli.run("--json", "query", "balls", "--ray", "0,0,9,0,0,-1", "--fields",
                            "ng,position")
        self.assertNotIn("-0,", done.stdout)
        self.assertNotIn("-0]", done.stdout)

    def test_outcomes_have_the_same_words(self):
        self.woods.trace(np.array([[0.3, 50, 0.4, 0, -1, 0]]))
        self.outcome("query", "--ray", DOWN[0], "-o", self.out / "h.npz")
        self.woods.render(size=(16, 8), spp=1)
        self.outcome("render", "--size", "16x8", "--samples", 1, "-o", self.out / "r.npy")
        self.woods.heatmap(size=(16, 8))
        self.outcome("heatmap", "--size", "16x8", "-o", self.out / "c.npy")

    def outcome(self, command, *words):
        cli = self.cli.json(command, "woods", *words)
        for key in ("file", "width", "height"):
            cli.pop(key, None)
        python = {key: value for key, value in self.client.outcome.items() if key != "heat"}
        self.equal(python, cli, command)

    def test_jobs_are_described_alike(self):
        job = self.woods.trace(np.array([[0.3, 50, 0.4, 0, -1, 0]]), detach=True).wait()
        self.assertEqual(self.cli.run("wait", job.number, "--deadline", 30).returncode, 0)
        self.equal(self.client.jobs(), self.cli.json("jobs")["jobs"])
        self.equal(job.info, self.cli.json("wait", job.number))
        endless = raynest.generators.hemisphere(np.full((20000, 3), 3.0), [0, 1, 0], samples=65536)
        job = self.woods.trace(endless, kind="any", reduce="hit_fraction", detach=True)
        self.assertEqual(self.cli.run("wait", job.number, "--deadline", 0.05).returncode,
                         raynest.DeadlineError.exit_code)
        job.cancel()


if __name__ == "__main__":
    main()
