#!/usr/bin/env python3
"""raynest-bench at small scale: what it prints, what it compares, what it refuses. No time is asserted.

  bench_test.py RAYNEST_BENCH TARGETS(;-separated) with-peer|without-peer
"""
import io
import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile
import unittest
from contextlib import redirect_stdout

import table

BENCH, TARGETS, PEER = "", [], False
SCENES = ["terrain", "cards", "forest1", "forest3", "forest3-flat", "interior"]
KEYS = {"scene", "rays", "kind", "traversal", "intersector", "target", "threads", "mrays",
        "peer", "peer_mrays", "ratio", "mismatches"}
UNIT = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
# Two triangles, at z = 0 and z = -1, and three rays: down on both, down on the second, past both.
SOUP = struct.pack("<I18f", 2, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, -1, 2, 0, -1, 0, 2, -1)
RAYS = struct.pack("<I24f", 3, .2, .2, 1, 0, 0, 0, -1, 1e30, .7, .7, 1, 0, 0, 0, -1, 1e30,
                   5, 5, 1, 0, 0, 0, -1, 1e30)


def reference(*records):
    return struct.pack("<I", len(records)) + b"".join(struct.pack("<fII", *r) for r in records)


GOOD_REF = reference((1, 0, 0xFFFFFFFF), (2, 1, 0xFFFFFFFF), (math.inf, 0xFFFFFFFF, 0xFFFFFFFF))


def instances(groups, root=0, magic=0x53494E52, transform=None):
    """One mesh (SOUP); `groups` lists (kind, child) of each group's instances."""
    data = struct.pack("<4I", magic, 1, len(groups), root) + SOUP
    for group in groups:
        data += struct.pack("<I", len(group))
        for kind, child in group:
            data += struct.pack("<2I12f", kind, child, *(transform or UNIT))
    return data


def bench(*arguments):
    return subprocess.run([BENCH, *arguments], capture_output=True, text=True, timeout=300, check=False)


def runnable_targets():
    """Those of the build that this CPU runs."""
    runs = {target: bench("--scene", "gen:cards?scale=0.001", "--count", "1024", "--rounds", "1",
                          "--rays", "primary", "--traversal", "single", "--target", target)
            for target in TARGETS}
    return [target for target, run in runs.items() if run.returncode == 0]


class Measuring(unittest.TestCase):
    def rows(self, *arguments):
        run = bench("--json", "--rounds", "1", "--count", "4096", *arguments)
        self.assertEqual(run.returncode, 0, run.stderr)
        return [json.loads(line) for line in run.stdout.splitlines()]

    def check_row(self, row):
        self.assertLessEqual(KEYS, row.keys())
        self.assertGreater(row["mrays"], 0)
        self.assertLessEqual(row["mismatches"], row.get("mismatches_max", 0))
        self.assertTrue(row["command"].startswith("raynest-bench --json"))

    def test_counting_has_rows_over_the_first_variant_with_its_answers(self):
        rows = self.rows("--scene", "gen:forest3?scale=0.01", "--rays", "primary",
                         "--traversal", "single", "--counters", "none,total,level", "--peers", "own")
        counted = [row for row in rows if row["peer"] == "own"]
        self.assertEqual([row["counters"] for row in counted], ["total", "level"])
        for row in counted:
            self.check_row(row)
            self.assertGreater(row["ratio"], 0)

    def test_every_scene_gives_rows_for_every_kind_of_ray_and_answers_as_the_peer(self):
        peers = ["--peers", "embree,embree-packet,embree-coherent,embree-robust"] if PEER else []
        for scene in SCENES:
            with self.subTest(scene):
                rows = self.rows("--scene", f"gen:{scene}?scale=0.01", "--rays",
                                 "primary,ao,shadow,diffuse,random", *peers)
                self.assertEqual({row["rays"] for row in rows},
                                 {"primary", "ao", "shadow", "diffuse", "random"})
                self.assertLessEqual({"single"}, {row["traversal"] for row in rows})
                for row in rows:
                    self.check_row(row)
                    self.assertEqual(row["kind"], "any" if row["rays"] in ("ao", "shadow") else "closest")
                    self.assertEqual(row["ratio"] > 0, PEER)

    def test_packets_of_the_peer_are_as_wide_as_the_instructions_of_its_target(self):
        if not PEER:
            self.skipTest("skipped: this build has no peer")
        for target in runnable_targets():
            rows = self.rows("--scene", "gen:cards?scale=0.01", "--rays", "primary,ao", "--traversal", "single", "--target", target,
                             "--peers", "embree,embree-packet,embree-coherent")
            wide = {"v2": 4, "v3": 8, "v4": 16}[target]
            self.assertEqual({(row["peer"], row["peer_width"]) for row in rows},
                             {("embree", 1), ("embree-packet", wide), ("embree-coherent", wide)})

    def test_alpha_is_tested_as_the_filters_of_the_peer_and_the_controls_do(self):
        peers = "own,embree-filter,embree-filter-coherent,embree-argument" if PEER else "own"
        rows = self.rows("--scene", "gen:cards?scale=0.01", "--rays", "primary,diffuse,ao", "--intersector",
                         "alpha_mask,fused_alpha,pointer_alpha", "--traversal", "single", "--peers", peers)
        for row in rows:
            self.check_row(row)
            self.assertLess(row.get("mask_borders", 0), row["count"] / 1000)
        self.assertEqual({row["intersector"] for row in rows},
                         {"alpha_mask", "fused_alpha", "pointer_alpha"})
        solid = self.rows("--scene", "gen:cards?scale=0.01", "--rays", "primary", "--traversal", "single",
                          "--intersector", "no_test,opaque,pointer_null,pointer_noop", "--peers", "own")
        self.assertEqual(len(solid), 4)

    def test_multi_hit_lists_are_the_peers(self):
        peers = ["--peers", "embree-list,embree-shrink"] if PEER else []
        rows = self.rows("--scene", "gen:cards?scale=0.01", "--rays", "primary", "--kind", "multi",
                         "--max-hits", "8", "--traversal", "single", *peers)
        self.assertEqual(len(rows), 2 if PEER else 1)
        for row in rows:
            self.check_row(row)
            self.assertEqual(row["kind"], "multi")

    def test_targets_with_fma_and_numbers_of_threads_give_the_same_bits(self):
        targets = [target for target in runnable_targets() if target != "v2"]
        rows = self.rows("--scene", "gen:forest3?scale=0.01", "--rays", "diffuse", "--traversal", "single",
                         "--target", ",".join(targets), "--threads", "1,2", "--peers", "own")
        self.assertEqual({(row["target"], row["threads"]) for row in rows},
                         {(target, threads) for target in targets for threads in (1, 2)})

    def test_nested_and_one_level_forms_answer_alike(self):
        rows = self.rows("--scene", "gen:forest3?scale=0.01", "--over", "gen:forest3-flat?scale=0.01",
                         "--rays", "primary,ao", "--traversal", "auto,single")
        self.assertEqual([(row["rays"], row["traversal"], row["peer"]) for row in rows],
                         [(rays, traversal, "own-over") for rays in ("primary", "ao")
                          for traversal in ("auto", "single")])
        for row in rows:
            self.check_row(row)

    def test_another_scene_is_told_apart(self):
        run = bench("--rounds", "1", "--count", "4096", "--scene", "gen:cards?scale=0.01", "--over",
                    "gen:terrain?scale=0.01", "--rays", "primary", "--traversal", "single")
        self.assertEqual(run.returncode, 9, run.stderr)

    def test_scenes_are_deterministic(self):
        def hash_of(source):
            return self.rows("--scene", source, "--rays", "primary", "--traversal", "single")[0]["scene_hash"]
        self.assertEqual(hash_of("gen:forest3?scale=0.01"), hash_of("gen:forest3?scale=0.01"))
        self.assertNotEqual(hash_of("gen:forest3?scale=0.01"), hash_of("gen:forest3?scale=0.02"))

    def test_builds_are_timed_and_weighed(self):
        peers = ["--peers", "embree"] if PEER else []
        rows = self.rows("--scene", "gen:terrain?scale=0.01", "--build", "--threads", "1,2", *peers)
        self.assertEqual([row["kind"] for row in rows], ["memory"] + 12 * ["build"])
        self.assertEqual([row["build"] for row in rows[1:]], 4 * ["fast"] + 4 * ["medium"] + 4 * ["high"])
        self.assertTrue(20 < rows[0]["bytes_per_triangle"] < 200)
        for row in rows[1:]:
            self.assertGreater(row["wall_seconds"], 0)
            self.assertIn(row["stage"], ("tree", "scene"))
        textured = self.rows("--scene", "gen:cards?scale=0.01", "--build", "--quality", "fast")
        self.assertEqual([row.get("build") for row in textured], [None, "fast", "fast"])
        # Leaf blocks of eight have another 192 bytes, of texture coordinates.
        self.assertGreater(textured[0]["bytes_per_triangle"], rows[0]["bytes_per_triangle"] + 20)
        self.assertIn("medium", bench("--build", "--quality", "best").stderr)
        instanced = self.rows("--scene", "gen:forest1?scale=0.01", "--build", *peers)
        self.assertTrue(64 < instanced[0]["bytes_per_instance"] < 1000)


class Files(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def write(self, name, data):
        path = self.folder / name
        path.write_bytes(data)
        return str(path)

    def run_files(self, scene, scene_data, rays=RAYS, ref=GOOD_REF):
        option = "--inst" if scene.endswith(".inst") else "--soup"
        return bench("--json", "--rounds", "1", "--traversal", "single", option, self.write(scene, scene_data),
                     "--rays", self.write("x.rays", rays), "--ref", self.write("x.ref", ref))

    def test_a_soup_its_rays_and_their_reference_agree(self):
        run = self.run_files("x.soup", SOUP)
        self.assertEqual(run.returncode, 0, run.stderr)
        row = json.loads(run.stdout)
        self.assertEqual((row["count"], row["ref_mismatches"], row["ref_ties"]), (3, 0, 0))

    def test_instances_of_groups_agree_with_the_reference_of_one_level(self):
        inst_ref = reference((1, 0, 0), (2, 1, 0), (math.inf, 0xFFFFFFFF, 0xFFFFFFFF))
        for groups, root in (([[(0, 0)]], 0), ([[(0, 0)], [(1, 0)]], 1)):
            run = self.run_files("x.inst", instances(groups, root), ref=inst_ref)
            self.assertEqual(run.returncode, 0, run.stderr)
            row = json.loads(run.stdout)
            self.assertEqual((row["ref_mismatches"], row["ref_ties"]), (0, 0))

    def test_wrong_references_are_counted(self):
        wrong = reference((1, 1, 0xFFFFFFFF), (2.1, 1, 0xFFFFFFFF), (4, 0, 0xFFFFFFFF))
        row = json.loads(self.run_files("x.soup", SOUP, ref=wrong).stdout)
        self.assertEqual((row["ref_mismatches"], row["ref_ties"]), (2, 1))

    def test_cut_and_invalid_files_are_refused(self):
        nan = struct.pack("<f", math.nan)
        one = [[(0, 0)]]
        soups = {
            "is not a count": [SOUP[:-1], SOUP + b"\0", struct.pack("<I", 0xFFFFFFFF), b""],
            "coordinates": [SOUP[:4] + nan + SOUP[8:]],
        }
        rays = {
            "is not a count": [RAYS[:-4]],
            "ray 0 is invalid": [struct.pack("<I8f", 1, *8 * [0]), RAYS[:4] + nan + RAYS[8:]],
        }
        references = {
            "is not a count": [GOOD_REF[:-1]],
            "no number": [reference(*3 * [(math.nan, 0, 0)])],
        }
        nested = {
            "is no .inst file": [instances(one, magic=1), b"RNIS"],
            "the root group does not exist": [instances(one, root=1)],
            "which does not exist": [instances([[(0, 1)]]), instances([[(1, 1)]]), instances([[(2, 0)]])],
            "contains itself": [instances([[(1, 0)]]), instances([[(1, 1)], [(1, 0)]])],
            "singular": [instances(one, transform=12 * [0.0]), instances(one, transform=12 * [math.nan])],
            "ends before": [instances(one)[:-1], instances(one)[:60]],
            "bytes behind": [instances(one) + b"\0"],
        }
        cases = [(word, ("x.soup", data)) for word, all in soups.items() for data in all]
        cases += [(word, ("x.soup", SOUP, data)) for word, all in rays.items() for data in all]
        cases += [(word, ("x.soup", SOUP, RAYS, data)) for word, all in references.items() for data in all]
        cases += [(word, ("x.inst", data)) for word, all in nested.items() for data in all]
        for number, (word, case) in enumerate(cases):
            with self.subTest(f"{number}: {word}"):
                run = self.run_files(*case)
                self.assertEqual(run.returncode, 5, f"{run.stdout}{run.stderr}")
                self.assertIn(word, run.stderr)

    def test_a_reference_of_other_rays_is_refused(self):
        run = self.run_files("x.soup", SOUP, ref=reference((1, 0, 0)))
        self.assertEqual(run.returncode, 2, run.stderr)

    def test_unknown_names_are_usage_errors_that_list_the_known_ones(self):
        for arguments, word in ((("--scene", "gen:nowhere"), "forest3"),
                                (("--scene", "gen:cards?scale=9"), "scale=S"),
                                (("--scene", "gen:cards?size=1"), "scale=S"),
                                (("--scene", "gen:cards?scale=0.001", "--rays", "sideways"), "diffuse"),
                                (("--scene", "gen:cards?scale=0.001", "--peers", "nobody"), "nobody")):
            run = bench(*arguments)
            self.assertIn(run.returncode, (2, 5), run.stderr)
            self.assertIn(word, run.stderr)


class Table(unittest.TestCase):
    def lines(self, *runs):
        with tempfile.TemporaryDirectory() as folder:
            files = [pathlib.Path(folder, f"{number}.jsonl") for number in range(len(runs))]
            for file, rows in zip(files, runs):
                file.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
            out, argv = io.StringIO(), sys.argv
            sys.argv = ["table.py", *map(str, files), "--commands"]
            try:
                with redirect_stdout(out):
                    table.main()
            finally:
                sys.argv = argv
        return out.getvalue().splitlines()

    def line(self, title, *runs):
        return next(line for line in self.lines(*runs) if line.startswith(f"| {title}"))

    def row(self, scene, rays, peer, ratio, **more):
        return {"scene": scene, "rays": rays, "kind": "closest", "traversal": "single", "intersector": "opaque",
                "target": "v4", "threads": 1, "peer": peer, "peer_mrays": 1.0,
                "ratio": ratio, "ratio_adjusted": ratio / 1.04, "mismatches": 1, "command": "bench X", **more}

    def test_a_line_is_the_geometric_mean_of_exactly_its_rows(self):
        ratios = iter((1, 2, 4, 1, 2, 4, 1, 2, 4))
        rows = [self.row(scene, rays, "embree", next(ratios)) for scene in table.FLAT
                for rays in ("primary", "diffuse", "random")]
        line = self.line("single rays, closest", rows)
        self.assertIn("| 2 | 1.92 |  | 1.05 | 1.2 | goal | 1 | `bench X` |", line)
        self.assertIn(table.UNAVAILABLE, self.line("single rays, closest", rows[:-1]))

    def test_of_several_runs_the_median_counts_and_the_spread_is_told(self):
        runs = [[self.row("forest3", rays, "own-over", ratio, traversal="auto", ratio_adjusted=ratio)
                 for rays in ("primary", "diffuse", "ao")] for ratio in (0.8, 1.25, 0.95)]
        self.assertIn("| 0.95 | 0.95 (0.8 to 1.25) |  | 0.9 | 1 | floor | 1 |",
                      self.line("forest3 nested", *runs))

    def test_what_a_crowded_core_gave_is_told_beside_it(self):
        rows = [self.row("forest3", rays, "own-over", 1.2, traversal="auto", ratio_adjusted=1.2, ratio_all=0.8,
                         ratio_all_adjusted=0.8, uncrowded=share, crowded_from=level)
                for rays, share, level in (("primary", 0.5, 0.1), ("diffuse", 0.25, 0.2), ("ao", 0.75, 0.1))]
        self.assertIn("| 1.2 | 1.2 | 0.8 | 0.9 | 1 | goal |", self.line("forest3 nested", rows))
        self.assertIn("50% of the laps (median of 3 rows; least 25%); 1 rows never had it alone", self.lines(rows)[-1])

    def test_the_better_of_two_filters_counts(self):
        rows = [self.row("cards", rays, peer, ratio, kind="multi", traversal="auto", peer_mrays=rate)
                for rays in ("primary", "diffuse", "random")
                for peer, ratio, rate in (("embree-list", 3, 1.0), ("embree-shrink", 1.04, 2.0))]
        self.assertIn("| 1.04 | 1 |  | 1.1 | 1.5 | below |", self.line("multi-hit", rows))

    def test_where_ours_chooses_the_best_form_of_the_peer_counts(self):
        def rows(*peers):
            return [self.row("forest1", rays, peer, ratio, traversal=traversal, mrays=ours, peer_mrays=rate,
                             ratio_adjusted=ratio)
                    for rays in ("primary", "diffuse", "ao")
                    for traversal, ours in (("auto", 6.0), ("packet", 8.0))
                    for peer, rate in peers for ratio in (ours / rate,)]
        self.assertIn("| 1.5 | 1.5 |", self.line("forest1", rows(("embree", 1.0), ("embree-coherent", 4.0))))
        self.assertIn("| 1.5 | 1.5 |", self.line("forest1", rows(("embree", 4.0), ("embree-coherent", 1.0))))
        self.assertIn(table.UNAVAILABLE, self.line("forest1", rows(("embree", 1.0))))

    def test_rows_with_too_many_mismatches_are_listed(self):
        rows = [self.row("cards", "primary", "embree", 1, mismatches=7, mismatches_max=2, count=9)]
        self.assertTrue(any("7 of 9" in line for line in self.lines(rows)))


if __name__ == "__main__":
    BENCH, TARGETS, PEER = sys.argv[1], sys.argv[2].split(";"), sys.argv[3] == "with-peer"
    unittest.main(argv=sys.argv[:1], verbosity=2)
