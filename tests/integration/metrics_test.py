#!/usr/bin/env python3
"""/metrics, /healthz and /readyz: what they say, and that each refusal and kill is counted.

  metrics_test.py RAYNESTD RAYNEST
"""
import re
import shutil
import socket
import subprocess

from daemon import PATIENCE, Daemon, DaemonTest, main, until
from websocket import get, greeted, place_of, raw, upgrade_request

LINE = re.compile(r"^([a-z_]+)(\{[^}]*\})? (\S+)$")


def scrape(http):
    """The values of /metrics by name with labels."""
    status, headers, body = get(http, "/metrics")
    assert status == 200 and headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8", (status, headers)
    found = {}
    for line in body.decode().splitlines():
        if not line.startswith("#"):
            name, labels, value = LINE.match(line).groups()
            found[name + (labels or "")] = float(value)
    return found


class Metrics(DaemonTest):
    arguments = ("--http", "127.0.0.1:0", "--principal-jobs-max", "6", "--total-jobs-max", "7", "--memory", "256M",
                 "--principal-scenes-max", "4")

    loads = {"forest": "builtin:forest?trees=30"}

    def setUp(self):
        self.http = self.daemon.http

    def rises(self, name, cause):
        """Checks that `cause` makes a value of /metrics rise."""
        before = scrape(self.http).get(name)
        self.assertIsNotNone(before, name)
        cause()
        until(lambda: scrape(self.http)[name] > before, lambda: f"{name} stays {before}")

    def refused(self, request, message, code):
        return lambda: self.assertEqual(self.ask(request, message), code)

    def ask(self, name, message):
        ws = greeted(self.http)
        try:
            frame = ws.ask(name, 1, message)[-1]
            return frame[2].get("name", frame[0])
        finally:
            ws.close()

    def test_names_and_values(self):
        found = scrape(self.http)
        for name in ("raynest_connections_total{result=\"accepted\"}", "raynest_frames_total{direction=\"sent\"}",
                     "raynest_rejected_total{reason=\"busy\"}", "raynest_rejected_total{reason=\"quota\"}",
                     "raynest_rejected_total{reason=\"draining\"}", "raynest_rejected_total{reason=\"deadline\"}",
                     "raynest_jobs{state=\"running\"}", "raynest_queue_limit_jobs",
                     "raynest_cancel_latency_seconds_count", "raynest_scene_load_duration_seconds_count",
                     "raynest_memory_used_bytes", "raynest_memory_budget_bytes", "raynest_scene_bytes",
                     "raynest_scenes{state=\"named\"}", "raynest_slow_consumer_disconnects_total",
                     "raynest_request_duration_seconds_bucket{le=\"+Inf\"}", "raynest_request_duration_seconds_count",
                     "process_open_fds", "process_resident_memory_bytes", "process_cpu_seconds_total"):
            self.assertIn(name, found)
        self.assertEqual(found["raynest_queue_limit_jobs"], 7)
        self.assertEqual(found["raynest_memory_budget_bytes"], 256 << 20)
        self.assertGreater(found["raynest_scene_bytes"], 0)
        build = next(name for name in found if name.startswith("raynest_build_info"))
        self.assertRegex(build, r'version="\d+\.\d+')
        # The same values as `raynest stats`.
        stats = self.client.json("stats")
        self.assertEqual(stats["scenes"], found["raynest_scenes{state=\"named\"}"])

    def test_rays_are_told_by_kind_intersector_and_backend(self):
        def rays(kind, intersector):
            labels = f'{{kind="{kind}",intersector="{intersector}",backend="cpu"}}'
            return scrape(self.http).get("raynest_rays_total" + labels, 0)
        everything = lambda: sum(value for name, value in scrape(self.http).items()
                                 if name.startswith("raynest_rays_total"))
        ray = ("--ray", "0,9,0,0,-1,0")
        picture = ("--size", "8x4", "-o", self.out / "r.png")
        for arguments, kind, intersector, count in (
                (("query", "forest", *ray), "closest", "alpha_mask", 1),
                (("query", "forest", *ray, "--kind", "any", "--intersector", "opaque"), "any", "opaque", 1),
                (("query", "forest", *ray, "--kind", "multi"), "multi", "alpha_mask", 1),
                (("explain", "forest", *ray), "explain", "alpha_mask", 1),
                (("heatmap", "forest", *picture), "picture", "alpha_mask", 32),
                (("render", "forest", *picture, "--integrator", "ao", "--intersector", "opaque"), "film", "opaque", None)):
            before, all_before = rays(kind, intersector), everything()
            self.client.json(*arguments)
            more = rays(kind, intersector) - before
            if count is None:
                self.assertGreaterEqual(more, 32)
            else:
                self.assertEqual(more, count, arguments)
            self.assertEqual(everything() - all_before, more, arguments)
        self.assertEqual(self.client.json("stats")["rays"], everything())

    def test_times_are_counted(self):
        self.rises("raynest_scene_load_duration_seconds_count",
                   lambda: self.client.json("load", "builtin:terrain?size=8", "--name", "small"))
        self.client.json("unload", "small")
        ws = greeted(self.http)
        self.addCleanup(ws.close)

        def cancel():
            ws.say("Heatmap", 1, {"job": {"scene": "forest"}, "width": 2048, "height": 2048, "encode": "raw"})
            self.assertEqual(ws.hear()[0], "Started")
            ws.say("Cancel", 1)
        self.rises("raynest_cancel_latency_seconds_count", cancel)
        found = scrape(self.http)
        # A chunk of this scene takes milliseconds, and a cancelled job waits for no other.
        self.assertLess(found["raynest_cancel_latency_seconds_sum"] / found["raynest_cancel_latency_seconds_count"], PATIENCE)

    def test_promtool_finds_nothing_wrong(self):
        promtool = shutil.which("promtool")
        if promtool is None:
            self.skipTest("promtool (Debian's package prometheus) is not installed")
        done = subprocess.run([promtool, "check", "metrics"], input=get(self.http, "/metrics")[2],
                              capture_output=True, timeout=PATIENCE, check=False)
        self.assertEqual((done.returncode, done.stdout + done.stderr), (0, b""))

    def test_requests_that_are_refused(self):
        rejected = "raynest_rejected_total{{reason=\"{}\"}}".format
        self.rises(rejected("invalid"), self.refused("Info", {"scene": "nothing"}, "SCENE_UNKNOWN"))
        self.rises(rejected("limit"), self.refused(
            "Heatmap", {"job": {"scene": "forest"}, "width": 99999, "height": 1}, "LIMIT_EXCEEDED"))
        self.rises(rejected("memory"), self.refused(
            "Render", {"job": {"scene": "forest"}, "width": 16000, "height": 4000, "encode": "raw"}, "RESOURCE_EXHAUSTED"))
        self.rises(rejected("deadline"), self.refused(
            "Heatmap", {"job": {"scene": "forest", "deadline_ms": 1}, "width": 1024, "height": 1024}, "DEADLINE"))
        self.rises("raynest_scene_rejects_total", self.broken_load)
        self.rises("raynest_requests_total{status=\"done\"}", lambda: self.client.json("query", "forest", "--ray", "0,9,0,0,-1,0"))

    def broken_load(self):
        broken = self.out / "broken.gltf"
        broken.write_text('{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":5}]}')
        self.assertNotEqual(self.client.run("load", broken).returncode, 0)

    def test_too_many_jobs(self):
        # Five are the share of one principal, of seven in all.
        ws = greeted(self.http)
        self.addCleanup(ws.close)
        # Queries whose rays do not come stay in flight.
        for request in range(1, 6):
            ws.say("Query", request, {"job": {"scene": "forest"}, "fields": ["t"], "ray_count": 10})
            self.assertEqual(ws.hear()[0], "Started")
        one_more = self.refused("Heatmap", {"job": {"scene": "forest"}, "width": 8, "height": 8}, "BUSY")
        self.rises("raynest_rejected_total{reason=\"busy\"}", one_more)
        self.rises("raynest_jobs_refused_total", one_more)
        self.assertEqual(scrape(self.http)["raynest_jobs{state=\"running\"}"], 5)
        self.rises("raynest_requests_total{status=\"cancelled\"}", lambda: ws.say("Cancel", 1))

    def test_too_many_scenes(self):
        def load_five():
            for number in range(5):
                self.client.run("load", f"builtin:flake?depth={number + 1}", "--name", f"flake-{number}")
        self.rises("raynest_rejected_total{reason=\"quota\"}", load_five)
        for number in range(5):
            self.client.run("unload", f"flake-{number}")

    def test_connections_that_end_badly(self):
        def nonsense():
            with socket.create_connection(place_of(self.daemon.uri.replace("tcp", "http")), timeout=PATIENCE) as bad:
                bad.sendall(b"nonsense" * 8)
                while bad.recv(4096):
                    pass
        self.rises("raynest_protocol_errors_total", nonsense)

        def silent():
            with socket.create_connection(place_of(self.daemon.uri.replace("tcp", "http")), timeout=PATIENCE) as idle:
                while idle.recv(4096):
                    pass
        self.rises("raynest_connections_ended_total{cause=\"timeout\"}", silent)
        self.rises("raynest_http_refused_total{reason=\"request\"}", lambda: get(self.http, "/nothing"))
        foreign = "raynest_http_foreign_total{{header=\"{}\"}}".format
        origins = scrape(self.http)[foreign("origin")]
        self.rises(foreign("host"), lambda: get(self.http, host="evil.example"))
        self.assertEqual(scrape(self.http)[foreign("origin")], origins)
        hosts = scrape(self.http)[foreign("host")]
        self.rises(foreign("origin"), lambda: raw(self.http, upgrade_request(self.http, origin="http://evil.example")))
        self.assertEqual(scrape(self.http)[foreign("host")], hosts)

    def test_health_while_all_workers_are_busy(self):
        ws = greeted(self.http)
        self.addCleanup(ws.close)
        for request in (1, 2):
            ws.say("Heatmap", request, {"job": {"scene": "forest"}, "width": 2048, "height": 2048, "encode": "raw"})
        self.assertEqual(ws.hear()[0], "Started")
        for _ in range(30):
            self.assertEqual(get(self.http, "/healthz")[::2], (200, b"ok\n"))
        self.assertEqual(scrape(self.http)["raynest_jobs{state=\"running\"}"], 2, "they were asked beside the jobs")
        self.assertEqual(get(self.http, "/readyz")[0], 200, "load changes nothing")


class Drain(DaemonTest):
    def test_draining(self):
        daemon = Daemon(self.raynestd, "--http", "127.0.0.1:0")
        ws = greeted(daemon.http)
        ws.ask("Load", 1, {"source": "builtin:forest?trees=400", "name": "forest"})
        ws.say("Heatmap", 2, {"job": {"scene": "forest"}, "width": 4096, "height": 4096, "encode": "raw"})
        self.assertEqual(ws.hear()[0], "Started")
        daemon.process.terminate()
        until(lambda: get(daemon.http, "/readyz")[0] == 503)
        self.assertEqual(get(daemon.http, "/healthz")[0], 200)
        before = scrape(daemon.http)["raynest_rejected_total{reason=\"draining\"}"]
        ws.say("Heatmap", 3, {"job": {"scene": "forest"}, "width": 8, "height": 8})
        until(lambda: scrape(daemon.http)["raynest_rejected_total{reason=\"draining\"}"] > before)
        ws.close()
        self.assertEqual(daemon.process.wait(timeout=PATIENCE), 0)
        daemon.folder.cleanup()


if __name__ == "__main__":
    main()
