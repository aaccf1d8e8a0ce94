#!/usr/bin/env python3
"""Edits of many texts, from files and from Python, are one epoch; errors say which change is wrong.

  edit_files_test.py RAYNESTD RAYNEST FLATC
"""
import json
import tempfile
from pathlib import Path

import numpy as np

import raynest
from raynest import _limits
from with_daemon import WithDaemon, main

COUNT = 1300    # more texts than a message has
SQUARE = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]), np.array([[0, 1, 2], [0, 2, 3]])


class EditFiles(WithDaemon):
    def setUp(self):
        self.folder = Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.at = np.zeros((COUNT, 3))
        self.at[:, 0] = 3 * np.arange(COUNT)
        cars = {"car": {"body": "square", "wheel": ("square", [[0, -1, 0], [0, -2, 0]])}, "square": SQUARE}
        self.row = self.client.scene_of({"square": SQUARE}, {"box": ("square", self.at)}, name="row", replace=True)
        self.cars = self.client.scene_of(cars, {"car": ("car", self.at)}, name="cars", replace=True)

    def heights(self, scene):
        rays = np.tile(np.array([.5, 5000, .5, 0, -1, 0]), (COUNT, 1))
        rays[:, 0] += self.at[:, 0]
        return 5000 - scene.trace(rays, fields=("t",))["t"]

    def edit(self, scene, text, *words):
        file = self.folder / "changes.txt"
        file.write_text(text)
        return self.cli.run("--json", "edit", scene, "--file", file, *words)

    def refused(self, scene, text, code, said):
        done = self.edit(scene, text)
        error = json.loads(done.stderr)["error"]
        self.assertEqual((done.returncode, done.stderr.count("\n")), (code, 1), done.stderr)
        self.assertRegex(error["message"], said)

    def test_a_file_of_many_texts_is_one_epoch(self):
        lines = [f"move box#{i}=0,{i},0" for i in range(COUNT)]
        before = self.row.info["epoch"]
        done = self.edit("row", "# all of them\n\n  # with a pause\n" + "\r\n".join(lines[:700]) +
                         "\n \t\n\t" + "  \n".join(lines[700:]) + "\nmove   box#7=0,0.5,0")
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads(done.stdout)
        self.assertEqual((told["epoch"], told["instances"]), (before + 1, COUNT))
        np.testing.assert_array_equal(self.heights(self.row), np.arange(COUNT) + 0.5 * (np.arange(COUNT) == 7))

    def test_many_texts_from_python_are_one_epoch(self):
        before = self.row.info["epoch"]
        heights = np.zeros((COUNT, 3))
        heights[:, 1] = np.arange(COUNT)[::-1]
        with self.row.edit() as edit:
            edit.move([f"box#{i}" for i in range(COUNT)], heights)
            edit.move("box#1*", (0, 0, 0))
        self.assertEqual((edit.epoch, edit.instances), (before + 1, COUNT))
        np.testing.assert_array_equal(self.heights(self.row), heights[:, 1])

    def test_parts_within_instances_keep_their_texts(self):
        # Beside many numbers there is room for a few.
        moves = [f"move car#{i}=0,{i},0" for i in range(600)]
        self.assertEqual(self.edit("cars", "\n".join([*moves, "move car#700/body=0,9,0"])).returncode, 0)
        np.testing.assert_array_equal(self.heights(self.cars)[[5, 599, 650, 700]], [5, 599, 0, 9])
        many = [f"car#{i}/body" for i in range(600)]
        said = "600 texts that use . or name a part within an instance, as 'car#0/body', and one edit takes 512, of 32768 bytes in all: let . stand for several"
        self.refused("cars", "\n".join(f"hide {text}" for text in many), 2, said)
        with self.assertRaisesRegex(raynest.UsageError, said), self.cars.edit() as edit:
            edit.hide(many)
        with self.assertRaisesRegex(raynest.UsageError, "300 texts that use .* of 32768 bytes in all"), self.cars.edit() as edit:
            edit.hide([f"car#{i}/{'body' * 30}" for i in range(300)])   # too long together
        long = "car#0/" + 40000 * "b"
        said = "^'car#0/b.* is a text of 40006 bytes, and those of one edit have at most 32768 in all"
        self.refused("cars", f"hide {long}", 2, said)
        with self.assertRaisesRegex(raynest.UsageError, said), self.cars.edit() as edit:
            edit.hide(["car#1/body", long])
        self.assertEqual(self.heights(self.cars)[700], 9)

    def test_a_file_of_a_windows_editor(self):
        self.assertEqual(self.edit("row", "\ufeffmove box#0=0,3,0\r\nmove box#1=0,4,0\r\n").returncode, 0)
        np.testing.assert_array_equal(self.heights(self.row)[:3], [3, 4, 0])

    def test_the_help_names_the_limits(self):
        said = " ".join(self.cli.run("edit", "--help").stdout.split())
        for limit in ("64 MiB", f"{_limits.edit_rows_max} changes", f"{_limits.list_items_max} different texts"):
            self.assertIn(limit, said)

    def test_an_error_names_the_change_and_leaves_the_scene(self):
        turned = "1,0,0,0,0,1,0,0,0,0,1"
        before = self.cars.info["epoch"]
        for text, code, said in (("hide car#0\n\n#\nhide van#0", 2, "^line 4 of .*changes.txt: .*van#0"),
                                 ("hide car", 2, "^line 1 of .*: .*'car'.*give the number, as 'car#0'"),
                                 ("hide van*", 2, "^line 1 of .*: no path is of the form 'van\\*'"),
                                 ("hide car#0/body/wheel", 2, "^line 1 of .*: 'car#0/body' has no 'wheel'"),
                                 ("show inst=0\nhide car#0/wheel", 2, "^line 2 of .*: 'car#0' has several 'wheel': give the number"),
                                 ("hide inst=0\nhide inst=99999", 2, "^line 2 of .*: names the outermost instance 99999"),
                                 ("hide inst=0\nhide uid=77", 2, "^line 2 of .*: names the user id 77, which no"),
                                 (f"show inst=0\nplace car#0={turned},nan", 2, "^line 2 of .*: has a matrix with a number that is not finite"),
                                 ("place car#0=" + ",".join("0" * 12), 2, "singular: a scale of 0"),
                                 (f"place car#0={turned}", 5, "^line 1 of .*: '.*' is not a 3x4 matrix row by row"),
                                 ("spin car#0=1,2,3", 5, "^line 1 of .*: 'spin car#0=1,2,3' does not begin with one of move"),
                                 ("set-mask car#0=xyz", 5, "^line 1 of .*: 'xyz' is not a mask"),
                                 ("add nobody=0,0,0", 5, "^line 1 of .*: .*nobody"),
                                 ("set-material car#0=gold", 2, "^line 1 of .*gold"),
                                 ("\n".join(f"show car#{i}" for i in range(600)) + "\nhide van#0", 2, "^line 601 of .*van#0")):
            with self.subTest(text=text[-60:]):
                self.refused("cars", text, code, said)
        done = self.cli.run("edit", "cars", "--show", "inst=0", "--hide", "inst=99999")
        self.assertEqual(done.returncode, 2)
        self.assertIn("--hide inst=99999: names the outermost instance 99999; the scene has 1300", done.stderr)
        self.assertEqual(self.cli.run("edit", "cars", "--file", self.folder / "none.txt").returncode, 5)
        self.assertEqual(self.cars.info["epoch"], before)


if __name__ == "__main__":
    main()
