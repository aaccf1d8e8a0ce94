#!/usr/bin/env python3
"""How long scenes and answers stay: names, connections, jobs; Python and the command line.

  lifetimes_test.py RAYNESTD RAYNEST FLATC
"""
import gc
import os
import time

import numpy as np

import raynest
from daemon import Client, Daemon, until
from with_daemon import WithDaemon, main

CORNERS = np.eye(3)
FACE = [[0, 1, 2]]
RAY = [[1, 1, 1, -1, -1, -1]]


class Lifetimes(WithDaemon):
    def connect(self, uri=None):
        client = raynest.connect(uri or self.daemon.uri)
        self.addCleanup(client.close)
        return client

    def names(self, client=None):
        return [scene["name"] for scene in (client or self.client).scenes()]

    def gone(self, name):
        until(lambda: name not in self.names(), lambda: f"{name} is still there")

    # ---- meshes without a name -------------------------------------------------------------------

    def test_a_mesh_without_a_name_goes_with_its_connection(self):
        own = self.connect()
        scene = own.mesh(CORNERS * 2, FACE)
        name = scene.name
        kept = own.mesh(CORNERS * 3, FACE, keep=True).name
        named = own.mesh(CORNERS * 4, FACE, "named").name
        self.assertLessEqual({name, kept, named}, set(self.names()))
        own.close()
        self.gone(name)
        self.assertLessEqual({kept, named}, set(self.names()))
        for each in (kept, named):
            self.assertEqual(self.client.scene(each).unload(), [])

    def test_a_mesh_without_a_name_goes_with_its_block(self):
        with self.client.mesh(CORNERS * 5, FACE) as outer:
            with self.client.mesh(CORNERS * 5, FACE) as inner:
                self.assertNotEqual(inner.name, outer.name)
                with self.client.scene(outer.name):
                    pass
            # Another object of the same scene has ended, and another scene, not this one.
            self.assertEqual(outer.trace(RAY)["t"].shape, (1,))
        self.assertNotIn(outer.name, self.names())
        with self.client.mesh(CORNERS * 5, FACE, keep=True) as scene:
            pass
        self.assertIn(scene.name, self.names())
        with self.client.mesh(CORNERS * 5, FACE):
            pass
        self.assertIn(scene.name, self.names())
        scene.unload()

    def test_meshes_in_a_loop_do_not_pile_up(self):
        before = len(self.names())
        for i in range(1, 21):
            scene = self.client.mesh(CORNERS * (100 + i), FACE)
            self.assertEqual(scene.trace(RAY)["t"].shape, (1,))
            gc.collect()
            self.assertLessEqual(len(self.names()), before + 2)
        scene.close()
        self.assertLessEqual(len(self.names()), before + 1)

    def test_a_block_does_not_take_what_another_program_keeps(self):
        other = self.connect()
        kept = other.mesh(CORNERS * 6, FACE, keep=True)
        other.close()
        with self.client.mesh(CORNERS * 6, FACE):
            pass
        self.assertIn(kept.name, self.names())
        self.cli.run("unload", kept.name)

    # ---- references ------------------------------------------------------------------------------

    def test_unload_takes_nothing_from_another_program(self):
        mine, theirs = self.connect(), self.connect()
        town = mine.load("builtin:terrain?size=8", "town")
        held = theirs.scene("town")
        before = held.trace(RAY, fields=("t",))["t"]
        self.assertEqual(town.unload(), ["127.0.0.1 (1 connection)"])
        with self.assertRaises(raynest.InvalidError):
            town.trace(RAY)
        with self.assertRaises(raynest.InvalidError):
            self.client.scene("town")
        np.testing.assert_array_equal(held.trace(RAY, fields=("t",))["t"], before)
        # The name is free, and means another scene for others.
        again = mine.load("builtin:terrain?size=9", "town")
        self.assertNotEqual(again.info["hash"], held.info["hash"])
        self.assertEqual(self.cli.json("info", "town")["hash"], again.info["hash"])
        used = self.client.stats()["memory_used_bytes"]
        theirs.close()
        until(lambda: self.client.stats()["memory_used_bytes"] < used)
        self.assertEqual(self.client.stats()["scenes_unlisted"], 0)
        again.unload()

    def test_the_command_line_holds_nothing_when_it_has_ended(self):
        self.cli.json("load", "builtin:terrain?size=8", "--name", "hills")
        until(lambda: self.entry("hills")["holders"] == 0)
        mine = self.connect()
        hills = mine.scene("hills")
        self.assertEqual(self.entry("hills")["holders"], 1)
        done = self.cli.run("unload", "hills")
        self.assertEqual(done.returncode, 0)
        self.assertIn("still held by 127.0.0.1 (1 connection)", done.stdout)
        self.assertEqual(hills.trace(RAY)["t"].shape, (1,))
        self.assertNotIn("hills", self.names())
        self.assertIn("hills", self.names(mine))

    def test_an_administrator_holds_and_unloads_scenes_of_others(self):
        other = self.connect(self.socket)  # uid:N, the daemon's own
        self.client.load("builtin:terrain?size=8", "mine")
        self.assertEqual(Client(self.raynest, self.socket).run("unload", "mine").returncode, 0)
        self.client.load("builtin:terrain?size=8", "mine")
        held = other.scene("mine")
        self.assertEqual(held.name, "127.0.0.1/mine")
        left = self.client.scene("mine").unload()
        self.assertEqual(left, [f"uid:{os.getuid()} (1 connection)"])
        self.assertEqual(held.trace(RAY)["t"].shape, (1,))

    def test_a_detached_job_keeps_its_scene(self):
        mine = self.connect()
        scene = mine.load("builtin:forest?trees=300", "copse")
        wanted = scene.render(size=(640, 480))
        job = scene.render(size=(640, 480), detach=True)
        self.assertEqual(scene.unload(), [])
        self.assertNotIn("copse", self.names())
        np.testing.assert_array_equal(job.wait().fetch(), wanted)

    # ---- tidying up ------------------------------------------------------------------------------

    def entry(self, name):
        return next(scene for scene in self.client.scenes() if scene["name"] == name)

    def test_scenes_say_whose_they_are_and_when_they_were_used(self):
        began = time.monotonic()
        scene = self.client.load("builtin:terrain?size=8", "aged")
        scene.trace(RAY)
        mine = self.entry("aged")
        self.assertEqual((mine["owner"], mine["holders"]), ("127.0.0.1", 1))
        self.assertLessEqual(mine["idle_seconds"], mine["age_seconds"])
        self.assertLessEqual(mine["age_seconds"], time.monotonic() - began)
        told = next(each for each in self.cli.json("scenes")["scenes"] if each["name"] == "aged")
        self.assertEqual(told.keys(), mine.keys())
        for column in ("OWNER", "AGE", "UNUSED", "OPEN"):
            self.assertIn(column, self.cli.run("scenes").stdout)
        scene.unload()

    def test_all_scenes_are_unloaded_at_once(self):
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        client, cli = self.connect(daemon.uri), Client(self.raynest, daemon.uri)
        for i in range(3):
            client.mesh(CORNERS * (i + 1), FACE, f"mesh {i}")
        self.assertEqual(client.unload_all(idle=3600), [])
        self.assertIn("nothing", cli.run("unload", "--idle", "1h").stdout)
        self.assertEqual(cli.json("unload", "mesh 0")["unloaded"], ["mesh 0"])
        self.assertEqual(cli.json("unload", "--all")["unloaded"], ["mesh 1", "mesh 2"])
        self.assertEqual(cli.json("unload", "--all")["unloaded"], [])
        self.assertEqual(client.unload_all(), ["mesh 0", "mesh 1", "mesh 2"])  # which it held
        self.assertEqual(client.scenes(), [])
        for bad in ((), ("a", "--all"), ("--idle", "1"), ("--idle", "0s"), ("--idle", "1w"),
                    ("--all", "--idle", "1h")):
            self.assertEqual(cli.run("unload", *bad).returncode, 2, bad)

    def test_a_full_principal_hears_what_to_unload(self):
        daemon = Daemon(self.raynestd, "--principal-scenes-max", "3")
        self.addCleanup(daemon.stop)
        client = self.connect(daemon.uri)
        scenes = [client.mesh(CORNERS * (i + 1), FACE, name) for i, name in
                  enumerate(("first", "second", "third"))]
        scenes[0].trace(RAY)
        with self.assertRaisesRegex(raynest.BusyError, "least recently used: 'second', 'third'"):
            client.mesh(CORNERS * 9, FACE)
        self.assertIn("raynest unload", str(self.refusal(client)))

    def refusal(self, client):
        try:
            client.mesh(CORNERS * 9, FACE)
        except raynest.Error as error:
            return error
        return None

    # ---- answers ---------------------------------------------------------------------------------

    def test_a_large_detached_picture_fits_the_defaults(self):
        mesh = self.client.mesh(CORNERS, FACE)
        view = {"look_at": ((3, 3, 3), (0, 0, 0)), "size": (6000, 6000), "detach": True}
        for options in ({}, {"encode": "png"}):
            job = mesh.render(**view, **options)
            kept = job.info["bytes"]
            self.assertLess(kept, 6000 * 6000 * 4 * 1.01)
            job.cancel()

    def test_a_detached_answer_that_is_too_large_hears_what_helps(self):
        daemon = Daemon(self.raynestd, "--principal-result-bytes-max", "1000000")
        self.addCleanup(daemon.stop)
        mesh = self.connect(daemon.uri).mesh(CORNERS, FACE)
        with self.assertRaises(raynest.BusyError) as caught:
            mesh.render(size=(1000, 1000), detach=True)
        for advice in ("smaller", "detach", "principal-result-bytes-max"):
            self.assertIn(advice, str(caught.exception))

    def test_a_load_ends_at_its_deadline_and_so_does_its_import(self):
        began = time.monotonic()
        message = {"source": "builtin:terrain?size=8192", "name": "endless", "deadline_ms": 300}
        with self.assertRaises(raynest.DeadlineError):
            for _ in self.client.connection.exchange("Load", message):
                pass
        self.assertLess(time.monotonic() - began, 20)
        self.assertNotIn("endless", self.names())


if __name__ == "__main__":
    main()
