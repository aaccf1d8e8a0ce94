#!/usr/bin/env python3
"""Edits: instances that move, hide, go and come, by text, number and array, at any depth; epochs; faults.

  edits_test.py RAYNESTD RAYNEST FLATC
"""
import concurrent.futures
import os
import signal
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import raynest
from daemon import Daemon, until
from with_daemon import WithDaemon, main, rain

RAYS = rain(3000)
RAYS[:, 5] = -1  # none of them upwards
COLUMNS = ("t", "prim", "inst", "uid", "path")


def box(x, y, z):
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * (x / 2, y / 2, z / 2)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return corners, faces


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

    def test_each_instance_gets_its_mask(self):
        seen = np.unique(self.before["inst"][self.before["inst"] < 2**32 - 1])[:3].tolist()
        with self.scene.edit() as edit:
            edit.set_mask("*", 8).set_mask(seen, [1, 2, 4])
        for number, mask in zip(seen, (1, 2, 4)):
            found = self.trace(mask=mask)["inst"]
            self.assertEqual(set(found[found < 2**32 - 1].tolist()), {number})
        with self.scene.edit() as edit:
            edit.show(seen)
        self.same(dict(self.trace(mask=2**31)), dict(self.trace(only=seen)))
        for masks, why in (([1, 2], "2 masks for 3 targets"), ([1, 2, -1], "whole number"), ([1, 2, 2**32], "whole number"),
                           ([1, 2, 0.5], "whole number"), ([[1, 2, 4]], r"mask has shape \(1, 3\)"),
                           ([[1], [1, 2]], "a mask must be numbers, in rows of one length")):
            with self.assertRaisesRegex((raynest.UsageError, TypeError), why), self.scene.edit() as edit:
                edit.set_mask(seen, masks)

    def test_a_batch_of_no_changes_is_not_sent(self):
        with self.scene.edit() as edit:
            pass
        self.assertEqual((edit.instances, edit.refits, edit.kept, list(edit.notes)), (0, 0, False, []))
        self.assertEqual(self.scene.info["epoch"], self.epoch)

    def test_counts_of_an_edited_scene_say_so(self):
        def notes():
            self.scene.heatmap(size=(8, 8))
            return [note for note in self.client.outcome["notes"] if "was edited" in note]
        self.assertEqual(notes(), [])
        with self.scene.edit() as edit:
            edit.move(0, (0, 1, 0))
        self.assertRegex(" ".join(notes()), "these counts, may differ from those of the same content loaded afresh")

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

    def test_a_request_names_an_epoch_that_is_still_there(self):
        with self.scene.edit() as edit:
            edit.hide("*")
        # The next edit is to be made in the memory of the epoch before this one, which stays until then.
        earlier = self.trace(epoch=self.epoch)
        self.same(dict(earlier), dict(self.before))
        self.assertEqual(self.client.outcome["epoch"], self.epoch)
        self.assertTrue((self.trace()["inst"] == 2**32 - 1).all())
        # The epoch that a stream reads is there for others, too, however many edits come meanwhile.
        stream = self.scene.stream(np.tile(RAYS, (40, 1)), fields=("inst",), epoch=self.epoch)
        next(iter(stream))
        other = raynest.connect(self.daemon.uri)
        self.addCleanup(other.close)
        edited = other.scene("edited")
        for mask in (1, 2, 3):
            with edited.edit() as edit:
                edit.set_mask("*", mask)
        np.testing.assert_array_equal(edited.trace(RAYS, fields=("inst",), epoch=self.epoch)["inst"], self.before["inst"])
        for _ in stream:
            pass
        with edited.edit() as edit:
            edit.set_mask("*", 4)
        with self.assertRaisesRegex(raynest.InvalidError, f"is at epoch {self.epoch + 5}, not {self.epoch}; leave epoch= out"):
            edited.trace(RAYS, epoch=self.epoch)
        # A load leaves none of them.
        before = edited.info["epoch"]
        again = self.client.load("builtin:flake", "edited", replace=True)
        with self.assertRaisesRegex(raynest.InvalidError, f"not {before}"):
            again.trace(RAYS, epoch=before)

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

    def pair(self, name):
        """A scene of two squares at height 0 that every edit moves together, and rays down to both."""
        square = ([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], [[0, 1, 2], [0, 2, 3]])
        scene = self.client.scene_of({"square": square}, {"a": "square", "b": ("square", (10, 0, 0))}, name=name)
        return scene, [[0.3, 2000, 0.2, 0, -1, 0], [10.3, 2000, 0.2, 0, -1, 0]]

    def test_each_of_many_readers_sees_one_epoch(self):
        scene, rays = self.pair("pair")
        first = scene.info["epoch"]
        edits = 1000
        stop = threading.Event()
        newest = [first] * 8  # by reader

        def read(number):
            seen = set()
            with raynest.connect(self.daemon.uri) as client:
                mine = client.scene("pair")
                while not stop.is_set():
                    a, b = mine.trace(rays, fields=("t",))["t"].tolist()
                    self.assertEqual(a, b)
                    self.assertEqual(2000 - a, client.outcome["epoch"] - first)  # as high as there were edits
                    newest[number] = client.outcome["epoch"]
                    seen.add(newest[number])
            return seen
        with concurrent.futures.ThreadPoolExecutor(8) as pool:
            readers = [pool.submit(read, number) for number in range(8)]
            try:
                for made in range(edits):
                    if made % 100 == 50:  # all read on, however slow the machine is
                        until(lambda: min(newest) >= first + made - 40 or any(each.done() for each in readers))
                    with scene.edit() as edit:
                        edit.move(["a", "b"], (0, 1, 0))
            finally:
                stop.set()
            seen = set().union(*(reader.result() for reader in readers))
        self.assertEqual(scene.info["epoch"], first + edits)
        self.assertGreaterEqual(len(seen), 10)

    def test_clients_that_are_killed_leave_no_half_epoch(self):
        scene, rays = self.pair("killed")
        random = np.random.default_rng(2)

        def change(mine):
            with mine.edit() as edit:  # 0.5 MB, so that many die within it
                edit.move("a", (0, 1, 0))
                edit.move(np.zeros(5000, np.int64), (0, 0, 0))
                edit.move("b", (0, 1, 0))
        began = time.monotonic()
        change(scene)
        took = time.monotonic() - began
        for _ in range(100):
            delay = random.uniform(0.0005, 2 * took + 0.005)
            child = os.fork()
            if child == 0:
                try:
                    client = raynest.connect(self.daemon.uri)
                    mine = client.scene("killed")
                    signal.signal(signal.SIGALRM, signal.SIG_DFL)
                    signal.setitimer(signal.ITIMER_REAL, delay)
                    while True:
                        change(mine)
                finally:
                    os._exit(1)
            self.assertEqual(os.WTERMSIG(os.waitpid(child, 0)[1]), signal.SIGALRM)
            a, b = scene.trace(rays, fields=("t",))["t"].tolist()
            self.assertEqual(a, b)
        self.assertLess(a, 1999)  # some of them were whole

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
                (lambda edit: edit.hide([[1], [1, 2]]), TypeError, "names no instance"),
                (lambda edit: edit.move(0, (1, 2)), raynest.UsageError, "has shape"),
                (lambda edit: edit.place("birch-*", np.zeros((3, 3, 4))), raynest.UsageError,
                 r"3 matrices for \d+ targets: .* 'birch-\*' stands for"),
                (lambda edit: edit.set_uid("birch-*", [1, 2]), raynest.UsageError, "2 uids for .* stands for"),
                (lambda edit: edit.set_uid([0, 1], [1, 2, 3]), raynest.UsageError,
                 "3 uids for 2 targets: give one, or one for each$"),
                (lambda edit: edit.move([0, 1], np.zeros((3, 3, 4))), raynest.UsageError, "3 matrices for 2"),
                (lambda edit: edit.hide(np.array([2**32])), raynest.UsageError, "instances must be whole numbers"),
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
        with self.assertRaisesRegex(raynest.UsageError, "'plain' has no instances to change"):
            with scene.edit() as edit:
                edit.move(0, (1, 0, 0))
        with self.assertRaisesRegex(raynest.UsageError, "'plain' has no instances to change"):
            with scene.edit() as edit:
                edit.hide("anything")
        before = scene.trace(RAYS, fields=("t", "prim"))
        with scene.edit() as edit:
            edit.add(self.client.scene_of({"post": box(0.1, 100, 0.1)}, name="post"), (5000, 0, 0))
        self.same(dict(scene.trace(RAYS, fields=("t", "prim"))), dict(before))
        self.assertEqual(scene.info["instances"], 2)

    def car(self, name):
        wheels = [(1.3, 0.35, 1), (1.3, 0.35, -1), (-1.3, 0.35, 1), (-1.3, 0.35, -1)]
        return self.client.scene_of({"body": box(4, 1.5, 2), "wheel": box(0.7, 0.7, 0.2)},
                                    {"body": ("body", (0, 1, 0)), "wheel": ("wheel", wheels)}, name=name)

    def test_scenes_are_added_to_others_and_their_parts_move_at_one_place(self):
        car = self.car("car")
        street = self.client.scene_of({"ground": box(400, 0.1, 40)}, name="street")
        with street.edit() as edit:
            edit.add(car, [(10 * i, 0, 5) for i in range(20)])
        self.assertEqual(edit.instances, 20)
        bytes_of_20 = street.info["bytes"]
        with street.edit() as edit:
            edit.add("car", (0, 0, -5), name="taxi")
            edit.move("car#3/wheel*", (0, 0.5, 0))
            edit.move("car#3/wheel#1", [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]], frame="own")
            edit.hide("car#5/body")
        self.assertEqual(edit.instances, 6)
        # The car is stored once: what has come is one copy of it, with its own wheels.
        self.assertLess(street.info["bytes"] - bytes_of_20, 16384)
        down = lambda *at: [*at[:1], 50, *at[1:], 0, -1, 0]
        rays = [down(30, 5), down(31.3, 6.05), down(28.7, 4), down(41.3, 6.05), down(50, 5), down(0, -5)]
        hits = street.trace(rays, fields=("t", "path"))
        self.assertEqual(street.path_of(hits["path"]),
                         ["car#3/body", "car#3/wheel#0", "car#3/body", "car#4/wheel#0", "ground", "taxi/body"])
        np.testing.assert_allclose(hits["t"], [50 - 1.75, 50 - 1.2, 50 - 1.75, 50 - 0.7, 50 - 0.05, 50 - 1.75],
                                   atol=1e-5)
        # A car goes: the others keep their texts, and the next one that comes has a new number.
        with street.edit() as edit:
            edit.remove("car#3")
            edit.move("car#4", (0, 0, 1))
            edit.add(car, (30, 0, 8))
        hits = street.trace([down(30, 5), down(40, 6), down(30, 8)], fields=("path",))
        self.assertEqual(street.path_of(hits["path"]), ["ground", "car#4/body", "car#20/body"])
        # Rays answer as in the same content loaded at once.
        places = {i: (10 * i, 0, 5) for i in range(20) if i != 3}
        places[4] = (40, 0, 6)
        bodies = [np.add(at, (0, 1, 0)) for i, at in (*places.items(), (20, (0, 0, -5)), (21, (30, 0, 8))) if i != 5]
        fresh = self.client.scene_of({"ground": box(400, 0.1, 40), "body": box(4, 1.5, 2)},
                                     {"ground": "ground", "body": ("body", bodies)}, name="fresh")
        above = np.zeros((2000, 6))
        above[:, 0], above[:, 2] = np.random.default_rng(3).uniform((-5, -8), (205, 12), (2000, 2)).T
        above[:, 1], above[:, 4] = 20, -1
        theirs = fresh.trace(above, fields=("t",))["t"]
        with street.edit() as edit:
            edit.hide("*wheel*")
        np.testing.assert_array_equal(street.trace(above, fields=("t",))["t"], theirs)

    def test_what_cannot_go_or_come_is_refused(self):
        car = self.car("whole")
        street = self.client.scene_of({"ground": box(400, 0.1, 40)}, name="road")
        with street.edit() as edit:
            edit.add(car, (0, 0, 0))
        for change, kind, words in (
                (lambda edit: edit.remove("whole/body"), raynest.UsageError, "hide it instead"),
                (lambda edit: edit.add("no-scene"), raynest.Error, "'no-scene' is not loaded"),
                (lambda edit: edit.add(car, (2e15, 0, 0)), raynest.UsageError, "1e15"),
                (lambda edit: edit.add(car, np.zeros((3, 4))), raynest.UsageError, "'whole' is singular"),
                (lambda edit: edit.add(3), TypeError, "is no scene"),
                (lambda edit: edit.add(car, name=3), TypeError, "3 is no name of a placement"),
                (lambda edit: edit.add(car, name="a\nb"), raynest.UsageError, r"no name of a placement: leave '\\n' out"),
                (lambda edit: edit.add(car, np.zeros((0, 3))), raynest.UsageError, "no placement"),
                (lambda edit: edit.place("whole", np.eye(4), frame="own"), raynest.UsageError, "'world' or 'parent'"),
                (lambda edit: edit.move("whole", (1, 0, 0), frame="mine"), raynest.UsageError, "frame is 'mine'")):
            with self.subTest(words=words), self.assertRaisesRegex(kind, words):
                with street.edit() as edit:
                    edit.hide("ground")
                    change(edit)
        self.assertEqual(street.info["epoch"], 2)

    def test_a_scene_of_another_daemon_is_added_only_where_it_is_here_too(self):
        street, other = self.client.scene_of({"ground": box(400, 0.1, 40)}), Daemon(self.raynestd)
        self.addCleanup(other.stop)
        car = self.enterContext(raynest.connect(other.uri)).scene_of({"body": box(4, 2, 2)}, name="bus")
        words = f"the scene 'bus' is at {other.uri}: load it at this daemon, too"
        with self.assertRaisesRegex(raynest.UsageError, words):
            street.add(car)
        self.client.scene_of({"body": box(4, 4, 2)}, name="bus")
        with self.assertRaisesRegex(raynest.UsageError, words):
            street.add(car)
        self.client.scene_of({"body": box(4, 2, 2)}, name="bus", replace=True)
        street.add(car)
        with raynest.connect(self.daemon.uri) as again:
            street.add(again.scene("bus"), (9, 0, 0))
        self.assertEqual(street.trace([[0, 9, 0, 0, -1, 0], [9, 9, 0, 0, -1, 0]], fields=("t",))["t"].tolist(), [8, 8])

    def test_a_scene_becomes_part_of_a_built_in_one(self):
        with self.scene.edit() as edit:
            edit.add(self.car("jeep"), [(0, 300, 0), (20, 300, 0)])
        hits = self.scene.trace([[0, 400, 0, 0, -1, 0], [20, 400, 0, 0, -1, 0]], fields=("t", "path"))
        self.assertEqual(self.scene.path_of(hits["path"]), ["jeep#0/body", "jeep#1/body"])
        np.testing.assert_allclose(hits["t"], 100 - 1.75, rtol=1e-6)
        self.same(dict(self.trace()), dict(self.before))

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
        self.assertIn("x,y,z", refused.stderr)
        self.car("van")
        done = self.cli.json("edit", "edited", "--add", "van=0,300,0", "--add", "van=9,300,0", "--remove", "inst=1")
        self.assertEqual((done["epoch"], done["instances"]), (self.epoch + 3, 3))
        done = self.cli.json("edit", "edited", "--turn", "van#1/wheel#2=0,-1,0,0,1,0,0,0,0,0,1,0")
        self.assertEqual(done["instances"], 1)
        hits = self.scene.trace([[0, 400, 0, 0, -1, 0], [9, 400, 0, 0, -1, 0]], fields=("path",))
        self.assertEqual(self.scene.path_of(hits["path"]), ["van#0/body", "van#1/body"])
        changes = Path(self.enterContext(tempfile.TemporaryDirectory())) / "changes.txt"
        changes.write_text("# two of them\n\nmove van#0=0,5,0\nturn van#1/wheel#2=0,-1,0,0,1,0,0,0,0,0,1,0\r\n")
        done = self.cli.json("edit", "edited", "--file", changes, "--hide", "inst=2")
        self.assertEqual(done["instances"], 3)
        self.assertEqual(self.scene.trace([[0, 400, 0, 0, -1, 0]], fields=("t",))["t"][0], np.float32(93.25))
        for text, words in (("jump van#0=1,0,0", "line 1 of .*: 'jump van#0=1,0,0' does not begin with one of"),
                            ("hide van#0\nmove van#0", "line 2 of .*'van#0' is not PATH="), ("hide", "line 1"),
                            ("move =1,2,3", "is not PATH=")):
            changes.write_text(text)
            refused = self.cli.run("edit", "edited", "--file", changes)
            self.assertEqual(refused.returncode, 5)
            self.assertRegex(refused.stderr, words)
        self.assertIn("no-such-file", self.cli.run("edit", "edited", "--file", "no-such-file").stderr)


if __name__ == "__main__":
    main()
