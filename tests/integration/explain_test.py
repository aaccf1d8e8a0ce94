#!/usr/bin/env python3
"""Tests `raynest explain`: its totals are the counters of the ray, and each refusal says why.

  explain_test.py RAYNESTD RAYNEST
"""
import json

import numpy

from daemon import DaemonTest, main
from exr import read_exr

COUNTERS = ("nodes", "boxes", "leaves", "prims", "instances", "instance_misses", "rejects", "box_hits", "prim_hits",
            "total")


class Explanations(DaemonTest):
    loads = {"woods": "builtin:forest?trees=20", "flake": "builtin:flake?depth=3"}

    def refused(self, *arguments, code=2, says=""):
        self.assertEqual(self.client.fails(code, says, "explain", *arguments).stdout, "")

    def rays(self, count):
        random = numpy.random.default_rng(5)
        origins = random.uniform(-12, 12, size=(count, 3)) + [0, 12, 0]
        return numpy.hstack([origins, random.uniform(-6, 6, size=(count, 3)) + [0, 2, 0] - origins])

    def test_totals_are_the_counters_of_the_ray(self):
        refused = 0
        for scene, intersector in (("woods", "alpha_mask"), ("woods", "opaque"), ("flake", "opaque"),
                                   ("woods", "procedural_mask")):
            for ray in self.rays(12):
                text = ",".join(f"{x:.4f}" for x in ray)
                told = self.client.json("explain", scene, "--ray", text, "--all", "--intersector", intersector)
                rows = self.client.run("--json", "query", scene, "--ray", text, "--intersector", intersector,
                                       "--traversal", "single", "--fields",
                                       "t,path,geom,prim," + ",".join(COUNTERS))
                row = json.loads(rows.stdout)
                self.assertEqual({name: row[name] for name in COUNTERS},
                                 {name: told["totals"][name] for name in COUNTERS})
                depth = self.client.json("info", scene)["levels"]
                by_level = [f"{name}.{level}" for name in COUNTERS for level in range(depth)]
                row = json.loads(self.client.run("--json", "query", scene, "--ray", text, "--intersector",
                                                 intersector, "--fields", ",".join(by_level)).stdout)
                self.assertEqual([row[name] for name in by_level],
                                 [told["levels"][level][name] if level < len(told["levels"]) else 0
                                  for name in COUNTERS for level in range(depth)])
                for name in COUNTERS:
                    self.assertEqual(told["totals"][name], sum(level[name] for level in told["levels"]))
                row = json.loads(rows.stdout)
                self.assertEqual(bool(row["hits"]), told["hit"] is not None)
                if told["hit"]:
                    hit = row["hits"][0]
                    self.assertEqual({key: hit[key] for key in ("path", "geom", "prim")},
                                     {key: told["hit"][key] for key in ("path", "geom", "prim")})
                    self.assertAlmostEqual(hit["t"], told["hit"]["t"], places=6)
                    self.assertEqual(self.client.run("path", scene, told["hit"]["path"]).stdout.strip(),
                                     told["hit"]["name"])
                    self.assertEqual(told["steps"][told["hit"]["step"]]["prim"], hit["prim"])
                self.check_steps(told)
                refused += told["totals"]["rejects"]
        self.assertGreater(refused, 0)

    def check_steps(self, told):
        steps = told["steps"]
        self.assertEqual(told["left_out"], 0)
        count = lambda kind: [step for step in steps if step["kind"] == kind]
        self.assertEqual(len(count("node")), told["totals"]["nodes"])
        self.assertEqual(sum(step["boxes"] for step in count("node")), told["totals"]["boxes"])
        self.assertEqual(sum(step["prims"] for step in count("leaf")), told["totals"]["prims"])
        self.assertEqual(sum(step["outcome"] == "accepted" for step in count("instance")),
                         told["totals"]["instances"])
        reasons = [step["why"] for step in count("candidate") if step["outcome"] == "refused"]
        self.assertEqual(len(reasons), told["totals"]["rejects"])
        for reason in reasons:
            self.assertRegex(reason, r"^refused by (alpha_mask: alpha [0-9.e-]+ below 0\.5"
                                     r"|procedural_mask: in a hole of the pattern)$")
        for at, step in enumerate(steps):
            self.assertTrue(step["parent"] is None or step["parent"] < at)

    def test_a_pixel_is_the_ray_of_that_pixel(self):
        view = ("--size", "64x36", "--lookat", "0,6,18,0,4,0")
        self.client.json("heatmap", "woods", *view, "-o", self.out / "h.npy")
        counts = numpy.load(self.out / "h.npy")
        for x, y in ((0, 0), (31, 17), (63, 35), (40, 20)):
            told = self.client.json("explain", "woods", *view, "--pixel", f"{x},{y}")
            self.assertEqual(told["totals"]["total"], counts[y, x])
            self.assertEqual((told["pixel"], told["size"]), ([x, y], [64, 36]))

    def test_masks_and_culled_faces_are_named(self):
        down = ("--ray", "0,30,0,0.01,-1,0.02")
        told = self.client.json("explain", "woods", *down, "--mask", "0")
        masked = [step for step in told["steps"] if step["kind"] == "instance"]
        self.assertTrue(masked)
        for step in masked:
            self.assertEqual((step["outcome"], step["why"]), ("mask", "mask FFFFFFFF has no bit of the ray's 0"))
        self.assertIn("not entered, mask FFFFFFFF has no bit of the ray's 0",
                      self.client.run("explain", "woods", *down, "--mask", "0").stdout)
        up = self.client.json("explain", "woods", "--ray", "0.5,-5,0.5,0,1,0", "--set", "cull=back", "--all")
        self.assertIn("back_face", [step.get("outcome") for step in up["steps"]])

    def test_text_says_the_same_and_is_cut(self):
        ray = ("--ray", "-20,3,0.2,1,0,0.02")
        told = self.client.json("explain", "woods", *ray, "--all")
        text = self.client.run("explain", "woods", *ray, "--all").stdout
        tree = text.split("\n\n", 1)[1].splitlines()
        self.assertEqual(sorted(int(line[:5]) for line in tree), list(range(len(told["steps"]))))
        self.assertEqual(text.count("THE HIT"), told["hit"] is not None)
        short = self.client.run("explain", "woods", *ray).stdout
        if len(told["steps"]) > 256:
            rest = len(told["steps"]) - 256
            self.assertIn(f"... {rest:,} more", short)
        cut = self.client.json("explain", "woods", *ray)
        self.assertEqual(cut["totals"], told["totals"])
        self.assertEqual(len(cut["steps"]) + cut["left_out"], len(told["steps"]))
        self.assertEqual(cut["left_out"], sum(cut["left_out_kinds"].values()))

    def test_bad_input_is_one_line(self):
        self.refused("woods", "--pixel", "64,3", "--size", "64x36", says="lies outside of a picture of 64x36")
        self.refused("woods", "--pixel", "3,-1", says="a pixel X,Y")
        self.refused("woods", "--pixel", "3", says="a pixel X,Y")
        self.refused("woods", says="--ray or --pixel")
        self.refused("woods", "--ray", "0,0,0,0,0,0", says="its direction is zero")
        self.refused("woods", "--ray", "nan,0,0,0,0,1", says="finite")
        for range_of in ("0,0,0,5,0,0,1,2", "0,0,0,-1,0,0,1,2"):
            self.refused("woods", "--ray", range_of, says="ox,oy,oz,tmin,dx,dy,dz,tmax")
        self.refused("woods", "--ray", "0,0,0,0,0,1", "--pixel", "1,1", says="excludes")
        self.refused("woods", "--ray", "0,0,0,0,0,1", "--worker", "gpu", says="gpu")
        self.refused("nowhere", "--ray", "0,0,0,0,0,1", code=5, says="nowhere")
        self.refused("woods", "--pixel", "1,1", "--camera", "no such", says="no such")
        self.refused("woods", "--pixel", "1,1", "--intersector", "glass", code=5, says="glass")


class Paths(DaemonTest):
    """`explain --integrator`: the rays of the paths that a lit picture is made of."""

    VIEW = ("--lookat", "0,6,18,0,4,0", "--size", "60x40", "--seed", "5")

    loads = {"woods": "builtin:forest?trees=20"}

    def refused(self, *arguments, code=2, says=""):
        self.client.fails(code, says, "explain", *arguments)

    def path(self, *arguments):
        return self.client.json("explain", "woods", *self.VIEW, *arguments)

    def test_paths_of_a_pixel_are_its_light(self):
        for integrator in ("path", "direct", "ao"):
            self.client.run("render", "woods", *self.VIEW, "--integrator", integrator, "--spp", "4",
                            "-o", self.out / "lit.exr")
            width, _, layers = read_exr((self.out / "lit.exr").read_bytes())
            kinds = set()
            for x, y in ((30, 30), (12, 20), (41, 8)):
                told = [self.path("--pixel", f"{x},{y}", "--integrator", integrator, "--sample", str(s))
                        for s in range(4)]
                mean = numpy.mean([path["radiance"] for path in told], axis=0)
                drawn = [layers[name][y * width + x] for name in "RGB"]
                numpy.testing.assert_allclose(mean, drawn, rtol=1e-4, atol=1e-6)
                for path in told:
                    self.assertEqual((path["pixel"], path["integrator"], path["seed"]), ([x, y], integrator, 5))
                    self.check_rays(path["rays"])
                    kinds |= {(ray["kind"], ray.get("blocked")) for ray in path["rays"]}
            self.assertIn(("camera", None), kinds)
            self.assertIn(("shadow", True), kinds)
            self.assertIn(("shadow", False), kinds)
            self.assertEqual(("bounce", None) in kinds, integrator != "ao")

    def check_rays(self, rays):
        """Each ray begins where its parent ended, and meets what a query of it meets."""
        self.assertEqual((rays[0]["kind"], rays[0]["parent"]), ("camera", None))
        for at, ray in enumerate(rays[1:], 1):
            self.assertLess(ray["parent"], at)
            before = rays[ray["parent"]]
            self.assertEqual(ray["bounce"], before["bounce"] + 1)
            numpy.testing.assert_allclose(ray["origin"], before["hit"]["position"], atol=1e-3)
        for ray in rays[:3]:
            ends = [ray["tmin"], "inf" if ray["tmax"] is None else ray["tmax"]]
            words = ",".join(map(str, [*ray["origin"], ends[0], *ray["direction"], ends[1]]))
            done = self.client.run("--json", "query", "woods", f"--ray={words}", "--fields", "t,path,prim")
            hits = json.loads(done.stdout)["hits"]
            self.assertEqual(bool(hits), ray["hit"] is not None)
            if hits:
                self.assertEqual((hits[0]["path"], hits[0]["prim"]), (ray["hit"]["path"], ray["hit"]["prim"]))

    def test_text_says_what_each_ray_meets(self):
        told = self.path("--pixel", "30,30", "--integrator", "path")
        done = self.client.run("explain", "woods", *self.VIEW, "--pixel", "30,30", "--integrator", "path")
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = [line for line in done.stdout.splitlines() if " ray along " in line]
        self.assertEqual(len(lines), len(told["rays"]))
        for line, ray in zip(lines, told["rays"]):
            self.assertIn(f"{ray['kind']} ray", line)
            self.assertEqual("BLOCKED" in line, ray.get("blocked", False))

    def test_bad_input_is_one_line(self):
        pixel = ("woods", *self.VIEW, "--pixel", "3,3", "--integrator")
        self.refused(*pixel, "whitted", says="ao, direct, path")
        self.refused(*pixel, "primary", says="no path")
        self.refused(*pixel, "path", "--env", "sky.hdr", says="without")
        self.refused(*pixel, "path", "--sample", "70000", says="--sample")
        self.refused(*pixel, "path", "--depth", "0", says="--depth")
        self.refused(*pixel, "path", "--sun", "1,99", says="elevation")
        self.refused("woods", "--pixel", "3,3", "--sample", "1", says="--integrator")
        self.refused("woods", "--ray", "0,0,0,1,0,0", "--integrator", "path", says="--integrator")
        self.refused("woods", *self.VIEW, "--pixel", "60,3", "--integrator", "path", says="outside")


if __name__ == "__main__":
    main()
