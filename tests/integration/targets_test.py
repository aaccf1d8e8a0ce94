#!/usr/bin/env python3
"""Tests engine/packs/TARGETS.md: its commands print what it shows but for the target of this machine, and a daemon
says its target in the log and to Prometheus, is forced to another, and refuses one that it cannot have.

  targets_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import re
import subprocess
import tempfile
import unittest
import urllib.request

from daemon import PATIENCE, Client, Daemon, DaemonTest, main

PAGE = (pathlib.Path(__file__).parents[2] / "engine/packs/TARGETS.md").read_text()


def shown(text):
    """What the page and a command agree on: the best target, and those below it, are the machine's."""
    return re.sub(r'v\d("?,? ?"?v\d)*', "v", text).strip()


class Targets(DaemonTest):
    def opaque(self, uri):
        return next(each for each in Client(self.raynest, uri).json("variants")["variants"] if each["name"] == "opaque")

    def test_the_commands_of_the_page_print_what_it_shows(self):
        if "v2" not in self.opaque(self.daemon.uri)["targets"]:
            self.skipTest("skipped: this build has no pack of v2")
        environment = {**os.environ, "RAYNEST_SERVER": self.daemon.uri,
                       "PATH": f"{pathlib.Path(self.raynest).parent}{os.pathsep}{os.environ['PATH']}"}
        console = "".join(re.findall(r"(?ms)^```console\n(.*?)^```", PAGE))
        commands = re.findall(r"(?m)^\$ (.*)\n(.*)$", console)
        self.assertEqual(len(commands), 5)
        for command, prints in commands:
            with self.subTest(command=command):
                done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True,
                                      timeout=PATIENCE, check=False)
                told = done.stdout or done.stderr
                if "RAYNEST_TARGET" in command or "v9" in command:
                    self.assertEqual(told.strip(), prints)
                else:
                    self.assertEqual(shown(told), shown(prints))

    def test_the_table_names_the_targets_of_help(self):
        help_text = subprocess.run([self.raynestd, "--help"], capture_output=True, text=True, check=True).stdout
        named = re.search(r"Kernel pack: auto, (.*)", help_text)[1].split(", ")
        self.assertEqual(re.findall(r"(?m)^\| `(v\d)` \|", PAGE), named)

    def test_the_log_and_prometheus_say_it(self):
        for forced in ((), ("--target", self.opaque(self.daemon.uri)["targets"][-1])):
            daemon = Daemon(self.raynestd, *forced, "--http", "127.0.0.1:0")
            self.addCleanup(daemon.stop)
            target = self.opaque(daemon.uri)["target"]
            self.assertRegex(daemon.log().splitlines()[0], rf" started .* target={target}$")
            with urllib.request.urlopen(f"{daemon.http}/metrics", timeout=PATIENCE) as metrics:
                self.assertRegex(metrics.read().decode(), rf'(?m)^raynest_build_info{{.*isa="{target}".*}} 1$')

    def test_a_forced_target_is_the_only_one(self):
        best = self.opaque(self.daemon.uri)
        self.assertEqual(best["target"], best["targets"][0])
        daemon = Daemon(self.raynestd, "--target", best["targets"][-1])
        self.addCleanup(daemon.stop)
        self.assertEqual(self.opaque(daemon.uri)["targets"], best["targets"][-1:])

    def test_a_folder_without_packs_of_the_target_is_told(self):
        with tempfile.TemporaryDirectory() as empty:
            done = subprocess.run([self.raynestd, "--listen", f"unix:{empty}/socket", "--http", "off"],
                                  env={**os.environ, "RAYNEST_BUILTIN_PACKS": empty}, capture_output=True, text=True,
                                  timeout=PATIENCE, check=False)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(f"no kernel pack for this CPU in {empty}", done.stdout + done.stderr)


if __name__ == "__main__":
    main()
