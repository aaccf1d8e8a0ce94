#!/usr/bin/env python3
"""`raynest query` that measures what a lidar reports, and traces rays at times of their own: as Python does.

  measured_command_test.py RAYNESTD RAYNEST FLATC
"""
import pathlib
import struct
import sys

import numpy as np

import raynest
from raynest import generators, returns
from with_daemon import WithDaemon, main, rain

PACKAGE = pathlib.Path(raynest.__file__).parents[1]
ANGLES = ("elevations=-20:10:8", "azimuths=0:360:60")
HEAD = np.linspace(-20, 10, 8), (0, 360, 60)
WORDS = ("--returns", 3, "--divergence", 0.02, "--footprint", 7, "--noise", 0.05, "--seed", 4)
MEASURE = {"returns": 3, "divergence": 0.02, "footprint": 7, "noise": 0.05, "seed": 4}


def drive():
    """A sensor whose z is the scene's y."""
    poses = np.zeros((2, 3, 4))
    poses[:, :, :3] = (1, 0, 0), (0, 0, 1), (0, -1, 0)
    poses[:, :, 3] = (0, 3, 0), (2, 3, 1)
    return np.array([0.0, 0.2]), poses


class MeasuredCommand(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.cli.environment.update(PYTHONPATH=str(PACKAGE), RAYNEST_PYTHON=sys.executable)
        cls.wind = cls.client.load("builtin:forest?trees=20&wind=1", "wind")
        times, poses = drive()
        cls.trajectory = cls.out / "drive.npy"
        np.save(cls.trajectory, np.column_stack([times, poses.reshape(2, 12)]))

    def columns(self, *words, scene="woods", name="made.npz"):
        told = self.cli.json("query", scene, *words, "-o", self.out / name)
        with np.load(self.out / name) as file:
            return told, dict(file)

    def test_a_sweep_is_measured_as_python_measures_it(self):
        sweep = ("--generate", "sweep", *ANGLES, f"trajectory={self.trajectory}", "scans=2", "range=1:50")
        told, made = self.columns(*sweep, *WORDS, "--prefer", "strongest", "--threshold", 0.05, "--resolution", 0.5)
        wanted = returns.measure(self.woods, generators.sweep(*HEAD, trajectory=drive(), scans=2, tmin=1, tmax=50),
                                 **MEASURE, prefer="strongest", threshold=0.05, resolution=0.5)
        self.same(made, wanted)
        self.assertGreater(wanted["return"].max(), 0)
        self.assertEqual((told["scene"], told["rows"], told["rays"]), ("woods", len(wanted["t"]), 960))
        # The scene moves meanwhile, from a time of its animation on.
        _, made = self.columns(*sweep[:-2], *WORDS, "--time", 0.5, "--time-step", 0.05, scene="wind")
        moved = generators.sweep(*HEAD, trajectory=drive())
        self.same(made, returns.measure(self.wind, moved, **MEASURE, time=0.5 + moved.time, time_step=0.05))

    def test_a_lidar_with_the_options_of_a_query(self):
        lidar = ("--generate", "lidar", *ANGLES, "lookat=0,3,0,0,3,-1")
        stands = generators.lidar(*HEAD, look_at=((0, 3, 0), (0, 3, -1)))
        _, made = self.columns(*lidar, *WORDS, "--intersector", "alpha_mask", "--set", "cutoff=0.9", "--hide", "oak-*",
                               "--fields", "t,uid,intensity")
        options = {"intersector": "alpha_mask", "params": {"cutoff": 0.9}, "hide": "oak-*"}
        wanted = returns.measure(self.woods, stands, **MEASURE, **options)
        self.same(made, {name: wanted[name] for name in ("t", "uid", "intensity")})
        plain = returns.measure(self.woods, stands)
        self.assertNotEqual(len(plain["t"]), len(wanted["t"]))
        self.same(self.columns(*lidar, "--returns", 1)[1], plain)

    def test_point_clouds_have_the_columns_of_returns(self):
        lidar = ("query", "woods", "--generate", "lidar", *ANGLES, "lookat=0,3,0,0,3,-1", *WORDS)
        told = self.cli.json(*lidar, "-o", self.out / "scan.las")
        data = (self.out / "scan.las").read_bytes()
        self.assertEqual((data[:4], struct.unpack_from("<I", data, 107)[0]), (b"LASF", told["rows"]))
        self.assertGreater(struct.unpack_from("<5I", data, 111)[1], 0)   # second returns
        done = self.cli.run(*lidar, "-o", self.out / "scan.ply", "--fields", "position,share")
        self.assertRegex(done.stdout, rf"scan.ply: {told['rows']:,} returns of 480 beams, alpha_mask, woods epoch 1\n")
        head = (self.out / "scan.ply").read_bytes().split(b"end_header")[0]
        self.assertEqual(head.count(b"property"), 4)
        self.assertIn(b"property double share", head)
        # Columns of the hits.
        stands = generators.lidar(*HEAD, look_at=((0, 3, 0), (0, 3, -1)))
        fields = ("normal", "base_colour", "texcoord", "reflectance", "velocity", "t")
        _, made = self.columns(*lidar[2:], "--fields", ",".join(fields))
        self.same(made, returns.measure(self.woods, stands, **MEASURE, fields=fields))
        self.cli.json(*lidar, "-o", self.out / "scan.ply", "--fields", "position,normal,base_colour")
        head = (self.out / "scan.ply").read_bytes().split(b"end_header")[0]
        for name in (b"x", b"nx", b"red"):
            self.assertRegex(head, rb"property \w+ " + name + rb"\n")
        self.cli.fails(2, "needs the column position", *lidar, "-o", self.out / "scan.ply", "--fields", "normal")

    def test_a_daemon_and_a_scene_of_its_own(self):
        words = ("query", "builtin:forest?trees=20", "--generate", "lidar", *ANGLES, "lookat=0,3,0,0,3,-1", *WORDS)
        with_own = [self.cli.json(*local, *words, "-o", self.out / "own.npz")["rows"] for local in ((), ("--local",))]
        self.assertEqual(with_own[0], with_own[1])
        self.assertFalse([scene for scene in self.client.scenes() if scene["name"].startswith("forest")])

    def test_rays_with_times_of_their_own(self):
        rays, times = rain(300), np.linspace(0.1, 1.3, 300)
        np.save(self.out / "rays.npy", rays)
        np.save(self.out / "times.npy", times)
        words = ("--rays", self.out / "rays.npy", "--times", self.out / "times.npy", "--intersector", "opaque")
        _, made = self.columns(*words, "--time-step", 0.25, "--fields", "t,path,hit", scene="wind")
        self.same(made, self.wind.trace(rays, time=times, time_step=0.25, intersector="opaque",
                                        fields=("t", "path", "hit")))
        self.assertGreater(made["hit"].sum(), 20)
        np.save(self.out / "two.npy", [0.1, 0.9])
        _, made = self.columns("--ray", "0,50,0,0,-1,0", "--ray", "1,50,0,0,0,-1,0,40", "--times", self.out / "two.npy",
                               "--kind", "all", "--fields", "t", scene="wind")
        wanted = self.wind.trace([[0, 50, 0, 0, 0, -1, 0, np.inf], [1, 50, 0, 0, 0, -1, 0, 40]],
                                 time=np.array([0.1, 0.9]), kind="all", fields=("t",))
        self.same(made, wanted)

    def test_what_is_refused(self):
        lidar, sweep, out = ("--generate", "lidar", *ANGLES), ("--generate", "sweep", *ANGLES), ("-o", self.out / "no.npz")
        two = self.out / "two.npy"
        np.save(two, [0.1, 0.9])
        one, moving = ("--returns", 2), (*sweep, f"trajectory={self.trajectory}")
        ray = ("--ray", "0,0,0,0,0,1")
        for words, said in (
                ((*lidar, *one), "-o FILE"), ((*lidar, *one, "-o", "-"), "-o FILE"),
                ((*lidar, "--returns", 0, *out), "returns"), ((*lidar, "--noise", "x", *out), "noise"),
                ((*lidar, "--prefer", "last", *out), "prefer"), ((*lidar, *one, "--kind", "all", *out), "--kind"),
                ((*lidar, *one, "--part", "1/2", *out), "--part"), ((*lidar, "--time-step", 1, *out), "--time-step"),
                ((*lidar, *one, "--time-step", 1, *out), "in motion"), ((*lidar, "--times", two, *out), "--times"),
                (("--generate", "camera", *one, *out), "lidar and sweep"), ((*ray, *one, *out), "--generate"),
                ((*lidar, "nonsense=1", *one, *out), "nonsense"), ((*lidar, "pose=1,2", *one, *out), "pose"),
                ((*moving, "--step-error", "1", *one, *out), "--time-step"),
                ((*lidar, *one, "--fields", "colour", *out), "no column colour: there are beam, t"),
                ((*ray, "--times", two, "-o", self.out / "no.ply"), "-o FILE.npz"),
                ((*moving[:3], "azimuths=1,5,3", moving[-1]), "azimuths=FILE.npy")):
            with self.subTest(words=words):
                self.cli.fails(2, said, "query", "woods", *words)
        self.cli.fails(5, "nobody", "query", "nobody", *lidar, *one, *out)
        for words in (("query", "woods", *lidar, *one, *out), ("query", "wind", *ray, *ray, "--times", two, *out),
                      ("render", "woods", "--trajectory", self.trajectory, "-o", self.out / "no.png")):
            self.cli.fails(5, "; leave --epoch out", *words, "--epoch", 99)
        self.cli.fails(5, "absent.npy", "query", "woods", *ray, "--times", self.out / "absent.npy", *out)
        self.cli.fails(2, "time of shape (2,) for 1 rays", "query", "wind", *ray, "--times", two, *out)
        np.save(self.out / "still.npy", 0.5)
        self.cli.fails(5, "still.npy has the shape ()", "query", "wind", *ray, "--times", self.out / "still.npy", "--time-step", 1, *out)


if __name__ == "__main__":
    main()
