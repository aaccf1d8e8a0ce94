#!/usr/bin/env python3
"""A successor takes the state folder and the sockets of a running daemon over, and nobody is refused.

  takeover_test.py RAYNESTD RAYNEST
"""
import array
import concurrent.futures
import contextlib
import datetime
import fcntl
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import threading
import time
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "client" / "python"))
import raynest  # noqa: E402
from daemon import LONG, PATIENCE, Client, main, until  # noqa: E402
from with_state import WOODS, WithState  # noqa: E402

RAYS = [[x / 8 - 4, 50, y / 8 - 4, 0, -1, 0] for x in range(8) for y in range(8)]


class Running:
    """A raynestd on the folder of a test; unlike Daemon it may not become ready."""

    def __init__(self, test, *arguments, ready=True, tcp=True):
        self.test = test
        self.log = test.folder / f"log{len(test.running)}"
        test.running.append(self)
        with open(self.log, "wb") as out:
            self.process = subprocess.Popen(
                [test.raynestd, "--state", test.state, *(["--listen", "tcp://127.0.0.1:0"] if tcp else []), "--listen",
                 f"unix:{test.folder}/socket", "--http", "127.0.0.1:0", "--cuda", "off", "--threads", "2",
                 "--ready-file", test.ready, *map(str, arguments)],
                stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        test.addCleanup(self.process.wait)
        test.addCleanup(self.process.kill)
        if ready:
            until(lambda: self.says("READY") or self.process.poll() is not None, self.text)
            if self.process.poll() is not None:
                raise AssertionError(self.text())

    def text(self):
        return self.log.read_text(errors="replace")

    def at(self, event):
        """When its log first said so, in s since 1970."""
        line = next(line for line in self.text().splitlines() if f" {event} " in line)
        return datetime.datetime.fromisoformat(line.split()[0]).timestamp()

    def open_files(self):
        files = set()
        for link in pathlib.Path(f"/proc/{self.process.pid}/fd").iterdir():
            with contextlib.suppress(OSError):  # closed meanwhile
                files.add(os.readlink(link))
        return files

    def says(self, event):
        if event != "READY":
            return event in self.text()
        try:
            return json.loads(self.test.ready.read_text())["pid"] == self.process.pid
        except (OSError, ValueError):
            return False

    def ended(self):
        self.test.assertEqual(self.process.wait(PATIENCE), 0, self.text()[-2000:])

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        self.ended()


class FakeSuccessor:
    """Asks the daemon of a folder to give way, and then does what a test wants."""

    def __init__(self, state):
        self.stream = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.stream.settimeout(PATIENCE)
        folder = os.open(state, os.O_PATH)
        self.stream.connect(f"/proc/self/fd/{folder}/successor")
        os.close(folder)

    def ask(self, word=b"takeover 1"):
        self.stream.send(word)
        return self

    def answer(self, keep=False):
        text, control, _, _ = self.stream.recvmsg(1 << 16, 4096)
        numbers = array.array("i")
        for _, _, data in control:
            numbers.frombytes(data[:len(data) - len(data) % numbers.itemsize])
        self.kept = list(numbers) if keep else []
        for number in numbers[:0] if keep else numbers:
            os.close(number)
        return text and json.loads(text), len(numbers)

    def close(self):
        for number in self.kept:
            os.close(number)
        self.stream.close()

    kept = ()


class Takeover(WithState):
    def setUp(self):
        super().setUp()
        self.ready = self.folder / "ready.json"
        self.running = []

    def daemon_of(self, *arguments):
        daemon = Running(self, *arguments)
        self.uri, self.local = json.loads(self.ready.read_text())["listen"]
        self.client = Client(self.raynest, self.uri)
        return daemon

    def successor(self, *arguments):
        return Running(self, "--takeover", *arguments)

    def hand_over(self, before):
        """Starts a successor. Returns it, and the seconds after which it and the one before came to each step."""
        times, begun = {}, time.time()
        after = Running(self, "--takeover", ready=False)

        def look():
            files, at = after.open_files(), time.time() - begun
            for step, file in (("got the lock and the sockets", "lock"), ("opened the manifest", "manifest.sqlite")):
                if str(self.state / file) in files:
                    times.setdefault(step, at)
            return after.says("READY") or after.process.poll() is not None

        until(look, after.text)
        self.assertIsNone(after.process.poll(), after.text())
        until(lambda: before.says("handed_over") and after.says("took_over"), before.text)
        before.ended()
        ended = time.time() - begun
        times |= {"asked": before.at("takeover_asked") - begun,
                  "serves": after.at("took_over") - begun,
                  "the one before accepts no more": before.at("handed_over") - begun, "and has ended": ended}
        return after, times

    def refused_successor(self, says, *arguments):
        refused = Running(self, "--takeover", *arguments, ready=False)
        self.assertEqual(refused.process.wait(PATIENCE), 1, refused.text())
        lines = [line for line in refused.text().splitlines() if "raynestd:" in line]
        self.assertEqual(len(lines), 1, refused.text())
        self.assertIn(says, lines[0])

    def python(self, uri, reconnect=PATIENCE):
        client = raynest.connect(uri, reconnect=reconnect)
        self.addCleanup(client.close)
        return client

    def test_50_clients_see_a_takeover_and_nobody_is_refused(self):
        clients, takeovers = 50, 100 if LONG else 3
        daemon = self.daemon_of()
        expected = self.python(self.uri).load(WOODS, "woods", share=("public",)).trace(RAYS, fields=("t", "prim"))
        expected = b"".join(expected[name].tobytes() for name in ("t", "prim"))
        counts, slowest = [0] * clients, [0.0] * clients
        problems, again = [], [0]
        over = threading.Event()

        def look(client):
            columns = client.scene("woods").trace(RAYS, fields=("t", "prim"))
            if b"".join(columns[name].tobytes() for name in ("t", "prim")) != expected:
                problems.append("other bytes")

        def change(client, index, number):
            name = f"own{index}"
            client.load(f"builtin:forest?trees=4&seed={number % 7}", name, replace=True)
            client.scene(name).trace(RAYS[:1])

        def work(index):
            uri = (self.uri, self.local)[index % 2]
            client = None
            number = 0
            while not over.is_set():
                start = time.monotonic()
                try:
                    client = client or raynest.connect(uri, reconnect=PATIENCE)
                    change(client, index, number) if index % 10 == 9 else look(client)
                    if index % 5 == 0:  # these connect for each request
                        client.close()
                        client = None
                except raynest.errors.Error as error:
                    problems.append(f"{index}: {error!r}")
                number += 1
                counts[index] = number
                slowest[index] = max(slowest[index], time.monotonic() - start)
                time.sleep(0.01)
            if client:
                client.close()

        def knock():
            """Connects all the time without any second try, and tries to lock the folder."""
            lock = self.enterContext(open(self.state / "lock", "rb"))
            families = ((socket.AF_INET, ("127.0.0.1", int(self.uri.rsplit(":", 1)[1]))),
                        (socket.AF_UNIX, self.local[5:]))
            while not over.is_set():
                for family, address in families:
                    try:
                        with socket.socket(family) as end:
                            end.connect(address)
                    except OSError as error:
                        problems.append(f"refused: {error!r}")
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    fcntl.flock(lock, fcntl.LOCK_UN)
                    problems.append("nobody held the lock")
                again[0] += 2
                time.sleep(0.002)

        threads = [threading.Thread(target=work, args=(i,)) for i in range(clients)] + [threading.Thread(target=knock)]
        for thread in threads:
            thread.start()
        timeline = []
        pool = self.enterContext(concurrent.futures.ThreadPoolExecutor(1))
        try:
            for _ in range(takeovers):
                seen = list(counts)
                until(lambda: all(now > then for now, then in zip(counts, seen)), lambda: str(problems[:3]), 4 * PATIENCE)
                seen = sum(counts)
                third = pool.submit(self.refused, "--ready-file", self.folder / "third")
                daemon, times = self.hand_over(daemon)
                self.assertIn("another daemon uses", third.result())
                timeline.append((times, sum(counts) - seen))
            seen = list(counts)
            until(lambda: all(now > then for now, then in zip(counts, seen)), lambda: str(problems[:3]), 4 * PATIENCE)
        finally:
            over.set()
            for thread in threads:
                thread.join()
        print(f"{takeovers} takeovers under {clients} clients: {sum(counts)} requests, {again[0]} bare connections, "
              f"{len(problems)} failed; {takeovers} third daemons refused; the slowest request took "
              f"{max(slowest):.2f} s", file=sys.stderr)
        times, answered = timeline[-1]
        print("the last one began", *(f"+{at:.2f} s {step}" for step, at in sorted(times.items(), key=lambda s: s[1])),
              f"{answered} requests ended meanwhile", sep=", ", file=sys.stderr)
        self.assertEqual(problems, [])
        self.assertTrue((self.folder / "socket").exists())
        daemon.stop()
        self.assertFalse((self.folder / "socket").exists())
        self.assertFalse(self.ready.exists())
        self.assertEqual(self.check()[0], 0, self.check()[1])

    def test_running_jobs_end_where_they_began(self):
        before = self.daemon_of("--drain-ms-max", "120000")
        self.client.json("load", "builtin:terrain?size=256", "--name", "woods")
        # Without a second try: its connection is the first daemon's.
        busy = self.client.start("render", "woods", "--size", "64x64", "--traversal", "reference", "-o",
                                 self.folder / "a.png")
        until(lambda: self.client.json("jobs")["jobs"])
        idle = raynest.connect(self.uri, reconnect=0)
        self.addCleanup(idle.close)
        after = self.successor()
        self.assertIn("woods", self.scenes())
        self.assertIsNone(before.process.poll())
        until(lambda: before.says("handed_over"))
        with self.assertRaisesRegex(raynest.errors.BusyError, "taken the place of this one: connect again"):
            idle.scenes()
        _, errors = busy.communicate(timeout=8 * PATIENCE)
        self.assertEqual(busy.returncode, 0, errors)
        before.ended()
        until(lambda: after.says("predecessor_ended"), after.text)
        self.assertEqual(json.loads(self.ready.read_text())["pid"], after.process.pid)

    def test_a_successor_that_fails_changes_nothing(self):
        before = self.daemon_of()
        self.client.json("load", WOODS, "--name", "woods")
        files = self.files().keys()
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            self.refused_successor("cannot listen on", "--listen", f"tcp://127.0.0.1:{port}")
        self.refused_successor("does not exist", "--listen", f"unix:{self.folder}/none/socket")
        until(lambda: before.says("takeover_failed"), before.text)
        self.assertTrue((self.folder / "socket").exists(), "its file went with the one that failed")
        self.assertEqual(self.files().keys() - {"manifest.sqlite-wal", "manifest.sqlite-shm"},
                         files - {"manifest.sqlite-wal", "manifest.sqlite-shm"})
        # It stores and removes as before.
        self.client.json("load", "builtin:flake?depth=2", "--name", "flake")
        self.client.json("edit", "woods", "--move", "birch-1=0,0,1", "--keep")
        self.assertEqual(Client(self.raynest, self.local).run("unload", "flake").returncode, 0)
        self.assertIn("another daemon uses", self.refused("--ready-file", self.folder / "other"))
        hits = self.hits("woods")
        self.successor()
        self.assertEqual(set(self.scenes()), {"woods"})
        self.assertEqual(self.hits("woods"), hits)
        before.ended()

    def test_changes_wait_and_go_on_if_the_successor_ends_before_it_serves(self):
        daemon = self.daemon_of()
        self.client.json("load", WOODS, "--name", "woods")
        self.client.json("edit", "woods", "--move", "birch-1=0,0,1", "--keep")
        hits = self.hits("woods")
        fake = FakeSuccessor(self.state).ask()
        answer, descriptors = fake.answer()
        self.assertEqual([row["value"] for row in answer["sockets"]],
                         ["tcp://127.0.0.1:0", f"unix:{self.folder}/socket", "127.0.0.1:0"])
        self.assertEqual(descriptors, 4)
        # Others are served, a third one is refused, and changes wait.
        self.assertEqual(self.hits("woods"), hits)
        self.refused_successor("another raynestd takes its place already")
        self.assertIn("another daemon uses", self.refused("--ready-file", self.folder / "other"))
        loading = self.client.start("load", "builtin:flake?depth=2", "--name", "flake")
        editing = self.client.start("edit", "woods", "--move", "birch-1=0,0,2", "--keep")
        time.sleep(0.5)
        self.assertEqual((loading.poll(), editing.poll()), (None, None))
        fake.close()
        for waiting in (loading, editing):
            _, errors = waiting.communicate(timeout=PATIENCE)
            self.assertEqual(waiting.returncode, 0, errors)
        self.assertIn("takeover_failed", daemon.text())
        daemon.process.kill()
        daemon.process.wait()
        self.daemon_of()
        self.assertEqual(set(self.scenes()), {"woods", "flake"})
        self.assertNotEqual(self.hits("woods"), hits)

    def test_a_name_that_a_failed_successor_took_is_made_again(self):
        daemon = self.daemon_of()
        fake = FakeSuccessor(self.state).ask()
        fake.answer()
        (self.state / "successor").unlink()
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as own:
            own.bind(str(self.state / "successor"))
        fake.close()
        until(lambda: daemon.says("takeover_failed"), daemon.text)
        self.assertIn("cannot write the ready file", self.refused("--takeover", "--ready-file", self.folder / "none" / "ready"))
        after = self.successor()
        daemon.ended()
        after.stop()

    def test_one_that_is_killed_while_it_is_asked_is_followed(self):
        daemon = self.daemon_of()
        self.client.json("load", WOODS, "--name", "woods")
        daemon.process.send_signal(signal.SIGSTOP)
        after = Running(self, "--takeover", ready=False)
        time.sleep(1)
        self.assertIsNone(after.process.poll(), after.text())
        daemon.process.kill()
        until(lambda: after.says("READY") or after.process.poll() is not None, after.text)
        self.uri, self.local = json.loads(self.ready.read_text())["listen"]
        self.client = Client(self.raynest, self.uri)
        self.assertEqual(set(self.scenes()), {"woods"})
        after.stop()

    def test_the_next_successor_waits_until_changes_go_on(self):
        daemon = self.daemon_of()
        self.client.json("load", WOODS, "--name", "woods")
        for _ in range(20):
            fake = FakeSuccessor(self.state).ask()
            self.assertEqual(fake.answer()[1], 4)
            fake.close()
        fake = FakeSuccessor(self.state).ask()
        fake.answer()
        loading = self.client.start("load", "builtin:flake?depth=2", "--name", "flake")
        time.sleep(0.5)
        self.assertIsNone(loading.poll(), "the gate of the one before was opened")
        held = [os.readlink(link) for link in pathlib.Path(f"/proc/{daemon.process.pid}/fd").iterdir() if link.is_symlink()]
        self.assertFalse([name for name in held if "manifest" in name])
        fake.close()
        self.assertEqual(loading.wait(PATIENCE), 0)
        daemon.stop()

    def test_one_that_ends_while_a_successor_has_the_sockets_leaves_their_names(self):
        daemon = self.daemon_of()
        fake = FakeSuccessor(self.state).ask()
        self.assertEqual(fake.answer(keep=True)[1], 4)
        daemon.process.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.process.wait(PATIENCE), 0, daemon.text())
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(self.folder / "socket"))
        self.assertIn("another daemon uses", self.refused("--ready-file", self.folder / "other"))
        fake.close()

    def test_a_successor_with_other_options_keeps_what_these_name_and_no_more(self):
        spare = self.folder / "spare"
        first = Running(self, "--listen", f"unix:{spare}")
        tcp, file = json.loads(self.ready.read_text())["listen"][0], self.folder / "socket"
        port = int(tcp.rsplit(":", 1)[1])
        self.assertEqual(file.stat().st_mode & 0o777, 0o600)
        second = Running(self, "--takeover", "--socket-mode", "0660", tcp=False)
        first.ended()
        with self.assertRaises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), PATIENCE)
        self.assertFalse(spare.exists())
        self.assertEqual(file.stat().st_mode & 0o777, 0o660)
        with raynest.connect(f"unix:{file}") as client:
            client.ping()
        self.assertIn("it is closed with that daemon", second.text())
        second.stop()
        self.assertFalse(file.exists())

    @unittest.skipUnless(LONG, "takes a minute: --long")
    def test_one_that_does_not_serve_in_time_is_ended(self):
        daemon = self.daemon_of()
        frozen = subprocess.Popen(
            [sys.executable, "-c", "import os, socket, sys, time; os.chdir(sys.argv[1]); "
             "peer = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET); peer.connect('successor'); "
             "peer.send(b'takeover 1'); peer.recvmsg(1 << 16, 4096); print(flush=True); time.sleep(600)", self.state],
            stdout=subprocess.PIPE)
        self.addCleanup(frozen.stdout.close)
        self.addCleanup(frozen.kill)
        frozen.stdout.readline()
        frozen.send_signal(signal.SIGSTOP)
        self.client.json("load", "builtin:flake?depth=2", "--name", "flake")    # waits for it
        self.assertEqual(frozen.wait(PATIENCE), -signal.SIGKILL)
        self.assertIn("it has not served within 60 s", daemon.text())
        daemon.stop()

    def test_strangers_learn_nothing_and_hold_up_nobody(self):
        daemon = self.daemon_of()
        silent = [FakeSuccessor(self.state) for _ in range(3)]
        for word in (b"takeover 9", b"serving", b"\0" * 64, b"x" * 60000):
            fake = FakeSuccessor(self.state).ask(word)
            answer, descriptors = fake.answer()
            self.assertEqual(descriptors, 0)
            self.assertIn("another release", answer["error"])
            fake.close()
        self.assertEqual((self.state / "successor").stat().st_mode & 0o777, 0o600)
        after = self.successor()
        daemon.ended()
        for end in silent:
            end.close()
        after.stop()
        self.assertFalse((self.state / "successor").exists())

    def test_takeover_starts_a_daemon_where_none_runs_and_needs_a_folder(self):
        self.successor().stop()
        done = subprocess.run([self.raynestd, "--takeover"], capture_output=True, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 2)
        self.assertIn("--takeover needs the --state DIR", done.stderr)


if __name__ == "__main__":
    main()
