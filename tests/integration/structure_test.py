#!/usr/bin/env python3
"""How a scene is built, for tables and wireframes; hidden instances; columns that tell of the structure.

  structure_test.py RAYNESTD RAYNEST
"""
import collections
import json

import numpy

from daemon import DaemonTest, main
from exr import read_texts
from websocket import greeted

PICTURE, CHUNK = 155, 153
CAMERA = {"kind": "camera", "settings": ["size=96x64", "lookat=0.5,2,13,0,3,0,0,1,0", "fov=50"]}
TYPES = {"u8": "u1", "u32": "<u4", "u64": "<u8", "f32": "<f4", 0: "u1", 1: "<u4", 2: "<u8", 3: "<f4"}


class Structure(DaemonTest):
    arguments = ("--http", "127.0.0.1:0")

    loads = {"forest": "builtin:forest?trees=30", "flake": "builtin:flake?depth=3"}

    def setUp(self):
        self.ws = greeted(self.daemon.http)
        self.addCleanup(self.ws.close)

    def ask(self, kind, scene="forest", **fields):
        frames = self.ws.ask("Structure", 1, {"scene": scene, "kind": kind, **fields})
        if frames[-1][0] == "Error":
            return frames[-1][2]
        text = b"".join(data[:frame["blocks"][0]["bytes"]] for _, _, frame, data in frames[:-1])
        return json.loads(text)

    def columns(self, fields, **job):
        frames = self.ws.ask("Query", 2, {"job": {"scene": "forest", **job}, "fields": fields, "generator": CAMERA})
        if frames[-1][0] == "Error":
            return frames[-1][2]
        found = {}
        for _, _, chunk, data in sorted(frames[1:-1], key=lambda frame: frame[2]["first_ray"]):
            for block in chunk["blocks"]:
                part = numpy.frombuffer(data[block["offset"]:block["offset"] + block["bytes"]], TYPES[block["dtype"]])
                found[block["name"]] = numpy.concatenate([found.get(block["name"], part[:0]), part])
        return found

    def test_objects_add_up(self):
        for scene in ("forest", "flake"):
            info = self.client.json("info", scene)
            document = self.ask("objects", scene)
            rows = document["rows"]
            self.assertEqual((document["total"], document["hash"]), (len(rows), info["hash"]))
            self.assertEqual(sum(row["triangles"] for row in rows), info["unique_triangles"])
            self.assertEqual(sum(row["triangles"] * row["placements"] for row in rows), info["instanced_triangles"])
            self.assertEqual(sum(row["nodes"] for row in rows), info["nodes"])
            self.assertEqual(max(row["height"] for row in rows), info["tree_height"])
            self.assertEqual(max(row["levels"] for row in rows), info["levels"])
            self.assertAlmostEqual(rows[-1]["sah_cost"], info["sah_cost"], delta=1e-4 * info["sah_cost"])
            tree = self.ask("tree", scene)
            self.assertEqual((tree["hash"], tree["epo"]), (info["hash"], rows[-1]["epo"]))
            self.assertAlmostEqual(tree["sah_cost"], info["sah_cost"], delta=1e-4 * info["sah_cost"])
            self.assertEqual(info["epo"], tree["epo"])
            told = self.client.run("info", scene).stdout
            if scene == "forest":
                self.assertGreater(info["epo"], 0)
                self.assertIn(f", EPO {info['epo']:.1f}, ", told)
            else:  # spheres have no triangles to look at
                self.assertIsNone(info["epo"])
                self.assertNotIn("EPO", told)
            self.assertLess(sum(row["bytes"] for row in rows), 1.05 * info["bytes"])
            for row in rows:
                self.assertTrue(0 <= row["box_share"] <= 1)
                self.assertTrue(row["epo"] is None or row["epo"] >= 0)
        self.assertEqual([row["object"] for row in self.ask("objects", first=1, count=2)["rows"]], [1, 2])
        self.assertEqual(self.ask("objects", first=10**6)["rows"], [])

    def test_equal_objects_have_equal_trees(self):
        self.client.json("load", "builtin:street", "--name", "street")
        cars = [row for row in self.ask("objects", "street")["rows"] if row["name"] == "car"]
        self.assertGreater(len(cars), 3)
        self.assertEqual(len({(row["sah_cost"], row["epo"]) for row in cars}), 1, cars)

    def test_info_says_no_epo_where_there_are_too_many_overlaps(self):
        (self.out / "triangle.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        for levels, is_known in ((3, True), (22, False)):
            objects = {"0": {"file": "triangle.off"}}
            for level in range(levels):
                objects[str(level + 1)] = {"instances": 4 * [{"object": str(level)}]}
            file = self.out / f"{levels}.rnscene.json"
            file.write_text(json.dumps({"rnscene": 1, "objects": objects, "instances": [{"object": str(levels)}]}))
            self.client.json("load", file, "--name", "nested", "--replace")
            self.assertEqual(self.client.json("info", "nested")["epo"] is not None, is_known)
            self.assertEqual(", EPO " in self.client.run("info", "nested").stdout, is_known)

    def test_placements_have_their_paths(self):
        document = self.ask("placements", count=20)
        self.assertEqual(document["total"], self.client.json("info", "forest")["instances"])
        self.assertEqual([row["path"] for row in document["rows"]], list(range(20)))
        for row in document["rows"][::6]:
            self.assertEqual(row["name"], self.client.json("path", "forest", str(row["path"]))["name"])
        last = self.ask("placements", first=document["total"] - 1)["rows"]
        self.assertEqual(len(last), 1)

    def test_boxes_contain_what_is_hit(self):
        levels = self.client.json("info", "forest")["levels"]
        found = self.columns(["t", "path", "position", "tree_depth"])
        hit = int(numpy.flatnonzero(numpy.isfinite(found["t"]))[7])
        path, point = int(found["path"][hit]), found["position"].reshape(-1, 3)[hit]
        innermost = self.ask("placements", first=path, count=1)["rows"][0]["depth"]
        document = self.ask("boxes", level=innermost, depth_max=40, one=True, first=path, count=16384)
        self.assertEqual(len(document["trees"]), 1)
        tree = document["trees"][0]
        matrix = numpy.array(tree["to_world"]).reshape(3, 4)
        inner = numpy.linalg.solve(matrix[:, :3], point - matrix[:, 3])
        boxes = numpy.array(tree["boxes"])
        room = 1e-3 * numpy.abs(boxes[:, 2:]).max()
        inside = ((boxes[:, 2:5] <= inner + room) & (boxes[:, 5:8] >= inner - room)).all(axis=1)
        self.assertTrue(inside[0], "the tree's own box")
        leaves = inside & (boxes[:, 1] == 1)
        self.assertIn(int(found["tree_depth"][hit]), boxes[leaves, 0].astype(int))
        # A range of depths, a bound, and levels.
        some = self.ask("boxes", level=0, depth_min=1, depth_max=2)["trees"][0]["boxes"]
        self.assertEqual({box[0] for box in some}, {1, 2})
        cut = self.ask("boxes", level=levels - 1, depth_max=40, count=10)
        self.assertEqual((sum(len(tree["boxes"]) for tree in cut["trees"]), cut["complete"]), (10, False))

    def test_columns_of_the_structure(self):
        found = self.columns(["t", "object", "mask", "box_share", "tree_depth", "material", "prim"])
        hits = numpy.isfinite(found["t"])
        self.assertTrue(hits.any() and not hits.all())
        rows = self.ask("objects")["rows"]
        self.assertTrue((found["object"][~hits] == 0xffffffff).all() and (found["tree_depth"][~hits] == 0xffffffff).all())
        self.assertTrue((found["mask"] == 0xffffffff).all())
        heights = numpy.array([row["height"] for row in rows])
        depth = found["tree_depth"][hits]
        self.assertLess((depth == 0xffffffff).mean(), 0.001, "nearly every triangle is found in its tree")
        known = depth != 0xffffffff
        self.assertTrue((depth[known] <= heights[found["object"][hits]][known]).all())
        share = found["box_share"][hits]
        self.assertTrue(((share >= 0) & (share <= 1.0001)).all() and share.max() > 0.1)

    def test_hiding_on_the_command_line_is_that_of_the_protocol(self):
        view = ("--generate", CAMERA["kind"], *CAMERA["settings"], "--fields", "inst,object,path,total")
        rows = lambda *words: [json.loads(line) for line in self.client.run("--json", "query", "forest", *view, *words).stdout.splitlines()]
        hits = [row["hits"][0] for row in rows() if row["hits"]]
        chosen = collections.Counter(hit["inst"] for hit in hits).most_common(1)[0][0]
        same = lambda words, **job: self.assertEqual([row["total"] for row in rows(*words)], self.columns(["total"], **job)["total"].tolist())
        same(("--hide", f"inst={chosen}"), hidden_instances=[chosen])
        same(("--only", f"inst={chosen}"), only_instances=[chosen])
        thing = next(hit["object"] for hit in hits if hit["inst"] == chosen)
        same(("--hide", f"object={thing}", "--hide", f"inst={chosen}"), hidden_objects=[thing], hidden_instances=[chosen])
        path = next(hit["path"] for hit in hits if hit["inst"] == chosen)
        name = self.client.json("path", "forest", str(path))["name"]
        for words in (("--hide", name), ("--hide", f"path={path}")):
            same(words, hidden_paths=[name])
            same(words, hidden_path_ids=[path])
        same(("--only", name, "--only", "inst=0"), only_paths=[name], only_instances=[0])
        for words, code, says in ((("--hide", "inst=x"), 2, "whole number"), (("--hide", "no/such"), 2, "the scene has no 'no'"),
                                  (("--only", "inst=100000"), 2, "there is no outermost instance 100000"), (("--hide", ""), 2, "--hide")):
            done = self.client.run("query", "forest", *view, *words)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (code, 1), done.stderr)
            self.assertIn(says, done.stderr)

    def test_what_is_hidden_and_shown_at_once_is_a_contradiction(self):
        for thing, words in (("inst=2", "outermost instance 2"), ("object=1", "object 1")):
            done = self.client.run("heatmap", "forest", "--hide", thing, "--only", thing, "-o", self.out / "x.png")
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(f"--hide and --only both name {words}: leave it out of one of them", done.stderr)
        done = self.client.run("render", "forest", "--integrator", "path", "--env", "none", "--sun", "90,30", "-o", self.out / "x.png")
        self.assertIn("--env none has no sky, and --sun is a part of it", done.stderr)

    def test_boxes_of_hidden_instances_are_counted_unless_they_are_left_out(self):
        whole = self.columns(["inst"])["inst"]
        chosen = int(numpy.bincount(whole[whole != 0xffffffff]).argmax())
        camera = ("--size", "48x32", "--lookat", "0.5,2,13,0,3,0", "--only", f"inst={chosen}", "-o", self.out / "heat.npy")
        charged, skipped = (self.client.run("heatmap", "forest", *camera, *more) for more in ((), ("--skip-hidden-boxes",)))
        self.assertIn("boxes of hidden instances are tested and counted; --skip-hidden-boxes leaves them out", charged.stdout + charged.stderr)
        self.assertIn("boxes that lead to hidden instances alone are left out of the counts", skipped.stdout + skipped.stderr)
        fields = ["t", "inst", "path", "prim", "boxes", "instances"]
        all_boxes, fewer = (self.columns(fields, only_instances=[chosen], skip_hidden_boxes=skips) for skips in (False, True))
        for name in ("t", "inst", "path", "prim", "instances"):
            self.assertEqual(all_boxes[name].tolist(), fewer[name].tolist(), name)
        self.assertTrue((fewer["boxes"] <= all_boxes["boxes"]).all())
        self.assertLess(fewer["boxes"].sum(), all_boxes["boxes"].sum())
        # With nothing hidden it says nothing.
        self.assertEqual(self.columns(["boxes"])["boxes"].tolist(), self.columns(["boxes"], skip_hidden_boxes=True)["boxes"].tolist())

    def test_files_say_what_was_hidden(self):
        camera = ("--size", "48x32", "--lookat", "0.5,2,13,0,3,0")
        lit = ("--integrator", "ao", "--hide", "inst=2", "--only", "object=0", *camera)
        for name, spp in (("part.exr", "2"), ("whole.exr", "6")):
            self.assertEqual(self.client.run("render", "forest", *lit, "--spp", spp, "-o", self.out / name).returncode, 0)
        texts = read_texts((self.out / "part.exr").read_bytes())
        self.assertEqual((texts["raynest:hide"], texts["raynest:only"]), ("inst=2", "object=0"))
        # It goes on with the same instances hidden.
        self.client.json("resume", self.out / "part.exr", "--spp", "6")
        self.assertEqual((self.out / "part.exr").read_bytes(), (self.out / "whole.exr").read_bytes())
        self.client.run("heatmap", "forest", *camera, "--hide", "inst=2", "-o", self.out / "heat.exr")
        self.assertEqual(read_texts((self.out / "heat.exr").read_bytes())["raynest:hide"], "inst=2")
        self.client.run("heatmap", "forest", *camera, "--hide", "inst=2", "-o", self.out / "heat.html")
        self.assertIn("hide inst=2", (self.out / "heat.html").read_text())
        self.client.run("heatmap", "forest", *camera, "-o", self.out / "heat.exr")
        self.assertNotIn("raynest:hide", read_texts((self.out / "heat.exr").read_bytes()))

    def test_hidden_instances_are_not_entered(self):
        fields = ["t", "inst", "object", "instances", "boxes"]
        whole = self.columns(fields)
        hits = numpy.isfinite(whole["t"])
        chosen = int(numpy.bincount(whole["inst"][hits & (whole["inst"] != 0xffffffff)]).argmax())
        without = self.columns(fields, hidden_instances=[chosen])
        self.assertFalse((without["inst"] == chosen).any())
        self.assertTrue((without["t"] >= whole["t"]).all())
        other = whole["inst"] != chosen
        self.assertTrue((without["t"][other] == whole["t"][other]).all())
        self.assertLess(without["instances"].sum(), whole["instances"].sum())
        alone = self.columns(fields, only_instances=[chosen])
        seen = numpy.isfinite(alone["t"])
        self.assertTrue(set(alone["inst"][seen]) <= {chosen, 0xffffffff} and (alone["inst"][seen] == chosen).any())
        # Objects likewise, wherever they are placed.
        thing = int(whole["object"][numpy.flatnonzero(whole["inst"] == chosen)[0]])
        self.assertFalse((self.columns(fields, hidden_objects=[thing])["object"] == thing).any())
        only = self.columns(fields, only_objects=[thing])
        self.assertTrue((only["object"] == thing).any())
        # The scene is as it was.
        self.assertTrue((self.columns(fields)["t"] == whole["t"]).all())
        frames = self.ws.ask("Explain", 3, {"job": {"scene": "forest", "hidden_instances": [chosen]},
                                            "camera": {"look_at": True, "eye": {"x": .5, "y": 2, "z": 13},
                                                       "at": {"x": 0, "y": 3, "z": 0}, "fov_degrees": 50},
                                            "width": 96, "height": 64, "pixel_x": 48, "pixel_y": 32})
        self.assertEqual(frames[-1][0], "Done")

    def test_paths_have_their_texts_in_the_order_of_the_request(self):
        rows = self.ask(kind="placements", count=5)["rows"]
        asked = [4, 0, 2**64 - 1, 2]
        self.assertEqual(self.ask(kind="paths", paths=asked)["rows"],
                         [rows[number]["name"] if number < 5 else "" for number in asked])
        self.assertEqual(self.ask(kind="paths")["rows"], [])

    def test_mistakes(self):
        for fields, says in (({"kind": "colours"}, "objects, placements, boxes, paths, tree"), ({"kind": "boxes", "level": 77}, "level 77"),
                             ({"kind": "boxes", "depth_min": 3}, "depth_min"), ({"kind": "objects", "count": 99999}, "structure_rows_max"),
                             ({"kind": "paths", "paths": [0, 2**60]}, "path"), ({"kind": "paths", "paths": [0] * 7681}, "7681"),
                             ({"kind": "objects", "scene": "nothing"}, "nothing"), ({"kind": "objects", "scene": ""}, "scene")):
            error = self.ask(**{"kind": "objects", **fields})
            self.assertIn(error["name"], ("INVALID_FIELD", "LIMIT_EXCEEDED", "SCENE_UNKNOWN"))
            self.assertIn(says, error["message"])
        for job, says in (({"hidden_instances": [10**6]}, "outermost instance 1000000"), ({"only_objects": [99999]}, "object 99999"),
                          ({"hidden_instances": list(range(600))}, "list_items_max")):
            self.assertIn(says, self.columns(["t"], **job)["message"])
        self.assertEqual(self.ws.ask("Ping", 0)[0][0], "Pong")


if __name__ == "__main__":
    main()
