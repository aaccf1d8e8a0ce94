#!/usr/bin/env python3
"""Parts that a request hides: its hits are those of a scene that was loaded without them.

  hide_test.py RAYNESTD RAYNEST FLATC
"""
import json
import tempfile
from pathlib import Path

import numpy as np

import raynest
from animation_test import CORNERS, FACES, Gltf
from with_daemon import WithDaemon, main

SURVEY = (4_500_000.25, 10.0, -5_400_000.5)
COLUMNS = ("t", "prim", "geom", "ng", "uv", "front", "position", "hit", "path")
MISSED = 2**64 - 1
# One name of each kind, and what has it.
WHEELS = {("car-1/wheel-0",): {"car-1/wheel-0"},
          ("car-0/wheel*", "car-2/body"): {"car-0/wheel-0", "car-0/wheel-1", "car-0/wheel 2", "car-2/body"},
          ("*wheel-1",): {f"car-{i}/wheel-1" for i in range(3)},
          ("car-1",): {f"car-1/{part}" for part in ("body", "wheel-0", "wheel-1", "wheel 2")},
          ("ground", "car-2/*"): {"ground", *(f"car-2/{part}" for part in ("body", "wheel-0", "wheel-1", "wheel 2"))},
          ("*",): None}


def cars(without=(), at=(0, 0, 0), moves=False):
    """A ground and three equal cars, whose subtrees are stored once, less the parts of these paths.

    A twin of each car stands far below, so that what a car lacks leaves it the subtree of two: the form of a scene,
    and with it the rounding, is the same whatever it lacks."""
    gltf = Gltf()
    ground = gltf.mesh(np.array([[-9, 0, -9], [9, 0, -9], [0, 0, 9]], float), [[0, 1, 2]])
    wheel, body = gltf.mesh(CORNERS * .5, FACES), gltf.mesh(CORNERS, FACES)
    if "ground" not in without:
        gltf.node(name="ground", mesh=ground, translation=list(at))
    made = []
    for name, car, down in [(f"{kind}-{car}", car, down) for car in range(3) for kind, down in (("twin", 5e4), ("car", 0))]:
        parts = [gltf.node(root=False, name=part, mesh=mesh, translation=where)
                 for part, mesh, where in (("body", body, [0, .4, 0]), ("wheel-0", wheel, [.5, 0, .4]),
                                           ("wheel-1", wheel, [-.5, 0, .4]), ("wheel 2", wheel, [0, .1, -.5]))
                 if f"car-{car}/{part}" not in without]
        if parts:
            made.append(gltf.node(name=name, children=parts,
                                  translation=np.add(at, [3 * car - 3, -down, car]).tolist()))
    if moves:
        gltf.animate("Drive", (made[-1], "translation", [0, 2], [[3, 0, 2], [0, 2, 2]], "LINEAR"))
    return gltf


def rain(count, at=(0, 0, 0)):
    chance = np.random.default_rng(5)
    rays = np.zeros((count, 6))
    rays[:, :3] = chance.uniform(-5, 5, (count, 3)) + [0, 6, 0]
    rays[:, 3:] = chance.uniform(-4, 4, (count, 3)) * [1, .2, 1] - rays[:, :3]
    rays[:, :3] += at
    return rays


class Hide(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.files = Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        cls.cars = cls.load("cars")
        cls.rays = rain(4000)
        texts = cls.cars.path_of(np.arange(cls.cars.info["instances"]))
        cls.ids = {text: path for path, text in enumerate(texts)}

    @classmethod
    def load(cls, name, origin=None, **made):
        return cls.client.load(cars(**made).write(cls.files / f"{name}.glb"), name, origin=origin)

    def paths_of(self, scene):
        """The texts of all paths but those of twins."""
        return [text for text in scene.path_of(np.arange(scene.info["instances"])) if "twin" not in text]

    def agrees(self, whole, less, hits, fresh):
        """Equal in every bit; paths by their texts, and those of `whole` by its ids."""
        for name in COLUMNS[:-1]:
            np.testing.assert_array_equal(hits[name].view(np.uint8), fresh[name].view(np.uint8), name)
        self.assertEqual(whole.path_of(hits["path"]), less.path_of(fresh["path"]))

    def test_hits_are_those_of_a_scene_without_the_parts(self):
        everything = set(self.paths_of(self.cars))
        self.assertEqual(len(everything), 13)
        # Cars share what they are made of, so a part of one takes records of its own.
        self.assertLess(self.cars.info["unique_triangles"], self.cars.info["instanced_triangles"])
        before = self.cars.trace(self.rays, fields=COLUMNS)
        for number, (names, gone) in enumerate(WHEELS.items()):
            if gone is None:
                continue
            less = self.load(f"less-{number}", without=gone)
            self.assertEqual(set(self.paths_of(less)), everything - gone)
            for traversal in ("single", "stream", "packet", "reference"):
                with self.subTest(names=names, traversal=traversal):
                    hits = self.cars.trace(self.rays, fields=COLUMNS, hide=names, traversal=traversal)
                    self.agrees(self.cars, less, hits, less.trace(self.rays, fields=COLUMNS, traversal=traversal))
            self.assertTrue((hits["path"] != before["path"]).any())
            # The same parts by the numbers of their paths, and as all that is not shown.
            ids = [f"path={self.ids[text]}" for text in gone]
            self.same(dict(self.cars.trace(self.rays, fields=COLUMNS, hide=ids)),
                      dict(self.cars.trace(self.rays, fields=COLUMNS, hide=names)))
            self.same(dict(self.cars.trace(self.rays, fields=COLUMNS, only=sorted(everything - gone))),
                      dict(self.cars.trace(self.rays, fields=COLUMNS, hide=names)))
            for kind, more in (("any", {}), ("multi", {"max_hits": 4}), ("all", {})):
                fields = ("hit",) if kind == "any" else ("t", "prim", "ng", "position")
                self.same(dict(self.cars.trace(self.rays, kind=kind, fields=fields, hide=names, **more)),
                          dict(less.trace(self.rays, kind=kind, fields=fields, **more)))
            view = {"look_at": ((4, 5, 9), (0, 0, 0)), "size": (40, 30)}
            np.testing.assert_array_equal(self.cars.render(encode="raw", hide=names, **view),
                                          less.render(encode="raw", **view))
            lit = {"integrator": "ao", "spp": 2, "ao_distance": 3, **view}
            film, other = self.cars.render(hide=names, **lit), less.render(**lit)
            self.same(*({name: layer for name, layer in each.items() if name not in ("instance", "mesh")}
                        for each in (film, other)))
            points = self.rays[:50, :3] * [1, 0, 1] + [0, 1e-3, 0]
            sky = raynest.generators.hemisphere(points=points, normals=np.tile([0, 1, 0], (50, 1)), samples=64, seed=3)
            self.same(dict(self.cars.trace(sky, reduce="hit_fraction", hide=names)),
                      dict(less.trace(sky, reduce="hit_fraction")))
            camera = raynest.generators.camera(**view)
            seen, other = (scene.trace(camera, reduce="visible_pixels", **job)
                           for scene, job in ((self.cars, {"hide": names}), (less, {})))
            self.assertEqual(dict(zip(self.cars.path_of(seen["path"]), seen["pixels"])),
                             dict(zip(less.path_of(other["path"]), other["pixels"])))
        # The scene is as it was.
        self.same(dict(self.cars.trace(self.rays, fields=COLUMNS)), dict(before))
        self.assertEqual(self.cars.info["epoch"], 1)

    def test_primitives_beside_instances(self):
        flake = self.client.load("builtin:flake?depth=4", "flake")
        texts = flake.path_of(np.arange(flake.info["instances"]))
        rays = np.random.default_rng(2).normal(0, 1, (3000, 6))
        rays[:, :3] *= 3
        rays[:, 3:] -= rays[:, :3]
        fields = ("t", "path", "object", "inst", "prim", "ng", "front", "position")
        every = flake.trace(rays, kind="all", fields=fields)
        owner = np.repeat(np.arange(len(rays)), np.diff(every["ray_splits"].astype(int)))
        # A sphere has buds beside it. Its text stands for all of these, its number for it alone.
        below = lambda name: {path for path, text in enumerate(texts) if text == name or text.startswith(name + "/")}
        alone = texts.index("bud-2/bud-6")
        meshes = {(text, f"flake-{2 - text.count('/')}") for text in texts if text}
        seen = set()
        for words, gone in (({"hide": "bud-3/bud-4"}, below("bud-3/bud-4")), ({"hide": f"path={alone}"}, {alone}),
                            ({"hide": ["path=0", "bud-5", "bud-6/bud-1/*"]},
                             {0} | below("bud-5") | below("bud-6/bud-1") - {texts.index("bud-6/bud-1")}),
                            ({"only": ["bud-1", f"path={alone}"], "hide": "bud-1/bud-8"},
                             set(range(len(texts))) - (below("bud-1") - below("bud-1/bud-8")) - {alone})):
            stays = ~np.isin(every["path"], list(gone))
            rays_left, first = np.unique(owner[stays], return_index=True)
            hits = flake.trace(rays, fields=fields, **words)
            self.assertEqual(np.flatnonzero(hits["path"] != MISSED).tolist(), rays_left.tolist())
            self.assertGreater(np.count_nonzero(hits["t"] != flake.trace(rays, fields=("t",))["t"]), 0, words)
            for name in fields:
                np.testing.assert_array_equal(hits[name][rays_left], every[name][stays][first], name)
            all_of_it = flake.trace(rays, kind="all", fields=fields, **words)
            for name in fields:
                np.testing.assert_array_equal(all_of_it[name], every[name][stays], name)
            for ray in rays_left[:20]:
                told = flake.explain(rays[ray], **words)
                self.assertEqual((told["hit"]["path"], np.float32(told["hit"]["t"])), (hits["path"][ray], hits["t"][ray]))
                named = {(step["name"], step["mesh"]) for step in told["steps"] if step["kind"] == "instance"}
                self.assertLessEqual(named, meshes)
                seen |= named
            self.assertGreater(len(seen), 3)
        self.assertFalse(flake.trace(rays, fields=("hit",), hide="*")["hit"].any())

    def test_all_may_be_hidden(self):
        self.assertFalse(self.cars.trace(self.rays, fields=("hit",), hide="*")["hit"].any())
        mesh = self.client.mesh(CORNERS, FACES, "box")
        down = [[0, 9, 0, 0, -1, 0]]
        self.assertEqual(mesh.trace(down, fields=("hit",))["hit"], 1)
        for all_of_it in ("path=0", "*", mesh.path_of(0) or "*"):
            for traversal in ("auto", "single", "reference"):
                self.assertEqual(mesh.trace(down, fields=("hit",), hide=all_of_it, traversal=traversal)["hit"], 0)
        self.assertEqual(mesh.trace(down, fields=("hit",), only="path=0")["hit"], 1)

    def test_lamps_that_rays_cannot_enter_give_no_light(self):
        def lamps(name, *lit):
            """A floor and two posts with a lamp each, of one subtree; a post that is not `lit` has a twin far below alone."""
            gltf = Gltf()
            gltf.json["materials"] = [{"emissiveFactor": [1, 1, 1]}]
            floor = gltf.mesh(np.array([[-9, 0, -9], [9, 0, -9], [0, 0, 9]], float), [[2, 1, 0]])
            lamp, shade = gltf.mesh(CORNERS * .2, FACES), gltf.mesh(CORNERS * .3, FACES)
            gltf.json["meshes"][lamp]["primitives"][0]["material"] = 0
            gltf.node(name="floor", mesh=floor)
            for post in range(2):
                parts = [gltf.node(root=False, name=part, mesh=mesh, translation=[0, 2 + height, 0])
                         for part, mesh, height in (("lamp", lamp, 0), ("shade", shade, 1)) if part == "shade" or post in lit]
                gltf.node(name=f"post-{post}", children=parts, translation=[4 * post - 2, 0, 0])
            gltf.write(self.files / f"{name}.glb")
            return self.client.load(self.files / f"{name}.glb", masks={"post-1/lamp": 0x2})

        both, first, dark = lamps("both", 0, 1), lamps("first", 0), lamps("dark")
        words = dict(integrator="direct", environment="none", spp=16, size=(64, 36), look_at=((0, 6, 9), (0, 0, 0)))

        def light(scene, **more):
            return scene.render(**{**words, **more})["rgba"][..., :3].astype(float)
        for integrator in ("direct", "path"):
            words["integrator"] = integrator
            wanted = light(first)
            self.assertGreater(light(both).mean(), 1.2 * wanted.mean())
            for hidden in ({"hide": "post-1/lamp"}, {"mask": 0x1}, {"only": ["floor", "post-0", "post-1/shade"]}):
                np.testing.assert_allclose(light(both, **hidden).mean(), wanted.mean(), rtol=0.03)
            self.assertEqual(light(both, hide="*/lamp").max(), light(dark).max())
        with both.edit() as edit:
            edit.hide("post-1/lamp")
        np.testing.assert_allclose(light(both).mean(), wanted.mean(), rtol=0.03)

    def test_coordinates_of_surveys(self):
        whole = self.load("survey", at=SURVEY, origin=SURVEY)
        less = self.load("survey-less", at=SURVEY, origin=SURVEY, without={"car-1/wheel-0"})
        rays = rain(2000, SURVEY)
        hits = whole.trace(rays, fields=COLUMNS, hide="car-1/wheel-0")
        self.agrees(whole, less, hits, less.trace(rays, fields=COLUMNS))
        self.assertTrue((hits["path"] != whole.trace(rays, fields=("path",))["path"]).any())

    def test_scenes_at_another_time(self):
        whole = self.load("drive", moves=True)
        less = self.load("drive-less", moves=True, without={"car-2/wheel-1"})
        for time in (0.0, 1.0, 1.7):
            hits = whole.trace(self.rays, fields=COLUMNS, time=time, hide="car-2/wheel-1")
            self.agrees(whole, less, hits, less.trace(self.rays, fields=COLUMNS, time=time))
            self.assertTrue((hits["path"] != whole.trace(self.rays, fields=("path",), time=time)["path"]).any())

    def test_edits_and_hidden_parts(self):
        scene = self.load("edited")
        with scene.edit() as edit:
            edit.move("car-1", (0, 0.5, 0))
        hidden = scene.trace(self.rays, fields=COLUMNS, hide=["car-1/wheel*", "car-2"])
        with scene.edit() as edit:
            edit.hide("car-1/wheel*")
            edit.hide("car-2")
        self.same(dict(scene.trace(self.rays, fields=COLUMNS)), dict(hidden))

    def test_what_is_hidden_again_is_there_already(self):
        scene = self.load("again")
        counts = lambda: np.array([self.client.stats()[f"selections_{name}"] for name in ("made", "reused")])
        before = counts()
        hits = [scene.trace(self.rays, fields=COLUMNS, hide=["car-1/wheel*", "car-2"]) for _ in range(5)]
        np.testing.assert_array_equal(counts() - before, [1, 4])
        for again in hits[1:]:
            self.same(dict(again), dict(hits[0]))
        # Single rays are answered on the daemon's io thread then.
        for ray in range(0, 200, 7):
            one = scene.trace(self.rays[ray:ray + 1], fields=COLUMNS, hide=["car-1/wheel*", "car-2"])
            self.same(dict(one), {name: column[ray:ray + 1] for name, column in hits[0].items()})
        # Another epoch is another scene, and so is another principal's.
        with scene.edit() as edit:
            edit.move("car-0", (0, 0.25, 0))
        before = counts()
        moved = scene.trace(self.rays, fields=COLUMNS, hide=["car-1/wheel*", "car-2"])
        np.testing.assert_array_equal(counts() - before, [1, 0])
        self.assertTrue((moved["t"] != hits[0]["t"]).any())
        # Many lists in turn, of which four stay.
        held = self.client.stats()["memory_used_bytes"]
        for number in range(40):
            scene.trace(self.rays[:1], fields=("t",), hide=f"path={number % 20 + 5}", only=["car*", f"path={number // 20}"])
        self.assertLess(self.client.stats()["memory_used_bytes"], held + (1 << 20))

    def test_only_and_hide_together(self):
        shown = self.cars.trace(self.rays, fields=COLUMNS, only="car-1", hide="car-1/wheel*")
        self.assertEqual(set(self.cars.path_of(shown["path"])), {"", "car-1/body"})
        self.same(dict(shown), dict(self.cars.trace(self.rays, fields=COLUMNS, only="car-1/body")))

    def test_the_steps_of_a_ray_are_told_in_the_scene(self):
        hits = self.cars.trace(self.rays, fields=("path", "t", "object"))
        path = self.ids["car-1/wheel-0"]
        ray = self.rays[np.flatnonzero(hits["path"] == path)[0]]
        told = self.cars.explain(ray, hide="car-1/wheel-0")
        after = self.cars.trace([ray], fields=("t", "path", "object"), hide="car-1/wheel-0")
        self.assertEqual(told["hit"] is None, not np.isfinite(after["t"][0]))
        if told["hit"]:
            self.assertEqual(told["hit"]["path"], after["path"][0])
        self.assertIn("car-1", json.dumps(told))
        ranked = self.cars.blame(look_at=((4, 5, 9), (0, 0, 0)), size=(40, 30), hide="car-1/wheel-0")
        self.assertEqual(ranked["rays"], 1200)

    def test_names_that_the_scene_lacks(self):
        for wrong, says in (("car-1/door", "'car-1' has no 'door'; there are: body"), ("bus*", "no path is of the form 'bus\\*'"),
                            ("path=25", "there is no path 25: the scene has 25"),
                            (["car-1", "nothing"], "the scene has no 'nothing'")):
            for key in ("hide", "only"):
                with self.subTest(wrong=wrong), self.assertRaisesRegex(raynest.UsageError, says):
                    self.cars.trace(self.rays[:1], **{key: wrong})
        with self.assertRaisesRegex(raynest.UsageError, "`?hide=?`? and `?only=?`? both name 'car-1'"):
            self.cars.trace(self.rays[:1], hide="car-1", only="car-1")
        with self.assertRaisesRegex(raynest.Error, "list_items_max"):
            self.cars.trace(self.rays[:1], hide=["car-1"] * 600)
        with self.assertRaisesRegex(raynest.Error, "text_bytes_max"):
            self.cars.trace(self.rays[:1], hide="x" * 5000)

    def test_the_command_line(self):
        view = ("--lookat", "4,5,9,0,0,0", "--size", "40x30")
        for words, job in ((("--hide", "car-0/wheel*", "--hide", "path=0"), {"hide": ["car-0/wheel*", "path=0"]}),
                           (("--only", "*wheel-1"), {"only": "*wheel-1"})):
            done = self.cli.json("heatmap", "cars", *view, *words, "-o", self.files / "heat.npy")
            picture = self.cars.heatmap(look_at=((4, 5, 9), (0, 0, 0)), size=(40, 30), **job)
            np.testing.assert_array_equal(np.load(self.files / "heat.npy"), picture)
            self.assertGreater(done["max"], 0)
        # A film says what it hides, and goes on with that.
        lit = (*view, "--integrator", "ao", "--hide", "car-0/wheel*", "--hide", "car-1/wheel 2", "--hide", "path=0")
        for name, spp in (("part.exr", "2"), ("whole.exr", "5")):
            self.cli.json("render", "cars", *lit, "--spp", spp, "-o", self.files / name)
        self.cli.json("resume", self.files / "part.exr", "--spp", "5")
        self.assertEqual((self.files / "part.exr").read_bytes(), (self.files / "whole.exr").read_bytes())


if __name__ == "__main__":
    main()
