#!/usr/bin/env python3
"""How items are dealt out to the workers of a Dask cluster: what is dealt again, to whom, and what the user is told.

  dask_deal_test.py RAYNESTD RAYNEST FLATC
"""
import asyncio
import contextlib
import os
import signal
import threading
import time
import unittest.mock
import warnings

import distributed
import numpy as np

import raynest
from daemon import PATIENCE, until
from raynest import _notes, _roster, _workers, generators
from raynest._requests.job import Outcome
from with_cluster import WithCluster, many
from with_daemon import main, rain

SCENE = "builtin:forest?trees=20"
QUICK = 0.2     # s of silence until an item is late


def makes(_host, _source, options):
    """An item that fails on a worker, or ends when there is such a file. The workers get it as code: they have not this
    module."""
    import distributed
    try:
        where = distributed.get_worker().address
    except ValueError:
        where = "here"
    if where in options.get("fails", ()):
        raise OSError("it is broken")
    end = time.monotonic() + options.get("patience", np.inf)
    while "until" in options and not options["until"].exists():
        if time.monotonic() > end:
            raise raynest.FailedError("it was kept waiting")
        time.sleep(0.02)
    time.sleep(options.get("seconds", 0))
    return where


def makes_of(_scene, rays, until):
    import time
    while not until.exists():
        time.sleep(0.02)
    return rays


class Dealt(WithCluster):
    def setUp(self):
        self.now = self.cluster(2)
        self.first, self.other = self.now.client.scheduler_info()["workers"]
        self.end = self.out / f"end of {self.id()}"
        self.addCleanup(self.end.touch)

    def deal(self, *options, patience=QUICK, **how):
        return many.Deal(self.now.client, self.setup, many.prepare(SCENE), makes, [many.Part(each) for each in options],
                         patience, None, **how)

    def dealt(self):
        """worker -> how many items of a client it has."""
        return {worker: sum(key.startswith("raynest-") for key in keys)
                for worker, keys in self.now.client.processing().items()}

    def keep_busy(self, worker, items=20):
        busy = [self.now.client.submit(makes, None, None, {"until": self.end}, workers=[worker], pure=False)
                for _ in range(items)]
        until(lambda: len(self.now.client.processing()[worker]) == items)
        return busy

    def look(self, deal):
        """Has a Deal see that all of its items were dealt long ago."""
        for copies in deal._open.values():
            for copy in copies.values():
                copy.born = -np.inf
        deal._asked = -np.inf
        deal._look()

    def test_a_late_item_goes_to_a_worker_that_has_no_copy_of_it(self):
        busy = self.keep_busy(self.other)       # the scheduler itself would give the first one all copies
        deal = self.deal({"until": self.end})
        deal._deal(0)
        until(lambda: self.dealt() == {self.first: 1, self.other: 0}, self.dealt)
        living = deal._roster.living()
        del living[self.first]
        self.enterContext(unittest.mock.patch.object(deal._roster, "living", lambda _patience: living))
        self.look(deal)
        until(lambda: self.dealt() == {self.first: 1, self.other: 1}, self.dealt)
        del busy

    def test_what_a_living_worker_makes_is_dealt_again_only_to_a_free_one_after_others_were_done(self):
        busy = self.keep_busy(self.other)
        deal = self.deal({"until": self.end})
        deal._deal(0)
        copies, = deal._open.values()
        until(lambda: self.dealt() == {self.first: 1, self.other: 0}, self.dealt)
        self.look(deal)
        self.assertEqual(len(copies), 1, "nobody knows how long an item takes")
        deal._seconds.append(0.01)
        self.look(deal)
        self.assertEqual(len(copies), 1, "the other worker is busy")
        for each in busy[1:]:
            each.cancel()
        until(lambda: len(self.now.client.processing()[self.other]) == 1)
        self.look(deal)
        self.assertEqual(len(copies), 2)
        until(lambda: self.dealt() == {self.first: 1, self.other: 1}, self.dealt)
        deal._copies[0] = 3
        self.look(deal)
        self.assertEqual((len(copies), deal._here), (2, {}), "living workers make it")

    def test_what_a_living_worker_makes_of_rays_that_a_stuck_one_has_is_dealt_again(self):
        rays = rain(10)
        deal = many.Deal(self.now.client, self.setup, many.prepare(SCENE), makes_of, [
            many.Part({"until": self.end}, lambda: rays, True)], QUICK, None)
        deal._deal(0, [self.first])
        until(lambda: self.dealt() == {self.first: 1, self.other: 0}, self.dealt)
        copy, = deal._open[0].values()
        self.assertEqual(copy.onto, self.first)
        copy.onto = "a worker that is not heard"
        self.look(deal)
        until(lambda: self.dealt() == {self.first: 1, self.other: 1}, self.dealt)

    def test_an_item_that_lasts_is_made_once(self):
        deal, found = self.deal({"until": self.end}), []
        making = threading.Thread(target=lambda: found.extend(deal.answers()))
        making.start()
        silence = deal._silence()
        until(lambda: time.monotonic() - deal._news > silence + 3)
        until(lambda: deal._asked > -np.inf)
        self.assertEqual(sum(self.dealt().values()), 1)
        self.assertEqual(deal._here, {})
        self.end.touch()
        making.join()
        self.assertIn(found[0][1], (self.first, self.other))

    def test_a_worker_that_is_not_heard_is_dead(self):
        roster = self.deal({})._roster
        self.assertEqual(set(roster.living()), {self.first, self.other})
        until(lambda: time.monotonic() - roster._asked > 0.1)
        roster._beats = {worker: (seen, when - 100) for worker, (seen, when) in roster._beats.items()}
        roster._hear({self.first: {"last_seen": roster._beats[self.first][0]}, self.other: {"last_seen": np.inf}})
        self.assertEqual(set(roster.living()), {self.other})

    def test_what_the_scheduler_tells_of_the_workers_is_known_everywhere(self):
        deal = self.deal({})
        workers = deal._roster.now
        self.assertEqual(set(workers()), {self.first, self.other})
        self.enterContext(unittest.mock.patch.object(_roster, "FRESH_SECONDS", np.inf))
        self.now.workers.append(self.now.add())
        self.now.wait(3)
        self.assertEqual(len(workers()), 2, "it is asked for seldom")
        deal._roster.places([], PATIENCE)
        self.assertEqual(len(workers()), 3)
        self.assertEqual(len(_roster.roster_of(self.now.client).living()), 3, "all requests of a client know it")

    def test_answers_of_workers_are_taken_while_this_machine_makes_an_item(self):
        deal = self.deal({"fails": (self.first, self.other), "until": self.end, "patience": PATIENCE}, {"seconds": 1})
        order = []
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for item, answer in deal.answers():
                order.append((item, answer))
                self.end.touch()    # without which this machine's never ends
        self.assertEqual(order[1], (0, "here"))
        self.assertEqual(order[0][0], 1)
        self.assertTrue(any("they were made on this machine" in str(each.message) for each in said))

    def test_a_worker_that_fails_every_item_gets_no_more_of_them(self):
        items = 60
        deal = self.deal(*[{"fails": (self.first,), "seconds": 0.03}] * items, patience=PATIENCE)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = dict(deal.answers())
        self.assertEqual(found, dict.fromkeys(range(items), self.other))
        told, = (str(each.message) for each in said)
        self.assertRegex(told, rf"^the worker {self.first} failed at \d+ items \(OSError: it is broken\), made elsewhere$")
        self.assertLess(deal._failures[f"the worker {self.first}"].items, items // 3)

    def test_answers_that_a_stuck_worker_has_are_made_again_and_others_come_meanwhile(self):
        items, asked, release = 30, [], asyncio.Event()
        fetch = distributed.worker.get_data_from_worker

        async def fetch_from_who_is_not_stuck(rpc, keys, worker, *rest, **how):
            if worker == self.first:
                asked.append(worker)
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(release.wait(), PATIENCE)
            return await fetch(rpc, keys, worker, *rest, **how)
        self.enterContext(unittest.mock.patch.object(distributed.worker, "get_data_from_worker", fetch_from_who_is_not_stuck))
        deal = self.deal(*[{"seconds": 0.02}] * items)
        self.addCleanup(self.now.client.loop.add_callback, release.set)
        self.assertEqual(dict(deal.answers()), dict.fromkeys(range(items), self.other))
        self.assertGreater(len(asked), 5)       # more than Dask's own gather() would wait for together

    def test_rays_that_a_stuck_worker_is_sent_hold_up_no_other_item(self):
        other_came = threading.Event()

        async def never(*_rays, **_how):
            while not other_came.is_set():
                await asyncio.sleep(0.02)
            raise OSError("it is stuck")
        self.enterContext(unittest.mock.patch.object(self.now.client, "scatter", never))
        rays = rain(100)
        deal = many.Deal(self.now.client, self.setup, many.prepare(SCENE), "trace", [
            many.Part({"fields": ("t",)}, lambda: rays, True), many.Part({"fields": ("t",)}, lambda: rays)], PATIENCE, None)
        order = []
        for item, answer in deal.answers():
            order.append(item)
            other_came.set()
            self.same(answer, self.woods.trace(rays, fields=("t",)))
        self.assertEqual(order, [1, 0])

    def test_an_item_is_not_late_while_its_rays_are_sent_and_who_did_not_take_them_gets_no_more(self):
        taken, given = threading.Event(), []

        async def late(_rays, workers, **_how):
            given.append(workers)
            while not taken.is_set():
                await asyncio.sleep(0.02)
            raise OSError("it is stuck")
        self.enterContext(unittest.mock.patch.object(self.now.client, "scatter", late))
        rays = rain(10)
        deal = many.Deal(self.now.client, self.setup, many.prepare(SCENE), makes_of, [
            many.Part({"until": self.end}, lambda: rays, True)] * 8, PATIENCE, None)
        for item in range(7):
            deal._deal(item, [self.first])
        until(lambda: given == [[self.first]] * len(given) and len(given) > 2)
        deal._patience = 0
        deal._seconds.append(0)
        deal._look()
        self.assertEqual(deal._copies, [1] * 7 + [0])
        taken.set()
        until(lambda: sum(self.dealt().values()) == 7, self.dealt)
        self.assertLess(len(given), 7)
        self.assertEqual(deal._taker([self.first, self.other]), self.other)

    def test_a_worker_that_goes_on_failing_is_left_out_for_longer_but_is_better_than_nobody(self):
        deal = self.deal({}, patience=1000)
        deal._open[0] = {"another copy": unittest.mock.Mock()}
        error, held = OSError("it is broken"), []
        error.raynest_where = where = f"the worker {self.first}"
        for _ in range(5):
            deal._failed(0, error)
            held.append(round((deal._failures[where].until - time.monotonic()) / 1000))
        self.assertEqual(held, [1, 2, 4, 8, 8])
        self.assertEqual(deal._fit(), [self.other])
        deal._unfit[self.other] = _workers.NoRoom("it has none")
        self.assertEqual(deal._fit(), [self.first])

    def test_an_answer_with_rows_for_other_rays_is_none(self):
        splits, t = np.array([0, 2, 3, 3]), np.zeros(3)
        for fits, rays, is_reduced, answer in (
                (True, 3, False, {"t": t}), (False, 4, False, {"t": t}), (True, 4, True, {"t": t}),
                (True, 3, False, {"ray_splits": splits, "t": t}), (False, 4, False, {"ray_splits": splits, "t": np.zeros(4)}),
                (False, 3, False, {"ray_splits": splits, "t": np.zeros(7)}), (False, 3, False, [t]), (False, 3, True, {"t": 1})):
            self.assertEqual(many._has_rows(rays, is_reduced, answer), fits, (rays, answer))

    def test_ctrl_c_ends_what_this_machine_makes(self):
        cluster = self.cluster(0)
        cluster.environment["RAYNESTD"] = "/nowhere"
        cluster.workers.append(cluster.add())
        cluster.wait(1)
        self.enterContext(unittest.mock.patch.dict(os.environ, RAYNESTD=self.raynestd))
        setup = self.setup._replace(binary="")

        def jobs():
            found = []
            for host in [host for (kind, _), host in _workers._hosts.items() if kind == setup and host._process]:
                with raynest.connect(host.uri) as client:
                    found += [job for job in client.jobs() if job["kind"] != "load"]
            return found

        def interrupt():
            try:
                until(jobs)
            finally:
                os.kill(os.getpid(), signal.SIGINT)
        interrupting = threading.Thread(target=interrupt)
        interrupting.start()
        with warnings.catch_warnings(), self.assertRaises(KeyboardInterrupt):
            warnings.simplefilter("ignore")
            many.render(cluster.client, SCENE, size=(640, 640), integrator="path", spp=1 << 16, setup=setup, patience=QUICK)
        interrupting.join()
        until(lambda: not jobs(), jobs)

    def warned(self, work):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            work()
        return [(str(each.message), each.category) for each in said]

    def test_notes_that_count_are_of_the_whole(self):
        def noisy(count, of, error):
            return f"the error is still above noise=0.1 in {count} of {of} parts of the picture, {error} in all of it: ask for more"

        def dropped(count):
            return f"{count} samples were not finite and count for nothing"
        self.assertEqual(_notes.notes_of([(8, [noisy(2, 4, 0.3), dropped(2)]), (8, [noisy(1, 4, 0.4)]), (16, [dropped(5)])]),
                         [noisy(3, 16, 0.26), dropped(7)])
        told = _notes.told_of("render", [("it is odd", raynest.RayWarning)], Outcome(notes=["the scene has no lights: it is dark"]))
        self.assertEqual([text for text, _ in told.warned], ["it is odd"], "no other client warns of a note")

    def test_a_request_tells_a_note_once(self):
        scene = many.prepare(SCENE)

        def request():
            many.known_to(self.now.client, scene, self.setup, PATIENCE)
            for _ in range(2):      # the one that asks for the scene's digest, and the one that traces
                deal = many.Deal(self.now.client, self.setup, scene, makes, [many.Part({})], PATIENCE, None)
                deal._note("a host has no room")
                self.assertEqual(len(list(deal.answers())), 1)
        for _ in range(2):
            self.assertEqual(self.warned(request), [("a host has no room", raynest.RayWarning)])

    def test_the_user_is_warned_as_by_one_daemon(self):
        rays = rain(20000)
        rays[9000, 4] = np.nan
        rays[15000:15003] = 0
        far = np.float64(rays[:, (0, 1, 2, 4, 5, 6)])
        far[8000:8010, 0] += 1e9
        points, up = np.zeros((400, 3)), np.tile([0.0, 1, 0], (400, 1))
        points[300] = np.nan
        for what, given, options in (("not valid", rays, {}), ("max_hits", rays, {"kind": "all", "max_hits": 1}),
                                     ("rays start so far", far, {}), ("of point 300", generators.hemisphere(
                                         points, up, samples=20, seed=4), {"reduce": "hit_fraction"})):
            with self.subTest(what):
                whole = self.warned(lambda: self.woods.trace(given, **options))
                self.assertTrue(any(what in text for text, _ in whole), whole)
                self.assertEqual(self.warned(lambda: many.trace(self.now.client, SCENE, given, **options, item_rays=3000,
                                                                setup=self.setup)), whole)
        with self.subTest("arrays"), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = many.arrays(self.now.client, SCENE, rays, item_rays=4000, setup=self.setup)
            self.now.client.compute(found["t"], sync=True)
            until(lambda: len(said) >= 2, lambda: said)
            self.assertEqual(sorted(str(each.message).rpartition(":")[0] for each in said if each.category is raynest.RayWarning), [
                "rays 12000 to 15999 of arrays(): 3 of 4000 rays are not valid and count as misses, the first is ray 15000",
                "rays 8000 to 11999 of arrays(): ray 9000 is not valid and counts as a miss"])
        with self.subTest("by this machine"):
            self.now.scheduler.kill()
            told = self.warned(lambda: many.trace(self.now.client, SCENE, rays, item_rays=3000, setup=self.setup))
            whole = self.warned(lambda: self.woods.trace(rays))
            self.assertEqual([each for each in told if "Dask scheduler" not in each[0]], whole)
            self.assertEqual(len(told), len(whole) + 1, told)


if __name__ == "__main__":
    main()
