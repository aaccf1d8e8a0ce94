#!/usr/bin/env python3
"""Which scenes of --state are in memory, and how much their owners may have on the disk.

  state_room_test.py RAYNESTD RAYNEST
"""
import os
import sqlite3
import subprocess
import time

import numpy

from daemon import IMPORTS_GROW, PATIENCE, Client, main, second_principal, skip_sanitized, until
from metrics_test import scrape
from with_state import WOODS, WithState


class Room(WithState):
    def test_a_principal_fills_its_own_part_of_the_disk_alone(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        added = subprocess.run([self.raynestd, "token", "add", "root", "--role", "admin", *options], capture_output=True,
                               text=True, check=True)
        self.start(*options)
        admin = Client(self.raynest, self.daemon.uri, added.stdout.splitlines()[-1])
        bob = Client(self.raynest, self.daemon.uri, token)
        bob.json("load", WOODS, "--name", "one")
        size = bob.json("scenes")["scenes"][0]["bytes"]
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], size)
        self.assertEqual(admin.run("admin", "quota", "bob", f"disk_bytes={size * 3 // 2}").returncode, 0)

        def refused(*words):
            done = bob.run(*words)
            self.assertEqual(done.returncode, 6, done.stderr)
            self.assertRegex(done.stderr, "in the state folder, .* its quota is disk_bytes=.*; unload scenes")
            self.assertEqual(done.stderr.count("\n"), 1)

        files = self.blob_names()
        refused("load", WOODS + "&seed=2", "--name", "two")
        self.assertEqual(self.blob_names(), files)
        # A scene in the place of another needs no more, and others have their own part.
        bob.json("load", WOODS + "&seed=3", "--name", "one", "--replace")
        admin.json("load", WOODS + "&seed=4", "--name", "two")
        # Kept edits count, too, and those that are not kept do not.
        bob.json("edit", "one", "--move", "birch-1=0,0,1", "--keep")
        admin.json("load", "builtin:forest?trees=200", "--name", "big", "--share", "public")
        files = self.blob_names()
        refused("edit", "one", "--add", "big=0,0,0", "--keep")
        self.assertEqual(self.blob_names(), files)
        used = bob.json("stats")["quota_disk_bytes_used"]
        self.assertGreater(used, size * 0.9)
        admin.run("admin", "quota", "bob", f"disk_bytes={used}")
        refused("edit", "one", "--move", "birch-1=0,0,1", "--keep")
        bob.json("edit", "one", "--move", "birch-1=0,0,1")
        self.again(*options)
        bob = Client(self.raynest, self.daemon.uri, token)
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], used)
        self.assertGreater(bob.json("stats")["quota_disk_bytes"], used)
        bob.json("unload", "one")
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], 0)

    def test_memory_holds_the_scenes_in_use_and_the_disk_all(self):
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        client = self.start("--memory", "128M", "--principal-scene-bytes-max", "1G")
        hits = {}
        client.json("load", "builtin:forest?trees=200&seed=99", "--name", "pinned")
        client.json("load", "builtin:forest?trees=200&seed=98", "--name", "loose")
        for name in ("pinned", "loose"):
            self.assertEqual(client.json("pin", name), {"pinned": [name]})
        client.json("pin", "--off", "loose")
        for number in range(14):
            client.json("load", f"builtin:forest?trees=200&seed={number}", "--name", f"f{number}")
            hits[f"f{number}"] = self.hits(f"f{number}")
        total = sum(scene["bytes"] for scene in self.scenes().values())
        self.assertGreater(total, 128 << 20)
        states = {name: scene["state"] for name, scene in self.scenes().items()}
        self.assertEqual(states["f0"], "disk")
        self.assertEqual((states["pinned"], states["loose"]), ("pinned", "disk"))
        self.assertEqual(states["f13"], "memory")
        for _ in range(2):
            for name in hits:
                self.assertEqual(self.hits(name), hits[name])
        self.assertLessEqual(client.json("stats")["memory_used_bytes"], 128 << 20)

    def test_scenes_that_nobody_uses_make_room_for_a_load(self):
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        client = self.start("--memory", "96M", "--principal-scene-bytes-max", "85M")
        corners = numpy.random.default_rng(1).integers(0, 4, (100_000, 3, 3)).astype(numpy.float32)
        numpy.savez_compressed(self.folder / "mesh.npz", vertices=corners.reshape(-1, 3),
                               faces=numpy.arange(corners.size // 3, dtype=numpy.uint32).reshape(-1, 3))
        names = [f"s{number}" for number in range(9)]
        for number, name in enumerate(names):
            client.json("load", f"builtin:forest?trees=200&seed={number}", "--name", name)
        # The import takes several times the bytes of its scene: it finds out while it runs.
        client.json("load", self.folder / "mesh.npz", "--name", "mesh")
        states = [self.scenes()[name]["state"] for name in names]
        self.assertIn("disk", states)
        # Content that is in memory already counts twice for who loads it under two names.
        for name in names:
            self.hits(name)
        self.hits("mesh")
        client.json("load", self.folder / "mesh.npz", "--name", "again")
        self.assertEqual(client.json("stats")["scenes"], len(names) + 2)
        # Scenes in the way are named, and not those on the disk alone: they take no memory.
        for name in ("mesh", "again", *names):
            client.run("pin", name)
        refused = client.run("load", "builtin:forest?trees=200&seed=99", "--name", "more")
        self.assertEqual(refused.returncode, 6, refused.stderr)
        scenes = self.scenes()
        proposed = [name for name in scenes if f"'{name}'" in refused.stderr]
        self.assertTrue(proposed, refused.stderr)
        self.assertNotIn("disk", [scenes[name]["state"] for name in proposed])

    def test_the_folder_is_watched(self):
        client = self.start("--http", "127.0.0.1:0")
        before = scrape(self.daemon.http)
        self.assertEqual((before["raynest_state_bytes"], before["raynest_state_failed"]), (0, 0))
        disk = os.statvfs(self.state)
        self.assertAlmostEqual(before["raynest_state_free_bytes"], disk.f_frsize * disk.f_bavail, delta=1 << 30)
        client.json("load", WOODS, "--name", "woods")
        client.json("edit", "woods", "--move", "birch-1=0,0,1", "--keep")
        after = scrape(self.daemon.http)
        size = self.scenes()["woods"]["bytes"]
        self.assertGreater(after["raynest_state_bytes"], size)
        self.assertLess(after["raynest_state_bytes"], 1.1 * size)
        count = "raynest_state_commit_seconds_count"
        self.assertGreaterEqual(after[count] - before[count], 2)
        client.json("unload", "woods")
        self.assertEqual(scrape(self.daemon.http)["raynest_state_bytes"], 0)

    def test_a_pin_is_on_the_disk_before_its_answer(self):
        client = self.start()
        client.json("load", WOODS, "--name", "a")
        for off in ((), ("--off",), ()):
            client.json("pin", *off, "a")
            self.kill()
            client = self.start()
            if off:
                self.assertEqual(self.scenes()["a"]["state"], "disk")
            else:
                until(lambda: self.scenes()["a"]["state"] == "pinned", lambda: str(self.scenes()))

    def test_pins_and_the_order_of_use_outlive_the_daemon(self):
        client = self.start()
        for number, name in enumerate("abc"):
            client.json("load", f"builtin:forest?trees=40&seed={number}", "--name", name)
        client.json("pin", "b")
        for name in "cab":
            self.hits(name)
            time.sleep(0.1)
        commits = (self.state / "manifest.sqlite-wal").stat().st_size
        for _ in range(20):
            self.hits("b")
        self.assertLess((self.state / "manifest.sqlite-wal").stat().st_size - commits, 50_000, "a commit per query")

        def order():
            scenes = self.scenes()
            return "".join(sorted(scenes, key=lambda name: -scenes[name]["idle_seconds"]))

        self.assertEqual(order(), "cab")
        self.daemon.process.terminate()
        self.assertEqual(self.daemon.process.wait(PATIENCE), 0)
        self.start()
        self.assertEqual(order(), "cab")
        # A pinned scene is read at once.
        until(lambda: self.scenes()["b"]["state"] == "pinned", lambda: str(self.scenes()))
        self.assertEqual({self.scenes()[name]["state"] for name in "ac"}, {"disk"})
        # A pin is taken off without reading the scene.
        self.client.json("pin", "--off", "c")
        self.assertEqual(self.scenes()["c"]["state"], "disk")
        # A killed daemon has noted what happened more than some seconds before.
        self.client.json("pin", "a")
        self.client.json("pin", "--off", "b")
        time.sleep(0.1)     # uses that lie closer are one
        self.hits("c")
        uses = "SELECT name, pinned FROM scenes JOIN uses ON scenes.number = uses.number ORDER BY uses.used"

        def noted():
            manifest = sqlite3.connect(f"file:{self.state}/manifest.sqlite?mode=ro", uri=True)
            rows = manifest.execute(uses).fetchall()
            manifest.close()
            return rows
        until(lambda: noted() == [("a", 1), ("b", 0), ("c", 0)], lambda: str(noted()))
        self.again()
        self.assertEqual(order(), "abc")
        until(lambda: self.scenes()["a"]["state"] == "pinned", lambda: str(self.scenes()))
        # Without it nothing is lost but that.
        self.kill()
        with sqlite3.connect(self.state / "manifest.sqlite") as manifest:
            manifest.execute("UPDATE uses SET used = ?, pinned = -7", (1 << 62,))
            manifest.execute("INSERT INTO uses VALUES(?, ?, 5)", (-1, -(1 << 62)))
        manifest.close()
        self.start()
        self.assertEqual(set(self.scenes()), set("abc"))
        self.assertEqual(self.check_after_kill()[0], 0)

    def check_after_kill(self):
        self.kill()
        return self.check()

    def test_a_content_with_two_names_takes_its_room_on_the_disk_once(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        self.start(*options)
        bob = Client(self.raynest, self.daemon.uri, token)
        bob.json("load", WOODS, "--name", "one")
        size = bob.json("scenes")["scenes"][0]["bytes"]
        bob.json("load", WOODS, "--name", "two")
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], size)
        bob.json("load", "builtin:forest?trees=4", "--name", "small")
        more = bob.json("stats")["quota_disk_bytes_used"]
        self.assertGreater(more, size)
        self.assertEqual(bob.run("unload", "one").returncode, 0)
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], more)
        bob.json("edit", "two", "--move", "birch-1=0,0,1", "--keep")
        self.assertLess(bob.json("stats")["quota_disk_bytes_used"], more + size)
        self.assertEqual(bob.run("unload", "two").returncode, 0)
        self.assertEqual(bob.json("stats")["quota_disk_bytes_used"], more - size)


if __name__ == "__main__":
    main()
