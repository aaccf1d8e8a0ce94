#!/usr/bin/env python3
"""Scene.stream() against a real daemon, and what happens when a request is left before its end: by
break, by an exception, by Ctrl-C, by its deadline.

  streams_test.py RAYNESTD RAYNEST FLATC
"""
import os
import signal
import threading
import time
import warnings

import numpy as np

import raynest
from raynest import generators
from daemon import PATIENCE, Daemon, until
from with_daemon import FIELDS, WithDaemon, main, rain

# Minutes of work, in pieces that are soon told to stop.
ENDLESS = generators.hemisphere(np.full((20000, 3), 3.0), [0, 1, 0], samples=65536)


class Streams(WithDaemon):
    def test_chunks_cover_all_rays_once(self):
        rays = rain(100000)
        whole = self.woods.trace(rays, fields=("t", "path"))
        seen = np.zeros(len(rays), int)
        for first, columns in self.woods.stream(rays, fields=("t", "path")):
            part = slice(first, first + len(columns["t"]))
            seen[part] += 1
            self.same(columns, {name: column[part] for name, column in whole.items()})
        self.assertTrue((seen == 1).all())
        self.assertEqual(self.client.outcome["rays"], 100000)

    def test_blocks_of_an_iterator_count_on(self):
        blocks = [rain(30000), rain(0), rain(12345, seed=2), rain(1, seed=3)]
        whole = self.woods.trace(np.concatenate(blocks), fields=("t",))["t"]
        answered = np.full(len(whole), np.nan)
        for first, columns in self.woods.stream(iter(blocks), fields=("t",)):
            answered[first:first + len(columns["t"])] = columns["t"]
        np.testing.assert_array_equal(answered, whole)

    def test_blocks_of_an_iterator_see_one_epoch(self):
        def blocks(size=9):
            yield rain(100)
            self.client.load(f"builtin:terrain?size={size}", "moving", replace=True)
            yield rain(100)
        scene = self.client.load("builtin:terrain?size=8", "moving")
        with self.assertRaisesRegex(raynest.InvalidError, "'moving' was replaced or unloaded"):
            for _ in scene.stream(blocks()):
                pass
        with self.assertRaisesRegex(raynest.InvalidError, "epoch"):
            for _ in scene.stream(blocks(10), epoch=scene.info["epoch"]):
                pass

    def test_blocks_of_an_iterator_are_counted_and_warned_of_together(self):
        bad = rain(200, seed=2)
        bad[3, 0] = np.nan
        with self.assertWarnsRegex(raynest.RayWarning, "^ray 203 is not valid"):
            for _ in self.woods.stream(iter([rain(200), bad, rain(100)])):
                pass
        outcome = self.client.outcome
        self.assertEqual((outcome["rays"], outcome["invalid"], outcome["first_invalid"]), (500, 1, 203))
        self.assertEqual(outcome["hits"] + outcome["misses"], 500)

    def test_other_requests_between_the_blocks_of_a_stream_do_not_disturb_it(self):
        other = self.client.load("builtin:terrain?size=8", "other", replace=True)
        for size in (9, 10):
            other = self.client.load(f"builtin:terrain?size={size}", "other", replace=True)

        def blocks():
            for seed in range(3):
                yield rain(100, seed)
                other.trace(rain(10))
        self.assertEqual(sum(len(columns["t"]) for _, columns in self.woods.stream(blocks())), 300)

    def test_multi_comes_with_splits_of_its_own(self):
        rays = rain(40000)
        whole = self.woods.trace(rays, kind="multi", fields=("t",))
        counts = np.diff(whole["ray_splits"])
        for first, columns in self.woods.stream(rays, kind="multi", fields=("t",)):
            own = np.diff(columns["ray_splits"])
            np.testing.assert_array_equal(own, counts[first:first + len(own)])
            start = int(whole["ray_splits"][first])
            np.testing.assert_array_equal(columns["t"], whole["t"][start:start + len(columns["t"])])

    def test_leaving_a_stream_cancels_it_and_frees_the_connection(self):
        cancelled = self.client.stats()["jobs_cancelled"]
        for _ in self.woods.stream(rain(4_000_000), fields=("t", "total")):
            break
        stats = self.client.stats()
        self.assertEqual(stats["jobs_cancelled"], cancelled + 1)
        self.assertEqual(stats["jobs_ended"], stats["jobs_started"])
        self.assertEqual(len(self.woods.trace(rain(5))["t"]), 5)

    def test_a_loop_that_thinks_between_chunks_goes_on(self):
        daemon = Daemon(self.raynestd, "--give-way-ms", "50")
        self.addCleanup(daemon.stop)
        rays = rain(400000)
        with raynest.connect(daemon.uri) as thinker, raynest.connect(daemon.uri) as other:
            woods = thinker.load("builtin:forest?trees=20", "woods")
            whole = woods.trace(rays, fields=FIELDS)
            stream = woods.stream(rays, fields=FIELDS)
            chunks = [next(stream)]
            before = -1  # until the daemon has no more room for answers
            while (traced := other.stats()["rays"]) != before:
                before = traced
                end = time.monotonic() + 0.1
                while time.monotonic() < end:
                    other.ping()
            self.assertEqual(other.stats()["gave_way_connections"], 0)
            chunks.extend(stream)
        self.assertEqual(sum(len(columns["t"]) for _, columns in chunks), len(rays))
        for first, columns in chunks:
            part = slice(first, first + len(columns["t"]))
            self.same(columns, {name: column[part] for name, column in whole.items()})

    def test_an_open_stream_keeps_the_connection(self):
        stream = self.woods.stream(rain(200000))
        next(stream)
        with self.assertRaisesRegex(raynest.UsageError, "another call is still open"):
            self.client.scenes()
        stream.close()
        self.assertTrue(self.client.scenes())

    def test_other_threads_are_told_of_an_open_stream(self):
        """A consumer that hands chunks to a worker which asks the same client would wait for ever."""
        told = []

        def ask():
            try:
                self.woods.path_of(0)
            except raynest.UsageError as error:
                told.append(str(error))
        pictures = self.woods.render_stream(size=(64, 36), integrator="ao", spp=64)
        for stream in (self.woods.stream(rain(200000)), pictures):
            next(stream)
            worker = threading.Thread(target=ask, daemon=True)
            worker.start()
            worker.join(PATIENCE)
            self.assertFalse(worker.is_alive())
            stream.close()
        self.assertEqual(len(told), 2)
        for line in told:
            self.assertRegex(line, r"another thread has an open stream .* connect\(\) once more")
        worker = threading.Thread(target=ask)
        worker.start()
        worker.join(PATIENCE)
        self.assertEqual(len(told), 2)

    def test_an_exception_in_the_loop_leaves_the_connection_usable(self):
        with self.assertRaises(ZeroDivisionError):
            self.woods.trace(rain(200000), progress=lambda *_: 1 // 0)
        self.assertLess(self.client.ping(), PATIENCE)

    def test_another_thread_may_close_the_connection(self):
        client = raynest.connect(self.daemon.uri)
        scene, socket = client.scene("woods"), client.connection._socket
        started = self.client.stats()["jobs_started"]

        def close():
            try:
                until(lambda: self.client.stats()["jobs_started"] > started)
            finally:
                client.close()
        closer = threading.Thread(target=close)
        with self.assertRaisesRegex(raynest.ConnectError, "closed meanwhile"):
            closer.start()
            scene.render(size=(8192, 8192))
        closer.join(PATIENCE)
        self.assertEqual(socket.fileno(), -1)

    def test_a_close_at_any_moment_is_the_same_error(self):
        """Sixty of them by another thread, each some milliseconds into requests."""
        rays = rain(100_000)
        for i in range(60):
            client = raynest.connect(self.daemon.uri)
            scene, socket = client.scene("woods"), client.connection._socket
            timer = threading.Timer(0.001 * (i % 20), client.close)
            with self.assertRaisesRegex(raynest.ConnectError, "closed"):
                timer.start()
                while True:
                    scene.trace(rays, fields=("t",))
            timer.join()
            self.assertEqual(socket.fileno(), -1)

    def test_a_request_that_is_closed_from_within_is_an_error(self):
        rays, corners = rain(400_000), np.eye(3) * 1234.5
        job = self.woods.trace(ENDLESS, reduce="hit_fraction", detach=True)
        self.addCleanup(job.cancel)
        for call in (lambda scene, end: scene.trace(rays, progress=end),
                     lambda scene, end: scene._client.job(job.number).wait(progress=end),
                     lambda scene, end: scene._client.mesh(corners, [[0, 1, 2]], "never",
                                                           progress=end),
                     lambda scene, end: [end() for _ in scene.stream(rays)]):
            client = raynest.connect(self.daemon.uri)
            with self.assertRaisesRegex(raynest.ConnectError, "closed meanwhile"):
                call(client.scene("woods"), lambda *_: client.close())
            with self.assertRaisesRegex(raynest.ConnectError, "connect again"):
                client.ping()
        self.assertNotIn("never", [scene["name"] for scene in self.client.scenes()])

    def test_a_stream_may_be_left_after_a_close(self):
        client = raynest.connect(self.daemon.uri)
        for _ in client.scene("woods").stream(rain(400_000)):
            client.close()
            break
        self.assertEqual(client.connection._socket.fileno(), -1)

    def test_threads_take_turns(self):
        rays = rain(30000)
        expected = self.woods.trace(rays)
        answers = [None] * 4

        def work(i):
            answers[i] = self.woods.trace(rays)
        threads = [threading.Thread(target=work, args=(i,)) for i in range(len(answers))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        for answer in answers:
            self.same(answer, expected)


class Interrupts(WithDaemon):
    def interrupt_once(self, condition):
        """Ctrl-C for this process, as soon as the daemon says so to a second connection."""
        def wait():
            try:
                with raynest.connect(self.daemon.uri) as watcher:
                    until(lambda: condition(watcher.stats()))
            finally:
                os.kill(os.getpid(), signal.SIGINT)
        thread = threading.Thread(target=wait)
        self.addCleanup(thread.join)
        thread.start()

    def assert_usable(self, before):
        stats = self.client.stats()
        self.assertEqual(stats["jobs_cancelled"], before["jobs_cancelled"] + 1)
        self.assertEqual(stats["jobs_ended"], stats["jobs_started"])
        self.assertFalse(self.client.connection.closed)
        self.assertEqual(signal.getsignal(signal.SIGINT), signal.default_int_handler)
        np.testing.assert_array_equal(self.woods.trace(rain(100))["t"],
                                      self.woods.trace(rain(100))["t"])

    def test_a_thread_is_told_of_its_own_rays_alone(self):
        bad = rain(500)
        bad[7, 0] = np.nan
        warned = {"good": 0, "bad": 0}

        def work(name, rays):
            for _ in range(50):
                self.woods.trace(rays)
                warned[name] += self.client.outcome.get("invalid", 0)
        threads = [threading.Thread(target=work, args=args)
                   for args in (("good", rain(500)), ("bad", bad)) for _ in range(2)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        self.assertEqual(warned, {"good": 0, "bad": 100})

    def test_an_interrupt_cancels_a_picture(self):
        before = self.client.stats()
        self.interrupt_once(lambda stats: stats["jobs_started"] > before["jobs_started"])
        with self.assertRaises(KeyboardInterrupt):
            self.woods.render(size=(8192, 8192))
        self.assert_usable(before)

    def test_an_interrupt_cancels_a_query_in_the_midst_of_sending(self):
        before = self.client.stats()
        self.interrupt_once(lambda stats: stats["rays"] > before["rays"])
        with self.assertRaises(KeyboardInterrupt):
            self.woods.trace(rain(8_000_000), fields=FIELDS)
        self.assert_usable(before)

    def test_interrupts_at_any_moment_leave_the_connection_usable(self):
        """Thirty of them, each some milliseconds into a request, wherever Python then is."""
        rays, interrupted = rain(300_000), 0
        old = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        self.addCleanup(signal.signal, signal.SIGALRM, old)
        for i in range(30):
            try:
                signal.setitimer(signal.ITIMER_REAL, 0.001 + 0.004 * i)
                self.woods.trace(rays, fields=FIELDS)
                while True:  # until it comes
                    self.client.ping()
            except KeyboardInterrupt:
                interrupted += 1
            self.assertFalse(self.client.connection.closed)
            self.assertEqual(self.woods.trace(rays[:10], kind="any")["hit"].size, 10)
        self.assertEqual(interrupted, 30)

    def test_a_second_interrupt_does_not_wait(self):
        reached = []
        with self.assertRaises(KeyboardInterrupt), self.client.connection.interrupts:
            for number in range(3):
                signal.raise_signal(signal.SIGINT)
                reached.append(number)
        self.assertEqual(reached, [0])
        self.assertEqual(signal.getsignal(signal.SIGINT), signal.default_int_handler)

    def test_an_interrupt_ends_the_wait_for_another_thread(self):
        answers = []
        cancel = threading.Event()

        def hold():
            def wait(*_):
                begun.set()
                cancel.wait(PATIENCE)
            answers.append(len(self.woods.trace(rain(100_000), fields=("t",), progress=wait)["t"]))
        begun = threading.Event()
        holder = threading.Thread(target=hold)
        holder.start()
        self.assertTrue(begun.wait(PATIENCE))
        timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
        with self.assertRaises(KeyboardInterrupt):
            timer.start()
            self.client.ping()
        cancel.set()
        holder.join(PATIENCE)
        self.assertEqual(sum(answers), 100_000)

    def test_a_handler_of_the_program_stays(self):
        seen = []
        old = signal.signal(signal.SIGINT, lambda *_: seen.append(1))
        self.addCleanup(signal.signal, signal.SIGINT, old)
        rays = self.client.stats()["rays"]
        self.interrupt_once(lambda stats: stats["rays"] > rays)
        self.woods.trace(rain(1_000_000), fields=("t",))
        until(lambda: seen)

    def test_a_deadline_ends_the_request_alone(self):
        for side, deadline in ((8192, 0.2), (1024, 1e-9)):  # in ms, of which 0 are none
            with self.assertRaises(raynest.DeadlineError) as caught:
                self.woods.render(size=(side, side), deadline=deadline)
        self.assertEqual((caught.exception.name, caught.exception.exit_code), ("DEADLINE", 7))
        self.assertIsInstance(caught.exception, TimeoutError)
        self.assertLess(self.client.ping(), PATIENCE)


if __name__ == "__main__":
    main()
