#!/usr/bin/env python3
"""A camera in motion that reads its picture row by row.

  rolling_shutter_test.py RAYNESTD RAYNEST FLATC
"""
import pathlib
import sys
from unittest import mock

import numpy as np

import raynest
from raynest import _shutter, generators
from with_daemon import WithDaemon, main

FIELDS = ("t", "prim", "geom", "path", "position", "normal", "hit", "origin", "direction")
STREET = "builtin:street?cars=12&length=80&seconds=2"
WIDTH, HEIGHT = 45, 28
LENS = {"fx": 30.0, "fy": 31.0, "cx": 21.5, "cy": 12.0, "size": (WIDTH, HEIGHT)}


def looking(place, turn):
    """A camera above the street that looks along it, turned by so many radians about the vertical."""
    pose = np.eye(3, 4)
    pose[:, 0], pose[:, 2] = (np.sin(turn), 0, np.cos(turn)), (-np.cos(turn), 0, np.sin(turn))
    pose[:, 1], pose[:, 3] = (0, 1, 0), place
    return pose


def drive():
    return [0.0, 1.0, 2.0], [looking((-30, 3, 0), 0), looking((-20, 3, 1), .3), looking((-10, 4, 0), .2)]


class RollingShutter(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.street = cls.client.load(STREET, name="street", replace=True)

    def same(self, seen, wanted, fields=FIELDS):
        for name in fields:
            np.testing.assert_array_equal(seen[name], wanted[name], name)

    def shot(self, **more):
        return generators.rolling_shutter(**{**LENS, "trajectory": drive(), "begin": .25, "end": 1.25, **more})

    def test_one_that_stands_still_is_a_pinhole(self):
        pose = looking((-30, 3, 0), .1)
        still = generators.rolling_shutter(**LENS, trajectory=([0.0, 1.0], [pose, pose]), tmin=.5, tmax=60)
        self.same(self.street.trace(still, fields=FIELDS),
                  self.street.trace(generators.pinhole(**LENS, pose=pose, tmin=.5, tmax=60), fields=FIELDS))

    def test_each_row_is_that_of_a_camera_at_its_time(self):
        made = self.shot()
        seen = self.street.trace(made, fields=FIELDS)
        times, (first, second, third) = .25 + np.arange(HEIGHT) / HEIGHT, drive()[1]
        np.testing.assert_array_equal(made.time, np.repeat(times, WIDTH))
        for row, time in enumerate(times):
            share, before, after = (time, first, second) if time < 1 else (time - 1, second, third)
            turn = .3 * time if time < 1 else .3 - .1 * (time - 1)
            camera = generators.pinhole(**LENS, pose=looking((1 - share) * before[:, 3] + share * after[:, 3], turn))
            wanted = self.street.trace(camera.part(row * WIDTH, WIDTH), fields=("origin", "direction"))
            for name in ("origin", "direction"):
                np.testing.assert_allclose(seen[name][row * WIDTH:(row + 1) * WIDTH], wanted[name], atol=2e-6, err_msg=name)
        # Where the camera is at a row's time is what tells: the last rows are seen from metres ahead.
        self.assertGreater(np.abs(seen["origin"][-1] - seen["origin"][0]).max(), 5)
        for start, count in ((0, 1), (40, 700), (WIDTH * HEIGHT - 1, 1)):
            self.same({name: column[start:start + count] for name, column in seen.items()},
                      self.street.trace(made.part(start, count), fields=FIELDS))
        with_time = self.street.trace(made.part(40, 700), fields=("t", "time"))
        np.testing.assert_array_equal(with_time["time"], made.time[40:740])

    def close(self, picture, wanted):
        """float32 powers of two libraries may differ by a bit."""
        self.assertEqual((picture.shape, picture.dtype), (wanted.shape, np.uint8))
        off = np.abs(picture.astype(int) - wanted)
        self.assertLessEqual(off.max(), 1)
        self.assertLess((off > 0).mean(), 0.01)

    def test_a_picture_of_a_camera_that_moves(self):
        eye, size = np.array((-30.0, 3, 0)), (90, 60)
        pose = looking(eye, .1)
        stands = self.street.render(look_at=(eye, eye - pose[:, 2]), size=size)
        self.assertGreater((stands[..., 3] == 255).mean(), .2)
        self.assertGreater((stands[..., 3] == 0).mean(), .05)
        for way in (([0.0, 1.0], [pose, pose]), ([0.5], [pose])):
            self.close(self.street.render(trajectory=way, begin=.5, readout=.5 * (len(way[0]) - 1), size=size), stands)
        wide = self.street.render(look_at=(eye, eye - pose[:, 2]), fov=70, size=size)
        self.close(self.street.render(trajectory=([0.0], [pose]), fov=70, size=size), wide)
        # Each row of one that moves is that row of a camera which stands there.
        times, poses = drive()
        moves = self.street.render(trajectory=drive(), begin=.25, readout=.75, size=size)
        for row in (0, 20, 59):
            share = .25 + .75 * row / 60
            there = looking((1 - share) * poses[0][:, 3] + share * poses[1][:, 3], .3 * share)
            still = self.street.render(trajectory=([0.0], [there]), size=size)
            self.close(moves[row:row + 1], still[row:row + 1])
            self.assertGreater((np.asarray(moves) != np.asarray(still)).mean(), .01)
        # The scene moves, too; all of it at a readout of nothing.
        late = self.street.render(trajectory=([0.0, 2.0], [pose, pose]), begin=1.5, step_error=1e-3, size=size)
        self.close(late, self.street.render(look_at=(eye, eye - pose[:, 2]), time=1.5, size=size))
        self.assertGreater((np.asarray(late) != np.asarray(stands)).any(axis=2).sum(), 20)
        self.assertEqual(self.street.render(trajectory=drive(), size=size, encode="png")[:4], b"\x89PNG")
        # A large one is traced in pieces, of whole rows.
        news = []
        with mock.patch.object(_shutter, "_RAYS", 7 * size[0] + 1):
            pieces = self.street.render(trajectory=drive(), begin=.25, readout=.75, size=size, progress=lambda *each: news.append(each))
        np.testing.assert_array_equal(pieces, moves)
        self.assertEqual(news, [(min(row, 60) * 90, 5400, "tracing") for row in range(7, 64, 7)])

    def test_what_has_no_normal_is_not_darkened(self):
        seen = {"ng": np.zeros((1, 3)), "direction": np.ones((1, 3)), "hit": np.ones(1, bool), "base_colour": np.full((1, 3), .5, np.float32)}
        self.assertEqual(_shutter._shade(seen).tolist(), [[188, 188, 188, 255]])

    def test_what_does_not_go_with_a_camera_that_moves(self):
        for more, said in (({"integrator": "path"}, "leave integrator out"), ({"fov": 180}, "fov"),
                           ({"camera": 0, "spp": 4}, "leave camera and spp out"), ({"readout": -1}, "readout"),
                           ({"readout": 9}, "lasts from 0.0 to 8.98"), ({"encode": "exr"}, "'raw' or 'png'"),
                           ({"trajectory": None, "readout": .1}, "pass a trajectory"),
                           ({"tile": (0, 0, 1, 1)}, "leave tile out"), ({"detach": True}, "leave detach out")):
            with self.subTest(more=more), self.assertRaisesRegex(raynest.UsageError, said):
                self.street.render(**{"trajectory": drive(), **more})

    def test_the_scene_moves_meanwhile_in_steps_of_rows(self):
        sent = self.street.trace(self.shot(), fields=("origin", "direction"))
        counts = []
        for error in (4.0, 1.0, .02):
            made = self.shot(step_error=error)
            seen = self.street.trace(made, fields=FIELDS)
            note = " ".join(self.client.outcome["notes"])
            self.assertRegex(note, r"the scene moved at up to [\d.]+ per second, in \d+ steps? per picture")
            steps = int(note.split(" step")[0].split()[-1])
            counts.append(steps)
            speed = float(note.split("at up to ")[1].split()[0])
            rows = -(-HEIGHT // steps)
            if rows > 1:
                self.assertLessEqual(speed * rows / HEIGHT / 2, error * 1.01)
            for first in range(0, HEIGHT, rows):
                last = min(first + rows, HEIGHT)
                rays = slice(first * WIDTH, last * WIDTH)
                at = (made.time[rays.start] + made.time[rays.stop - 1]) / 2
                self.same({name: column[rays] for name, column in seen.items()},
                          self.street.trace(sent["origin"][rays], sent["direction"][rays], fields=FIELDS, time=at))
            for start, count in ((0, 1), (100, 333), (WIDTH * HEIGHT - 1, 1)):
                self.same({name: column[start:start + count] for name, column in seen.items()},
                          self.street.trace(made.part(start, count), fields=FIELDS))
        self.assertLess(counts[0], counts[1])
        self.assertEqual(counts[2], HEIGHT)
        self.assertFalse(np.array_equal(seen["t"], self.street.trace(self.shot(), fields=("t",))["t"]))

    def test_on_the_command_line(self):
        made = self.shot(step_error=1.0)
        fields = ("t", "path", "position")
        seen = self.street.trace(made, fields=fields)
        times, poses = drive()
        np.save(self.out / "drive.npy", np.column_stack([times, np.reshape(poses, (-1, 12))]))
        words = ("query", "street", "--generate", "rolling_shutter", f"trajectory={self.out / 'drive.npy'}",
                 f"size={WIDTH}x{HEIGHT}", "fx=30", "fy=31", "cx=21.5", "cy=12", "begin=0.25", "end=1.25")
        more = ("--step-error", "1", "--fields", ",".join(fields) + ",time")

        def read(name, wanted):
            with np.load(self.out / name) as file:
                self.same(file, wanted, fields)
                np.testing.assert_array_equal(file["time"], made.time)
        done = self.cli.run(*words, *more, "-o", self.out / "whole.npz")
        self.assertEqual(done.returncode, 0, done.stderr)
        read("whole.npz", seen)
        for part in ("1/2", "2/2"):
            done = self.cli.run(*words, *more, "--part", part, "-o", self.out / f"{part[0]}.npz")
            self.assertEqual(done.returncode, 0, done.stderr)
        done = self.cli.run("merge", self.out / "all.npz", self.out / "1.npz", self.out / "2.npz")
        self.assertEqual(done.returncode, 0, done.stderr)
        read("all.npz", seen)
        for wrong, said in ((("--fields", "ring"), "the column ring is of --generate lidar and sweep"),
                            (("--generate", "rolling_shutter", "fx=1"), "needs trajectory=FILE.npy")):
            done = self.cli.run(*(words if "--generate" not in wrong else words[:2]), *wrong, "-o", self.out / "no.npz")
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn(said, done.stderr)

    def test_the_command_line_makes_the_picture_that_python_makes(self):
        self.cli.environment.update(PYTHONPATH=str(pathlib.Path(raynest.__file__).parents[1]), RAYNEST_PYTHON=sys.executable)
        times, poses = drive()
        np.save(self.out / "drive.npy", np.column_stack([times, np.reshape(poses, (-1, 12))]))
        words = ("render", "street", "--trajectory", self.out / "drive.npy", "--size", f"{WIDTH}x{HEIGHT}", "--fov", 50)
        moving = ("--begin", 0.25, "--readout", 1, "--step-error", 1)
        wanted = self.street.render(trajectory=drive(), begin=.25, readout=1, step_error=1, fov=50, size=(WIDTH, HEIGHT))
        told = self.cli.json(*words, *moving, "-o", self.out / "shot.npy")
        np.testing.assert_array_equal(np.load(self.out / "shot.npy"), wanted)
        self.assertEqual((told["width"], told["height"], told["rays"], told["scene"]), (WIDTH, HEIGHT, WIDTH * HEIGHT, "street"))
        done = self.cli.run(*words, *moving, "--intersector", "opaque", "-o", self.out / "shot.png")
        self.assertRegex(done.stdout, rf"shot.png: {WIDTH}x{HEIGHT}, 1,260 rays, opaque, street epoch 1\n")
        self.assertEqual((self.out / "shot.png").read_bytes(),
                         self.street.render(trajectory=drive(), begin=.25, readout=1, step_error=1, fov=50, size=(WIDTH, HEIGHT),
                                            intersector="opaque", encode="png"))
        still = self.cli.run(*words, "-o", self.out / "still.npy")
        self.assertEqual(still.returncode, 0, still.stderr)
        self.assertFalse(np.array_equal(np.load(self.out / "still.npy"), wanted))
        for code, said, more in ((2, "-o FILE.png or FILE.npy", ("-o", self.out / "no.exr")), (2, "-o FILE.png", ("-o", "-")),
                                 (2, "--spp", ("--spp", 4, "-o", self.out / "no.png")), (2, "--camera", ("--camera", 0, "-o", self.out / "no.png")),
                                 (2, "--readout", ("--readout", -1, "-o", self.out / "no.png")),
                                 (2, "the trajectory from 0.0 to 2.0", ("--readout", 9, "-o", self.out / "no.png"))):
            self.cli.fails(code, said, *words, *more)
        self.cli.fails(2, "--trajectory", "render", "street", "--readout", 1, "-o", self.out / "no.png")
        self.cli.fails(5, "absent.npy", "render", "street", "--trajectory", self.out / "absent.npy", "-o", self.out / "no.png")
        self.assertFalse(list(self.out.glob("no.*")))

    def test_what_is_wrong_gets_a_line(self):
        for wrong, said in (({"fx": 0.0}, "needs fx and fy above 0"), ({"step_error": 1e-9}, None),
                            ({"end": .2}, "end after it begins"), ({"end": 9.0}, "the trajectory from 0.0 to 2.0"),
                            ({"step_error": -1.0}, "must be finite and above 0"), ({"size": (3, )}, "must be")):
            with self.subTest(**wrong):
                if said is None:
                    # At most a step for each row.
                    self.street.trace(self.shot(**wrong), fields=("t",))
                    self.assertIn(f"in {HEIGHT} steps", " ".join(self.client.outcome["notes"]))
                    continue
                with self.assertRaisesRegex((raynest.Error, raynest.UsageError), said):
                    self.street.trace(self.shot(**wrong))
        for settings, said in (({"poses": "0"}, "needs poses above 0"), ({"scans": "2"}, "scans"), ({"camera": "driver"}, "camera"),
                               ({"poses": "2"}, "longer than its announced")):
            with self.subTest(**settings), self.assertRaisesRegex(raynest.Error, said):
                made = self.shot()
                made._settings.update(settings)
                self.street.trace(made)
        self.assertTrue(self.street.trace([[0, 9, 0, 0, -1, 0]], fields=("hit",))["hit"].all())


if __name__ == "__main__":
    main()
