#!/usr/bin/env python3
"""Edits of user ids, of all that an instance places and of nothing else, and edits by user ids.

  uid_edits_test.py RAYNESTD RAYNEST FLATC
"""
import tempfile
from pathlib import Path

import numpy as np

import raynest
from animation_test import Gltf
from edits_test import box
from with_daemon import WithDaemon, main, rain

RAYS = rain(4000)
RAYS[:, 5] = -1
COLUMNS = ("t", "prim", "inst", "path", "uid")
NONE = 2**32 - 1


class LastEdit(WithDaemon):
    def test_info_says_what_the_last_edit_changed(self):
        cube = box(1, 1, 1)
        scene = self.client.scene_of({"cube": cube}, {name: ("cube", (3 * i, 0, 0)) for i, name in enumerate("abcdef")})
        self.assertEqual(scene.info["last_edit"], "")
        for change, words in (
                (lambda edit: edit.move("a", (0, 1, 0)), "moved a"),
                (lambda edit: edit.move([1, 2, 3, 4, 5], np.zeros((5, 3))), "moved b, c, d and 2 more"),
                (lambda edit: (edit.hide("b"), edit.remove("c")), "changed the mask of b; removed c"),
                (lambda edit: edit.set_vertices("d", cube[0]), "changed the shape of d")):
            with scene.edit() as edit:
                change(edit)
            self.assertEqual(scene.info["last_edit"], words)
        self.assertIn("; the last edit changed the shape of d", self.cli.run("info", scene.name).stdout)
        again = self.client.scene_of({"cube": cube}, name=scene.name, replace=True)
        self.assertEqual(again.info["last_edit"], "")


    def test_a_scene_without_instances_says_why(self):
        scene = self.client.scene_of({"cube": box(1, 1, 1)}, {"a": "cube"})
        with scene.edit() as edit:
            edit.remove("a")
        with self.assertRaisesRegex(raynest.UsageError, "has no instances to change: it is empty"):
            with scene.edit() as edit:
                edit.hide("a")


class UidEdits(WithDaemon):
    def test_the_digest_is_that_of_a_fresh_load(self):
        rock, places = box(1, 1, 1), [(0, 0, 0), (0, 9, 0), (0, 0, 4)]
        group = {"rock": ("rock", [(0, 0, 0), (3, 0, 0)])}
        for parts, of in (({"rock": rock}, "rock"), ({"rock": rock, "group": group}, "group")):
            for text, uid, wanted in (("g#0", 9, [9, 2, 3]), ("g#1", 1, [1, 1, 3]), ("g*", 5, [5, 5, 5])):
                edited, fresh = (self.client.scene_of(parts, {"g": raynest.Place(of, places, uid=uids)}, name)
                                 for name, uids in (("edited", [1, 2, 3]), ("fresh", wanted)))
                before = edited.info["hash"]
                with edited.edit() as edit:
                    edit.set_uid(text, uid)
                self.assertNotEqual(edited.info["hash"], before)
                self.assertEqual(edited.info["hash"], fresh.info["hash"], (of, text))
                for scene in (edited, fresh):
                    scene.unload()

    def seen(self, scene, rays=RAYS):
        found = scene.trace(rays, fields=COLUMNS)
        return found, scene.path_of(found["path"])

    def follow(self, scene, before, uids, rays=RAYS):
        """All is as before, but for the user ids of these outermost instances."""
        (found, texts), (was, were) = self.seen(scene, rays), before
        for name in COLUMNS[:-1]:
            np.testing.assert_array_equal(found[name], was[name], name)
        self.assertEqual(texts, were)
        wanted = was["uid"].copy()
        for inst, uid in uids.items():
            self.assertTrue((was["inst"] == inst).any(), inst)
            wanted[was["inst"] == inst] = uid
        np.testing.assert_array_equal(found["uid"], wanted)
        return found, texts

    def test_of_instances_that_share_their_objects(self):
        scene = self.client.load("builtin:forest?trees=60", "woods", replace=True)
        before = self.seen(scene)
        most = np.bincount(before[0]["inst"][before[0]["inst"] < NONE]).argsort()[::-1]
        insts = before[0]["inst"].tolist()
        stands = [int(i) for i in most if i in insts and before[1][insts.index(i)].startswith("stand")][:2]
        first, second = stands
        with scene.edit() as edit:
            edit.set_uid([first, second], [70_000, 50_000])
        self.assertEqual(edit.instances, 2)
        after = self.follow(scene, before, {first: 70_000, second: 50_000})
        # An instance that shares its object with another one still moves by itself.
        with scene.edit() as edit:
            edit.move(first, (0, 300, 0))
            edit.set_uid(second, 6)
        with scene.edit() as edit:
            edit.move(first, (0, -300, 0))
        found = self.seen(scene)[0]
        wanted = after[0]["uid"].copy()
        wanted[wanted == 50_000] = 6
        np.testing.assert_array_equal(found["uid"], wanted)

    def street(self, of_file=True):
        """Cars and posts on ground. In a scene of a file nodes name the paths, and the posts share one."""
        wheels = [(1.3, 0.35, 1), (1.3, 0.35, -1), (-1.3, 0.35, 1), (-1.3, 0.35, -1)]
        car = self.client.scene_of({"body": box(4, 1.5, 2), "wheel": box(0.7, 0.7, 2.4)},
                                   {"body": ("body", (0, 1, 0)), "wheel": ("wheel", wheels)}, name="car", replace=True)
        post = self.client.scene_of({"post": box(1, 3, 1)}, name="post", replace=True)
        if of_file:
            street = self.client.scene_of({"ground": box(400, 0.1, 40)}, name="street", replace=True)
        else:
            # It has too many placements to be given nodes by the cars that have some.
            street = self.client.load("builtin:forest", "street", replace=True)
        with street.edit() as edit:
            edit.add(car, [(10 * i, 60, 5) for i in range(6)])
            edit.add(post, [(10 * i, 60, -5) for i in range(6)], name="post")
        return street

    def test_of_placements_that_share_a_node(self):
        self.check_street(True, "")

    def test_of_instances_without_nodes(self):
        self.check_street(False, "/post")

    def check_street(self, of_file, post):
        street = self.street(of_file)
        grid = np.zeros((61 * 20, 6))
        grid[:, 0], grid[:, 2] = [at.ravel() for at in np.meshgrid(np.linspace(-4, 56, 61), np.linspace(-7, 8, 20))]
        grid[:, 1], grid[:, 4] = 90, -1
        before = self.seen(street, grid)

        def number(text):
            at = next(i for i, one in enumerate(before[1]) if one.split("/")[0] == text)
            return int(before[0]["inst"][at])
        with street.edit() as edit:
            edit.set_uid(["car#3", "post#0", "post#2", "post#3"], [33, 100, 102, 102])
        given = {number("car#3"): 33, number("post#0"): 100, number("post#2"): 102, number("post#3"): 102}
        after = self.follow(street, before, given, grid)
        self.assertIn("car#3/wheel#1", after[1])
        self.assertEqual(street.path("post#3" + post)["steps"][-1]["uid"], 102)
        with street.edit() as edit:
            edit.set_uid("post*", 9)
            edit.set_uid("post#5", 10)
            edit.set_uid("car#3", 34)
        posts = {number(f"post#{i}"): 9 for i in range(5)}
        self.follow(street, before, {**posts, number("post#5"): 10, number("car#3"): 34}, grid)
        # Texts find what they found: parts of a node that was parted move, go and come.
        with street.edit() as edit:
            edit.move("post#2", (0, 5, 0))
            edit.move("car#3/wheel#1", (0, 9, 0))
            edit.remove("post#1")
            edit.add("post", (70, 60, -5), name="post")
        hits, texts = self.seen(street, [[20, 90, -5, 0, -1, 0], [40, 90, -5, 0, -1, 0], [70, 90, -5, 0, -1, 0],
                                         [31.3, 90, 4, 0, -1, 0], [10, 90, -5, 0, -1, 0]])
        self.assertEqual(texts[:4], ["post#2" + post, "post#4" + post, "post#6" + post, "car#3/wheel#1"])
        self.assertEqual(hits["t"][:4].tolist(), [23.5, 28.5, 28.5, np.float32(90 - 60 - 9.7)])
        self.assertEqual(hits["uid"][[0, 1, 3]].tolist(), [9, 9, 34])
        self.assertFalse(texts[4].startswith("post"))

    def test_of_what_lies_within_instances(self):
        for of_file in (True, False):
            with self.subTest(of_file=of_file):
                street = self.street(of_file)
                wheels = [[10 * i + x, 90, 5 + z, 0, -1, 0] for i in range(6) for x in (1.64, -1.64) for z in (1.1, -1.1)]
                bodies = [[10 * i, 90, 5, 0, -1, 0] for i in range(6)]
                rays = np.array(wheels + bodies)
                was, texts = self.seen(street, rays)
                is_wheel = [text.split("/")[1].startswith("wheel") for text in texts]
                self.assertEqual(is_wheel, 24 * [True] + 6 * [False])

                def check(given):
                    wanted = was["uid"].copy()
                    for number, text in enumerate(texts):
                        wanted[number] = given.get(text, given.get(text.split("/")[0], wanted[number]))
                    found, now = self.seen(street, rays)
                    self.assertEqual(now, texts)
                    np.testing.assert_array_equal(found["uid"], wanted)
                    for name in COLUMNS[:-1]:
                        np.testing.assert_array_equal(found[name], was[name], name)
                # The inner one counts where it is said later; what is said later of the outer one counts for all.
                with street.edit() as edit:
                    edit.set_uid("car#1", 9050)
                    edit.set_uid("car#1/wheel#2", 9051)
                    edit.set_uid("car#4/body", 9052)
                    edit.set_uid("car#5/wheel*", 9053)
                    edit.set_uid("car#5", 9054)
                given = {"car#1": 9050, "car#1/wheel#2": 9051, "car#4/body": 9052, "car#5": 9054}
                check(given)
                with street.edit() as edit:
                    edit.set_uid([f"car#4/wheel#{i}" for i in range(4)], range(9060, 9064))
                given.update({f"car#4/wheel#{i}": 9060 + i for i in range(4)})
                check(given)
                # One edit moves by user ids what it would move by texts.
                with street.edit() as edit:
                    edit.move(raynest.Uids([9051, 9054, 9062]), [(0, 1, 0), (0, 2, 0), (0, 3, 0)])
                self.assertEqual(edit.instances, 3)
                moved = {"car#1/wheel#2": 1, "car#5": 2, "car#4/wheel#2": 3}
                up = [moved.get(text, moved.get(text.split("/")[0], 0)) for text in texts]
                found = self.seen(street, rays)[0]
                np.testing.assert_allclose(found["t"], was["t"] - np.array(up), atol=1e-5)
                with street.edit() as edit:
                    edit.remove(raynest.Uids(9054))
                self.assertNotIn("car#5/body", self.seen(street, rays)[1])
                with self.assertRaisesRegex(raynest.Error, "user id 9054, which no instance has"), street.edit() as edit:
                    edit.move(raynest.Uids([9051, 9054]), (0, 1, 0))
                with self.assertRaisesRegex(raynest.Error, "removes what lies within"), street.edit() as edit:
                    edit.remove(raynest.Uids(9051))

    def test_of_nodes_that_place_nothing_themselves(self):
        gltf = Gltf()
        mesh = gltf.mesh(*box(1, 1, 1))
        groups = [gltf.node(name=name, children=[gltf.node(root=False, name="body", mesh=mesh)], translation=[x, 0, 0])
                  for name, x in (("A", 0), ("B", 10))]
        with tempfile.TemporaryDirectory() as folder:
            scene = self.client.load(str(gltf.write(Path(folder) / "groups.glb")), "groups", replace=True)
        old = [scene.path(f"{name}/body")["steps"][0]["uid"] for name in "AB"]
        self.assertEqual(old, groups)
        with scene.edit() as edit:
            edit.set_uid("A", old[1])
            edit.set_uid("B", old[0])
        self.assertEqual([[step["uid"] for step in scene.path(f"{name}/body")["steps"]] for name in "AB"],
                         [[old[1]] * 2, [old[0]] * 2])
        down = [[0, 9, 0, 0, -1, 0], [10, 9, 0, 0, -1, 0]]
        was = scene.trace(down)["t"]
        with scene.edit() as edit:
            edit.move(raynest.Uids(old[1]), (0, 2, 0))
        self.assertEqual(edit.instances, 1)
        np.testing.assert_allclose(scene.trace(down)["t"], was - [2, 0])

    def test_the_command_line_and_mistakes(self):
        street = self.street()
        down = [[30, 90, 5, 0, -1, 0], [20, 90, 5, 0, -1, 0]]
        uid = street.trace(down, fields=("uid",))["uid"]
        self.assertEqual(self.cli.json("edit", "street", "--set-uid", "car#3=4000000000")["instances"], 1)
        self.assertEqual(street.trace(down, fields=("uid",))["uid"].tolist(), [4_000_000_000, uid[1]])
        for text in ("-1", "x", "4294967296", "1.5", ""):
            refused = self.cli.run("edit", "street", "--set-uid", f"car#3={text}")
            self.assertEqual(refused.returncode, 2, refused.stderr)
            self.assertIn("is no user id", refused.stderr)
        refused = self.cli.run("edit", "street", "--set-uid", f"car#3={NONE}")
        self.assertIn("stands for none", refused.stderr)
        for wrong in (-1, NONE, 1.5, [1, 2], "x", None):
            with self.subTest(wrong), self.assertRaises((raynest.UsageError, TypeError)), street.edit() as edit:
                edit.set_uid("car#3", wrong)
        self.assertEqual(street.trace(down, fields=("uid",))["uid"].tolist(), [4_000_000_000, uid[1]])
        self.cli.json("edit", "street", "--move", "uid=4000000000=0,2,0")
        self.assertEqual(street.trace(down)["t"].tolist(), [26.25, 28.25])
        refused = self.cli.run("edit", "street", "--move", "uid=12345=0,2,0")
        self.assertEqual(refused.returncode, 2, refused.stderr)
        self.assertIn("names the user id 12345, which no instance has", refused.stderr)
        for wrong in (-1, NONE, 1.5, [[1, 2]], "x", None, [1, None]):
            with self.subTest(wrong), self.assertRaises((raynest.UsageError, TypeError)):
                raynest.Uids(wrong)
        with self.assertRaisesRegex(raynest.UsageError, "no instances"), street.edit() as edit:
            edit.hide(raynest.Uids([]))
        with self.assertRaisesRegex(raynest.UsageError, "3 matrices for 2 targets"), street.edit() as edit:
            edit.move(raynest.Uids([1, 2]), np.zeros((3, 3)))

    def test_an_edit_is_sent_once(self):
        scene = self.client.scene_of({"box": box(1, 1, 1)}, {"box": ("box", [(0, 0, 0), (9, 0, 0)])})
        for fails in (False, True):
            edit = scene.edit()
            try:
                with edit:
                    edit.move(0, (0, 1, 0))
                    if fails:
                        raise KeyError
            except KeyError:
                pass
            with self.assertRaisesRegex(raynest.UsageError, r"begin another with edit\(\)"), edit:
                edit.move(0, (0, 1, 0))
            self.assertEqual(scene.trace([[0, 9, 0, 0, -1, 0]], fields=("t",))["t"].tolist(), [7.5])


if __name__ == "__main__":
    main()
