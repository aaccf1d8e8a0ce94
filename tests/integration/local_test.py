#!/usr/bin/env python3
"""Checks files in the place of a scene's name, and --local, the daemon of one command.

  local_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile

from daemon import DaemonTest, PATIENCE, Programs, main, until
from picture_test import coloured_square

AT_SQUARE = ("--ray", "0.5,0.2,5,0,0,-1")


def processes_with(text):
    """Returns the ids of processes whose command line has `text`."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            if text.encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:
            pass
    return found


class Files(DaemonTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        (cls.out / "square.gltf").write_text(coloured_square())

    def names(self):
        return [line.split()[0] for line in self.client.run("scenes").stdout.splitlines()[1:]]

    def test_a_file_takes_the_place_of_a_scene_and_goes_with_its_command(self):
        file = self.out / "square.gltf"
        before = self.names()
        hit = self.client.run("--json", "query", file, *AT_SQUARE)
        self.assertEqual(json.loads(hit.stdout)["hits"][0]["t"], 5)
        info = self.client.json("info", file)
        self.assertEqual(info["unique_triangles"], 2)
        self.assertTrue(info["name"].startswith("square-"), info["name"])
        for command, ending in (("heatmap", "npy"), ("render", "npy")):
            told = self.client.json(command, file, "-o", self.out / f"a.{ending}", "--size", "8x8")
            self.assertEqual((told["scene"], told["rays"]), (info["name"], 64))
        self.assertEqual(self.client.json("query", "builtin:terrain?size=8", "--ray",
                                          "0.3,100,0.4,0,-1,0")["ray"], 0)
        until(lambda: self.names() == before, self.names)

    def test_a_file_stands_in_the_way_of_no_scene_of_its_name(self):
        self.client.json("load", "builtin:terrain?size=8", "--name", "square")
        triangles = self.client.json("info", self.out / "square.gltf")["unique_triangles"]
        self.assertEqual(triangles, 2)
        self.assertGreater(self.client.json("info", "square")["unique_triangles"], 2)

    def test_a_file_that_is_no_scene_is_named(self):
        (self.out / "broken.glb").write_bytes(b"glTF\0\0\0\0")
        for file in ("broken.glb", "missing.glb"):
            self.client.fails(5, file, "info", self.out / file)


class Local(Programs):
    def setUp(self):
        self.out = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-local-")))
        self.temporary = self.out / "tmp"
        self.temporary.mkdir()
        (self.out / "square.gltf").write_text(coloured_square())
        # The address of another daemon is no obstacle.
        self.environment = dict(os.environ, TMPDIR=str(self.temporary), RAYNEST_SERVER="unix:/no")
        self.bin = self.out / "bin"
        self.bin.mkdir()

    def run_raynest(self, *arguments, program=None, **options):
        return subprocess.run([program or self.raynest, "--local", *map(str, arguments)],
                              env=dict(self.environment, **options), capture_output=True, text=True,
                              timeout=PATIENCE, stdin=subprocess.DEVNULL)

    def assert_nothing_is_left(self):
        until(lambda: not processes_with(str(self.temporary)),
              lambda: f"processes {processes_with(str(self.temporary))} are left")
        self.assertEqual(list(self.temporary.iterdir()), [])

    def test_one_line_answers_without_a_daemon(self):
        done = self.run_raynest("--json", "query", self.out / "square.gltf", *AT_SQUARE)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(json.loads(done.stdout)["hits"][0]["t"], 5)
        self.assert_nothing_is_left()

    def test_a_failure_keeps_its_exit_code(self):
        done = self.run_raynest("info", self.out / "missing.glb")
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assert_nothing_is_left()

    def start_long(self, **options):
        """Starts a command of minutes, and returns it once its daemon traces."""
        process = subprocess.Popen(
            [self.raynest, "--local", "--quiet", "render", self.out / "square.gltf", "--size",
             "4096x4096", "--spp", "1024", "-o", self.out / "long.png"], env=self.environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        # The folder goes as soon as the client is connected.
        until(lambda: processes_with(str(self.temporary)) or process.poll() is not None)
        until(lambda: not list(self.temporary.iterdir()) or process.poll() is not None)
        self.assertIsNone(process.poll())
        return process

    def test_ctrl_c_ends_the_daemon_too(self):
        process = self.start_long()
        process.send_signal(signal.SIGINT)
        self.assertEqual(process.wait(PATIENCE), 130)
        self.assert_nothing_is_left()

    def test_a_killed_command_leaves_no_daemon(self):
        process = self.start_long()
        process.kill()
        process.wait(PATIENCE)
        self.assert_nothing_is_left()

    def test_the_end_of_the_terminal_ends_the_daemon_too(self):
        process = self.start_long()
        process.send_signal(signal.SIGHUP)
        self.assertEqual(process.wait(PATIENCE), 130)
        self.assert_nothing_is_left()

    def test_the_daemon_has_nothing_of_the_program(self):
        reading, writing = os.pipe()
        self.addCleanup(os.close, reading)
        self.environment["RAYNEST_TOKEN"] = "rnt_secret"
        process = self.start_long(pass_fds=(writing,))
        os.close(writing)
        # A child that the daemon starts has its command line for a moment.
        daemon, = until(lambda: len(found := processes_with(str(self.temporary))) == 1 and found)
        folder = pathlib.Path(f"/proc/{daemon}")
        self.assertNotIn(f"pipe:[{os.stat(reading).st_ino}]",
                         {os.readlink(entry) for entry in (folder / "fd").iterdir()})
        self.assertEqual({os.readlink(folder / "fd" / number) for number in "01"}, {"/dev/null"})
        self.assertNotIn(b"rnt_secret", (folder / "environ").read_bytes())
        process.kill()
        process.wait(PATIENCE)
        self.assert_nothing_is_left()

    def copy_alone(self):
        shutil.copy(self.raynest, self.bin / "raynest")
        return self.bin / "raynest"

    def test_without_a_daemon_s_program_one_line_says_so(self):
        done = self.run_raynest("info", self.out / "square.gltf", program=self.copy_alone(),
                                PATH="/nonexistent")
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn("no raynestd beside raynest, nor on PATH", done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1)
        self.assert_nothing_is_left()

    def test_a_daemon_that_does_not_start_says_why(self):
        fake = self.bin / "raynestd"
        fake.write_text("#!/bin/sh\necho 'no kernels for this machine' >&2\nexit 1\n")
        fake.chmod(0o755)
        done = self.run_raynest("info", self.out / "square.gltf", program=self.copy_alone())
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn("no kernels for this machine", done.stderr)
        self.assert_nothing_is_left()


class Browser(DaemonTest):
    arguments = ("--http", "127.0.0.1:0")

    def test_a_browser_that_goes_on_holds_nothing(self):
        """xdg-open may be the browser itself: `raynest open` ends, and with it its output."""
        noted = self.out / "noted"
        (self.out / "xdg-open").write_text(f'#!/bin/sh\necho $$ > "{noted}.new" && mv "{noted}.new" "{noted}"\n'
                                           "exec sleep 600\n")
        (self.out / "xdg-open").chmod(0o755)
        reading, writing = os.pipe()
        self.addCleanup(os.close, reading)
        environment = {"DISPLAY": ":99", "PATH": f"{self.out}:{os.environ['PATH']}",
                       "RAYNEST_SERVER": self.daemon.uri, "RAYNEST_TOKEN": ""}
        done = subprocess.run([self.raynest, "open"], env={**os.environ, **environment}, capture_output=True,
                              text=True, timeout=PATIENCE, stdin=subprocess.DEVNULL, pass_fds=(writing,))
        os.close(writing)
        browser = int(noted.read_text())
        self.addCleanup(os.kill, browser, signal.SIGKILL)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        folder = pathlib.Path(f"/proc/{browser}")
        self.assertEqual({os.readlink(entry) for entry in (folder / "fd").iterdir()}, {"/dev/null"})
        self.assertEqual(os.getsid(browser), browser)
        self.assertNotIn(b"RAYNEST_TOKEN", (folder / "environ").read_bytes())


if __name__ == "__main__":
    main()
