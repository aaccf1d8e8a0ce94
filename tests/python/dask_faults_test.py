#!/usr/bin/env python3
"""Seeded faults of a Dask cluster with its default time-outs, and ours: no byte differs. It prints how long each kind
held an answer up, beyond the time without a fault and the capacity that was lost; no time is asserted.

  dask_faults_test.py RAYNESTD RAYNEST FLATC
"""
import collections
import contextlib
import os
import signal
import threading
import time
import traceback
import unittest
import unittest.mock
import warnings

import numpy as np

import raynest
from daemon import LONG, children, until
from raynest import generators
from raynest._deal import Deal
from with_cluster import Elsewhere, WithCluster, many
from with_daemon import main, rain

SEEDS = 200 if LONG else 8      # one of each kind
SCENE = "builtin:forest?trees=20"
RAYS = rain(1 << 18)
LIDAR = generators.lidar(np.linspace(-40, 5, 256), (0, 360, 2048), look_at=((0, 9, 0), (1, 9, 0)))
FIELDS = ("t", "prim")
LIT = {"size": (160, 128), "integrator": "path", "spp": 16}
HEAT = {"size": (800, 512)}
# Requests: of one daemon, and of the cluster with a Setup and progress=.
REQUESTS = (
    (lambda woods: woods.trace(LIDAR, fields=FIELDS),
     lambda *to, **how: many.trace(*to, LIDAR, fields=FIELDS, item_rays=1 << 15, **how)),
    (lambda woods: woods.trace(RAYS, fields=FIELDS),
     lambda *to, **how: many.trace(*to, RAYS, fields=FIELDS, item_rays=1 << 14, **how)),
    (lambda woods: woods.trace(LIDAR, reduce="visible_pixels"),
     lambda *to, **how: many.reduce(*to, LIDAR, "visible_pixels", item_rays=1 << 15, **how)),
    (lambda woods: woods.render(**LIT),
     lambda *to, **how: many.render(*to, **LIT, item_samples=160 * 8 * 16, **how)),
    (lambda woods: {"": woods.heatmap(**HEAT)},
     lambda *to, **how: {"": many.heatmap(*to, **HEAT, item_samples=800 * 32, **how)}))
WORKERS = 2


class Faults(WithCluster):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.whole = [alone(cls.woods) for alone, _ in REQUESTS]
        # Both workers share its daemon: namespaces of one machine are one host.
        cls.shared = cls.setup._replace(each="host", options=("--threads=2",))

    def setUp(self):
        self.far, self.now = None, None
        with contextlib.suppress(unittest.SkipTest):
            self.far = Elsewhere()
            self.addCleanup(self.far.close)
        self.addCleanup(lambda: self.now and self.now.close())

    def begin(self):
        """A cluster whose last worker is on another host, if this machine can have one."""
        if self.now:
            self.now.close()
        self.now = self.cluster(WORKERS - 1, self.far.here if self.far else "127.0.0.1")
        self.join()

    def join(self):
        """Starts the last worker, or one in place of it."""
        self.now.workers[WORKERS - 1:] = [self.now.add(under=self.far.under if self.far else ())]
        until(lambda: len(self.now.client.scheduler_info()["workers"]) == WORKERS)
        many.trace(self.now.client, SCENE, RAYS[:2000], item_rays=100, setup=self.setup)    # it has the scene then

    def replace(self):
        if self.far:
            self.far.mend()
        worker = self.now.workers.pop()
        worker.kill()
        worker.wait()
        until(lambda: len(self.now.client.scheduler_info()["workers"]) == WORKERS - 1)
        self.join()

    def asked(self, request, setup, progress=None):
        """Carries out a request, whose answer must be that of one daemon; returns how long that took."""
        begin = time.monotonic()
        deals = []
        with unittest.mock.patch.object(many, "Deal", lambda *given, **how: deals.append(Deal(*given, **how)) or deals[-1]):
            answer = REQUESTS[request][1](self.now.client, SCENE, setup=setup, progress=progress)
        took = time.monotonic() - begin
        self.assertTrue(any(deal._heard for deal in deals), "workers made some: all were there when it began")
        self.same({name: np.asarray(column) for name, column in answer.items()},
                  {name: np.asarray(column) for name, column in self.whole[request].items()})
        return took

    def fault(self, kind, pause):
        """Returns what happens, and what is done afterwards. Something stuck goes on after `pause` seconds, or never."""
        worker = self.now.workers[-1]
        if "shared" in kind:    # by whichever worker it was started, and those workers go on
            pid, = until(lambda: [pid for each in self.now.workers for pid in children(each.pid, *self.shared.options)])
        else:
            pid = worker.pid if "worker" in kind else until(lambda: children(worker.pid, "--threads\0"))[0]
        if kind == "the scheduler is killed":
            return self.now.scheduler.kill, self.begin
        if kind == "a link is cut":
            return self.far.cut, self.replace
        if "killed" in kind:
            return lambda: os.kill(pid, signal.SIGKILL), self.replace if "worker" in kind else lambda: None

        def go_on():
            with contextlib.suppress(ProcessLookupError):   # somebody has ended it
                os.kill(pid, signal.SIGCONT)
        going = threading.Timer(pause, go_on)

        def stop():
            os.kill(pid, signal.SIGSTOP)
            if np.isfinite(pause):
                going.start()

        def after():
            if np.isfinite(pause):
                going.join()
            elif "shared" not in kind:
                self.replace()
        return stop, after

    def disturbed(self, kind, chance):
        """A request during which a fault happens. Returns how long it took beyond what it takes without it, and with
        the lost capacity."""
        request, at, delay = chance.integers(len(REQUESTS)), chance.uniform(0, 0.8), chance.uniform(0, 0.05)
        pause = chance.choice([chance.uniform(0.5, 8), np.inf])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", raynest.RayWarning)
            setup = self.shared if "shared" in kind else self.setup
            faultless = self.asked(request, setup)
            act, after = self.fault(kind, pause)
            begin, happened = time.monotonic(), []

            def progress(done, total, _stage):
                if done >= at * total and not happened:
                    time.sleep(delay)
                    act()
                    happened.append(time.monotonic() - begin)
            took = self.asked(request, setup, progress)
        after()
        left = max(0.0, faultless - happened[0])
        lost = 0.0 if "daemon is killed" in kind else min(left, pause) if "stuck" in kind else left
        return took - faultless - lost

    def test_no_byte_differs(self):
        kinds = ["a worker is killed", "a worker is stuck", "a daemon is killed", "a daemon is stuck",
                 "the scheduler is killed", "a shared daemon is killed", "a shared daemon is stuck", *(["a link is cut"] if self.far else [])]
        beyond = collections.defaultdict(list)
        self.begin()
        for seed in range(SEEDS):
            kind = kinds[seed % len(kinds)]
            with self.subTest(kind, seed=seed):
                try:
                    beyond[kind].append(self.disturbed(kind, np.random.default_rng(seed)))
                except BaseException:
                    traceback.print_exc()       # now, and not after the last seed
                    self.begin()
                    raise
                print(f"seed {seed}: {kind}: {beyond[kind][-1]:.1f} s", flush=True)
        for kind, seconds in beyond.items():
            print(f"| {kind} | {len(seconds)} | {np.median(seconds):.1f} s | {max(seconds):.1f} s |", flush=True)


if __name__ == "__main__":
    main()
