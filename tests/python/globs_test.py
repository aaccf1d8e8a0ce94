#!/usr/bin/env python3
"""Texts with '*': what they stand for, and edits that give each of these a value of its own.

  globs_test.py RAYNESTD RAYNEST FLATC
"""
from unittest import mock

import numpy as np

import raynest
from raynest import _paths
from edits_test import box
from with_daemon import WithDaemon, main

WHEELS = np.array([(1.3, 0.35, 1), (1.3, 0.35, -1), (-1.3, 0.35, 1), (-1.3, 0.35, -1)])


class Globs(WithDaemon):
    def setUp(self):
        """A street of twelve cars, each a group of a body and four wheels, and a post beside each."""
        self.places = np.array([(10.0 * i, 0, 0) for i in range(12)])
        self.scene = self.client.scene_of(
            {"body": box(4, 1.5, 2), "wheel": box(0.7, 0.7, 0.2), "post": box(0.2, 2, 0.2),
             "car": {"body": ("body", (0, 1, 0)), "wheel": ("wheel", WHEELS)}},
            {"car": ("car", self.places), "post": ("post", self.places + (5, 0, 0))})

    def heights(self, points):
        """Where rays from above the points end; 0 for a miss."""
        rays = [(x, 500, z, 0, -1, 0) for x, _, z in points]
        return np.nan_to_num(500 - self.scene.trace(rays, fields=("t",))["t"].astype(np.float64), neginf=0).round(3).tolist()

    def test_parts_are_found_in_the_order_of_their_paths(self):
        self.assertEqual(self.scene.find("car#3/wheel*"), [f"car#3/wheel#{i}" for i in range(4)])
        # Letters would put car#10 before car#2.
        self.assertEqual(self.scene.find("car*"), [f"car#{i}" for i in range(12)])
        self.assertEqual(self.scene.find("*#1*/body"), ["car#1/body", "car#10/body", "car#11/body"])
        self.assertEqual(self.scene.find("post#7"), ["post#7"])
        for glob in ("bus*", "wheel*", "car#3/wheel"):
            with self.assertRaisesRegex(raynest.UsageError, "no path is of the form"):
                self.scene.find(glob)
        for wrong in ("", 3, None, b"car"):
            with self.assertRaisesRegex(TypeError, "is no text of paths"):
                self.scene.find(wrong)
        with mock.patch.object(_paths, "_SEARCHED_MAX", 20), self.assertRaisesRegex(raynest.UsageError, "at most 20: give the texts"):
            self.scene.find("car*")
        with self.scene.edit() as edit:
            edit.remove("car#11")
        self.assertEqual(self.scene.find("car*"), [f"car#{i}" for i in range(11)])
        self.assertEqual(self.scene.find("car*", epoch=edit.epoch - 1), [f"car#{i}" for i in range(12)])
        with self.assertRaisesRegex(raynest.Error, "epoch"):
            self.scene.find("car*", epoch=edit.epoch + 1)

    def test_each_part_that_a_text_stands_for_gets_its_value(self):
        up = np.zeros((4, 3))
        up[:, 1] = (10, 20, 30, 40)
        matrices = np.tile(np.eye(4)[:3], (4, 1, 1))
        matrices[:, :, 3] = up
        for given in (up, matrices):
            with self.scene.edit() as edit:
                edit.move("car#3/wheel*", given)
            self.assertEqual(edit.instances, 4)
        self.assertEqual(self.heights(WHEELS + (30, 0, 0)), [20.7, 40.7, 60.7, 80.7])
        self.assertEqual(self.heights(WHEELS + (20, 0, 0)), [1.75] * 4)    # the body's, above the wheels
        with self.scene.edit() as edit:
            edit.move(["post#0", "car#1*"], [(0, 7, 0), (0, 1, 0)])        # a text has one value where these suffice
            edit.move(["post#1", "car#1*"], [(0, 8, 0), (0, 0, 0), (0, 5, 0), (0, 6, 0)])
            edit.place("post#1*", [np.column_stack([np.eye(3), at]) for at in ((15, 100, 0), (105, 200, 0), (115, 300, 0))])
        self.assertEqual(self.heights(self.places[[1, 10, 11]]), [2.75, 7.75, 8.75])
        self.assertEqual(self.heights(self.places[[0, 1, 2, 10, 11]] + (5, 0, 0)), [8, 101, 1, 201, 301])
        with self.scene.edit() as edit:
            edit.set_mask("car*", 1 << np.arange(12)).set_uid("post*", range(100, 112))
        seen = self.scene.trace([(*(self.places[5] + (0, 9, 0)), 0, -1, 0)] * 2, mask=np.array([16, 32]), fields=("hit",))
        self.assertEqual(seen["hit"].tolist(), [False, True])
        seen = self.scene.trace([(*(self.places[4] + (5, 9, 0)), 0, -1, 0)], fields=("uid",))
        self.assertEqual(seen["uid"].tolist(), [104])

    def test_what_stands_in_a_part_is_not_the_part(self):
        column = [(*(self.places[2] + (0.3, 9, 0.1)), 0, -1, 0)]
        masks = lambda: self.scene.trace(column, fields=("mask",), kind="all", max_hits=8)["mask"].tolist()
        top = lambda: self.scene.path_of(self.scene.trace(column, fields=("path",))["path"])[0]
        with self.scene.edit() as edit:
            edit.set_mask("car#2/*", 6)
        self.assertEqual((edit.instances, masks()), (5, [6, 6]))
        for change in (lambda edit: edit.hide("car#2/*"), lambda edit: edit.show("car#2/body")):
            with self.scene.edit() as edit:
                change(edit)
        self.assertEqual(top(), "car#2/body")
        turn = np.array([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]])
        for given in (turn, [turn] * 5):    # each part turns where it is
            with self.scene.edit() as edit:
                edit.move("car#3/*", given, "own")
            self.assertEqual((edit.instances, self.heights(self.places[[3]])), (5, [1.75]))
        for text in ("car#4/*", "car#4/body"):
            with self.assertRaisesRegex(raynest.UsageError, "removes what lies within an instance"), self.scene.edit() as edit:
                edit.remove(text)
        # One part alone in a car has the same paths as the car.
        lone = self.client.scene_of({"body": box(2, 1, 2), "car": {"body": ("body", (3, 0, 0))}}, {"car": ("car", np.eye(2, 3) * 20)})
        for text, x in (("car#0/body", 23), ("car#0/*", 23), ("car#0", 17)):
            with lone.edit() as edit:
                edit.move(text, turn, "own")
            self.assertEqual(edit.instances, 1)
            hits = lone.trace([(x, 9, 0, 0, -1, 0)], fields=("hit", "path"))
            self.assertEqual((hits["hit"].all(), lone.path_of(hits["path"])), (True, ["car#0/body"]), text)

    def test_numbers_are_written_in_one_way_and_the_last_one_is_told(self):
        # With user ids of its own the scene has nodes, of which one names several posts.
        scene = self.client.scene_of({"post": box(1, 1, 1)}, {"post": raynest.Place("post", 3 * np.eye(3), uid=[5, 5, 5])})
        with scene.edit() as edit:
            edit.remove("post#1")
        for text, words in (("post#1", "'post#1' places nothing that can be hit"), ("post#3", "no 'post#3': the last one is 'post#2'"),
                            ("post#00", "no 'post#00'")):
            with self.assertRaisesRegex(raynest.UsageError, words), scene.edit() as edit:
                edit.hide(text)

    def test_values_that_do_not_fit_are_told_how_many_match(self):
        edit = self.scene.edit()
        for call, words in ((lambda: edit.move("car#3/wheel*", np.zeros((3, 3))),
                             r"3 matrices for 4 targets: give one, or one for each: 'car#3/wheel\*' stands for 4$"),
                            (lambda: edit.set_mask(["post#0", "car*"], [1] * 5), r"5 masks for 13 .*'car\*' stands for 12$"),
                            (lambda: edit.set_uid("post*", [1, 2]), r"2 uids for 12 .*'post\*' stands for 12$"),
                            (lambda: edit.move("car#3", np.zeros((3, 3))), "3 matrices for 1 target.*list those"),
                            (lambda: edit.move("bus*", np.zeros((3, 3))), r"no path is of the form 'bus\*'")):
            with self.assertRaisesRegex(raynest.UsageError, words):
                call()

    def test_more_parts_than_an_edit_takes_texts(self):
        many = np.array([(3.0 * i, 0, 0) for i in range(700)])
        self.scene = self.client.scene_of({"box": box(1, 1, 1)}, {"box": ("box", many)})
        edit = self.scene.edit()
        with edit:
            edit.move("box*", np.outer(np.arange(700), (0, 0.25, 0)))
        self.assertEqual(self.heights(many[[0, 1, 2, 699]]), [0.5, 0.75, 1, 175.25])
        # The numbers belong to the epoch in which they were found.
        late = self.scene.edit()
        late.move("box*", np.zeros((700, 3)))
        with self.scene.edit() as other:
            other.remove("box#0")
        with self.assertRaisesRegex(raynest.Error, f"epoch {other.epoch}, not {edit.epoch}"), late:
            pass

    def test_a_mesh_of_few_of_its_vertices_takes_those(self):
        points = np.random.default_rng(3).uniform(-1, 1, (1000, 3)).astype(np.float32)
        faces = np.array([[0, 500, 999], [7, 500, 3], [998, 2, 4]])
        # A scene with spheres is sent in a form that keeps all vertices.
        for scene, wanted in ((self.client.mesh(points, faces), points[np.unique(faces)]),
                              (self.client.scene_of({"mesh": (points, faces)}), points[np.unique(faces)]),
                              (self.client.scene_of({"mesh": (points, faces), "ball": raynest.Spheres([[9, 0, 0]], 1)}), points)):
            with scene.edit() as edit:
                edit.set_vertices("mesh", wanted + np.float32([0, 8, 0]))
            middle = points[faces].mean(axis=1) + (0, 8, 0)
            ways = np.cross(*(points[faces[:, i]] - points[faces[:, 0]] for i in (1, 2)))
            rays = np.hstack([middle + 1e-3 * ways, -ways])
            hits = scene.trace(rays, fields=("prim", "t"))
            self.assertEqual(hits["prim"].tolist(), [0, 1, 2])
            np.testing.assert_allclose(hits["t"], 1e-3, rtol=1e-2)


if __name__ == "__main__":
    main()
