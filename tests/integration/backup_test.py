#!/usr/bin/env python3
"""raynestd backup copies a state folder while a daemon uses it; restore copies it back, and gc makes room.

  backup_test.py RAYNESTD RAYNEST
"""
import fcntl
import os
import shutil
import subprocess
import sys
import threading

from daemon import PATIENCE, Client, Daemon, run_tests
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

    def test_what_cannot_be_copied_leaves_nothing(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        copy = self.folder / "copy"
        for words, said in (((self.state, self.state), "exists; name a new folder"),
                            ((self.folder, copy), "is no state folder"),
                            ((self.state, self.folder / "no" / "such"), "cannot make"),
                            ((self.folder / "gone", copy), "is no state folder"),
                            ((self.state, ""), "needs the name of a new folder")):
            with self.subTest(words=words):
                self.assertIn(said, self.raynestd_says(1, "backup", *words))
        for words in ((), (self.state,), (self.state, copy, copy), ("--help", copy)):
            self.assertIn("raynestd backup DIR NEW", self.raynestd_says(2, "backup", *words))
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
        digest = self.scenes()["lost"]["hash"]
        (self.blobs / digest).rename(self.folder / "hidden")
        said = self.raynestd_says(1, "backup", self.state, copy)
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
        self.assertIn("1 damaged", self.raynestd_says(1, "backup", self.state, copy))

    def test_restore_makes_the_folder_again(self):
        client = self.start()
        for name in "ab":
            client.run("load", f"{WOODS}&seed={ord(name)}", "--name", name)
        client.run("edit", "b", "--move", "birch-1=0,0,3", "--keep")
        told = {name: (scene["hash"], scene["epoch"], self.hits(name)) for name, scene in self.scenes().items()}
        copy = self.folder / "copy"
        self.raynestd_says(0, "backup", self.state, copy)
        # A folder that is in use, or holds anything, stays as it is.
        self.assertIn("is not empty", self.raynestd_says(1, "restore", copy, self.state))
        self.kill()
        before = sorted(os.listdir(self.state))
        self.assertIn("is not empty", self.raynestd_says(1, "restore", copy, self.state))
        self.assertEqual(sorted(os.listdir(self.state)), before)
        for words, said in (((self.folder / "gone", self.folder / "new"), "is no state folder"),
                            ((copy, self.rays), "is no folder"), ((copy, self.folder / "no" / "such"), "cannot make")):
            with self.subTest(words=words):
                self.assertIn(said, self.raynestd_says(1, "restore", *words))
        self.assertFalse((self.folder / "new").exists())
        for words in ((), (copy,), (copy, self.state, self.state), ("--help", copy)):
            self.assertIn("raynestd restore BACKUP DIR", self.raynestd_says(2, "restore", *words))
        # An empty folder whose lock a daemon holds: a daemon that has just begun.
        empty = self.folder / "empty"
        empty.mkdir()
        with open(empty / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.assertIn("another daemon uses", self.raynestd_says(1, "restore", copy, empty))
        shutil.rmtree(self.state)
        for folder in (self.state, empty):
            self.assertIn("2 scenes", self.raynestd_says(0, "restore", copy, folder))
            other, daemon = self.elsewhere(folder)
            self.assertEqual({name: (scene["hash"], scene["epoch"], self.hits(name, other))
                              for name, scene in self.scenes(other).items()}, told)
            daemon.process.kill()
            daemon.process.wait()
        self.assertEqual(len(list((copy / "blobs").iterdir())), 2)

    def test_gc_removes_what_no_scene_needs(self):
        client = self.start()
        client.run("load", WOODS, "--name", "woods")
        blob, = self.blobs.iterdir()
        self.assertIn("a running daemon removes such files itself", self.raynestd_says(1, "gc", self.state))
        self.kill()
        (self.blobs / ("0" * 64)).write_bytes(b"x" * 3000)
        (self.blobs / ".new-1").write_bytes(b"x" * 72)
        (self.state / "damaged" / ("1" * 64)).write_bytes(b"y" * 1024)
        said = self.raynestd_says(0, "gc", self.state)
        self.assertIn("2 files removed, 3.0 KiB freed; 1 blobs", said)
        self.assertIn("1 damaged blobs, 1.0 KiB", said)
        self.assertEqual(list(self.blobs.iterdir()), [blob])
        self.assertIn("0 files removed", self.raynestd_says(0, "gc", self.state))
        self.assertIn("is no state folder", self.raynestd_says(1, "gc", self.folder))
        self.assertIn("raynestd gc DIR", self.raynestd_says(2, "gc"))
        self.start()
        self.hits("woods")

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
    Backup.raynestd, Backup.raynest = sys.argv[1:3]
    del sys.argv[1:3]
    run_tests()
