#!/usr/bin/env python3
"""Tests what an administrator relies on: checks of the configuration, quotas, statistics, the log, and
acts that fail.

  operation_test.py RAYNESTD RAYNEST
"""
import os
import pathlib
import re
import signal
import socket
import ssl
import subprocess
import tempfile
import time
import tomllib
import unittest
from urllib.request import urlopen

from daemon import PATIENCE, Client, Daemon, Programs, main, until
from secure_daemon import Certificates, SecureClient, SecureDaemon, Tokens

SCENE = "builtin:terrain?size=8"


OTHER = 12345  # a user that this machine need not have


class Operation(Programs):
    @classmethod
    def setUpClass(cls):
        shared = cls.enterClassContext(tempfile.TemporaryDirectory(prefix="raynest operation "))
        cls.certificates = Certificates(cls.raynestd, f"{shared}/tls")

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))
        self.config = self.folder / "raynestd.toml"

    def daemon(self, *arguments, **options):
        daemon = Daemon(self.raynestd, *arguments, **options)
        self.addCleanup(daemon.stop)
        return daemon

    def check(self, text, wanted, *said, arguments=(), environment=None):
        """Checks a configuration; `said` are parts of the answer."""
        self.config.write_text(text)
        done = subprocess.run([self.raynestd, "--config", self.config, "--check-config", *map(str, arguments)],
                              capture_output=True, text=True, timeout=PATIENCE, check=False, cwd="/",
                              env=dict(os.environ, **(environment or {})))
        answer = done.stdout + done.stderr
        self.assertEqual(done.returncode, wanted, answer)
        for part in said:
            self.assertIn(part, answer)
        return answer

    def says(self, done, code, *parts):
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        for part in parts:
            self.assertIn(part, done.stdout + done.stderr)
        return done

    def local(self, *arguments):
        """Returns a daemon, a client that administers it, and its socket."""
        path = self.folder / "socket"
        tokens = Tokens(self.raynestd, self.folder / "tokens")
        secrets = {name: tokens.add(name, *more) for name, more in
                   (("bob", ()), ("carol", ("--quota", "scene_bytes=100000,jobs=1,rays=100")),
                    ("vera", ("--role", "viewer")))}
        daemon = self.daemon("--listen", f"unix:{path}", "--tokens", tokens.file, *arguments)
        clients = {name: Client(self.raynest, daemon.uri, secret) for name, secret in secrets.items()}
        return daemon, Client(self.raynest, f"unix:{path}"), clients

    # ---- the configuration ----------------------------------------------------------------------

    def test_a_check_looks_at_the_files_that_a_start_needs(self):
        tls = self.certificates.folder
        pair = f'tls-cert = "{tls}/cert.pem"\ntls-key = "{tls}/key.pem"\n'
        self.check(pair, 0, "is valid")
        self.check(f'tls-cert = "{tls}/cert.pem"\ntls-key = "{tls}/client-key.pem"\n', 1,
                   "raynestd.toml, line 2: tls-key", "does not fit the certificate")
        self.check(f'tls-cert = "{tls}/none.pem"\ntls-key = "{tls}/key.pem"\n', 1,
                   "raynestd.toml, line 1: tls-cert", "none.pem")
        self.check(pair + f'client-ca = "{tls}/none.pem"\n', 1, "raynestd.toml, line 3: client-ca")
        self.check('threads = 1\ntokens = "/nonexistent/tokens"\n', 1,
                   "raynestd.toml, line 2: tokens /nonexistent/tokens: No such file")
        self.check('listen = [\n  "tcp://127.0.0.1:0",\n  "unix:/nonexistent/s",\n]\n', 1,
                   "raynestd.toml, line 3: listen unix:/nonexistent/s: the folder /nonexistent does not exist")
        self.check('state = "/etc/passwd"\n', 1, "line 1: state /etc/passwd", "is not a folder")
        precious = self.folder / "precious"
        precious.write_text("mine\n")
        self.check(f'ready-file = "{precious}"\n', 1, "line 1: ready-file", "neither empty nor a ready file")
        self.check(f'listen = "unix:{precious}"\n', 1, "line 1: listen", "is no socket")
        self.check('load = ["root:a.glb"]\n', 0, "warning: --load names root:PATH, and there is no --scene-root")
        # A daemon that runs is no fault.
        daemon = self.daemon("--listen", f"unix:{self.folder}/socket", "--state", self.folder / "state")
        self.check(f'listen = "unix:{self.folder}/socket"\nstate = "{self.folder}/state"\n', 0)
        self.assertTrue(daemon.alive())

    def test_a_state_folder_that_others_can_change_is_refused(self):
        state = self.folder / "shared"
        for part in (state, state / "blobs"):
            part.mkdir(exist_ok=True)
            part.chmod(0o777)
            self.check(f'state = "{state}"\n', 1, "line 1: state", "other users may write", f"chmod go-w {part}")
            told = subprocess.run([self.raynestd, "--listen", f"unix:{self.folder}/s", "--http", "off", "--state", state],
                                  capture_output=True, text=True, timeout=PATIENCE, check=False)
            self.assertEqual(told.returncode, 1, told.stderr)
            self.assertIn(f"chmod go-w {part}", told.stderr)
            part.chmod(0o755)
        above = self.folder / "above"
        above.mkdir()
        for missing in (above / "state", above / "more" / "state"):
            above.chmod(0o777)
            self.check(f'state = "{missing}"\n', 1, f"other users may write in {above} and change the scenes")
            above.chmod(0o1777)
            self.check(f'state = "{missing}"\n', 0)
        self.check(f'state = "{state}"\n', 0, f"warning: other users can see the names of the files in {state}")
        state.chmod(0o700)
        self.assertNotIn("warning", self.check(f'state = "{state}"\n', 0))
        if os.geteuid() == 0:
            os.chown(state, 5, -1)
            self.check(f'state = "{state}"\n', 1, "belongs to the user 5, who could change the scenes")

    def test_what_others_can_change_lets_nobody_in_and_runs_no_code(self):
        tls = self.folder / "tls"
        Certificates(self.raynestd, tls)
        packs, tokens = self.folder / "packs", self.folder / "of others" / "tokens"
        packs.mkdir()
        tokens.parent.mkdir()
        Tokens(self.raynestd, tokens).add("bob")
        (packs / "one.so").write_bytes(b"")
        text = (f'listen = "tls://127.0.0.1:0"\nhttp = "off"\ntls-cert = "{tls}/cert.pem"\n'
                f'tls-key = "{tls}/key.pem"\nclient-ca = "{tls}/ca.pem"\ntokens = "{tokens}"\n')
        self.check(text, 0, "is valid")
        daemon = self.daemon("--listen", f"unix:{self.folder}/socket", "--config", self.config)
        root = Client(self.raynest, f"unix:{self.folder}/socket")
        for part, mode, option, harm in (
                (tls / "cert.pem", 0o666, "line 3: tls-cert", "let in whom they like"),
                (tls / "ca.pem", 0o666, "line 5: client-ca", "let in whom they like"),
                (tokens.parent, 0o777, "line 6: tokens", "let in whom they like"),
                (self.config, 0o666, str(self.config), "change the options"),
                (packs, 0o777, "line 7: pack-dir", "run code in the daemon"),
                (packs / "one.so", 0o666, "line 7: pack-dir", "run code in the daemon")):
            with self.subTest(part.name):
                more = f'pack-dir = "{packs}"\n' if packs in (part, part.parent) else ""
                before = part.stat().st_mode
                part.chmod(mode)
                said = f"other users may write in {part} and {harm}"
                self.check(text + more, 2 if part == self.config else 1, option, said)
                if not more:
                    self.says(root.run("admin", "reload"), 5, f"and {harm}; chmod", "the old content stays")
                started = subprocess.run([self.raynestd, "--config", self.config], capture_output=True, text=True,
                                         timeout=PATIENCE, check=False)
                self.says(started, 2 if part == self.config else 1, said)
                part.chmod(before & 0o777)
                self.check(text, 0, "is valid")
                self.says(root.run("admin", "reload"), 0)

    def check_within(self, script, *arguments):
        """Checks a configuration in a mount namespace, after a script."""
        if subprocess.run(["unshare", "--mount", "true"], check=False, capture_output=True).returncode:
            self.skipTest("skipped: no right to mount")
        return subprocess.run(["unshare", "--mount", "sh", "-c", script + ' && exec "$@" --check-config', *arguments],
                              capture_output=True, text=True, timeout=PATIENCE, check=False)

    def test_what_is_mounted_read_only_may_be_changed_elsewhere(self):
        """A unit with ProtectSystem=strict sees all files read-only."""
        config = self.folder / "mount" / "raynestd.toml"
        config.parent.mkdir()
        config.write_text('listen = "tcp://127.0.0.1:0"\nhttp = "off"\n')
        for mode, code in ((0o777, 2), (0o755, 0), (0o1777, 0)):
            config.parent.chmod(mode)
            done = self.check_within('mount --bind "$0" "$0" && mount -o remount,bind,ro "$0"', config.parent,
                                     self.raynestd, "--config", config)
            self.says(done, code, *("change the options", f"chmod go-w {config.parent}") if code else ())

    @unittest.skipIf(os.geteuid() != 0, "only root can become another user")
    def test_a_group_that_others_are_in_may_write_nothing(self):
        """As the package's group raynest, whose members use the socket."""
        self.folder.chmod(0o755)
        etc, state = self.folder / "etc", self.folder / "state"
        etc.mkdir()
        state.mkdir()
        self.config.write_text(f'listen = "tcp://127.0.0.1:0"\nhttp = "off"\nstate = "{state}"\n')
        for name, users, members, code in (("own", "", "", 0), ("itself", "", "raynest", 0), ("root", "", "root", 0),
                                           ("member", "", "raynest,eve", 1), ("first", f"bob:x:7:{OTHER}::/:\n", "", 1),
                                           ("gone", "", "nobody-knows", 1)):
            with self.subTest(name):
                (etc / "passwd").write_text(f"root:x:0:0::/:\nraynest:x:{OTHER}:{OTHER}::/:\neve:x:8:8::/:\n{users}")
                (etc / "group").write_text(f"root:x:0:\nraynest:x:{OTHER}:{members}\n")
                os.chown(state, OTHER, OTHER)
                state.chmod(0o770)
                done = self.check_within(
                    'for file in passwd group; do mount --bind "$0/$file" /etc/$file || exit; done', etc, "setpriv",
                    f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups", self.raynestd, "--config", self.config)
                self.says(done, code, *("change the scenes", f"chmod g-w {state}") if code else ())

    def test_a_module_that_is_cut_short_ends_the_start(self):
        whole = pathlib.Path(os.environ.get("RAYNEST_BUILTIN_PACKS") or
                             pathlib.Path(self.raynestd).resolve().parents[1] / "lib/raynest")
        for folder in ("shading", "images"):
            packs = self.folder / f"cut-{folder}"
            packs.mkdir()
            for part in whole.iterdir():
                if part.name != folder:
                    (packs / part.name).symlink_to(part)
            (packs / folder).mkdir()
            module = next((whole / folder).glob("*.so"))
            (packs / folder / module.name).write_bytes(module.read_bytes()[:module.stat().st_size // 2])
            for more in (("--check-config",), ()):
                told = subprocess.run([self.raynestd, "--listen", f"unix:{self.folder}/s", "--http", "off", *more],
                                      capture_output=True, text=True, timeout=PATIENCE, check=False,
                                      env={**os.environ, "RAYNEST_BUILTIN_PACKS": str(packs)})
                self.assertEqual(told.returncode, 1, told.stderr)
                self.assertIn(f"{module.name}: it is cut short", told.stderr)

    def test_a_scene_has_no_name_that_looks_like_another(self):
        client = Client(self.raynest, self.daemon("--http", "off").uri)
        for name, said in (("a\u202eb", "'a?b' has a letter that nobody sees"), ("a\u200bb", "a?b"), ("a\u3164", "a?"),
                           ("a\u3000b", "a?b"), ("a\ufe0f", "a?"), ("a\U0001d159", "a?"), ("a\ue000", "Unicode does not know"),
                           ("a ", "has a blank at an end"), (" a", "has a blank at an end"), ("a  b", "two side by side")):
            told = client.run("load", "builtin:flake?depth=1", "--name", name)
            self.assertNotEqual(told.returncode, 0)
            self.assertIn(said, told.stderr)
        told = client.run("load", "builtin:flake?depth=1", "--name", "a", "--share", "b\u2066c")
        self.assertIn("'b?c', which has a letter that nobody sees", told.stderr)
        self.assertEqual(client.run("load", "builtin:flake?depth=1", "--name", "\u00e4 \u20ac").returncode, 0)
        # The name of a file becomes a good one by itself.
        file = self.folder / " two  cars .obj"
        file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        self.says(client.run("load", file), 0, "two cars")

    def test_a_fault_between_options_names_file_and_line(self):
        for text, *said in (
                ('\nlisten = "tls://127.0.0.1:1"\n', "line 2: listen tls://127.0.0.1:1 needs tls-cert and tls-key"),
                ('listen = [\n "unix:/tmp/a",\n "tcp://0.0.0.0:1",\n]\n', "line 3: listen", "or pass insecure"),
                ('listen = [\n "tcp://127.0.0.1:9",\n "tcp://localhost:9",\n]\n', "line 3: listen", "is given twice"),
                ('threads = 1\nclient-ca = "c"\n', "line 2: client-ca needs tls-cert and tls-key"),
                ('tls-key = "k"\n', "line 1: tls-key needs tls-cert"),
                ('http = "0.0.0.0:1"\n', "line 1: http 0.0.0.0:1 can be reached")):
            answer = self.check(text, 2, f"{self.config}, ", *said)
            self.assertNotIn("--listen", answer)
            self.assertNotIn("--tls", answer)
        self.check("", 2, "RAYNEST_LISTEN tls://127.0.0.1:1 needs",
                   environment={"RAYNEST_LISTEN": "tls://127.0.0.1:1"})
        self.check("", 2, "--listen tls://127.0.0.1:1 needs --tls-cert",
                   arguments=("--listen", "tls://127.0.0.1:1"))

    def test_relative_paths_begin_at_the_folder_of_the_configuration(self):
        tls = self.folder / "tls"
        tls.symlink_to(self.certificates.folder)
        text = 'tls-cert = "tls/cert.pem"\ntls-key = "tls/key.pem"\nstate = "state"\nlisten = "unix:s"\n'
        self.check(text, 0)
        daemon = self.daemon("--config", self.config, "--listen", f"unix:{self.folder}/t")
        self.assertTrue((self.folder / "state" / "lock").exists())
        self.assertTrue(daemon.alive())
        self.check('tokens = "none"\n', 1, f"tokens {self.folder}/none: No such file")

    def test_variables_name_limits_too_and_stand_between_file_and_options(self):
        text = "principal-scenes-max = 1\ndrain-ms-max = 100\n"
        self.config.write_text(text)

        def printed(*arguments, **variables):
            done = subprocess.run([self.raynestd, "--config", self.config, "--print-config", *arguments],
                                  env=dict(os.environ, **variables), capture_output=True, text=True,
                                  timeout=PATIENCE, check=True)
            return tomllib.loads(done.stdout)
        self.assertEqual(printed()["drain-ms-max"], "100")
        told = printed(RAYNEST_DRAIN_MS_MAX="200", RAYNEST_CUDA="off")
        self.assertEqual((told["drain-ms-max"], told["principal-scenes-max"], told["cuda"]), ("200", "1", "off"))
        self.assertEqual(printed(RAYNEST_DRAIN_MS_MAX="")["drain-ms-max"], "100")
        told = printed("--drain-ms-max", "300", RAYNEST_DRAIN_MS_MAX="200")
        self.assertEqual(told["drain-ms-max"], "300")
        # Every option of the list has its variable.
        shown = subprocess.run([self.raynestd, "--help"], capture_output=True, text=True, check=True).stdout
        for name in told:
            self.assertIn("Env:RAYNEST_" + name.upper().replace("-", "_") + ")", shown)

    def bad_files(self):
        """Yields files that are no configuration, one of each kind."""
        pipe = self.folder / "pipe.toml"
        os.mkfifo(pipe)
        yield pipe, "it is not a regular file"
        zero = self.folder / "zero.toml"
        zero.symlink_to("/dev/zero")
        yield zero, "it is not a regular file"
        large = self.folder / "large.toml"
        with open(large, "wb") as file:
            file.truncate(3 << 30)
        yield large, "it is over 1048576 bytes"

    def test_a_configuration_is_a_regular_file_of_bounded_size(self):
        good = self.folder / "good.toml"
        good.write_text('log-level = "info"\n')
        self.config.symlink_to(good)
        daemon = self.daemon("--config", self.config)
        client = Client(self.raynest, daemon.uri)
        for seen, (file, why) in enumerate(self.bad_files(), 1):
            begun = time.monotonic()
            done = subprocess.run([self.raynestd, "--config", file], capture_output=True, text=True,
                                  stdin=subprocess.DEVNULL, timeout=PATIENCE, check=False)
            self.assertLess(time.monotonic() - begun, PATIENCE / 3)
            self.says(done, 2, f"--config: cannot read {file}: {why}")
            self.config.unlink()
            self.config.symlink_to(file)
            daemon.process.send_signal(signal.SIGHUP)
            until(lambda: daemon.log().count(" reloaded ") == seen)
            self.assertIn(why, daemon.log())
            self.assertEqual(client.run("scenes").returncode, 0)
        self.assertLess(daemon.resident_bytes("VmHWM"), 2 << 30)

    def test_a_reload_of_an_unusable_file_fails_and_says_why(self):
        self.config.write_text("threads = 1\n")
        daemon, root, _ = self.local("--config", self.config)
        self.says(root.run("admin", "reload"), 0, "were read again")
        self.config.write_text("threads = 1\nthrads = 2\n")
        said = self.says(root.run("admin", "reload"), 5, "raynestd.toml, line 2: there is no option 'thrads'",
                         "the old content stays").stderr
        self.assertNotIn(str(self.folder), said)
        line, = re.findall(r"configuration_unusable reason=\"(.*?)\" ", daemon.log())
        self.assertTrue(line.startswith(str(self.config)), line)
        self.assertNotRegex(line, "raynestd: |--help")
        self.config.write_text("threads = 1\n")
        (self.folder / "tokens").write_text("rubbish\n")
        self.says(root.run("admin", "reload"), 5, "tokens, line 1")

    def test_a_reload_of_an_unusable_certificate_fails(self):
        certificates = Certificates(self.raynestd, self.folder / "tls")
        daemon, root, _ = self.local("--listen", "tls://127.0.0.1:0", *certificates.server)
        self.says(root.run("admin", "reload"), 0, "were read again")
        (certificates.folder / "cert.pem").write_text("rubbish\n")
        self.says(root.run("admin", "reload"), 5, "cert.pem")

    # ---- statistics and quotas ------------------------------------------------------------------

    def test_statistics_of_others_than_administrators_are_their_own(self):
        daemon, root, clients = self.local("--anonymous", "user")
        anybody = Client(self.raynest, daemon.uri)
        shown = ("scenes", "scene_bytes", "memory_used_bytes", "scenes_unlisted", "scenes_unlisted_bytes", "rays",
                 "jobs_started", "jobs_ended", "jobs_done", "scenes_loaded", "bytes_received", "connections_open",
                 "jobs_running")
        for name in shown:  # nothing of an earlier connection comes late
            until(lambda: anybody.json("stats")["connections_open"] == 1)
        before = anybody.json("stats")
        clients["bob"].json("load", "builtin:terrain?size=64", "--name", "car")
        clients["bob"].run("query", "car", "--ray", "0,9,0,0,-1,0")
        after = anybody.json("stats")
        for name in shown:
            if name != "bytes_received":  # the look itself adds to it
                self.assertEqual(after[name], before[name], name)
        self.assertLess(after["bytes_received"] - before["bytes_received"], 2000)
        own, whole = clients["bob"].json("stats"), root.json("stats")
        self.assertEqual((own["scenes"], own["rays"]), (1, 1))
        self.assertGreater(own["memory_used_bytes"], 100_000)
        self.assertGreaterEqual(own["memory_used_bytes"], own["scene_bytes"])
        self.assertEqual(whole["scenes"], 1)
        self.assertGreaterEqual(whole["rays"], 1)
        self.assertIn("your memory 0", anybody.run("top", "--once").stdout)

    def test_a_refusal_by_a_quota_names_the_quota(self):
        daemon, root, clients = self.local("--principal-scenes-max", "2")
        carol, bob = clients["carol"], clients["bob"]
        self.says(carol.run("load", "builtin:terrain?size=64", "--name", "large"), 6,
                  "its quota is scene_bytes=100000", "raynest admin quota carol scene_bytes=N")
        carol.json("load", SCENE, "--name", "small")
        self.says(carol.run("query", "small", "--generate", "equirectangular", "size=64x32", "-o",
                            self.folder / "a.npz"), 5, "its quota is rays=100", "raynest admin quota carol rays=N")
        # An administrator's quota counts before the token's until the daemon ends.
        self.says(root.run("admin", "quota", "carol", "rays=10000"), 0, "until the daemon ends")
        self.says(carol.run("query", "small", "--generate", "equirectangular", "size=64x32", "-o",
                            self.folder / "a.npz"), 0)
        bob.json("load", SCENE, "--name", "a")
        bob.json("load", SCENE, "--name", "b")
        self.says(bob.run("load", SCENE, "--name", "c"), 6, "--principal-scenes-max 2")
        self.says(root.run("admin", "quota", "bob", "rays=5"), 0)
        said = self.says(bob.run("query", "a", "--generate", "equirectangular", "size=4x2", "-o",
                                 self.folder / "a.npz"), 5, "its quota is rays=5").stderr
        self.assertNotIn("--principal", said)

    def test_quotas_that_make_no_sense_are_refused(self):
        daemon, root, _ = self.local()
        for words, why in (("second_bytes=1", "the least second_bytes is 65536"), ("", "write one"),
                           ("jobs=1,jobs=2", "jobs is given twice"), ("jobs=0", "not a quota"), ("jobs=1,", "not a quota")):
            done = subprocess.run([self.raynestd, "token", "add", "dave", "--quota", words, "--tokens",
                                   self.folder / "tokens"], capture_output=True, text=True, timeout=PATIENCE,
                                  check=False)
            self.says(done, 2, why)
            if words and not words.endswith(","):
                self.says(root.run("admin", "quota", "bob", words), 2, why)

    def test_acts_on_nobody_say_so(self):
        daemon, root, clients = self.local()
        self.says(root.run("admin", "quota", "nosuch", "jobs=1"), 5, "nobody is called 'nosuch'")
        self.says(root.run("admin", "quota", "bob", "jobs=1"), 0)  # has a token
        self.says(root.run("admin", "kick", "nosuch"), 5, "nobody is called 'nosuch'")
        self.says(root.run("admin", "kick", "123456"), 5, "no connection 123456")
        self.says(root.run("admin", "kick", "bob"), 0, "0 connections ended")
        clients["carol"].json("load", SCENE, "--name", "hills")
        busy = clients["carol"].start("top")
        until(lambda: any(row["principal"] == "carol" for row in root.json("admin", "connections")["connections"]))
        self.assertEqual(root.run("admin", "kick", "carol").stdout, "1 connection ended\n")
        busy.communicate(timeout=PATIENCE)

    def test_an_administrator_is_told_that_several_owners_have_a_scene(self):
        daemon, root, clients = self.local()
        for name in ("bob", "carol"):
            clients[name].json("load", SCENE, "--name", "car")
        for act in ("unload", "info"):
            said = self.says(root.run(act, "car"), 5, "several owners have a scene 'car'").stderr
            self.assertRegex(said, r"name one of (bob/car, carol/car|carol/car, bob/car)")
        # The alert about memory advises this.
        self.says(root.run("unload", "bob/car"), 0)
        self.assertEqual([scene["owner"] for scene in root.json("scenes")["scenes"]], ["carol"])

    # ---- the log --------------------------------------------------------------------------------

    def test_a_refused_login_has_the_id_of_its_line(self):
        daemon, _, _ = self.local("--anonymous", "off")
        for token in (None, "rnt_" + "0" * 64):
            said = self.says(Client(self.raynest, daemon.uri, token).run("scenes"), 4).stderr
            tag = re.search(r" \[request ([0-9a-f]+)\]\n$", said)
            self.assertIsNotNone(tag, said)
            lines = [line for line in daemon.log().splitlines() if f"request_id={tag[1]}" in line]
            self.assertEqual(len(lines), 1, daemon.log())
            self.assertIn(" login_refused ", lines[0])

    def test_a_refused_request_is_logged_once(self):
        daemon, _, clients = self.local()
        said = self.says(clients["vera"].run("load", SCENE), 4, "needs the role user").stderr
        tag = re.search(r"\[request ([0-9a-f]+)\]", said)[1]
        lines = [line for line in daemon.log().splitlines() if f"request_id={tag}" in line]
        self.assertEqual(len(lines), 1, lines)
        self.assertIn(" request_refused principal=vera role=viewer request=Load", lines[0])

    def test_lines_that_a_full_disk_takes_are_counted(self):
        log = self.folder / "log"
        # A limit of the file's size stands for a full disk; the shell keeps its signal from the daemon.
        under = ("sh", "-c", 'trap "" XFSZ; exec prlimit --fsize=2048 "$0" "$@" 2>>' + f"'{log}'")
        daemon = self.daemon("--http", "127.0.0.1:0", "--log-level", "debug", under=under)
        client = Client(self.raynest, daemon.uri)

        def lost():
            with urlopen(daemon.http + "/metrics", timeout=PATIENCE) as answer:
                return int(float(re.search(r"^raynest_log_lines_lost (\S+)$", answer.read().decode(), re.M)[1]))
        for _ in range(40):
            self.assertEqual(client.run("info", "nowhere").returncode, 5)
        until(lambda: lost() > 0)
        self.assertLessEqual(log.stat().st_size, 2048)
        count = lost()
        os.truncate(log, 0)
        client.run("info", "nowhere")
        until(lambda: "log_lines_lost" in log.read_text())
        told = int(re.search(r"log_lines_lost lines=(\d+)", log.read_text())[1])
        self.assertEqual(log.read_text().count("log_lines_lost"), 1)
        self.assertGreaterEqual(told, count)
        self.assertEqual(lost(), told)
        for line in log.read_text().splitlines()[1:]:
            self.assertRegex(line, r"^\d{4}-\d\d-\d\dT")

    def test_a_flood_of_broken_handshakes_takes_few_lines(self):
        daemon = SecureDaemon(self.raynestd, self.certificates)
        self.addCleanup(daemon.stop)
        count = 200
        begun = time.monotonic()
        for _ in range(count):
            with socket.create_connection(("127.0.0.1", daemon.port), timeout=PATIENCE) as one:
                one.sendall(b"\x16\x03\x01\x00\x05hello")
                while one.recv(4096):
                    pass
        seconds = time.monotonic() - begun

        def lines():
            return re.findall(r" handshake_failed (.*)", daemon.log())

        def left_out():
            return sum(int(number) for line in lines() for number in re.findall(r"left_out=(\d+)", line))
        until(lambda: left_out() + sum("peer=" in line for line in lines()) == count,
              lambda: str(lines()))
        self.assertLessEqual(len(lines()), 6 * (seconds + 2))
        self.assertGreater(left_out(), 0)
        client = SecureClient(self.raynest, daemon.uri)
        self.assertEqual(client.run("scenes").returncode, 0)

    def test_long_turns_take_few_lines_at_level_debug_too(self):
        daemon = SecureDaemon(self.raynestd, self.certificates, "--log-level", "debug")
        self.addCleanup(daemon.stop)
        begun = time.monotonic()
        for _ in range(100):  # handshakes are turns of 0.3 ms and more
            with socket.create_connection(("127.0.0.1", daemon.port), timeout=PATIENCE) as one:
                with ssl._create_unverified_context().wrap_socket(one):  # pylint: disable=protected-access
                    pass
        seconds = time.monotonic() - begun
        self.assertLessEqual(len(re.findall(r" long_turn ", daemon.log())), 6 * (seconds + 2))


if __name__ == "__main__":
    main()
