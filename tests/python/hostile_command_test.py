#!/usr/bin/env python3
"""Daemons that lie to the command line: each ends a command with one line, soon, with exit code 1,
which is not that of a user's mistake, and none of them costs memory or leaves a file.

  hostile_command_test.py RAYNESTD RAYNEST FLATC      (uses RAYNEST only)
"""
import contextlib
import json
import os
import pathlib
import resource
import struct
import subprocess
import sys
import tempfile
import unittest

import numpy as np

from daemon import PATIENCE
from with_fake import WithFake, frame, t

RAYNEST = sys.argv[2]
MEMORY_KIB = 3 << 20  # for any command

SCENE = {"name": "a", "hash": "0", "build": "medium", "cameras": ["front"], "animations": ["walk"],
         "animation_seconds": [1.0]}
DONE = ("Done", {})
RAY = ("--ray", "0,0,5,0,0,-1")


def piece(data=64, **message):
    """A frame of a picture of 4 x 4 pixels."""
    return "Payload", {"width": 4, "height": 4, "encode": "png", "total": 64, **message}, \
        {"data": np.zeros(data, np.uint8)}


def document(value):
    text = np.frombuffer(json.dumps(value).encode(), np.uint8)
    return "Payload", {"width": 1, "height": 1, "encode": "json", "total": len(text)}, {"data": text}


def chunk(first=0, count=1, **columns):
    return "Chunk", {"first_ray": first, "count": count}, columns


def jobs(kind, detail=""):
    return [("JobList", {"jobs": [{"job": 5, "kind": kind, "detail": detail}]})]


class Commands(WithFake):
    def run_command(self, *words, **answers):
        """Runs a command at a daemon that answers requests by name: with frames, one after the other, or as
        a function of the peer and the message does. Any other request ends with Done."""
        def script(peer):
            with contextlib.suppress(ConnectionError):
                while True:
                    name, message, _ = peer.read()
                    if name in ("Credit", "Upload", "QueryRays", "Cancel"):
                        continue
                    answer = answers.get(name, [DONE] if name != "Info" else [("SceneInfo", SCENE)])
                    if callable(answer):
                        answer(peer, message)
                        continue
                    for kind, fields, *columns in answer:
                        peer.send(kind, fields, **(columns[0] if columns else {}))
        done = subprocess.run([RAYNEST, "--quiet", "--reconnect", "0", "--server", self.fake(script), *words],
                              stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=4 * PATIENCE)
        self.assertLess(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, MEMORY_KIB)
        return done

    def refused(self, text, *words, code=1, **answers):
        with self.subTest(words=words[0], text=text):
            done = self.run_command(*words, **answers)
            self.assertEqual((done.returncode, done.stderr.count("\n")), (code, 1), done.stderr)
            self.assertIn(text, done.stderr)
            return done

    def out(self, name):
        """The path of a file that the test must not find in the end."""
        folder = self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-out-"))
        path = pathlib.Path(folder) / name
        self.addCleanup(lambda: self.assertFalse(path.exists(), path))
        return str(path)

    def test_a_request_that_ends_without_its_answer(self):
        png = self.out("a.png")
        for words in (("scenes",), ("stats",), ("jobs",), ("variants",), ("top", "--once"), ("open",),
                      ("pin", "a"), ("unload", "a"), ("wait", "5"), ("cancel", "5"), ("fetch", "5", "-o", png),
                      ("path", "a", "3"), ("info", "a", "--meshes"), ("edit", "a", "--hide", "b"),
                      ("load", "builtin:a"), ("admin", "connections"), ("admin", "drain")):
            self.refused("the daemon sent Done before the answer was whole", *words)
        for words in (("info", "a"), ("query", "a", *RAY), ("explain", "a", *RAY), ("animate", "a", "-o", png),
                      ("render", "a", "--cameras", "all", "-o", png)):
            self.refused("the daemon sent Done before the answer was whole", *words, Info=[DONE])

    def test_answers_of_another_kind_end_their_request(self):
        for other in ("Pong", "SceneList", "Welcome", "Detached"):
            self.refused(f"the daemon sent {other} before", "stats", Stats=[(other, {})])

    def test_broken_answers_are_no_mistake_of_the_user(self):
        for words, name, answer in (
                (("info", "a"), "Info", ("SceneInfo", {"name": "a\x1b[2J"})),
                (("info", "a"), "Info", ("SceneInfo", {"origin_x": np.nan})),
                (("info", "a"), "Info", ("SceneInfo", {"box_min": (0, 0, 0), "box_max": (1, np.inf, 1)})),
                (("animate", "a", "-o", self.out("a.png")), "Info",
                 ("SceneInfo", {"animations": ["b"], "animation_seconds": [np.nan]})),
                (("load", "builtin:a"), "Load", ("Loaded", {})),
                (("load", "builtin:a"), "Load", ("Progress", {"stage": "\n"})),
                (("stats",), "Stats", ("Statistics", {"names": ["b"]})),
                (("stats",), "Stats", ("Error", {"code": 5, "message": "\x1b"})),
                (("jobs",), "Jobs", ("JobList", {"jobs": [{"job": 1, "owner": "x" * 300}]})),
                (("wait", "5"), "Wait", ("JobInfo", {"job": 5, "state": "\x07"})),
                (("edit", "a", "--hide", "b"), "Edit", ("Edited", {"hash": "\x07"})),
                (("query", "a", *RAY), "Query", ("Started", {"notes": ["\r"]}))):
            self.refused(f"the daemon sent a broken {answer[0]}", *words, **{name: [answer]})

    def test_broken_frames(self):
        for junk in (b"HTTP" * 9, b"RYN1" + bytes([153, 0, 1, 0]) + bytes(24),
                     b"RYN1" + bytes([153, 0, 0, 0]) + b"\xff" * 24):
            self.refused("the daemon sent a broken frame", "stats", Stats=lambda peer, _: peer.socket.sendall(junk))

    def test_lists_without_end(self):
        """Each page says that there are more."""
        self.refused("a job twice", "jobs", Jobs=[("JobList", {"jobs": [{"job": 5}], "more": True})])
        self.refused("a connection twice", "admin", "connections", Admin=[("AdminReport", {
            "principals": ["b"], "roles": ["b"], "transports": ["b"], "peers": ["b"], "connections": [3],
            "age_ms": [1], "jobs": [1], "more": True})])
        self.assertEqual(self.run_command("jobs", Jobs=[("JobList", {"more": True})]).returncode, 0)
        names, ones = ["b"] * 500, [1] * 500
        page = frame("Unloaded", {"names": names}, 1)
        parts = frame("PartList", {"names": names, "alpha_modes": names, "triangles": ones, "placements": ones,
                                   "records": ones, "total": 2**32 - 1}, 1)

        def again(whole):
            return lambda peer, _: peer.socket.sendall(whole[:24] + struct.pack("<Q", peer.id) + whole[32:])
        self.refused("a list of more than", "unload", "--all", Unload=again(page))
        self.refused("a list of more than", "info", "a", "--meshes", Parts=again(parts))

    def test_pictures(self):
        render = ("render", "a", "--size", "4x4", "-o", self.out("a.png"))
        fetch = ("fetch", "5", "-o", self.out("b.png"))
        other, fit, end = "another answer than was asked", "do not fit", "before its last piece"
        for text, frames in (
                (other, [piece(total=2**50)]), (other, [piece(encode="raw")]), (other, [piece(encode="exr")]),
                (fit, [piece(65)]), (fit, [piece(offset=64)]), (fit, [piece(32), piece(32, offset=32, total=2**60)]),
                (fit, [piece(), piece(offset=64)]), (fit, [piece(32), piece(32)]),
                (end, [DONE]), (end, [piece(32), DONE]), (end, [piece(0, total=0), DONE]),
                ("not asked for", [("Detached", {"job": 7})]), ("not asked for", [("Detached", {})]),
                ("Started twice", [("Started", {}), ("Started", {}), DONE]),
                ("a broken Payload", [piece(width=2**31)])):
            self.refused(text, *render, Render=frames)
            if frames[0][1].get("encode") != "exr" and frames[0][1].get("encode") != "raw":
                self.refused(text, *fetch, Jobs=jobs("render"), Fetch=frames)
        raw = ("render", "a", "--size", "4x4", "-o", self.out("a.npy"))
        for fields in ({"width": 8, "height": 2}, {"total": 60}, {"width": 2, "height": 2, "total": 16}):
            self.refused(other, *raw, Render=[piece(fields.get("total", 64), encode="raw", **fields), DONE])

        def unstarted(peer, _):
            kind, fields, columns = piece()
            peer.send(kind, fields, **columns)
            peer.started = peer.id
            peer.send(*DONE)
        self.refused("had not started", *render, Render=unstarted)
        self.refused(end, "export", "a", "-o", self.out("a.glb"), Export=[piece(32), DONE])
        self.refused(other, "export", "a", "-o", self.out("b.glb"), Export=[piece(total=2**33)])

    def test_columns(self):
        npz, ply = self.out("a.npz"), self.out("a.ply")
        hit = np.ones(1, np.uint8)
        point = np.zeros((1, 3), np.float32)
        query = ("query", "a", *RAY, *RAY)
        for text, frames in (
                ("wrong type", [chunk(position=hit, hit=hit)]), ("other columns", [chunk(hit=hit)]),
                ("other columns", [chunk(position=point, hit=hit), chunk(1, position=point)]),
                ("too early", [chunk(position=point, hit=hit), DONE]), ("not asked", [chunk(0, 3)]),
                ("not asked for", [("Detached", {"job": 7})])):
            self.refused(text, *query, "--fields", "position", "-o", ply, Query=frames)
        self.refused("ray_splits that do not rise", *query, "--kind", "all", "--fields", "flags", Query=[
            chunk(0, 2, ray_splits=np.array([0, 0, 2**63], np.uint64), flags=np.zeros(2, np.uint8))])
        few = chunk(0, 3, ray_splits=np.zeros(4, np.uint64), path=np.zeros(0, np.uint64))
        self.refused("rows without their columns", "fetch", "5", Jobs=jobs("query", "visible_pixels"), Fetch=[few])
        self.refused("rows without their columns", "fetch", "5", Jobs=jobs("query", "visible_pixels"), Fetch=[chunk()])

        def never_the_first(peer, _):
            peer.send("Started", {})
            for first in range(1, 2**20):
                peer.send("Chunk", {"first_ray": 65536 * first, "count": 1}, x=np.zeros((1 << 18, 4), np.float32))
        self.refused("for long without that to ray 0", "fetch", "5", "-o", npz, Jobs=jobs("query", "closest"),
                     Fetch=never_the_first)

    def test_files_that_were_not_offered(self):
        with tempfile.NamedTemporaryFile(suffix=".obj") as file:
            file.write(b"v 0 0 0\n")
            file.flush()
            for text, frames in (("twice, or for one", [("Need", {"files": [1]})]),
                                 ("twice, or for one", [("Need", {"files": [0, 0]})]),
                                 ("Need twice", [("Need", {}), ("Need", {})])):
                self.refused(text, "load", file.name, Load=frames)

    def test_documents(self):
        for value in ({}, [], 3, {"steps": 1}, {"ray": {}}, {"sample": 1, "pixel": [], "size": []}):
            text = "a JSON document" if not isinstance(value, dict) else "lacks what it must hold"
            for words, name in ((("explain", "a", *RAY), "Explain"),
                                (("explain", "a", "--pixel", "1,1", "--integrator", "path"), "Render"),
                                (("heatmap", "a", "--size", "4x4", "--top", "3"), "Blame"),
                                (("heatmap", "a", "--size", "4x4", "--fail-if", "total.max>1"), "Heatmap")):
                self.refused(text, *words, **{name: [document(value), DONE]})
        self.refused("another answer", "explain", "a", *RAY, Explain=[
            ("Payload", {"width": 1, "height": 1, "encode": "json", "total": 2**40}, {"data": t(1).view(np.uint8)})])

    def test_the_address_of_a_page(self):
        for address in ("http://127.0.0.1:1/$(reboot)", "http://a;reboot:80", "file:///etc/passwd", "http://a"):
            self.refused("which is no http address", "open", Page=[("PageAddress", {"http": address})])

    def test_numbers(self):
        done = self.run_command("jobs", Jobs=[("JobList", {"jobs": [
            {"job": 2**64 - 1, "done": 2**64 - 1, "total": 1, "age_ms": 2**64 - 1, "bytes": 2**64 - 1}]})])
        self.assertEqual((done.returncode, "100%" in done.stdout), (0, True), done)


class Hosts(unittest.TestCase):
    """hosts.toml, which both clients read."""

    def setUp(self):
        self.home = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-home-")))
        self.file = self.home / "raynest" / "hosts.toml"
        self.file.parent.mkdir()
        self.file.write_text('["tcp://127.0.0.1:1"]\ntoken = "t"\n')
        self.file.chmod(0o600)

    def both(self, uid):
        """Yields the words of the two clients, run as this user."""
        for command in ([RAYNEST, "--reconnect", "0", "--server", "tcp://127.0.0.1:1", "stats"],
                        [sys.executable, "-c", "import sys, raynest\ntry: raynest.connect('tcp://127.0.0.1:1')\n"
                         "except raynest.Error as error: sys.exit(f'{error}')"]):
            yield subprocess.run(command, env={**os.environ, "XDG_CONFIG_HOME": str(self.home)}, user=uid,
                                 extra_groups=None if uid is None else [], capture_output=True, text=True, timeout=PATIENCE).stderr

    @unittest.skipIf(os.geteuid(), "only root can be other users")
    def test_a_folder_that_may_not_be_entered(self):
        self.home.chmod(0o755)
        self.file.parent.chmod(0o700)
        for said in self.both(65534):
            self.assertIn("cannot connect to tcp://127.0.0.1:1", said)

    def test_a_file_without_end(self):
        self.file.write_text("#" * (2 << 20))
        for said in self.both(None):
            self.assertIn("hosts.toml is over 1048576 bytes", said)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
