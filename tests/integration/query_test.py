#!/usr/bin/env python3
"""Tests query results other than the nearest hit: all hits, nothing (kind null), sums.

  query_test.py RAYNESTD RAYNEST
"""
import json

import numpy

from daemon import DaemonTest, main

ALL_FIELDS = "t,prim,geom,path,uv,hit,flags"


def quads(count):
    """Returns `count` unit squares, one above the other along z, as a glTF with embedded data."""
    import base64
    square = numpy.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], numpy.float32)
    heights = numpy.repeat(numpy.arange(count, dtype=numpy.float32), 6)
    positions = numpy.column_stack([numpy.tile(square, (count, 1)), heights]).astype("<f4")
    data = base64.b64encode(positions.tobytes()).decode()
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(positions),
                       "type": "VEC3", "min": positions.min(0).tolist(),
                       "max": positions.max(0).tolist()}],
        "bufferViews": [{"buffer": 0, "byteLength": positions.nbytes}],
        "buffers": [{"byteLength": positions.nbytes,
                     "uri": "data:application/octet-stream;base64," + data}]})


class Queries(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.client.json("load", "builtin:forest?trees=20", "--name", "woods")
        cls.client.json("load", "builtin:flake?depth=3", "--name", "flake")
        (cls.out / "stack.gltf").write_text(quads(300))
        cls.client.json("load", cls.out / "stack.gltf")
        random = numpy.random.default_rng(1)
        origins = random.uniform(-20, 20, size=(20_000, 3)) + [0, 10, 0]
        rays = numpy.hstack([origins, random.normal(size=origins.shape)]).astype(numpy.float32)
        rays[77] = 0  # invalid
        numpy.save(cls.out / "rays.npy", rays)
        down = numpy.zeros((20_000, 6), numpy.float32)
        down[:, :3] = random.uniform(0.1, 0.9, size=(20_000, 3))
        down[:, 2] = random.integers(-5, 300, size=20_000)
        down[:, 5] = 1
        numpy.save(cls.out / "up.npy", down)

    def query(self, scene, *arguments, code=0, says=""):
        file = self.out / "answer.npz"
        file.unlink(missing_ok=True)
        done = self.client.run("--quiet", "query", scene, *arguments, "-o", file)
        self.assertEqual(done.returncode, code, done.stderr)
        if code != 0:
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
            self.assertIn(says, done.stderr)
        if code not in (0, 8):
            return None
        with numpy.load(file) as columns:
            return dict(columns)

    def same(self, a, b):
        self.assertEqual(sorted(a), sorted(b))
        for name in a:
            self.assertTrue(numpy.array_equal(a[name], b[name], equal_nan=True), name)

    def test_all_hits_begin_as_multi_and_agree_with_the_reference(self):
        rays = ["--rays", self.out / "rays.npy", "--fields", ALL_FIELDS]
        everything = self.query("woods", *rays, "--kind", "all")
        counts = numpy.diff(everything["ray_splits"].astype(int))
        self.assertGreater(counts.max(), 8)
        self.assertTrue(((counts > 0) == everything["hit"]).all())
        self.assertEqual(everything["flags"][77], 1)
        self.assertEqual(everything["flags"].sum(), 1)
        few = self.query("woods", *rays, "--kind", "multi", "--max-hits", "8")
        kept = numpy.minimum(counts, 8)
        self.assertTrue((numpy.diff(few["ray_splits"]) == kept).all())
        first = numpy.repeat(everything["ray_splits"][:-1].astype(int), kept)
        place = numpy.arange(kept.sum()) - numpy.repeat(few["ray_splits"][:-1].astype(int), kept)
        for name in ("t", "prim", "geom", "path", "uv"):
            self.assertTrue((everything[name][first + place]
                             == few[name]).all(), name)
        short = self.out / "few.npy"
        numpy.save(short, numpy.load(self.out / "rays.npy")[:300])
        rays[1] = short
        self.same(self.query("woods", *rays, "--kind", "all", "--traversal", "reference"),
                  self.query("woods", *rays, "--kind", "all"))

    def test_directions_from_one_origin_are_rays_too(self):
        rays = numpy.load(self.out / "rays.npy")
        rays[:, :3] = 1, 2, 3
        numpy.save(self.out / "whole.npy", rays)
        for dtype in (numpy.float32, numpy.float64):
            numpy.save(self.out / "ways.npy", rays[:, 3:].astype(dtype))
            self.same(self.query("woods", "--rays", self.out / "ways.npy", "--from", "1,2,3"),
                      self.query("woods", "--rays", self.out / "whole.npy"))
        self.query("woods", "--rays", self.out / "ways.npy", code=5, says="(N, 3) with --from")
        self.query("woods", "--generate", "hemisphere", f"points={self.out / 'ways.npy'}", code=5,
                   says="(20000, 3); points and normals have the shape (N, 6)\n")
        self.query("woods", "--rays", self.out / "whole.npy", "--from", "1,2,3", code=5,
                   says="rays have the shape (N, 3)")

    def test_many_hits_per_ray_come_whole_and_sorted_in_many_chunks(self):
        rays = numpy.load(self.out / "up.npy")
        got = self.query("stack", "--rays", self.out / "up.npy", "--kind", "all", "--fields", "t")
        want = [numpy.arange(max(0, numpy.floor(z) + 1), 300) - z for z in rays[:, 2]]
        self.assertTrue((numpy.diff(got["ray_splits"]) == [len(t) for t in want]).all())
        self.assertGreater(len(got["t"]), 2_500_000)  # 10 MB: more than the client's window
        self.assertTrue(numpy.allclose(got["t"], numpy.concatenate(want), rtol=1e-6))

    def test_a_ray_over_its_budget_keeps_the_nearest_and_says_so(self):
        rays = numpy.load(self.out / "up.npy")
        got = self.query("stack", "--rays", self.out / "up.npy", "--kind", "all", "--fields",
                         "t,flags", "--max-hits", "100", code=8, says="13,314 of 20,000 rays have more hits than --max-hits")
        whole = 299 - numpy.maximum(-1, numpy.floor(rays[:, 2]))
        self.assertTrue((numpy.diff(got["ray_splits"]) == numpy.minimum(whole, 100)).all())
        self.assertTrue(((got["flags"] == 2) == (whole > 100)).all())
        first = got["ray_splits"][:-1][whole > 0].astype(int)
        nearest = numpy.maximum(0, numpy.floor(rays[:, 2]) + 1) - rays[:, 2]
        self.assertTrue(numpy.allclose(got["t"][first], nearest[whole > 0], rtol=1e-6))

    def test_the_hit_budget_has_limits(self):
        rays = ["--rays", self.out / "up.npy"]
        self.query("stack", *rays, "--kind", "multi", "--max-hits", "257", code=2, says="256; --kind all")
        self.query("stack", *rays, "--kind", "all", "--max-hits", "65537", code=2, says="65536")
        self.query("stack", *rays, "--kind", "all", "--fields", "t,nodes", code=2,
                   says="not counted for kind all")
        most = [*rays, "--kind", "all", "--max-hits", "65536"]
        self.query("stack", *most)
        fields = "t,prim,geom,path,inst,uid,uv,ng,front,position,material"
        self.query("stack", *most, "--fields", fields, code=5, says="fewer hits or columns")

    def test_kind_null_answers_canonical_misses_for_every_column(self):
        fields = "hit,t,prim,path,uv,ng,flags,total"
        got = self.query("woods", "--rays", self.out / "rays.npy", "--kind", "null", "--fields",
                         fields)
        for name, miss in (("hit", 0), ("t", numpy.inf), ("prim", 2**32 - 1), ("path", 2**64 - 1),
                           ("uv", 0), ("ng", 0), ("flags", 0), ("total", 0)):
            self.assertEqual(len(got[name]), 20_000)
            self.assertTrue((got[name] == numpy.array(miss, got[name].dtype)).all(), name)
        done = self.client.run("--json", "query", "woods", "--ray", "0,50,0,0,-1,0", "--kind", "null")
        self.assertEqual(done.stdout, '{"ray":0,"hits":[]}\n')

    def test_generated_rays_have_the_answers_of_the_same_rays_sent(self):
        for kind in ("closest", "any", "multi", "all"):
            fields = "hit" if kind == "any" else "t,path,position"
            for generator in (["camera", "size=203x117"],
                              ["lidar", "elevations=-20:20:9", "azimuths=0:360:777",
                               "lookat=0,3,9,0,3,0"]):
                made = self.query("woods", "--generate", *generator, "--kind", kind, "--fields",
                                  fields + ",origin,direction")
                rays = numpy.hstack([made.pop("origin"), made.pop("direction")])
                numpy.save(self.out / "made.npy", rays)
                sent = self.query("woods", "--rays", self.out / "made.npy", "--kind", kind,
                                  "--fields", fields)
                self.assertGreater(len(made[fields.split(",")[0]]), 100)
                self.same(made, sent)

    def test_hit_fraction_is_the_share_of_each_points_rays(self):
        random = numpy.random.default_rng(3)
        points = numpy.hstack([random.uniform(-10, 10, size=(50, 3)) + [0, 3, 0],
                               random.normal(size=(50, 3))]).astype(numpy.float32)
        numpy.save(self.out / "points.npy", points)
        for samples in (100, 20_000):  # less and more than a chunk of rays
            generator = ["--generate", "hemisphere", f"points={self.out / 'points.npy'}",
                         f"samples={samples}", "seed=4"]
            rows = self.query("woods", *generator, "--kind", "any")
            want = rows["hit"].reshape(50, samples).sum(axis=1) / samples
            got = self.query("woods", *generator, "--reduce", "hit_fraction")
            self.assertEqual(list(got), ["hit_fraction"])
            self.assertTrue((got["hit_fraction"] == want.astype(numpy.float32)).all())
            self.assertTrue((want > 0).any() and (want < 1).any())

    def test_visible_pixels_are_counted_per_path(self):
        for scene, generator in (("woods", ["camera", "size=203x117"]),
                                 ("flake", ["equirectangular", "size=400x200",
                                            "lookat=0,0,3,0,0,0"])):
            seen = self.query(scene, "--generate", *generator, "--fields", "path,hit")
            paths, pixels = numpy.unique(seen["path"][seen["hit"] == 1], return_counts=True)
            got = self.query(scene, "--generate", *generator, "--reduce", "visible_pixels")
            self.assertGreater(len(paths), 10)
            self.assertTrue((got["path"] == paths).all())
            self.assertTrue((got["pixels"] == pixels).all())

    def test_reduced_rows_read_well(self):
        table = self.client.run("query", "woods", "--generate", "camera", "size=40x20", "--reduce",
                                "visible_pixels").stdout.splitlines()
        self.assertEqual(table[0].split(), ["path", "pixels"])
        lines = self.client.run("--json", "query", "woods", "--generate", "camera", "size=40x20",
                                "--reduce", "visible_pixels").stdout.splitlines()
        self.assertEqual([json.loads(line)["path"] for line in lines],
                         [int(row.split()[0]) for row in table[1:]])
        numpy.save(self.out / "points.npy", numpy.array([[0, 1, 0, 0, 1, 0]], numpy.float32))
        line = self.client.run("--json", "query", "woods", "--generate", "hemisphere",
                               f"points={self.out / 'points.npy'}", "--reduce", "hit_fraction")
        self.assertEqual(sorted(json.loads(line.stdout)), ["hit_fraction", "point"])

    def test_a_reducer_says_what_it_cannot_do(self):
        camera = ["--generate", "camera", "size=8x8"]
        self.query("woods", *camera, "--reduce", "sum", code=2, says="hit_fraction, visible_pixels")
        self.query("woods", *camera, "--reduce", "hit_fraction", code=2, says="hemisphere")
        self.query("woods", *camera, "--reduce", "visible_pixels", "--kind", "any", code=2,
                   says="use kind closest")
        self.query("woods", *camera, "--reduce", "visible_pixels", "--fields", "t", code=2,
                   says="name no fields")


if __name__ == "__main__":
    main()
