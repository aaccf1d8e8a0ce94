#!/usr/bin/env python3
"""raynestd backup copies a state folder while a daemon uses it, restore brings the copy back, and gc
removes what no scene needs.

  backup_test.py RAYNESTD RAYNEST
"""
import json
import os
import shutil
import sqlite3
import subprocess
import threading

from daemon import PATIENCE, Client, Daemon, main
from with_state import WOODS, WithState


class Backup(WithState):
    def raynestd_says(self, code, *words):
        done = subprocess.run([self.raynestd, *map(str, words)], stdin=subprocess.DEVNULL, capture_output=True,
                              text=True, timeout=PATIENCE, check=False)
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def elsewhere(self, folder):
        """A client of a second daemon, on the backup."""
        daemon = Daemon(self.raynestd, "--state", folder)
        self.addCleanup(daemon.folder.cleanup)
        self.addCleanup(daemon.process.wait)
        self.addCleanup(daemon.process.kill)
        return Client(self.raynest, daemon.uri), daemon

    def test_a_backup_is_the_state_of_a_moment(self):
        client = self.start()
        for name in "abc":
            client.run("load", f"{WOODS}&seed={ord(name)}", "--name", name)
        client.run("edit", "b", "--move", "birch-1=0,0,3", "--keep")
        told = self.scenes()
        hits = {name: self.hits(name) for name in told}
        said = self.raynestd_says(0, "backup", self.state, self.folder / "copy")
        self.assertIn("3 scenes", said)
        self.assertIn(" 0 damaged", said)
        client.run("unload", "a")
        client.run("edit", "b", "--move", "birch-1=0,0,-9", "--keep")
        other, _ = self.elsewhere(self.folder / "copy")
        restored = self.scenes(other)
        self.assertEqual({name: (scene["hash"], scene["epoch"]) for name, scene in restored.items()},
                         {name: (scene["hash"], scene["epoch"]) for name, scene in told.items()})
        for name in told:
            self.assertEqual(self.hits(name, other), hits[name])
        # Nothing is shared: what befalls one file befalls no other.
        for blob in (self.folder / "copy" / "blobs").iterdir():
            self.assertEqual(blob.stat().st_nlink, 1)

    def test_backups_beside_loads_and_edits_are_whole(self):
        client = self.start()
        client.run("load", WOODS, "--name", "edited")
        done, seen = threading.Event(), [(1, self.scenes()["edited"]["hash"])]

        def edit():
            while not done.is_set():
                answer = client.json("edit", "edited", "--move", "birch-1=0,0,0.1", "--keep")
                seen.append((answer["epoch"], answer["hash"]))

        def load():
            number = 0
            while not done.is_set():
                number += 1
                client.run("load", f"{WOODS}&seed={number}", "--name", "replaced", "--replace")

        threads = [threading.Thread(target=work) for work in (edit, load)]
        for thread in threads:
            thread.start()
        try:
            for number in range(6):
                self.raynestd_says(0, "backup", self.state, self.folder / f"copy-{number}")
        finally:
            done.set()
            for thread in threads:
                thread.join()
        epochs = []
        for number in range(6):
            other, daemon = self.elsewhere(self.folder / f"copy-{number}")
            scene = self.scenes(other)["edited"]
            self.assertIn((scene["epoch"], scene["hash"]), seen)
            self.hits("edited", other)
            epochs.append(scene["epoch"])
            daemon.process.kill()
            daemon.process.wait()
        self.assertEqual(epochs, sorted(epochs))
        self.assertGreater(epochs[-1], epochs[0])

    def test_a_restore_puts_the_backup_in_the_place_of_all(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        client.run("edit", "woods", "--move", "birch-1=0,0,3", "--keep")
        told, hits, copy = self.scenes(), self.hits("woods"), self.folder / "copy"
        self.raynestd_says(0, "backup", self.state, copy)
        self.assertIn("another daemon uses", self.raynestd_says(1, "restore", copy, self.state))
        client.run("load", f"{WOODS}&seed=2", "--name", "later")
        later = self.blob_of(self.scenes()["later"]["hash"])
        self.kill()
        for part in self.state.glob("manifest.sqlite*"):
            part.unlink()
        (self.state / "manifest.sqlite").write_bytes(b"damaged" * 1000)
        self.assertIn("raynestd restore BACKUP DIR", self.refused())
        # A backup that is none changes nothing.
        (self.folder / "none").mkdir()
        for wrong in (self.folder / "gone", self.folder / "none"):
            self.assertIn("is no state folder", self.raynestd_says(1, "restore", wrong, self.state))
        # Nor does one that gc or the restore itself would take away.
        for wrong in (self.state, self.folder, self.state / "restoring", self.state / "damaged" / "copy"):
            self.assertIn("lie within each other", self.raynestd_says(1, "restore", wrong, self.state))
        self.assertEqual((self.state / "manifest.sqlite").read_bytes(), b"damaged" * 1000)
        self.assertTrue((self.blobs / later).exists())

        said = self.raynestd_says(0, "restore", copy, self.state)
        self.assertIn("1 scenes", said)
        self.assertIn("replaced", said)
        self.assertTrue((self.state / "replaced" / "blobs" / later).exists())
        self.assertIn("earlier restore", self.raynestd_says(1, "restore", copy, self.state))
        self.start()
        back = self.scenes()
        self.assertEqual([(name, scene["hash"], scene["epoch"]) for name, scene in back.items()],
                         [(name, scene["hash"], scene["epoch"]) for name, scene in told.items()])
        self.assertEqual(self.hits("woods"), hits)
        # A folder that is new, or empty, has nothing to put aside.
        for number, folder in enumerate((self.folder / "new", self.folder / "empty")):
            if number:
                folder.mkdir()
            self.assertNotIn("replaced", self.raynestd_says(0, "restore", copy, folder))
            self.assertEqual({part.name for part in folder.iterdir()}, {"lock", "blobs", "damaged", "manifest.sqlite"})
        # One that was cut off is made anew.
        (self.folder / "new" / "restoring.unfinished").mkdir()
        (self.folder / "new" / "restoring").mkdir()
        self.raynestd_says(0, "restore", copy, self.folder / "new")
        self.assertFalse((self.folder / "new" / "restoring").exists())

    def test_a_restore_that_was_cut_off_is_finished(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        hits, copy = self.hits("woods"), self.folder / "copy"
        self.raynestd_says(0, "backup", self.state, copy)
        client.run("unload", "woods")
        client.run("load", "builtin:flake?depth=2", "--name", "flake")
        self.kill()
        # As a kill leaves it: its copy is complete, and so many renames are done.
        parts = ["manifest.sqlite", "manifest.sqlite-wal", "manifest.sqlite-shm", "damaged", "blobs"]

        def cut_off(name, renames):
            state = self.folder / name
            shutil.copytree(self.state, state, ignore=shutil.ignore_patterns("successor"))
            shutil.copytree(copy, state / "restoring")
            (state / "replaced").mkdir()
            steps = [(state, state / "replaced", part) for part in parts if (state / part).exists()]
            steps += [(state / "restoring", state, part) for part in reversed(parts) if (state / "restoring" / part).exists()]
            for source, target, part in steps[:renames]:
                (source / part).rename(target / part)
            return state, len(steps)

        count = cut_off("counted", 0)[1]
        self.assertGreaterEqual(count, 6)
        for renames in range(count + 1):
            state, _ = cut_off(f"gc-{renames}", renames)
            self.assertIn("was cut off; raynestd gc", self.raynestd_says(1, "check", state))
            self.raynestd_says(0, "gc", state)
            self.assertIn("1 scenes", self.raynestd_says(0, "check", state))
            self.assertTrue((state / "replaced" / "manifest.sqlite").exists(), renames)
            self.raynestd_says(0, "gc", state)
            self.assertFalse((state / "replaced").exists())
        again, _ = cut_off("again", count - 1)
        self.assertIn("earlier restore", self.raynestd_says(1, "restore", copy, again))
        self.state, _ = cut_off("started", count // 2)
        self.start()
        self.assertIn("restore_finishes", self.daemon.log())
        self.assertEqual(set(self.scenes()), {"woods"})
        self.assertEqual(self.hits("woods"), hits)
        self.kill()

    def test_garbage_goes_and_scenes_stay(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        hits = self.hits("woods")
        self.assertIn("another daemon uses", self.raynestd_says(1, "gc", self.state))
        self.kill()
        digest, = os.listdir(self.blobs)
        (self.blobs / ("0" * 64)).write_bytes(b"x" * 3_000_000)
        (self.blobs / ".unfinished").write_bytes(b"x" * 1_000_000)
        (self.state / "damaged" / digest).write_bytes(b"x" * 2_000_000)
        (self.state / "replaced" / "blobs").mkdir(parents=True)
        (self.state / "replaced" / "blobs" / digest).write_bytes(b"x" * 4_000_000)
        self.assertIn("9.5 MiB removed", self.raynestd_says(0, "gc", self.state))
        self.assertEqual(os.listdir(self.blobs), [digest])
        self.assertEqual(os.listdir(self.state / "damaged"), [])
        self.assertFalse((self.state / "replaced").exists())
        self.assertIn("0 B removed", self.raynestd_says(0, "gc", self.state))
        self.start()
        self.assertEqual(self.hits("woods"), hits)
        self.kill()
        self.assertIn("is no state folder", self.raynestd_says(1, "gc", self.folder))
        # Without its manifest nobody knows what is garbage.
        for part in self.state.glob("manifest.sqlite*"):
            part.unlink()
        (self.state / "manifest.sqlite").write_bytes(b"damaged" * 1000)
        self.raynestd_says(1, "gc", self.state)
        self.assertEqual(os.listdir(self.blobs), [digest])
        for words in ((), (self.state, self.state), ("--all", )):
            self.assertIn("raynestd gc DIR", self.raynestd_says(2, "gc", *words))
            self.assertIn("raynestd restore BACKUP DIR", self.raynestd_says(2, "restore", *words[:1]))

    def test_links_pipes_and_foreign_tables_are_told_and_not_followed(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        self.kill()
        digest, = os.listdir(self.blobs)
        victim = self.folder / "victim"

        def spoiled(name):
            shutil.copytree(self.state, self.folder / name, ignore=shutil.ignore_patterns("successor"))
            return self.folder / name

        for part in ("blobs", "damaged", "replaced", "restoring"):
            victim.mkdir(exist_ok=True)
            (victim / "precious").write_bytes(b"x" * 1000)
            (victim / "below").mkdir(exist_ok=True)
            state = spoiled(f"link-{part}")
            shutil.rmtree(state / part, ignore_errors=True)
            (state / part).symlink_to(victim)
            self.assertIn("0 B removed", self.raynestd_says(0, "gc", state))
            self.assertEqual(sorted(os.listdir(victim)), ["below", "precious"], part)
        for name, make in (("pipe", os.mkfifo), ("zero", lambda path: path.symlink_to("/dev/zero")), ("folder", os.mkdir)):
            state = spoiled(name)
            (state / "blobs" / digest).unlink()
            make(state / "blobs" / digest)
            with self.subTest(name):
                self.assertIn("it is no regular file", self.raynestd_says(1, "check", state))
                # The other scenes are backed up all the same.
                said = self.raynestd_says(3, "backup", state, self.folder / f"copy-of-{name}")
                self.assertIn("1 scenes have lost their blobs", said)
        for name, make in (("pipes", os.mkfifo), ("zeros", lambda path: path.symlink_to("/dev/zero")), ("folders", os.mkdir)):
            state = spoiled(name)
            for part in state.glob("manifest.sqlite*"):
                part.unlink()
            make(state / "manifest.sqlite")
            for words in (("check",), ("gc",), ("backup", self.folder / "copy")):
                with self.subTest(name, command=words[0]):
                    self.assertRegex(self.raynestd_says(1, words[0], state, *words[1:]),
                                     "no regular file|no state folder|missing or empty")
        for name, change in (("view", "DROP TABLE scenes; CREATE VIEW scenes AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL "
                              "SELECT i + 1 FROM n) SELECT i AS number FROM n"),
                             ("trigger", "CREATE TRIGGER gone AFTER INSERT ON scenes BEGIN DELETE FROM scenes; END")):
            state = spoiled(name)
            manifest = sqlite3.connect(state / "manifest.sqlite")
            manifest.executescript(change)
            manifest.close()
            for command in ("check", "gc"):
                self.assertIn("it has what raynestd has not put there", self.raynestd_says(1, command, state))
            self.state, kept = state, self.state
            self.assertIn("it has what raynestd has not put there", self.refused())
            self.state = kept

    def test_what_cannot_be_copied_leaves_nothing(self):
        client = self.start()
        (self.folder / "taken").mkdir()
        client.run("load", WOODS, "--name", "woods")
        copy = self.folder / "copy"
        for words, said in (((self.state, self.state), "lie within each other; name a folder beside it"),
                            ((self.state, self.blobs / "copy"), "lie within each other"),
                            ((self.state, self.folder), "lie within each other"),
                            ((self.state, self.folder / "taken"), "exists; name a new folder"),
                            ((self.folder / "taken", copy), "is no state folder"),
                            ((self.state, self.folder / "no" / "such"), "cannot make"),
                            ((self.folder / "gone", copy), "is no state folder"),
                            ((self.state, ""), "needs the name of a new folder")):
            with self.subTest(words=words):
                self.assertIn(said, self.raynestd_says(1, "backup", *words))
        for words in ((), (self.state,), (self.state, copy, copy), ("--all", copy)):
            self.assertIn("raynestd backup DIR NEW", self.raynestd_says(2, "backup", *words))
        for command in ("check", "backup", "restore", "gc"):
            self.assertIn(f"raynestd {command} ", self.raynestd_says(0, command, "--help"))
        copy.with_name("copy.unfinished").mkdir()
        self.assertIn("another backup goes on", self.raynestd_says(1, "backup", self.state, copy))
        copy.with_name("copy.unfinished").rmdir()
        copy.symlink_to(self.folder / "elsewhere")
        self.assertIn("exists", self.raynestd_says(1, "backup", self.state, copy))
        copy.unlink()
        # A folder above it may be a link.
        (self.folder / "real").mkdir()
        (self.folder / "link").symlink_to(self.folder / "real")
        self.raynestd_says(0, "backup", self.state, self.folder / "link" / "copy")
        # A blob that is gone is told, and the others are kept.
        client.run("load", f"{WOODS}&seed=2", "--name", "lost")
        digest = self.blob_of(self.scenes()["lost"]["hash"])
        (self.blobs / digest).rename(self.folder / "hidden")
        said = self.raynestd_says(3, "backup", self.state, copy)
        self.assertIn("lost: its file is gone", said)
        self.assertIn("1 scenes have lost their blobs", said)
        self.assertEqual(len(list((copy / "blobs").iterdir())), 1)
        shutil.rmtree(copy)
        # A flipped byte in a blob is found by the check of the copy.
        (self.folder / "hidden").rename(self.blobs / digest)
        with open(self.blobs / digest, "r+b") as blob:
            blob.seek(5000)
            byte = blob.read(1)
            blob.seek(5000)
            blob.write(bytes([byte[0] ^ 1]))
        self.assertIn("1 damaged", self.raynestd_says(3, "backup", self.state, copy))
        # It comes back with its damage, and says so; what was there stays.
        self.kill()
        said = self.raynestd_says(3, "restore", copy, self.state)
        self.assertIn("replaced, where damaged scenes may be whole", said)

    def test_all_four_tell_in_json(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        client.run("load", f"{WOODS}&seed=2", "--name", "lost")
        digest = self.blob_of(self.scenes()["lost"]["hash"])
        copy = self.folder / "copy"

        def told(code, *words):
            said = self.raynestd_says(code, *words, "--json")
            self.assertEqual(said.count("\n"), 1, said)
            return json.loads(said)

        good = told(0, "backup", self.state, copy)
        self.assertEqual((good["scenes"], good["damaged"]), (2, []))
        self.assertGreater(good["bytes"], 1000)
        error = told(1, "backup", self.state, copy)["error"]
        self.assertEqual((error["code"], error["name"]), (1, "FAILED"))
        self.assertIn("exists; name a new folder", error["message"])
        self.assertIn("another daemon uses", told(1, "check", self.state)["error"]["message"])
        self.kill()
        self.assertEqual(told(0, "check", self.state), good)
        (self.blobs / digest).unlink()
        damaged = told(1, "check", self.state)["damaged"]
        self.assertEqual([(scene["name"], scene["reason"]) for scene in damaged], [("lost", "its file is gone")])
        restored = told(0, "restore", copy, self.state)
        self.assertEqual(restored, {**good, "replaced": str(self.state / "replaced")})
        self.assertGreater(told(0, "gc", self.state)["removed_bytes"], 1000)
        self.assertEqual(told(0, "gc", self.state), {"removed_bytes": 0})

    def test_a_folder_that_cannot_be_written_is_checked(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        view = self.folder / "view"
        view.mkdir()

        def check(code, *words):
            """Checks the folder as a read-only mount shows it."""
            script = 'mount --bind "$0" "$1" && mount -o remount,bind,ro "$1" && shift && exec "$@"'
            done = subprocess.run(["unshare", "--mount", "sh", "-c", script, self.state, view, self.raynestd, "check", view,
                                   *words], capture_output=True, text=True, timeout=PATIENCE, check=False)
            self.assertEqual(done.returncode, code, done.stdout + done.stderr)
            return done.stdout + done.stderr

        if subprocess.run(["unshare", "--mount", "true"], check=False, capture_output=True).returncode:
            self.skipTest("skipped: no right to mount")
        # The lock of a daemon that runs holds there, too.
        self.assertIn("another daemon uses", check(1))
        self.kill()  # it leaves the manifest's journal
        files = self.files()
        self.assertRegex(check(0), "(?m)^1 scenes, .*, 0 damaged$")
        self.assertNotIn("locked", check(0, "--json"))
        # A copy on such a medium may have no lock.
        (self.state / "lock").unlink()
        self.assertIn("it was not locked, because it cannot be written", check(0))
        self.assertIs(json.loads(check(0, "--json"))["locked"], False)
        digest, = self.blob_names()
        self.damage(digest)
        self.assertIn("woods: its bytes have changed", check(1))
        self.damage(digest)
        self.assertEqual(self.files(), files)
        # After a good end there is no journal.
        self.start()
        self.daemon.process.terminate()
        self.assertEqual(self.daemon.process.wait(PATIENCE), 0)
        (self.state / "lock").unlink()
        self.assertIn("0 damaged", check(0))
        self.assertFalse((self.state / "lock").exists())
        # Where it can be written, it is locked as before.
        self.assertNotIn("not locked", self.raynestd_says(0, "check", self.state))

    def test_a_full_disk_leaves_nothing(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        small = self.folder / "small"
        small.mkdir()
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", small], check=False).returncode:
            self.skipTest("skipped: no right to mount")
        self.addCleanup(subprocess.run, ["umount", small], check=False)
        self.assertIn("make room there", self.raynestd_says(1, "backup", self.state, small / "copy"))
        self.assertEqual(os.listdir(small), [])


if __name__ == "__main__":
    main()
