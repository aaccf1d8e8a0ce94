#!/usr/bin/env python3
"""Disks that lose their power, fail, or change bytes cost nothing that was answered: --state on file systems of this
test's own.

  disk_test.py RAYNESTD RAYNEST

FS_IOC_GOINGDOWN ends a mounted file system at once, and loses what was not flushed. It tears and reorders no blocks.
Mounts need root.
"""
import fcntl
import json
import os
import pathlib
import random
import re
import shutil
import struct
import subprocess
import sys
import time

import numpy

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "client" / "python"))
import raynest  # noqa: E402
from daemon import LONG, PATIENCE, Client, Daemon, is_sanitized, main  # noqa: E402
from fuse import STATFS, Fuse  # noqa: E402
from metrics_test import scrape  # noqa: E402
from with_state import WOODS, WithState  # noqa: E402

GOINGDOWN = 0x8004587D  # _IOR('X', 125, __u32)
WITHOUT_LOG_FLUSH = struct.pack("I", 2)
ROUNDS = 50 if LONG else 4
# fsync() and fdatasync() that do nothing for files whose path holds NO_FLUSH.
NO_FLUSH = r"""
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
static int flush(const char* name, int file) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    const ssize_t length = readlink(link, path, sizeof path - 1);
    path[length < 0 ? 0 : length] = 0;
    if (strstr(path, getenv("NO_FLUSH"))) return 0;
    return ((int (*)(int))dlsym(RTLD_NEXT, name))(file);
}
int fsync(int file) { return flush("fsync", file); }
int fdatasync(int file) { return flush("fdatasync", file); }
"""


class Disk(WithState):
    def setUp(self):
        super().setUp()
        self.disk = self.folder / "disk"
        self.disk.mkdir()
        self.state = self.disk / "state"
        self.blobs = self.state / "blobs"
        self.chance = random.Random(int(os.environ.get("RAYNEST_SEED", time.time())))

    def make_disk(self, kind, image=None):
        if os.geteuid() != 0:
            self.skipTest("needs root, for loop mounts")
        image = image or self.folder / "image"
        if not shutil.which(f"mkfs.{kind}"):
            self.skipTest(f"no mkfs.{kind}; apt install {'e2fsprogs' if kind == 'ext4' else 'xfsprogs'}")
        with open(image, "wb") as file:
            file.truncate(400 << 20)
        subprocess.run([f"mkfs.{kind}", "-q", image], check=True, capture_output=True)
        self.image = image
        self.addCleanup(subprocess.run, ["umount", "-l", self.disk], capture_output=True)
        if self.mount() != 0:
            self.skipTest("cannot mount a file system of its own")

    def mount(self):
        return subprocess.run(["mount", "-o", "loop", self.image, self.disk], capture_output=True).returncode

    def lose_power(self):
        """The disk first, then the daemon: it may answer in between, and what it answers then counts, too."""
        folder = os.open(self.disk, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.ioctl(folder, GOINGDOWN, WITHOUT_LOG_FLUSH)
        finally:
            os.close(folder)
        self.kill()

    def mount_again(self):
        subprocess.run(["umount", self.disk], check=True)
        self.assertEqual(self.mount(), 0)

    def restart(self):
        self.mount_again()
        return self.start()

    def loses_nothing(self, kind):
        self.make_disk(kind)
        self.start()
        self.assertEqual(self.strikes(f"losses of power on {kind}", ROUNDS, self.lose_power, self.restart), [])

    def test_what_was_answered_survives_losses_of_power_on_ext4(self):
        self.loses_nothing("ext4")

    def test_what_was_answered_survives_losses_of_power_on_xfs(self):
        self.loses_nothing("xfs")

    def test_a_daemon_that_does_not_flush_is_caught(self):
        """The losses above are real ones: what is not flushed is gone, blob or row."""
        self.make_disk("ext4")
        self.start().json("load", WOODS, "--name", "first")
        self.daemon.stop()
        os.sync()
        self.preload(NO_FLUSH, NO_FLUSH="nothing")
        lost = {}
        for what in ("/blobs/", "/manifest.sqlite", "/manifest.sqlite-wal"):  # the last: synchronous=NORMAL
            os.environ["NO_FLUSH"] = what
            self.start().json("load", "builtin:flake?depth=2", "--name", "second", "--replace")
            self.lose_power()
            self.mount_again()
            os.environ["NO_FLUSH"] = "nothing"
            self.start().json("info", "first")
            row = self.scenes().get("second")
            lost[what] = row and self.client.run("info", "second").returncode != 0
            if row:
                self.client.json("load", "builtin:flake?depth=2", "--name", "second", "--replace")
                self.client.json("unload", "second")
            self.daemon.stop()
        self.assertEqual(lost, {"/blobs/": True, "/manifest.sqlite": None, "/manifest.sqlite-wal": None})

    def test_a_disk_that_fails_is_written_no_more(self):
        """The file system lies in a small tmpfs: it believes that it has room, and its disk then fails."""
        backing = self.folder / "backing"
        backing.mkdir()
        if os.geteuid() != 0:
            self.skipTest("needs root, for a small tmpfs")
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=40m", "none", backing], capture_output=True).returncode:
            self.skipTest("cannot mount a tmpfs")
        self.addCleanup(subprocess.run, ["umount", "-l", backing], capture_output=True)
        self.make_disk("ext4", backing / "image")
        self.start("--principal-disk-bytes-max", "1G", "--http", "127.0.0.1:0")
        good = {}
        for number in range(40):
            done = self.client.run("--json", "load", f"builtin:forest?trees=300&seed={number}", "--name", f"s{number}")
            if done.returncode != 0:
                break
            good[f"s{number}"] = json.loads(done.stdout)["hash"]
        else:
            self.fail("the disk never fails")
        self.assertEqual(done.returncode, 6, done.stderr)
        self.assertIn("has failed (", done.stderr)
        # Nothing is written after that: a second flush would succeed without the bytes.
        self.client.fails(6, "has failed: ", "load", "builtin:flake?depth=1", "--name", "later")
        self.assertEqual(scrape(self.daemon.http)["raynest_state_failed"], 1)
        for name in good:
            self.hits(name)
        self.assertLessEqual(good.items(), {name: scene["hash"] for name, scene in self.scenes().items()}.items())
        self.kill()
        subprocess.run(["umount", self.disk], check=True)
        subprocess.run(["mount", "-o", "remount,size=400m", backing], check=True)
        self.assertEqual(self.mount(), 0)
        self.start()
        self.assertEqual({name: scene["hash"] for name, scene in self.scenes().items()}, good)
        for name in good:
            self.hits(name)
        self.client.json("load", "builtin:flake?depth=1", "--name", "later")

    def test_a_disk_that_is_read_only_refuses_the_start_and_stays_as_it_is(self):
        self.make_disk("ext4")
        self.start().json("load", WOODS, "--name", "woods")
        hits = self.hits("woods")
        self.daemon.stop()
        files = self.files()
        for mode in ("ro", "rw"):
            subprocess.run(["mount", "-o", f"remount,{mode}", self.disk], check=True)
            if mode == "ro":
                self.assertIn("Read-only", self.refused())
            self.assertEqual(self.files().items() & files.items(), files.items())
        self.start()
        self.assertEqual(self.hits("woods"), hits)

    def test_a_folder_of_fuse_is_refused_by_name(self):
        try:
            mounted = Fuse(self.disk)
        except OSError as error:
            self.skipTest(f"needs /dev/fuse and the right to mount: {error}")
        self.addCleanup(mounted.close)
        self.state = self.disk
        self.assertIn(f"{self.disk} is on FUSE, where scenes may be lost; give --state", self.refused())
        # It is the mount that was asked, and nothing but the lock was made there.
        self.assertIn(STATFS, mounted.asked)
        self.assertEqual(mounted.made, ["lock"])

    def test_blobs_without_permissions_fail_loads_alone(self):
        under = ()
        if os.geteuid() == 0:  # root may read and write everything, unless it lets go of that
            under = ("setpriv", "--bounding-set=-dac_override,-dac_read_search")
            if not shutil.which("setpriv") or subprocess.run([*under, "true"], capture_output=True).returncode != 0:
                self.skipTest("root, and setpriv cannot take its rights")
        client = self.start(under=under)
        for number, name in enumerate(("stored", "held")):
            client.json("load", f"{WOODS}&seed={number}", "--name", name)
        hits = {name: self.hits(name) for name in self.scenes()}
        client = self.again(under=under)
        self.hits("held")
        blobs = {name: content for name, content in self.files().items() if name.startswith("blobs/")}
        more = ("load", "builtin:flake?depth=2", "--name", "more")
        self.addCleanup(self.blobs.chmod, 0o700)
        self.blobs.chmod(0)
        for _ in range(2):
            self.client.fails(6, "could not be stored in the state folder: Permission denied; see to its disk", *more)
            self.client.fails(6, "the stored scene could not be read: Permission denied; try again", "info", "stored")
        # A scene in memory is served, and no scene counts as damaged.
        self.assertEqual(self.hits("held"), hits["held"])
        self.assertEqual({name: scene["state"] for name, scene in self.scenes().items()},
                         {"stored": "disk", "held": "memory"})
        self.blobs.chmod(0o700)
        self.assertEqual({name: self.hits(name) for name in self.scenes()}, hits)
        self.assertLessEqual(blobs.items(), self.files().items())
        self.assertEqual(len(self.blob_names()), 2)
        client.json(*more)
        self.again(under=under)
        self.assertEqual({name: self.hits(name) for name in hits}, hits)
        self.hits("more")

    def test_a_load_is_flushed_before_it_is_answered(self):
        """The blob, its name, its row, the answer: in this order."""
        if not shutil.which("strace") or is_sanitized(self.raynestd):
            self.skipTest("needs strace, and no sanitizer")
        trace = self.folder / "trace"
        self.daemon = Daemon(self.raynestd, "--state", self.state, under=(
            "strace", "-f", "-y", "-qq", "-o", trace, "-e", "trace=fsync,fdatasync,rename,sendmsg,sendto,write,writev"))
        self.addCleanup(self.daemon.folder.cleanup)
        Client(self.raynest, self.daemon.uri).json("load", WOODS, "--name", "woods")
        subprocess.run(["pkill", "-TERM", "-P", str(self.daemon.process.pid)], check=True)  # strace itself takes none
        self.daemon.process.wait(timeout=PATIENCE)
        steps = (("blob", r"fsync\(\d+<[^>]*/blobs/\.new-"), ("name", r"rename\(.*/blobs/\.new-"),
                 ("folder", r"fsync\(\d+<[^>]*/blobs>"), ("row", r"f(data)?sync\(\d+<[^>]*/manifest\.sqlite-wal>"),
                 ("answer", r"(send|write)\w*\(\d+<(socket|TCP).*"))
        text = trace.read_text(errors="replace")
        at = text.index("/blobs/.new-")
        for name, pattern in steps:
            found = re.compile(pattern).search(text, at)
            self.assertTrue(found, name)
            at = found.end()

    def test_flipped_bytes_cost_their_own_scenes(self):
        count = 500 if LONG else 10
        names = [f"s{number}" for number in range(2 * count)]
        damaged = set(names[::2])
        self.start("--principal-scenes-max", "2000")
        with raynest.connect(self.daemon.uri) as client:
            for name in names:
                corners = numpy.random.default_rng(int(name[1:])).uniform(-5, 5, (300, 3)).astype(numpy.float32)
                client.mesh(corners, numpy.arange(300).reshape(-1, 3), name=name)
        blobs = {name: self.blob_of(scene["hash"]) for name, scene in self.scenes().items()}
        self.assertEqual(len(set(blobs.values())), len(names))
        self.kill()
        for name in damaged:
            size = (self.blobs / blobs[name]).stat().st_size
            self.damage(blobs[name], self.chance.randrange(size))
        self.start()
        self.assertEqual(set(self.scenes()), set(names))
        refused = set()
        with raynest.connect(self.daemon.uri) as client:
            for name in names:
                try:
                    client.scene(name)
                except raynest.errors.Error as error:
                    self.assertIn(f"the stored copy of scene '{name}' is damaged", str(error))
                    refused.add(name)
        marked = {name for name, scene in self.scenes().items() if scene["state"] == "damaged"}
        print(f"{count} of {2 * count} blobs with a flipped bit: {len(marked & damaged)} of their scenes are damaged, "
              f"{len((marked | refused) - damaged)} others", file=sys.stderr)
        self.assertEqual((refused, marked), (damaged, damaged))

    def test_one_damaged_scene_of_20_is_named_and_the_others_are_whole(self):
        client = self.start()
        names = [f"s{number}" for number in range(20)]
        hashes = {name: client.json("load", f"builtin:forest?trees={number + 1}", "--name", name)["hash"]
                  for number, name in enumerate(names)}
        hits = {name: self.hits(name) for name in names}
        bad = self.chance.choice(names)
        self.kill()
        self.damage(self.blob_of(hashes[bad]))
        self.start()
        # The first answer has all names; nothing is read for that.
        self.assertEqual({name: scene["state"] for name, scene in self.scenes().items()}, dict.fromkeys(names, "disk"))
        for name in names:
            if name == bad:
                self.client.fails(5, f"the stored copy of scene '{bad}' is damaged", "info", bad)
            else:
                self.assertEqual(self.hits(name), hits[name], name)
        self.assertEqual([name for name, scene in self.scenes().items() if scene["state"] == "damaged"], [bad])

    def test_blobs_that_are_cut_under_clients_end_nobody(self):
        """Blobs are read, not mapped: no byte of an answer differs, and nothing dies of SIGBUS."""
        client = self.start()
        for number in range(3):
            client.json("load", f"{WOODS}&seed={number}", "--name", f"s{number}")
        expected = [self.hits(f"s{number}") for number in range(3)]
        outs = [self.folder / f"{number}.npz" for number in range(9)]
        running = [client.start("--quiet", "query", f"s{number % 3}", "--rays", self.rays, "-o", out)
                   for number, out in enumerate(outs)]
        for blob in self.blobs.iterdir():
            os.truncate(blob, 4096)
        for number, (process, out) in enumerate(zip(running, outs)):
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, 0, errors)
            with numpy.load(out) as columns:
                self.assertEqual({name: columns[name].tobytes() for name in columns}, expected[number % 3])
        self.again()
        for number in range(3):
            self.client.fails(5, "has 4096 bytes", "info", f"s{number}")
        self.daemon.stop()


if __name__ == "__main__":
    main()
