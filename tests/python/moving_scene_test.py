#!/usr/bin/env python3
"""Sweeps over a scene that moves meanwhile: one request, and the scene in steps.

  moving_scene_test.py RAYNESTD RAYNEST FLATC
"""
import json
import pathlib
import subprocess
import tempfile

import numpy as np

import raynest
from animation_test import CORNERS, FACES, Gltf, travelling
from raynest import generators, points, sweeps
from with_daemon import WithDaemon, main

FIELDS = ("t", "prim", "geom", "path", "position", "normal", "hit", "origin", "velocity")
STREET = "builtin:street?cars=12&length=80&seconds=2"


def standing(*place):
    pose = np.eye(3, 4)
    pose[:, 0], pose[:, 1], pose[:, 2] = (1, 0, 0), (0, 0, -1), (0, 1, 0)    # z of the sensor is the scene's y
    pose[:, 3] = place
    return pose


def drive(end):
    return [0.0, end], [standing(-10, 2, 0), standing(10, 2, 0)]


class MovingScene(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        cls.street = cls.client.load(STREET, name="moving-street", replace=True)

    def parts_of(self, scene, made, steps, scans, animation=None, channels=None, columns=None, kind="closest",
                 fields=FIELDS, base=None, **job):
        """The same answer, one request per step and channel: the scene at the time of the step's middle."""
        whole = {}
        times = made.time
        for scan in range(scans):
            for step in range(steps):
                first, end = step * columns // steps, (step + 1) * columns // steps
                at = (times[scan * channels * columns + first] + times[scan * channels * columns + end - 1]) / 2
                rays = ((scan * channels + np.arange(channels))[:, None] * columns + np.arange(first, end)).ravel()
                origin = self.rays[0][rays], self.rays[1][rays]
                seen = scene.trace(*origin, fields=fields, kind=kind, time=at, **job)
                for name, column in seen.items():
                    if name not in whole:
                        whole[name] = np.empty((scans * channels * columns, *column.shape[1:]), column.dtype)
                    whole[name][rays] = column
        return whole

    def test_a_sensor_that_stands_has_one_pose(self):
        beams, pose = ([-10.0, 0, 5], (0, 360, 200)), standing(0, 2, 0)
        once, twice = ([7.0], [pose]), ([0.5, 0.75], [pose, pose])
        for given, wanted in zip(sweeps.lidar(*beams, begin=.5, end=.75, trajectory=once),
                                 sweeps.lidar(*beams, begin=.5, end=.75, trajectory=twice)):
            np.testing.assert_array_equal(given, wanted)
        motion = {"begin": .5, "end": .75, "scans": 2, "step_error": .1}
        shutter = {"size": (40, 30), "begin": .5, "end": .75, "step_error": .1}
        fields = ("t", "path", "origin", "direction", "time")
        later = [.5, 1.0], [pose, pose]
        for given, wanted in ((generators.lidar(*beams, pose=pose, **motion), generators.sweep(*beams, trajectory=later, **motion)),
                              (generators.sweep(*beams, trajectory=once, **motion), generators.sweep(*beams, trajectory=later, **motion)),
                              (generators.rolling_shutter(30.0, trajectory=once, **shutter),
                               generators.rolling_shutter(30.0, trajectory=later, **shutter))):
            self.same(self.street.trace(given, fields=fields), self.street.trace(wanted, fields=fields))
            self.assertIn("steps per", " ".join(self.client.outcome["notes"]))

    def test_answers_are_those_of_a_request_for_each_step(self):
        channels, columns, scans = 7, 90, 3
        trajectory = drive(1.0)
        made = generators.sweep(np.linspace(-20, 10, channels), (0, 360, columns), trajectory=trajectory, begin=.25,
                                end=.35, scans=scans, step_error=.05)
        still = generators.sweep(np.linspace(-20, 10, channels), (0, 360, columns), trajectory=trajectory, begin=.25,
                                 end=.35, scans=scans)
        sent = self.street.trace(still, fields=("origin", "direction"))
        self.rays = sent["origin"], sent["direction"]
        seen = self.street.trace(made, fields=FIELDS)
        note = " ".join(self.client.outcome["notes"])
        self.assertRegex(note, r"the scene moved at up to [\d.]+ per second, in \d+ steps per scan")
        steps = int(note.split(" steps")[0].split()[-1])
        self.assertGreater(steps, 4)
        self.assertLess(steps, columns)
        parts = self.parts_of(self.street, made, steps, scans, channels=channels, columns=columns)
        for name in FIELDS:
            np.testing.assert_array_equal(seen[name], parts[name], name)
        standing_still = self.street.trace(still, fields=FIELDS)
        self.assertFalse(np.array_equal(seen["t"], standing_still["t"]))

        with self.subTest("a part"):
            for first, count in ((0, 1), (37, 95), (85, 400), (630, 630), (700, 1), (1200, 690), (1889, 1)):
                part = self.street.trace(made.part(first, count), fields=FIELDS)
                for name in FIELDS:
                    np.testing.assert_array_equal(part[name], seen[name][first:first + count], name)
        with self.subTest("all hits"):
            for kind in ("multi", "all"):
                all_of = self.street.trace(made, kind=kind, fields=("t", "path", "position"))
                counts = np.diff(all_of["ray_splits"])
                self.assertEqual(len(counts), made.count)
                hit = counts > 0
                np.testing.assert_array_equal(hit, seen["hit"])
                np.testing.assert_array_equal(all_of["t"][all_of["ray_splits"][:-1][hit]], seen["t"][hit])
        with self.subTest("reducer"):
            table = self.street.trace(made, reduce="visible_pixels")
            paths, pixels = np.unique(seen["path"][seen["hit"]], return_counts=True)
            np.testing.assert_array_equal(table["path"], paths)
            np.testing.assert_array_equal(table["pixels"], pixels)
        with self.subTest("hidden"):
            hidden = self.street.trace(made, hide=["house-*", "car-1*"], fields=FIELDS)
            parts = self.parts_of(self.street, made, steps, scans, channels=channels, columns=columns, hide=["house-*", "car-1*"])
            for name in FIELDS:
                np.testing.assert_array_equal(hidden[name], parts[name], name)
            self.assertFalse(np.array_equal(hidden["t"], seen["t"]))

    def test_it_converges_to_the_hit_of_a_box_that_moves(self):
        gltf = Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES), translation=[5, -.4, 0])
        gltf.animate("Drive", (box, "translation", [0, 1], [[5, -.4, 0], [15, -.4, 0]], "LINEAR"))
        scene = self.client.load(str(gltf.write(pathlib.Path(self.folder.name) / "box.glb")), name="box", replace=True)
        columns = 400
        ahead = np.zeros(columns)    # each column looks ahead, along x, where the face moves from 4.5 at 10 per second
        for error in (1.0, .1, .01, 1e-3):
            made = generators.sweep([0.0], ahead, trajectory=([0.0], [standing(0, 0, 0)] ), begin=0, end=0,
                                    step_error=error)
            self.assertTrue(scene.trace(made, fields=("hit",))["hit"].all())
            made = generators.sweep([0.0], ahead, trajectory=([0.0, 1.0], [standing(0, 0, 0)] * 2), begin=.2, end=.7,
                                    step_error=error)
            off = np.abs(scene.trace(made, fields=("t",))["t"] - (4.5 + 10 * made.time)).max()
            self.assertLess(off, error + 1e-5)
            if error > .01:
                self.assertGreater(off, error / 4)
        # Steps are those that sweeps.steps() tells.
        scene.trace(generators.sweep([0.0], ahead, trajectory=([0.0, 1.0], [standing(0, 0, 0)] * 2), begin=.2, end=.7,
                                     step_error=.1))
        self.assertIn(f"in {sweeps.steps(10, .5, .1)} steps per scan", " ".join(self.client.outcome["notes"]))
        # With `time` the scene is there at the first column.
        later = generators.sweep([0.0], ahead, trajectory=([100.0, 101.0], [standing(0, 0, 0)] * 2), begin=100.2,
                                 end=100.7, step_error=1e-3)
        off = scene.trace(later, time=.3, fields=("t",))["t"] - (4.5 + 10 * (later.time - 100.2 + .3))
        self.assertLess(np.abs(off).max(), 1e-3 + 1e-5)

    def test_a_jump_is_seen_from_its_column_on(self):
        gltf = Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES), translation=[5, -.4, 0])
        gltf.animate("Jump", (box, "translation", [0, .3, .3037, .7, .8, 1], [[5, -.4, 0], [9, -.4, 0], [7, -.4, 0], [7, -.4, 0], [5, -.4, 0], [5, -.4, 0]], "STEP"))
        scene = self.client.load(str(gltf.write(pathlib.Path(self.folder.name) / "jump.glb")), name="jump", replace=True)

        def face(times):
            return np.select([times < np.float32(.3), times < np.float32(.3037), times < np.float32(.8)], [4.5, 8.5, 6.5], 4.5)

        known, poses = [0.0, 1.0], [standing(0, 0, 0)] * 2
        for columns, scans in ((1000, 1), (7, 100), (250, 4)):
            made = generators.sweep([0.0, .01], np.zeros(columns), trajectory=(known, poses), begin=0, end=1 / scans * .99, scans=scans, step_error=1.0)
            seen = scene.trace(made, fields=("t",))["t"]
            np.testing.assert_allclose(seen, face(made.time), atol=1e-4, err_msg=f"{scans} scans of {columns} columns")
        self.assertIn("where parts of it jump, 3 times", " ".join(self.client.outcome["notes"]))
        # A part has the jumps of its own scans.
        for scan, jumps in enumerate(("", "jump, 2 times", "", "jump, 1 time")):
            scene.trace(made.part(500 * scan, 500), fields=("t",))
            said, = [note for note in self.client.outcome["notes"] if note.startswith("the scene moved")]
            self.assertEqual(said.endswith(jumps) if jumps else "jump" not in said, True, said)
        shot = generators.rolling_shutter(5000.0, size=(2, 60), begin=0, end=.99, step_error=1.0, trajectory=(
            known, [[[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0]]] * 2))
        np.testing.assert_allclose(scene.trace(shot, fields=("t",))["t"], face(shot.time), atol=1e-3)

    def test_the_error_holds_for_splines_turns_within_turns_and_bent_meshes(self):
        """Corners of what moves against float64; the speed between the keys is higher than on the way from key to key."""
        def scene(name, gltf):
            return self.client.load(str(gltf.write(pathlib.Path(self.folder.name) / f"{name}.glb")), name=name, replace=True)
        columns, error = 4000, .02
        spline = np.array([[0, 0, 0], [0, -.4, 0], [40, 0, 0], [40, 0, 0], [10, -.4, 0], [0, 0, 0]])
        ease = spline * [[0], [1], [0], [0], [1], [0]]
        u = np.arange(columns) / columns
        for name, keys, way in (("steep", spline, 10 * u**2 * (3 - 2 * u) + 40 * (u**3 - 2 * u**2 + u + u**3 - u**2)),
                                ("ease", ease, 10 * u**2 * (3 - 2 * u))):
            gltf = Gltf()
            box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES))
            gltf.animate("Go", (box, "translation", [0, 1], keys, "CUBICSPLINE"))
            made = generators.sweep([0.0], np.zeros(columns), trajectory=([0.0, 1.0], [standing(-50, 0, 0)] * 2), end=1, step_error=error)
            seen = scene(name, gltf).trace(made, fields=("t",))["t"]
            off = np.abs(seen - (49.5 + way))
            self.assertLess(off.max(), error + 2e-5, name)
            self.assertGreater(off.max(), error / 2, name)
        for name, exact, make in (("arms", self.fastest_arm(), self.arms), ("bent", 20, self.bent), ("wide", 1000, self.wide)):
            answer = scene(name, make())
            made = generators.sweep([0.0], (0, 360, columns), trajectory=([0.0, 1.0], [standing(0, 9, 0)] * 2), end=.99, step_error=error)
            answer.trace(made, fields=("t",))
            speed = float(" ".join(self.client.outcome["notes"]).split("at up to ")[1].split()[0])
            self.assertGreaterEqual(speed, .999 * exact, name)
            self.assertLess(speed, 1.9 * exact, name)  # boxes around what turns have corners farther out

    def arms(self):
        """Six arms of length 1, each of which turns by 170 degrees about the end of the one before."""
        gltf = Gltf()
        inner = gltf.node(root=False, name="box", mesh=gltf.mesh(CORNERS * .02, FACES))
        joints = []
        for i in range(6):
            inner = gltf.node(root=i == 5, name=f"arm{i}", children=[inner], translation=[1, 0, 0])
            joints.append(inner)
        half = np.radians(170) / 2
        gltf.animate("Curl", *((each, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sin(half), np.cos(half)]], "LINEAR") for each in joints))
        return gltf

    @staticmethod
    def fastest_arm():
        time = np.linspace(0, 1, 20_001)
        end = np.zeros(len(time), complex)
        for _ in range(6):
            end = 1 + np.exp(1j * np.radians(170) * time) * end
        return np.abs(np.diff(end)).max() / (time[1] - time[0])

    def wide(self):
        """A mesh whose targets move at 10 per second, on a node that stands still and makes it 100 times as large."""
        gltf = Gltf()
        mesh = gltf.mesh(CORNERS, FACES)
        gltf.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": gltf.accessor(np.tile([10.0, 0, 0], (8, 1)), "VEC3")}]
        node = gltf.node(name="box", mesh=mesh, scale=[100, 100, 100])
        gltf.animate("Go", (node, "weights", [0, 1], [0, 1], "LINEAR"))
        return gltf

    def bent(self):
        """A node at 10 per second with a mesh whose targets move at 10 per second the same way."""
        gltf = Gltf()
        mesh = gltf.mesh(CORNERS, FACES)
        gltf.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": gltf.accessor(np.tile([10.0, 0, 0], (8, 1)), "VEC3")}]
        node = gltf.node(name="box", mesh=mesh)
        gltf.animate("Go", (node, "translation", [0, 1], [[0, 0, 0], [10, 0, 0]], "LINEAR"), (node, "weights", [0, 1], [0, 1], "LINEAR"))
        return gltf

    def test_the_advice_at_the_limit_of_steps_helps(self):
        scene = self.client.load(str(travelling().write(pathlib.Path(self.folder.name) / "arm.glb")), name="arm", replace=True)
        make = lambda error: generators.sweep([0.0], (0, 360, 1000), trajectory=([0.0, 9.0], [standing(0, 5, 0)] * 2), end=.02,
                                              scans=100, step_error=error)
        with self.assertRaisesRegex(raynest.Error, "accept") as caught:
            scene.trace(make(1e-9))
        advice = float(str(caught.exception).split("accept ")[1].split()[0])
        self.assertEqual(len(scene.trace(make(advice), fields=("hit",))["hit"]), 100_000)

    def test_what_cannot_be_is_told(self):
        scene = self.client.load(str(travelling().write(pathlib.Path(self.folder.name) / "arm.glb")), name="arm",
                                 replace=True)
        def made(step_error=.01, begin=0.0, end=1.0, scans=1, columns=1000):
            return generators.sweep([0.0], (0, 360, columns), trajectory=([0.0, 1000.0], [standing(0, 5, 0)] * 2), begin=begin,
                                    end=end, scans=scans, step_error=step_error)
        for generator, job, text in (
                (made(begin=1.5, end=2.5), {}, "the animation runs from 0 to 2 s"),
                (made(), {"time": 1.5}, "the animation runs from 0 to 2 s"),
                (made(), {"animation": "Fly"}, "no animation 'Fly'"),
                (made(), {"worker": "cuda"}, "is traced by worker cpu"),
                (made(1e-9, 0, .002, 100, 1000), {}, "sweep_steps_max = 65536; accept")):
            with self.assertRaisesRegex(raynest.Error, text):
                scene.trace(generator, **job)
        self.assertEqual(len(scene.trace(made(end=.5), animation="Rest")["t"]), 1000)
        for wrong in (0, -1, np.nan, np.inf):
            with self.assertRaises(raynest.UsageError):
                made(wrong)
        # Keys are counted before anything is made of them; less time has fewer.
        gltf = Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(CORNERS, FACES))
        keys = np.linspace(0, 10, 140_000)
        gltf.animate("Shake", (box, "translation", keys, np.stack([np.sin(keys), 0 * keys, 0 * keys], 1), "LINEAR"))
        shaken = self.client.load(str(gltf.write(pathlib.Path(self.folder.name) / "shaken.glb")), name="shaken", replace=True)
        with self.assertRaisesRegex(raynest.Error, "has more than 65536 keys; ask for less of that time at once"):
            shaken.trace(made(end=9.9))
        self.assertEqual(len(shaken.trace(made(end=.5))["t"]), 1000)
        # A scene without an animation stands still.
        seen, still = (self.woods.trace(generators.sweep([-5.0, 0.0], (0, 360, 300), trajectory=([0.0], [standing(0, 6, 0)]),
                                                         begin=0, end=0, step_error=error), fields=FIELDS)
                       for error in (.1, None))
        for name in FIELDS:
            np.testing.assert_array_equal(seen[name], still[name], name)

    def test_deadlines_and_clients_that_leave_end_it(self):
        made = generators.sweep(np.linspace(-20, 10, 64), (0, 360, 1800), trajectory=drive(2.0), begin=0, end=.1, scans=19,
                                step_error=1e-3)
        with self.assertRaises(raynest.DeadlineError):
            self.street.trace(made, deadline=.3, fields=("t",))
        for _ in self.street.stream(made, fields=("t",)):
            break                                                             # cancels the rest
        self.assertEqual(len(self.woods.trace([[0, 9, 0, 0, -1, 0]])["t"]), 1)

    def test_on_the_command_line(self):
        times, poses = drive(1.0)
        file = pathlib.Path(self.folder.name) / "drive.npy"
        np.save(file, np.column_stack([times, np.reshape(poses, (2, 12))]))
        out = pathlib.Path(self.folder.name) / "out.npz"
        run = subprocess.run([self.raynest, "--server", self.daemon.uri, "query", "moving-street", "--generate", "sweep", f"trajectory={file}",
                              "elevations=-20:10:7", "azimuths=0:360:90", "begin=0.25", "end=0.35", "--step-error", "0.05",
                              "--fields", "t,hit", "-o", str(out)], capture_output=True, text=True, check=False)
        self.assertEqual(run.returncode, 0, run.stderr)
        self.assertIn("steps per scan", run.stderr)
        seen = self.street.trace(generators.sweep(np.linspace(-20, 10, 7), (0, 360, 90), trajectory=(times, poses), begin=.25,
                                                  end=.35, step_error=.05), fields=("t", "hit"))
        np.testing.assert_array_equal(np.load(out)["t"], seen["t"])

    def test_ring_and_time_on_the_command_line(self):
        folder = pathlib.Path(self.folder.name)
        times, poses = drive(1.0)
        np.save(folder / "drive.npy", np.column_stack([times, np.reshape(poses, (2, 12))]))
        made = generators.sweep(np.linspace(-20, 10, 7), (0, 360, 90), trajectory=(times, poses), begin=.25, end=.35, scans=3)
        seen = self.street.trace(made, fields=("t", "position", "hit", "ring", "time"))

        def query(*more, generate=("sweep", f"trajectory={folder / 'drive.npy'}", "begin=0.25", "end=0.35", "scans=3"),
                  code=0):
            run = subprocess.run([self.raynest, "--server", self.daemon.uri, *more[:1], "query", "moving-street", "--generate",
                                  *generate, "elevations=-20:10:7", "azimuths=0:360:90", *more[1:]],
                                 capture_output=True, text=True, check=False)
            self.assertEqual(run.returncode, code, run.stderr)
            return run.stdout if code == 0 else run.stderr

        query("--quiet", "--fields", "t,ring,time", "-o", str(folder / "rows.npz"))
        rows = np.load(folder / "rows.npz")
        self.assertEqual(set(rows), {"t", "ring", "time"})
        for name in rows:
            self.assertEqual(rows[name].dtype, seen[name].dtype)
            np.testing.assert_array_equal(rows[name], seen[name], name)
        lines = [json.loads(line) for line in query("--json", "--fields", "t,ring,time").splitlines()]
        np.testing.assert_array_equal([line["ring"] for line in lines], seen["ring"])
        np.testing.assert_array_equal([line["time"] for line in lines], seen["time"])
        for ending in ("ply", "pcd", "las"):
            query("--quiet", "--fields", "position,ring,time", "-o", str(folder / f"cli.{ending}"))
            points.save(folder / f"python.{ending}", seen["position"], where=seen["hit"], ring=seen["ring"], time=seen["time"])
            self.assertEqual((folder / f"cli.{ending}").read_bytes(), (folder / f"python.{ending}").read_bytes(), ending)
        # The same in parts, and with several hits of a ray.
        for part in (1, 2, 3):
            query("--quiet", "--fields", "t,ring,time", "--part", f"{part}/3", "-o", str(folder / f"part{part}.npz"))
        np.testing.assert_array_equal(np.concatenate([np.load(folder / f"part{part}.npz")["time"] for part in (1, 2, 3)]),
                                      seen["time"])
        query("--quiet", "--kind", "multi", "--fields", "t,ring", "-o", str(folder / "multi.npz"))
        np.testing.assert_array_equal(np.load(folder / "multi.npz")["ring"], seen["ring"])
        query("--quiet", "--fields", "ring", "-o", str(folder / "lidar.npz"), generate=("lidar",))
        np.testing.assert_array_equal(np.load(folder / "lidar.npz")["ring"], np.repeat(np.arange(7), 90))
        self.assertIn("the column time is of --generate sweep and rolling_shutter", query("--quiet", "--fields", "time", generate=("lidar",), code=2))
        self.assertIn("is made when the answer is fetched", query("--quiet", "--fields", "t,ring", "--detach", code=2))


if __name__ == "__main__":
    main()
