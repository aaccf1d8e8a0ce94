#!/usr/bin/env python3
"""Edits: instances that move and hide, by text, number and array; epochs; faults.

  edits_test.py RAYNESTD RAYNEST FLATC
"""
import concurrent.futures
from types import SimpleNamespace

import numpy as np

import raynest
from with_daemon import WithDaemon, main, rain

RAYS = rain(3000)
RAYS[:, 5] = -1  # none of them upwards
COLUMNS = ("t", "prim", "inst", "uid", "path")


class Edits(WithDaemon):
    def setUp(self):
        self.scene = self.client.load("builtin:forest?trees=12", "edited", replace=True)
        self.epoch = self.scene.info["epoch"]
        self.before = self.trace()

    def trace(self, **options):
        return self.scene.trace(RAYS, fields=COLUMNS, **options)

    def test_all_that_moves_by_an_offset_is_hit_by_rays_that_move_with_it(self):
        with self.scene.edit() as edit:
            edit.move("*", (16, 0, 8))
        self.assertEqual(edit.epoch, self.epoch + 1)
        self.assertGreaterEqual(edit.instances, self.before["inst"][self.before["inst"] < 2**32 - 1].max() + 1)
        moved = RAYS.copy()
        moved[:, :3] += (16, 0, 8)
        hits = self.scene.trace(moved, fields=COLUMNS)
        same = hits["path"] == self.before["path"]
        self.assertGreater(same.mean(), 0.999)  # edges may round to the other side
        seen = same & np.isfinite(hits["t"])
        self.assertGreater(seen.sum(), 500)
        np.testing.assert_allclose(hits["t"][seen], self.before["t"][seen], rtol=1e-4)

    def test_one_instance_moves_and_all_others_stay(self):
        number = int(np.bincount(self.before["inst"][self.before["inst"] < 2**32 - 1]).argmax())
        text = self.scene.path_of(int(self.before["path"][self.before["inst"] == number][0])).split("/")[0]
        with self.scene.edit() as edit:
            edit.move(text, (0, 500, 0))
        self.assertEqual(edit.instances, 1)
        self.assertEqual((edit.refits + edit.rebuilds) > 0, True)
        after = self.trace()
        self.assertFalse((after["inst"] == number).any())  # far above where the rays begin
        others = self.before["inst"] != number
        for name in COLUMNS:
            np.testing.assert_array_equal(after[name][others], self.before[name][others])
        with self.scene.edit() as edit:
            edit.move(number, np.array([[1, 0, 0, 0], [0, 1, 0, -500], [0, 0, 1, 0], [0, 0, 0, 1]]))
        np.testing.assert_array_equal(self.trace()["inst"] == number, self.before["inst"] == number)

    def test_hidden_instances_are_those_that_hide_leaves_out(self):
        shown = self.trace(hide=["inst=1", "inst=2"])
        with self.scene.edit() as edit:
            edit.hide(np.array([1, 2]))
        self.same(dict(self.trace()), dict(shown))
        with self.scene.edit() as edit:
            edit.show([1, 2])
        self.same(dict(self.trace()), dict(self.before))
        with self.scene.edit() as edit:
            edit.set_mask([1, 2], 0x10)
        self.same(dict(self.trace(mask=0x01)), dict(shown))
        self.same(dict(self.trace(mask=0x10)), dict(self.before))

    def test_arrays_place_many_at_once(self):
        count = self.before["inst"][self.before["inst"] < 2**32 - 1].max() + 1
        matrices = np.zeros((count, 3, 4))
        matrices[:, :3, :3] = np.eye(3)
        matrices[:, 0, 3] = np.arange(count) * 1000.0
        with self.scene.edit() as edit:
            edit.place(np.arange(count), matrices)
        self.assertEqual(edit.instances, count)
        rays = np.zeros((count, 6))
        rays[:, 0] = np.arange(count) * 1000.0
        rays[:, 1], rays[:, 4] = 900, -1
        hits = self.scene.trace(rays, fields=("inst",))
        met = hits["inst"] < 2**32 - 1
        self.assertGreater(met.sum(), 50)
        np.testing.assert_array_equal(hits["inst"][met], np.arange(count)[met])

    def test_an_edit_of_another_epoch_is_refused(self):
        with self.scene.edit(epoch=self.epoch) as edit:
            edit.hide(0)
        with self.assertRaisesRegex(raynest.InvalidError, f"is at epoch {self.epoch + 1}, not {self.epoch}"):
            with self.scene.edit(epoch=self.epoch) as edit:
                edit.hide(1)
        self.assertEqual(self.scene.info["epoch"], self.epoch + 1)

    def test_what_runs_keeps_its_epoch(self):
        stream = self.scene.stream(np.tile(RAYS, (40, 1)), fields=("inst",))
        first = next(iter(stream))
        other = raynest.connect(self.daemon.uri)
        self.addCleanup(other.close)
        with other.scene("edited").edit() as edit:
            edit.hide("*")
        seen = np.zeros(40 * len(RAYS), np.uint32)
        for first_ray, columns in (first, *stream):
            seen[first_ray:first_ray + len(columns["inst"])] = columns["inst"]
        np.testing.assert_array_equal(seen, np.tile(self.before["inst"], 40))
        self.assertTrue((self.trace()["inst"] == 2**32 - 1).all())

    def test_edits_at_one_time_follow_each_other(self):
        def nudge(number):
            with raynest.connect(self.daemon.uri) as client:
                scene = client.scene("edited")
                for _ in range(5):
                    with scene.edit() as edit:
                        edit.move(number, (0, 1, 0))
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            list(pool.map(nudge, range(4)))
        self.assertEqual(self.scene.info["epoch"], self.epoch + 20)
        with self.scene.edit() as edit:
            edit.move([0, 1, 2, 3], (0, -5, 0))
        np.testing.assert_allclose(self.trace()["t"], self.before["t"], rtol=1e-4)

    def test_a_wrong_edit_changes_nothing(self):
        cases = [
            (lambda edit: edit.hide("no-such-*"), "no path is of the form 'no-such-\\*'"),
            (lambda edit: edit.move("nothing", (1, 0, 0)), "has no 'nothing'"),
            (lambda edit: edit.hide(4000), "outermost instance 4000; the scene has"),
            (lambda edit: edit.move(0, (np.nan, 0, 0)), "not finite"),
            (lambda edit: edit.move(0, (3e15, 0, 0)), "1e15"),
            (lambda edit: edit.move(0, np.zeros((3, 4))), "singular"),
        ]
        for change, words in cases:
            with self.subTest(words=words), self.assertRaisesRegex(raynest.Error, words):
                with self.scene.edit() as edit:
                    edit.hide(1)
                    change(edit)
        for change, kind, words in (
                (lambda edit: edit.hide([]), raynest.UsageError, "no instances"),
                (lambda edit: edit.hide(1.5), TypeError, "names no instance"),
                (lambda edit: edit.move(0, (1, 2)), raynest.UsageError, "has shape"),
                (lambda edit: edit.move([0, 1], np.zeros((3, 3, 4))), raynest.UsageError, "3 matrices for 2"),
                (lambda edit: edit.set_mask(0, -1), raynest.UsageError, "whole number")):
            with self.subTest(words=words), self.assertRaisesRegex(kind, words):
                with self.scene.edit() as edit:
                    edit.hide(1)
                    change(edit)
        self.assertEqual(self.scene.info["epoch"], self.epoch)
        self.same(dict(self.trace()), dict(self.before))

    def test_a_scene_of_parts_is_moved_by_its_places(self):
        ground = (np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]]),
                  [[0, 1, 2], [0, 2, 3]])
        box = SimpleNamespace(vertices=np.array([[-1, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]]),
                              faces=np.array([[0, 1, 2], [0, 2, 3]]))
        where = np.array([[0, 0, 0], [10, 0, 0], [20, 2, 0]])
        scene = self.client.scene_of({"ground": ground, "box": box},
                                     {"ground": "ground", "car": ("box", where), "hut": ("box", (0, 4, 9))})
        self.assertEqual(scene.info["unique_triangles"], 4)
        self.assertEqual(scene.info["instances"], 5)
        down = [[*(place + (0.5, 30, 0.25)), 0, -1, 0] for place in (*where, np.array((0, 4, 9)))]
        hits = scene.trace(down, fields=("t", "inst", "path"))
        self.assertEqual(hits["t"].tolist(), [29, 29, 29, 29])
        self.assertEqual(hits["inst"].tolist(), [1, 2, 3, 4])
        self.assertEqual(scene.path_of(hits["path"]), ["car#0", "car#1", "car#2", "hut"])
        with scene.edit() as edit:
            edit.move(["car#0", "car#2"], [(0, 1, 0), (0, 2, 0)])
            edit.place("hut", np.column_stack([2 * np.eye(3), (0, 0, 9)]))
        self.assertEqual(scene.trace(down, fields=("t",))["t"].tolist(), [28, 29, 27, 32])
        again = self.client.scene_of({"ground": ground}, name="just-ground")
        self.assertEqual(again.trace([[3, 8, 4, 0, -1, 0]], fields=("t",))["t"][0], 8)
        for parts, places, words in (
                ({}, None, "a dict of meshes"), ({"a": 3}, None, "must be \\(vertices, faces\\)"),
                ({"a": ground}, {"b": "c"}, "is no part"), ({"a": ground}, {"b": ("a", np.eye(2))}, "shape"),
                ({"a": ground}, {"b": ("a", (np.nan, 0, 0))}, "not finite"), ({1: ground}, None, "no name")):
            with self.subTest(words=words), self.assertRaisesRegex((TypeError, raynest.UsageError), words):
                self.client.scene_of(parts, places)

    def test_a_scene_without_instances_says_so(self):
        scene = self.client.load("builtin:terrain?size=16", "plain", replace=True)
        with self.assertRaisesRegex(raynest.UsageError, "'plain' has no instances to edit"):
            with scene.edit() as edit:
                edit.move(0, (1, 0, 0))

    def test_a_scene_with_an_origin_moves_in_the_world(self):
        place = np.array((500000.25, 0, 4000000.5))
        corners = np.array([[0, 0, 0], [4, 0, 0], [0, 0, 4]]) + place
        scene = self.client.mesh(corners, [[0, 1, 2]], origin=place)
        ray = [*(place + (1, 5, 1)), 0, -1, 0]
        self.assertEqual(scene.trace([ray])["t"][0], 5)
        with scene.edit() as edit:
            edit.move("*", (3, 0.5, -2))
        self.assertEqual(scene.trace([ray])["t"][0], np.inf)
        ray[0], ray[2] = ray[0] + 3, ray[2] - 2
        hit = scene.trace([ray], fields=("t", "position"))
        self.assertEqual(hit["t"][0], 4.5)
        np.testing.assert_allclose(hit["position"][0], place + (4, 0.5, -1), atol=1e-6)
        # A quarter turn about the world's vertical axis through the triangle's corner.
        corner = place + (3, 0.5, -2)
        turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        with scene.edit() as edit:
            edit.move(0, np.column_stack([turn, corner - turn @ corner]))
        ray = [*(corner + turn @ (1, 5, 1)), 0, -1, 0]
        self.assertEqual(scene.trace([ray])["t"][0], 5)
        with self.assertRaisesRegex(raynest.UsageError, "move it instead"):
            with scene.edit() as edit:
                edit.place(0, np.eye(4))

    def test_the_command_line_edits_too(self):
        hidden = self.trace(hide=["inst=1"])
        done = self.cli.json("edit", "edited", "--move", "inst=1=0,1000,0",
                             "--move", "inst=1=0,-1000,0", "--hide", "inst=1")
        self.assertEqual((done["epoch"], done["instances"]), (self.epoch + 1, 1))
        self.same(dict(self.trace()), dict(hidden))
        self.assertIn(f"edited is at epoch {self.epoch + 2}: 1 instance has changed",
                      self.cli.run("edit", "edited", "--show", "inst=1").stdout)
        refused = self.cli.run("edit", "edited", "--move", "inst=1=1,2")
        self.assertEqual(refused.returncode, 2)
        self.assertIn("dx,dy,dz", refused.stderr)


if __name__ == "__main__":
    main()
