#!/usr/bin/env python3
"""Tests a newcomer's messages: the first steps, how to start a daemon, the wrong word and its
remedy, in each client's own words; progress of long commands, and how Ctrl-C ends them.

  first_hour_test.py RAYNESTD RAYNEST
"""
import io
import json
import os
import pathlib
import pty
import re
import select
import signal
import subprocess
import sys
import time
from unittest import mock

import numpy

from daemon import Client, Daemon, DaemonTest, PATIENCE, closed_port, main, until

ROOT = pathlib.Path(__file__).resolve().parents[2]


def children(pid):
    """Returns process ids of a process's children."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            if int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1]) == pid:
                found.append(int(entry.name))
        except (OSError, IndexError):
            pass
    return found


class FirstHour(DaemonTest):
    loads = {"hills": "builtin:terrain?size=32"}

    def says(self, code, words, *arguments):
        done = self.client.run(*arguments)
        self.assertEqual(done.returncode, code, done.stderr)
        for word in (words,) if isinstance(words, str) else words:
            self.assertIn(word, done.stderr)
        return done.stderr

    def test_spaces_around_commas_are_no_mistake(self):
        spaced, plain = (self.client.run("query", "hills", "--ray", ray, "--fields", fields)
                         for ray, fields in (("0, 90 ,0, 0,-1, 0", "t, prim"),
                                             ("0,90,0,0,-1,0", "t,prim")))
        self.assertEqual((spaced.returncode, spaced.stdout), (0, plain.stdout), spaced.stderr)
        self.says(2, "'0 0,90,0,0,-1,0'", "query", "hills", "--ray", "0 0,90,0,0,-1,0")

    def test_what_is_not_what_it_was_taken_for_is_said(self):
        self.says(5, ("no scene is called 'forest.fbx'", "raynest load"), "info",
                  "forest.fbx")
        self.says(2, "did you mean unix:/tmp/x/s?", "scenes", "--server", "/tmp/x/s")
        self.says(2, "unix:PATH", "scenes", "--server", "unix:")
        self.says(5, "from there as .glb", "load", "a.fbx")

    # ---- the first steps ------------------------------------------------------------------------

    def test_the_bare_name_shows_three_commands_that_work(self):
        said = self.says(2, "raynest --help")
        commands = [line.split() for line in said.splitlines() if line.startswith("  raynest ")]
        self.assertEqual(len(commands), 3)
        for command in commands:
            done = subprocess.run([self.raynest, *command[1:]], cwd=self.out, check=False,
                                  capture_output=True, timeout=PATIENCE,
                                  env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri))
            self.assertEqual(done.returncode, 0, done.stderr)
        self.client.run("unload", "forest")
        self.says(2, "raynest load builtin:forest", "--quiet")

    def test_who_finds_no_daemon_reads_how_to_start_one(self):
        with closed_port() as uri:
            done = Client(self.raynest, uri).run("scenes")
        self.assertEqual(done.returncode, 3)
        self.assertIn(f"start a daemon with: raynestd --listen {uri} &", done.stderr)
        done = Client(self.raynest, f"unix:{self.out}/nobody").run("scenes")
        self.assertIn(f"start a daemon with: raynestd --listen unix:{self.out}/nobody &", done.stderr)

    # ---- messages -------------------------------------------------------------------------------

    def test_messages_name_what_was_wrong_and_what_to_do(self):
        numpy.save(self.out / "flat.npy", numpy.zeros((2, 3), numpy.float32))
        numpy.save(self.out / "balls.npy", numpy.ones((2, 4), numpy.float32))
        self.says(2, "there is no option --rayz", "query", "hills", "--rayz", "a.npy")
        self.says(2, "there is no option --sizes", "render", "hills", "--sizes", "8x8")
        self.says(5, ("'flat.npy'", "(N, 4)"), "load", self.out / "flat.npy", "--primitive", "sphere")
        self.says(5, ("'flat.npy'", "(M, 12)"), "load", self.out / "balls.npy", "--primitive",
                  "sphere", "--instances", self.out / "flat.npy")
        self.says(5, ("'cube'", "'balls.npy'", "--primitive", "sphere"), "load",
                  self.out / "balls.npy", "--primitive", "cube")
        for source in ("builtin:", "builtin:woods"):
            self.says(5, ("builtin:forest", "trees", "builtin:terrain", "size", "builtin:flake",
                          "depth"), "load", source, "--name", "x")
        self.says(1, ("--name", "--replace"), "load", "builtin:terrain?size=9", "--name", "hills")
        self.says(5, ("raynest scenes", "raynest load"), "info", "nowhere")
        self.says(5, "leave --epoch out", "query", "hills", "--ray", "0,9,0,0,-1,0", "--epoch", "7")

    def test_what_is_left_out_of_a_scene_is_named(self):
        node = {"mesh": 0, "scale": [1, 0, 1], "name": "flag"}
        (self.out / "flat.gltf").write_text(json.dumps({
            "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}, node, {"camera": 0}, {"camera": 0, "name": "eye"}],
            "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}))
        said = self.client.run("info", self.out / "flat.gltf").stdout
        for words in ("0 (no name), 1 eye", "1 placement scaled to 0\n", "that of node 1 ('flag')"):
            self.assertIn(words, said)

    def test_a_source_that_is_no_scene_says_what_it_is(self):
        (self.out / "lfs.glb").write_text("version https://git-lfs.github.com/spec/v1\n")
        (self.out / "page.glb").write_text("<!DOCTYPE html>\n")
        self.says(5, "lfs.glb is a Git LFS pointer", "load", self.out / "lfs.glb")
        self.says(5, "begins with '<!DOCTYPE html>'", "load", self.out / "page.glb")
        (self.out / "folder").mkdir()
        for name, content in (("scan.glb.xz", b"\xfd7zXZ"), ("empty.glb", b""), ("empty.gltf", b""),
                              ("empty.npy", b""), ("braces.gltf", b"{}")):
            (self.out / name).write_bytes(content)
        self.says(5, ("folder is a folder", "name the .glb"), "load", self.out / "folder")
        self.says(5, ("is packed", "unpack it"), "load", self.out / "scan.glb.xz")
        # Both clients say the same of the files that are no scenes.
        for name, says in (("scan.e57", "points have no surface to hit.* with --radius, or"), ("berlin.EPW", "the sun's directions"),
                           ("sky.exr", "render a scene with it as --env$"), ("sky.hdr", "--env$"), ("scan.las.gz", "is packed; unpack it"),
                           ("scan.zip", "is packed"), ("dem.asc", "gdal_translate"), ("scan.laz", "laszip"), ("car.fbx", "Blender")):
            (self.out / name).write_bytes(b"PK\3\4")
            for words in (("load", self.out / name), ("load", f"nowhere/{name}"), ("info", self.out / name)):
                done = self.client.run(*words)
                self.assertEqual(done.returncode, 5, done.stderr)
                self.assertRegex(done.stderr.strip(), f"{name} .*{says}")
            there = subprocess.run([self.raynest, "info", name], cwd=self.out, stderr=subprocess.PIPE, text=True, check=False,
                                   env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri), timeout=PATIENCE)
            self.assertRegex(there.stderr.strip(), says)
        self.says(5, "empty.glb is empty", "load", self.out / "empty.glb")
        self.says(5, "empty.gltf is empty", "load", self.out / "empty.gltf")
        self.says(5, "/dev/null is empty", "load", "/dev/null", "--name", "x")
        self.says(5, "empty.npy is empty", "query", "hills", "--rays", self.out / "empty.npy")
        self.says(5, "no asset.version", "load", self.out / "braces.gltf")
        self.says(5, ("there is no built-in scene ''", "builtin:forest"), "load", "builtin:")

    def test_what_a_query_lacks_or_has_twice_is_said_in_words(self):
        self.says(2, "one of --ray, --rays, --generate is required", "query", "hills")
        self.says(2, "belongs to --kind multi and --kind all", "query", "hills", "--ray",
                  "0,9,0,0,-1,0", "--max-hits", "3")
        self.says(2, "reduce visible_pixels has columns of its own", "query", "hills", "--ray",
                  "0,9,0,0,-1,0", "--reduce", "visible_pixels", "--kind", "any", "--fields", "t")
        self.says(0, "ray 0 is not valid and counts as a miss:", "query", "hills", "--ray",
                  "0,9,0,0,0,0")

    def test_an_output_that_cannot_be_written_says_why(self):
        self.says(1, f"there is no folder {self.out}/nowhere/", "render", "hills", "-o",
                  self.out / "nowhere/a.png", "--size", "8x8")
        with open("/dev/full", "wb") as full:
            done = subprocess.run([self.raynest, "scenes"], stdout=full, stderr=subprocess.PIPE, check=False,
                                  env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri), timeout=PATIENCE)
        self.assertEqual((done.returncode, done.stderr),
                         (1, b"raynest: cannot write stdout: No space left on device\n"))

    def test_only_who_asked_for_an_exr_is_told_to_take_a_png(self):
        small = Daemon(self.raynestd, "--memory", "200M")
        self.addCleanup(small.stop)
        client = Client(self.raynest, small.uri)
        client.json("load", "builtin:terrain?size=8", "--name", "hills")
        for ending, advised in (("png", False), ("exr", True)):
            done = client.run("render", "hills", "--size", "8192x8192", "-o",
                              self.out / f"a.{ending}")
            self.assertEqual(done.returncode, 6, done.stderr)
            self.assertIn("ask for a smaller --size", done.stderr)
            self.assertEqual("PNG in place of EXR" in done.stderr, advised, done.stderr)

    def test_each_client_knows_every_word_of_the_daemon(self):
        """Checks that each client replaces every protocol word, which messages put between
        backticks."""
        words = set()
        for folder in ("server", "engine", "protocol"):
            for path in (ROOT / folder).rglob("*.cpp"):
                for line in path.read_text().splitlines():
                    for text in re.findall(r'"[^"]*"', line.split("//")[0]):
                        words.update(re.findall(r"`([A-Za-z_]+)`", text))
        self.assertGreater(len(words), 5)
        sys.path.insert(0, str(ROOT / "client/python"))
        self.addCleanup(sys.path.pop, 0)
        from raynest import _wording
        self.assertEqual(words - _wording.WORDS.keys(), set())
        said = "a `deadline_ms`, `x` or ` `Load` at `origin` 1,2,3"
        self.assertEqual(_wording.localize_message(said), "a deadline=, `x` or ` Client.load() at origin=(1,2,3)")
        with mock.patch.object(_wording, "_own", _wording._own):
            _wording.speak_as_command()
            self.assertEqual(_wording.localize_message(said), "a --deadline, `x` or ` raynest load at --origin 1,2,3")

    # ---- what takes long ------------------------------------------------------------------------

    def on_terminal(self, *arguments):
        """Starts a command whose stderr is a terminal; returns the process and that terminal."""
        ours, theirs = pty.openpty()
        self.addCleanup(os.close, ours)
        with open(theirs, "wb", buffering=0) as terminal:
            process = subprocess.Popen(
                [self.raynest, *map(str, arguments)], stderr=terminal, stdout=subprocess.PIPE,
                stdin=subprocess.DEVNULL, env=dict(os.environ, RAYNEST_SERVER=self.daemon.uri))
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)
        return process, ours

    def seen(self, terminal, enough=lambda text: False):
        """Reads the terminal until `enough` or until the command closes it."""
        text = b""
        end = time.monotonic() + PATIENCE
        while not enough(text) and time.monotonic() < end:
            try:
                if select.select([terminal], [], [], 0.1)[0]:
                    text += os.read(terminal, 1 << 16)
            except OSError:
                break
        return text

    def test_long_work_shows_progress_on_a_terminal(self):
        rays = io.BytesIO()
        numpy.save(rays, numpy.ones((1, 6), numpy.float32))
        os.mkfifo(self.out / "slow.npy")
        for options, shown in (((), True), (("--quiet",), False), (("--json",), False)):
            process, terminal = self.on_terminal(*options, "query", "hills", "--rays",
                                                 self.out / "slow.npy")
            with open(self.out / "slow.npy", "wb") as pipe:  # opens once the command reads it
                if shown:
                    text = self.seen(terminal, lambda text: b"reading" in text)
                    self.assertIn(b"reading 0 s", text)
                pipe.write(rays.getvalue())
            text = self.seen(terminal)
            self.assertEqual(process.wait(PATIENCE), 0)
            if not shown:
                self.assertEqual(text, b"")
        done = self.client.run("load", "builtin:terrain?size=16", "--name", "small")
        self.assertEqual(done.stderr, "")

    def test_an_interrupt_ends_a_load_and_its_import(self):
        for source in ("builtin:forest?trees=4000000&levels=1&leaves=200", "builtin:terrain?size=8192"):
            process = self.client.start("load", source, "--name", "huge")
            until(lambda: children(self.daemon.process.pid))
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=PATIENCE)
            self.assertEqual((process.returncode, errors),
                             (130, "raynest: interrupted; the request was cancelled\n"))
            until(lambda: not children(self.daemon.process.pid))
            self.says(5, "'huge' is not loaded", "info", "huge")
        self.assertEqual(self.client.json("stats")["jobs_cancelled"], 2)

    def test_an_interrupt_ends_an_upload(self):
        (self.out / "large.bin").write_bytes(b"")
        os.truncate(self.out / "large.bin", 400 << 20)
        (self.out / "large.gltf").write_text(json.dumps({
            "asset": {"version": "2.0"},
            "buffers": [{"uri": "large.bin", "byteLength": 400 << 20}]}))
        before = self.client.json("stats")["jobs_started"]
        process = self.client.start("load", self.out / "large.gltf")
        until(lambda: self.client.json("stats")["jobs_started"] > before)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
        self.assertEqual(process.returncode, 130)
        until(lambda: self.client.json("stats")["jobs_started"]
              == self.client.json("stats")["jobs_ended"])
        self.says(5, "'large' is not loaded", "info", "large")


if __name__ == "__main__":
    main()
