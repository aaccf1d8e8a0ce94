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
import tempfile
import time

import numpy

from daemon import LONG, PATIENCE, Client, Daemon, is_sanitized, main
from metrics_test import scrape
from with_state import WOODS, WithState

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
        hashes = [self.client.json("load", WOODS, "--name", "woods")["hash"]]
        self.client.json("load", WOODS, "--name", "twin")
        with self.edits("twin", False, 40 * ROUNDS) as twin:
            hashes += [line.split()[1] for line in twin.communicate(timeout=4 * PATIENCE)[0].splitlines()]
        loaded, done, number = {}, 0, 0
        for _ in range(ROUNDS):
            started = []
            for _ in range(3):
                number += 1
                source = f"builtin:forest?trees={self.chance.randint(1, 30)}&seed={self.chance.randint(1, 9)}"
                started.append((f"s{number}", self.client.start("--json", "load", source, "--name", f"s{number}")))
            with self.edits("woods", True, min(40, len(hashes) - 1 - done)) as edits:
                # Power goes among edits, however slow the machine is.
                first = edits.stdout.readline()
                time.sleep(self.chance.uniform(0, 1))
                self.lose_power()
                said = [line.split()[1] for line in (first + edits.stdout.read()).splitlines()]
            for name, process in started:
                output, _ = process.communicate(timeout=PATIENCE)
                if process.returncode == 0:
                    loaded[name] = json.loads(output)["hash"]
            self.restart()
            scenes = self.scenes()
            self.assertLessEqual(loaded.items(), {name: scene["hash"] for name, scene in scenes.items()}.items())
            for name, scene in scenes.items():
                self.assertEqual(self.client.json("info", name)["hash"], scene["hash"])
            now = hashes.index(scenes["woods"]["hash"])
            # One that was on its way may be there without an answer.
            self.assertIn(now - done - len(said), (0, 1))
            self.assertEqual(said, hashes[done + 1:done + 1 + len(said)])
            for name in list(scenes)[:max(0, len(scenes) - 8)]:
                if name not in ("woods", "twin"):
                    self.client.json("unload", name)
                    loaded.pop(name, None)
            done = now
        self.kill()
        self.assertEqual(self.check()[0], 0)
        print(f"{kind}: {ROUNDS} losses of power, {number} loads, {done} kept edits: nothing lost")

    def test_what_was_answered_survives_losses_of_power_on_ext4(self):
        self.loses_nothing("ext4")

    def test_what_was_answered_survives_losses_of_power_on_xfs(self):
        self.loses_nothing("xfs")

    def test_a_daemon_that_does_not_flush_is_caught(self):
        """The losses above are real ones: what is not flushed is gone, blob or row."""
        compiler = shutil.which("cc") or shutil.which("g++")
        if not compiler or is_sanitized(self.raynestd):
            self.skipTest("needs a compiler, and no sanitizer")
        # LD_PRELOAD knows no spaces, which this test's folder has.
        library = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-"))) / "no_flush.so"
        subprocess.run([compiler, "-shared", "-fPIC", "-D_GNU_SOURCE", "-x", "c", "-", "-o", library, "-ldl"],
                       input=NO_FLUSH, text=True, check=True)
        self.make_disk("ext4")
        self.start().json("load", WOODS, "--name", "first")
        self.daemon.stop()
        os.sync()
        os.environ.update(LD_PRELOAD=str(library))
        self.addCleanup(os.environ.pop, "LD_PRELOAD", None)
        self.addCleanup(os.environ.pop, "NO_FLUSH", None)
        lost = {}
        for what in ("/blobs/", "/manifest.sqlite"):
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
        self.assertEqual(lost, {"/blobs/": True, "/manifest.sqlite": None})

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
        count = 500 if LONG else 12
        client = self.start()
        hashes = [client.json("load", f"builtin:forest?trees=1&seed={number}", "--name", f"s{number}")["hash"]
                  for number in range(count)]
        damaged = {f"s{number}" for number in range(0, count, 2)}
        blobs = [self.blob_of(hashes[int(name[1:])]) for name in damaged]
        self.kill()
        for blob in blobs:
            self.damage(blob)
        self.start()
        self.assertEqual(len(self.scenes()), count)
        self.assertEqual({name for name in self.scenes() if self.client.run("info", name).returncode != 0}, damaged)
        self.assertEqual({name for name, scene in self.scenes().items() if scene["state"] == "damaged"}, damaged)

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
