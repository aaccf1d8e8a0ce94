"""A real raynestd and the raynest command line, for the tests in this folder.

A daemon listens on a free loopback port and ends with the test; every wait has a deadline.
"""
import contextlib
import copy
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
import unittest

# A daemon that a test ends does not come back: the Python client looks for no other one.
os.environ.setdefault("RAYNEST_RECONNECT", "0")

PATIENCE = float(os.environ.get("RAYNEST_PATIENCE", "30"))  # s, as in tests/patience.h
LONG = "RAYNEST_LONG" in os.environ  # tests/run.sh --long
SHARED_SCENES = (pathlib.Path(__file__).resolve().parent / "../../../shared/scenes").resolve()


def until(condition, why=lambda: "it did not come true", patience=PATIENCE):
    """Calls `condition` until it returns a true value, and returns that; `why` explains a
    failure when patience ends first."""
    end = time.monotonic() + patience
    while not (answer := condition()):
        if time.monotonic() > end:
            raise AssertionError(why())
        time.sleep(0.01)
    return answer


@contextlib.contextmanager
def closed_port():
    """Returns the URI of a port that nobody listens on, and nobody can meanwhile."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"tcp://127.0.0.1:{taken.getsockname()[1]}"


def children(pid, word):
    """Returns process ids of the children of a process whose command line has the word."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and word.encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except (OSError, IndexError):
            pass
    return found


def device_workers(pid):
    return children(pid, "--device-worker")


def is_sanitized(program):
    """True if the program is built with a sanitizer, which slows it down and enlarges its
    memory. tests/sanitized.h does this for C++."""
    code = pathlib.Path(program).read_bytes()
    return b"__asan_init" in code or b"__tsan_init" in code


IMPORTS_GROW = "enlarges the import's process, which counts towards --memory"


def skip_sanitized(test, program, why):
    """Skips a test of which a sanitizer itself breaks what it looks at: memory, page faults, system calls."""
    if is_sanitized(program):
        test.skipTest("skipped: a sanitizer " + why)


class Daemon:
    def __init__(self, program, *arguments, under=()):
        """Starts a daemon. `under` is a command that runs it, such as prlimit. Unless `--cuda`
        is given, the daemon does not use the machine's GPU; unless `--http` is, it has no page."""
        for option in ("--cuda", "--http"):
            if option not in arguments:
                arguments = (option, "off", *arguments)
        self.folder = tempfile.TemporaryDirectory(prefix="raynest-test-")
        ready = pathlib.Path(self.folder.name) / "ready.json"
        with open(pathlib.Path(self.folder.name) / "log", "wb") as log:
            self.process = subprocess.Popen(
                [*under, program, "--listen", "tcp://127.0.0.1:0", "--ready-file", ready, *arguments],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            until(lambda: ready.exists() or not self.alive())
            content = json.loads(ready.read_text())
            self.listen = content["listen"]
            self.uri = self.listen[0]
            self.http = content["http"]
        except Exception as error:
            self.process.kill()
            self.process.wait()
            raise RuntimeError("raynestd did not become ready: " + self.log()) from error

    def log(self):
        return (pathlib.Path(self.folder.name) / "log").read_text(errors="replace")

    def resident_bytes(self, key="VmRSS"):
        for line in pathlib.Path(f"/proc/{self.process.pid}/status").read_text().splitlines():
            if line.startswith(key + ":"):
                return int(line.split()[1]) * 1024
        raise RuntimeError(f"no {key}")

    def alive(self):
        return self.process.poll() is None

    def stop(self):
        """Ends the daemon as a user would; it must end in time and without error."""
        self.process.send_signal(signal.SIGTERM)
        try:
            code = self.process.wait(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            code = "nothing, on SIGTERM"
        log = self.log()
        self.folder.cleanup()
        # A sanitizer's finding ends the daemon with its own exit code; a leak does so only at the
        # end.
        if code != 0:
            raise RuntimeError(f"raynestd ended with {code}: {log}")


class Client:
    """Runs `raynest` against one daemon."""

    def __init__(self, program, uri, token=None):
        self.program = program
        self.uri = uri
        # A daemon that a test ends does not come back: look for no other one.
        self.environment = {"RAYNEST_SERVER": uri, "RAYNEST_RECONNECT": "0", "RAYNEST_PYTHON": sys.executable,
                            **({"RAYNEST_TOKEN": token} if token else {})}

    def start(self, *arguments, **options):
        environment = dict(os.environ, **self.environment)
        return subprocess.Popen([self.program, *map(str, arguments)], env=environment,
                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True, errors="replace", **options)

    def run(self, *arguments, timeout=PATIENCE):
        process = self.start(*arguments)
        try:
            output, errors = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
        return subprocess.CompletedProcess(arguments, process.returncode, output, errors)

    def json(self, *arguments):
        """Runs a command that must succeed, and returns its answer, one object."""
        done = self.run("--json", *arguments)
        if done.returncode != 0:
            raise AssertionError(f"{arguments}: {done.returncode}: {done.stderr}")
        return json.loads(done.stdout)

    def fails(self, code, says, *arguments):
        """Runs a command that must end with `code` and one line, which has `says` in it."""
        done = self.run(*arguments)
        if done.returncode != code or done.stderr.count("\n") != 1 or says not in done.stderr:
            raise AssertionError(f"{arguments}: {done.returncode}, not {code} and {says!r}: {done.stderr}")
        return done


def load_test_of(client):
    """Returns raynest-load-test, which stands beside `raynest`, as a client of the same daemon."""
    other = copy.copy(client)
    other.program = pathlib.Path(client.program).with_name("raynest-load-test")
    return other


def second_principal(raynestd, cleanup):
    """Returns a daemon's options and a token: clients with it belong to `bob`, others to their
    address. `cleanup` is addCleanup() or addClassCleanup() of a test."""
    folder = tempfile.TemporaryDirectory(prefix="raynest tokens ")
    cleanup(folder.cleanup)
    options = ("--tokens", f"{folder.name}/tokens")
    added = subprocess.run([raynestd, "token", "add", "bob", "--role", "user", *options],
                           capture_output=True, text=True, check=True)
    return options, added.stdout.splitlines()[-1]


def run_tests():
    """Calls unittest.main(), with exit code 77, which ctest treats as skipped, if no test could
    run."""
    result = unittest.main(exit=False).result
    for _, reason in result.skipped:
        print(reason, file=sys.stderr)
    all_skipped = result.skipped and len(result.skipped) == result.testsRun
    sys.exit(77 if all_skipped else not result.wasSuccessful())


class Programs(unittest.TestCase):
    """Tests of both programs, which main() sets."""
    raynestd = raynest = None


def main():
    """Runs the tests of a file that was called with RAYNESTD RAYNEST, and perhaps names of tests."""
    Programs.raynestd, Programs.raynest = sys.argv[1:3]
    del sys.argv[1:3]
    os.umask(0o022)
    run_tests()


class DaemonTest(Programs):
    """The tests of a class share a daemon, a client of it and a folder."""
    arguments = ()  # the daemon's arguments
    loads = {}  # scenes that it has: names and sources

    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.socket = f"unix:{cls.out}/socket"
        cls.daemon = Daemon(cls.raynestd, "--listen", cls.socket, *cls.arguments)
        cls.addClassCleanup(cls.daemon.stop)
        cls.client = Client(cls.raynest, cls.daemon.uri)
        for name, source in cls.loads.items():
            cls.client.json("load", source, "--name", name)

    def fed(self, name, data):
        """Returns a pipe to which `data` is written once it is read."""
        path = self.out / name
        os.mkfifo(path)
        feeder = threading.Thread(target=lambda: path.write_bytes(data))
        feeder.start()
        self.addCleanup(feeder.join)
        return path
