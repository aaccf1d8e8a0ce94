#!/usr/bin/env python3
"""raynest backup copies all stored scenes to a file while the daemon goes on, restore brings scenes back, and
gc removes what is left of damaged ones.

  remote_backup_test.py RAYNESTD RAYNEST
"""
import contextlib
import io
import os
import pathlib
import signal
import sqlite3
import subprocess
import tarfile
import sys
import threading

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import PATIENCE, Client, Daemon, main, until
from with_state import WOODS, WithState


class RemoteBackup(WithState):
    def setUp(self):
        super().setUp()
        self.tar = self.folder / "scenes.tar"

    def daemon_of_an_admin(self, *arguments, under=()):
        """Starts a daemon, and returns a client on its Unix socket, whose own user is an admin."""
        self.sockets = getattr(self, "sockets", 0) + 1
        uri = f"unix:{self.folder}/socket-{self.sockets}"
        daemon = Daemon(self.raynestd, "--listen", uri, *arguments, under=under)
        self.addCleanup(daemon.folder.cleanup)
        self.addCleanup(daemon.process.wait)
        self.addCleanup(daemon.process.kill)
        self.user = Client(self.raynest, daemon.uri)
        return daemon, Client(self.raynest, uri)

    def start(self, *arguments, under=()):
        self.daemon, self.client = self.daemon_of_an_admin("--state", self.state, *arguments, under=under)
        return self.client

    def load(self, *names):
        for name in names:
            self.run_ok("load", f"{WOODS}&seed={ord(name)}", "--name", name)

    def run_ok(self, *words, client=None):
        done = (client or self.client).run(*words)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def identities(self, client=None):
        return {name: (scene["hash"], scene["epoch"]) for name, scene in self.scenes(client).items()}

    def another(self):
        """A client of a second daemon, whose state folder is empty at first."""
        return self.daemon_of_an_admin("--state", self.folder / "other")[1]

    def repacked(self, change):
        """A copy of the backup whose members `change` has gone through: (name, bytes) -> the same, or None."""
        copy = self.folder / "changed.tar"
        with tarfile.open(self.tar) as source, tarfile.open(copy, "w") as target:
            for member in source:
                changed = change(member.name, source.extractfile(member).read())
                if changed is None:
                    continue
                member.name, data = changed
                member.size = len(data)
                target.addfile(member, io.BytesIO(data))
        return copy

    def test_all_comes_back_on_another_machine(self):
        self.start()
        self.load("a", "b", "c")
        self.run_ok("edit", "b", "--move", "birch-1=0,0,3", "--keep")
        self.run_ok("edit", "b", "--move", "oak-2=0,1,0", "--keep")
        told, hits = self.identities(), {name: self.hits(name) for name in "abc"}
        self.assertIn("scenes.tar", self.run_ok("backup", self.tar))
        self.assertEqual(self.tar.stat().st_mode & 0o077, 0)
        other = self.another()
        self.assertEqual(self.run_ok("restore", self.tar, client=other).count(" is back"), 3)
        self.assertEqual(self.identities(other), told)
        for name in "abc":
            self.assertEqual(self.hits(name, other), hits[name])
        # Its kept edits are followed by others.
        self.assertGreater(other.json("edit", "b", "--move", "birch-1=0,0,1", "--keep")["epoch"], told["b"][1])

    def test_it_comes_back_for_good(self):
        self.start()
        self.load("a")
        self.run_ok("edit", "a", "--move", "birch-1=0,0,3", "--keep")
        self.run_ok("backup", self.tar)
        hits, told = self.hits("a"), self.identities()
        self.run_ok("unload", "a")
        self.assertEqual(self.identities(), {})
        self.run_ok("restore", self.tar)
        self.again()
        self.assertEqual(self.identities(), told)
        self.assertEqual(self.hits("a"), hits)
        self.kill()
        self.assertEqual(self.check()[0], 0)

    def test_names_in_use_stay_and_some_can_be_named(self):
        self.start()
        self.load("a", "b", "c")
        self.run_ok("backup", self.tar)
        owner = self.client.json("scenes")["scenes"][0]["owner"]
        told = self.identities()
        self.run_ok("load", f"{WOODS}&seed=7", "--name", "a", "--replace")
        changed = self.identities()["a"]
        self.run_ok("unload", "b")
        self.run_ok("unload", "c")
        report = self.client.json("restore", self.tar, f"{owner}/a", f"{owner}/b")
        self.assertEqual(report, {"restored": [f"{owner}/b"], "mended": [], "kept": [f"{owner}/a"], "missing": []})
        self.assertEqual(self.identities(), {"a": changed, "b": told["b"]})
        done = self.client.run("restore", self.tar, f"{owner}/nobody")
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn(f"no scene '{owner}/nobody'", done.stderr)
        self.assertNotIn("c", self.identities())

    def test_a_damaged_scene_is_mended(self):
        self.start()
        self.load("a", "b")
        self.run_ok("edit", "a", "--move", "birch-1=0,0,3", "--keep")
        hits = self.hits("a")
        self.run_ok("backup", self.tar)
        self.kill()
        self.damage(self.blob_of(self.scenes_on_disk()["a"]))
        self.start()
        self.assertEqual(self.client.run("query", "a", "--ray", "0,0,9,0,0,-1").returncode, 5)
        self.assertEqual(self.scenes()["a"]["state"], "damaged")
        report = self.client.json("restore", self.tar)
        self.assertEqual([name.split("/")[-1] for name in report["mended"]], ["a"])
        self.assertEqual([name.split("/")[-1] for name in report["kept"]], ["b"])
        self.assertEqual(self.hits("a"), hits)
        # The damaged bytes are kept for a look.
        self.assertEqual(len(list((self.state / "damaged").iterdir())), 1)
        self.assertIn("removed", self.run_ok("gc"))
        self.assertEqual(list((self.state / "damaged").iterdir()), [])
        self.assertIn("nothing to remove", self.run_ok("gc"))
        self.assertEqual(self.hits("a"), hits)

    def test_a_load_of_the_same_content_mends_a_damaged_scene(self):
        self.start()
        self.load("a")
        self.run_ok("backup", self.tar)
        self.run_ok("edit", "a", "--move", "birch-1=0,0,3", "--keep")
        hits, told = self.hits("a"), self.identities()["a"]
        blob = self.blob_of(self.scenes_on_disk()["a"])
        self.kill()
        (self.blobs / blob).unlink()
        self.start()
        self.assertEqual(self.client.run("query", "a", "--ray", "0,0,9,0,0,-1").returncode, 5)
        self.run_ok("load", f"{WOODS}&seed={ord('a')}", "--name", "other")
        # The edit since the backup is there, and the restore, which has not that one, takes nothing away.
        self.assertEqual(self.hits("a"), hits)
        self.assertEqual(len(self.client.json("restore", self.tar)["kept"]), 1)
        self.assertEqual(self.identities()["a"], told)

    def test_rows_that_no_load_makes_do_not_come_back(self):
        """Lists of scenes could not be read with them, and they could not be unloaded."""
        def checksum(text):
            value = 0xcbf29ce484222325
            for byte in text.encode():
                value = (value ^ byte) * 0x100000001b3 % 2**64
            return value - 2**64 if value >> 63 else value

        def renamed(name, data):
            if "manifest" not in name:
                return name, data
            file = self.folder / "changed.sqlite"
            file.write_bytes(data)
            columns = "number, owner, name, share, digest, epoch, bytes, triangles, build_seconds, used, content"
            with contextlib.closing(sqlite3.connect(file)) as manifest:
                (row,) = manifest.execute(f"SELECT {columns} FROM scenes")
                for number, (owner, scene) in enumerate((("x" * 4000, "y"), ("x", "y" * 4000), ("x", "b/c"))):
                    made = [row[0] + 1 + number, owner, scene, "public", *row[4:]]
                    text = "\n".join(str(value).removesuffix(".0") for value in made)
                    manifest.execute(f"INSERT INTO scenes ({columns}, checksum) VALUES ({', '.join('?' * 12)})",
                                     [*made, checksum(text)])
                manifest.commit()
                manifest.execute("VACUUM")
            return name, file.read_bytes()

        self.start()
        self.load("a")
        self.client.run("edit", "a", "--move", "birch-1=0,0,3", "--keep")
        self.run_ok("backup", self.tar)
        other = self.another()
        report = other.json("restore", self.repacked(renamed))
        self.assertEqual([len(report[key]) for key in ("restored", "missing")], [1, 3], report)
        self.assertEqual(set(self.scenes(other)), {"a"})

    def test_a_scene_whose_edit_is_damaged_is_that_of_the_backup(self):
        self.start()
        self.load("a")
        self.run_ok("edit", "a", "--move", "birch-1=0,0,3", "--keep")
        hits = self.hits("a")
        self.run_ok("backup", self.tar)
        self.run_ok("edit", "a", "--move", "birch-1=0,0,4", "--keep")
        told = self.identities()["a"]
        self.kill()
        with contextlib.closing(sqlite3.connect(self.state / "manifest.sqlite")) as manifest:
            manifest.execute("UPDATE edits SET change = zeroblob(length(change)) WHERE epoch = 3")
            manifest.commit()
        self.start()
        self.assertEqual(self.client.run("query", "a", "--ray", "0,0,9,0,0,-1").returncode, 5)
        self.assertEqual(len(self.client.json("restore", self.tar)["restored"]), 1)
        self.assertEqual(self.hits("a"), hits)
        # Epochs that were told before mean nothing else.
        now = self.identities()["a"]
        self.assertGreater(now[1], told[1])
        self.again()
        self.assertEqual(self.hits("a"), hits)
        self.assertEqual(self.identities()["a"], now)
        self.kill()
        self.assertEqual(self.check()[0], 0)

    def test_one_content_under_many_names(self):
        """More than come back in one commit."""
        names = [f"name-{number:03}" for number in range(140)]
        self.start()
        with raynest.connect(self.client.uri) as client:
            for name in names:
                client.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name=name)
        self.run_ok("backup", self.tar)
        other = self.another()
        self.assertEqual(len(other.json("restore", self.tar)["restored"]), len(names))
        self.assertEqual(sorted(self.scenes(other)), names)
        self.hits(names[-1], other)

    def test_a_stream_is_not_begun_anew(self):
        self.start()
        self.run_ok("load", "builtin:terrain?size=300", "--name", "t")
        self.run_ok("backup", self.tar)
        environment = {**os.environ, "RAYNEST_RECONNECT": str(PATIENCE)}
        backup = subprocess.Popen([self.raynest, "--server", self.client.uri, "backup", "-"], env=environment,
                                  stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.addCleanup(backup.kill)
        begin = backup.stdout.read(1 << 16)
        self.kill()
        again = Daemon(self.raynestd, "--listen", self.client.uri, "--state", self.state)
        self.addCleanup(again.folder.cleanup)
        self.addCleanup(again.process.wait)
        self.addCleanup(again.process.kill)
        rest, said = backup.communicate(timeout=PATIENCE)
        self.assertIn(backup.returncode, (1, 3), said)
        self.assertLess(len(begin) + len(rest), self.tar.stat().st_size)
        # Into a file it is.
        self.assertEqual(self.client.run("backup", self.folder / "second.tar").returncode, 0)

    def scenes_on_disk(self):
        """The content of each stored scene as its last load made it."""
        manifest = sqlite3.connect(f"file:{self.state}/manifest.sqlite?mode=ro", uri=True)
        with contextlib.closing(manifest):
            return dict(manifest.execute("SELECT name, content FROM scenes"))

    def test_a_damaged_scene_keeps_no_other_from_its_backup(self):
        self.start()
        self.load("a", "b")
        (self.blobs / self.blob_of(self.scenes()["a"]["hash"])).unlink()
        done = self.client.run("backup", self.tar)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("/a is damaged", done.stderr)
        report = self.another().json("restore", self.tar)
        self.assertEqual([name.split("/")[-1] for name in report["restored"]], ["b"])
        self.assertEqual([name.split("/")[-1] for name in report["missing"]], ["a"])

    def test_what_tar_unpacks_is_a_state_folder(self):
        self.start()
        self.load("a", "b")
        told = self.identities()
        self.run_ok("backup", self.tar)
        subprocess.run(["tar", "xf", self.tar], cwd=self.folder, check=True, timeout=PATIENCE)
        self.kill()
        done = subprocess.run([self.raynestd, "restore", self.folder / "raynest-state", self.state],
                              capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.start()
        self.assertEqual(self.identities(), told)
        # And back: what tar packs is a backup.
        subprocess.run(["tar", "cf", self.folder / "again.tar", "raynest-state"], cwd=self.folder, check=True,
                       timeout=PATIENCE)
        other = self.another()
        self.run_ok("restore", self.folder / "again.tar", client=other)
        self.assertEqual(self.identities(other), told)

    def test_backups_beside_loads_and_edits_are_of_one_moment(self):
        self.start()
        self.load("e")
        done, seen = threading.Event(), [(self.scenes()["e"]["hash"], 1)]

        def edit():
            while not done.is_set():
                answer = self.client.json("edit", "e", "--move", "birch-1=0,0,0.1", "--keep")
                seen.append((answer["hash"], answer["epoch"]))

        def load():
            number = 0
            while not done.is_set():
                number += 1
                self.client.run("load", f"{WOODS}&seed={number}", "--name", "replaced", "--replace")

        threads = [threading.Thread(target=work) for work in (edit, load)]
        for thread in threads:
            thread.start()
        try:
            for number in range(4):
                self.run_ok("backup", self.folder / f"{number}.tar")
        finally:
            done.set()
            for thread in threads:
                thread.join()
        other, epochs = self.another(), []
        for number in range(4):
            self.run_ok("restore", self.folder / f"{number}.tar", client=other)
            scene = self.identities(other)["e"]
            self.assertIn(scene, seen)
            self.hits("e", other)
            epochs.append(scene[1])
            for name in self.identities(other):
                self.run_ok("unload", name, client=other)
        self.assertEqual(epochs, sorted(epochs))

    def test_what_is_no_backup_changes_nothing(self):
        self.start()
        self.load("a")
        self.run_ok("backup", self.tar)
        self.run_ok("unload", "a")
        whole = self.tar.read_bytes()
        files = self.blob_names()

        written = self.folder / "wrong.tar"
        for why, wrong in (("no tar", b"x" * 4096), ("zeros", bytes(4096)), ("cut", whole[:len(whole) // 2]),
                           ("no end", whole[:512 * 3]), ("a damaged head", whole[:100] + b"9" + whole[101:]),
                           ("foreign", self.repacked(lambda name, data: ("etc/passwd", data)).read_bytes()),
                           ("no manifest", self.repacked(lambda name, data: None if "manifest" in name else
                                                         (name, data)).read_bytes())):
            written.write_bytes(wrong)
            done = self.client.run("restore", written)
            self.assertEqual(done.returncode, 5, (why, done.stderr))
            self.assertIn("no backup", done.stderr, why)
            self.assertEqual(done.stderr.count("\n"), 1, (why, done.stderr))
        # A manifest that is damaged, or of something else.
        for change in (lambda data: b"x" * len(data), lambda data: data[:-5000] + bytes(5000)):
            file = self.repacked(lambda name, data, change=change: (name, change(data) if "manifest" in name else data))
            done = self.client.run("restore", file)
            self.assertEqual(done.returncode, 5, done.stderr)
            self.assertIn("the manifest of the backup is damaged", done.stderr)
        self.assertEqual(self.identities(), {})
        until(lambda: self.blob_names() == files)
        # A blob of other bytes than its name says does not come back.
        flipped = self.repacked(lambda name, data: (
            name, data[:9999] + bytes([data[9999] ^ 1]) + data[10000:] if "blobs" in name else data))
        report = self.client.json("restore", flipped)
        self.assertEqual([len(report[key]) for key in ("restored", "mended", "kept", "missing")], [0, 0, 0, 1])
        until(lambda: self.blob_names() == files)
        self.assertEqual(len(self.client.json("restore", self.tar)["restored"]), 1)
        self.hits("a")

    def test_a_restore_that_ends_half_way_leaves_nothing(self):
        self.start()
        self.load("a", "b")
        self.run_ok("backup", self.tar)
        for name in "ab":
            self.run_ok("unload", name)
        done = subprocess.Popen([self.raynest, "--server", self.client.uri, "restore", self.tar],
                                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        done.send_signal(signal.SIGKILL)
        done.wait(PATIENCE)
        # Whole or not at all: the daemon may have had all of it.
        self.client.run("scenes")
        for name in list(self.identities()):
            self.run_ok("unload", name)
        self.run_ok("load", "builtin:flake", "--name", "f")
        self.run_ok("unload", "f")
        until(lambda: self.blob_names() == set())
        # A daemon that is killed meanwhile starts again with all or nothing.
        self.run_ok("restore", self.tar)
        self.again()
        self.assertEqual(set(self.identities()), {"a", "b"})

    def test_users_and_daemons_without_scenes_are_told(self):
        self.start()
        self.load("a")
        for words in (("backup", self.tar), ("gc",), ("restore", self.rays)):
            done = self.user.run(*words)
            self.assertEqual(done.returncode, 4, done.stderr)
            self.assertIn("needs the role admin", done.stderr)
        self.assertFalse(self.tar.exists())
        client = self.daemon_of_an_admin()[1]
        for words in (("backup", self.tar), ("gc",)):
            done = client.run(*words)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn("--state", done.stderr)
        self.run_ok("backup", self.tar)
        done = client.run("restore", self.tar)
        self.assertIn("--state", done.stderr)
        done = self.client.run("restore", self.folder)
        self.assertEqual(done.returncode, 5)
        self.assertIn("is no file", done.stderr)
        before = self.tar.read_bytes()
        os.truncate(self.tar, 0)
        self.assertIn("empty", self.client.run("restore", self.tar).stderr)
        self.tar.write_bytes(before)


if __name__ == "__main__":
    main()
