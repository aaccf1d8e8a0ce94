#!/usr/bin/env python3
"""Tests the package's unit: its score, its alerts, and the daemon under its restrictions, as far as a
machine without systemd allows. Exit code 77 (skipped) where systemd-analyze is missing.

  service_test.py RAYNESTD RAYNEST CONFINE IMPORT_CHILD
"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib

from daemon import PATIENCE, Client, Daemon, Programs, main, skip_sanitized, until
from running_test import CORNERS, TRIANGLE

PACKAGE = pathlib.Path(__file__).resolve().parents[2] / "server" / "package"
UNIT = PACKAGE / "raynestd.service"
SCORE_MAX = 1.5
RAYS = ("--ray", "8,50,-8,0,-1,0", "--ray", "3,50,2,0,-1,0")


def values(key):
    """Returns the values of a key of the unit, in order."""
    return re.findall(rf"^{key}=(.*)$", UNIT.read_text(), re.M)


def calls_of(name):
    """Returns the system calls of a name, which may be a set such as @network-io."""
    if not name.startswith("@"):
        return {name}
    listed = subprocess.run(["systemd-analyze", "syscall-filter", name], capture_output=True,
                            text=True, check=True).stdout.splitlines()[1:]
    words = (line.strip() for line in listed)
    return set().union(*(calls_of(word) for word in words if word and word[0] != "#"))


def allowed_calls():
    """Returns the calls that the unit's SystemCallFilter= lines leave."""
    calls = calls_of("@default")
    for line in values("SystemCallFilter"):
        named = set().union(*(calls_of(word) for word in line.lstrip("~").split()))
        calls = calls - named if line.startswith("~") else calls | named
    return calls


class Service(Programs):
    confine = import_child = None

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest-service-")))
        if not shutil.which("systemd-analyze"):
            self.skipTest("skipped: there is no systemd-analyze (Debian: systemd)")

    def calls_file(self):
        file = self.folder / "calls"
        file.write_text("\n".join(sorted(allowed_calls())))
        return file

    def test_the_unit_exposes_little(self):
        told = subprocess.run(["systemd-analyze", "security", "--offline=true", UNIT],
                              capture_output=True, text=True, check=False)
        score = re.search(r"Overall exposure level for raynestd.service: ([\d.]+)", told.stdout)
        self.assertIsNotNone(score, told.stdout + told.stderr)
        self.assertLessEqual(float(score[1]), SCORE_MAX)

    def test_the_unit_keeps_the_users_of_the_machine(self):
        # In a user namespace the socket's peers would all be one principal.
        self.assertEqual(values("PrivateUsers"), [])

    def test_users_whom_a_namespace_hides_need_a_token(self):
        if os.geteuid() != 0 or subprocess.run(["unshare", "-U", "--map-root-user", "true"],
                                               capture_output=True, check=False).returncode != 0:
            self.skipTest("skipped: needs root and user namespaces")
        self.folder.chmod(0o755)
        path = self.folder / "socket"
        tokens = self.folder / "tokens"
        secret = subprocess.run([self.raynestd, "token", "add", "bob", "--tokens", tokens], text=True,
                                capture_output=True, check=True, timeout=PATIENCE).stdout.splitlines()[-1]
        daemon = Daemon(self.raynestd, "--listen", f"unix:{path}", "--socket-mode", "0666", "--tokens",
                        tokens, under=("unshare", "-U", "--map-root-user"))
        self.addCleanup(daemon.stop)
        self.assertIn(" users_unknown ", daemon.log())
        uri = f"unix:{path}"

        def run(client, user, *command):
            process = client.start(*command, user=user, group=user, extra_groups=[])
            said = "".join(process.communicate(timeout=PATIENCE))
            return process.returncode, said
        for user in (5001, 5002, 65534):
            code, said = run(Client(self.raynest, uri), user, "load", "builtin:terrain?size=8")
            self.assertEqual(code, 4, said)
            self.assertIn("stands for several users", said)
            code, said = run(Client(self.raynest, uri, secret), user, "scenes")
            self.assertEqual(code, 0, said)
        self.assertEqual(run(Client(self.raynest, uri), 0, "admin", "connections")[0], 0)

    def test_users_of_the_machine_are_principals_of_their_own(self):
        if os.geteuid() != 0:
            self.skipTest("skipped: needs root")
        self.folder.chmod(0o755)
        path = self.folder / "socket"
        daemon = Daemon(self.raynestd, "--listen", f"unix:{path}", "--socket-mode", "0666")
        self.addCleanup(daemon.stop)
        self.assertNotIn(" users_unknown ", daemon.log())
        client = Client(self.raynest, f"unix:{path}")
        for user, command, wanted in ((5001, ("load", "builtin:terrain?size=8"), 0),
                                      (5002, ("unload", "terrain"), 5), (65534, ("scenes",), 0),
                                      (5001, ("unload", "terrain"), 0)):
            process = client.start(*command, user=user, group=user, extra_groups=[])
            said = process.communicate(timeout=PATIENCE)
            self.assertEqual(process.returncode, wanted, said)

    def test_the_alerts_name_commands_that_there_are(self):
        for line in re.findall(r"remedy: (.*)", (PACKAGE / "alerts.yml").read_text()):
            for command in re.findall(r"raynest ((?:admin )?[a-z]+)", line):
                shown = subprocess.run([self.raynest, *command.split()[:1], "--help"], text=True,
                                       capture_output=True, timeout=PATIENCE, check=False)
                self.assertEqual(shown.returncode, 0, command)
            # By itself it frees only what its caller holds, and it needs a time.
            self.assertNotIn("--idle", line)

    def test_the_unit_and_the_configuration_name_the_same_sockets(self):
        done = subprocess.run([self.raynestd, "--config", PACKAGE / "raynestd.toml", "--print-config"],
                              capture_output=True, text=True, check=True, timeout=PATIENCE)
        printed = tomllib.loads(done.stdout)
        wanted = {uri.removeprefix("unix:").removeprefix("tcp://") for uri in [*printed["listen"], printed["http"]]}
        socket = (PACKAGE / "raynestd.socket").read_text()
        self.assertEqual(set(re.findall(r"^ListenStream=(.*)$", socket, re.M)), wanted)

    def test_the_alerts_are_valid_and_name_metrics_that_there_are(self):
        text = (PACKAGE / "alerts.yml").read_text()
        if shutil.which("promtool"):
            checked = subprocess.run(["promtool", "check", "rules", PACKAGE / "alerts.yml"],
                                     capture_output=True, text=True, check=False)
            self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        tls = self.folder / "tls"
        subprocess.run([self.raynestd, "tls", "init", tls], check=True, capture_output=True,
                       timeout=PATIENCE)
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0", "--listen", "tls://127.0.0.1:0",
                        "--state", self.folder / "state", "--tls-cert", tls / "cert.pem", "--tls-key", tls / "key.pem")
        self.addCleanup(daemon.stop)
        from urllib.request import urlopen
        with urlopen(daemon.http + "/metrics", timeout=PATIENCE) as answer:
            metrics = answer.read().decode()
        names = set(re.findall(r"\b(?:raynest|process)_\w+", "\n".join(
            line for line in text.splitlines() if "expr:" in line)))
        self.assertGreater(len(names), 6)
        for name in names:
            self.assertRegex(metrics, rf"(?m)^{name}[ {{]")
        days = float(re.search(r"^raynest_tls_certificate_days_left (\S+)$", metrics, re.M)[1])
        self.assertAlmostEqual(days, 397, delta=1.5)

    def confined(self):
        """Returns a command that runs a program as the unit does: unprivileged, with a read-only
        file system but for one folder, and with the unit's system calls."""
        if os.geteuid() != 0:
            return (self.confine, self.calls_file())
        self.folder.chmod(0o755)
        state = self.folder / "state"
        state.mkdir()
        os.chown(state, 65534, 65534)
        script = ('mount --make-rprivate / && mount -o remount,bind,ro / && '
                  'mount --bind "$0" "$0" && mount -o remount,bind,rw "$0" && cd / && '
                  'exec setpriv --reuid=65534 --regid=65534 --clear-groups --bounding-set=-all '
                  '--inh-caps=-all --no-new-privs "$@"')
        try:
            subprocess.run(["unshare", "--mount", "sh", "-c", script, state, "true"], check=True,
                           capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return (self.confine, self.calls_file())
        return ("unshare", "--mount", "sh", "-c", script, state, self.confine, self.calls_file())

    def skip_without_confine(self):
        if not os.access(self.confine, os.X_OK):
            self.skipTest("skipped: built without libseccomp")
        skip_sanitized(self, self.raynestd, "makes system calls of its own")

    def test_the_daemon_works_under_the_unit_s_restrictions(self):
        self.skip_without_confine()
        plain = Daemon(self.raynestd)
        self.addCleanup(plain.stop)
        expected = Client(self.raynest, plain.uri)
        # The ready file, which the harness reads, is written in the one folder that is writable.
        scenes = self.folder / "scenes"
        (scenes / "inner").mkdir(parents=True)
        (scenes / "inner" / "corner.gltf").write_text(json.dumps(TRIANGLE))
        (scenes / "inner" / "corners.bin").write_bytes(CORNERS)
        (scenes / "link.gltf").symlink_to("inner/corner.gltf")
        daemon = ConfinedDaemon(self.confined(), self.raynestd, self.folder / "state", "--scene-root", scenes,
                                "--load", scenes / "inner" / "*.gltf")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        answers = []
        for one in (client, expected):
            loaded = one.json("load", "builtin:forest?trees=20", "--name", "woods")
            hits = one.run("--json", "query", "woods", *RAYS)
            self.assertEqual(hits.returncode, 0, hits.stderr)
            picture = self.folder / f"{len(answers)}.png"
            drawn = one.run("render", "woods", "--size", "64x64", "-o", picture)
            self.assertEqual(drawn.returncode, 0, drawn.stderr)
            answers.append((loaded["hash"], hits.stdout, picture.read_bytes()))
        self.assertEqual(*answers)
        # The unit takes openat2() away: files are found without it, and links are not followed.
        corner = client.json("load", "root:inner/corner.gltf", "--name", "again")
        until(lambda: client.run("info", "corner").returncode == 0)
        self.assertEqual(client.json("info", "corner")["hash"], corner["hash"])
        for name, why in (("link.gltf", "links"), ("../corner.gltf", "the path leaves"), ("none.gltf", "no such file")):
            refused = client.run("load", f"root:{name}")
            self.assertEqual(refused.returncode, 5, refused.stderr)
            self.assertIn(why, refused.stderr)

    def test_an_import_that_runs_out_of_memory_ends_alone(self):
        self.assertEqual(values("OOMPolicy"), ["continue"])

    def test_a_kernel_without_a_sandbox_is_named_at_the_start(self):
        self.skip_without_confine()
        kept = allowed_calls() - {"seccomp"} - {f"landlock_{word}" for word in
                                                ("create_ruleset", "add_rule", "restrict_self")}
        calls = self.folder / "fewer"
        calls.write_text("\n".join(sorted(kept)))
        says = "no seccomp filter can be set here, and the kernel offers no Landlock"
        checked = subprocess.run([self.confine, calls, self.raynestd, "--check-config"],
                                 capture_output=True, text=True, check=True, timeout=PATIENCE)
        self.assertIn(f"warning: {says}", checked.stdout)
        daemon = Daemon(self.raynestd, under=(self.confine, calls))
        self.addCleanup(daemon.stop)
        self.assertIn(f' import_sandbox_weak reason="{says}', daemon.log())
        plain = Daemon(self.raynestd)
        self.addCleanup(plain.stop)
        self.assertNotIn(" import_sandbox_weak ", plain.log())

    def test_the_import_process_closes_itself_off_there_too(self):
        self.skip_without_confine()
        done = subprocess.run([*map(str, self.confined()), str(self.import_child), "--sandbox"],
                              capture_output=True, check=False, timeout=PATIENCE)
        # 100: every call that an attacker would try is refused.
        self.assertEqual(done.returncode, 100, done.stderr)


class ConfinedDaemon:
    def __init__(self, command, raynestd, state, *arguments):
        ready = state / "ready.json"
        self.log = open(state.parent / "log", "wb")
        self.process = subprocess.Popen(
            [*map(str, command), str(raynestd), "--listen", "tcp://127.0.0.1:0", "--http", "off",
             "--cuda", "off", "--state", str(state), "--ready-file", str(ready), *map(str, arguments)],
            stdin=subprocess.DEVNULL, stdout=self.log, stderr=self.log)
        until(lambda: ready.exists() or self.process.poll() is not None)
        if not ready.exists():
            raise AssertionError((state.parent / "log").read_text())
        self.uri = json.loads(ready.read_text())["listen"][0]

    def stop(self):
        self.process.terminate()
        code = self.process.wait(PATIENCE)
        self.log.close()
        if code != 0:
            raise AssertionError(f"raynestd ended with {code}")


if __name__ == "__main__":
    Service.confine, Service.import_child = sys.argv[3:5]
    del sys.argv[3:5]
    main()
