#!/usr/bin/env python3
"""ssh://HOST from the command line and from Python: ssh ends with the program, however that ends, and
holds nothing of it.

  ssh_test.py RAYNESTD RAYNEST FLATC
"""
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile

from both_clients import BothClients
from daemon import PATIENCE, Daemon, Programs, until
from secure_daemon import fake_ssh
from with_daemon import main

# The program of the Python client: it says "ready", and ends as its second argument says.
PROGRAM = """
import os, signal, sys, threading, time, raynest
c = raynest.connect(sys.argv[1])
def ready():
    print("ready", flush=True)
def endless():
    while True:
        time.sleep(60)
how = sys.argv[2]
if how == "close":
    c.close()
elif how == "raise":
    raise SystemExit(7)
elif how == "forget":
    del c
    ready()
    endless()
elif how == "_exit":
    os._exit(0)
elif how == "fork":  # the child outlives its parent
    if os.fork() == 0:
        os.close(1), os.close(2)
        time.sleep(60)
    os._exit(0)
elif how == "interrupt":
    try:
        os.killpg(0, signal.SIGINT)
        endless()
    except KeyboardInterrupt:
        pass
    c.ping()
elif how == "wait":
    ready()
    endless()
ready()
"""
THREAD = """
import sys, threading, raynest
made = []
thread = threading.Thread(target=lambda: made.append(raynest.connect(sys.argv[1])))
thread.start()
thread.join()
for _ in range(20):
    made[0].ping()
"""


def lives(process):
    """True for a process that runs: a zombie does not."""
    try:
        return pathlib.Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


class Ssh(Programs):
    @classmethod
    def setUpClass(cls):
        cls.out = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        cls.daemon = Daemon(cls.raynestd, "--listen", f"unix:{cls.out}/socket")
        cls.addClassCleanup(cls.daemon.stop)
        cls.programs = fake_ssh(cls.out / "bin", "me@gpu", "2222")
        cls.uri = f"ssh://me@gpu:2222{cls.out}/socket"

    def setUp(self):
        self.both = BothClients(self.raynest, self.out / "config")
        self.environment = {**self.both.environment, "PATH": f"{self.programs}:{os.environ['PATH']}"}
        self.state = self.programs / "state"
        self.state.unlink(missing_ok=True)

    def start(self, *words, **environment):
        process = subprocess.Popen(words, env={**self.environment, **environment}, text=True,
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   start_new_session=True)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        self.addCleanup(self.end_ssh)
        return process

    def end_ssh(self):
        """Ends the one of a test that failed: it may hold the program's output."""
        if self.state.exists() and lives(ssh := json.loads(self.state.read_text())[0]):
            os.kill(ssh, signal.SIGKILL)

    def start_python(self, how):
        return self.start(sys.executable, "-c", PROGRAM, self.uri, how)

    def start_command(self):
        """`top` looks once a second until it is ended."""
        process = self.start(self.raynest, "--server", self.uri, "--json", "top")
        process.stdout.readline()
        return process

    def assert_nothing_is_left(self, process):
        """The reader of the program's output comes to its end."""
        said = process.communicate(timeout=PATIENCE)
        ssh, socket, _ = json.loads(self.state.read_text())
        until(lambda: not lives(ssh), lambda: f"ssh is left: {said}")
        until(lambda: not os.path.exists(os.path.dirname(socket)), lambda: f"{socket} is left: {said}")
        return said

    def test_ssh_ends_with_the_command_line_s_program(self):
        done = self.start(self.raynest, "--server", self.uri, "scenes")
        self.assert_nothing_is_left(done)
        self.assertEqual(done.returncode, 0)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL):
            with self.subTest(number=number):
                process = self.start_command()
                process.send_signal(number)
                self.assert_nothing_is_left(process)

    def test_ssh_ends_with_python_s_program(self):
        for how, code in (("close", 0), ("end", 0), ("raise", 7), ("_exit", 0), ("fork", 0)):
            with self.subTest(how=how):
                process = self.start_python(how)
                self.assert_nothing_is_left(process)
                self.assertEqual(process.returncode, code)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL):
            with self.subTest(number=number):
                process = self.start_python("wait")
                self.assertEqual(process.stdout.readline(), "ready\n")
                process.send_signal(number)
                self.assert_nothing_is_left(process)

    def test_ssh_ends_with_the_last_use_of_its_client(self):
        process = self.start_python("forget")
        self.assertEqual(process.stdout.readline(), "ready\n")
        until(lambda: not lives(json.loads(self.state.read_text())[0]))

    def test_ctrl_c_of_a_terminal_ends_the_request_and_not_ssh(self):
        process = self.start_python("interrupt")
        said, errors = self.assert_nothing_is_left(process)
        self.assertEqual((process.returncode, said), (0, "ready\n"), errors)
        process = self.start_command()
        os.killpg(process.pid, signal.SIGINT)
        self.assert_nothing_is_left(process)
        self.assertEqual(process.returncode, 0)

    def test_ssh_outlives_the_thread_that_connected(self):
        process = self.start(sys.executable, "-c", THREAD, self.uri)
        _, errors = self.assert_nothing_is_left(process)
        self.assertEqual(process.returncode, 0, errors)

    def test_ssh_is_not_shown_the_token(self):
        for _, done in self.both.run(self.uri, **self.environment, RAYNEST_TOKEN="rnt_1"):
            self.assertIn(done.returncode, (0, 4), done.stderr)
            _, _, environment = json.loads(self.state.read_text())
            self.assertNotIn("RAYNEST_TOKEN", environment)
            self.assertIn("PATH", environment)

    def says(self, uri, code, *texts, **environment):
        for name, done in self.both.run(uri, **{**self.environment, "RAYNEST_RECONNECT": "30", **environment}):
            with self.subTest(client=name, uri=uri):
                self.assertEqual(done.returncode, code, done.stderr)
                self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
                for text in texts:
                    self.assertIn(text, done.stderr)

    def test_addresses_that_ssh_would_take_for_more_are_refused(self):
        for host in ("-oProxyCommand=x", "me@-oProxyCommand", "me@", "@gpu", "a@b@gpu", "gpu:-p", "gpu:22x",
                     "gpu/${HOME}", "gpu/%h", "gpu/a:b", "gpu/a\nb", "gpu/\x1b[31m", "gpu ls", "", "gpu;ls"):
            self.says(f"ssh://{host}", 2, "is not ssh://")
        self.assertFalse(self.state.exists())

    def test_ssh_s_reason_is_told_in_the_one_line(self):
        self.says("ssh://elsewhere", 3, "ssh to elsewhere failed: ssh: Could not resolve hostname elsewhere")
        self.says("ssh://elsewhere", 3, "cannot start ssh", PATH=str(self.out))

    def test_a_machine_without_a_daemon_is_told_after_one_try(self):
        self.says(f"ssh://me@gpu:2222{self.out}/none", 3, "no daemon answers on me@gpu",
                  "open failed: connect failed: No such file or directory")


if __name__ == "__main__":
    main()
