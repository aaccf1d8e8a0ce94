#!/usr/bin/env python3
"""Tests restarts: sockets that outlive the daemon, and clients that find it again.

  restart_test.py RAYNESTD RAYNEST
"""
import contextlib
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "client" / "python"))
import raynest  # noqa: E402
from daemon import LONG, PATIENCE, Client, Programs, main, until  # noqa: E402

SCENE = "builtin:terrain?size=16"
RAYS = [[x / 8 - 4, 50, y / 8 - 4, 0, -1, 0] for x in range(8) for y in range(8)]


class Keeper:
    """Keeps a listening socket and runs one daemon after another on it, as systemd does."""

    def __init__(self, program, *arguments):
        self.program, self.arguments = program, arguments
        self.folder = tempfile.TemporaryDirectory(prefix="raynest-test-")
        self.socket = socket.create_server(("127.0.0.1", 0), backlog=1024)
        self.uri = f"tcp://127.0.0.1:{self.socket.getsockname()[1]}"
        self.process = None
        self.logs = []

    def start(self):
        ready = pathlib.Path(self.folder.name) / "ready.json"
        log = pathlib.Path(self.folder.name) / f"log{len(self.logs)}"
        self.logs.append(log)
        number = self.socket.fileno()
        with open(log, "wb") as out:
            self.process = subprocess.Popen(
                [self.program, "--listen", f"fd:{number}", "--http", "off", "--cuda", "off",
                 "--ready-file", str(ready), *self.arguments],
                stdin=subprocess.DEVNULL, stdout=out, stderr=out, pass_fds=[number])
        until(lambda: ready.exists() or self.process.poll() is not None)
        if not ready.exists():
            raise AssertionError(log.read_text())
        return json.loads(ready.read_text())

    def stop(self, how=signal.SIGTERM):
        """Ends the daemon; returns its exit code."""
        process, self.process = self.process, None
        process.send_signal(how)
        return process.wait(PATIENCE)

    def close(self):
        if self.process:
            self.process.kill()
            self.process.wait()
        self.socket.close()
        self.folder.cleanup()


class Cut:
    """A proxy whose connections can be cut while the daemon lives on."""

    def __init__(self, uri):
        self.target = ("127.0.0.1", int(uri.rsplit(":", 1)[1]))
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.uri = f"tcp://127.0.0.1:{self.listener.getsockname()[1]}"
        self.ends = []
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self.listener.accept()
                far = socket.create_connection(self.target)
                self.ends += [near, far]
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self.pump, args=(source, sink), daemon=True).start()

    def pump(self, source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self):
        for end in self.ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self.ends = []


class Restart(Programs):
    def keeper(self, *arguments):
        keeper = Keeper(self.raynestd, *arguments)
        self.addCleanup(keeper.close)
        keeper.start()
        return keeper

    def client(self, uri):
        client = Client(self.raynest, uri)
        client.environment["RAYNEST_RECONNECT"] = str(PATIENCE)
        return client

    def python(self, uri):
        client = raynest.connect(uri, reconnect=PATIENCE)
        self.addCleanup(client.close)
        return client

    def test_a_client_waits_while_no_daemon_runs_on_a_kept_socket(self):
        keeper = self.keeper()
        self.assertEqual(self.client(keeper.uri).run("scenes").returncode, 0)
        self.assertEqual(keeper.stop(), 0)
        waiting = self.client(keeper.uri).start("--json", "scenes")
        time.sleep(0.3)
        self.assertIsNone(waiting.poll(), "it was refused")
        self.assertEqual(keeper.start()["listen"], [keeper.uri])
        output, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual((waiting.returncode, json.loads(output)["scenes"]), (0, []), errors)

    def test_a_client_that_a_killed_daemon_cut_off_in_its_greeting_finds_the_next_one(self):
        # A connection that the old daemon has accepted ends with it, before any answer.
        keeper = self.keeper()
        for first in (lambda: self.client(keeper.uri).start("--json", "scenes"), None):
            os.kill(keeper.process.pid, signal.SIGSTOP)
            if first:
                waiting = first()
            else:
                found = []
                thread = threading.Thread(target=lambda: found.append(self.python(keeper.uri).scenes()))
                thread.start()
            time.sleep(0.5)
            # The kernel's queue belongs to the socket and survives; this one was taken from it.
            taken, _ = keeper.socket.accept()
            keeper.stop(signal.SIGKILL)
            taken.close()
            time.sleep(0.2)
            keeper.start()
            if first:
                output, errors = waiting.communicate(timeout=PATIENCE)
                self.assertEqual((waiting.returncode, errors), (0, ""))
            else:
                thread.join(PATIENCE)
                self.assertEqual(found, [[]])

    def test_a_client_that_is_cut_off_looks_no_longer_than_it_should(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            over = threading.Event()

            def cut_off():
                while not over.is_set():
                    with contextlib.suppress(OSError):
                        server.accept()[0].close()
            thread = threading.Thread(target=cut_off)
            thread.start()
            client = Client(self.raynest, f"tcp://127.0.0.1:{server.getsockname()[1]}")
            client.environment["RAYNEST_RECONNECT"] = "1"
            begun = time.monotonic()
            done = client.run("scenes")
            seconds = time.monotonic() - begun
            over.set()
            socket.create_connection(server.getsockname()).close()
            thread.join()
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn("no RayNest daemon answers", done.stderr)
        self.assertGreaterEqual(seconds, 1)
        self.assertLess(seconds, PATIENCE / 2)

    def test_sockets_of_a_service_manager_are_found_by_their_addresses(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        path, ready = folder / "socket", folder / "ready.json"
        with socket.create_server(("127.0.0.1", 0)) as tcp, socket.socket(socket.AF_UNIX) as local, \
                socket.create_server(("127.0.0.1", 0)) as other:
            local.bind(str(path))
            local.listen()
            port, spare = tcp.getsockname()[1], other.getsockname()[1]

            def prepare():
                for number, end in enumerate((tcp, local, other), 60):
                    os.dup2(end.fileno(), number)
                for number in (3, 4, 5):
                    os.dup2(number + 57, number, inheritable=True)
            command = (f'LISTEN_FDS=3 LISTEN_PID=$$ exec "$0" --listen tcp://127.0.0.1:{port} --listen '
                       f'unix:{path} --http off --cuda off --ready-file {ready}')
            log = folder / "log"
            # With 3 to 5 taken, none of them is the pipe by which Popen() learns that the program runs.
            for _ in range(3):
                self.addCleanup(os.close, os.open(os.devnull, os.O_RDONLY))
            with open(log, "wb") as out:
                process = subprocess.Popen(["sh", "-c", command, self.raynestd], stderr=out,
                                           pass_fds=(3, 4, 5), preexec_fn=prepare)
            try:
                until(lambda: ready.exists() or process.poll() is not None)
                for uri in (f"tcp://127.0.0.1:{port}", f"unix:{path}"):
                    self.assertEqual(self.client(uri).run("scenes").returncode, 0, log.read_text())
                self.assertRegex(log.read_text(), f'socket_unused uri="?tcp://127.0.0.1:{spare}')
            finally:
                process.terminate()
                self.assertEqual(process.wait(PATIENCE), 0)
            self.assertTrue(path.exists(), "the socket's file is its owner's")

    def test_a_descriptor_that_is_no_listening_socket_is_refused(self):
        for uri in ("fd:0", "fd:999", "fd:x", "fd:", "tls://fd:0"):
            done = subprocess.run([self.raynestd, "--listen", uri], capture_output=True, text=True,
                                  stdin=subprocess.DEVNULL, timeout=PATIENCE, check=False)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn("is no listening socket", done.stderr)

    def test_a_scene_is_gone_after_a_restart_and_the_message_says_load(self):
        keeper = self.keeper()
        client, python = self.client(keeper.uri), self.python(keeper.uri)
        client.json("load", SCENE, "--name", "hills")
        hills = python.scene("hills")
        before = hills.trace(RAYS, fields=("t",))
        keeper.stop()
        keeper.start()
        done = client.run("query", "hills", "--ray", "0,50,0,0,-1,0")
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn("raynest load", done.stderr)
        with self.assertRaisesRegex(raynest.errors.InvalidError, "not loaded"):
            hills.trace(RAYS)
        again = python.load(SCENE, "hills")
        self.assertEqual(again.trace(RAYS, fields=("t",))["t"].tobytes(), before["t"].tobytes())

    def long_render(self, client, *more):
        """Starts a render that outlasts the test unless it is interrupted."""
        busy = client.start("render", "builtin:forest?trees=200", "--size", "1024x1024",
                            "--traversal", "reference", "-o", pathlib.Path(self.folder) / "a.png", *more)
        return busy

    def setUp(self):
        self.folder = self.enterContext(tempfile.TemporaryDirectory())

    def test_a_command_goes_on_with_the_next_daemon(self):
        for how in (signal.SIGKILL, signal.SIGTERM):
            keeper = self.keeper("--drain-ms-max", "300")
            client = self.client(keeper.uri)
            output = pathlib.Path(self.folder) / "hits.npz"
            # Each chunk takes long enough that the daemon ends in the middle of the answer.
            busy = client.start("render", "builtin:forest?trees=2000", "--size", "2048x2048",
                                "--spp", "16", "--integrator", "ao", "-o", f"{self.folder}/a.png",
                                "--deadline", "8")
            until(lambda: Client(self.raynest, keeper.uri).json("jobs")["jobs"])
            keeper.stop(how)
            keeper.start()
            _, errors = busy.communicate(timeout=4 * PATIENCE)
            self.assertIn(busy.returncode, (0, 8), errors)
            self.assertIn("the daemon went away; looking for it", errors)
            self.assertTrue((pathlib.Path(self.folder) / "a.png").exists())
            self.assertFalse(output.exists())

    def test_what_cannot_be_repeated_is_not(self):
        keeper = self.keeper("--drain-ms-max", "300")
        keeper_jobs = Client(self.raynest, keeper.uri)
        busy = self.client(keeper.uri).start("render", "builtin:forest?trees=2000", "--size",
                                             "2048x2048", "--traversal", "reference", "-o",
                                             f"{self.folder}/a.png")
        quick = Client(self.raynest, keeper.uri)  # RAYNEST_RECONNECT=0
        until(lambda: keeper_jobs.json("jobs")["jobs"])
        number = quick.json("render", "builtin:forest?trees=2000", "--size", "2048x2048",
                            "--traversal", "reference", "--detach")["job"]
        waits = quick.start("wait", number)
        time.sleep(0.2)
        keeper.stop(signal.SIGKILL)
        _, errors = waits.communicate(timeout=PATIENCE)
        self.assertEqual(waits.returncode, 1, errors)
        self.assertNotIn("looking for it", errors)
        busy.kill()
        busy.communicate()

    def test_a_detached_job_is_found_again_after_its_connection_broke(self):
        keeper = self.keeper()
        proxy = Cut(keeper.uri)
        client, python = self.client(proxy.uri), self.python(proxy.uri)
        direct = Client(self.raynest, keeper.uri)
        direct.json("load", "builtin:terrain?size=256", "--name", "hills")
        number = direct.json("render", "hills", "--size", "64x64", "--traversal", "reference",
                             "--detach")["job"]
        job = python.job(number)
        waits = client.start("wait", number)
        result = []
        thread = threading.Thread(target=lambda: result.append(job.wait()))
        thread.start()
        time.sleep(0.3)
        proxy.cut()
        output, errors = waits.communicate(timeout=4 * PATIENCE)
        self.assertEqual(waits.returncode, 0, errors)
        thread.join(4 * PATIENCE)
        self.assertEqual(result, [job])
        proxy.cut()
        self.assertEqual(job.fetch()[1:4], b"PNG")

    def test_nobody_is_refused_and_no_byte_is_wrong(self):
        clients, restarts = (50, 100) if LONG else (8, 4)
        keeper = self.keeper()
        expected = self.python(keeper.uri).load(SCENE, "hills").trace(
            RAYS, fields=("t", "prim"), kind="closest")
        expected = b"".join(expected[name].tobytes() for name in ("t", "prim"))
        counts = [0] * clients
        loads, problems = [], []
        over = threading.Event()

        def work(index):
            client = raynest.connect(keeper.uri, reconnect=4 * PATIENCE)
            hills = client.load(SCENE, "hills")
            while not over.is_set():
                try:
                    columns = hills.trace(RAYS, fields=("t", "prim"))
                    if b"".join(columns[name].tobytes() for name in ("t", "prim")) != expected:
                        problems.append("other bytes")
                    counts[index] += 1
                except raynest.errors.InvalidError as error:
                    if error.name != "SCENE_UNKNOWN":
                        problems.append(repr(error))
                    loads.append(index)
                    hills = client.load(SCENE, "hills")
                except raynest.errors.Error as error:
                    problems.append(repr(error))
                time.sleep(0.01)
            client.close()
        threads = [threading.Thread(target=work, args=(i,)) for i in range(clients)]
        for thread in threads:
            thread.start()
        try:
            begun = time.monotonic()
            for _ in range(restarts):
                seen = list(counts)
                # Everybody has an answer of this daemon before the next one.
                until(lambda: all(now > then for now, then in zip(counts, seen)),
                      lambda: f"{sum(now > then for now, then in zip(counts, seen))} of {clients} "
                              f"went on; {problems[:3]}", 4 * PATIENCE)
                self.assertEqual(keeper.stop(), 0, keeper.logs[-1].read_text()[-500:])
                keeper.start()
        finally:
            over.set()
            for thread in threads:
                thread.join()
        print(f"{restarts} restarts under {clients} clients in {time.monotonic() - begun:.0f} s: "
              f"{sum(counts)} answers, {len(loads)} loads of a missing scene, {len(problems)} problems",
              file=sys.stderr)
        self.assertEqual(problems, [])
        self.assertGreaterEqual(len(loads), restarts)


if __name__ == "__main__":
    main()
