#!/usr/bin/env python3
"""Runs all that users of the Python client are shown: the examples, and the code of its README.

  examples_test.py RAYNESTD RAYNEST FLATC
"""
import datetime
import os
import pathlib
import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np

import raynest
from daemon import Daemon, DaemonTest, PATIENCE, closed_port
from with_daemon import main

CLIENT = pathlib.Path(__file__).resolve().parents[2] / "client" / "python"
sys.path.insert(0, str(CLIENT / "examples"))
import sun_hours
import visibility

SECONDS_MAX = 4 * PATIENCE  # for a whole program
FOREST = "builtin:forest?trees=20"


def points_of(path):
    """The dots of a path of distortion.py: metres ahead of the sensor and to its right."""
    return 0.02 * np.cumsum([[int(number) for number in step] for step in
                             re.findall(r"m(-?\d+) (-?\d+)h0", path.get("d"))], axis=0)


class Examples(DaemonTest):
    def run_python(self, *words, daemon=None):
        environment = dict(os.environ, RAYNEST_SERVER=(daemon or self.daemon).uri)
        return subprocess.run([sys.executable, *map(str, words)], cwd=self.out, env=environment,
                              stdin=subprocess.DEVNULL, capture_output=True, text=True,
                              timeout=SECONDS_MAX, check=False)

    def example(self, name, *words, code=0):
        done = self.run_python(CLIENT / "examples" / name, *words)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertEqual(done.stderr.count("\n"), int(code != 0), done.stderr)
        print(done.stdout or done.stderr, end="", file=sys.stderr)
        return done.stdout or done.stderr

    def test_lidar_makes_a_point_cloud(self):
        said = self.example("lidar.py", FOREST, "-o", "a.ply")
        header, body = (self.out / "a.ply").read_bytes().split(b"end_header\n", 1)
        count = int(re.search(rb"element vertex (\d+)", header)[1])
        self.assertIn(f"{count:,} points", said)
        self.assertGreater(count, 50000)
        self.assertEqual(re.findall(rb"property (\w+ \w+)", header),
                         [b"double x", b"double y", b"double z", b"float cosine", b"uint instance",
                          b"ushort channel"])
        self.example("lidar.py", FOREST, "-o", "a.npy")
        points = np.load(self.out / "a.npy")
        self.assertEqual(points.tobytes(), body)
        # The lowest channel looks down 25 degrees from 1.8 m: the ground is near there.
        low = points[points["channel"] == 0]
        self.assertTrue((np.hypot(low["x"], low["z"]) < 6).all())
        self.assertTrue(((points["cosine"] >= 0) & (points["cosine"] <= 1.0001)).all())
        self.assertEqual(set(points["channel"]), set(range(64)))

    def test_a_flight_has_several_returns_of_a_pulse(self):
        said = self.example("canopy.py", FOREST, "--lines", 20, "--pulses", 200, "--returns", 3, "-o", "a.las")
        pulses = [int(count.replace(",", "")) for count in said.rpartition("returns: ")[2].split(", ")]
        self.assertEqual((len(pulses), sum(pulses)), (4, 20 * 200))
        self.assertTrue(all(count > 0 for count in pulses[1:]), said)
        of_return = np.frombuffer((self.out / "a.las").read_bytes()[111:131], "<u4")
        self.assertEqual(of_return.tolist(), [sum(pulses[1:]), sum(pulses[2:]), pulses[3], 0, 0])

    def test_a_part_moves_from_sweep_to_sweep(self):
        said = self.example("moving.py", FOREST, "--part", "birch-*", "--by", "0,2,0", "--frames", 3,
                            "--channels", 8, "--azimuths", 400, "-o", "moving.npz")
        self.assertRegex(said, r"frame 2: epoch \d+, [1-9]\d* instances moved")
        frames = np.load(self.out / "moving.npz")
        self.assertEqual(len(frames), 3)
        heights = [frames[name][:, 1].max() for name in sorted(frames)]
        self.assertGreater(heights[2], heights[0] + 1)  # it rises
        self.example("moving.py", FOREST, "--part", "no-such", "--frames", 1, code=2)

    def test_a_lidar_drives_with_the_traffic(self):
        said = self.example("street.py", "--cars", 8, "--rate", 20, "--seconds", 1, "--channels", 8,
                            "--azimuths", 360, "--speed", 40, "-o", "street.npz")
        self.assertRegex(said, r"epoch \d+, 40 instances moved")  # 8 cars and their wheels
        self.assertIn("20 sweeps of 2,880 rays in 1 step:", said)
        clouds = np.load(self.out / "street.npz")
        self.assertEqual(len(clouds), 20)
        centres = [np.median(clouds[name][:, 0]) for name in sorted(clouds)]
        self.assertLess(centres[-1], centres[0] - 15)  # the first car drives towards -X, and the sensor with it
        said = self.example("street.py", "--cars", 8, "--seconds", 1, "--channels", 8, "--azimuths", 360,
                            "--step-error", 0.2, "-o", "street.ply")
        self.assertIn("in 4 steps:", said)  # 13 m/s in a tenth of a second
        header = (self.out / "street.ply").read_bytes().split(b"end_header\n", 1)[0].decode()
        self.assertEqual(re.findall(r"property \w+ (\w+)", header),
                         ["x", "y", "z", "ring", "time", "distance", "instance"])
        # It does not see the car that it stands on.
        near = np.linalg.norm(clouds["sweep_00000"] - (-50, 1.9, -1.5 * 3.25), axis=1)
        self.assertGreater(near.min(), 1.5)

    def test_a_picture_shows_what_motion_does_to_a_sweep(self):
        said = self.example("distortion.py", "--channels", 16, "--azimuths", 720, "-o", "a.svg")
        self.assertEqual(len(re.findall(r": [\d,]+ points", said)), 2)
        still, moving = ElementTree.parse(self.out / "a.svg").getroot().findall("./{*}g/{*}svg")
        # Points on cars are the last dots, a path for each shade of time. Those of the car ahead, which is seen when
        # the turn begins and when it ends, are torn apart: it drove on by about a metre.
        gaps = []
        for panel in (still, moving):
            ahead = [points_of(path) for path in (panel.findall(".//{*}path")[2], panel.findall(".//{*}path")[11])]
            nearest = [points[(abs(points[:, 1]) < 1) & (points[:, 0] > 5)][:, 0].min() for points in ahead]
            gaps.append(nearest[1] - nearest[0])
        self.assertLess(abs(gaps[0]), 0.1)
        self.assertTrue(0.8 < gaps[1] < 1.5, gaps)
        self.assertEqual(len(moving.findall(".//{*}rect[@stroke-dasharray]")), len(still.findall(".//{*}rect")))

    def test_a_lidar_elsewhere_sees_no_further_than_its_range(self):
        self.example("lidar.py", FOREST, "-o", "b.npy", "--at", 5, 30, -5, "--range", 40,
                     "--channels", 8, "--azimuths", 90, "--elevations", -90, -10)
        points = np.load(self.out / "b.npy")
        away = np.stack([points["x"] - 5, points["y"] - 30, points["z"] + 5], -1)
        distance = np.linalg.norm(away, axis=1)
        self.assertTrue((distance <= 40.001).all())
        self.assertGreater(distance.max(), 30)

    def test_a_lidar_far_from_zero_keeps_its_digits(self):
        far = np.array([5e5, 0, 4.5e6])
        with raynest.connect(self.daemon.uri) as client:
            client.mesh(far + [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
                        [[0, 2, 1], [0, 3, 2]], "field", origin=far)
            self.example("lidar.py", "field", "-o", "far.npy", "--at", *(far + [0.3, 1, 0.2]),
                         "--channels", 2, "--elevations", -90, -89, "--azimuths", 4)
        points = np.load(self.out / "far.npy")
        np.testing.assert_allclose(points["x"], far[0] + 0.3, rtol=0, atol=0.02)
        np.testing.assert_allclose(points["z"], far[2] + 0.2, rtol=0, atol=0.02)

    def test_eyes_stand_on_the_ground(self):
        with raynest.connect(self.daemon.uri) as client:
            field = client.mesh([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9], [0, 5, 0]],
                                [[0, 2, 1], [0, 3, 2], [4, 4, 4]], "flat", keep=True)
            eyes = visibility.scatter(field, 50, 1.7, 1)
        np.testing.assert_allclose(eyes[:, 1], 1.7, atol=1e-5)

    def test_up_may_be_z(self):
        """A scene whose up is z gives what its turned twin gives whose up is y."""
        day, place = datetime.date(2026, 6, 21), (52.5, 13.4)
        times = sun_hours.day_times(day, 30, place)
        corners = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0],
                            [2, 1, 0], [2, -1, 0], [2, -1, 40], [2, 1, 40]], float)
        faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
        points = np.array([[1, 0, 0], [4, 0, 0], [30, 0, 0]], float)
        turned = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # (x, y, z) -> (x, z, -y)
        with raynest.connect(self.daemon.uri) as client:
            tower = client.mesh(corners, faces, "tower z", keep=True)
            twin = client.mesh(corners @ turned.T, faces, "tower y", keep=True)
            hours = sun_hours.sun_hours(tower, points, [[0, 0, 1]] * 3, times, place, up="z")
            np.testing.assert_array_equal(hours, sun_hours.sun_hours(
                twin, points @ turned.T, [[0, 1, 0]] * 3, times, place))
            self.assertGreater(hours.min(), 1)
            ground, normals = sun_hours.ground(tower, 5, up="z")
            np.testing.assert_allclose(normals, [[0, 0, 1]] * len(ground), atol=1e-6)
            eyes = visibility.scatter(tower, 50, 1.7, 1, up="z")
            np.testing.assert_allclose(eyes[:, 2], 1.7, atol=1e-5)
        self.assertIn("from 0.00, 0.00, 1.80", self.example("lidar.py", "tower z", "--up", "z", "-o", "z.npy"))
        self.example("lidar.py", "tower y", "-o", "y.npy")
        found = {up: np.sort(np.round(np.load(self.out / f"{up}.npy")[up], 3)) for up in "yz"}
        np.testing.assert_allclose(found["z"], found["y"], atol=2e-3)

    def test_visibility_is_who_sees_whom(self):
        said = self.example("visibility.py", FOREST, "--random", 50, "-o", "sees.npy")
        sees = np.load(self.out / "sees.npy")
        self.assertEqual((sees.shape, sees.dtype), ((50, 50), bool))
        np.testing.assert_array_equal(sees, sees.T)
        self.assertTrue(sees.diagonal().all())
        self.assertIn(f"{(sees.sum() - 50) // 2:,} of 1,225 pairs", said)
        # Two points over all trees see each other, one in the ground sees nobody.
        np.save(self.out / "points.npy", [[0, 90, 0], [5, 95, 5], [0, -50, 0]])
        self.example("visibility.py", FOREST, "--points", "points.npy", "-o", "sees.dat")
        np.testing.assert_array_equal(np.load(self.out / "sees.dat"),
                                      [[1, 1, 0], [1, 1, 0], [0, 0, 1]])

    def test_the_sun_stands_where_an_almanac_has_it(self):
        utc, berlin = datetime.timezone.utc, (52.5, 13.4)
        # Highest at midsummer's noon: 90 - 52.5 + 23.44 degrees, in the south.
        noon = sun_hours.sun_direction(datetime.datetime(2026, 6, 21, 11, 8, tzinfo=utc), berlin)
        self.assertAlmostEqual(np.degrees(np.arcsin(noon[1])), 60.94, delta=0.02)
        self.assertGreater(noon[2], 0.4)
        self.assertAlmostEqual(noon[0], 0, delta=0.005)
        # At the equinox it rises due east.
        rise = sun_hours.sun_direction(datetime.datetime(2026, 3, 20, 5, 13, tzinfo=utc), berlin)
        np.testing.assert_allclose(rise, [1, 0, 0], atol=0.02)
        self.assertLess(sun_hours.sun_direction(datetime.datetime(2026, 6, 21, 23, tzinfo=utc), berlin)[1], 0)

    def test_hours_of_sun_are_those_of_the_open_sky_less_what_a_wall_hides(self):
        day, place = datetime.date(2026, 6, 21), (0, 0)
        times = sun_hours.day_times(day, 10, place)
        with raynest.connect(self.daemon.uri) as client:
            # A wall along x = 1 that is endless for these points hides the morning: the sun is in the east.
            wall = client.mesh([[1, -1e5, -1e5], [1, 1e5, -1e5], [1, 1e5, 1e5], [1, -1e5, 1e5]],
                               [[0, 1, 2], [0, 2, 3]])
            hours = sun_hours.sun_hours(wall, [[0, 0, 0], [2, 0, 0], [0, 0, 0]],
                                        [[0, 1, 0], [0, 1, 0], [0, -1, 0]], times, place)
        np.testing.assert_allclose(hours, [6, 6, 0], atol=0.34)
        self.assertEqual(len(sun_hours.day_times(day, 720, place)), 2)
        self.example("sun_hours.py", FOREST, "--minutes", 721, code=2)
        said = self.example("sun_hours.py", FOREST, "--grid", 8, "--minutes", 60, "-o", "sun.npy")
        hours = np.load(self.out / "sun.npy")
        self.assertIn(f"{hours.min():.1f} to {hours.max():.1f} hours", said)
        self.assertTrue((hours >= 0).all() and 3 < hours.max() < 17)
        self.example("sun_hours.py", FOREST, "--place", "north", code=2)
        # South of the equator, and every other value that begins with a minus.
        self.example("sun_hours.py", FOREST, "--place", "-33.9,151.2", "--day", "2026-12-21", "--grid", 4,
                     "--minutes", 240, "-o", "south.npy")
        self.example("lidar.py", FOREST, "--at", "-1.5e1", "-2", "-.5", "--elevations", "-3e1", "-1e-1",
                     "--azimuths", 8, "--channels", 2, "-o", "minus.ply")

    def test_hours_of_sun_are_the_same_far_from_zero(self):
        """As in projected coordinates: a tower on the ground, at zero and 5,800 km away."""
        day, place = datetime.date(2026, 6, 21), (52.5, 13.4)
        times = sun_hours.day_times(day, 30, place)
        tower = np.array([[-50, 0, -50], [-50, 0, 50], [50, 0, 50], [50, 0, -50],
                          [2, 0, -1], [2, 0, 1], [2, 40, 1], [2, 40, -1]], float)
        faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
        points = np.array([[1, 0, 0], [4, 0, 0], [30, 0, 0]], float)
        found = []
        with raynest.connect(self.daemon.uri) as client:
            for place_of in ((0, 0, 0), (500000, 0, 5800000)):
                with client.mesh(tower + place_of, faces, origin=place_of) as scene:
                    found.append(sun_hours.sun_hours(scene, points + place_of, [[0, 1, 0]] * 3,
                                                     times, place))
                    nothing = sun_hours.sun_hours(scene, np.empty((0, 3)), np.empty((0, 3)), times, place)
                    self.assertEqual(nothing.shape, (0,))
        np.testing.assert_array_equal(*found)
        self.assertLess(found[0][0], found[0][2] - 1)

    def test_a_day_has_24_hours_however_often_the_sun_is_looked_at(self):
        for minutes in (7, 60, 700, 720):
            times = sun_hours.day_times(datetime.date(2026, 6, 21), minutes, (0, 0))
            self.assertAlmostEqual(len(times) * (times[1] - times[0]).total_seconds(), 86400, places=3)

    def test_the_benchmark_compares_equal_answers(self):
        said = self.example("bench.py", FOREST, "--rays", 50000, "--rounds", 1, "--raynest",
                            self.raynest)
        ratios = [float(ratio) for ratio in re.findall(r"([\d.]+) times raynest query", said)]
        self.assertEqual((len(ratios), ratios[0]), (4, 1))
        self.assertGreater(min(ratios), 0)

    def test_help_starts_with_an_example(self):
        for name in ("lidar.py", "visibility.py", "sun_hours.py", "bench.py"):
            said = self.example(name, "--help")
            self.assertTrue(said.startswith(f"usage: {name} builtin:forest "), said)

    def test_errors_are_one_line_and_an_exit_code(self):
        with closed_port() as nobody:
            for code, words in ((5, ["missing.glb"]), (3, ["--server", nobody]),
                                (2, ["--server", "nowhere"]),
                                (2, [FOREST, "-o", "sweep.xyz"]),
                                (1, [FOREST, "-o", "/nonexistent/a.npy"])):
                said = self.example("lidar.py", *words, code=code)
                self.assertTrue(said.startswith("lidar.py: "), said)

    def test_commands_of_the_readme_run_as_printed(self):
        text = (CLIENT / "README.md").read_text(encoding="utf-8").split("## Examples\n")[1]
        commands = re.findall(r"^\$ (.*)$", text, re.MULTILINE)
        self.assertEqual(sum("examples/" in command for command in commands), 8)
        # As at the root of a source tree that was built, where python3 is the one that runs this.
        root = self.out / "root"
        (root / "build/bin").mkdir(parents=True)
        (root / "client").symlink_to(CLIENT.parent)
        (root / "build/bin/raynest").symlink_to(pathlib.Path(self.raynest).resolve())
        (root / "python3").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        (root / "python3").chmod(0o755)
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        environment = dict(os.environ, RAYNEST_SERVER=daemon.uri,
                           PATH=f"{root}:{os.environ['PATH']}")
        environment.pop("PYTHONPATH")
        done = subprocess.run(["bash", "-ec", "\n".join(commands)], cwd=root, env=environment,
                              stdin=subprocess.DEVNULL, capture_output=True, text=True,
                              timeout=SECONDS_MAX, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("times raynest query", done.stdout)
        for made in ("sweep.ply", "distortion.svg", "sees.npy", "sun.npy"):
            self.assertGreater((root / made).stat().st_size, 1000, made)

    def test_pieces_of_the_readme_print_what_it_says(self):
        text = (CLIENT / "README.md").read_text(encoding="utf-8")
        program = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        done = self.run_python("-c", program, daemon=daemon)
        self.assertEqual(done.returncode, 0, done.stderr)
        promised = re.findall(r"^print\(.*\) +# (.+)$", program, re.MULTILINE)
        self.assertGreater(len(promised), 3)
        for line in promised:
            self.assertIn(line, done.stdout.splitlines())


if __name__ == "__main__":
    main()
