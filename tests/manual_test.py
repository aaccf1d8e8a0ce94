#!/usr/bin/env python3
"""Tests the man pages and the completions of bash and zsh that .ci/manual.py writes, in those programs.

  manual_test.py SOURCE RAYNEST RAYNESTD
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE, RAYNEST, RAYNESTD = map(pathlib.Path, sys.argv[1:4])
SECONDS_MAX = 60
# Stand-ins that print what the completion would offer.
ZSH_STUBS = """
_arguments() { print -rl -- "$@" }
_describe() { print -rl -- ${(P)2} }
_files() { print files }
"""


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True,
                          stdin=subprocess.DEVNULL, timeout=SECONDS_MAX, check=False, **options)


class Manual(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        made = run("/usr/bin/python3", SOURCE / ".ci/manual.py", cls.folder, RAYNEST, RAYNESTD,
                   env=dict(os.environ, LC_ALL="C.UTF-8"))
        if made.returncode != 0:
            raise AssertionError(made.stderr)

    def test_every_command_and_option_of_the_help_is_in_the_man_page(self):
        for program, page in ((RAYNEST, "raynest.1"), (RAYNESTD, "raynestd.8")):
            text = (self.folder / page).read_text().replace("\\-", "-")
            helps = run(program, "--help").stdout
            for flag in set(re.findall(r"(?m)^  (?:-\w,)?(--[\w-]+)", helps)):
                self.assertIn(flag, text)
        commands = re.findall(r"(?m)^  ([a-z][\w-]*)\s", run(RAYNEST, "--help").stdout.split(
            "Subcommands:")[1])
        page = (self.folder / "raynest.1").read_text().replace("\\-", "-")
        self.assertGreater(len(commands), 15)
        for command in commands:
            self.assertIn(f'.SS "raynest {command}"', page)

    def test_man_shows_the_pages_without_a_warning(self):
        if not shutil.which("man"):
            self.skipTest("skipped: there is no man (Debian: man-db)")
        for page in ("raynest.1", "raynestd.8"):
            shown = run("man", "--warnings", "-l", self.folder / page,
                        env=dict(os.environ, LC_ALL="C.UTF-8", MANROFFSEQ="", MANWIDTH="80"))
            self.assertEqual((shown.returncode, shown.stderr), (0, ""))
            self.assertIn("OPTIONS", shown.stdout)

    def offered_by_bash(self, *words):
        name = words[0]
        script = (f'source "$1"; complete -p {name} >&2; COMP_WORDS=("${{@:2}}"); '
                  f'COMP_CWORD=$(($#-2)); _{name}; printf "%s\\n" "${{COMPREPLY[@]}}"')
        done = run("bash", "-c", script, "bash", self.folder / f"{name}.bash", *words,
                   cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stderr, f"complete -o filenames -F _{name} {name}\n")
        return done.stdout.split()

    def test_bash_completes_commands_options_and_values(self):
        for words, offered in ((("raynest", "hea"), ["heatmap"]),
                               (("raynest", "heatmap", "--pal"), ["--palette"]),
                               (("raynest", "--server", "x", "unload", "--al"), ["--all"]),
                               (("raynest", "--tls-verify", ""), ["on", "off"]),
                               (("raynest", "admin", "k"), ["kick"]),
                               (("raynestd", "tok"), ["token"]),
                               (("raynestd", "token", "re"), ["revoke"]),
                               (("raynestd", "tls", "init", "--ho"), ["--host"]),
                               (("raynestd", "--listen", ""), sorted(os.listdir(self.folder)))):
            self.assertEqual(sorted(self.offered_by_bash(*words)), sorted(offered), words)
        self.assertIn("load", self.offered_by_bash("raynest", ""))

    def offered_by_zsh(self, *words):
        script = (ZSH_STUBS + 'words=("${@:2}"); CURRENT=$#words; PREFIX=$words[CURRENT]; '
                  'complete() { source "$1" }; complete "$1"')
        done = run("zsh", "-f", "-c", script, "zsh", self.folder / f"_{words[0]}", *words)
        self.assertEqual(done.stderr, "", words)
        return done.stdout.splitlines()

    def test_zsh_completes_commands_options_and_values(self):
        if not shutil.which("zsh"):
            self.skipTest("skipped: there is no zsh")
        for words, offered in ((("raynest", ""), r"heatmap:."),
                               (("raynest", "heatmap", "--pal"), r"--palette\[.+\]:value:"),
                               (("raynest", "--tls"), r"--tls-verify\[.+\]:value:\(on off\)"),
                               (("raynestd", "token", ""), r"revoke:."),
                               (("raynestd", "tls", "init", "-"), r"--host\[.+\]:value:_files")):
            found = self.offered_by_zsh(*words)
            self.assertTrue(any(re.match(offered, line) for line in found), (words, found))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
