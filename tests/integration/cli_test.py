#!/usr/bin/env python3
"""Runs every subcommand of raynest against a real daemon: answers, files and exit codes.

  cli_test.py RAYNESTD RAYNEST
"""
import json
import re
import shutil
import signal
import struct
import zipfile

from daemon import Client, Daemon, DaemonTest, PATIENCE, closed_port, main, until
from npy import npy, read_npy

DOWN = "0.3,1000,0.4,0,-1,0"
UP = "0.3,1000,0.4,0,1,0"


class Cli(DaemonTest):
    loads = {"hills": "builtin:terrain?size=32", "woods": "builtin:forest?trees=20"}

    def expect(self, code, *arguments, says=""):
        done = self.client.run(*arguments)
        self.assertEqual(done.returncode, code, f"{arguments}: {done.stderr}")
        if code != 0:
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
            self.assertIn(says, done.stderr)
        return done

    def query(self, *arguments):
        done = self.expect(0, "--json", "query", *arguments)
        return [json.loads(line) for line in done.stdout.splitlines()]

    def test_load_and_info_say_the_same(self):
        loaded = self.client.json("load", "builtin:terrain?size=32", "--name", "hills")
        seconds = loaded.pop("seconds")
        self.assertGreaterEqual(seconds, 0)
        info = self.client.json("info", "hills")
        for key in ("name", "hash", "epoch", "unique_triangles", "instanced_triangles", "instances",
                    "levels", "materials", "mask_materials", "bytes", "cameras", "skipped"):
            self.assertIn(key, info)
            self.assertEqual(info[key], loaded[key])
        self.assertGreater(info["unique_triangles"], 1000)
        self.assertEqual(info["build"], "medium")
        self.assertGreater(info["build_seconds"], 0)
        self.assertGreater(info["sah_cost"], 1)
        self.assertGreater(info["nodes"], info["tree_height"])
        self.assertLess(info["bytes_per_triangle"], 75)

    def test_build_says_how_trees_are_built_and_changes_no_answer(self):
        rays = [("--ray", f"{x},50,{z},0.1,-1,0.2") for x in (-3, 1, 4) for z in (-2, 2)]
        answers, hashes = [], set()
        for build in ("fast", "medium", "high"):
            loaded = self.client.json("load", "builtin:terrain?size=64", "--name", build,
                                      "--build", build)
            self.assertEqual(loaded["build"], build)
            hashes.add(loaded["hash"])
            answers.append(self.client.run("--json", "query", build,
                                           *[word for ray in rays for word in ray]).stdout)
        self.assertEqual(len(hashes), 3)
        self.assertIn('"t"', answers[0])
        self.assertEqual(answers[1], answers[0])
        self.assertEqual(answers[2], answers[0])

    def test_scenes_are_listed_by_name(self):
        done = self.expect(0, "scenes")
        self.assertIn("hills", done.stdout)
        self.assertIn("woods", done.stdout)

    def test_what_would_be_lost_or_ignored_is_refused_first(self):
        self.expect(0, "load", "builtin:terrain?size=16", "--name", "early")
        self.expect(1, "render", "early", "-o", "/nonexistent/a.png", says="/nonexistent/a.png")
        self.expect(2, "load", "builtin:terrain", "--primitive", "sphere", says=".npy")
        self.expect(0, "query", "early", "--ray", DOWN, "--intersector", "procedural_mask",
                    "--set", "scale=0.001")
        beyond = Client(self.raynest, "tcp://127.0.0.1:65537").run("scenes")
        self.assertEqual(beyond.returncode, 2)
        self.assertIn("from 1 to 65535", beyond.stderr)

    def test_no_command_writes_files_that_nobody_named(self):
        self.expect(0, "load", "builtin:street?cars=1&seconds=1", "--name", "street")
        lit = self.out / "lit.exr"
        self.expect(0, "render", "hills", "--size", "8x8", "--integrator", "ao", "--spp", "1", "-o", lit)
        job = self.client.json("query", "hills", "--ray", DOWN, "--detach")["job"]
        without = {"export": ["street"], "render": ["street", "--size", "8x8"], "resume": [lit, "--spp", "2"],
                   "animate": ["street", "--size", "8x8", "--to", "0"], "query": ["street", "--ray", DOWN],
                   "heatmap": ["street", "--size", "8x8"], "fetch": [job]}
        commands = re.findall(r"^  ([a-z-]+)  ", self.client.run("--help").stdout.partition("Subcommands:")[2], re.M)
        self.assertEqual({name for name in commands if "-o,--output" in self.client.run(name, "--help").stdout}, set(without))
        for command, words in without.items():
            with self.subTest(command=command):
                here = self.out / f"{command} alone"
                here.mkdir()
                started = self.client.start(command, *words, cwd=here)
                said, error = started.communicate(timeout=PATIENCE)
                self.assertEqual(list(here.iterdir()), [])
                if started.returncode != 0:
                    self.assertIn("is required", error)
                else:
                    self.assertTrue(said)

    def test_a_taken_name_needs_replace_and_is_a_new_epoch(self):
        first = self.client.json("load", "builtin:terrain?size=8", "--name", "taken")
        for remedy in ("--replace", "--name"):
            self.expect(1, "load", "builtin:terrain?size=9", "--name", "taken", says=remedy)
        second = self.client.json("load", "builtin:terrain?size=9", "--name", "taken", "--replace")
        self.assertEqual(second["epoch"], first["epoch"] + 1)
        self.expect(5, "query", "taken", "--ray", DOWN, "--epoch", "1", says="epoch 2")
        self.expect(0, "unload", "taken")
        self.expect(5, "info", "taken", says="raynest load")

    def test_a_builtin_scene_is_called_by_its_kind(self):
        self.assertEqual(self.client.json("load", "builtin:flake?depth=2")["name"], "flake")
        self.expect(1, "load", "builtin:flake?depth=3", says="'flake'")
        self.expect(0, "unload", "flake")

    def test_variants_name_parameters_and_queries(self):
        done = self.expect(0, "variants")
        for word in ("opaque", "alpha_mask", "procedural_mask", "cutoff", "closest"):
            self.assertIn(word, done.stdout)

    def test_a_hit_a_miss_and_an_any(self):
        hit, miss = self.query("hills", "--ray", DOWN, "--ray", UP)
        self.assertEqual(hit["ray"], 0)
        self.assertEqual(sorted(hit["hits"][0]), ["geom", "path", "prim", "t", "u", "v"])
        self.assertTrue(900 < hit["hits"][0]["t"] < 1100)
        self.assertEqual(miss, {"ray": 1, "hits": []})
        self.assertEqual(self.query("hills", "--kind", "any", "--ray", DOWN, "--ray", UP),
                         [{"ray": 0, "hit": True}, {"ray": 1, "hit": False}])

    def test_hits_of_multi_are_sorted_and_start_with_the_closest(self):
        closest = self.query("woods", "--ray", DOWN)[0]["hits"][0]
        multi = self.query("woods", "--kind", "multi", "--max-hits", "16", "--ray", DOWN)[0]["hits"]
        self.assertEqual(multi[0], closest)
        distances = [hit["t"] for hit in multi]
        self.assertEqual(distances, sorted(distances))

    def test_columns_come_as_npz(self):
        rays = [[0.1 * i, 1000, 0.1, 0, -1, 0] for i in range(50)]
        body = struct.pack("<300f", *(value for ray in rays for value in ray))
        (self.out / "rays.npy").write_bytes(npy((50, 6), body))
        self.expect(0, "query", "hills", "--rays", self.out / "rays.npy", "--fields",
                    "t,ng,path,front,total", "-o", self.out / "hits.npz")
        with zipfile.ZipFile(self.out / "hits.npz") as file:
            self.assertIsNone(file.testzip())
            columns = {name[:-4]: read_npy(file.read(name)) for name in file.namelist()}
        self.assertEqual({name: column[:2] for name, column in columns.items()},
                         {"t": ("<f4", (50,)), "ng": ("<f4", (50, 3)), "path": ("<u8", (50,)),
                          "front": ("|b1", (50,)), "total": ("<u4", (50,))})
        self.assertTrue(all(count > 0 for count in columns["total"][2]))

    def test_columns_of_multi_are_per_hit_or_per_ray(self):
        self.expect(0, "query", "hills", "--kind", "multi", "--fields", "t,path,hit,flags,total",
                    "--ray", UP, "--ray", DOWN, "--ray", "0,0,0,0,0,0", "-o", self.out / "m.npz")
        with zipfile.ZipFile(self.out / "m.npz") as file:
            columns = {name[:-4]: read_npy(file.read(name))[2] for name in file.namelist()}
        self.assertEqual(columns["ray_splits"], (0, 0, 1, 1))
        self.assertEqual((columns["hit"], columns["flags"]), ((0, 1, 0), (0, 0, 1)))
        self.assertEqual((len(columns["t"]), len(columns["path"]), len(columns["total"])), (1, 1, 3))

    def test_a_path_has_a_name(self):
        hit = self.query("woods", "--ray", DOWN)[0]["hits"][0]
        done = self.expect(0, "path", "woods", hit["path"])
        self.assertTrue(done.stdout.strip())
        self.expect(2, "path", "woods", 2**60, says="path")

    def test_pictures_are_what_their_names_say(self):
        magic = {"a.png": b"\x89PNG", "a.exr": b"\x76\x2f\x31\x01"}
        for name, start in magic.items():
            for command in ("render", "heatmap"):
                done = self.client.json(command, "woods", "--size", "64x36", "-o", self.out / name)
                self.assertEqual(done["file"], str(self.out / name))
                self.assertEqual((self.out / name).read_bytes()[:4], start)

    def test_without_the_image_module_raw_pictures_still_work(self):
        (self.out / "bin").mkdir()
        daemon = Daemon(shutil.copy(self.raynestd, self.out / "bin"))
        self.addCleanup(daemon.stop)
        client = Client(self.raynest, daemon.uri)
        client.json("load", "builtin:terrain?size=8")
        done = client.run("render", "terrain", "--size", "8x8", "-o", self.out / "none.png")
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn("install libopenimageio", done.stderr)
        for command, of_pixels in (("heatmap", ("<u4", (4, 8))), ("render", ("|u1", (4, 8, 4)))):
            client.json(command, "terrain", "--size", "8x4", "-o", self.out / "some.npy")
            dtype, shape, _ = read_npy((self.out / "some.npy").read_bytes())
            self.assertEqual((dtype, shape), of_pixels)

    def test_the_raw_heat_map_agrees_with_its_statistics(self):
        heat = self.client.json("heatmap", "woods", "--size", "64x36", "-o", self.out / "h.npy")
        _, shape, counts = read_npy((self.out / "h.npy").read_bytes())
        self.assertEqual(shape, (36, 64))
        ordered = sorted(counts)
        self.assertEqual((heat["metric"], heat["min"], heat["max"], heat["rays"]),
                         ("total", ordered[0], ordered[-1], len(counts)))
        self.assertAlmostEqual(heat["mean"], sum(counts) / len(counts), places=3)
        self.assertEqual(heat["p99"], ordered[-(-len(counts) * 99 // 100) - 1])

    def test_necessary_work_is_never_more_than_traversed_work(self):
        counts = {}
        for count in ("traversed", "necessary"):
            name = self.out / f"{count}.npy"
            self.expect(0, "heatmap", "woods", "--size", "64x36", "--count", count, "-o", name)
            counts[count] = read_npy(name.read_bytes())[2]
        self.assertTrue(all(n <= t for n, t in zip(counts["necessary"], counts["traversed"])))
        self.assertLess(sum(counts["necessary"]), sum(counts["traversed"]))

    def test_the_same_request_gives_the_same_bytes(self):
        pictures = []
        for _ in range(2):
            self.expect(0, "render", "woods", "--size", "96x54", "-o", self.out / "same.png")
            pictures.append((self.out / "same.png").read_bytes())
        self.assertEqual(*pictures)

    def test_exit_codes_of_what_is_asked_wrongly(self):
        self.expect(5, "render", "nowhere", "-o", self.out / "x.png", says="raynest load")
        self.expect(5, "query", "hills", "--ray", DOWN, "--intersector", "unheard_of",
                    says="unheard_of")
        self.expect(2, "query", "hills", "--ray", DOWN, "--set", "unheard=1", says="unheard")
        self.expect(2, "query", "hills", "--ray", DOWN, "--fields", "t,unheard", says="unheard")
        self.expect(2, "query", "hills", "--ray", DOWN, "--kind", "any", "--fields", "t",
                    says="any")
        self.expect(2, "heatmap", "hills", "-o", self.out / "x.png", "--metric", "unheard",
                    says="unheard")
        self.expect(2, "render", "hills", "-o", self.out / "x.png", "--camera", "unheard",
                    says="unheard")
        self.expect(5, "render", "hills", "-o", self.out / "x.png", "--worker", "cuda",
                    says="use auto or cpu as --worker")
        self.expect(5, "load", "builtin:unheard_of", says="unheard_of")
        self.expect(5, "load", "root:x.glb", says="--scene-root")
        self.assertEqual(self.client.run("query", "hills").returncode, 2)
        self.assertFalse((self.out / "x.png").exists())

    def test_errors_are_json_when_asked_for(self):
        done = self.client.run("--json", "info", "nowhere")
        self.assertEqual(done.returncode, 5)
        error = json.loads(done.stderr)["error"]
        self.assertEqual((error["name"], sorted(error)), ("SCENE_UNKNOWN", ["code", "message",
                                                                            "name", "request"]))

    def test_nobody_at_the_address_is_exit_code_3(self):
        with closed_port() as uri:
            done = Client(self.raynest, uri).run("scenes")
        self.assertEqual(done.returncode, 3)

    def test_rows_that_nobody_reads_on_end_the_work(self):
        before = self.counter("rays")
        with self.client.start("query", "hills", "--generate", "equirectangular",
                               "size=8000x8000") as rows:
            rows.stdout.readline()
            rows.stdout.close()
            self.assertEqual(rows.stderr.read(), "")
            self.assertEqual(rows.wait(PATIENCE), -signal.SIGPIPE)
        until(lambda: self.counter("jobs_started") == self.counter("jobs_ended"))
        self.assertLess(self.counter("rays") - before, 8_000_000)

    def test_old_words_of_traversals_are_refused_with_the_new_ones(self):
        for old, new in (("latency", "single"), ("batch", "stream"), ("coherent", "packet")):
            self.expect(2, "query", "hills", "--ray", "0,100,0,0,-1,0", "--traversal", old,
                        says=f"'{old}' is called {new}")

    def test_the_option_precision_is_refused_and_says_why(self):
        for command in (("query", "hills", "--ray", "0,100,0,0,-1,0"), ("heatmap", "hills", "-o", "x.png")):
            self.expect(2, *command, "--precision", "fast", says="the watertight test is always used")
            self.assertNotIn("precision", self.expect(0, command[0], "--help").stdout)

    def test_a_picture_goes_to_a_device_and_its_size_is_checked_first(self):
        for command in ("render", "heatmap"):
            self.expect(0, command, "hills", "--size", "32x18", "-o", "/dev/null")
            for size in ("99999x99999", "16385x1", "16384x16384", "0x1"):
                self.expect(2, command, "hills", "-o", "x.png", "--size", size, says="--size: '")
        self.expect(2, "render", "hills", "-o", "x.png", "--set", "cutoff=1", "seed=2",
                    says="repeat --set before each NAME=VALUE")
        self.expect(2, "render", "hills", "-o", "x.png", "--lookat", "nan,0,0,1,0,0",
                    says="--lookat: 'nan,0,0,1,0,0' has a number that is not finite")
        self.assertIn("--set NAME=VALUE", self.expect(0, "render", "--help").stdout)

    def test_help_shows_the_range_of_a_number_with_its_type(self):
        # Behind the text it would read as the range of --spp.
        said = " ".join(self.expect(0, "render", "--help").stdout.split())
        self.assertRegex(said, r"--noise NUMBER in \[0\.000001, 1\] .*; --spp is then the most --progressive")
        for entry in ("--seed NUMBER seed", "--deadline SECONDS in [0.001, 4000000] give up",
                      "--readout SECONDS in [0, 1e9] how long"):
            self.assertIn(entry, said)

    def test_help_names_what_an_option_goes_with_behind_its_text(self):
        said = " ".join(self.expect(0, "explain", "--help").stdout.split())
        for entry in ("--seed NUMBER seed of the random numbers (0); with --integrator --depth",
                      "--all all steps of a long traversal, not the first 256; not with --integrator --integrator",
                      "--camera TEXT number or name", "see: raynest info); not with --lookat, --ray --lookat"):
            self.assertIn(entry, said)
        for command in ("explain", "render", "query", "heatmap", "info", "unload"):
            self.assertNotRegex(self.expect(0, command, "--help").stdout, "Needs:|Excludes:")

    def test_a_heat_map_says_what_it_counts_and_what_lies_below_its_range(self):
        told = self.client.json("heatmap", "hills", "--size", "64x36", "-o", self.out / "h.png",
                                "--range", "1000:2000", "--count", "necessary")
        self.assertEqual(told["count"], "necessary")
        self.assertGreater(told["below"], 0)
        said = self.expect(0, "heatmap", "hills", "--size", "64x36", "-o", self.out / "h.png",
                           "--range", "1000:2000", "--count", "necessary").stdout
        self.assertIn("necessary total per ray", said)
        self.assertIn("% below the range", said)

    def test_a_deadline_is_exit_code_7(self):
        # In the woods a single chunk is half a billion triangle tests: minutes under a sanitizer.
        self.expect(7, "render", "hills", "--size", "4096x4096", "--traversal", "reference", "-o",
                    self.out / "x.png", "--deadline", "0.2", says="the request's deadline passed; ")

    def test_an_interrupt_cancels_the_job_and_is_exit_code_130(self):
        before = self.counter("jobs_cancelled")
        started = self.counter("jobs_started")
        render = self.client.start("render", "hills", "--size", "4096x4096", "--traversal",
                                   "reference", "-o", self.out / "x.png")
        until(lambda: self.counter("jobs_started") > started)
        render.send_signal(signal.SIGINT)
        render.communicate(timeout=PATIENCE)
        self.assertEqual(render.returncode, 130)
        until(lambda: self.counter("jobs_started") == self.counter("jobs_ended"))
        self.assertGreater(self.counter("jobs_cancelled"), before)

    def counter(self, name):
        return self.client.json("stats")[name]


if __name__ == "__main__":
    main()
