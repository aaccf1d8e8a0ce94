#!/usr/bin/env python3
"""Scenes made of parts of several kinds: spheres, records and groups are hit where the same content of a file, or of
one mesh, is hit; places have masks and user ids; and bad parts are refused with their names.

  scenes_of_parts_test.py RAYNESTD RAYNEST FLATC
"""
import json
import pathlib
import tempfile
import warnings
from unittest import mock

import numpy as np

import raynest
from raynest import Place, Records, Spheres
from raynest._requests import parts
from raynest._requests.upload import Upload
from with_daemon import WithDaemon, main

FIELDS = ("t", "prim", "uv", "ng", "path", "inst", "mask")
CUBE = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) / 2
SIDES = np.array([[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1],
                  [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])


def box(*size):
    return CUBE * size, SIDES


def poses(count, seed, reach=30.0):
    """Turns about y, scales and offsets, (N, 3, 4)."""
    chance = np.random.default_rng(seed)
    angle, scale = chance.uniform(0, 6, count), chance.uniform(0.5, 2, count)
    made = np.zeros((count, 3, 4))
    made[:, 0, 0] = made[:, 2, 2] = np.cos(angle) * scale
    made[:, 0, 2], made[:, 2, 0], made[:, 1, 1] = np.sin(angle) * scale, -np.sin(angle) * scale, scale
    made[:, :, 3] = chance.uniform((-reach, 0, -reach), (reach, 6, reach), (count, 3))
    return made


def joined(*matrices):
    """The product of matrices (3, 4)."""
    whole = np.eye(4)
    for matrix in matrices:
        whole = whole @ np.vstack([matrix, (0, 0, 0, 1)])
    return whole[:3]


def rain(count, seed=9, reach=34.0):
    chance = np.random.default_rng(seed)
    return np.hstack([chance.uniform((-reach, 20, -reach), (reach, 20, reach), (count, 3)),
                      chance.normal((0, -1, 0), 0.3, (count, 3))])


def nearest_sphere(rays, spheres):
    """The distance to the nearest of spheres (N, 4), and its row, of directions of unit length."""
    off = rays[:, None, :3] - spheres[None, :, :3]
    along = (off * rays[:, None, 3:]).sum(-1)
    root = along**2 - (off**2).sum(-1) + spheres[None, :, 3]**2
    with np.errstate(invalid="ignore"):
        t = np.where(root > 0, -along - np.sqrt(root), np.inf)
    return t.min(1), t.argmin(1)


class ScenesOfParts(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        cls.wheels = np.array([(1.3, -0.7, 1), (1.3, -0.7, -1), (-1.3, -0.7, 1), (-1.3, -0.7, -1.0)])
        cls.balls = np.random.default_rng(3).uniform((-2, 1, -2, 0.1), (2, 3, 2, 0.6), (20, 4))
        cls.parts = {"ground": box(80, 0.1, 80), "body": box(4, 1.5, 2), "wheel": box(0.7, 0.7, 0.2),
                     "cargo": Spheres(cls.balls[:, :3], cls.balls[:, 3]),
                     "axle": {"left": ("wheel", (0, 0, 1)), "right": ("wheel", (0, 0, -1))},
                     "car": {"body": "body", "wheel": ("wheel", cls.wheels), "axle": ("axle", (0, -0.7, 0)), "cargo": "cargo"}}
        cls.cars = poses(30, 1)
        cls.places = {"ground": "ground", "car": ("car", cls.cars), "van": ("car", poses(1, 2)[0])}
        cls.scene = cls.client.scene_of(cls.parts, cls.places, "street")

    def test_spheres_are_hit_where_arithmetic_says(self):
        chance = np.random.default_rng(4)
        spheres = chance.uniform((-20, 0, -20, 0.2), (20, 5, 20, 1.5), (300, 4))
        rays = rain(5000, reach=22)
        rays[:, 3:] /= np.linalg.norm(rays[:, 3:], axis=1)[:, None]
        for scene in (self.client.scene_of({"balls": Spheres(spheres[:, :3], spheres[:, 3])}),
                      self.client.scene_of({"balls": Records("sphere", spheres)})):
            hits = scene.trace(rays, fields=("t", "prim", "path"))
            t, row = nearest_sphere(rays, spheres)
            same = hits["prim"] == np.where(np.isfinite(t), row, 2**32 - 1)
            self.assertGreater(np.isfinite(t).sum(), 1000)
            self.assertGreater(same.mean(), 0.998)      # at a rim, float32 may miss what float64 hits
            np.testing.assert_allclose(hits["t"][same], t[same], rtol=2e-4)
            self.assertEqual(scene.info["instances"], 1)
        one = self.client.scene_of({"balls": Spheres([[0, 0, 0], [9, 0, 0]], 2)})
        self.assertEqual(one.trace([[0, 9, 0, 0, -1, 0], [9, 9, 0, 0, -1, 0]], fields=("t",))["t"].tolist(), [7, 7])

    def test_groups_in_groups_are_hit_as_all_that_is_in_them(self):
        flat = {"ground": [np.eye(4)[:3]], "body": [], "wheel": [], "cargo": []}
        at = lambda *xyz: np.column_stack([np.eye(3), xyz])
        for car in (*self.cars, poses(1, 2)[0]):
            flat["body"].append(car)
            flat["cargo"].append(car)
            flat["wheel"] += [joined(car, at(*wheel)) for wheel in self.wheels]
            flat["wheel"] += [joined(car, at(0, -0.7, side)) for side in (1, -1)]
        whole = self.client.scene_of(
            {name: part for name, part in self.parts.items() if not isinstance(part, dict)},
            {name: (name, np.array(matrices)) for name, matrices in flat.items()}, "flat")
        rays = rain(20000)
        ours, theirs = (scene.trace(rays, fields=("t", "prim", "path", "inst")) for scene in (self.scene, whole))
        near = np.isclose(ours["t"], theirs["t"], rtol=1e-4, atol=1e-4)
        self.assertGreater(near.mean(), 0.9995)         # boxes are cut by other boxes: float32 may choose either
        self.assertGreater((ours["prim"] == theirs["prim"]).mean(), 0.998)
        # 31 cars of a body, four wheels, two more on the axle and the cargo.
        self.assertEqual(self.scene.info["instances"], whole.info["instances"])
        self.assertEqual(self.scene.info["instances"], 1 + 31 * 8)
        self.assertEqual(self.scene.info["unique_triangles"], 36)
        texts = set(filter(None, self.scene.path_of(np.unique(ours["path"]))))
        self.assertLessEqual(texts, {"ground", *(f"{car}/{part}" for car in ("van", *(f"car#{i}" for i in range(30)))
                                                 for part in ("body", "cargo", "axle/left", "axle/right",
                                                              *(f"wheel#{i}" for i in range(4))))})
        for text in ("car#29/body", "car#0/wheel#2", "van/cargo"):
            self.scene.path(text)
        # The ground is the first of the outermost instances, then the cars, then the van.
        of_van = [text is not None and text.startswith("van") for text in self.scene.path_of(ours["path"])]
        self.assertEqual(set(ours["inst"][of_van]), {31})
        with self.scene.edit() as edit:
            edit.hide("car#*/axle/left")
        self.assertEqual(edit.instances, 30)
        left = set(self.scene.path_of(np.unique(self.scene.trace(rays, fields=("path",))["path"])))
        self.assertFalse([text for text in left if text.endswith("axle/left") and text.startswith("car")])
        with self.scene.edit() as edit:
            edit.show("car#*/axle/left")

    def test_it_is_the_composition_of_the_same_content(self):
        for name in ("body", "wheel"):
            vertices, faces = self.parts[name]
            (self.folder / f"{name}.obj").write_text(
                "".join("v {!r} {!r} {!r}\n".format(*each) for each in vertices.tolist())
                + "".join("f {} {} {}\n".format(*each) for each in (faces + 1).tolist()), encoding="ascii")
        np.save(self.folder / "cargo.npy", self.balls)
        np.save(self.folder / "cars.npy", self.cars)
        (self.folder / "x.rnscene.json").write_text(json.dumps({
            "rnscene": 1, "up": "z", "objects": {
                "body": {"file": "body.obj"}, "wheel": {"file": "wheel.obj"},
                "cargo": {"file": "cargo.npy", "primitive": "sphere"},
                "car": {"instances": [{"object": "body"}, {"object": "cargo", "mask": 6},
                                      {"object": "wheel", "uid": 5, "translation": [1, 0, 0]}]}},
            "instances": [{"object": "car", "matrices": "cars.npy", "mask": 3, "uid": 8},
                          {"object": "car", "name": "own", "translation": [0, 0, 7]}]}), encoding="utf-8")
        parts = {"body": self.parts["body"], "wheel": self.parts["wheel"], "cargo": self.parts["cargo"],
                 "car": {"body": "body", "cargo": Place("cargo", mask=6), "wheel": Place("wheel", (1, 0, 0), uid=5)}}
        ours = self.client.scene_of(parts, {"car": Place("car", self.cars, mask=3, uid=8), "own": ("car", (0, 0, 7))}, up="z")
        theirs = self.client.load(self.folder / "x.rnscene.json")
        self.assertEqual((ours.info["up"], ours.info["instances"]), ("z", theirs.info["instances"]))
        rays = rain(8000)
        for mask in (2**32 - 1, 1, 2, 4):
            mine, other = (scene.trace(rays, fields=FIELDS, mask=mask) for scene in (ours, theirs))
            self.assertGreater((mine["inst"] != 2**32 - 1).sum(), 10 if mask == 4 else 100)
            self.same(dict(mine), dict(other))
            uids = ours.trace(rays, fields=("uid", "inst"), mask=mask)
            self.assertLessEqual(set(uids["uid"][uids["inst"] < 30]), {8})
        # A wheel within the placement that has no user id keeps that of its group.
        wheel = ours.trace([[1, 0, 9, 0, 0, -1]], fields=("uid", "path"))
        self.assertEqual(ours.path_of(wheel["path"]), ["own/body"])
        wheel = ours.trace([[1, -9, 7, 0, 1, 0]], fields=("uid", "t"))
        self.assertTrue(np.isfinite(wheel["t"][0]))

    def test_each_place_has_its_mask_and_user_id(self):
        post = {"post": box(0.5, 4, 0.5)}
        x = np.arange(6)
        places = {"a": Place("post", [(i, 0, 0) for i in x], mask=[1, 2, 2, 4, 4, 6], uid=[9, 9, 8, 7, 0, 1]),
                  "b": Place("post", [(i, 0, 5) for i in x], visible=[True, False] * 3),
                  "c": Place("post", (0, 0, 9), mask=4, uid=77, visible=True), "d": Place("post", (1, 0, 9), visible=False)}
        scene = self.client.scene_of(post, places)
        down = lambda z: [[i, 9, z, 0, -1, 0] for i in x]
        self.assertEqual(scene.info["unique_triangles"], 12)
        for mask, seen in ((1, [0]), (2, [1, 2, 5]), (4, [3, 4, 5]), (8, [])):
            hits = scene.trace(down(0), mask=mask, fields=("hit",))["hit"]
            self.assertEqual(np.flatnonzero(hits).tolist(), seen)
        hits = scene.trace(down(0), fields=("uid", "mask", "inst"))
        self.assertEqual(hits["uid"].tolist(), [9, 9, 8, 7, 0, 1])
        self.assertEqual(hits["mask"].tolist(), [1, 2, 2, 4, 4, 6])
        self.assertEqual(hits["inst"].tolist(), x.tolist())
        self.assertEqual(scene.trace(down(5), fields=("hit",))["hit"].tolist(), [True, False] * 3)
        last = scene.trace(down(9)[:2], fields=("hit", "uid", "path"))
        self.assertEqual((last["hit"].tolist(), last["uid"][0]), ([True, False], 77))
        self.assertEqual(scene.path_of(last["path"][0]), "c")
        # One by one in a group, too; and by user id.
        row = self.client.scene_of({**post, "row": {"post": Place("post", [(i, 0, 0) for i in x], mask=1 << x, uid=10 + x)}},
                                   {"row": ("row", [(0, 0, 0), (0, 0, 5)])})
        for z in (0, 5):
            hits = row.trace(down(z), fields=("mask", "uid"))
            self.assertEqual((hits["mask"].tolist(), hits["uid"].tolist()), ((1 << x).tolist(), (10 + x).tolist()))
        with row.edit() as edit:
            edit.hide(raynest.Uids([11, 13]))
        self.assertEqual(row.trace(down(5), fields=("hit",))["hit"].tolist(), [True, False, True, False, True, True])

    def test_places_that_differ_are_numbered_as_others_are(self):
        post, at = {"post": box(0.5, 4, 0.5)}, [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]
        down = [[x, 9, z, 0, -1, 0] for z in (0, 5) for x in range(4)]
        for masks in ([1, 2, 4, 8], [1, 1, 2, 2], [1, 2, 2, 1], [7, 7, 7, 7]):
            row = self.client.scene_of({**post, "row": {"post": Place("post", at, mask=masks)}},
                                       {"row": ("row", [(0, 0, 0), (0, 0, 5)]), "one": Place("post", [(0, 0, 9)], mask=[2])})
            texts = [f"row#{z}/post#{x}" for z in range(2) for x in range(4)]
            self.assertEqual(row.path_of(row.trace(down, fields=("path",))["path"]), texts)
            self.assertEqual(row.path_of(row.trace([[0, 9, 9, 0, -1, 0]], fields=("path",))["path"]), ["one"])

    def test_thousands_of_places_in_one_call(self):
        count = 3000
        grid = np.stack([np.arange(count) % 60, np.zeros(count), np.arange(count) // 60], 1).astype(float)
        scene = self.client.scene_of({"ball": Spheres([[0, 0, 0]], 0.25), "cube": box(0.5, 0.5, 0.5)},
                                     {"ball": ("ball", grid), "cube": Place("cube", grid + (0, 9, 0), uid=np.arange(count))})
        rays = np.hstack([grid + (0, 20, 0), np.tile((0, -1, 0), (count, 1))])
        hits = scene.trace(rays, fields=("t", "uid", "inst"))
        np.testing.assert_array_equal(hits["t"], 10.75)
        np.testing.assert_array_equal(hits["uid"], np.arange(count))
        np.testing.assert_array_equal(hits["inst"], np.arange(count, 2 * count))
        rays[:, 1] = 5
        hits = scene.trace(rays, fields=("t", "inst"))
        np.testing.assert_array_equal(hits["t"], 4.75)
        np.testing.assert_array_equal(hits["inst"], np.arange(count))

    def test_far_parts_keep_their_digits(self):
        """In groups, too: they are hit as the same parts near zero are."""
        def scene(at, **origin):
            return self.client.scene_of(
                {"ball": Spheres(np.add(at, [[0, 0, 0.125], [3, 0, 0.125]]), 0.5), "cube": (CUBE + at + (0, 4, 0), SIDES),
                 "pair": {"ball": "ball", "cube": "cube"}}, {"pair": "pair", "next": ("pair", (0.25, 0, 4))}, **origin)
        far = np.array([4e6, 100, 5e6])
        rays = rain(4000, reach=5) * (1, 0.5, 1, 1, 1, 1)
        fields = ("t", "prim", "inst")
        wanted = scene((0, 0, 0)).trace(rays, fields=fields)
        hits = scene(far, origin=far + 1).trace(rays + (*far, 0, 0, 0), fields=fields)
        same = hits["prim"] == wanted["prim"]
        for inst in (0, 1):
            self.assertGreater((wanted["inst"] == inst).sum(), 50)
        self.assertGreater(same.mean(), 0.998)
        np.testing.assert_allclose(hits["t"][same], wanted["t"][same], atol=2e-3)
        # Also those that only their places bring near.
        wanted = self.client.mesh(CUBE, SIDES).trace(rays, fields=("t",))["t"]
        for at in (far + 0.3, 0.3 - far):
            hits = self.client.scene_of({"cube": (CUBE + at, SIDES)}, {"cube": ("cube", -at)}, origin=(1, 0, 0)).trace(rays, fields=("t",))
            np.testing.assert_allclose(hits["t"], wanted, atol=1e-5)

    def test_wide_parts_keep_the_digits_that_a_mesh_keeps(self):
        """About the origin, however large the part is, and whatever its vertices are numbers of."""
        at = np.array([448123.13, 5412345.37, 312.11])
        near = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        faces = [[0, 1, 2], [3, 4, 5]]
        for vertices, origin in (
                (at + np.vstack([near, 200000 + 5000 * near]), at),
                (at + np.vstack([near, -300000 - 5000 * near]), at + 100),
                (np.vstack([at + near, at * (0, 0, 0) + near]), at), (np.vstack([at + near, 0 * near]), at + 400),
                (np.vstack([at + near, 0 * near]).astype(int), at.astype(int)),
                (np.vstack([at + 10 * near, at + 20 * near]).astype(np.float32), at)):
            part = {"wide": (vertices, faces)}
            first = vertices[:3].astype(float)
            start = first.mean(0) + np.linspace(-1, 1, 2001)[:, None] * (first[1] - first[0]) * (1, 0, 0) + (0, 0, 5)
            rays = np.hstack([start, np.tile((0, 0, -1), (len(start), 1))])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", raynest.SceneWarning)
                wanted = self.client.mesh(vertices, faces, origin=origin).trace(rays, fields=("t", "prim"))
                ball = {"ball": Spheres([at + 1000], 1)}
                group = {"ball": ("ball", (0, 0, 50)), "wide": "wide"}
                scenes = [self.client.scene_of(part, origin=origin), self.client.scene_of({**part, **ball}, origin=origin),
                          self.client.scene_of({**part, **ball, "group": group}, {"group": "group"}, origin=origin),
                          self.client.scene_of({**part, **ball, "inner": group, "group": {"inner": ("inner", (0, 0, -9)), "ball": "ball"}},
                                               {"group": ("group", (0, 0, 9))}, origin=origin)]
            self.assertGreater((wanted["prim"] == 0).sum(), 500)
            for scene in scenes:
                hits = scene.trace(rays, fields=("t", "prim"))
                same = hits["prim"] == wanted["prim"]
                self.assertGreater(same.mean(), 0.998)
                np.testing.assert_allclose(hits["t"][same], wanted["t"][same], atol=1e-3)
        balls = Spheres(np.vstack([[0, 0, 0], at + (5, 5, 0)]), 0.1)
        hit = self.client.scene_of({"cloud": balls}, origin=at).trace([[*(at + (5, 5, 5)), 0, 0, -1]], fields=("t",))
        np.testing.assert_allclose(hit["t"], 4.9, atol=1e-5)

    def test_wide_parts_near_zero_that_a_group_places_far_keep_their_digits(self):
        at = np.array([448123.25, 5412345.5, 312])
        ground = {"ground": (np.array([[-400000, -400000, 0], [400000, -400000, 0], [0, 400000, 0]]), [[0, 1, 2]]), "cube": (CUBE, SIDES)}
        scene = self.client.scene_of({**ground, "town": {"ground": ("ground", at), "cube": ("cube", at + (0, 0, 2))}},
                                     {"town": "town"}, origin=at)
        rays = [[*(at + (0.3, -8.1, 2.2)), 0, 1, 0], [*(at + (3, 0, 8)), 0, 0, -1]]
        np.testing.assert_allclose(scene.trace(rays, fields=("t",))["t"], [7.6, 8], atol=1e-5)

    def test_equal_content_is_sent_once(self):
        sent = []
        progress = lambda done, total, stage: sent.append(total) if stage == "uploading" else None
        for _ in range(2):
            scene = self.client.scene_of({"ball": Spheres([[0, 0, 0]], 0.1251), "up": {"ball": ("ball", (0, 1, 0))}},
                                         keep=True, progress=progress)
        self.assertGreater(max(sent), 0)
        self.assertEqual(sent[-1], max(sent))           # the first call's: the second one uploaded nothing
        other = self.client.scene_of({"ball": Spheres([[0, 0, 0]], 0.1252), "up": {"ball": ("ball", (0, 1, 0))}}, keep=True)
        self.assertNotEqual(other.name, scene.name)
        self.assertNotEqual(other.info["hash"], scene.info["hash"])
        # A part in a group stands there alone.
        self.assertEqual(scene.trace([[0, 9, 0, 0, -1, 0]], fields=("t",))["t"][0], np.float32(9 - 1 - 0.1251))
        self.assertEqual(scene.info["instances"], 1)

    def test_a_part_that_a_scene_has_is_not_sent_again(self):
        """By its vertices and faces, or its records, whatever that scene makes of it; and the result is that of all files."""
        steps = np.arange(80)
        x, z = np.meshgrid(steps, steps)
        corners = (steps[:-1, None] * 80 + steps[:-1]).reshape(-1, 1)
        faces = np.vstack([corners + (0, 80, 1), corners + (1, 80, 81)])
        chance = np.random.default_rng(8)
        heights = lambda *shape: chance.integers(0, 256, shape) / 256  # exact in float32, also less an origin
        hill, dune = ((np.stack([x, heights(80, 80), z], -1).reshape(-1, 3), faces) for _ in range(2))
        rain = Spheres(heights(5000, 3), 0.01)
        red = raynest.Material("red", (1, 0, 0))
        far = np.array([448000.0, 5412000, 300])
        hill_far, dune_far = ((vertices + far, faces) for vertices, faces in (hill, dune))
        cases = {
            "mesh": lambda: self.client.mesh(*hill),
            "material": lambda: self.client.mesh(*hill, material=red),
            "origin": lambda: self.client.mesh(*hill_far, origin=far),
            "meshes": lambda: self.client.scene_of({"hill": hill, "dune": dune}),
            "group": lambda: self.client.scene_of({"hill": hill, "all": {"low": "hill", "high": ("hill", (0, 9, 0))}}, up="z"),
            "kinds": lambda: self.client.scene_of({"rain": rain, "hill": raynest.Mesh(*hill, red), "dune": dune}),
            "far": lambda: self.client.scene_of({"hill": hill_far, "rain": Spheres(rain.rows[:, :3] + far, 0.01),
                                                 "all": {"dune": "dune"}, "dune": dune_far}, origin=far)}
        sent = []
        read = Upload.read

        def told(upload, number):
            sent.append(len(upload.files[number].data))
            return read(upload, number)

        def load(case):
            """Returns the scene, and the bytes of what was sent of its parts."""
            sent.clear()
            with mock.patch.object(Upload, "read", told):
                return cases[case](), sum(size for size in sent if size > 16384)

        alone = {}
        for case in cases:
            with load(case)[0] as scene:
                alone[case] = scene.info["hash"]
        self.assertGreater(load("mesh")[1], 0)
        self.assertGreater(load("mesh")[1], 0)      # nobody holds the first one any more
        first, whole = load("kinds")
        self.assertEqual(first.info["hash"], alone["kinds"])
        self.assertGreater(whole, 2 * hill[0].size * 4)
        kept = []
        for case in cases:
            scene, size = load(case)
            self.assertEqual(scene.info["hash"], alone[case], case)
            self.assertEqual(size, 0, case)
            kept.append(scene)
        # A mesh that has changed is no more the one that was sent.
        changed = self.client.scene_of({"hill": hill, "dune": (dune[0] * 2, faces)})
        with changed.edit() as edit:
            edit.set_vertices("dune", dune[0] * 3)
        _, size = load("meshes")
        self.assertEqual(size, 0)
        sent.clear()
        with mock.patch.object(Upload, "read", told):
            self.client.scene_of({"dune": (dune[0] * 2, faces)})
            self.client.scene_of({"dune": (dune[0] * 3, faces)})
        self.assertEqual(len([size for size in sent if size > 16384]), 1)

    def test_add_is_an_edit_of_one_scene(self):
        street = self.client.scene_of({"ground": box(40, 0.1, 40)})
        car = self.client.scene_of(self.parts, {"car": ("car", (0, 2, 0))}, "taxi")
        edit = street.add(car, [(0, 0, 0), (9, 0, 0)])
        self.assertEqual((edit.epoch, edit.instances, street.info["epoch"]), (2, 2, 2))
        edit = street.add("taxi", (0, 0, 9), "van", 2, epoch=2)
        self.assertEqual(edit.epoch, 3)
        rays = [[9, 9, 0, 0, -1, 0], [0, 9, 9, 0, -1, 0]]
        texts = street.path_of(street.trace(rays, fields=("path",))["path"])
        self.assertEqual([text.split("/")[0] for text in texts], ["taxi#1", "van"])
        seen = street.trace(rays, fields=("inst",), mask=1)["inst"]
        self.assertEqual(seen.tolist(), [2, 0])
        with self.assertRaisesRegex(raynest.UsageError, "adds no placement"):
            street.add(car, np.zeros((0, 3)))
        with self.assertRaises(raynest.Error):
            street.add(car, epoch=2)
        self.assertEqual(street.info["epoch"], 3)

    def test_bad_parts_and_places_are_named(self):
        cube, ball = box(1, 1, 1), Spheres([[0, 0, 0]], 1)
        three, ragged = [(0, 0, 0), (1, 0, 0), (2, 0, 0)], [[1], [1, 2]]
        flat = np.tile(np.eye(4), (3, 1, 1))
        flat[1, 2, 2] = 0
        many = {f"part {i}": cube for i in range(600)}
        of = self.client.scene_of
        chain = {f"g{i}": {"x": f"g{i + 1}"} for i in range(3000)}
        for make, words in (
                (lambda: of([cube]), "parts must be a dict of meshes"), (lambda: of({"a": ball, "b": 3}), "the part 'b' must be"),
                (lambda: of({"a": ball}, ["a"]), "places of .* must be a dict"), (lambda: of({1: ball}), "no name of a part"),
                (lambda: of({"a": ball, "g": {"": "a"}}), "no name of a place"),
                (lambda: of({"a": ball}, {"x": "b"}), "the place 'x' is of 'b', which is no part; there are 'a'"),
                (lambda: of(many, {"x": "prat 312"}), "is of 'prat 312', which is no part: did you mean 'part 312'\\?$"),
                (lambda: of(many, {"x": "zzz"}), "there are 'part 0', 'part 1', 'part 2', 'part 3', 'part 4' and 595 more$"),
                (lambda: of({"a\0b": cube}), r"no name of a part: leave '\\x00' out"),
                (lambda: of({"a": cube, "g": {"\x85": "a"}}), r"no name of a place: leave '\\x85' out"),
                (lambda: of({"a": cube}, {"p\ud800": "a"}), r"no name of a place: leave '\\ud800' out"),
                (lambda: of({"a": ball, "g": {"x": ("b", (0, 0, 0))}}), "the place 'x' in the group 'g' is of 'b', which is no"),
                (lambda: of({"a": ball, "g": {"x": ball}}), "'x' in the group 'g' is of <raynest.*which is no part"),
                (lambda: of({"a": ball, "g": {}}), "the group 'g' is empty"),
                (lambda: of({"g": {"x": "g"}}), "the group 'g' holds itself: 'g' > 'g'"),
                (lambda: of({"a": {"x": "b"}, "b": {"x": "c"}, "c": {"x": "a"}}), "holds itself: '(.)' > '.' > '.' > '\\1'"),
                (lambda: of({**chain, "g3000": {"x": "g0"}}), "holds itself"),
                (lambda: of({"a": ball}, {"x": ("a", (0, np.nan, 0))}), "the place 'x' has numbers that are not finite"),
                (lambda: of({"a": ball, "g": {"x": ("a", np.eye(2))}}), "the place 'x' in the group 'g' has shape"),
                (lambda: of({"a": ball}, masks={"a": 2}), "masks by path are for .*raynest.Place"),
                (lambda: of({"a": cube}, {"x": Place("a", uid=3)}, masks={"x": 2}), "masks by path"),
                (lambda: of({"a": (CUBE * np.nan, SIDES), "b": ball}), "the part 'a' has vertices that are not finite"),
                (lambda: of({"a": (ragged, SIDES)}), "^the part 'a': vertices must be numbers, in rows of one length"),
                (lambda: of({"a": (CUBE, ragged), "b": ball}), "^the part 'a': faces must be numbers, in rows of one"),
                (lambda: of({"a": (CUBE, []), "b": cube}), "^the part 'a': the mesh has no triangles"),
                (lambda: of({"a": (CUBE, SIDES + 1), "b": ball}), "^the part 'a': faces go from 1 to 8"),
                (lambda: of({"a": (CUBE[:, :2], SIDES)}), "^the part 'a': vertices must be numbers of shape"),
                (lambda: of({"a": (CUBE, SIDES[:, :2])}), "^the part 'a': faces must be integers"),
                (lambda: of({"a": (np.ma.masked_greater(CUBE, 0), SIDES)}), "^the part 'a': some vertices are masked"),
                (lambda: of({"a": (CUBE, np.ma.masked_greater(SIDES, 6))}), "^the part 'a': some faces are masked"),
                (lambda: Place("a", np.zeros((3, 2))), "matrices has shape"),
                (lambda: Place("a", three[:2], mask=ragged), "mask must be numbers, in rows of one length"),
                (lambda: Place("a", three[:2], visible=ragged), "visible must be numbers, in rows of one length"),
                (lambda: Place("a", three, mask=[1, 2]), r"mask has shape \(2,\): for 3 places"),
                (lambda: Place("a", mask=[1, 2]), r"mask has shape \(2,\): for 1 place it"),
                (lambda: Place("a", three, mask=2**32), "mask of 4294967296"), (lambda: Place("a", mask=1.5), "mask of 1.5"),
                (lambda: Place("a", mask=-1), "mask of -1"), (lambda: Place("a", mask=np.nan), "mask of nan"),
                (lambda: Place("a", three, uid=[1, 2, 3, 4]), r"uid has shape \(4,\): for 3 places"),
                (lambda: Place("a", uid=2**32 - 1), "uid of 4294967295"), (lambda: Place("a", uid="x"), "uid must be numbers"),
                (lambda: Place("a", uid=-1), "uid of -1"), (lambda: Place("a", visible=2), "visible of 2"),
                (lambda: Place("a", three, visible=[True]), r"visible has shape \(1,\): for 3"),
                (lambda: Spheres([0, 0, 0], 1), r"centres has shape \(3,\): it must be \(N, 3\)"),
                (lambda: Spheres(np.zeros((0, 3)), 1), "centres has shape"),
                (lambda: Spheres([[0, 0, np.nan]], 1), "centres has numbers that are not finite"),
                (lambda: Spheres([[0, 0, 1e39]], 1), "centres has numbers that are not finite in float32"),
                (lambda: Spheres(three, [1, 2]), r"radii has shape \(2,\): it must be one number, or \(3,\)"),
                (lambda: Spheres(three, [1, 2, 0]), "radii must be finite numbers above 0"),
                (lambda: Spheres(three, 1e-50), "radii must be finite numbers above 0, also in float32"),
                (lambda: Spheres(three, np.inf), "radii must be finite"), (lambda: Spheres(three, "1"), "radii must be numbers"),
                (lambda: Records(3, [[1]]), "primitive of 3"), (lambda: Records("", [[1]]), "primitive of ''"),
                (lambda: Records("sphere", [1, 2, 3, 4]), r"rows has shape \(4,\): it must be \(N, M\)"),
                (lambda: Records("sphere", [[1, 2, 3, np.inf]]), "rows has numbers that are not finite"),
                # The daemon alone knows types, and how deep groups may be.
                (lambda: of({"a": Records("cone", [[1, 2, 3, 4]])}), "object 'a': there is no primitive type 'cone'"),
                (lambda: of({"a": Records("sphere", [[1, 2, 3]])}), r"object 'a': .*shape \(N, 4\)"),
                (lambda: of({**chain, "g3000": {"x": "a"}, "a": ball}), "deeper than 32 levels"),
                (lambda: of({**{f"g{i}": chain[f"g{i}"] for i in range(30)}, "g30": {"x": "a"}, "a": ball}), "more than 32 levels"),
                (lambda: of({"a": ball}, {"x": ("a", np.zeros((3, 4)))}), "^the place 'x' is singular: a scale of 0"),
                (lambda: of({"a": cube}, {"x": ("a", flat)}), "^number 1 of the place 'x' is singular"),
                (lambda: of({"a": cube}, {"x": Place("a", flat[1])}), "^the place 'x' is singular"),
                (lambda: of({"a": cube}, {"x": ("a", 1e-50 * flat[0, :3])}), "^the place 'x' is singular"),
                (lambda: of({"a": cube, "g": {"x": ("a", flat)}}), "^number 1 of the place 'x' in the group 'g'")):
            with self.subTest(words=words), self.assertRaisesRegex((TypeError, ValueError, raynest.InvalidError), words):
                make()
        balls, cubes = {f"ball {i}": ball for i in range(510)}, {f"cube {i}": cube for i in range(101)}
        with self.assertRaisesRegex(raynest.UsageError, "make 512 files, at most 511 are taken: spheres .* one for 100. Join"):
            of({**balls, **cubes})
        del cubes["cube 0"]
        of({**balls, **cubes})
        of({**{f"g{i}": chain[f"g{i}"] for i in range(29)}, "g29": {"x": "a"}, "a": ball})     # 30 groups
        with mock.patch.object(parts, "JSON_BYTES_MAX", 1000), \
                self.assertRaisesRegex(raynest.UsageError, r"put them into a group, as \{'cars': \{'car': \('car', matrices\)"):
            of({"a": cube}, {"a": ("a", three * 10)})


    def test_more_meshes_than_an_upload_has_files(self):
        count = 600
        turns = np.arange(count)
        at = np.stack([turns % 25 * 3.0, 0 * turns, turns // 25 * 3.0], -1)
        sizes = 1 + turns[:, None] % [2, 3, 5] / 8
        scene = self.client.scene_of({f"part/{i}": box(*sizes[i]) for i in range(count)},
                                     {f"p{i}": Place(f"part/{i}", at[i], uid=1000 + i) for i in range(count)})
        down = np.hstack([at + (0.1, 50, 0.1), np.tile((0.0, -1, 0), (count, 1))])
        hits = scene.trace(down, fields=("t", "uid", "inst"))
        np.testing.assert_array_equal(hits["uid"], 1000 + turns)
        np.testing.assert_array_equal(hits["inst"], turns)
        np.testing.assert_allclose(hits["t"], 50 - sizes[:, 1] / 2, atol=1e-4)


if __name__ == "__main__":
    main()
