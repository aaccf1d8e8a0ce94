#!/usr/bin/env python3
"""The demo draws its pictures and never leaves a daemon behind, however it ends.

  demo_test.py BUILD_FOLDER      the build that the demo finds up to date
"""
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

DEMO = pathlib.Path(__file__).resolve().parent.parent / "client" / "demo.sh"
SECONDS_MAX = 240


class Demo(unittest.TestCase):
    build = None

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="a demo ")))
        (self.folder / "tmp").mkdir()

    def start(self, *arguments):
        environment = dict(os.environ, RAYNEST_BUILD=str(self.build),
                           RAYNEST_DEMO_OUT=str(self.folder / "pictures"),
                           TMPDIR=str(self.folder / "tmp"))
        return subprocess.Popen(["bash", DEMO, *arguments], cwd=self.folder, env=environment,
                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, text=True, start_new_session=True)

    def daemons(self):
        """Processes of this demo: all of them name its temporary folder."""
        found = []
        for entry in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
            try:
                command = entry.read_bytes()
            except OSError:
                continue
            if b"raynestd" in command and str(self.folder).encode() in command:
                found.append(int(entry.parent.name))
        return found

    def assert_nothing_left(self):
        self.assertEqual(self.daemons(), [])
        self.assertEqual(list((self.folder / "tmp").iterdir()), [])

    def test_five_different_pictures(self):
        demo = self.start("builtin:forest?trees=40")
        output, _ = demo.communicate(timeout=SECONDS_MAX)
        self.assertEqual(demo.returncode, 0, output)
        pictures = {path.name: path.read_bytes() for path in (self.folder / "pictures").iterdir()}
        self.assertEqual(sorted(pictures), ["alpha_mask.png", "heat.png", "opaque.png", "path.png",
                                            "procedural_mask.png"])
        for name, data in pictures.items():
            self.assertEqual(data[:8], b"\x89PNG\r\n\x1a\n", name)
            self.assertIn(str(self.folder / "pictures" / name), output)
        self.assertEqual(len(set(pictures.values())), 5)
        self.assertRegex(output, r"[\d.]+ Mrays/s")
        self.assertRegex(output, r"path \d+ is \S+/\S+", "a hit through nested instances")
        self.assert_nothing_left()

    def test_open_keeps_the_daemon_until_ctrl_c_and_prints_the_page_s_address(self):
        demo = self.start("--open", "builtin:forest?trees=10")
        address = ""
        for line in demo.stdout:
            if line.startswith("http://"):
                address = line.strip()
                break
        self.assertRegex(address, r"^http://127\.0\.0\.1:\d+/#scene=forest&code=[0-9a-f]+$")
        with urllib.request.urlopen(address.split("#")[0], timeout=30) as page:
            self.assertEqual(page.status, 200)
        os.killpg(demo.pid, signal.SIGINT)
        demo.communicate(timeout=SECONDS_MAX)
        self.assertEqual(demo.returncode, 130)
        self.assert_nothing_left()

    def test_a_scene_that_is_not_there(self):
        demo = self.start(str(self.folder / "missing.glb"))
        output, _ = demo.communicate(timeout=SECONDS_MAX)
        self.assertNotEqual(demo.returncode, 0)
        self.assertIn("missing.glb", output)
        self.assert_nothing_left()

    def test_interrupted(self):
        demo = self.start()
        deadline = time.monotonic() + SECONDS_MAX
        while not self.daemons() and demo.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        self.assertTrue(self.daemons(), "the demo started no daemon")
        os.killpg(demo.pid, signal.SIGINT)
        output, _ = demo.communicate(timeout=SECONDS_MAX)
        self.assertEqual(demo.returncode, 130, output)
        self.assert_nothing_left()


if __name__ == "__main__":
    Demo.build = pathlib.Path(sys.argv.pop(1)).resolve()
    unittest.main()
