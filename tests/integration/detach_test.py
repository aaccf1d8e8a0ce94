#!/usr/bin/env python3
"""Detached jobs on the command line: started, listed, waited for, fetched, cancelled, owned.

  detach_test.py RAYNESTD RAYNEST
"""
import signal
import struct

from daemon import Client, Daemon, DaemonTest, PATIENCE, main, second_principal, until
from npy import npy

DOWN = "0.3,1000,0.4,0,-1,0"
UP = "0.3,1000,0.4,0,1,0"
# The reference traversal tests all triangles for every ray: minutes of work.
ENDLESS = ("--traversal", "reference", "--size", "4096x4096")


class Detach(DaemonTest):
    @classmethod
    def setUpClass(cls):
        cls.arguments, token = second_principal(cls.raynestd, cls.addClassCleanup)
        super().setUpClass()
        cls.other = Client(cls.raynest, cls.daemon.uri, token)
        cls.client.json("load", "builtin:forest?trees=20", "--name", "woods")
        cls.client.json("load", "builtin:terrain?size=64", "--name", "hills")

    def expect(self, code, *arguments, says="", client=None):
        done = (client or self.client).run(*arguments)
        self.assertEqual(done.returncode, code, f"{arguments}: {done.stderr}")
        if code != 0:
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertIn(says, done.stdout if code == 0 else done.stderr)
        return done

    def detach(self, *arguments):
        return str(self.client.json(*arguments, "--detach")["job"])

    def listed(self):
        return {str(job["job"]): job for job in self.client.json("jobs")["jobs"]}

    def test_fetch_writes_what_the_command_would_have_written(self):
        cases = [("render", "png", ()), ("render", "exr", ()), ("render", "npy", ()),
                 ("heatmap", "png", ()), ("heatmap", "npy", ("--metric", "nodes")),
                 ("heatmap", "exr", ())]
        for command, ending, options in cases:
            with self.subTest(command=command, ending=ending):
                attached = self.out / f"attached.{ending}"
                fetched = self.out / f"fetched.{ending}"
                words = (command, "woods", "--size", "320x180", *options)
                told = self.client.json(*words, "-o", attached)
                job = self.detach(*words, "-o", f"x.{ending}")
                self.expect(0, "wait", job, says=f"job {job} ({command}, woods) is done")
                answer = self.client.json("fetch", job, "-o", fetched)
                self.assertEqual(fetched.read_bytes(), attached.read_bytes())
                for key in set(told) - {"seconds", "queued_seconds", "file"}:
                    self.assertEqual(answer[key], told[key], key)

    def test_fetch_prints_what_the_query_would_have_printed(self):
        for options in ((), ("--kind", "any"), ("--kind", "multi", "--max-hits", "3"),
                        ("--fields", "t,path")):
            with self.subTest(options=options):
                words = ("query", "woods", "--ray", DOWN, "--ray", UP, *options)
                attached = self.expect(0, "--json", *words).stdout
                job = self.detach(*words)
                self.client.json("wait", job)
                self.assertEqual(self.expect(0, "--json", "fetch", job).stdout, attached)
                # A result can be fetched repeatedly.
                self.assertEqual(self.expect(0, "--json", "fetch", job).stdout, attached)

    def test_a_detached_query_of_many_rays_becomes_the_same_file(self):
        rays = self.out / "rays.npy"
        body = b"".join(struct.pack("<6f", i % 200 * 0.1 - 10, 50, i // 200 * 0.1 - 10, 0, -1, 0)
                        for i in range(40000))
        rays.write_bytes(npy((40000, 6), body))
        words = ("query", "woods", "--rays", rays)
        self.expect(0, *words, "-o", self.out / "attached.npz")
        job = self.detach(*words, "-o", "x.npz")
        self.client.json("wait", job)
        self.expect(0, "fetch", job, "-o", self.out / "fetched.npz", says="40,000 rays")
        self.assertEqual((self.out / "fetched.npz").read_bytes(),
                         (self.out / "attached.npz").read_bytes())

    def test_jobs_lists_what_runs_and_what_is_kept(self):
        kept = self.detach("render", "woods", "--size", "64x64")
        self.client.json("wait", kept)
        runs = self.detach("heatmap", "hills", *ENDLESS)
        attached = self.client.start("render", "hills", *ENDLESS, "-o", self.out / "never.png")

        def running():
            jobs = self.listed()
            mine = [job for job in jobs.values() if job["kind"] == "render" and
                    not job["detached"]]
            return mine and jobs[runs]["done"] > 0 and (jobs, mine)
        jobs, mine = until(running)
        self.assertEqual(jobs[kept]["state"], "done")
        self.assertTrue(3000 < jobs[kept]["left_seconds"] <= 3600)
        self.assertGreater(jobs[kept]["bytes"], 100)
        self.assertEqual(jobs[runs]["state"], "running")
        self.assertEqual(jobs[runs]["owner"], "127.0.0.1")
        self.assertEqual(jobs[runs]["scene"], "hills")
        self.assertEqual(jobs[runs]["total"], 4096 * 4096)
        self.assertIsNone(jobs[runs]["left_seconds"])
        self.assertEqual(jobs[runs]["worker"], "cpu")
        table = self.expect(0, "jobs").stdout
        self.assertIn("PROGRESS", table.splitlines()[0])
        # A running job cannot be fetched; another client's attached job can be ended too.
        self.expect(6, "fetch", runs, "-o", self.out / "early.png", says="raynest wait")
        self.expect(0, "cancel", runs, says=f"cancelled job {runs} (heatmap, hills)")
        self.expect(5, "wait", runs, says="raynest jobs")
        self.expect(0, "cancel", str(mine[0]["job"]))
        attached.communicate(timeout=PATIENCE)
        self.assertEqual(attached.returncode, 130)
        cancelled = self.client.json("cancel", kept)
        self.assertEqual((cancelled["state"], cancelled["bytes"], cancelled["left_seconds"]),
                         ("cancelled", 0, None))
        self.assertNotIn(kept, self.listed())

    def test_jobs_belong_to_who_asked(self):
        job = self.detach("render", "woods", "--size", "64x64")
        self.client.json("wait", job)
        for command in (("wait",), ("cancel",), ("fetch", "-o", self.out / "stolen.png")):
            self.expect(5, command[0], job, *command[1:], client=self.other,
                        says=f"there is no job {job}")
        self.assertEqual(self.other.json("jobs")["jobs"], [])
        self.assertIn(job, self.listed())
        self.expect(5, "wait", "999999", says="raynest jobs")

    def test_only_so_many_jobs_are_kept(self):
        daemon = Daemon(self.raynestd, "--principal-results-max", "3")
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=16", "--name", "hills")
        words = ("query", "hills", "--ray", DOWN, "--detach")
        kept = [str(client.json(*words)["job"]) for _ in range(3)]
        for job in kept:
            client.json("wait", job)
        self.expect(6, *words, says="--principal-results-max", client=client)
        # Fetching a result makes room.
        self.expect(0, "fetch", kept[1], client=client)
        self.expect(0, *words, client=client)
        self.expect(5, "fetch", kept[1], client=client)
        self.expect(0, "fetch", kept[0], client=client)

    def test_a_deadline_holds_for_detached_jobs_and_is_told_by_wait_and_fetch(self):
        job = self.detach("render", "hills", *ENDLESS, "--deadline", "0.2")
        self.expect(7, "--quiet", "wait", job, says="deadline")
        self.expect(7, "fetch", job, "-o", self.out / "late.png", says="deadline")
        self.assertEqual(self.listed()[job]["state"], "failed")
        waiting = self.detach("render", "hills", *ENDLESS)
        self.expect(7, "--quiet", "wait", waiting, "--deadline", "0.1",
                    says=f"job {waiting} still runs: raynest wait {waiting}")
        self.expect(0, "cancel", waiting)

    def test_ctrl_c_ends_a_wait_and_not_the_job(self):
        job = self.detach("render", "hills", *ENDLESS)
        waiting = self.client.start("wait", job)
        until(lambda: any(other["kind"] == "wait" for other in self.listed().values()))
        waiting.send_signal(signal.SIGINT)
        _, errors = waiting.communicate(timeout=PATIENCE)
        self.assertEqual(waiting.returncode, 130)
        self.assertIn(f"job {job} goes on", errors)
        self.assertEqual(self.listed()[job]["state"], "running")
        self.expect(0, "cancel", job)

    def test_what_does_not_fit_together_is_refused(self):
        self.expect(2, "render", "woods", says="--output")
        self.expect(2, "wait", "none", says="whole number")
        job = self.detach("render", "woods", "--size", "64x64", "-o", "x.exr")
        self.client.json("wait", job)
        self.expect(2, "fetch", job, says="-o FILE")
        self.expect(2, "fetch", job, "-o", self.out / "wrong.png", says=".exr")
        query = self.detach("query", "woods", "--ray", DOWN, "--fields", "t", "-o", "x.npz")
        self.client.json("wait", query)
        for ending in ("png", "npy", "exr"):
            wrong = self.out / f"query.{ending}"
            self.expect(2, "fetch", query, "-o", wrong, says=f"FILE.npz, not '{wrong}'")
            self.assertFalse(wrong.exists())
        # A table tells misses by columns that nobody sees.
        self.assertEqual(self.expect(0, "fetch", query).stdout.split()[:2], ["ray", "t"])
        self.expect(0, "fetch", query, "-o", self.out / "right.npz")

    def test_more_than_one_principal_may_keep_is_refused_before_it_runs(self):
        self.expect(6, "query", "woods", "--generate", "equirectangular", "size=8192x8192",
                    "--detach", says="--principal-result-bytes-max")
        self.assertFalse([job for job in self.listed().values()
                          if job["total"] == 8192 * 8192])

    def test_one_job_gets_its_share_beside_many_of_another_principal(self):
        options, token = second_principal(self.raynestd, self.addCleanup)
        daemon = Daemon(self.raynestd, "--threads", "2", *options)
        self.addCleanup(daemon.folder.cleanup)  # nobody waits for its jobs
        self.addCleanup(daemon.process.kill)
        crowd, single = Client(self.raynest, daemon.uri), Client(self.raynest, daemon.uri, token)
        crowd.json("load", "builtin:terrain?size=8", "--name", "hills", "--share", "public")
        words = ("render", "hills", "--traversal", "reference", "--detach", "--size")
        single.json(*words, "4096x4096")
        for _ in range(50):  # all of them fit into one answer to `jobs`
            crowd.json(*words, "512x512")

        # A principal sees its own jobs alone, so one is asked after the other; the crowd is first at the
        # end and last at the beginning, so that it is charged with no ray of the time between.
        def traced(client):
            return sum(job["done"] for job in client.json("jobs")["jobs"])
        before = traced(single), traced(crowd)

        def sixteen_chunks_later():
            others = traced(crowd) - before[1]
            own = traced(single) - before[0]
            return own >= 16 * 16384 and (own, others)
        own, others = until(sixteen_chunks_later)
        # Chunks of all jobs are equal: the single job and the crowd get one each, in turn. Without
        # turns the crowd would trace fifty times as much meanwhile.
        self.assertTrue(0 < others < 3 * own, (own, others))


if __name__ == "__main__":
    main()
