#!/usr/bin/env python3
"""Requests whose workers are gone, stuck, out of reach, or no good: this machine makes what they do not, and nothing waits,
differs in a byte, or stays behind.

  dask_alone_test.py RAYNESTD RAYNEST FLATC
"""
import asyncio
import contextlib
import gc
import os
import signal
import time
import unittest.mock
import warnings

import distributed
import numpy as np

import raynest
from daemon import PATIENCE, until
from raynest import _prepared, _roster, _workers, generators
from raynest._travel import Missing, own_piece
from with_cluster import WithCluster, many
from with_daemon import main, rain

SCENE = "builtin:forest?trees=20"
RAYS = rain(20000)
QUICK = 0.2     # s of silence until an item is late
NO_PACKAGE = """
import sys
class Lacks:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "raynest":
            raise ModuleNotFoundError("No module named 'raynest'")
sys.meta_path.insert(0, Lacks())
"""
LEAVES = np.random.default_rng(1).uniform(-60, 60, (150000, 1, 3))
LARGE = (LEAVES + np.random.default_rng(2).uniform(-0.5, 0.5, (150000, 3, 3))).reshape(-1, 3), np.arange(450000).reshape(-1, 3)
MESH = np.array([[-40.0, 0, -40], [40, 0, -40], [0, 0, 60]]), np.array([[0, 1, 2]])


def makes(_host, _source, options):
    """Says where, or is what another place would make. The workers get it as code: they have not this module."""
    import time

    import distributed
    time.sleep(options.get("seconds", 0))
    try:
        return distributed.get_worker().address
    except ValueError:
        return options.get("here", "here")


def lasts(_host, _source, options):
    import time
    while not options["until"].exists():
        time.sleep(0.02)


def fails(_host, _source, options):
    """An item that no worker makes."""
    import distributed
    try:
        distributed.get_worker()
    except ValueError:
        return options["here"]
    raise OSError("it is broken")


def stored(dask_worker):
    return len(dask_worker.data)


def tasks(dask_scheduler):
    return {key: str(task.state) for key, task in dask_scheduler.tasks.items()}


class Alone(WithCluster):
    def deal(self, cluster, method, *options, patience=QUICK, **part):
        return many.Deal(cluster.client, self.setup, many.prepare(SCENE), method,
                         [many.Part(each, **part) for each in options], patience, None)

    def traced(self, cluster, scene=SCENE, **options):
        return many.trace(cluster.client, scene, RAYS, **{"item_rays": 500, "setup": self.setup, **options})

    @contextlib.contextmanager
    def told(self):
        notes = []
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            yield notes
        notes += [str(each.message) for each in said if issubclass(each.category, raynest.errors.Warning)]

    # ---- no worker lives ------------------------------------------------------------------------

    def test_a_cluster_without_workers(self):
        cluster = self.cluster(0)
        with self.told() as notes:
            self.same(self.traced(cluster, patience=QUICK), self.woods.trace(RAYS))
        made_here = "no worker finished some items (FailedError: the cluster has no workers); they were made on this machine"
        self.assertEqual(notes, [made_here])
        with self.subTest("it is waited for once"), self.told() as notes:
            _roster.roster_of(cluster.client).none_since -= 1000
            deal = self.deal(cluster, makes, {}, patience=PATIENCE)
            deal._look()
            self.assertTrue(deal._nobody)
            many.heatmap(cluster.client, SCENE, size=(64, 40), diff="builtin:forest?trees=5", setup=self.setup)
        self.assertEqual(notes, [made_here])

    def test_workers_that_come_late_are_used(self):
        cluster = self.cluster(0)
        found = []
        for _, where in self.deal(cluster, makes, *[{"seconds": 0.1}] * 400).answers():
            found.append(where)
            if len(found) == 3:
                cluster.workers.append(cluster.add())
            if where != "here":
                break
        self.assertEqual(found[:3], ["here"] * 3)
        self.assertNotEqual(found[-1], "here", "a worker made one, and was not left out")

    def lost(self, cluster, act):
        """A request whose workers are lost in the middle of it."""
        acted = []

        def progress(done, total, _stage):
            if not acted and done > 0.2 * total:
                acted.append(act())
        with self.told() as notes:
            self.same(self.traced(cluster, patience=QUICK, progress=progress), self.woods.trace(RAYS))
        self.assertTrue(acted)
        self.assertTrue(any("they were made on this machine" in note for note in notes), notes)

    def test_all_workers_are_killed(self):
        cluster = self.cluster(2)
        self.traced(cluster)

        def kill():
            for worker in cluster.workers:
                worker.kill()
                worker.wait()
        self.lost(cluster, kill)

    def test_all_workers_are_stuck(self):
        cluster = self.cluster(2)
        self.traced(cluster)
        self.lost(cluster, lambda: [worker.send_signal(signal.SIGSTOP) for worker in cluster.workers])
        with self.told():       # and are still
            self.same(self.traced(cluster, patience=QUICK), self.woods.trace(RAYS))

    def test_a_scheduler_is_stuck(self):
        cluster = self.cluster(1)
        scene = many.prepare(*MESH)
        self.traced(cluster, scene)
        cluster.scheduler.send_signal(signal.SIGSTOP)
        self.addCleanup(cluster.scheduler.send_signal, signal.SIGCONT)
        self.enterContext(unittest.mock.patch.object(_prepared, "PATIENCE", QUICK))
        with self.told():
            self.same(self.traced(cluster, scene, patience=QUICK), self.client.mesh(*MESH).trace(RAYS))
            lit = {"size": (64, 64), "integrator": "path", "spp": 1, "deadline": 1000}
            self.same(many.render(cluster.client, SCENE, **lit, setup=self.setup, patience=QUICK), self.woods.render(**lit))
        with self.assertRaisesRegex(raynest.FailedError, "the Dask scheduler does not answer"):
            many.arrays(cluster.client, many.prepare(*MESH), RAYS, setup=self.setup, patience=QUICK)

    def test_a_client_that_is_closed_in_the_middle(self):
        cluster = self.cluster(1)
        client = distributed.Client(cluster.client.scheduler.address, set_as_default=False)
        with self.assertRaisesRegex(raynest.UsageError, "the Client was closed before its request was done"):
            many.trace(client, SCENE, RAYS, item_rays=50, setup=self.setup, progress=lambda *_: client.close())

    def test_a_deadline_is_that_of_all_items(self):
        cluster = self.cluster(1)
        end = self.out / "end of the deadline"
        self.addCleanup(end.touch)
        with self.assertRaisesRegex(raynest.DeadlineError, "the request's deadline passed; pass a longer deadline="):
            list(self.deal(cluster, lasts, *[{"until": end, "deadline": 0.5}] * 4).answers())
        words = [{"until": end, "words": ["query", "--deadline", "0.5"]}]
        with self.assertRaises(raynest.DeadlineError):
            list(self.deal(cluster, lasts, *words).answers())

    # ---- answers --------------------------------------------------------------------------------

    def test_an_answer_of_this_machine_is_checked_as_one_of_a_worker(self):
        cluster = self.cluster(1)
        for here, said in ((Missing(["a"]), "this machine cannot read builtin:forest"), ("odd", "an answer of another form")):
            with self.subTest(said), self.told(), self.assertRaisesRegex(
                    raynest.FailedError, f"no worker finished an item .*it is broken.*, and this machine cannot make it: .*{said}"):
                self.deal(cluster, fails, {"here": here}, fits=lambda answer: answer != "odd").all()

    def small(self):
        """A daemon that has no room for LARGE."""
        path = self.out / "raynestd"
        path.write_text(f'#!/bin/sh\nexec {self.raynestd} --memory 24M "$@"\n')
        path.chmod(0o755)
        return str(path)

    def test_columns_stay_where_a_host_has_room(self):
        whole, setup = self.client.mesh(*LARGE).trace(RAYS, fields=("t",))["t"], many.Setup("", "worker", ("--threads", "1"))

        def blocks(cluster):
            return many.arrays(cluster.client, LARGE, RAYS, fields=("t",), item_rays=2000, setup=setup)["t"]

        cluster = self.cluster(1)
        first, = cluster.client.scheduler_info()["workers"]
        cluster.environment["RAYNESTD"] = self.small()
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        bad, = set(cluster.client.scheduler_info()["workers"]) - {first}
        until(lambda: len(_roster.roster_of(cluster.client).living()) == 2)
        said = f"^the worker {bad} has no room for the scene, whose files have "
        with self.told() as notes, unittest.mock.patch.object(cluster.client, "submit", wraps=cluster.client.submit) as submit:
            found = blocks(cluster)
        self.assertEqual(len(notes), 1, notes)
        self.assertRegex(notes[0], said)
        # Dask may copy them to the other one later.
        makers = [call.kwargs["workers"] for call in submit.call_args_list if call.args[0] is _workers.columns_of]
        self.assertEqual(makers, [[first]] * 10)
        np.testing.assert_array_equal(cluster.client.compute(found, sync=True), whole)
        cluster.workers[0].kill()
        cluster.workers[0].wait()
        until(lambda: list(cluster.client.scheduler_info()["workers"]) == [bad])
        with self.subTest("no host has room"), self.told() as notes, self.assertRaisesRegex(raynest.BusyError, said):
            blocks(cluster)
        self.assertEqual(notes, [])

    def test_columns_go_to_others_where_a_host_finds_no_room_any_more(self):
        cluster = self.cluster(1)
        first, = cluster.client.scheduler_info()["workers"]
        cluster.environment["RAYNESTD"] = self.small()
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        whole = self.client.mesh(*LARGE).trace(RAYS, fields=("t",))["t"]
        # As if it had had room at the time of the call.
        with self.told(), unittest.mock.patch.object(many.Deal, "good", lambda _deal: []):
            found = many.arrays(cluster.client, LARGE, RAYS, fields=("t",), item_rays=500,
                                setup=many.Setup("", "worker", ("--threads", "1")))["t"]
        np.testing.assert_array_equal(cluster.client.compute(found, sync=True), whole)

    def test_a_host_that_fails_beside_a_good_one_is_named(self):
        odd = ("from raynest import _deal, _notes\nmake = _deal.make_item\n"
               "_deal.make_item = lambda *given: ('the worker ' + __import__('distributed').get_worker().address, 'odd', _notes.Told()) "
               "if given[3] == 'trace' else make(*given)")
        for what, scene, raynestd, patch, said in (
                ("no room", LARGE, self.small(), "", "the worker {} has no room for the scene, whose files have [0-9]+ MB: .*--memory.*"),
                ("no daemon", MESH, "/nowhere", "", r"the worker {} failed at (an item|[0-9]+ items) \(FailedError: the worker {} "
                                                    r"cannot start /nowhere: .*\), made elsewhere"),
                ("odd answers", MESH, self.raynestd, odd, r"the worker {} failed at (an item|[0-9]+ items) \(FailedError: the worker {} "
                                                          r"sent an answer of another form\), made elsewhere")):
            with self.subTest(what):
                cluster = self.cluster(1)
                first, = cluster.client.scheduler_info()["workers"]
                cluster.environment["RAYNESTD"] = raynestd
                cluster.workers.append(cluster.add(patch))
                cluster.wait(2)
                bad, = set(cluster.client.scheduler_info()["workers"]) - {first}
                until(lambda: len(_roster.roster_of(cluster.client).living()) == 2)
                with self.told() as notes:
                    found = self.traced(cluster, scene, setup=many.Setup("", "worker", ("--threads", "1")))
                self.same(found, self.client.mesh(*scene).trace(RAYS))
                self.assertEqual(len(notes), 1, notes)
                self.assertRegex(notes[0], "^" + said.replace("{}", bad) + "$")

    def test_a_host_whose_processor_rounds_otherwise_is_left_out(self):
        whole = self.woods.trace(RAYS)
        if self.client.outcome["target"] not in ("v3", "v4"):
            self.skipTest(f"a machine of {self.client.outcome['target']}")
        cluster = self.cluster(1)
        first, = cluster.client.scheduler_info()["workers"]
        scene = many.prepare(SCENE)
        self.same(self.traced(cluster, scene), whole)
        cluster.environment["RAYNEST_TARGET"] = "v2"
        cluster.workers.append(cluster.add())
        cluster.wait(2)
        other, = set(cluster.client.scheduler_info()["workers"]) - {first}
        notes = []
        while not notes:        # until it has loaded the scene in time
            with self.told() as notes:
                self.same(self.traced(cluster, scene, item_rays=50), whole)
        self.assertEqual(notes, [f"the worker {other} is left out: it rounds twice, and those that began once, so its bytes differ"])
        with self.subTest("a command"), self.told() as notes:
            deal = many.Deal(cluster.client, self.setup, scene, command_of(other), [many.Part({})] * 8, PATIENCE, None)
            self.assertNotIn(other, deal.all())
        cluster.workers[0].kill()
        cluster.workers[0].wait()
        until(lambda: list(cluster.client.scheduler_info()["workers"]) == [other])
        for what, of in ("all others are gone", scene), ("all round so", SCENE):
            with self.subTest(what), self.told() as notes:
                self.assertFalse(np.array_equal(self.traced(cluster, of)["t"], whole["t"]))
            self.assertEqual(notes, [])

    def test_workers_within_this_process(self):
        mesh = self.client.mesh(*MESH)
        sky = generators.hemisphere(np.zeros((100, 3)) + [0, 90, 0], np.tile([0.0, 1, 0], (100, 1)), samples=9)
        setup = many.Setup(self.raynestd, "host", ("--threads", "1"))
        with distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=None) as local, \
                distributed.Client(local, set_as_default=False) as client, self.told() as notes:
            for rays in (RAYS, sky):
                self.same(many.trace(client, MESH, rays, setup=setup), mesh.trace(rays))
            # A task waits for others, for which there is no other thread.
            within = client.submit(lambda: many.trace(distributed.get_client(), MESH, RAYS, setup=setup))
            self.same(within.result(timeout=PATIENCE), mesh.trace(RAYS))
        self.assertEqual(notes, [])

    def test_workers_that_only_the_scheduler_reaches(self):
        cluster = self.cluster(1)
        worker, = cluster.client.scheduler_info()["workers"]
        connect = cluster.client.rpc.connect

        async def refused(address, *rest, **how):
            if address == worker:
                raise OSError("it is behind a gateway")
            return await connect(address, *rest, **how)
        self.enterContext(unittest.mock.patch.object(cluster.client.rpc, "connect", refused))
        with self.told() as notes:
            self.same(self.traced(cluster, many.prepare(*MESH)), self.client.mesh(*MESH).trace(RAYS))
        self.assertEqual(notes, [f"this machine cannot reach the worker {worker}: rays and answers go through the scheduler"])

    def test_a_worker_with_another_release(self):
        for what, patch in (("a function that it lacks", "import raynest._deal; del raynest._deal.sent_item"),
                            ("a class of another form", "import raynest._travel as t, typing; "
                             "t.Source = typing.NamedTuple('Source', [('path', str)])"),
                            ("no package", NO_PACKAGE),
                            ("another version", "import raynest._version as v; v.VERSION = '0.0.1'")):
            cluster = self.cluster(0)
            cluster.workers.append(cluster.add(patch))
            cluster.wait(1)
            bad, = cluster.client.scheduler_info()["workers"]
            said = f"(the worker {bad}|a worker) (cannot run it: .*; install python3-raynest|has RayNest 0.0.1, .*: install one version on)"
            with self.subTest(what), self.told() as notes, self.assertRaisesRegex(raynest.Error, said):
                self.traced(cluster)
            self.assertEqual(notes, [])
            with self.subTest(what, beside="another worker"), self.told() as notes:
                cluster.workers.append(cluster.add())
                until(lambda: len(_roster.roster_of(cluster.client).living()) == 2)
                self.same(self.traced(cluster), self.woods.trace(RAYS))
            self.assertEqual(len(notes), 1, notes)
            self.assertRegex(notes[0], said)

    def test_a_machine_that_cannot_make_an_item_waits_for_who_comes(self):
        cluster = self.cluster(1)
        cannot = many.Deal._not_made_here

        def joins(*given):
            if len(cluster.workers) == 1:
                cluster.workers.append(cluster.add())
            return cannot(*given)
        for comes in (True, False):
            with self.subTest(comes=comes), contextlib.ExitStack() as now, self.told() as notes:
                now.enter_context(unittest.mock.patch.dict(os.environ, RAYNESTD="/nowhere"))
                if comes:
                    now.enter_context(unittest.mock.patch.object(many.Deal, "_not_made_here", joins))
                else:
                    now.enter_context(self.assertRaisesRegex(raynest.FailedError, "this machine cannot start /nowhere"))
                called = []

                def progress(*_):
                    if not called:
                        called.append(cluster.workers[-1].kill())
                self.same(self.traced(cluster, setup=many.Setup("", "worker", ("--threads", "1")), progress=progress,
                                      patience=PATIENCE if comes else QUICK), self.woods.trace(RAYS))
                self.assertTrue(called)
            self.assertEqual(notes, [])

    # ---- what stays behind ----------------------------------------------------------------------

    def left(self, cluster):
        until(lambda: not cluster.client.run_on_scheduler(tasks), lambda: cluster.client.run_on_scheduler(tasks))

    def test_nothing_stays_on_the_cluster_after_a_request(self):
        cluster = self.cluster(1)
        self.traced(cluster)
        gc.collect()
        gc.disable()
        self.addCleanup(gc.enable)
        for rays in (RAYS, generators.camera(size=(200, 100))):
            many.trace(cluster.client, SCENE, rays, item_rays=500, setup=self.setup)
            self.left(cluster)
        with self.subTest("a scene that is gone"):
            scene = many.prepare(*MESH)
            self.traced(cluster, scene)
            del scene
            self.left(cluster)
        with self.subTest("a request that is left while its items are submitted"):
            submit = cluster.client.submit

            def slow(*given, **options):
                time.sleep(0.05)
                return submit(*given, **options)
            with unittest.mock.patch.object(cluster.client, "submit", slow):
                for _ in range(3):
                    next(self.deal(cluster, makes, *[{}] * 50).answers())
            self.left(cluster)
        with self.subTest("a request that is left while its rays are sent"):
            landed, scatter = [], distributed.client.scatter_to_workers

            async def slow(*given, **options):
                found = await scatter(*given, **options)
                landed.append(found)
                await asyncio.sleep(0.5)
                return found
            with unittest.mock.patch.object(distributed.client, "scatter_to_workers", slow):
                deal = many.Deal(cluster.client, self.setup, many.prepare(SCENE), "trace", [
                    many.Part({}, lambda: RAYS, True)] * 3, PATIENCE, None)
                for item in range(3):
                    deal._deal(item)
                until(lambda: landed)
                for item in range(3):
                    deal._leave(item)
                self.left(cluster)
                until(lambda: not any(cluster.client.run(stored).values()), lambda: cluster.client.run(stored))
        with self.subTest("an error that somebody keeps"):
            kept = []
            try:
                with unittest.mock.patch.object(many, "slice", side_effect=KeyboardInterrupt, create=True):
                    many.render(cluster.client, SCENE, size=(320, 200), item_samples=512, setup=self.setup)
            except KeyboardInterrupt as error:
                kept.append(error)
            self.assertTrue(kept)
            self.left(cluster)

    def test_pieces_that_two_scenes_have_stay_with_either(self):
        cluster = self.cluster(1)
        first, second = many.prepare(*MESH), many.prepare(*MESH)
        keys = list(second._pieces)
        self.traced(cluster, first)
        second.send_all(cluster.client)
        del first
        gc.collect()
        self.assertEqual([own_piece(key) is None for key in keys], [False] * len(keys))
        self.left_pieces(cluster, [f"{key}~0" for key in keys])
        with self.subTest("those of an earlier sending go"):
            second.send_anew([f"{keys[0]}~0"])
            second.send_all(cluster.client)
            self.left_pieces(cluster, [f"{key}~1" for key in keys])

    def left_pieces(self, cluster, keys):
        def there():
            return {key for key, places in cluster.client.who_has().items() if places}
        until(lambda: there() == set(keys), there)


def command_of(worker):
    """An item as of a daemon that rounds twice where the worker is."""
    def method(host, _source, _options):
        import time

        import distributed
        where = distributed.get_worker().address
        time.sleep(0.2)
        host.client().outcome["target"] = "v2" if where == worker else "v4"
        return where
    return method


if __name__ == "__main__":
    main()
