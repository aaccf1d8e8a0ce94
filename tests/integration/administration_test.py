#!/usr/bin/env python3
"""Tests an administrator's tools: the ready file, signals, the log, the Unix socket, empty folders.

  administration_test.py RAYNESTD RAYNEST
"""
import json
import os
import pathlib
import re
import signal
import socket
import stat
import subprocess
import tempfile

from daemon import Client, Daemon, PATIENCE, Programs, main, until

RAY = "0,50,0,0,-1,0"


class Administration(Programs):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="raynest test ")))

    def daemon(self, *arguments):
        daemon = Daemon(self.raynestd, *arguments)
        self.addCleanup(daemon.stop)
        return daemon

    def busy(self, *arguments):
        """Returns a daemon and a client for which it renders."""
        daemon = Daemon(self.raynestd, *arguments)
        self.addCleanup(daemon.folder.cleanup)
        self.addCleanup(daemon.process.kill)
        client = Client(self.raynest, daemon.uri)
        self.assertEqual(client.run("load", "builtin:forest?trees=2000").returncode, 0)
        busy = client.start("render", "forest", "--size", "4096x4096", "--traversal", "reference",
                            "-o", self.folder / "a.png")
        until(lambda: client.json("jobs")["jobs"])
        return daemon, busy

    def refused(self, *arguments):
        """Returns the error output of a daemon that does not start."""
        done = subprocess.run([self.raynestd, "--cuda", "off", *map(str, arguments)], text=True,
                              stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE)
        return done.returncode, done.stderr

    def lines(self, daemon, event):
        """Returns the log's lines of an event, each as a dict of its fields and `level`."""
        found = []
        for line in daemon.log().splitlines():
            words = re.findall(r'(?:[^\s"]|"(?:\\.|[^"\\])*")+', line)
            if len(words) > 2 and words[2] == event:
                fields = dict(word.split("=", 1) for word in words[3:])
                found.append({"level": words[1], **fields})
        return found

    def level_after(self, job):
        """Returns the log level of a job whose only notable property may be its time."""
        return "info" if float(job["seconds"]) > 1 else "debug"

    def test_a_ready_file_replaces_nothing_that_is_not_its_own(self):
        ready = self.folder / "ready.json"
        ready.write_text("precious\n")
        listen = ("--listen", "tcp://127.0.0.1:0", "--ready-file", ready)
        code, said = self.refused(*listen)
        self.assertEqual(code, 1)
        self.assertIn(f"{ready} is neither empty nor a ready file", said)
        self.assertEqual(ready.read_text(), "precious\n")
        ready.write_text("")
        process = subprocess.Popen([self.raynestd, "--cuda", "off", *map(str, listen)],
                                   stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            until(lambda: ready.read_text() != "")
            self.assertIn(str(process.pid), ready.read_text())
        finally:
            process.terminate()
            self.assertEqual(process.wait(PATIENCE), 0)
        self.assertFalse(ready.exists())
        self.assertEqual(list(self.folder.iterdir()), [])

    def test_a_hangup_reads_files_again_and_goes_on(self):
        daemon = self.daemon()
        client = Client(self.raynest, daemon.uri)
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: self.lines(daemon, "reloaded"))
        self.assertEqual(self.lines(daemon, "reloaded")[0]["level"], "info")
        self.assertEqual(client.run("scenes").returncode, 0)

    def test_a_hangup_takes_changed_options_and_names_those_that_wait_for_a_restart(self):
        config = self.folder / "raynestd.toml"
        config.write_text('log-level = "info"\nprincipal-scenes-max = 1\nthreads = 2\n')
        daemon = self.daemon("--config", config)
        client = Client(self.raynest, daemon.uri)
        self.assertEqual(client.run("load", "builtin:terrain?size=8", "--name", "a").returncode, 0)
        second = ("load", "builtin:terrain?size=9", "--name", "b")
        self.assertEqual(client.run(*second).returncode, 6)
        config.write_text('log-level = "debug"\nprincipal-scenes-max = 2\nthreads = 1\n')
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: self.lines(daemon, "reloaded"))
        self.assertEqual(self.lines(daemon, "reloaded")[0]["changed"], "log-level,principal-scenes-max")
        self.assertEqual(self.lines(daemon, "restart_needed")[0]["options"], "threads")
        self.assertEqual(client.run(*second).returncode, 0)
        self.assertTrue(self.lines(daemon, "greeted"), "debug is on")

    def test_a_hangup_with_a_bad_file_keeps_the_old_settings_and_names_the_mistake(self):
        config = self.folder / "raynestd.toml"
        config.write_text("principal-scenes-max = 1\n")
        daemon = self.daemon("--config", config)
        client = Client(self.raynest, daemon.uri)
        config.write_text("principal-scenes-max = 9\nprincipal-scnes-max = 2\n")
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: self.lines(daemon, "reloaded"))
        line, = self.lines(daemon, "configuration_unusable")
        self.assertEqual(line["level"], "error")
        self.assertRegex(line["reason"], "raynestd.toml, line 2: .*'principal-scnes-max'")
        self.assertEqual(self.lines(daemon, "reloaded")[0]["level"], "error")
        client.run("load", "builtin:terrain?size=8", "--name", "a")
        self.assertEqual(client.run("load", "builtin:terrain?size=9", "--name", "b").returncode, 6)

    def test_an_error_names_its_request_as_the_log_does(self):
        daemon = self.daemon("--log-level", "debug")
        client = Client(self.raynest, daemon.uri)
        done = client.run("info", "nowhere")
        tag = re.search(r" \[request ([0-9a-f]+)\]\n$", done.stderr)[1]
        line, = (line for line in self.lines(daemon, "refused") if line.get("request_id") == tag)
        self.assertEqual(line["code"], "SCENE_UNKNOWN")
        failed = json.loads(client.run("--json", "load", "builtin:forest?trees=0").stderr)["error"]
        line, = (line for line in self.lines(daemon, "job") if line["request_id"] == failed["request"])
        self.assertRegex(line["outcome"], "SCENE_INVALID")
        greeted = {line["connection"] for line in self.lines(daemon, "greeted")}
        self.assertIn(line["connection"], greeted)

    def test_the_log_may_be_json(self):
        daemon = self.daemon("--log-format", "json", "--log-level", "debug")
        client = Client(self.raynest, daemon.uri)
        client.run("info", 'a\x1b[2J\n{"event":"forged"}')
        name = 'a "b"'
        self.assertEqual(client.run("load", "builtin:terrain?size=8", "--name", name).returncode, 0)
        lines = [json.loads(line) for line in daemon.log().splitlines()]
        loaded, = (line for line in lines if line["event"] == "loaded")
        self.assertEqual((loaded["scene"], loaded["level"], loaded["principal"]),
                         (name, "info", "127.0.0.1"))
        self.assertRegex(loaded["time"], r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d$")
        self.assertRegex(loaded["request_id"], "^[0-9a-f]+$")
        refused, = (line for line in lines if line["event"] == "refused")
        self.assertEqual(refused["message"], "`scene` is not printable UTF-8")

    def test_jobs_that_the_drain_cuts_off_are_not_blamed_on_their_clients(self):
        daemon, busy = self.busy("--drain-ms-max", "200")
        daemon.process.terminate()
        daemon.process.wait(PATIENCE)
        _, errors = busy.communicate(timeout=PATIENCE)
        self.assertEqual(busy.returncode, 6, errors)
        outcomes = {line["outcome"] for line in self.lines(daemon, "job") if line["kind"] == "render"}
        self.assertEqual(outcomes, {"DRAINING"})

    def test_a_pack_folder_without_packs_is_warned_of(self):
        daemon = self.daemon("--pack-dir", self.folder)
        line = self.lines(daemon, "pack_dir_empty")[0]
        self.assertEqual(line["level"], "warning")
        self.assertIn(str(self.folder), line["reason"])

    def test_a_unix_socket_is_opened_to_a_group(self):
        group = next((g for g in os.getgroups() if g != os.getgid()), os.getgid())
        for arguments, mode in ((("--socket-mode", "0660"), 0o660),
                                (("--socket-group", str(group)), 0o660),
                                (("--socket-group", str(group), "--socket-mode", "0600"), 0o600),
                                ((), 0o600)):
            path = self.folder / "socket"
            before = os.umask(0o077)  # the daemon must not apply the umask to the requested mode
            try:
                daemon = Daemon(self.raynestd, "--listen", f"unix:{path}", *arguments)
            finally:
                os.umask(before)
            try:
                status = path.stat()
                self.assertEqual(stat.S_IMODE(status.st_mode), mode, arguments)
                if "--socket-group" in arguments:
                    self.assertEqual(status.st_gid, group)
                self.assertEqual(Client(self.raynest, f"unix:{path}").run("scenes").returncode, 0)
            finally:
                daemon.stop()
            self.assertFalse(path.exists())

    def test_what_cannot_be_printed_is_a_failure(self):
        for command in ((self.raynestd, "--print-config"), (self.raynestd, "--help"),
                        (self.raynest, "--help"), (self.raynest, "--version")):
            with open("/dev/full", "wb") as full:
                done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False,
                                      text=True, timeout=PATIENCE)
            self.assertEqual(done.returncode, 1, command)
            self.assertIn("cannot write stdout", done.stderr)

    def raynestd_says(self, *arguments):
        done = subprocess.run([self.raynestd, *map(str, arguments)], capture_output=True, check=False,
                              text=True, timeout=PATIENCE)
        return done.returncode, done.stdout + done.stderr

    def test_a_configuration_that_cannot_be_read_says_why(self):
        for file, why in ((self.folder, "it is a folder; name a file in it"),
                          (self.folder / "nowhere", "No such file or directory")):
            self.assertEqual(self.raynestd_says("--config", file),
                             (2, f"raynestd: --config: cannot read {file}: {why}; see raynestd --help\n"))

    def test_help_has_words_and_no_names_of_checks(self):
        code, text = self.raynestd_says("--help")
        self.assertEqual(code, 0)
        self.assertIn("Compute threads, 1 to 1024", text)
        self.assertNotRegex(text, r"UINT:UINT|in \[1 - |OR \(FILE\)|TEXT:\{|:DIR")

    def test_options_of_a_unix_socket_that_is_not_there_are_warned_of(self):
        daemon = self.daemon("--socket-mode", "0660")
        self.assertEqual(self.lines(daemon, "socket_access_unused")[0]["level"], "warning")

    def test_the_first_line_says_what_was_started(self):
        daemon = self.daemon("--threads", "2", "--memory", "64M")
        line = self.lines(daemon, "started")[0]
        self.assertEqual((line["pid"], line["threads"], line["memory"]),
                         (str(daemon.process.pid), "2", '"64.0 MiB"'))
        self.assertRegex(line["target"], "v[234]")

    def test_too_few_descriptors_are_named_with_their_remedy(self):
        done = subprocess.run(["prlimit", "--nofile=31", self.raynestd, "--cuda", "off", "--listen",
                               "tcp://127.0.0.1:0"], stdin=subprocess.DEVNULL, capture_output=True,
                              check=False, text=True, timeout=PATIENCE)
        self.assertEqual(done.returncode, 1)
        self.assertIn("raise LimitNOFILE or ulimit -n", done.stderr)

    def test_a_forced_end_takes_the_ready_file_along(self):
        daemon, busy = self.busy()
        ready = pathlib.Path(daemon.folder.name) / "ready.json"
        self.assertTrue(ready.exists())
        daemon.process.send_signal(signal.SIGTERM)
        until(lambda: self.lines(daemon, "draining"))
        daemon.process.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.process.wait(PATIENCE), 3)
        self.assertFalse(ready.exists())
        busy.communicate(timeout=PATIENCE)

    def test_the_service_manager_is_told_how_the_daemon_is(self):
        path = self.folder / "notify"
        manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.addCleanup(manager.close)
        manager.bind(str(path))
        manager.settimeout(PATIENCE)
        daemon = Daemon(self.raynestd, under=("env", f"NOTIFY_SOCKET={path}", "WATCHDOG_USEC=200000"))
        self.assertEqual(manager.recv(100), b"READY=1")
        for _ in range(3):
            self.assertEqual(manager.recv(100), b"WATCHDOG=1")
        daemon.process.send_signal(signal.SIGHUP)
        until(lambda: manager.recv(100) == b"RELOADING=1")
        until(lambda: manager.recv(100) == b"READY=1")
        daemon.stop()
        until(lambda: manager.recv(100) == b"STOPPING=1")

    def test_who_may_not_open_the_socket_reads_how_to(self):
        path = self.folder / "socket"
        self.daemon("--listen", f"unix:{path}")
        self.folder.chmod(0o755)
        stranger = {"user": 65534, "group": 65534, "extra_groups": []}
        if os.geteuid() != 0:
            path.chmod(0)
            stranger = {}
        process = Client(self.raynest, f"unix:{path}").start("scenes", **stranger)
        _, said = process.communicate(timeout=PATIENCE)
        self.assertEqual(process.returncode, 4, said)
        self.assertIn("join its group, or start raynestd with --socket-group", said)

    def test_a_file_that_is_no_socket_is_named_so(self):
        file = self.folder / "file"
        file.write_text("")
        done = Client(self.raynest, f"unix:{file}").run("scenes")
        self.assertEqual(done.returncode, 3)
        self.assertIn("it is no socket", done.stderr)

    def test_unload_goes_on_after_a_name_that_is_not_there(self):
        client = Client(self.raynest, self.daemon().uri)
        for name in ("a", "b"):
            client.json("load", "builtin:terrain?size=8", "--name", name)
        done = client.run("unload", "a", "nobody", "b", "gone")
        self.assertEqual(done.returncode, 5)
        self.assertEqual(done.stdout, "unloaded a\nunloaded b\n")
        for name in ("'nobody'", "'gone'"):
            self.assertIn(name, done.stderr)
        self.assertEqual(client.json("scenes")["scenes"], [])
        self.assertIn("go with their connections", client.run("unload", "--all").stdout)

    def test_jobs_of_a_client_that_is_killed_count_as_cancelled(self):
        daemon = self.daemon()
        client = Client(self.raynest, daemon.uri)
        self.assertEqual(client.run("load", "builtin:forest?trees=2000").returncode, 0)
        for number, end in enumerate((signal.SIGKILL, signal.SIGINT)):
            busy = client.start("render", "forest", "--size", "4096x4096", "--traversal",
                                "reference", "-o", self.folder / "a.png")
            until(lambda: client.json("jobs")["jobs"])
            busy.send_signal(end)
            busy.communicate(timeout=PATIENCE)
            until(lambda: client.json("stats")["jobs_cancelled"] == number + 1)
            until(lambda: not client.json("jobs")["jobs"])
        self.assertEqual(client.json("stats")["jobs_cancelled"], 2)
        outcomes = {line["outcome"] for line in self.lines(daemon, "job")
                    if line["kind"] == "render"}
        self.assertEqual(outcomes, {'"CANCELLED: client is gone"', "CANCELLED"})

    def test_the_log_has_a_line_for_each_job_and_says_what_matters_at_info(self):
        daemon = self.daemon("--log-level", "debug")
        client = Client(self.raynest, daemon.uri)
        scene = "builtin:forest?trees=5"
        self.assertEqual(client.run("load", scene, "--name", "woods").returncode, 0)
        self.assertEqual(client.run("query", "woods", "--ray", RAY).returncode, 0)
        number = str(client.json("render", "woods", "--size", "8x8", "--detach")["job"])
        self.assertEqual(client.run("wait", number).returncode, 0)
        self.assertNotEqual(client.run("load", "builtin:forest?trees=0").returncode, 0)
        self.assertEqual(client.run("unload", "woods").returncode, 0)

        until(lambda: len(self.lines(daemon, "job")) >= 4)
        jobs = self.lines(daemon, "job")
        query, = (job for job in jobs if job["kind"] == "query")
        self.assertEqual((query["level"], query["scene"], query["rays"], query["outcome"]),
                         (self.level_after(query), "woods", "1", "done"))
        self.assertEqual(query["principal"], "127.0.0.1")
        self.assertGreater(float(query["seconds"]), 0)
        render, = (job for job in jobs if job["kind"] == "render")
        self.assertEqual((render["level"], render["number"], render["detached"], render["rays"]),
                         ("info", number, "yes", "64"))
        loads = [job for job in jobs if job["kind"] == "load"]
        self.assertEqual((loads[0]["level"], loads[0]["outcome"]),
                         (self.level_after(loads[0]), "done"))
        self.assertEqual(loads[1]["level"], "info")
        self.assertRegex(loads[1]["outcome"], "SCENE_INVALID: .*trees")
        self.assertEqual(self.lines(daemon, "loaded")[0]["level"], "info")
        self.assertEqual(self.lines(daemon, "unloaded")[0]["scene"], "woods")

    def test_a_job_that_is_cancelled_is_logged_at_info(self):
        daemon = self.daemon()
        client = Client(self.raynest, daemon.uri)
        self.assertEqual(client.run("load", "builtin:forest?trees=2000").returncode, 0)
        job = client.json("render", "forest", "--size", "4096x4096", "--traversal", "reference",
                          "--detach")["job"]
        self.assertEqual(client.run("cancel", job).returncode, 0)
        until(lambda: "kind=render" in daemon.log())
        line, = (line for line in self.lines(daemon, "job") if line["kind"] == "render")
        self.assertEqual((line["level"], line["number"], line["outcome"]),
                         ("info", str(job), "CANCELLED"))

    def test_keys_of_built_in_scenes_are_known_ones_and_given_once(self):
        client = Client(self.raynest, self.daemon().uri)
        for keys, fault in (("tree=9", "tree=9"), ("trees=1&trees=2", "trees=2"),
                            ("trees=1&seed=2&trees=1", "trees=1"), ("trees", "trees")):
            done = client.run("load", "builtin:forest?" + keys)
            self.assertEqual(done.returncode, 5, done.stderr)
            self.assertIn(f"'{fault}'", done.stderr)
            self.assertIn("leaves (1..200", done.stderr)


if __name__ == "__main__":
    main()
