#!/usr/bin/env python3
"""Tests what can be tested of the Debian packages without a fresh machine: their scripts on a folder in
place of the system, that two runs of cpack give the same bytes, and what they depend on.

  package_scripts_test.py SOURCE_DIR BUILD_DIR CMAKE
"""
import hashlib
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

SOURCE, BUILD, CMAKE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
PACKAGE = SOURCE / "server" / "package"
UNITS = ("raynestd.socket", "raynestd.service")
# Programs of the machine that the scripts must not run here: each writes its call to a file.
STUBS = {"adduser": "touch $DPKG_ROOT/user", "deluser": "rm $DPKG_ROOT/user", "getent": "test -e $DPKG_ROOT/user",
         "systemctl": "", "deb-systemd-invoke": ""}


class Scripts(unittest.TestCase):
    def setUp(self):
        if not shutil.which("deb-systemd-helper"):
            self.skipTest("skipped: there is no deb-systemd-helper (Debian: init-system-helpers)")
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-package-")))
        self.root = folder / "root"
        self.calls = folder / "calls"
        stubs = folder / "stubs"
        stubs.mkdir()
        for name, act in STUBS.items():
            (stubs / name).write_text(f'#!/bin/sh\necho {name} "$@" >>"{self.calls}"\n{act}\n')
            (stubs / name).chmod(0o755)
        self.environment = dict(os.environ, DPKG_ROOT=str(self.root), DPKG_MAINTSCRIPT_PACKAGE="raynest",
                                PATH=f"{stubs}:{os.environ['PATH']}")
        for name in ("run/systemd/system", "lib/systemd/system", "etc", "var/lib"):
            (self.root / name).mkdir(parents=True)

    def script(self, name, *arguments):
        """Runs a script as dpkg does. Returns the calls of the stubs."""
        self.calls.write_text("")
        subprocess.run(["sh", PACKAGE / name, *arguments], env=self.environment, check=True, timeout=60)
        return self.calls.read_text().splitlines()

    def install(self, *before):
        for unit in UNITS:
            shutil.copy(PACKAGE / unit, self.root / "lib/systemd/system")
        (self.root / "etc/raynest").mkdir(exist_ok=True)
        return self.script("postinst", "configure", *before)

    def remove(self):
        calls = self.script("prerm", "remove")
        for unit in UNITS:
            (self.root / "lib/systemd/system" / unit).unlink()
        return calls + self.script("postrm", "remove")

    def links(self):
        return sorted(path.name for path in self.root.glob("etc/systemd/system/*.wants/*"))

    def run_folder(self):
        """Makes what a daemon leaves in /run."""
        folder = self.root / "run/raynest"
        folder.mkdir()
        (folder / "socket").touch()
        return folder

    def check_started(self, calls):
        self.assertIn("deb-systemd-invoke start raynestd.socket", calls)
        self.assertIn("deb-systemd-invoke restart raynestd.service", calls)
        self.assertEqual(self.links(), sorted(UNITS))

    def test_an_installation_after_a_removal_enables_and_starts_again(self):
        self.check_started(self.install(""))
        folder = self.run_folder()
        calls = self.remove()
        self.assertIn("deb-systemd-invoke stop raynestd.socket raynestd.service", calls)
        self.assertFalse(folder.exists())
        self.check_started(self.install("0.1.0"))

    def test_what_an_administrator_disabled_stays_disabled(self):
        self.install("")
        for link in self.root.glob("etc/systemd/system/*.wants/*"):
            link.unlink()
        self.remove()
        self.install("0.1.0")
        self.assertEqual(self.links(), [])

    def test_a_purge_leaves_nothing(self):
        before = sorted(self.root.rglob("*"))
        self.install("")
        self.assertTrue((self.root / "user").exists())
        (self.root / "var/lib/raynest").mkdir()
        self.run_folder()
        self.remove()
        self.script("postrm", "purge")
        left = [path for path in self.root.rglob("*") if path not in before and not path.is_dir()]
        self.assertEqual(left, [])
        for name in ("run", "etc", "var/lib"):
            self.assertFalse((self.root / name / "raynest").exists())


class Packages(unittest.TestCase):
    def setUp(self):
        for program in ("cpack", "dpkg-shlibdeps", "dpkg-parsechangelog"):
            if not shutil.which(program):
                self.skipTest(f"skipped: there is no {program}")
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-package-")))

    def test_two_runs_give_the_same_bytes(self):
        sums = set()
        for run in ("one", "two"):
            made = self.folder / run
            environment = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
            subprocess.run(["cpack", "-G", "DEB", "-B", made, "-D", "CPACK_COMPONENTS_ALL=python"], cwd=BUILD,
                           env=environment, check=True, capture_output=True, timeout=300)
            package, = made.glob("*.deb")
            sums.add(hashlib.sha256(package.read_bytes()).hexdigest())
            begun = int(time.time())
            while int(time.time()) == begun:  # times in packages have whole seconds
                time.sleep(0.1)
        self.assertEqual(len(sums), 1)

    def test_the_library_for_pictures_is_only_recommended(self):
        if not (BUILD / "lib/raynest/images/raynest-images.so").exists():
            self.skipTest("skipped: built without OpenImageIO")
        script = self.folder / "print.cmake"
        script.write_text(f'set(CPACK_COMPONENTS_ALL runtime)\nset(CPACK_RAYNEST_BUILD "{self.folder}")\n'
                          f'set(CPACK_RAYNEST_CHANGELOG "{PACKAGE}/changelog")\n'
                          f'include("{SOURCE}/.ci/package_run.cmake")\n'
                          'message("Depends: ${CPACK_DEBIAN_RUNTIME_PACKAGE_DEPENDS}")\n'
                          'message("Recommends: ${CPACK_DEBIAN_RUNTIME_PACKAGE_RECOMMENDS}")\n')
        for name in ("bin", "lib"):
            (self.folder / name).symlink_to(BUILD / name)
        done = subprocess.run([CMAKE, "-P", script], capture_output=True, text=True, check=False, timeout=300)
        self.assertEqual(done.returncode, 0, done.stderr)
        depends, recommends = (re.search(rf"^{field}: (.*)$", done.stderr, re.M)[1]
                               for field in ("Depends", "Recommends"))
        self.assertIn("libopenimageio", recommends)
        self.assertNotIn("libopenimageio", depends)
        self.assertNotIn("opencv", depends)
        for name in ("libc6", "libssl", "adduser"):
            self.assertIn(name, depends)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
