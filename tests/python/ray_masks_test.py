#!/usr/bin/env python3
"""A mask of each ray: the answer is that of separate requests, each with one mask, in every byte.

  ray_masks_test.py RAYNESTD RAYNEST FLATC
"""
import os
import subprocess
import sys

import numpy as np

import raynest
from raynest import generators
from with_daemon import FIELDS, WithDaemon, main, rain

SURVEY = (4_500_000.25, 10.0, -5_400_000.5)
MASKS = np.array([1, 2, 4, 3, 0, 2**32 - 1, 2**31], np.uint32)


def masks_of(count, seed=2):
    """Masks in runs and alone, so that chunks have groups of one ray and of many."""
    chance = np.random.default_rng(seed)
    masks = chance.choice(MASKS, count)
    masks[count // 4:count // 2] = MASKS[1]
    return masks


class RayMasks(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        with cls.woods.edit() as edit:
            for tree in range(cls.woods.info["instances"]):
                if tree < 20:
                    edit.set_mask(tree, 1 << tree % 3)

    def separate(self, ask, masks):
        """The rows of ask(chosen rays, mask) for each mask, in the order of all rays."""
        whole = {}
        for mask in np.unique(masks):
            chosen = np.flatnonzero(masks == mask)
            for name, column in ask(chosen, int(mask)).items():
                whole.setdefault(name, np.empty((len(masks), *column.shape[1:]), column.dtype))[chosen] = column
        return whole

    def separate_hits(self, ask, masks):
        """The same for answers with ray_splits."""
        parts, rows = {}, [None] * len(masks)
        for mask in np.unique(masks):
            chosen = np.flatnonzero(masks == mask)
            parts[mask] = ask(chosen, int(mask))
            splits = parts[mask]["ray_splits"].astype(int)
            for ray, at in zip(chosen, range(len(chosen))):
                rows[ray] = mask, at, splits[at], splits[at + 1]
        whole = {}
        for name in parts[masks[0]]:
            if name == "ray_splits":
                whole[name] = np.cumsum([0, *(end - first for _, _, first, end in rows)]).astype(np.int64)
            elif name in ("hit", "flags", "total"):
                whole[name] = np.array([parts[mask][name][at] for mask, at, _, _ in rows])
            else:
                whole[name] = np.concatenate([parts[mask][name][first:end] for mask, _, first, end in rows])
        return whole

    def test_the_closest_hits_are_those_of_a_request_for_each_mask(self):
        rays, masks = rain(50000), masks_of(50000)
        for options in ({}, {"traversal": "single"}, {"traversal": "stream"}, {"traversal": "packet"},
                        {"fields": FIELDS}, {"fields": ("t", "total", "flags")}, {"fields": ("t", "boxes.1")},
                        {"intersector": "alpha_mask"}, {"kind": "any"}, {"kind": "any", "fields": ("hit", "total")},
                        {"kind": "null"}):
            with self.subTest(**options):
                whole = self.woods.trace(rays, mask=masks, **options)
                self.same(whole, self.separate(lambda chosen, mask: self.woods.trace(rays[chosen], mask=mask, **options),
                                               masks))
        hits = self.woods.trace(rays, mask=masks, fields=("t", "mask", "hit"))
        met = hits["hit"] != 0
        self.assertTrue((hits["mask"][met] & masks[met] != 0).all())
        self.assertFalse(met[masks == 0].any())
        self.assertNotEqual(np.count_nonzero(met), np.count_nonzero(self.woods.trace(rays, fields=("hit",))["hit"]))

    def test_the_reference_without_trees_has_the_same_hits(self):
        rays, masks = rain(600), masks_of(600)
        self.same(self.woods.trace(rays, mask=masks, traversal="reference"), self.woods.trace(rays, mask=masks))

    def test_many_hits_are_those_of_a_request_for_each_mask(self):
        rays, masks = rain(6000), masks_of(6000)
        for options in ({"kind": "multi"}, {"kind": "multi", "max_hits": 256},
                        {"kind": "multi", "fields": ("t", "prim", "flags", "total")}, {"kind": "all"},
                        {"kind": "all", "fields": ("t", "path", "flags", "hit"), "max_hits": 3},
                        {"kind": "all", "max_hits": 65536}):
            with self.subTest(**options):
                whole = self.woods.trace(rays, mask=masks, **options)
                told = dict(self.client.outcome)
                self.same(whole, self.separate_hits(
                    lambda chosen, mask: self.woods.trace(rays[chosen], mask=mask, **options), masks))
                self.assertEqual((told["rays"], told["rows"]), (6000, 6000))

    def test_all_forms_of_rays_carry_masks(self):
        rays, masks = rain(40000), masks_of(40000)
        six = rays[:, [0, 1, 2, 4, 5, 6]]
        expected = self.woods.trace(rays, mask=masks)
        for form in ((six,), (six.astype(np.float64),), (rays[:, :3], rays[:, 4:7])):
            self.same(self.woods.trace(*form, mask=masks.tolist()), expected)
        one = rays[0, :3]
        self.same(self.woods.trace(one, rays[:, 4:7], mask=masks),
                  self.separate(lambda chosen, mask: self.woods.trace(one, rays[chosen, 4:7], mask=mask), masks))
        # Few rays are answered without a task of the pool, or together with those of others.
        for few in (1, 2, 60, 200):
            self.same(self.woods.trace(rays[:few], mask=masks[:few]),
                      {name: column[:few] for name, column in expected.items()})
        self.assertEqual(len(self.woods.trace(rays[:0], mask=masks[:0])["t"]), 0)

    def test_lines_of_sight_and_streams_carry_masks(self):
        chance = np.random.default_rng(3)
        a, b = chance.uniform(-40, 40, (2, 3000, 3)) * [1, 0.1, 1] + [0, 4, 0]
        masks = masks_of(3000)
        free = self.woods.occluded(a, b, mask=masks)
        for mask in MASKS:
            np.testing.assert_array_equal(free[masks == mask], self.woods.occluded(a, b, mask=int(mask))[masks == mask])
        self.assertTrue(free.any() and not free.all())
        # All pairs, with a mask for each of one side: each robot does not see itself.
        pairs = self.woods.occluded(a[:40, None], b[None, :30], mask=masks[:40, None])
        for i in range(40):
            np.testing.assert_array_equal(pairs[i], self.woods.occluded(a[i], b[:30], mask=int(masks[i])))
        rays, masks = rain(100000), masks_of(100000)
        expected = self.woods.trace(rays, mask=masks)
        for sent in ({"rays": rays, "mask": masks},
                     {"rays": iter(np.split(rays, 4)), "mask": iter(np.split(masks, 4))}):
            made = {name: np.empty_like(column) for name, column in expected.items()}
            for first, columns in self.woods.stream(**sent):
                for name, column in columns.items():
                    made[name][first:first + len(column)] = column
            self.same(made, expected)

    def test_points_and_reducers_carry_masks(self):
        chance = np.random.default_rng(4)
        points = chance.uniform(-40, 40, (700, 3)) * [1, 0, 1]
        masks = masks_of(700)
        for samples in (3, 64, 20000):
            few = 700 if samples < 1000 else 5
            def ask(chosen, mask, **options):
                some = generators.hemisphere(points[chosen], (0, 1, 0), samples=samples)
                return self.woods.trace(some, mask=mask, **options)
            whole = ask(np.arange(few), masks[:few], reduce="hit_fraction")["hit_fraction"]
            self.assertEqual(len(whole), few)
            # The rays of a point depend on its number, so compare with all points of each mask.
            for mask in np.unique(masks[:few]):
                alike = ask(np.arange(few), int(mask), reduce="hit_fraction")["hit_fraction"]
                np.testing.assert_array_equal(whole[masks[:few] == mask], alike[masks[:few] == mask])
        rows = self.woods.trace(generators.hemisphere(points, (0, 1, 0), samples=3), mask=masks, fields=("t", "prim"))
        for mask in MASKS:
            alike = self.woods.trace(generators.hemisphere(points, (0, 1, 0), samples=3), mask=int(mask),
                                     fields=("t", "prim"))
            np.testing.assert_array_equal(rows["t"][np.repeat(masks == mask, 3)],
                                          alike["t"][np.repeat(masks == mask, 3)])
        rays, masks = rain(30000), masks_of(30000)
        seen = self.woods.trace(rays, mask=masks, reduce="visible_pixels")
        paths = self.woods.trace(rays, mask=masks, fields=("path", "hit"))
        path, pixels = np.unique(paths["path"][paths["hit"] != 0], return_counts=True)
        np.testing.assert_array_equal(seen["path"], path)
        np.testing.assert_array_equal(seen["pixels"], pixels)

    def test_far_scenes_hidden_parts_and_detached_jobs(self):
        rays, masks = rain(5000), masks_of(5000)
        far = self.client.mesh(np.array([[-50, 0, -50], [50, 0, -50], [0, 0, 50]]) + SURVEY, [[0, 1, 2]], name="far",
                               origin=SURVEY)
        with far.edit() as edit:
            edit.set_mask(0, 2)
        moved = rays.astype(np.float64)
        moved[:, :3] += SURVEY
        for scene, sent, options in ((far, moved, {}), (self.woods, rays, {"hide": [0, 3]})):
            options["fields"] = ("t", "position", "hit")
            hits = scene.trace(sent, mask=masks, **options)
            self.same(hits, self.separate(lambda chosen, mask: scene.trace(sent[chosen], mask=mask, **options), masks))
            self.assertTrue(hits["hit"].any() and not hits["hit"].all())
        job = self.woods.trace(rays, mask=masks, detach=True)
        job.wait()
        self.same(job.fetch(), self.woods.trace(rays, mask=masks))

    def test_many_clients_with_few_rays_get_their_own_masks(self):
        rays = rain(100)
        alone = {int(mask): self.woods.trace(rays, mask=int(mask)) for mask in MASKS}
        masks = masks_of(100)
        mixed = self.woods.trace(rays, mask=masks)
        script = ("import sys, numpy as np, raynest\n"
                  "from with_daemon import rain\n"
                  "from ray_masks_test import masks_of\n"
                  "s = raynest.connect(sys.argv[1]).scene('woods')\n"
                  "first = s.trace(rain(100), mask=masks_of(100))\n"
                  "for _ in range(100):\n"
                  "    again = s.trace(rain(100), mask=masks_of(100))\n"
                  "    assert all((again[name] == first[name]).all() for name in first)\n")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        others = [subprocess.Popen([sys.executable, "-c", script, self.daemon.uri], env=environment) for _ in range(3)]
        for mask, expected in alone.items():
            for _ in range(20):
                self.same(self.woods.trace(rays, mask=mask), expected)
        self.assertEqual([other.wait() for other in others], [0, 0, 0])
        self.same(self.woods.trace(rays, mask=masks), mixed)

    def test_the_command_line_reads_masks_from_a_file(self):
        rays, masks = rain(40000), masks_of(40000)
        np.save(self.out / "rays.npy", rays)
        np.save(self.out / "masks.npy", masks)
        words = ("query", "woods", "--rays", self.out / "rays.npy", "--masks", self.out / "masks.npy", "-o",
                 self.out / "hits.npz")

        def read(name="hits.npz"):
            with np.load(self.out / name) as file:
                return {name: file[name] for name in file.files if name != "raynest"}
        self.cli.run(*words)
        self.same(read(), self.woods.trace(rays, mask=masks))
        # A ray enters what has a bit of both.
        self.cli.run(*words, "--mask", "3")
        self.same(read(), self.woods.trace(rays, mask=masks & 3))
        for part in (1, 2, 3):
            done = self.cli.run(*words[:-1], self.out / f"part-{part}.npz", "--part", f"{part}/3")
            self.assertEqual(done.returncode, 0, done.stderr)
        done = self.cli.run("merge", self.out / "all.npz", *(self.out / f"part-{part}.npz" for part in (1, 2, 3)))
        self.assertEqual(done.returncode, 0, done.stderr)
        self.same(read("all.npz"), self.woods.trace(rays, mask=masks))
        np.save(self.out / "masks.npy", masks.astype(np.int64))     # any size will do
        self.cli.run(*words)
        self.same(read(), self.woods.trace(rays, mask=masks))
        for wrong, said in ((masks[:10], r"has the shape \(10,\); masks of these rays have the shape \(40000,\)"),
                            (-masks.astype(int), "as the mask of ray 0; masks are whole numbers"),
                            (masks.astype(np.float64), r"has floats \(<f8\); masks are whole numbers"),
                            (np.arange(40000), "ray_masks_max = 64")):
            np.save(self.out / "masks.npy", wrong)
            done = self.cli.run(*words)
            self.assertEqual(done.returncode, 5, done.stderr)
            self.assertRegex(done.stderr, said)
        done = self.cli.run("query", "woods", "--generate", "camera", "size=4x4", "--masks", self.out / "masks.npy")
        self.assertEqual(done.returncode, 2)
        self.assertIn("give one --mask", done.stderr)

    def test_what_is_wrong_with_masks_gets_a_line(self):
        rays = rain(70000)
        few = np.arange(70000, dtype=np.uint32) % 64
        self.woods.trace(rays, mask=few)
        # The 65th comes in a later frame.
        with self.assertRaisesRegex(raynest.InvalidError, "ray_masks_max = 64.*several queries"):
            self.woods.trace(rays, mask=np.where(np.arange(70000) < 69999, few, 99))
        with self.assertRaisesRegex(raynest.InvalidError, "ray_masks_max"):
            self.woods.trace(rays[:100], mask=np.arange(100))
        for wrong in ([1, 2], np.ones((70000, 1), int)):
            with self.assertRaisesRegex(raynest.UsageError, "for 70000 rays: it must be one number"):
                self.woods.trace(rays, mask=wrong)
        with self.assertRaisesRegex(raynest.UsageError, "0 to 4294967295"):
            self.woods.trace(rays[:2], mask=[1, 2**32])
        for wrong in ([1.5, 2], [1.0, 2.0], [-1, 2]):
            with self.assertRaises(raynest.UsageError):
                self.woods.trace(rays[:2], mask=wrong)
        with self.assertRaisesRegex(raynest.UsageError, "mask of bools"):
            self.woods.trace(rays[:2], mask=[True, False])
        with self.assertRaisesRegex(raynest.UsageError, "makes these rays"):
            self.woods.trace(generators.camera(size=(4, 4)), mask=[1] * 16)
        with self.assertRaisesRegex(raynest.UsageError, "one number here"):
            self.woods.render(mask=[1, 2])
        with self.assertRaisesRegex(raynest.UsageError, "fit"):
            self.woods.occluded(np.zeros((4, 1, 3)), np.ones((1, 5, 3)), mask=[1, 2, 3])


if __name__ == "__main__":
    main()
