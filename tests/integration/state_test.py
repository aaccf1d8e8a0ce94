#!/usr/bin/env python3
"""Scenes outlive the daemon with --state: kills, full disks, damaged files, and memory that is too small.

  state_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import sqlite3
import subprocess
import sys
import time

import numpy

from daemon import IMPORTS_GROW, LONG, PATIENCE, Client, Daemon, main, second_principal, skip_sanitized, until
from with_state import WOODS, WithState

ROUNDS = 200 if LONG else 12
# A commit reaches its file with the second one after it: until then it is the process's alone, and is answered.
LATE_COMMIT = r"""
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
typedef ssize_t (*Write)(int, const void*, size_t, off64_t);
typedef ssize_t (*Read)(int, void*, size_t, off64_t);
static struct Held { int file, commit; off64_t at; size_t size; void* bytes; } held[4096];
static int count, commit;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static int is_log(int file) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    const ssize_t length = readlink(link, path, sizeof path - 1);
    path[length < 0 ? 0 : length] = 0;
    return strstr(path, "/manifest.sqlite-wal") != NULL;
}
static void write_before(int end) {
    int left = 0;
    for (int i = 0; i < count; ++i)
        if (held[i].commit >= end) held[left++] = held[i];
        else {
            ((Write)dlsym(RTLD_NEXT, "pwrite64"))(held[i].file, held[i].bytes, held[i].size, held[i].at);
            free(held[i].bytes);
        }
    count = left;
}
ssize_t pwrite64(int file, const void* bytes, size_t size, off64_t at) {
    if (!is_log(file)) return ((Write)dlsym(RTLD_NEXT, "pwrite64"))(file, bytes, size, at);
    pthread_mutex_lock(&mutex);
    if (count == 4096) abort();
    held[count++] = (struct Held){file, commit, at, size, memcpy(malloc(size), bytes, size)};
    pthread_mutex_unlock(&mutex);
    return size;
}
ssize_t pread64(int file, void* bytes, size_t size, off64_t at) {
    if (is_log(file)) {
        pthread_mutex_lock(&mutex);
        write_before(commit + 1);
        pthread_mutex_unlock(&mutex);
    }
    return ((Read)dlsym(RTLD_NEXT, "pread64"))(file, bytes, size, at);
}
int fdatasync(int file) {
    if (is_log(file)) {
        pthread_mutex_lock(&mutex);
        write_before(commit++ - 1);
        pthread_mutex_unlock(&mutex);
    }
    return ((int (*)(int))dlsym(RTLD_NEXT, "fdatasync"))(file);
}
"""


class State(WithState):
    def test_scenes_are_there_after_a_kill_with_owners_shares_and_equal_hits(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        client = self.start(*options)
        client.json("load", WOODS, "--name", "woods", "--share", "public")
        client.json("load", "builtin:flake?depth=3", "--name", "mine")
        client.json("load", "builtin:flake?depth=2", "--name", "ours", "--share", "bob,CN=robot\\,O=Lab")
        client.json("load", WOODS + "&seed=3", "--name", "woods", "--replace")
        before = self.scenes()
        self.assertEqual({scene["state"] for scene in before.values()}, {"memory"})
        hits = {name: self.hits(name) for name in before}
        client = self.again(*options)
        after = self.scenes()
        self.assertEqual({scene["state"] for scene in after.values()}, {"disk"})
        for row in [*before.values(), *after.values()]:
            for name in ("age_seconds", "idle_seconds", "holders", "state"):
                del row[name]
        self.assertEqual(after, before)
        bob = Client(self.raynest, self.daemon.uri, token)
        owner = before["woods"]["owner"]
        self.assertEqual(set(self.scenes(bob)), {f"{owner}/woods", f"{owner}/ours"})
        self.assertEqual(bob.run("info", f"{owner}/mine").returncode, 5)
        self.assertEqual(self.hits("ours", bob), hits["ours"])
        for name in before:
            self.assertEqual(self.hits(name), hits[name], name)
        self.assertEqual({scene["state"] for scene in self.scenes().values()}, {"memory"})
        self.assertEqual(after["woods"]["epoch"], 2)

    def test_the_quota_of_the_disk_is_the_same_before_the_folder_is_made(self):
        self.assertFalse(self.state.exists())
        disk = os.statvfs(self.folder)
        for start in (self.start, self.again):
            self.assertEqual(start().json("stats")["quota_disk_bytes"], disk.f_frsize * disk.f_blocks // 2)

    def test_the_manifest_is_for_the_daemons_user_alone(self):
        self.state.mkdir(mode=0o755)
        for start in (self.start, self.again):
            start().json("load", WOODS, "--name", "woods", "--replace")
            for file in self.state.glob("manifest*"):
                self.assertEqual(file.stat().st_mode & 0o77, 0, file)
            (self.state / "manifest.sqlite").chmod(0o644)

    def test_many_requests_wait_for_one_read(self):
        self.start().json("load", WOODS, "--name", "woods")
        hits = self.hits("woods")
        self.again()
        running = [self.client.start("--quiet", "query", "woods", "--rays", self.rays, "-o", self.folder / f"{i}.npz")
                   for i in range(6)]
        for i, process in enumerate(running):
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 0, errors)
            with numpy.load(self.folder / f"{i}.npz") as columns:
                self.assertEqual({name: columns[name].tobytes() for name in columns}, hits)
        self.assertEqual(self.daemon.log().count("scene_read"), 1)

    def test_what_was_answered_survives_every_kill(self):
        self.start()
        self.assertEqual(self.strikes("kills", ROUNDS, self.kill, self.start), [])

    def test_a_daemon_that_answers_before_it_commits_is_caught(self):
        self.preload(LATE_COMMIT)
        self.start()
        lost = self.strikes("kills of one that commits late", 10, self.kill, self.start)
        self.assertTrue(lost)
        self.assertFalse([what for what in lost if "content" in what])

    def test_the_same_content_is_stored_once_and_removed_with_its_last_name(self):
        client = self.start()
        first = client.json("load", WOODS, "--name", "a")["hash"]
        client.json("load", WOODS, "--name", "b")
        both = [client.start("load", WOODS, "--name", "c") for _ in range(2)]  # at once
        for process in both:
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 0, errors)
        self.assertEqual(self.blob_names(), {self.blob_of(first)})
        client.json("unload", "a")
        client.json("unload", "c")
        self.assertEqual(self.blob_names(), {self.blob_of(first)})
        second = client.json("load", "builtin:flake?depth=2", "--name", "b", "--replace")["hash"]
        self.again()
        self.assertEqual({name: scene["hash"] for name, scene in self.scenes().items()}, {"b": second})
        self.assertEqual(self.blob_names(), {self.blob_of(second)})
        self.client.json("unload", "b")
        self.assertEqual(self.blob_names(), set())
        self.again()
        self.assertEqual(self.scenes(), {})

    def test_a_flipped_byte_costs_one_scene_until_it_is_loaded_again(self):
        client = self.start()
        digest = client.json("load", WOODS, "--name", "woods")["hash"]
        client.json("load", "builtin:flake?depth=2", "--name", "flake")
        cut = self.blob_of(client.json("load", "builtin:flake?depth=1", "--name", "cut")["hash"])
        woods = self.blob_of(digest)
        self.kill()
        self.assertEqual(self.check()[0], 0)
        self.damage(woods)
        os.truncate(self.blobs / cut, 4096)
        code, said = self.check()
        self.assertEqual((code, said.splitlines()[-1].split(", ")[-1]), (1, "2 damaged"))
        client = self.start()
        for _ in range(2):
            self.client.fails(5, "the stored copy of scene 'woods' is damaged", "info", "woods")
        self.client.fails(5, "has 4096 bytes", "info", "cut")
        self.hits("flake")
        self.assertEqual({name: scene["state"] for name, scene in self.scenes().items()},
                         {"woods": "damaged", "flake": "memory", "cut": "damaged"})
        self.assertIn("scene_damaged", self.daemon.log())
        self.assertEqual(client.json("stats")["scenes_damaged"], 2)
        self.assertEqual({file.name for file in (self.state / "damaged").iterdir()}, {woods, cut})
        client = self.again()
        self.client.fails(5, "is damaged", "info", "woods")
        self.client.fails(5, "its file is gone", "info", "cut")
        self.assertEqual(client.json("load", WOODS, "--name", "woods")["hash"], digest)
        # Another content needs no --replace there.
        client.json("load", "builtin:flake?depth=3", "--name", "cut")
        self.again()
        self.hits("woods")
        self.hits("cut")

    def test_a_scene_of_another_release_stays_where_it_is(self):
        client = self.start()
        digest = client.json("load", WOODS, "--name", "woods")["hash"]
        blob = self.blobs / self.blob_of(digest)
        self.kill()
        whole = blob.read_bytes()
        blob.write_bytes(whole[:8] + (1).to_bytes(4, "little") + whole[12:])
        self.start()
        self.client.fails(5, "has version 1, this build reads version", "info", "woods")
        self.assertEqual(os.listdir(self.blobs), [blob.name])
        self.kill()
        blob.write_bytes(whole)     # the other release again
        self.start()
        self.hits("woods")
        self.kill()
        blob.write_bytes(whole[:8] + (1).to_bytes(4, "little") + whole[12:])
        client = self.start()
        self.client.fails(5, "has version 1, this build reads version", "info", "woods")
        self.assertEqual(client.json("load", WOODS, "--name", "woods")["hash"], digest)
        self.again()
        self.hits("woods")

    def test_a_damaged_manifest_refuses_to_start_and_nothing_is_deleted(self):
        self.start().json("load", WOODS, "--name", "woods")
        self.daemon.stop()
        manifest = self.state / "manifest.sqlite"
        good = manifest.read_bytes()
        changes = [good[:0] + b"x" * 100 + good[100:], good.replace(b"woods", b"weeds"), good[:5000],
                   b"", b"no database" * 99]
        if good.count(b"woods") == 0:
            self.fail("the name is not in the file")
        for bad in changes:
            manifest.write_bytes(bad)
            files = self.files()
            said = self.refused()
            self.assertIn("damaged", said)
            self.assertIn("nothing was changed", said)
            self.assertEqual(self.files(), files)
        manifest.write_bytes(good)
        with sqlite3.connect(manifest) as database:
            database.execute("PRAGMA user_version=99")
        database.close()
        files = self.files()
        self.assertIn("a newer one wrote it", self.refused())
        self.assertEqual(set(self.files()), set(files))
        manifest.write_bytes(good)
        self.start()
        self.hits("woods")
        self.assertIn("another daemon uses", self.refused())

    def test_a_full_disk_fails_the_load_and_leaves_the_rest(self):
        if os.geteuid() != 0:
            self.skipTest("needs root, for a small tmpfs")
        self.state.mkdir()
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m,mode=700", "none", self.state], capture_output=True)
        if mounted.returncode != 0:
            self.skipTest("cannot mount a tmpfs")
        self.addCleanup(subprocess.run, ["umount", "-l", self.state])
        client = self.start("--principal-disk-bytes-max", "1G")
        self.addCleanup(self.kill)
        small = client.json("load", "builtin:flake?depth=2", "--name", "small")["hash"]
        self.client.fails(6, "has no room for the scene", "load", "builtin:forest?trees=300", "--name", "big")
        self.assertEqual(self.blob_names(), {self.blob_of(small)})
        self.assertEqual(set(self.scenes()), {"small"})
        # The blob fits, the row does not.
        free = os.statvfs(self.state)
        (self.state / "filler").write_bytes(b"x" * (free.f_bavail * free.f_bsize))
        for number in range(40):
            done = client.run("load", "builtin:flake?depth=2", "--name", f"same{number}")
            if done.returncode != 0:
                break
        else:
            self.fail("the disk is not full")
        self.assertEqual(done.returncode, 6, done.stderr)
        self.assertIn("state folder", done.stderr)
        names = set(self.scenes())
        self.assertNotIn(f"same{number}", names)
        self.kill()
        (self.state / "filler").unlink()
        self.start()
        self.assertEqual(set(self.scenes()), names)
        self.hits("small")
        self.client.json("load", "builtin:flake?depth=3", "--name", "more")

    def test_a_scene_that_is_unloaded_stays_for_those_who_hold_it_and_no_other_is_touched(self):
        skip_sanitized(self, self.raynestd, IMPORTS_GROW)
        script = """
import sys, numpy, raynest
uri, rays, asleep = sys.argv[1], numpy.load(sys.argv[2]), sys.argv[3] == "True"
with raynest.connect(uri) as owner, raynest.connect(uri) as other:
    def fill(first):
        return [owner.load(f"builtin:forest?trees=200&seed={first + i}", f"f{first + i}") for i in range(14)]
    mine = owner.load("builtin:forest?trees=200&seed=99", "held")
    held = other.scene("held")
    before = held.trace(rays)["t"]
    if asleep:
        fill(0)
    mine.unload()
    fill(20)
    assert (held.trace(rays)["t"] == before).all()
    fill(40)
    assert (held.trace(rays)["t"] == before).all()
"""
        package = pathlib.Path(__file__).parents[2] / "client" / "python"
        for asleep in (False, True):
            client = self.start("--memory", "128M", "--principal-scene-bytes-max", "1G")
            done = subprocess.run([sys.executable, "-c", script, self.daemon.uri, self.rays, str(asleep)],
                                  capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(package)},
                                  timeout=4 * PATIENCE)
            self.assertEqual(done.returncode, 0, done.stderr)
            until(lambda: client.json("stats")["quota_disk_bytes_used"] ==
                  sum(file.stat().st_size for file in self.blobs.iterdir()))
            self.assertEqual(set(self.scenes()), {f"f{first + i}" for first in ((0, 20, 40) if asleep else (20, 40))
                                                  for i in range(14)})
            self.assertEqual(list((self.state / "damaged").iterdir()), [])
            self.kill()
            self.assertEqual(self.check()[0], 0)

    def test_a_load_writes_a_damaged_blob_anew(self):
        client = self.start()
        client.json("load", WOODS, "--name", "woods")
        digest, = self.blob_names()
        self.damage(digest)
        client.json("load", WOODS, "--name", "woods", "--replace")
        self.kill()
        self.assertEqual(self.check()[0], 0)

    def test_loads_among_edits_keep_epochs_and_their_edits(self):
        """A load takes its epoch before its row is committed; edits must not take it meanwhile."""
        client = self.start()
        client.json("load", WOODS, "--name", "woods")
        told = set()
        for number in range(6):
            with self.edits("woods", True, 100_000) as edits:
                edits.stdout.readline()
                loaded = client.json("load", f"{WOODS}&seed={number}", "--name", "woods", "--replace")
                epoch, digest = edits.stdout.readline().split()  # an edit's behind it, or under way
                edits.kill()
                told |= {(int(epoch), digest), (loaded["epoch"], loaded["hash"])}
                said = [line.split() for line in edits.stdout.read().splitlines() if line.count(" ") == 1 and len(line) > 60]
                told |= {(int(epoch), digest) for epoch, digest in said}
            client.json("edit", "woods", "--move", "inst=0=0,1,0", "--keep")
            now = client.json("info", "woods")
            client = self.again()
            after = client.json("info", "woods")
            self.assertEqual((after["epoch"], after["hash"]), (now["epoch"], now["hash"]))
            told.add((now["epoch"], now["hash"]))
        self.assertEqual(len({epoch for epoch, _ in told}), len(told), "an epoch was told of two contents")
        self.kill()
        self.assertEqual(self.check()[0], 0)

    def test_what_is_kept_and_what_is_not(self):
        client = self.start()
        loaded = client.json("load", WOODS, "--name", "woods")
        car = client.json("load", "builtin:flake?depth=2", "--name", "car")
        self.assertTrue(client.json("info", "woods")["kept"])
        first = client.json("edit", "woods", "--move", "inst=0=3,0,0", "--keep")
        self.assertEqual((first["kept"], first["epoch"]), (True, 2))
        # An edit that is not kept: after a restart the scene is what the kept one made of it.
        loose = client.json("edit", "woods", "--hide", "*")
        self.assertFalse(loose["kept"])
        self.assertFalse(client.json("info", "woods")["kept"])
        client = self.again()
        self.assertEqual({name: scene["hash"] for name, scene in self.scenes().items()},
                         {"woods": first["hash"], "car": car["hash"]})
        self.assertEqual(client.json("info", "woods")["epoch"], 2)
        # Its epoch is not told again for other content.
        second = client.json("edit", "woods", "--move", "inst=1=3,0,0")
        self.assertGreater(second["epoch"], loose["epoch"])
        # A kept edit after one that is not keeps both; so does one that adds a scene.
        third = client.json("edit", "woods", "--add", "car=9,0,0", "--keep")
        client.json("unload", "car")
        hits = self.hits("woods")
        client = self.again()
        self.assertEqual(client.json("info", "woods")["hash"], third["hash"])
        self.assertEqual(self.hits("woods"), hits)
        self.assertEqual(self.blob_names(), {self.blob_of(third["hash"])})
        fourth = client.json("edit", "woods", "--remove", "car", "--keep")
        # A load takes the place of all that; its edits are gone with it.
        client = self.again()
        self.assertEqual(client.json("load", WOODS, "--name", "woods", "--replace")["hash"], loaded["hash"])
        self.assertGreater(client.json("info", "woods")["epoch"], fourth["epoch"])
        client = self.again()
        self.assertEqual(client.json("info", "woods")["hash"], loaded["hash"])
        client.json("unload", "woods")
        client = self.again()
        self.assertEqual(self.scenes(), {})

    def test_a_damaged_edit_costs_one_scene_until_it_is_loaded_again(self):
        client = self.start()
        client.json("load", WOODS, "--name", "woods")
        client.json("load", WOODS, "--name", "other")
        client.json("edit", "woods", "--hide", "*", "--keep")
        hits = self.hits("other")
        self.daemon.stop()
        with sqlite3.connect(self.state / "manifest.sqlite") as database:
            change = bytearray(database.execute("SELECT change FROM edits WHERE length(change)>0").fetchone()[0])
            change[-1] ^= 1
            database.execute("UPDATE edits SET change=? WHERE length(change)>0", (bytes(change),))
        database.close()
        self.assertEqual(self.check()[0], 1)
        client = self.start()
        self.client.fails(5, "its edit of epoch 2 is not as it was written", "info", "woods")
        self.assertEqual(self.hits("other"), hits)
        client.json("load", WOODS, "--name", "woods")
        self.again()
        self.assertEqual(self.hits("woods"), hits)

    def test_without_a_state_folder_nothing_is_kept(self):
        daemon = Daemon(self.raynestd)
        self.addCleanup(daemon.stop)
        self.client = Client(self.raynest, daemon.uri)
        self.client.json("load", WOODS, "--name", "woods")
        self.client.fails(2, "--state", "edit", "woods", "--hide", "*", "--keep")

    def test_an_edit_lasts_until_the_restart(self):
        client = self.start()
        client.json("load", WOODS, "--name", "woods")
        loaded = self.hits("woods")
        client.json("edit", "woods", "--hide", "*")
        self.assertNotEqual(self.hits("woods"), loaded)
        self.again()
        self.assertEqual(self.hits("woods"), loaded)

    def test_kept_edits_that_nobody_waits_for_are_stopped(self):
        def seconds():
            """CPU time of the daemon."""
            fields = pathlib.Path(f"/proc/{self.daemon.process.pid}/stat").read_text().rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

        def rested():
            before = seconds()
            time.sleep(1)
            return seconds() - before < 0.05

        (self.folder / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        numpy.save(self.folder / "places.npy", numpy.random.default_rng(2).uniform(-500, 500, (50000, 3)))
        # Long texts of many instances, two of each, which a glob in their middle has to look at.
        objects = {"one": {"file": "one.obj"}, "of0": {"instances": [{"object": "one", "name": "a"}, {"object": "one", "name": "b"}]}}
        for level in range(1, 17):
            objects[f"of{level}"] = {"instances": [{"object": f"of{level - 1}", "name": "n" * 240}]}
        (self.folder / "names.rnscene.json").write_text(json.dumps(
            {"rnscene": 1, "objects": objects, "instances": [{"object": "of16", "name": "x", "matrices": "places.npy"}]}))
        client = self.start()
        client.json("load", self.folder / "names.rnscene.json", "--name", "names")
        for i in range(8):
            client.json("edit", "names", "--move", f"x#1*{i}=0,0,0.001", "--keep")
        client = self.again()
        until(rested)
        begun = seconds()
        waiting = client.start("query", "names", "--generate", "camera", "size=2x2", "--fields", "t")
        until(lambda: seconds() > begun + 0.1)
        waiting.kill()
        waiting.communicate()
        killed = seconds()
        until(rested)
        after = seconds() - killed
        whole = seconds()
        client.run("query", "names", "--generate", "camera", "size=2x2", "--fields", "t")
        whole = seconds() - whole
        self.assertLess(after, whole / 2)

    def test_a_load_at_the_start_takes_the_place_of_what_it_stored_before(self):
        def flake(other=None):
            found = [scene["hash"] for name, scene in self.scenes().items() if name.endswith("flake")]
            return found and found[0] != other and found[0]

        self.start("--load", "builtin:flake?depth=2")
        first = until(flake)
        self.again("--load", "builtin:flake?depth=3")
        until(lambda: flake(first))
        self.assertNotIn("load_failed", self.daemon.log())


if __name__ == "__main__":
    main()
