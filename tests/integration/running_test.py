#!/usr/bin/env python3
"""Tests what running the daemon as a service relies on: the unit's reload, the journal's priorities, scenes that
are loaded at the start, few descriptors, quotas and metrics of each principal, a missing library for pictures.

  running_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from daemon import PATIENCE, Client, Daemon, Programs, main, until
from secure_daemon import Tokens

PACKAGE = pathlib.Path(__file__).resolve().parents[2] / "server" / "package"
SCENE = "builtin:terrain?size=8"
TRIANGLE = {
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "buffers": [{"uri": "corners.bin", "byteLength": 36}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}]}
CORNERS = bytes.fromhex("000000000000000000000000" "0000803f0000000000000000" "000000000000803f00000000")


def read(url, token=None):
    """Returns status and text of an answer."""
    request = Request(url, headers={"Authorization": f"Bearer {token}"} if token else {})
    try:
        with urlopen(request, timeout=PATIENCE) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as refused:
        return refused.code, refused.read().decode()


class Running(Programs):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest running ")))

    def daemon(self, *arguments, **options):
        daemon = Daemon(self.raynestd, *arguments, **options)
        self.addCleanup(daemon.stop)
        return daemon

    def local(self, *arguments, **options):
        """Returns a daemon with HTTP and a client that administers it."""
        path = self.folder / "socket"
        daemon = self.daemon("--http", "127.0.0.1:0", "--listen", f"unix:{path}", *arguments, **options)
        return daemon, Client(self.raynest, f"unix:{path}")

    # ---- the unit -------------------------------------------------------------------------------

    def reload_as_unit(self, daemon, config):
        """Runs the unit's ExecReload= lines as systemd does: in turn, until one fails. True if none did."""
        for line in re.findall(r"^ExecReload=(.*)$", (PACKAGE / "raynestd.service").read_text(), re.M):
            line = line.replace("/usr/bin/raynestd", f"'{self.raynestd}'")
            line = line.replace("/etc/raynest/raynestd.toml", f"'{config}'")
            done = subprocess.run(["sh", "-c", line], env=dict(os.environ, MAINPID=str(daemon.process.pid)),
                                  capture_output=True, timeout=PATIENCE, check=False)
            if done.returncode != 0:
                return False
        return True

    def test_a_reload_of_the_unit_with_a_broken_file_fails_and_changes_nothing(self):
        config = self.folder / "raynestd.toml"
        config.write_text('log-level = "info"\n')
        daemon = self.daemon("--config", config)
        config.write_text('log-level = "loud"\n')
        self.assertFalse(self.reload_as_unit(daemon, config))
        config.write_text('tokens = "none"\n')
        self.assertFalse(self.reload_as_unit(daemon, config))
        config.write_text('log-level = "debug"\n')
        self.assertTrue(self.reload_as_unit(daemon, config))
        until(lambda: " reloaded " in daemon.log())
        self.assertEqual(daemon.log().count(" reloaded "), 1)
        self.assertNotIn("configuration_unusable", daemon.log())

    # ---- the journal ----------------------------------------------------------------------------

    def lines_to(self, stream, *arguments):
        """Returns the lines that a daemon writes to a pipe, before its end, with JOURNAL_STREAM=stream(pipe)."""
        reader, writer = os.pipe()
        process = subprocess.Popen([self.raynestd, "--listen", "tcp://127.0.0.1:0", "--http", "off", "--cuda", "off",
                                    *arguments], stderr=writer, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                   env=dict(os.environ, JOURNAL_STREAM=stream(os.fstat(writer))))
        os.close(writer)
        with open(reader, encoding="utf-8") as lines:
            text = ""
            for line in lines:
                text += line
                if " listening " in line or '"listening"' in line:
                    process.send_signal(signal.SIGTERM)
        process.wait(PATIENCE)
        return text.splitlines()

    def test_lines_have_priorities_where_stderr_is_the_journal_and_only_there(self):
        def journal(status):
            return f"{status.st_dev}:{status.st_ino}"
        empty = self.folder / "packs"
        empty.mkdir()
        lines = self.lines_to(journal, "--pack-dir", empty)
        self.assertTrue(all(re.match(r"<[3467]>\d{4}-", line) for line in lines), lines)
        self.assertTrue(any(re.match("<4>.* pack_dir_empty ", line) for line in lines), lines)
        self.assertTrue(any(re.match("<6>.* started ", line) for line in lines), lines)
        for line in self.lines_to(journal, "--log-format", "json"):
            self.assertEqual(line[:4], "<6>{")
            json.loads(line[3:])
        failed = self.lines_to(journal, "--listen", "unix:/nonexistent/s")
        self.assertTrue(failed[-1].startswith("<3>raynestd: "), failed)
        wrong = self.lines_to(journal, "--threads", "none")
        self.assertTrue(wrong[-1].startswith("<3>raynestd: "), wrong)
        for line in self.lines_to(lambda status: f"{status.st_dev}:{status.st_ino + 1}"):
            self.assertRegex(line, r"^\d{4}-")

    # ---- scenes at the start --------------------------------------------------------------------

    def write_scene(self, name):
        path = self.folder / "scenes" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(TRIANGLE))
        (path.parent / "corners.bin").write_bytes(CORNERS)
        return path

    def test_scenes_of_the_configuration_are_there_after_the_start_for_everybody(self):
        self.write_scene("a.gltf")
        self.write_scene("b.gltf")
        (self.folder / "scenes" / "c.gltf").write_text("rubbish")
        (self.folder / "link.gltf").symlink_to(self.folder / "scenes" / "a.gltf")
        config = self.folder / "raynestd.toml"
        config.write_text(f'load = ["scenes/*.gltf", "{SCENE}", "none-*.glb", "link.gltf", "builtin:nothing"]\n')
        tokens = Tokens(self.raynestd, self.folder / "tokens")
        vera = tokens.add("vera", "--role", "viewer")
        daemon, root = self.local("--config", config, "--tokens", tokens.file)
        until(lambda: read(daemon.http + "/readyz")[0] == 200)
        listed = {scene["name"]: scene for scene in root.json("scenes")["scenes"]}
        self.assertEqual(set(listed), {"a", "b", "terrain", "link"})
        self.assertEqual({scene["owner"] for scene in listed.values()}, {f"uid:{os.geteuid()}"})
        self.assertEqual({scene["share"] for scene in listed.values()}, {"public"})
        # No connection holds them: an administrator's unload frees the memory.
        self.assertEqual({scene["holders"] for scene in listed.values()}, {0})
        viewer = Client(self.raynest, daemon.uri, vera)
        seen = viewer.run("query", "a", "--ray", "0.2,0.2,5,0,0,-1")
        self.assertEqual(seen.returncode, 0, seen.stderr)
        failed = re.findall(r" load_failed source=(\S+) reason=\"(.*)\"", daemon.log().replace('"' + str(self.folder), str(self.folder)))
        told = "\n".join(line for line in daemon.log().splitlines() if " load_failed " in line)
        self.assertEqual(told.count("load_failed"), 3, told)
        for source in ("scenes/c.gltf", "none-*.glb", "builtin:nothing"):
            self.assertIn(source, told)
        self.assertEqual(root.json("jobs")["jobs"], [])

    def test_readiness_waits_for_scenes_and_a_reload_names_them_as_waiting_for_a_restart(self):
        config = self.folder / "raynestd.toml"
        config.write_text('load = ["builtin:forest?trees=4000"]\n')
        daemon, root = self.local("--config", config)
        status, text = read(daemon.http + "/readyz")
        if status != 200:  # else the load was faster than the test
            self.assertEqual((status, text), (503, "the daemon loads its scenes: 0 of 1 have been loaded\n"))
        self.assertEqual(read(daemon.http + "/healthz"), (200, "ok\n"))
        until(lambda: read(daemon.http + "/readyz")[0] == 200)
        self.assertEqual(root.run("info", "forest").returncode, 0)
        config.write_text('load = ["builtin:terrain"]\n')
        root.run("admin", "reload")
        self.assertRegex(daemon.log(), r"restart_needed options=\S*load")

    # ---- few descriptors ------------------------------------------------------------------------

    def test_without_descriptors_an_administrator_finds_a_place_and_health_names_them(self):
        daemon, root = self.local("--give-way-ms", "600000", under=("prlimit", "--nofile=64"))
        self.assertEqual(read(daemon.http + "/healthz"), (200, "ok\n"))
        host, port = daemon.uri.removeprefix("tcp://").rsplit(":", 1)
        crowd = [socket.create_connection((host, int(port)), PATIENCE) for _ in range(100)]
        web = daemon.http.removeprefix("http://").rsplit(":", 1)
        crowd += [socket.create_connection((web[0], int(web[1])), PATIENCE) for _ in range(20)]
        try:
            until(lambda: " descriptors_used_up " in daemon.log())
            for _ in range(3):
                status, text = read(daemon.http + "/healthz")
                self.assertEqual(status, 200)
                self.assertIn("file descriptors are used up: the limit is 64; raise LimitNOFILE", text)
            status, text = read(daemon.http + "/readyz")
            self.assertEqual(status, 503)
            self.assertIn("file descriptors", text)
            held = [root.start("top") for _ in range(2)]
            self.assertTrue(root.json("admin", "connections")["connections"])
            loaded = root.run("load", SCENE)
            self.assertEqual(loaded.returncode, 0, loaded.stderr)
            for process in held:
                process.kill()
                process.communicate()
        finally:
            for connection in crowd:
                connection.close()
        until(lambda: read(daemon.http + "/readyz")[0] == 200)
        self.assertEqual(read(daemon.http + "/healthz"), (200, "ok\n"))

    # ---- principals -----------------------------------------------------------------------------

    def test_quotas_show_what_is_used_of_them_and_take_units(self):
        tokens = Tokens(self.raynestd, self.folder / "tokens")
        secret = tokens.add("bob", "--quota", "scene_bytes=1.5M,jobs=3")
        daemon, root = self.local("--tokens", tokens.file)
        bob = Client(self.raynest, daemon.uri, secret)
        bytes_of = bob.json("load", SCENE)["bytes"]
        stats = bob.json("stats")
        self.assertEqual((stats["quota_scene_bytes"], stats["quota_scene_bytes_used"]), (3 << 19, bytes_of))
        self.assertEqual((stats["quota_jobs"], stats["quota_jobs_used"]), (3, 0))
        self.assertEqual((stats["quota_scenes_used"], stats["quota_connections_used"]), (1, 1))
        self.assertEqual(root.json("stats")["quota_scenes_used"], 0)
        self.assertRegex(root.run("admin", "quota", "bob").stdout, r"^bob uses .*0 of 3 jobs, .* of 1\.5 MiB scene_bytes, 0 B of .* disk_bytes; ")
        changed = root.run("admin", "quota", "bob", "scene_bytes=20G")
        self.assertEqual(changed.returncode, 0, changed.stderr)
        self.assertEqual(bob.json("stats")["quota_scene_bytes"], 20 << 30)
        wrong = root.run("admin", "quota", "bob", "scene_bytes=20X")
        self.assertEqual(wrong.returncode, 2, wrong.stderr)
        self.assertEqual(root.run("admin", "quota", "nosuch").returncode, 5)

    def test_metrics_tell_administrators_of_each_principal_and_others_of_themselves(self):
        tokens = Tokens(self.raynestd, self.folder / "tokens")
        secrets = {name: tokens.add(name, *more) for name, more in
                   (("bob", ()), ("carol", ()), ("ops", ("--role", "admin")))}
        begun = time.time()
        daemon, root = self.local("--tokens", tokens.file)
        bob = Client(self.raynest, daemon.uri, secrets["bob"])
        bob.json("load", SCENE)
        bob.run("query", "terrain", "--ray", "0,9,0,0,-1,0", "--ray", "0,9,0,0,-1,0")

        def shown(name):
            status, text = read(daemon.http + "/metrics", secrets[name])
            self.assertEqual(status, 200, text)
            return text
        rays = 'raynest_principal_rays_total{principal="bob"} 2\n'
        scenes = 'raynest_principal_used{principal="bob",resource="scenes"} 1\n'
        quota = 'raynest_principal_quota{principal="bob",resource="scenes"} '
        for reader in ("bob", "ops"):
            for line in (rays, scenes, quota):
                self.assertIn(line, shown(reader), reader)
        self.assertNotIn('principal="bob"', shown("carol"))
        self.assertNotIn('principal="bob"', read(daemon.http + "/metrics")[1])
        started = float(re.search(r"^process_start_time_seconds (\S+)$", shown("carol"), re.M)[1])
        self.assertLess(abs(started - begun), 60 + PATIENCE)

    # ---- pictures -------------------------------------------------------------------------------

    def test_without_the_library_for_pictures_the_daemon_names_its_package(self):
        program = self.folder / "bin" / "raynestd"
        program.parent.mkdir()
        shutil.copy(self.raynestd, program)
        module = pathlib.Path(self.raynestd).parents[1] / "lib/raynest/images/raynest-images.so"
        if not module.exists():
            self.skipTest("skipped: built without OpenImageIO")
        daemon = Daemon(program)
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", SCENE)
        picture = client.run("render", "terrain", "--size", "8x8", "-o", self.folder / "a.png")
        self.assertEqual(picture.returncode, 5, picture.stderr)
        self.assertRegex(picture.stderr, r"pictures need the image module .*install libopenimageio\d+\.\d+ where raynestd runs")
        self.assertEqual(client.run("query", "terrain", "--ray", "0,9,0,0,-1,0").returncode, 0)


if __name__ == "__main__":
    main()
