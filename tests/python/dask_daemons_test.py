#!/usr/bin/env python3
"""The daemon of a host, which several workers of it share: who starts it, and what happens when it ends or is stuck.

  dask_daemons_test.py RAYNESTD RAYNEST FLATC
"""
import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest.mock

import numpy as np

import raynest
from daemon import until
from raynest import _own_daemon, _workers
from raynest._notes import Told
from raynest._own_daemon import Daemon
from raynest._travel import Missing
from with_cluster import many
from with_daemon import WithDaemon, main, rain

SCENE = "builtin:forest?trees=5"
RAYS = rain(2000)


class Hosts(WithDaemon):
    def setUp(self):
        self.folder = self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-test-host-"))
        self.enterContext(unittest.mock.patch.object(tempfile, "tempdir", self.folder))
        self.setup = many.Setup(self.raynestd, "host", ("--threads", "1"))

    def worker(self, kind=Daemon, **setup):
        """A worker of a host, as far as its daemon is concerned: locks of one process keep its own others out, too."""
        made = kind(self.setup._replace(**setup), "a scheduler")
        self.addCleanup(lambda: (made.drop(), made._end()))
        return made

    def script(self, text):
        path = pathlib.Path(self.folder) / f"script{len(os.listdir(self.folder))}"
        path.write_text("#!/bin/sh\n" + text)
        path.chmod(0o755)
        return str(path)

    def refused(self, said, **setup):
        with self.assertRaisesRegex(raynest.FailedError, f"^this machine {said}$"):
            self.worker(**setup).client()

    def test_a_daemon_that_ends_at_once_is_told_with_what_it_said(self):
        self.refused("has a daemon that ended at once: .*--nonsense.*", options=("--nonsense",))
        self.refused("has a daemon that ended at once: the pack is missing",
                     binary=self.script("echo 'raynestd: first' >&2; echo 'raynestd: the pack is missing' >&2; exit 1"))
        self.refused("has a daemon that ended at once by signal 9", binary=self.script("kill -9 $$"))
        with self.subTest("another worker of the host may try"):
            once = self.script(f"[ -e {self.folder}/tried ] && exec {self.raynestd} \"$@\"; touch {self.folder}/tried; exit 3")
            self.refused("has a daemon that ended at once with code 3", binary=once)
            self.worker(binary=once).client().ping()
        with unittest.mock.patch.object(_own_daemon, "START_SECONDS", 0.5):
            self.refused("has a daemon that was not ready after 0 s: it waits",
                         binary=self.script("echo it waits >&2; exec sleep 1000"))

    def test_any_worker_starts_the_next_daemon(self):
        first, second = self.worker(), self.worker()
        first.client().ping()
        second.client().ping()
        self.assertEqual((first._process is None, second._process is None), (False, True))
        first._process.kill()
        second.drop()
        second.client().ping()      # though the first one has nothing to do
        self.assertIsNotNone(second._process)
        until(lambda: first._process is None)
        first._end()
        second.client().ping()
        self.assertTrue(os.path.exists(second.folder))
        second._end()
        self.assertFalse(os.path.exists(second.folder))

    def item(self, host, method="trace", rays=RAYS, **options):
        source = many.prepare(SCENE).source
        with unittest.mock.patch.object(_workers, "_host", lambda _setup: contextlib.nullcontext(host)):
            return _workers.item(raynest.__version__, self.setup, source, method, rays, options)[1]

    def test_a_stuck_daemon_is_ended_by_any_worker_and_an_item_that_lasts_is_not(self):
        self.assertLess(_own_daemon.DAEMON_SECONDS + _own_daemon.SILENT_LOOKS * _own_daemon.GREETING_SECONDS, 10,
                        "a fault may cost no more")
        first, second = self.worker(), self.worker(_workers.Host)
        self.enterContext(unittest.mock.patch.object(_own_daemon, "DAEMON_SECONDS", 0.01))
        self.enterContext(unittest.mock.patch.object(_own_daemon, "GREETING_SECONDS", 0.5))
        first.client().ping()
        with self.subTest("many looks"):
            looks = []
            with unittest.mock.patch.object(_own_daemon, "Client", side_effect=lambda *to, **how: looks.append(
                    raynest.Client(*to, **how)) or looks[-1]):
                lit = {"size": (64, 64), "integrator": "path", "spp": 128}
                whole = self.item(second, "render", None, **lit)
            self.assertGreater(len(looks), _own_daemon.SILENT_LOOKS + 1)
            self.same(whole, self.client.load(SCENE, "few").render(**lit))
        for what, end in (("where a thread begins", second.drop), ("in an item", lambda: second.client().ping())):
            with self.subTest("stuck " + what):
                end()
                stuck = first._process or second._process
                stuck.send_signal(signal.SIGSTOP)
                self.addCleanup(stuck.kill)
                self.same(self.item(second), self.client.scene("few").trace(RAYS))
                self.assertIsNotNone(stuck.poll())

    def test_a_daemon_with_nothing_to_do_ends_where_another_setup_begins(self):
        self.enterContext(unittest.mock.patch.object(_workers, "_hosts", {}))

        def started(threads):
            with _workers._host(self.setup._replace(options=("--threads", threads))) as host:
                host.client().ping()
                self.addCleanup(lambda: (host.drop(), host._end()))
                return host._process
        first = started("1")
        second = started("2")
        self.assertEqual((first.poll(), second.poll()), (None, None))      # it may be needed again at once
        with unittest.mock.patch.object(_workers, "IDLE_SECONDS", 0):
            self.assertIs(started("2"), second)
            self.assertIsNone(first.poll())
            with _workers._host(self.setup._replace(options=("--threads", "2"))):      # it makes an item
                third = started("3")
                self.assertIsNotNone(first.wait())
                self.assertEqual((second.poll(), third.poll()), (None, None))
            self.assertIsNone(started("1").poll())
            self.assertIsNotNone(second.wait())

    def test_a_daemon_that_another_worker_process_uses_stays(self):
        host = self.worker()
        host.client().ping()
        uses = ("import sys; from raynest._own_daemon import Daemon, Setup; daemon = Daemon(Setup(), ''); daemon.folder = sys.argv[1]\n"
                "with daemon.in_use():\n    print(flush=True)\n    sys.stdin.read()")
        with subprocess.Popen([sys.executable, "-c", uses, host.folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
            other.stdout.readline()
            self.assertFalse(host.end_if_idle(0))
            self.assertIsNone(host._process.poll())
            other.stdin.close()
        self.assertEqual(other.returncode, 0)
        self.assertFalse(host.end_if_idle(1000))
        process = host._process
        self.assertTrue(host.end_if_idle(0))
        self.assertIsNotNone(process.wait())
        self.assertFalse(os.path.exists(host.folder))

    def test_a_block_of_arrays_that_no_worker_can_make_any_more_says_what_helps(self):
        with unittest.mock.patch.object(_workers, "item", return_value=("here", Missing(["a file"]), Told())), \
                self.assertRaisesRegex(raynest.FailedError, r"lacks the scene, .*: call arrays\(\) again$"):
            _workers.columns_of("", self.setup, None, None, {}, 0, 1, "", ())

    def test_hosts_that_share_a_folder_for_what_is_temporary_keep_apart(self):
        here = self.worker()
        here.client().ping()
        left = pathlib.Path(here.folder)
        os.utime(left, (0, 0))
        with unittest.mock.patch.object(_own_daemon.socket, "gethostname", return_value="another"), \
                unittest.mock.patch.object(_own_daemon.fcntl, "flock"):     # as where locks are each host's own
            there = self.worker()
            self.assertNotEqual(here.folder, there.folder)
            there.client().ping()
        self.assertTrue(left.exists())
        self.assertIsNotNone(there._process)

    def test_a_folder_of_somebody_else_is_refused(self):
        folder = pathlib.Path(self.worker().folder)
        elsewhere = pathlib.Path(self.folder) / "elsewhere"
        elsewhere.mkdir(0o700)
        said = f"may not use {folder}, which is no private folder of this user: remove it, or set another TMPDIR there"

        def link():
            folder.symlink_to(elsewhere)

        def theirs():
            folder.mkdir(0o700)
            os.chown(folder, 12345, 12345)

        for what, make, remove in (("a link", link, folder.unlink), ("a file", folder.touch, folder.unlink),
                                   ("open to others", lambda: (folder.mkdir(), folder.chmod(0o770)), folder.rmdir),
                                   ("another user's", theirs, folder.rmdir)):
            with self.subTest(what):
                if make is theirs and os.getuid() != 0:
                    self.skipTest("skipped: only root gives folders away")
                make()
                self.refused(said)
                remove()
        self.assertEqual(os.listdir(elsewhere), [])
        with self.subTest("no folder at all"), unittest.mock.patch.object(tempfile, "tempdir", "/proc/nowhere"):
            self.refused("cannot make /proc/nowhere/.*; set another TMPDIR there")


if __name__ == "__main__":
    main()
