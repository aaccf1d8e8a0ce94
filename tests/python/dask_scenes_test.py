#!/usr/bin/env python3
"""Scenes that only the client's machine has, and scenes that move, on many hosts: the bytes of one daemon.

  dask_scenes_test.py RAYNESTD RAYNEST FLATC
"""
import asyncio
import os
import signal
import subprocess
import sys
import types
import unittest.mock
import warnings

import numpy as np

import raynest
from daemon import PATIENCE
from raynest import _prepared, generators, returns
from with_cluster import WithCluster, many
from with_daemon import main, rain

RAYS = rain(30000)
FIELDS = ("t", "prim", "path")


def hills(side=60, seed=2):
    """Triangles (vertices, faces) of uneven ground under the rays."""
    at = np.linspace(-60, 60, side)
    x, z = np.meshgrid(at, at)
    y = np.random.default_rng(seed).uniform(0, 5, x.shape)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.stack([corner, corner + side, corner + 1], 1),
                            np.stack([corner + 1, corner + side, corner + side + 1], 1)])
    return np.stack([x, y, z], -1).reshape(-1, 3), faces


class OnlyHere(WithCluster):
    def traced(self, cluster, scene, **options):
        options = {"item_rays": 3000, "fields": FIELDS, "setup": self.setup, **options}
        return many.trace(cluster.client, scene, RAYS, **options)

    def in_pieces(self, *mesh):
        """Prepared in pieces that this test can have many of."""
        size, many.Prepared.piece_bytes = many.Prepared.piece_bytes, 100_000
        try:
            return many.prepare(*mesh)
        finally:
            many.Prepared.piece_bytes = size

    def holders(self, cluster, scene):
        return {place for places in cluster.client.who_has(list(scene._sent[cluster.client].values())).values()
                for place in places}

    def test_every_form_has_the_bytes_of_one_daemon(self):
        cluster = self.cluster(2)
        vertices, faces = hills()
        parts = {"ground": (vertices, faces), "stone": hills(5, 3)}
        places = {"ground": "ground", "stone": ("stone", [(0, 9, 0), (5, 12, 3)])}
        whole = self.client.mesh(vertices, faces).trace(RAYS, fields=FIELDS)
        file = self.out / "hills.npz"
        np.savez(file, vertices=vertices, faces=faces)
        for form in ((vertices, faces), [vertices, faces], types.SimpleNamespace(vertices=vertices, faces=faces),
                     many.prepare(vertices, faces)):
            self.same(self.traced(cluster, form), whole)
        red = raynest.Mesh(vertices, faces, raynest.Material("red", (1, 0, 0)))
        self.same(self.traced(cluster, red, fields=("t", "base_colour")),
                  self.client.mesh(vertices, faces, material=red.material).trace(RAYS, fields=("t", "base_colour")))
        for form in (file.read_bytes(), str(file), file, self.client.load(file, "hills")):
            self.same(self.traced(cluster, form), self.client.scene("hills").trace(RAYS, fields=FIELDS))
        self.same(self.traced(cluster, parts, load={"places": places}),
                  self.client.scene_of(parts, places).trace(RAYS, fields=FIELDS))
        kinds = {**parts, "ball": raynest.Spheres([[0, 0, 0], [9, 0, 0]], 4), "pair": {"ball": "ball", "stone": "stone"}}
        stand = {**places, "pair": raynest.Place("pair", [(0, 20, 0), (9, 25, 3)], mask=[1, 2], uid=7)}
        with self.client.scene_of(kinds, stand) as scene:
            whole = scene.trace(RAYS, fields=(*FIELDS, "uid"))
            self.assertIn(7, whole["uid"])
            for form, load in ((kinds, {"places": stand}), (scene, {})):
                self.same(self.traced(cluster, form, load=load, fields=(*FIELDS, "uid")), whole)
        far = {"origin": (1e6, 0, 0)}
        self.same(many.trace(cluster.client, (vertices + (1e6, 0, 0), faces), RAYS[:, (0, 1, 2, 4, 5, 6)] + (1e6, 0, 0, 0, 0, 0),
                             fields=FIELDS, load=far, setup=self.setup),
                  self.client.mesh(vertices + (1e6, 0, 0), faces, **far).trace(
                      RAYS[:, (0, 1, 2, 4, 5, 6)] + (1e6, 0, 0, 0, 0, 0), fields=FIELDS))
        lit = {"size": (96, 64), "integrator": "path", "spp": 2}
        self.same(many.render(cluster.client, (vertices, faces), **lit, item_samples=2048, setup=self.setup),
                  self.client.mesh(vertices, faces).render(**lit))
        found = many.arrays(cluster.client, hills(30), RAYS, fields=("t",), item_rays=5000, setup=self.setup)
        np.testing.assert_array_equal(cluster.client.compute(found["t"], sync=True),
                                      self.client.mesh(*hills(30)).trace(RAYS, fields=("t",))["t"])
        options = {"origin": (1, 2, 3), "up": "z", "build": "fast"}
        with self.client.mesh(vertices, faces, **options) as scene:
            self.same(self.traced(cluster, scene), scene.trace(RAYS, fields=FIELDS))
        with self.assertRaisesRegex(raynest.UsageError, "is closed, or was not made by load"):
            self.traced(cluster, scene)
        with self.client.scene_of(parts, places, masks={"stone#1": 2}, origin=(1, 2, 3)) as scene:
            self.same(self.traced(cluster, scene), scene.trace(RAYS, fields=FIELDS))
            self.same(self.traced(cluster, scene, mask=1), scene.trace(RAYS, fields=FIELDS, mask=1))
            with scene.edit() as edit:
                edit.move("stone#1", (0, 1, 0))
            with self.assertRaisesRegex(raynest.InvalidError, "was edited"):
                self.traced(cluster, scene)
        with self.assertRaisesRegex(raynest.UsageError, "was not made by load"):
            self.traced(cluster, self.client.scene("hills"))
        with self.assertRaisesRegex(raynest.InvalidError, "neither this machine nor the worker"):
            self.traced(cluster, "/nowhere/forest.glb")

    def test_warnings_of_a_scene_are_told_once(self):
        scene, info = many.prepare(*hills()), {"hash": "h", "warnings": ["it is odd"], "origin": (0, 0, 0),
                                             "degenerate_triangles": 0, "box_min": (0, 0, 0), "box_max": (1, 1, 1)}
        with self.assertWarnsRegex(raynest.SceneWarning, "^it is odd$"):
            scene.learn(info)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene.learn(info)

    def test_warnings_of_a_scene_are_those_of_one_daemon(self):
        vertices, faces = hills(10)
        cluster = self.cluster(1)

        def warned(work):
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                work()
            return [str(each.message) for each in said if each.category is raynest.SceneWarning]
        for far in (vertices + 4e6, (vertices + 4e6).astype(np.float32)):
            told = warned(lambda: self.client.mesh(far, faces))
            self.assertEqual(len(told), 1)
            self.assertEqual(warned(lambda: many.trace(cluster.client, (far, faces), RAYS[:9], setup=self.setup)), told)

    def test_files_travel_once_and_only_where_they_must(self):
        cluster = self.cluster(2)
        mesh = hills()
        first, stages = many.prepare(*mesh), []
        whole = self.traced(cluster, first, progress=lambda _done, _total, stage: stages.append(stage))
        self.assertEqual((stages[0], stages[-1]), ("sending", "tracing"))
        sent = first._sent[cluster.client]
        self.assertEqual(set(sent), {key + "~0" for key in first._pieces})
        again = many.prepare(*mesh)
        self.same(self.traced(cluster, again), whole)
        self.assertNotIn(cluster.client, again._sent, "the daemons have it already")
        file = self.out / "seen.npz"
        np.savez(file, vertices=mesh[0], faces=mesh[1])
        seen = many.prepare(file)
        self.same(self.traced(cluster, seen), whole)
        self.assertNotIn(cluster.client, seen._sent, "the workers read it at its path")

    def test_a_scene_of_many_files_is_asked_for_at_once(self):
        """Else each file that is missing begins the load anew."""
        cluster = self.cluster(1)
        asked = []
        send = many.Prepared.send

        def told(scene, cluster, keys, *others):
            asked.append(len(keys))
            return send(scene, cluster, keys, *others)
        parts = {f"hill {i}": hills(60, i) for i in range(12)}     # large enough for files of their own
        scene = many.prepare(parts)
        with unittest.mock.patch.object(many.Prepared, "send", told):
            self.same(self.traced(cluster, scene), self.client.scene_of(parts).trace(RAYS, fields=FIELDS))
            self.assertEqual(asked, [13])
            # Another scene with one of these parts: its host has that one.
            other = {"hill 3": parts["hill 3"], "hill 20": hills(60, 20)}
            self.same(self.traced(cluster, other), self.client.scene_of(other).trace(RAYS, fields=FIELDS))
            self.assertEqual(asked, [13, 2])

    def test_a_late_host_gets_it_and_lost_pieces_are_sent_again(self):
        cluster = self.cluster(1)
        scene = many.prepare(*hills())
        whole = self.traced(cluster, scene)
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        cluster.workers[0].kill()           # it alone has what was sent
        cluster.workers[0].wait()
        self.same(self.traced(cluster, scene), whole)
        late = list(cluster.client.scheduler_info()["workers"])
        self.assertLessEqual(self.holders(cluster, scene), set(late))

    def test_pieces_that_a_stuck_worker_has_are_sent_again(self):
        cluster = self.cluster(1)
        seconds, many.Prepared.piece_seconds = many.Prepared.piece_seconds, 1.0
        try:
            scene = many.prepare(*hills())
        finally:
            many.Prepared.piece_seconds = seconds
        whole = self.traced(cluster, scene)
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        cluster.workers[0].send_signal(signal.SIGSTOP)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            self.same(self.traced(cluster, scene), whole)
        self.assertFalse([one for one in said if "this machine" in str(one.message)])
        self.assertGreater(scene.sending, 0)        # more often if the late one is slow
        self.assertTrue(any(key.endswith(f"~{scene.sending}") for key in scene._sent[cluster.client]))

    def test_pieces_are_spread_over_the_hosts(self):
        cluster = self.cluster(2)
        scene = self.in_pieces(*hills(200))
        self.assertGreater(len(scene._pieces), 5)
        self.same(self.traced(cluster, scene), self.client.mesh(*hills(200)).trace(RAYS, fields=FIELDS))
        self.assertEqual(len(self.holders(cluster, scene)), 2)

    def test_pieces_that_a_stuck_worker_does_not_take_go_to_another(self):
        cluster = self.cluster(2)
        scene = self.in_pieces(*hills(200))
        stuck, other = cluster.client.scheduler_info()["workers"]
        scatter, given = cluster.client.scatter, []

        async def scatter_to_who_is_not_stuck(data, workers, **how):
            given.extend(workers)
            if workers[0] not in (stuck, other):
                raise OSError("nobody is there")
            if workers == [stuck]:
                await asyncio.sleep(PATIENCE)
            return await scatter(data, workers=workers, **how)
        self.enterContext(unittest.mock.patch.object(cluster.client, "scatter", scatter_to_who_is_not_stuck))
        self.enterContext(unittest.mock.patch.object(_prepared, "SLOW_SECONDS", 0.2))
        scene.send_all(cluster.client)
        self.assertEqual(self.holders(cluster, scene), {other})
        self.assertEqual((given.count(stuck), given.count(other)), (1, len(scene._pieces)))
        with self.assertRaisesRegex(raynest.FailedError, "no worker takes the scene's files"):
            scene.send(cluster.client, [key + "~1" for key in scene._pieces], ["tcp://nobody:1"])

    def test_the_command_line_of_a_file_that_no_worker_sees(self):
        cluster = self.cluster(1)
        mesh = hills()
        np.savez(self.out / "only.npz", vertices=mesh[0], faces=mesh[1])
        look = ("/proc/self/cwd/only.npz", "--generate", "camera", "size=300x300", "--fields", "t,prim")
        for out, words in (("one.npz", ("--server", self.daemon.uri)),      # each process has another folder there
                           ("many.npz", ("--dask", cluster.client.scheduler.address))):
            done = subprocess.run([self.raynest, *words, "query", *look, "-o", out], cwd=self.out, capture_output=True,
                                  env={**os.environ, "RAYNEST_PYTHON": sys.executable}, text=True,
                                  stdin=subprocess.DEVNULL)
            self.assertEqual(done.returncode, 0, done.stderr)
        with np.load(self.out / "one.npz") as one, np.load(self.out / "many.npz") as found:
            self.same(dict(found), dict(one))

    def test_a_host_without_room_is_told_in_a_line(self):
        cluster = self.cluster(1)
        small = self.setup._replace(options=("--threads", "1", "--memory", "64M"))
        with self.assertRaisesRegex(raynest.BusyError, r"^the worker \S+ has no room for the scene, whose files have \d+ MB: "):
            self.traced(cluster, hills(1000), setup=small, patience=PATIENCE)


def street(edit, step):
    edit.place("car", np.hstack([np.eye(3), [[3.0 * step - 40], [12], [0]]]))
    edit.move("stone#1", (0, 0.25, 0))
    if step == 3:
        edit.hide("stone#0")


class Moving(WithCluster):
    PARTS = {"ground": hills(20), "car": hills(8, 4), "stone": hills(5, 3)}
    PLACES = {"ground": "ground", "car": "car", "stone": ("stone", [(0, 9, 0), (5, 12, 3)])}

    def alone(self, steps, fields=FIELDS):
        """The scans of one daemon."""
        with self.client.scene_of(self.PARTS, self.PLACES) as scene:
            found = []
            for step in range(steps):
                with scene.edit() as edit:
                    street(edit, step)
                found.append(scene.trace(RAYS[step::3], fields=fields))
            return found

    def moved(self, steps):
        scene = many.prepare(self.PARTS, places=self.PLACES)
        scans = []
        for step in range(steps):
            with scene.edit() as edit:
                street(edit, step)
            scans.append((scene.epoch, RAYS[step::3]))
        return scene, scans

    def test_a_sweep_is_dealt_by_scan(self):
        cluster = self.cluster(2)
        scene, scans = self.moved(12)
        whole = self.alone(12)
        for seen, one in zip(many.sweep(cluster.client, scene, scans, fields=FIELDS, setup=self.setup), whole):
            self.same(seen, one)
        with self.subTest("backwards, and by a host that comes late"):
            cluster.workers.append(cluster.add())
            cluster.workers[0].kill()
            found = many.sweep(cluster.client, scene, scans[::-1], fields=FIELDS, setup=self.setup)
            for seen, one in zip(found, whole[::-1]):
                self.same(seen, one)
        with self.subTest("at the last epoch"):
            self.same(many.trace(cluster.client, scene, RAYS[11::3], fields=FIELDS, setup=self.setup, item_rays=3000),
                      whole[11])
        with self.subTest("what it was before any edit"):
            fresh = many.prepare(self.PARTS, places=self.PLACES)
            self.same(many.trace(cluster.client, fresh, RAYS, fields=FIELDS, setup=self.setup, item_rays=3000),
                      self.client.scene_of(self.PARTS, self.PLACES).trace(RAYS, fields=FIELDS))

    def test_the_scans_of_a_lidar_are_measured(self):
        cluster = self.cluster(2)
        poses = np.tile(np.array([[1, 0, 0, 0], [0, 0, 1, 25], [0, -1, 0, 0.0]]), (2, 1, 1))
        poses[1, 0, 3] = 4
        heads = [generators.sweep([-80, -60], (0, 360, 500), trajectory=([0, 1], poses)), generators.lidar(
            [-60, -40], (0, 360, 500), look_at=((0, 20, 0), (0, 20, -1)))]
        heads.append(heads[0].beams())
        wide = {"returns": 3, "divergence": .03, "footprint": 5, "noise": .02, "seed": 3, "velocities": {"car": (1, 0, 2)}}
        scene, scans, whole = many.prepare(self.PARTS, places=self.PLACES), [], []
        with self.client.scene_of(self.PARTS, self.PLACES) as alone:
            for step, head in enumerate(heads):
                for moved in (scene, alone):
                    with moved.edit() as edit:
                        street(edit, step)
                scans.append((scene.epoch, head))
                whole.append(returns.measure(alone, head, **wide))
        found = many.sweep(cluster.client, scene, scans, setup=self.setup, **wide)
        for seen, one in zip(found, whole):
            self.assertGreater(len(one["t"]), 100)
            self.assertTrue(one["radial_velocity"].any())
            self.same(seen, one)
        for rays, more, error, said in ((heads[0], {"reduce": "hit_fraction"}, raynest.UsageError, "chooses reduce itself"),
                                        (RAYS, {}, TypeError, "sweep of type numpy.ndarray")):
            with self.subTest(said), self.assertRaisesRegex(error, said):
                many.sweep(cluster.client, scene, [(1, rays)], setup=self.setup, **wide, **more)

    def test_all_that_is_measured_is_of_one_epoch(self):
        cluster = self.cluster(1)
        scene = many.prepare({"ground": hills()}, places={"ground": "ground"})
        rays = generators.lidar([-20, -10], (0, 360, 90), look_at=((0, 9, 0), (1, 9, 0)))
        how = {"velocities": {"ground": (1, 0, 0)}, "fields": ("beam", "t", "path"), "setup": self.setup}
        whole, dealt, epochs = many.measure(cluster.client, scene, rays, **how), many._Dealt._dealt, []

        def edits(*given):
            found = dealt(*given)
            with scene.edit() as edit:
                edit.move("ground", (0, -3, 0))
            epochs.append(scene.epoch)
            return found
        self.enterContext(unittest.mock.patch.object(many._Dealt, "_dealt", edits))
        self.same(many.measure(cluster.client, scene, rays, **how), whole)
        self.assertGreater(len(epochs), 1)

    def test_an_epoch_is_the_same_scene_as_for_one_daemon(self):
        cluster = self.cluster(1)
        lidar = generators.lidar([-60, -40], (0, 360, 500), look_at=((0, 20, 0), (0, 20, -1)))
        to, seen = {"look_at": ((0, 40, 50), (0, 0, 0)), "size": (64, 40)}, {"fields": ("t", "prim")}
        methods = {
            "trace": (lambda scene, **how: scene.trace(RAYS, **seen, **how), lambda *to, **how: many.trace(*to, RAYS, **seen, **how)),
            "reduce": (lambda scene, **how: scene.trace(RAYS, reduce="visible_pixels", **how),
                       lambda *to, **how: many.reduce(*to, RAYS, "visible_pixels", **how)),
            "arrays": (lambda scene, **how: scene.trace(RAYS, **seen, **how), lambda *where, **how: dict(zip(
                seen["fields"], where[0].gather(where[0].compute(list(many.arrays(*where, RAYS, **seen, **how).values())))))),
            "render": (lambda scene, **how: {"": scene.render(**to, **how)}, lambda *where, **how: {"": many.render(*where, **to, **how)}),
            "heatmap": (lambda scene, **how: {"": scene.heatmap(**to, **how)}, lambda *where, **how: {"": many.heatmap(*where, **to, **how)}),
            "measure": (lambda scene, **how: returns.measure(scene, lidar, **how), lambda *where, **how: many.measure(*where, lidar, **how))}
        scene, whole = many.prepare(self.PARTS, places=self.PLACES), []
        with self.client.scene_of(self.PARTS, self.PLACES) as alone:
            for step in range(3):
                for moved in (scene, alone) if step else ():
                    with moved.edit() as edit:
                        street(edit, step)
                self.assertEqual(scene.epoch, alone.info["epoch"])
                whole.append({name: one(alone, epoch=scene.epoch) for name, (one, _) in methods.items()})
        for name, (_, dealt) in methods.items():
            self.assertFalse(all(np.array_equal(np.asarray(whole[1][name][column]), np.asarray(whole[2][name][column]))
                                 for column in whole[2][name]), "the edit is seen")
            for epoch in (0, 1, 2, 3):
                with self.subTest(name, epoch=epoch):
                    answer = dealt(cluster.client, scene, epoch=epoch, setup=self.setup)
                    for column, values in whole[epoch - 1][name].items():
                        np.testing.assert_array_equal(np.asarray(answer[column]), np.asarray(values), column)

    def test_the_change_travels_and_not_the_scene(self):
        cluster = self.cluster(2)
        scene, scans = self.moved(3)
        many.sweep(cluster.client, scene, scans, setup=self.setup)
        before = dict(scene._sent[cluster.client])
        with scene.edit() as edit:
            edit.move("car", (0, 1, 0))
        many.sweep(cluster.client, scene, [(scene.epoch, RAYS)], setup=self.setup)
        new = set(scene._sent[cluster.client]) - set(before)
        self.assertEqual(len(new), 1)
        self.assertLess(sum(scene.piece(key.removesuffix("~0")).nbytes for key in new), 2000)
        self.assertTrue(all(scene._sent[cluster.client][key] is future for key, future in before.items()))

    def test_an_edit_adds_a_scene_that_only_the_client_has(self):
        cluster = self.cluster(2)
        ground, stone = hills(), hills(5, 3)
        placed = [np.eye(3, 4) * [1, 1, 1, 0] + np.pad([[x], [9], [3]], ((0, 0), (3, 0))) for x in (-20, 0, 25)]
        city, one = many.prepare({"ground": ground}, places={"ground": "ground"}), many.prepare(*stone)
        here = self.client.scene_of({"ground": ground}, {"ground": "ground"}, "city")
        kept = self.client.mesh(*stone, "stone")
        wanted = [here.trace(RAYS, fields=FIELDS)]
        for edited, added in ((city, one), (here, kept)):
            with edited.edit() as edit:
                edit.add(added, placed, name="stone")
        wanted.append(here.trace(RAYS, fields=FIELDS))
        for edited in (city, here):
            with edited.edit() as edit:
                edit.move("stone#1", (0, 2, 0))
        wanted.append(here.trace(RAYS, fields=FIELDS))
        for seen, scan in zip(many.sweep(cluster.client, city, [(i, RAYS) for i in (1, 2, 3)], fields=FIELDS, setup=self.setup),
                              wanted):
            self.same(seen, scan)
        self.assertFalse(np.array_equal(wanted[0]["t"], wanted[1]["t"]))
        self.assertFalse(np.array_equal(wanted[1]["t"], wanted[2]["t"]))

    def test_mistakes(self):
        cluster = self.cluster(1)
        scene, scans = self.moved(1)
        for epoch in (9, 0, None, 0.5, "1", True):
            with self.subTest(epoch=epoch), self.assertRaisesRegex(
                    raynest.UsageError, rf"^scans\[0\]: an epoch of {epoch!r}: it must be a whole number from 1 to 2$"):
                many.sweep(cluster.client, scene, [(epoch, RAYS)], setup=self.setup)
        for scan, error, said in (
                (RAYS, raynest.UsageError, r"a scan of array\(.*: it must be a pair \(epoch, rays\)"), (1, raynest.UsageError, "a scan of 1: it must"),
                ((1,), raynest.UsageError, r"a scan of \(1,\): it must"), ((1, RAYS, 2), raynest.UsageError, r"a scan of \(.*: it must"),
                ((1, RAYS[:, :5]), raynest.UsageError, r"rays of shape \(30000, 5\): they must be"),
                ((1, None), raynest.UsageError, "rays must be numbers"), ((1, types.SimpleNamespace(rays=RAYS)), TypeError, "rays is a sweep: pass sweep.rays")):
            with self.subTest(said), self.assertRaisesRegex(error, rf"^scans\[1\]: {said}"):
                many.sweep(cluster.client, scene, [*scans, scan], setup=self.setup)
        for several, said in ((None, "scans of type NoneType: they must be a list"), (5, "scans of type int: they must be a list"),
                              (RAYS, r"scans\[0\]: a scan of array")):
            with self.subTest(said), self.assertRaisesRegex(raynest.UsageError, f"^{said}"):
                many.sweep(cluster.client, scene, several, setup=self.setup)
        with self.subTest("a worker finds it out"), self.assertRaisesRegex(raynest.Error, r"^scans\[1\]: .*camera"):
            many.sweep(cluster.client, scene, [(1, RAYS), (2, generators.camera(size=(8, 8), camera=9))], setup=self.setup)
        self.assertEqual(many.sweep(cluster.client, scene, [], setup=self.setup), [])
        with self.subTest("this machine finds it out"), warnings.catch_warnings(), self.assertRaisesRegex(
                raynest.Error, r"^scans\[0\]: no worker finished an item.*camera"):
            warnings.simplefilter("ignore", raynest.RayWarning)
            many.sweep(self.cluster(0).client, scene, [(1, generators.camera(size=(8, 8), camera=9))], setup=self.setup, patience=0.2)
        with self.assertRaisesRegex(raynest.UsageError, "epoch= is of a scan here"):
            many.sweep(cluster.client, scene, scans, epoch=1, setup=self.setup)
        with self.assertRaisesRegex(raynest.UsageError, "an epoch of 3: it must be a whole number from 0 to 2"):
            many.trace(cluster.client, scene, RAYS, epoch=3, setup=self.setup)
        for prepare in (lambda: many.prepare(scene, hills()[1]), lambda: many.trace(cluster.client, scene, RAYS, load={"up": "z"})):
            with self.assertRaisesRegex(raynest.UsageError, "with a scene that is prepared already"):
                prepare()
        stone, far = many.prepare(*hills(5)), many.prepare("/nowhere/forest.glb")
        for added, name, said in (("woods", "w", "adds another scene that"), (scene, "w", "adds another scene that"),
                                  (stone, "", "give the name="), (far, "f", "must be where this program runs")):
            with self.subTest(said), self.assertRaisesRegex(raynest.UsageError, said), scene.edit() as edit:
                edit.add(added, name=name)
        with stone.edit() as edit:
            edit.hide(0)
        with self.assertRaisesRegex(raynest.UsageError, "as it was prepared"), scene.edit() as edit:
            edit.add(stone, name="stone")
        self.assertEqual(scene.epoch, 2)
        damaged = many.prepare(b"glTF and no more")
        for change, error, said in ((lambda edit: edit.move("nobody", (1, 0, 0)), raynest.UsageError, "2 .*nobody"),
                                    (lambda edit: edit.add(damaged, name="bad"), raynest.InvalidError, "3 .*scene.glb")):
            with scene.edit() as edit:
                change(edit)
            with self.assertRaisesRegex(error, "edit {} of the scene is left out from now on: {}".format(*said.split(" "))):
                many.sweep(cluster.client, scene, [(scene.epoch, RAYS)], setup=self.setup)
        with scene.edit() as edit:
            edit.hide("car")
        with self.client.scene_of(self.PARTS, self.PLACES) as alone:
            with alone.edit() as edit:
                street(edit, 0)
            whole = [alone.trace(RAYS, fields=("t",))]
            with alone.edit() as edit:
                edit.hide("car")
            whole.append(alone.trace(RAYS, fields=("t",)))
        # The epochs before it, of it, and after it.
        found = many.sweep(cluster.client, scene, [(epoch, RAYS) for epoch in (2, 3, 4, 5)], fields=("t",), setup=self.setup)
        for seen, one in zip(found, (whole[0], whole[0], *whole)):
            self.same(seen, one)
        for wrong, call, options in (("a side of size of 0", many.render, {"size": (0, 4)}), ("items of 0", many.trace, {"item_rays": 0}),
                                     ("tile= is for one daemon", many.render, {"tile": (0, 0, 64, 8)}),
                                     ("detach= is for one daemon", many.trace, {"detach": True})):
            with self.subTest(wrong), self.assertRaisesRegex(raynest.UsageError, wrong):
                call(cluster.client, hills(5), *((RAYS,) if call is many.trace else ()), setup=self.setup, **options)

    def test_masked_rays_and_one_ray_are_those_of_one_daemon(self):
        cluster = self.cluster(1)
        mesh = hills(5)
        masked = np.ma.masked_array(RAYS)
        masked[::3] = np.ma.masked
        for rays in (masked, RAYS[0]):
            ours = many.trace(cluster.client, mesh, rays, fields=("t", "flags"), setup=self.setup, item_rays=10000)
            theirs = self.client.mesh(*mesh).trace(rays, fields=("t", "flags"))
            for name in ("t", "flags"):
                np.testing.assert_array_equal(ours[name], theirs[name])


if __name__ == "__main__":
    main()
