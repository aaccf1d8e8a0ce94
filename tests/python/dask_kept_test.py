#!/usr/bin/env python3
"""Data that a cluster and its hosts keep for requests, and when that goes.

  dask_kept_test.py RAYNESTD RAYNEST FLATC
"""
import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import unittest.mock

import numpy as np

import raynest
from daemon import PATIENCE, until
from raynest import _prepared, _workers
from with_cluster import WithCluster, many
from with_daemon import main, rain

SCENE = "builtin:forest?trees=5"
RAYS = rain(2000)
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes([200, 10, 10, 129] * 2)
LIT = {"size": (64, 40), "integrator": "path", "spp": 1}


def ground(side, seed=2):
    """Triangles (vertices, faces) under the rays."""
    at = np.linspace(-60, 60, side)
    x, z = np.meshgrid(at, at)
    y = np.random.default_rng(seed).uniform(0, 5, x.shape)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    return np.stack([x, y, z], -1).reshape(-1, 3), np.concatenate([
        np.stack([corner, corner + side, corner + 1], 1), np.stack([corner + 1, corner + side, corner + side + 1], 1)])


class OnTheCluster(WithCluster):
    """Pieces that the workers have."""

    def pieces(self, cluster):
        return {key.partition("~")[0] for key, places in cluster.client.who_has().items() if places}

    def test_changes_of_a_scene_travel_together_to_who_comes_late(self):
        cluster = self.cluster(1)
        parts, places = {"ground": ground(9), "stone": ground(3, 3)}, {"ground": "ground", "stone": ("stone", [(0, 9, 0), (5, 12, 3)])}
        scene, edits = many.prepare(parts, places=places), 100
        large = ground(9)[0] + np.zeros((81, 3))

        def change(edited, number):
            with edited.edit() as edit:
                edit.move("nobody" if number == 40 else "stone#1", (0.3, 0.1 * (number % 7 - 3), 0))
                if number in (50, 51):
                    edit.set_vertices("ground", large + (0, number - 50, 0))
        whole = []
        with self.client.scene_of(parts, places) as alone:
            for number in range(edits):
                whole.append(alone.trace(RAYS, fields=("t", "prim", "position")))
                if number != 40:
                    change(alone, number)
            whole.append(alone.trace(RAYS, fields=("t", "prim", "position")))
        self.enterContext(unittest.mock.patch.object(_prepared, "PACK_BYTES", 10000))
        self.enterContext(unittest.mock.patch.object(_prepared, "PACK", 16))
        sent, send = [], many.Prepared.send

        def noted(prepared, cluster, keys, *how):
            sent.extend(keys)
            return send(prepared, cluster, keys, *how)
        self.enterContext(unittest.mock.patch.object(many.Prepared, "send", noted))

        def seen(*epochs):
            sent.clear()
            for epoch, found in zip(epochs, many.sweep(cluster.client, scene, [(epoch, RAYS) for epoch in epochs], setup=self.setup,
                                                       fields=("t", "prim", "position"))):
                self.same(found, whole[epoch - 1])
        for number in range(edits):     # some are seen at once, the others by who comes late
            change(scene, number)
            if number < 20:
                seen(scene.epoch)
                self.assertLessEqual(len(sent), 2)
        with self.assertRaisesRegex(raynest.UsageError, "edit 41 of the scene is left out"):
            seen(scene.epoch)
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        cluster.workers[0].kill()
        cluster.workers[0].wait()
        until(lambda: len(cluster.client.scheduler_info()["workers"]) == 1)
        seen(scene.epoch)
        self.assertTrue(any("to" in key for key in sent))
        self.assertLess(len(sent), 1 + edits // 16 + 16 + 3)
        seen(scene.epoch, *range(60, 20, -7), 1, 17, 18, *range(30, 60, 3))
        with self.subTest("columns that stay"):
            sent.clear()
            found = many.arrays(cluster.client, scene, RAYS, fields=("t",), setup=self.setup)["t"]
            self.assertLess(len(sent), 1 + edits // 16 + 16 + 3)
            self.same({"t": cluster.client.compute(found, sync=True)}, {"t": whole[-1]["t"]})

    def test_what_a_request_takes_along_leaves_with_it(self):
        cluster = self.cluster(1)
        scene, other = many.prepare(*ground(20)), many.prepare(*ground(20, 3))
        own, users = set(scene._pieces), set(other._pieces)
        many.trace(cluster.client, scene, RAYS, setup=self.setup)
        until(lambda: self.pieces(cluster) == own, lambda: self.pieces(cluster))
        sent, send = set(), many.Prepared.send

        def noted(prepared, cluster, keys, *how):
            sent.update(key.partition("~")[0] for key in keys)
            return send(prepared, cluster, keys, *how)
        self.enterContext(unittest.mock.patch.object(many.Prepared, "send", noted))
        requests = {
            "a file": lambda: many.render(cluster.client, scene, **LIT, environment=HDR, setup=self.setup),
            "the user's scene": lambda: many.heatmap(cluster.client, scene, size=(64, 40), diff=other, setup=self.setup),
            "a scene": lambda: many.heatmap(cluster.client, scene, size=(64, 40), diff=ground(20, 4), setup=self.setup)}
        for what, request in requests.items():
            with self.subTest(what):
                sent.clear()
                request()
                self.assertTrue(sent - own, "it travelled")
                until(lambda: self.pieces(cluster) <= own | users, lambda: self.pieces(cluster) - own - users)
                self.assertEqual((set(scene._pieces), scene.compared), (own, []))
        with self.subTest("an error that somebody keeps"):
            sent.clear()
            try:
                with unittest.mock.patch.object(many, "slice", side_effect=KeyboardInterrupt, create=True):
                    many.render(cluster.client, ground(20, 5), **LIT, environment=HDR[:-4] + b"abcd", setup=self.setup)
            except KeyboardInterrupt as error:
                kept = error
            self.assertTrue(sent - own)
            until(lambda: not self.pieces(cluster) & (sent - own), lambda: self.pieces(cluster))
            self.assertIsInstance(kept, KeyboardInterrupt)
        with self.subTest("two requests at once, of which one ends"):
            first, second = _prepared.Baggage(scene), _prepared.Baggage(scene)
            carried = first.file(HDR), second.file(HDR)
            self.assertEqual(*carried)
            key, = set(scene._pieces) - own
            with first:
                pass
            self.assertIsNotNone(scene.piece(key))
            with second:
                pass
            self.assertIsNone(scene.piece(key))


def left(dask_scheduler):
    return {key: str(task.state) for key, task in dask_scheduler.tasks.items()}


def stored(dask_worker):
    return len(dask_worker.data)


# A program whose pieces and rays lie on a worker for a while before its scheduler is told of them.
SLOW = """
import asyncio, pathlib, sys, distributed
from raynest import _command
scatter = distributed.client.scatter_to_workers
async def slow(*given, **options):
    found = await scatter(*given, **options)
    pathlib.Path("landed").touch()
    await asyncio.sleep({})
    return found
distributed.client.scatter_to_workers = slow
sys.exit(_command.main(sys.argv[1:]))
"""


class OfACommand(WithCluster):
    def begun(self, cluster, seconds):
        """A command in the middle of its request."""
        np.savez(self.out / "only.npz", vertices=ground(20)[0], faces=ground(20)[1])
        (self.out / "landed").unlink(missing_ok=True)
        running = subprocess.Popen(
            [sys.executable, "-c", SLOW.format(seconds), cluster.client.scheduler.address, "9", "/proc/self/cwd/only.npz", "p.exr", "render",
             "/proc/self/cwd/only.npz", "--size", "640x640", "--integrator", "path", "--spp", str(1 << 16), "-o", "p.exr"],
            cwd=self.out, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**cluster.environment, "TMPDIR": str(self.out)})
        self.addCleanup(running.kill)
        until((self.out / "landed").exists, patience=2 * PATIENCE)
        return running

    def nothing_is_left(self, cluster):
        until(lambda: not cluster.client.run_on_scheduler(left), lambda: cluster.client.run_on_scheduler(left), 3 * PATIENCE)
        until(lambda: not any(cluster.client.run(stored).values()), lambda: cluster.client.run(stored))

    def test_what_is_ended_while_it_sends_leaves_nothing(self):
        cluster = self.cluster(1)
        for end, code, said in ((signal.SIGTERM, 128 + signal.SIGTERM, ""), (signal.SIGINT, 130, "raynest: interrupted\n")):
            with self.subTest(end):
                running = self.begun(cluster, 1.0)
                running.send_signal(end)
                self.assertEqual((running.communicate(timeout=10 * PATIENCE)[0], running.returncode), (said, code))
                self.nothing_is_left(cluster)

    def test_what_is_killed_leaves_nothing(self):
        """Dask does that when the connection to the client ends."""
        cluster = self.cluster(1)
        running = self.begun(cluster, 0)
        until(lambda: any(cluster.client.processing().values()))
        self.assertTrue(any(cluster.client.run(stored).values()))
        running.kill()
        self.nothing_is_left(cluster)


class OnAHost(WithCluster):
    def setUp(self):
        self.folder = self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-test-host-"))
        self.enterContext(unittest.mock.patch.object(tempfile, "tempdir", self.folder))

    def host(self, *options):
        made = _workers.Host(self.setup._replace(options=("--threads", "1", *options)), "a scheduler")
        self.addCleanup(lambda: (made.drop(), made._end()))
        self.enterContext(unittest.mock.patch.object(_workers, "_host", lambda _setup: contextlib.nullcontext(made)))
        return made

    def item(self, scene, method="trace", rays=RAYS, **options):
        return _workers.item(raynest.__version__, self.setup, scene.at(), method, rays, options)[1]

    def test_files_of_clients_go_when_no_item_needs_them_or_they_are_too_many(self):
        host, scene = self.host(), many.prepare(SCENE)
        baggage = self.enterContext(_prepared.Baggage(scene))

        def there():
            return {each.name for each in pathlib.Path(host.files).iterdir()}

        def lights(seed):
            file = baggage.file(HDR[:-4] + bytes([seed, 9, 9, 129]))
            self.item(scene, "render", None, **LIT, environment=file)
            return file.name
        first = lights(1)
        self.assertEqual(there(), {first})
        second = lights(2)
        self.assertEqual(there(), {first, second}, "the next request may need it")
        os.utime(pathlib.Path(host.files) / first, (0, 0))
        lights(2)
        self.assertEqual(there(), {second})
        with unittest.mock.patch.object(_workers, "FILES_BYTES_MAX", len(HDR)):
            third = lights(3)
            self.assertEqual(there(), {third}, "the one that was needed last stays")
            with host.making():
                needed = host.local(baggage.file(HDR[:-4] + b"need"), scene.source)
                with self.subTest("an item needs it"):
                    fourth = None

                    def another():
                        nonlocal fourth
                        fourth = lights(4)
                    thread = threading.Thread(target=another)
                    thread.start()
                    thread.join()
                    self.assertEqual(there(), {os.path.basename(needed), fourth})
        with unittest.mock.patch.object(_workers, "KEPT_SECONDS", 0.2):
            host._tidies = threading.Lock()     # the one before waits for long
            lights(5)
            self.assertTrue(there())
            until(lambda: not there())

    def test_scenes_go_when_no_item_needs_them(self):
        host = self.host()
        with unittest.mock.patch.object(_workers, "KEPT_SECONDS", 0.5):
            self.item(many.prepare(SCENE))
            moved = many.prepare({"ground": ground(9)}, places={"ground": "ground"})
            with moved.edit() as edit:
                edit.move("ground", (0, 1, 0))
            self.item(moved)
            with raynest.connect(host.uri) as client:
                self.assertEqual(len(client.scenes()), 2)
                until(lambda: not client.scenes())
        self.item(moved)

    def test_scenes_that_no_item_needs_make_room(self):
        host = self.host("--memory", "56M")

        def one(seed):
            scene = many.prepare(*ground(300, seed))
            found = self.item(scene)
            self.same(found, self.client.mesh(*ground(300, seed)).trace(RAYS))
        one(1)
        for seed in range(2, 5):
            with self.subTest(seed=seed):
                one(seed)
        with self.subTest("those of another thread"):
            failed = []

            def elsewhere():
                try:
                    one(9)
                except BaseException as error:
                    failed.append(error)
            thread = threading.Thread(target=elsewhere)
            thread.start()
            thread.join()
            self.assertEqual(failed, [])
        with self.subTest("those that the item needs stay"):
            other = many.prepare(*ground(300, 2))
            with self.assertRaises(_workers.NoRoom):
                self.item(many.prepare(*ground(300, 1)), "heatmap", None, size=(64, 40), diff=other.at())


if __name__ == "__main__":
    main()
