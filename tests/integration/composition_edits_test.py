#!/usr/bin/env python3
"""Tests the edits of compositions: a composition with edits is hit where the same one without them is hit
after Scene.edit() made the same changes.

  composition_edits_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_files import WithFiles

BOX = """o {0}
v -1 -1 -1\nv 1 -1 -1\nv -1 1 -1\nv 1 1 -1\nv -1 -1 1\nv 1 -1 1\nv -1 1 1\nv 1 1 1
f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6
"""
QUARTER = [[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0]]
TOWN = {
    "rnscene": 1,
    "objects": {"house": {"file": "house.obj"}, "tree": {"file": "tree.obj"},
                "garden": {"instances": [{"object": "tree", "name": "oak"},
                                         {"object": "tree", "name": "elm", "translation": [4, 0, 0]}]}},
    "instances": [{"object": "house"}, {"object": "garden", "translation": [0, 0, 10]},
                  {"object": "garden", "name": "park", "translation": [0, 0, 20]},
                  {"object": "tree", "translation": [-9, 0, 0], "scale": [1, 2, 0.5]},
                  {"object": "house", "name": "barn", "translation": [9, 0, 0]},
                  {"object": "house", "name": "shed", "translation": [20, 0, 0]}]}
EDITS = [
    {"move": "garden/elm", "translation": [0, 0.5, 1]},
    {"move": "park", "matrix": QUARTER},
    {"turn": "tree", "matrix": QUARTER},
    {"place": "barn", "translation": [9, 3, -9], "scale": 0.5},
    {"set-mask": "*/oak", "mask": "0x2"},
    {"set-uid": "house", "uid": 77},
    {"hide": "park/elm"},
    {"remove": "shed"},
    {"move": "house", "translation": [1, 0, 0]},
    {"show": "park/elm"},
    {"hide": "barn"},
    {"show": "barn"}]


def matrix_of(change):
    """The 3x4 matrix of a change."""
    if "matrix" in change:
        return np.array(change["matrix"], float)
    matrix = np.eye(3, 4)
    matrix[:, :3] *= change.get("scale", 1)
    matrix[:, 3] = change["translation"]
    return matrix


class CompositionEdits(WithFiles):
    def setUp(self):
        super().setUp()
        for name in ("house", "tree"):
            self.write(f"{name}.obj", BOX.format(name))
        random = np.random.default_rng(5)
        aim = random.uniform([-12, -2, -12], [24, 4, 24], (6000, 3))
        eye = aim + random.uniform(-2, 2, (6000, 3)) + [0, 9, 0]
        self.rays = np.hstack([eye, aim - eye])

    def load_town(self, name, **more):
        return self.load(f"{name}.rnscene.json", json.dumps({**TOWN, **more}))

    def answers(self, scene, **settings):
        hit = scene.trace(self.rays, fields=("t", "path", "uid"), **settings)
        return hit["t"], np.array([str(path) for path in scene.path_of(hit["path"])]), hit["uid"]

    def test_they_are_what_an_edit_makes(self):
        ours, theirs = self.load_town("ours", edits=EDITS), self.load_town("theirs")
        before = self.answers(theirs)[0]
        with theirs.edit() as edit:
            for change in EDITS:
                word, = set(change) & {"move", "turn", "place", "set-mask", "set-uid", "hide", "show", "remove"}
                path = change[word]
                if word in ("move", "place"):
                    getattr(edit, word)(path, matrix_of(change))
                elif word == "turn":
                    edit.move(path, matrix_of(change), frame="own")
                elif word == "set-mask":
                    edit.set_mask(path, int(change["mask"], 16))
                elif word == "set-uid":
                    edit.set_uid(path, change["uid"])
                elif word in ("hide", "show"):
                    edit.set_mask(path, 0 if word == "hide" else 0xFFFFFFFF)
                else:
                    edit.remove(path)
        for settings in ({}, {"mask": 1}):
            for one, other in zip(self.answers(ours, **settings), self.answers(theirs, **settings)):
                np.testing.assert_array_equal(one, other)
        self.assertGreater((self.answers(ours)[0] != before).sum(), 100)
        self.assertIn(77, self.answers(ours)[2])
        # The same text is the same scene, and the daemon knows it.
        self.assertEqual(self.load_town("again", edits=EDITS).info["hash"], ours.info["hash"])
        self.assertEqual(ours.info["refits"] + ours.info["rebuilds"], 0)

    def test_materials_are_those_of_an_edit(self):
        self.write("paint.mtl", "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
        self.write("house.obj", "mtllib paint.mtl\nusemtl red\n" + BOX.format("house"))
        self.write("tree.obj", "mtllib paint.mtl\nusemtl blue\n" + BOX.format("tree"))
        plain = self.load_town("plain")
        named = plain.materials
        change = {"set-material": "barn", "material": "blue"}
        number = [row["name"] for row in named].index("blue")
        made = [self.load_town(f"town{i}", edits=[{**change, "material": which}]) for i, which in enumerate(("blue", number))]
        with plain.edit() as edit:
            edit.set_material("barn", "blue")
        hits = [scene.trace(self.rays, fields=("t", "path", "material", "base_colour")) for scene in (plain, *made)]
        at_barn = np.array([path.startswith("barn") for path in plain.path_of(hits[0]["path"])])
        self.assertGreater(at_barn.sum(), 20)
        self.assertEqual(set(hits[0]["material"][at_barn]), {number})
        for hit in hits[1:]:
            for name, column in hit.items():
                np.testing.assert_array_equal(column, hits[0][name], name)
        for edit, said in (({"set-material": "barn"}, "'material' alone beside 'set-material'"),
                           ({"set-material": "barn", "material": "green"}, r"edits\[0\]: .*'green'"),
                           ({"set-material": "barn", "material": -1}, r"edits\[0\].material is no number from 0")):
            with self.subTest(said), self.assertRaisesRegex(raynest.InvalidError, said):
                self.load_town("wrong", edits=[edit])

    def test_a_composition_that_is_placed_brings_its_own(self):
        self.write("inner.rnscene.json", json.dumps({**TOWN, "edits": EDITS}))
        outer = self.load("outer.rnscene.json", json.dumps({
            "rnscene": 1, "objects": {"town": {"file": "inner.rnscene.json"}},
            "instances": [{"object": "town"}], "edits": [{"remove": "town"}, ]}))
        self.assertEqual(outer.info["instances"], 0)
        outer = self.load("outer.rnscene.json", json.dumps({
            "rnscene": 1, "objects": {"town": {"file": "inner.rnscene.json"}}, "instances": [{"object": "town"}],
            "edits": [{"hide": "town/house"}]}))
        inner = self.load_town("inner2", edits=[*EDITS, {"hide": "house"}])
        np.testing.assert_allclose(self.answers(outer)[0], self.answers(inner)[0], rtol=1e-5)

    def test_what_is_wrong_is_told_with_its_place(self):
        for edits, said in (
                ([{"move": "house"}], r"edits\[0\] is to have 'matrix', or 'translation' with 'rotation' and 'scale', alone beside 'move'"),
                ([{"hide": "house"}, {"hide": "house", "mask": 1}], r"edits\[1\] is to have nothing beside 'hide'"),
                ([{"set-uid": "house", "uid": 0xFFFFFFFF}], "stands for no user id"),
                ([{"set-mask": "house", "uid": 1}], "'mask' alone beside 'set-mask'"),
                ([{"hide": "house", "show": "house"}], "is to have one of move, turn"),
                ([{"matrix": QUARTER}], "is to have one of move, turn"),
                ([{"move": 3, "matrix": QUARTER}], r"edits\[0\].move is no text"),
                ([{"fly": "house"}], "'fly', which is none of"),
                ([{"hide": "hut"}], r"edits\[0\]: .*'hut'"),
                ([{"remove": "garden/oak"}], r"edits\[0\]: removes what lies within"),
                ([{"move": "house", "matrix": [[0] * 4] * 3}], "its edits: .*house"),
                ([{"move": "house", "translation": [1e30, 0, 0]}], "its edits: .*house"),
                ({"hide": "house"}, "edits is no list")):
            with self.subTest(said), self.assertRaisesRegex(raynest.InvalidError, said):
                self.load_town("wrong", edits=edits)

    def test_an_object_is_one_of_several_meshes_of_a_file(self):
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], float)
        np.savez(self.scenes / "shapes.npz", **{f"{name}/{word}": array for name, height in (("low", 1), ("high", 5))
                                                for word, array in (("vertices", corners + (0, height, 0)),
                                                                    ("faces", np.array([[0, 2, 1]])))})
        def town(**member):
            return self.load("shapes.rnscene.json", json.dumps({
                "rnscene": 1, "objects": {name: {"file": "shapes.npz", "mesh": name, **member} for name in ("low", "high")},
                "instances": [{"object": "low"}, {"object": "high", "translation": [10, 0, 0]}]}))
        hits = town().trace([[0.2, 9, 0.2, 0, -1, 0], [10.2, 9, 0.2, 0, -1, 0]])
        np.testing.assert_array_equal(hits["t"], [8, 4])
        for member, said in (({"mesh": "wide"}, "has no array 'wide/vertices'.* it has .*low/vertices.npy"),
                             ({"mesh": ""}, "has no array 'vertices'"), ({"mesh": 3}, "mesh is no text"),
                             ({"file": "house.obj"}, "'mesh' is for a .npz of several meshes: leave it out")):
            with self.subTest(member), self.assertRaisesRegex(raynest.InvalidError, said):
                town(**member)

    def test_an_animation_moves_what_an_edit_would(self):
        drive = {"name": "drive", "channels": [
            {"instance": "garden", "path": "translation", "times": [0, 2], "values": [[0, 0, 10], [6, 0, 10]]},
            {"instance": "tree", "path": "scale", "times": [0, 1], "values": [[1, 2, 0.5], [1, 3, 0.5]]}]}
        scene = self.load_town("played", animations=[drive])
        there = json.loads(json.dumps(TOWN["instances"]))
        there[1]["translation"] = [3, 0, 10]
        there[3]["scale"] = [1, 3, 0.5]
        moved = self.load_town("moved", instances=there)
        # Without a time all stands where the entries say.
        for played, still in ((self.answers(scene, time=1), self.answers(moved)),
                              (self.answers(scene), self.answers(self.load_town("rest")))):
            for one, other in zip(played, still):
                np.testing.assert_array_equal(one, other)
        self.assertGreater((self.answers(scene, time=1)[0] != self.answers(scene)[0]).sum(), 50)
        # Two channels that say where one instance stands contradict each other, also by its two names.
        twice = {"channels": [*drive["channels"], {**drive["channels"][0], "instance": "garden#0"}]}
        with self.assertRaisesRegex(raynest.InvalidError, r"animations\[0\].channels\[2\] moves 'garden#0' by the path of a "
                                                          "channel before it"):
            self.load_town("twice", animations=[twice])
        # Composed into another scene it does not play, and that is said.
        with self.assertWarnsRegex(raynest.SceneWarning, "its animations are left out"):
            self.load("outer.rnscene.json", json.dumps({
                "rnscene": 1, "objects": {"town": {"file": "played.rnscene.json"}}, "instances": [{"object": "town"}]}))


if __name__ == "__main__":
    main()
