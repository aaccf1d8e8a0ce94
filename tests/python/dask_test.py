#!/usr/bin/env python3
"""Many hosts on Dask distributed: the same bytes as one daemon, whatever dies.

  dask_test.py RAYNESTD RAYNEST FLATC
"""
import asyncio
import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
import time
import unittest.mock
import warnings
from pathlib import Path

import distributed
import numpy as np

import raynest
from daemon import PATIENCE, until
from raynest import _copies, _roster, generators
from raynest._deal import sent_item
from raynest._copies import uncompressed
from raynest._own_daemon import _system
from raynest._workers import item
from with_cluster import Elsewhere, WithCluster, many
from with_daemon import main, rain


SCENE = "builtin:forest?trees=20"
SWEEP = generators.lidar(np.linspace(-40, 5, 64), (0, 360, 2048), look_at=((0, 9, 0), (1, 9, 0)))
FIELDS = ("t", "prim", "path", "direction")
# Beyond any test's patience.
ENDLESS = {"size": (640, 640), "integrator": "path", "spp": 1 << 16, "item_samples": 1 << 40}


def processes(cluster, *words):
    """Process ids of what the workers of a cluster started, whose command lines have the words."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            line = (entry / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if all(word in line for word in (f"unix:{cluster.folder.name}/raynest-dask-", *words)):
            found.append(int(entry.name))
    return found


def sockets(cluster):
    """Where the daemons of the workers listen."""
    found = set()
    for pid in processes(cluster):
        with contextlib.suppress(OSError):      # it has ended meanwhile
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            found.update(word.removeprefix("unix:") for word in words if word.startswith("unix:"))
    return found


def waits(_host, _source, end):
    """An item that ends when there is such a file. The workers get it as code: they have not this module."""
    while not end.exists():
        time.sleep(0.05)


def profiled(dask_worker):
    """Milliseconds between two looks at a worker's threads."""
    return dask_worker.periodic_callbacks["profile"].callback_time


def has_task(key, dask_worker):
    """True until a worker has ended a task that was dropped."""
    return key in dask_worker.state.tasks


class ManyHosts(WithCluster):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.sweep = cls.woods.trace(SWEEP, fields=FIELDS)

    def traced(self, cluster, **options):
        options = {"item_rays": 4096, "fields": FIELDS, "setup": self.setup, **options}
        return many.trace(cluster.client, SCENE, SWEEP, **options)

    def disturbed(self, cluster, act, at=5, **options):
        """A trace during which `act` is called once so many items are answered. Returns columns and warnings."""
        called = []

        def progress(done, _total, _stage):
            if done >= at * 4096 and not called:
                called.append(True)
                act()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            seen = self.traced(cluster, progress=progress, **options)
        self.assertTrue(called)
        return seen, [str(one.message) for one in said if one.category is raynest.RayWarning]

    def told(self, cluster, ask):
        """The lists that the daemons of the workers answer, in one."""
        found = []
        for socket in sockets(cluster):
            with raynest.connect(f"unix:{socket}") as client:
                found += ask(client)
        return found

    def jobs(self, cluster):
        return self.told(cluster, raynest.Client.jobs)

    def holders(self, cluster):
        return [scene["holders"] for scene in self.told(cluster, raynest.Client.scenes)]

    def test_all_that_is_dealt_out_has_the_bytes_of_one_daemon(self):
        cluster = self.cluster(2)
        with self.subTest("a generator"):
            self.same(self.traced(cluster), self.sweep)
        with self.subTest("all hits"):
            whole = self.woods.trace(SWEEP.part(0, 20000), kind="all", fields=("t", "prim"))
            self.same(many.trace(cluster.client, SCENE, SWEEP.part(0, 20000), kind="all", fields=("t", "prim"),
                                 item_rays=3000, setup=self.setup), whole)
        with self.subTest("sent rays"):
            rays = rain(20000)
            self.same(many.trace(cluster.client, SCENE, rays, item_rays=3000, setup=self.setup), self.woods.trace(rays))
        with self.subTest("masks of sent rays"):
            masks = np.random.default_rng(2).integers(0, 3, len(rays))
            seen = many.trace(cluster.client, SCENE, rays, mask=masks, item_rays=3000, setup=self.setup)
            self.same(seen, self.woods.trace(rays, mask=masks))
            self.assertTrue((seen["t"][masks == 0] == np.inf).all())
            with self.assertRaisesRegex(raynest.UsageError, "one for each of the rays"):
                many.trace(cluster.client, SCENE, rays, mask=masks[1:], setup=self.setup)
        with self.subTest("a sweep"):
            poses = np.tile(np.eye(4)[:3], (2, 1, 1))
            poses[1, :, 3] = 3, 2, 1
            moving = generators.sweep([-5, 0, 5], (0, 360, 700), trajectory=([0, 1], poses), scans=5)
            self.same(many.trace(cluster.client, SCENE, moving, item_rays=3000, setup=self.setup),
                      self.woods.trace(moving))
        with self.subTest("a hemisphere"):
            points = np.random.default_rng(3).uniform(-20, 20, (500, 3))
            sky = generators.hemisphere(points, np.broadcast_to([0, 1, 0], points.shape), samples=50, seed=4)
            self.same(many.reduce(cluster.client, SCENE, sky, "hit_fraction", item_rays=2500, setup=self.setup),
                      self.woods.trace(sky, reduce="hit_fraction"))
        with self.subTest("visible pixels"):
            self.same(many.reduce(cluster.client, SCENE, SWEEP, "visible_pixels", item_rays=5000, setup=self.setup),
                      self.woods.trace(SWEEP, reduce="visible_pixels"))
        with self.subTest("pictures"):
            size = (200, 100)
            lit = {"size": size, "integrator": "path", "spp": 4, "seed": 5}
            self.same(many.render(cluster.client, SCENE, **lit, item_samples=4 * 2048, setup=self.setup),
                      self.woods.render(**lit))
            np.testing.assert_array_equal(many.render(cluster.client, SCENE, size=size, item_samples=4000,
                                                      setup=self.setup), self.woods.render(size=size))
            np.testing.assert_array_equal(many.heatmap(cluster.client, SCENE, size=size, item_samples=4000,
                                                       setup=self.setup), self.woods.heatmap(size=size))
        with self.subTest("arrays that stay"):
            found = many.arrays(cluster.client, SCENE, SWEEP, fields=FIELDS, item_rays=10000, setup=self.setup)
            for name, column in found.items():
                np.testing.assert_array_equal(cluster.client.compute(column, sync=True), self.sweep[name])
            self.assertEqual(cluster.client.compute(found["prim"].max(), sync=True), self.sweep["prim"].max())
        with self.subTest("a mistake"), self.assertRaisesRegex(raynest.InvalidError, "nothing"):
            many.trace(cluster.client, "builtin:nothing", SWEEP, setup=self.setup)
        with self.subTest("no daemon"), self.assertRaisesRegex(raynest.Error, "binary="):
            many.trace(cluster.client, SCENE, SWEEP, setup=self.setup._replace(binary="/nowhere/raynestd"))

    def test_the_command_line(self):
        cluster = self.cluster(1)
        address = cluster.client.scheduler.address
        folder = Path(cluster.folder.name)
        environment = {**os.environ, "RAYNEST_PYTHON": sys.executable}

        def run(*words):
            return subprocess.run([self.raynest, "--dask", address, *map(str, words)], env=environment, cwd=self.out,
                                  stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=10 * PATIENCE)
        lit = ("render", SCENE, "--size", "160x90", "--integrator", "path", "--spp", "28")
        done = run(*lit, "-o", folder / "lit.exr")
        self.assertEqual((done.returncode, done.stdout), (0, f"{folder}/lit.exr: 90 rows of pixels of 6 parts\n"),
                         done.stderr)
        layers = raynest.read_layers((folder / "lit.exr").read_bytes())
        self.same(layers, self.woods.render(size=(160, 90), integrator="path", spp=28))
        done = run("query", SCENE, "--generate", "camera", "size=500x500", "--fields", "t,prim", "-o", folder / "q.npz")
        self.assertEqual(done.returncode, 0, done.stderr)
        with np.load(folder / "q.npz") as columns:
            self.same(dict(columns), self.woods.trace(generators.camera(size=(500, 500)), fields=("t", "prim")))
        for code, said, words in (
                (2, "exposure", (*lit, "-o", folder / "lit.png")),
                (5, "no built-in scene", ("render", "builtin:nothing", "-o", folder / "x.exr")),
                (2, "--dask needs -o", ("query", SCENE, "--ray", "0,1,5,0,0,-1")),
                (2, "--dask is for", ("info", SCENE))):
            done = run(*words)
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertRegex(done.stderr, said)
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        with self.subTest("rays of a file, and points, that no worker sees"):
            np.save(self.out / "rays.npy", rain(150000))
            points = np.random.default_rng(3).uniform(-20, 20, (900, 3))
            np.save(self.out / "points.npy", np.hstack([points, np.broadcast_to([0, 1, 0], points.shape)]))
            np.save(self.out / "masks.npy", np.arange(150000) % 3)
            for name, parts, words in (("rays", 2, ("--rays", "/proc/self/cwd/rays.npy", "--fields", "t,prim")),
                                       ("masked", 2, ("--rays", "/proc/self/cwd/rays.npy", "--masks",
                                                      "/proc/self/cwd/masks.npy", "--fields", "t,prim")),
                                       ("sky", 1, ("--generate", "hemisphere", "points=/proc/self/cwd/points.npy",
                                                   "samples=8", "--reduce", "hit_fraction"))):
                done = run("--json", "query", SCENE, *words, "-o", folder / f"{name}.npz")
                self.assertEqual(done.returncode, 0, done.stderr)
                document = json.loads(done.stdout)
                one = subprocess.run([self.raynest, "--server", self.daemon.uri, "--json", "query", SCENE, *words, "-o",
                                      self.out / "one.npz"], cwd=self.out, capture_output=True, check=True)
                for key in ("hash", "rays", "hits", "misses", "rows", "intersector"):
                    self.assertEqual(document[key], json.loads(one.stdout)[key], key)
                self.assertEqual((document["parts"], document["file"]), (parts, f"{folder}/{name}.npz"))
                with np.load(folder / f"{name}.npz") as found, np.load(self.out / "one.npz") as columns:
                    self.same(dict(found), dict(columns))
        with self.subTest("--json"):
            done = run("--json", "render", SCENE, "--size", "160x90", "-o", folder / "p.png")
            document = json.loads(done.stdout)
            self.assertEqual((document["width"], document["height"], document["rays"]), (160, 90, 160 * 90), done.stderr)
            done = run("--json", "render", "builtin:nothing", "-o", folder / "x.exr")
            self.assertEqual((done.returncode, done.stdout), (5, ""))
            self.assertIn("no built-in scene", json.loads(done.stderr)["error"]["message"])

    def one_line(self, code, said, address, scene=SCENE, **environment):
        """A command that fails with a line that says so, with and without --json."""
        for before in ((), ("--json",)):
            done = subprocess.run([self.raynest, "--dask", address, *before, "render", scene, "--size", "96x64", "-o",
                                   self.out / "x.exr"], capture_output=True, text=True, timeout=10 * PATIENCE,
                                  env={**os.environ, "RAYNEST_PYTHON": sys.executable, **environment})
            self.assertEqual((done.returncode, done.stdout), (code, ""), done.stderr)
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
            message = json.loads(done.stderr)["error"]["message"] if before else done.stderr.removeprefix("raynest: ")
            self.assertRegex(message, f"^{said}")

    def test_what_is_wrong_with_a_cluster_is_a_line(self):
        soon = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}
        with self.subTest("nobody there"):
            hint = "; one with TLS has an address tls://HOST:8786"
            self.one_line(3, f"no Dask scheduler answers at tcp://127.0.0.1:1: .*{hint}$", "tcp://127.0.0.1:1", **soon)
        with self.subTest("a daemon, and no scheduler"):
            self.one_line(3, "no Dask scheduler answers at tcp", self.daemon.uri, **soon)
        with self.subTest("no package"):
            without = self.out / "without"
            (without / "distributed").mkdir(parents=True)
            (without / "distributed/__init__.py").write_text("raise ImportError('hidden')")
            path = os.pathsep.join((str(without), os.environ["PYTHONPATH"]))
            self.one_line(1, "raynest.dask needs Dask distributed: apt install", "tcp://127.0.0.1:1", PYTHONPATH=path)
        with self.subTest("no room"):
            small = self.out / "raynestd"
            small.write_text(f'#!/bin/sh\nexec {self.raynestd} --memory 64M "$@"\n')
            small.chmod(0o755)
            np.savez(self.out / "large.npz", vertices=np.zeros((900000, 3)), faces=np.zeros((900000, 3), np.uint32))
            cluster = self.cluster(0)
            cluster.environment["RAYNESTD"] = str(small)
            cluster.workers.append(cluster.add())
            cluster.wait(1)
            self.one_line(6, r"the worker \S+ has no room for the scene, whose files have \d+ MB: ",
                          cluster.client.scheduler.address, scene=str(self.out / "large.npz"))
        for what, code, said, patch, lacks in (
                ("another Dask", 2, r"the worker \S+ has distributed 1.2.3, this machine \S+: install one version",
                 "import distributed; distributed.__version__ = '1.2.3'", {}),
                ("another RayNest", 2, r"the worker \S+ has RayNest 9.9.9, this client \S+: install one version",
                 "import raynest._version; raynest._version.VERSION = '9.9.9'", {}),
                ("no RayNest", 1, "the worker \\S+ cannot run it: No module named 'raynest'; install python3-raynest",
                 "", {"PYTHONPATH": ""}),
                ("no daemon", 1, r"no worker finished an item .*cannot start /nowhere: .*install raynest there",
                 "", {"RAYNESTD": "/nowhere"})):
            with self.subTest(what):
                cluster = self.cluster(0)
                cluster.environment.update(lacks)
                cluster.workers.append(cluster.add(patch))
                cluster.wait(1)
                self.one_line(code, said, cluster.client.scheduler.address, RAYNESTD="/nowhere")

    def test_a_worker_dies_and_a_late_one_joins(self):
        cluster = self.cluster(2)

        def act():
            cluster.workers[0].kill()
            cluster.workers.append(cluster.add())
        seen, _ = self.disturbed(cluster, act)
        self.same(seen, self.sweep)
        cluster.workers[1].kill()       # the late one alone has to make it
        cluster.workers[1].wait()
        cluster.wait(1)
        self.same(self.traced(cluster), self.sweep)

    def test_an_answer_that_dask_drops_is_made_again(self):
        cluster = self.cluster(1)
        fetch, dropped = _roster.Roster.answer_of, []

        async def fetch_what_is_gone(roster, key):
            if not dropped:     # as when its worker dies, which also has the rays that it was made of
                dropped.append(key)
                await cluster.client.cancel([distributed.Future(key, cluster.client)], asynchronous=True)
            return await fetch(roster, key)
        self.enterContext(unittest.mock.patch.object(_roster.Roster, "answer_of", fetch_what_is_gone))
        rays = rain(20000)
        self.same(many.trace(cluster.client, SCENE, rays, item_rays=3000, setup=self.setup), self.woods.trace(rays))
        self.assertTrue(dropped)

    def test_arrays_travel_as_they_are(self):
        rays = np.zeros((20000, 6), np.float32)
        usual, ours = (distributed.protocol.dumps({"rays": distributed.protocol.to_serialize(each)},
                                                  context={"compression": "zlib"}) for each in (rays, uncompressed(rays)))
        self.assertLess(memoryview(usual[-1]).nbytes, rays.nbytes)
        self.assertEqual(memoryview(ours[-1]).nbytes, rays.nbytes)
        np.testing.assert_array_equal(distributed.protocol.loads(ours)["rays"], rays)

    def test_a_worker_is_seldom_profiled_while_it_makes_an_item(self):
        cluster = self.cluster(1)
        end = self.out / "end of the look"
        self.addCleanup(end.touch)
        usual, = cluster.client.run(profiled).values()
        making = cluster.client.submit(sent_item, raynest.__version__, self.setup, many.prepare(SCENE).source, waits, None, end,
                                       pure=False)
        until(lambda: list(cluster.client.run(profiled).values()) == [1000])
        end.touch()
        making.result()
        self.assertEqual((usual, list(cluster.client.run(profiled).values())), (10, [10]))

    def test_items_travel_without_source_text(self):
        cluster = self.cluster(1)
        many.trace(cluster.client, SCENE, rain(100), setup=self.setup)

        def texts():
            return cluster.client.run_on_scheduler(lambda dask_scheduler: [
                str(text) for each in dask_scheduler.computations for text in each.code])
        self.assertFalse([text for text in texts() if "def " in text])
        cluster.client.submit(len, "abc").result()      # but with one where the user submits
        self.assertTrue([text for text in texts() if "def test_items_travel" in text])

    def test_folders_of_killed_workers_are_taken_away(self):
        cluster = self.cluster(1)
        folders = {name: Path(cluster.folder.name) / f"raynest-dask-{os.getuid()}-{_system()}-{name * 16}" for name in "abcd"}
        for name, folder in folders.items():
            folder.mkdir(0o700)
            if name != "d":         # where no daemon was started
                (folder / "lock").touch()
            os.utime(folder, (0, 0))
        os.utime(folders["b"])  # as a worker that begins does
        with open(folders["c"] / "lock", "rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # a worker that lives
            self.same(self.traced(cluster), self.sweep)
        self.assertEqual([name for name, folder in folders.items() if folder.exists()], ["b", "c"])

    def test_a_daemon_dies(self):
        cluster = self.cluster(1)
        self.traced(cluster)
        daemon, = processes(cluster)
        socket, = sockets(cluster)
        self.assertEqual(os.stat(os.path.dirname(socket)).st_mode & 0o777, 0o700)
        seen, said = self.disturbed(cluster, lambda: os.kill(daemon, signal.SIGKILL), patience=PATIENCE)
        self.same(seen, self.sweep)
        self.assertEqual(said, [])

    def test_a_stuck_worker_is_not_waited_for(self):
        cluster = self.cluster(2)
        self.traced(cluster)
        seen, _ = self.disturbed(cluster, lambda: cluster.workers[0].send_signal(signal.SIGSTOP), patience=1.0)
        self.same(seen, self.sweep)
        rays = rain(20000)
        self.same(many.trace(cluster.client, SCENE, rays, item_rays=1000, setup=self.setup, patience=1.0),
                  self.woods.trace(rays))

    def test_a_client_that_cannot_wait_is_refused(self):
        cluster = self.cluster(0)
        address = cluster.client.scheduler.address

        async def alone():
            async with distributed.Client(address, asynchronous=True, set_as_default=False) as client:
                with self.assertRaisesRegex(raynest.UsageError, "the Client is asynchronous: give one made without"):
                    many.trace(client, SCENE, SWEEP, setup=self.setup)
        asyncio.run(alone())
        with distributed.Client(address, set_as_default=False) as client:
            pass
        with self.assertRaisesRegex(raynest.UsageError, "the Client is closed.*: connect anew"):
            many.trace(client, SCENE, SWEEP, setup=self.setup)

    def test_what_nobody_waits_for_is_ended(self):
        cluster = self.cluster(1)
        self.traced(cluster)
        with self.subTest("a request"):
            held = []

            def interrupt():
                try:
                    until(lambda: self.jobs(cluster))
                    held.append(self.holders(cluster))
                finally:
                    os.kill(os.getpid(), signal.SIGINT)
            interrupting = threading.Thread(target=interrupt)
            interrupting.start()
            with self.assertRaises(KeyboardInterrupt):
                many.render(cluster.client, SCENE, **ENDLESS, setup=self.setup, patience=1000.0)
            interrupting.join()
            until(lambda: not self.jobs(cluster), lambda: self.jobs(cluster))
            self.assertEqual([self.holders(cluster)], held, "no connection was given up for it")
        with self.subTest("a command"):
            lit = ("render", SCENE, "--size", "640x640", "--integrator", "path", "--spp", str(1 << 16))
            running = subprocess.Popen([self.raynest, "--dask", cluster.client.scheduler.address, *lit, "-o", "many.exr"],
                                       cwd=self.out, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                       stderr=subprocess.PIPE, text=True,
                                       env={**cluster.environment, "RAYNEST_PYTHON": sys.executable})
            until(lambda: processes(cluster, "\0--part\0"))
            running.send_signal(signal.SIGINT)
            self.assertEqual((running.communicate(timeout=10 * PATIENCE), running.returncode),
                             (("", "raynest: interrupted\n"), 130))
            until(lambda: not processes(cluster, "\0--part\0"), lambda: processes(cluster, "\0--part\0"))
            until(lambda: not self.jobs(cluster), lambda: self.jobs(cluster))
        self.same(self.traced(cluster), self.sweep)

    def test_a_thread_that_waits_for_the_load_of_another_sees_that_nobody_waits_for_it(self):
        cluster = self.cluster(1)
        self.traced(cluster)
        socket, = sockets(cluster)
        with open(os.path.dirname(socket) + "/loading", "wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)    # as another thread does while it loads
            waiting = cluster.client.submit(item, raynest.__version__, self.setup, many.prepare("builtin:forest?trees=3").source,
                                            "heatmap", None, {}, pure=False)
            key = waiting.key
            # It asks for all keys, since the scheduler may not know this one yet.
            until(lambda: any("_load" in str(stacks.get(key)) for stacks in cluster.client.call_stack().values()))
            waiting.release()
            until(lambda: not any(cluster.client.run(has_task, key).values()))
        self.same(self.traced(cluster), self.sweep)

    def test_a_link_is_cut(self):
        far = Elsewhere()
        self.addCleanup(far.close)
        cluster = self.cluster(1, far.here)
        cluster.workers.append(cluster.add(under=far.under))
        cluster.wait(2)
        self.traced(cluster)
        heard = []

        def cut():
            heard.extend(cluster.client.scheduler_info()["workers"])
            far.cut()
        seen, said = self.disturbed(cluster, cut)
        self.same(seen, self.sweep)
        self.assertTrue(any(far.there in address for address in heard), heard)
        self.assertEqual(said, [])

    def test_the_scheduler_dies(self):
        cluster = self.cluster(2)
        seen, said = self.disturbed(cluster, cluster.scheduler.kill)
        self.same(seen, self.sweep)
        self.assertTrue(any("scheduler went away" in line for line in said), said)

    def test_a_command_goes_on_without_the_scheduler(self):
        cluster = self.cluster(1)
        lit = ("render", SCENE, "--size", "160x256", "--integrator", "path", "--spp", "40")
        subprocess.run([self.raynest, "--server", self.daemon.uri, *lit, "-o", self.out / "one.exr"], check=True,
                       capture_output=True)
        running = subprocess.Popen([self.raynest, "--dask", cluster.client.scheduler.address, *lit, "-o", "many.exr"],
                                   cwd=self.out, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   env={**cluster.environment, "RAYNEST_PYTHON": sys.executable}, text=True)
        until(lambda: processes(cluster, "\0--part\0"))
        cluster.scheduler.kill()
        _, said = running.communicate(timeout=10 * PATIENCE)
        self.assertEqual(running.returncode, 0, said)
        self.assertTrue(all(line.startswith("raynest: ") for line in said.splitlines()), said)
        self.assertIn("the Dask scheduler went away", said)
        one, many_hosts = ((self.out / name).read_bytes() for name in ("one.exr", "many.exr"))
        self.same(raynest.read_layers(one), raynest.read_layers(many_hosts))


if __name__ == "__main__":
    main()
