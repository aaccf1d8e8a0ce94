#!/usr/bin/env python3
"""`raynest --dask`: what it tells the user, and with which exit code, is what one daemon's command tells.

  dask_command_test.py RAYNESTD RAYNEST FLATC
"""
import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import unittest.mock
import warnings

import numpy as np

import raynest
from raynest import _command, _deal, errors
from raynest._beside import error_of
from raynest._notes import Told
from raynest._requests import deadlines
from daemon import PATIENCE, until
from secure_daemon import Certificates
from with_cluster import WithCluster, many
from with_daemon import main, rain

SCENE = "builtin:forest?trees=20"
# A worker on which some parts have no sample by their deadline.
LATE = """
import raynest, raynest._beside, raynest.scene
def late():
    raise raynest.DeadlineError("not one sample was made by then")
render, command = raynest.scene.Scene.render, raynest._beside.command
raynest.scene.Scene.render = lambda scene, **how: late() if 16 <= how["tile"][1] < 48 else render(scene, **how)
raynest._beside.command = lambda host, source, options: (late() if {"2/4", "3/4", "--seed=1"} & {
    word for word in options["words"] if isinstance(word, str)} else command(host, source, options))
"""


def lasts(_host, _source, options):
    """An item that ends when there is such a file. The workers get it as code: they have not this module."""
    import time
    while not options["until"].exists():
        time.sleep(0.02)


class Commands(WithCluster):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.environment = {**os.environ, "RAYNEST_PYTHON": sys.executable, "RAYNESTD": cls.raynestd}

    def run_as(self, *words, **how):
        return subprocess.run([*map(str, words)], cwd=self.out, text=True, timeout=10 * PATIENCE,
                              **{"env": self.environment, "stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **how})

    def dealt(self, cluster, *words, **how):
        return self.run_as(self.raynest, "--dask", cluster.client.scheduler.address, *words, **how)

    def test_rays_that_are_not_valid_or_hit_too_much_are_told_as_by_one_daemon(self):
        cluster = self.cluster(1)
        rays = np.float64(rain(150000)[:, (0, 1, 2, 4, 5, 6)])
        rays[70000] = rays[140000] = np.nan
        np.save(self.out / "rays.npy", rays)
        np.save(self.out / "one.npy", rays[70001:140001])
        for file, kind, code in (("rays", "closest", 0), ("rays", "all", 8), ("one", "closest", 0)):
            words = ("query", SCENE, "--rays", f"{file}.npy", "--fields", "t", *(
                ("--kind", "all", "--max-hits", "1") if kind == "all" else ()), "-o")
            for before in ((), ("--json",)):
                with self.subTest(file, kind=kind, json=before):
                    one = self.run_as(self.raynest, "--server", self.daemon.uri, *before, *words, "one.npz")
                    many = self.dealt(cluster, *before, *words, "many.npz")
                    self.assertEqual((many.returncode, many.stderr), (code, one.stderr))
                    self.assertEqual(one.returncode, code)
                    self.assertIn("not valid", one.stderr)
                    if before:
                        one, many = json.loads(one.stdout), json.loads(many.stdout)
                        for key in ("invalid", "first_invalid", "truncated", "notes", "rays"):
                            self.assertEqual(many[key], one[key], key)
                    with np.load(self.out / "one.npz") as wanted, np.load(self.out / "many.npz") as found:
                        self.same(dict(found), dict(wanted))

    def test_a_lit_picture_has_as_many_parts_as_it_can(self):
        cluster = self.cluster(1)
        for words, parts in ((("--size", "64x400", "--integrator=ao", "--spp", "64"), 25),
                             (("--size", "64x400", "--integrator", "ao", "--spp", "32"), 12), (("--size", "1024x1024"), 8)):
            done = self.dealt(cluster, "--json", "render", SCENE, *words, "-o", "lit.exr")
            self.assertEqual(json.loads(done.stdout)["parts"], parts, done.stderr)

    def test_a_camera_that_sees_nothing_or_backs_alone_is_told_as_by_one_daemon(self):
        cluster = self.cluster(2)
        box = self.out / "box.obj"
        corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        box.write_text("".join("v %d %d %d\n" % corner for corner in corners) +    # seen from within, all faces show their backs
                       "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n")
        away, inside = ("--lookat=0,9000,0,0,9999,1",), ("--lookat=0,0,0,0,0,1",)
        size = ("--size", "192x1080")
        for words in (("render", *away), ("render", *inside), ("render", *away, "--integrator=path", "--spp=2"), ("heatmap", *away)):
            with self.subTest(words):
                command, *how = words
                one, many_ = (json.loads(done.stdout)["notes"] for done in (
                    self.run_as(self.raynest, "--server", self.daemon.uri, "--json", command, box, *how, *size, "-o", "one.exr"),
                    self.dealt(cluster, "--json", command, box, *how, *size, "-o", "many.exr")))
                said = [note for note in one if note.startswith("camera ")]
                self.assertEqual(len(said), 1, one)
                self.assertEqual([note for note in many_ if note.startswith("camera ")], said)
        for show, how in ((many.render, {}), (many.heatmap, {}), (many.render, {"integrator": "direct", "spp": 2})):
            for look_at, sees in ((((0, 9000, 0), (0, 9999, 1)), "nothing"), (((0, 0, 0), (0, 0, 1)), "only backs"),
                                  (((0, 0, 9), (0, 0, 0)), "")):
                with self.subTest(show=show, sees=sees, **how), warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always")
                    show(cluster.client, str(box), size=(192, 1080), look_at=look_at, item_samples=192 * 64, setup=self.setup, **how)
                    told = [str(each.message) for each in said if "camera" in str(each.message)]
                    if sees == "" or how and sees != "nothing":
                        self.assertEqual(told, [])
                    else:
                        self.assertEqual(len(told), 1, told)
                        self.assertIn(f"sees {sees}", told[0])
        # Few pixels of the whole see this one, and most tiles see nothing.
        leaf = (np.float32([[0, 0, 0], [.01, 0, 0], [0, .01, 0]]) + np.float32([.013, .021, 0]), np.array([[0, 1, 2]]))
        for show, how in ((many.render, {}), (many.heatmap, {}), (many.render, {"integrator": "ao", "spp": 1})):
            with self.subTest("a small thing", show=show, **how), warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                found = show(cluster.client, leaf, size=(960, 540), look_at=((0, 0, 2), (0, 0, 0)), fov=40, setup=self.setup, **how)
                self.assertGreater(len(np.unique(found["rgba"] if how else found)), show is many.render)
                self.assertEqual([str(each.message) for each in said if "camera" in str(each.message)], [])
        with self.subTest("a picture of one column"):
            tall = {"size": (1, 16384)}
            self.same({"": many.render(cluster.client, SCENE, setup=self.setup, **tall)}, {"": self.woods.render(**tall)})

    def test_a_picture_has_the_samples_that_were_made_by_its_deadline(self):
        cluster = self.cluster(1)
        lit = ("render", SCENE, "--integrator", "path", "--spp", "65536", "--size", "64x64", "--deadline=10", "-o", "lit.exr")
        done = self.dealt(cluster, "--json", *lit)
        self.assertEqual(done.returncode, 8, done.stderr)
        error = json.loads(done.stderr)["error"]
        self.assertEqual((error["name"], error["message"]), ("PARTIAL", "lit.exr has fewer samples than were asked for: give it "
                         "more time, or leave --deadline out"))
        document = json.loads(done.stdout)
        layers = raynest.read_layers((self.out / "lit.exr").read_bytes())
        self.assertEqual((document["height"], document["incomplete"]), (64, True))
        self.assertIn(document["parts"], (1, 2, 3, 4))      # fewer where a busy machine made no sample of one
        self.assertEqual(document["samples"], layers["samples"].min())
        self.assertLess(layers["samples"].max(), 65536)
        spread, = (note for note in document["notes"] if note.startswith("pixels have "))
        self.assertRegex(spread, f"^pixels have {layers['samples'].min():.0f} to {layers['samples'].max():.0f} of 65536 samples, ")
        self.assertAlmostEqual(float(spread.split()[-3]), layers["samples"].mean(), delta=layers["samples"].mean() / 50)
        with self.subTest("in Python"), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            layers = many.render(cluster.client, SCENE, integrator="path", spp=65536, size=(64, 32), deadline=10, setup=self.setup)
            told = [str(each.message) for each in said if each.category is raynest.RayWarning]
            self.assertEqual([sum(each.startswith(words) for each in told) for words in ("pixels have ", "the deadline passed: ")],
                             [1, 1], told)
            self.assertLess(layers["samples"].max(), 65536)

    def test_what_has_no_sample_by_its_deadline_is_written_without_one(self):
        cluster = self.cluster(0)
        cluster.workers.append(cluster.add(patch=LATE))
        cluster.wait(1)
        size, lit = (64, 56), {"integrator": "path", "spp": 128}
        whole = self.woods.render(size=size, **lit)
        for name in whole:
            whole[name] = np.array(whole[name])
            whole[name][16:48] = raynest._requests.film.UNSAMPLED.get(name, 0)
        spread = f"pixels have 0 to 128 of 128 samples, {128 * 24 / 56:.3g} on average"
        with self.subTest("in Python"), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            self.same(many.render(cluster.client, SCENE, size=size, **lit, deadline=1000, item_samples=128 * 64 * 16,
                                  setup=self.setup), whole)
            self.assertEqual([str(each.message) for each in said if each.category is raynest.RayWarning][-2:], [
                spread, "the deadline passed: pixels of the picture have 0 samples or more, fewer than it was asked for"])
        words = ("--integrator=path", "--samples", "128", "--size", "64x56", "--deadline=1000", "-o")
        done = self.dealt(cluster, "--json", "render", SCENE, *words, "late.exr")
        self.assertEqual(done.returncode, 8, done.stderr)
        document = json.loads(done.stdout)
        self.assertEqual([document[key] for key in ("parts", "height", "samples", "incomplete")], [2, 56, 0, True])
        self.assertIn(spread, document["notes"])
        self.same(raynest.read_layers((self.out / "late.exr").read_bytes()), whole)
        done = self.dealt(cluster, "render", SCENE, *words[:-1], "--exposure=0", "-o", "late.npy")
        self.assertEqual(done.returncode, 8, done.stderr)
        picture = np.load(self.out / "late.npy")
        self.same({"": picture[16:48]}, {"": np.zeros((32, 64, 4), np.uint8)})
        self.assertTrue(picture[:16].any() and picture[48:].any())
        with self.subTest("all of it"):
            done = self.dealt(cluster, "render", SCENE, "--seed=1", *words, "late.exr")
            self.assertEqual((done.returncode, done.stderr.strip()), (7, "raynest: not one sample was made by then"))

    def test_a_pixel_without_a_sample_is_as_in_python(self):
        for deadline in 0.1 * 2.0 ** np.arange(8):
            with warnings.catch_warnings(), contextlib.suppress(raynest.DeadlineError):
                warnings.simplefilter("ignore")
                layers = self.woods.render(size=(1024, 1024), integrator="path", spp=1, deadline=deadline)
                without = layers["samples"] == 0
                if without.any():
                    break
        self.assertTrue(without.any() and not without.all())
        for name, layer in layers.items():
            with self.subTest(name):
                self.assertTrue((layer[without] == raynest._requests.film.UNSAMPLED.get(name, 0)).all())

    def test_each_part_has_its_share_of_what_is_left_of_a_deadline(self):
        cluster = self.cluster(1)       # of two threads
        deal = many.Deal(cluster.client, self.setup, many.prepare(SCENE), "render", [
            many.Part({"deadline": 8}, late=Told()), many.Part({}, late=Told())], PATIENCE, None)
        for left, items, share in ((8, 8, 2.0), (8, 1, 8.0), (4, 4, 2.0), (2, 8, 0.5), (-1, 2, deadlines.SHARE_SECONDS_MIN)):
            deal._left, deal._end = items, 2.0**20 + left
            with self.subTest(left=left, items=items), unittest.mock.patch.object(deal._roster, "threads", return_value=2), \
                    unittest.mock.patch.object(_deal.time, "monotonic", return_value=2.0**20):
                self.assertEqual([deal._options(0), deal._options(1)], [{"deadline": share}, {}])
        for words, made in ((["--deadline", "6", "x"], ["--deadline", "3.0", "x"]), (["--deadline=6"], ["--deadline=3.0"]),
                            ([None, "--size", "6"], [None, "--size", "6"])):
            self.assertEqual(_command._with_share(words, lambda seconds: seconds / 2), made)
        # As for --deadline 0.001 --cameras all: the command takes no less.
        self.assertGreaterEqual(deadlines.share_of(0.001, 2, 99), 0.001)

    def test_a_picture_ends_with_its_deadline_whatever_became_of_its_parts(self):
        cluster = self.cluster(1)
        made = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", raynest.RayWarning)
            many.render(cluster.client, SCENE, size=(640, 360), integrator="path", spp=4096, deadline=2, setup=self.setup,
                        progress=lambda *told: made.append(told))
        self.assertLess(len(made), 45, "of 0.2 s each, by two threads")
        end = self.out / "end of parts"
        self.addCleanup(end.touch)
        parts = [many.Part({"until": end, "deadline": 1}, late=Told((("late", raynest.RayWarning),)))] * 99
        deal = many.Deal(cluster.client, self.setup, many.prepare(SCENE), lasts, parts, PATIENCE, None)
        with self.assertWarnsRegex(raynest.RayWarning, "late"):
            self.assertEqual([type(answer) for answer in deal.all()], [raynest.DeadlineError] * 99)

    def test_what_is_several_requests_is_dealt_out(self):
        cluster = self.cluster(1)
        poses = np.array([[0, 1, 0, 0, 0, 0, 0, 1, 3, 0, -1, 0, 0], [.2, 1, 0, 0, 2, 0, 0, 1, 3, 0, -1, 0, 1]])
        stands = np.array([[0, 1, 0, 0, 0, 0, 1, 0, 6, 0, 0, 1, 20], [1, 1, 0, 0, 0, 0, 1, 0, 6, 0, 0, 1, 15]])
        np.save(self.out / "drive.npy", poses)
        np.save(self.out / "way.npy", stands)
        np.save(self.out / "rays.npy", rain(300))
        np.save(self.out / "times.npy", np.linspace(.1, 1.3, 300))
        wind = "builtin:forest?trees=20&wind=1"
        beams = ("elevations=-20:10:8", "azimuths=0:360:60")
        wide = ("--returns", 3, "--divergence", .02, "--footprint", 7, "--noise", .05, "--seed", 4)
        for ending, words in (
                (".npz", ("query", wind, "--generate", "sweep", *beams, "trajectory=drive.npy", *wide, "--time", 1,
                          "--time-step", .03)),
                (".ply", ("query", SCENE, "--generate", "lidar", *beams, "lookat=0,3,0,0,3,-1", *wide, "--hide", "oak-*")),
                (".npz", ("query", wind, "--rays", "rays.npy", "--times", "times.npy", "--time-step", .25, "--fields", "t,hit")),
                (".npy", ("render", SCENE, "--trajectory", "way.npy", "--readout", .5, "--size", "64x48")),
                (".png", ("render", SCENE, "--trajectory", "way.npy", "--readout", .5, "--size", "64x48"))):
            with self.subTest(words=words):
                documents = [json.loads(self.done(*command, "--json", *words, "-o", name + ending)) for name, command in (
                    ("one", (self.raynest, "--server", self.daemon.uri)),
                    ("many", (self.raynest, "--dask", cluster.client.scheduler.address)))]
                one, many = ((self.out / (name + ending)).read_bytes() for name in ("one", "many"))
                self.assertEqual(many, one)
                self.assertGreater(len(many), 1000)
                # A daemon tells the digest of the scene as it was last, at a moment of its animation.
                for key in ("rays", "notes", *({"rows", "width"} & documents[0].keys()), *(() if wind in words else ("hash",))):
                    self.assertEqual(documents[1][key], documents[0][key], key)
        done = self.dealt(cluster, *words, "-o", "many.png")
        self.assertEqual((done.stdout, done.stderr), ("many.png: 64x48, 3,072 rays\n", ""))
        for code, said, words in (
                (5, "scene 'nosuch' is not loaded; with --dask name a file in its place", ("query", "nosuch", *wide)),
                (2, "the scene has no 'nothing'", ("query", SCENE, *wide, "--hide", "nothing")),
                (2, "--returns and its like go without --part", ("query", SCENE, *wide, "--part", "1/2")),
                (2, "--dask goes without --local", ("--local", "query", SCENE, *wide))):
            done = self.dealt(cluster, *words, "--generate", "lidar", *beams, "lookat=0,3,0,0,3,-1", "-o", "x.npz")
            self.assertEqual((done.returncode, done.stdout, done.stderr.count("\n")), (code, "", 1), done.stderr)
            self.assertRegex(done.stderr, f"^raynest: .*{said}")

    def done(self, *words):
        done = self.run_as(*words)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_quiet(self):
        cluster = self.cluster(1)
        look = ("render", SCENE, "--size", "4096x64", "-o", "p.png")
        inside = ("-c", "import sys\nfrom raynest import _command\nsys.exit(_command.main(sys.argv[1:]))")
        address = cluster.client.scheduler.address
        for is_quiet, program in (
                (False, (self.raynest, "--dask", address, *look)), (True, (self.raynest, "--dask", address, *look, "--quiet")),
                (True, (sys.executable, *inside, "--quiet", address, "4", SCENE, "p.png", *look))):
            ours, theirs = pty.openpty()
            done = self.run_as(*program, stderr=theirs)
            os.close(theirs)
            said = b""
            try:
                while found := os.read(ours, 1 << 16):
                    said += found
            except OSError:     # the end of it
                pass
            os.close(ours)
            self.assertEqual(done.returncode, 0, said)
            self.assertEqual(b"of 4 parts" in said, not is_quiet, said)
            self.assertEqual(done.stdout, "p.png: 64 rows of pixels of 4 parts\n")
            if not is_quiet:
                self.assertTrue(said.endswith(b"\r\033[K"), said)

    def test_what_is_wrong_has_the_exit_code_of_one_daemon(self):
        cluster = self.cluster(0)
        for code, said, words in (
                (5, "scene 'nosuch' is not loaded; with --dask name a file in its place, such as nosuch.glb", ("nosuch",)),
                (2, "--dask goes without --server: each worker has a daemon of its own", (SCENE, "--server", "unix:/x")),
                (2, "--dask goes without --server: each worker has a daemon of its own", (SCENE, "--server=unix:/x"))):
            done = self.dealt(cluster, "render", *words, "-o", "x.png")
            self.assertEqual((done.returncode, done.stderr.count("\n")), (code, 1), done.stderr)
            self.assertTrue(done.stderr.startswith(f"raynest: {said}"), done.stderr)
        one = self.run_as(self.raynest, "--server", self.daemon.uri, "render", "nosuch", "-o", "x.png")
        self.assertRegex(one.stderr, "^raynest: scene 'nosuch' is not loaded; ")
        self.assertEqual(one.returncode, 5)
        for kind in (errors.FailedError, errors.UsageError, errors.ConnectError, errors.NotAllowedError, errors.InvalidError,
                     errors.BusyError, errors.DeadlineError, errors.CancelledError):
            self.assertIs(type(error_of(kind.exit_code, "raynest: it says so")), kind)

    def test_a_command_that_is_ended_leaves_no_parts(self):
        cluster = self.cluster(1)
        folder = self.out / "temporary"
        folder.mkdir()
        running = subprocess.Popen(
            [self.raynest, "--dask", cluster.client.scheduler.address, "render", SCENE, "--size", "640x640", "--integrator", "path",
             "--spp", str(1 << 16), "-o", "p.exr"], cwd=self.out, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, env={**cluster.environment, "TMPDIR": str(folder), "RAYNEST_PYTHON": sys.executable})
        until(lambda: list(folder.glob("raynest-dask-*")))
        running.terminate()
        self.assertEqual((running.communicate(timeout=10 * PATIENCE)[0], running.returncode), ("", 128 + signal.SIGTERM))
        self.assertEqual(list(folder.iterdir()), [])

    def test_a_scheduler_with_tls(self):
        folder = Certificates(self.raynestd, self.out / "tls", "127.0.0.1").folder
        environment = {"CA_FILE": folder / "ca.pem", "CLIENT__CERT": folder / "client-cert.pem", "CLIENT__KEY": folder / "client-key.pem"}
        environment.update((f"{end}__{name}", folder / f"{name.lower()}.pem") for end in ("SCHEDULER", "WORKER") for name in ("CERT", "KEY"))
        environment = {**self.environment, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
                       **{f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(value) for name, value in environment.items()}}
        file = self.out / "scheduler.json"
        scheduler = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "tls://127.0.0.1", "--port", "0",
                                      "--no-dashboard", "--no-show", "--scheduler-file", file], cwd=self.out, env=environment,
                                     stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(lambda: (scheduler.kill(), scheduler.wait()))
        until(file.exists, patience=2 * PATIENCE)
        address = json.loads(file.read_text())["address"]
        self.assertTrue(address.startswith("tls://"), address)
        hint = "; one with TLS has an address tls://HOST:8786"
        for where, env, code, said in (
                (address.replace("tls:", "tcp:"), {**environment, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}, 3,
                 f"^raynest: no Dask scheduler answers at tcp://.*{hint}\n$"),
                (address, self.environment, 3, r"^raynest: no Dask scheduler answers at tls://(?!.*one with TLS).*\n$"),
                (address, environment, 0, "^raynest: no worker finished some items .*the cluster has no workers.*\n$")):
            with self.subTest(where, code=code):
                done = self.run_as(self.raynest, "--dask", where, "render", SCENE, "--size", "96x64", "-o", "x.png", env=env)
                self.assertEqual(done.returncode, code, done.stderr)
                self.assertRegex(done.stderr, said)

    def test_an_early_interrupt_is_a_line(self):
        program = ("import sys, time, distributed\nfrom raynest import _command\n"
                   "def start(self, **_):\n    self._Client__loop = 1\n    raise KeyboardInterrupt\n"
                   "distributed.Client.start = start\n"
                   "distributed.Client.close = lambda self, *_, **__: time.sleep(1000)\n"
                   "sys.exit(_command.main(sys.argv[1:]))")
        done = self.run_as(sys.executable, "-c", program, "tcp://127.0.0.1:1", "4", SCENE, "p.png", "render", SCENE, "-o",
                           "p.png")
        self.assertEqual((done.returncode, done.stdout, done.stderr), (130, "", "raynest: interrupted\n"))


if __name__ == "__main__":
    main()
