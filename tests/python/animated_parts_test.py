#!/usr/bin/env python3
"""Parts that an animation moves: how fast they go, what edits do to them, and rays with times of their own.

  animated_parts_test.py RAYNESTD RAYNEST FLATC
"""
import numpy as np

import animation_test
import raynest
from animation_test import RAIN, RNG, poses, rays_at, travelling
from with_daemon import WithDaemon, main


class AnimatedParts(WithDaemon):
    load, skinned = animation_test.Animation.load, animation_test.Animation.skinned

    def test_velocities_are_those_of_float64(self):
        """Differences of poses that are known in closed form; on key 2, of the way there."""
        def rate(of, time):
            return (of(time) - of(time - 1e-6)) / 1e-6 if time in (1.0, 2.0) else (of(time + 1e-6) - of(time - 1e-6)) / 2e-6
        down = np.array([[0, 1., 0]])
        scene = self.load(travelling(), "drive")
        spots = np.pad(RNG.uniform(-.3, .3, (20, 3)) * [1, 0, 1] + [0, .8, 0], ((0, 0), (0, 1)), constant_values=1)
        for time in (.25, .5, 1.375, 1.75, 2.0):
            for name, to_world in poses(time).items():
                rays = rays_at(spots @ to_world[:3].T, np.tile(down, (20, 1)))
                hits = scene.trace(rays, fields=("t", "path", "velocity", "radial_velocity"), time=time)
                np.testing.assert_array_equal(hits["path"], scene.trace(rays, fields=("path",), time=time)["path"])
                self.assertEqual(set(scene.path_of(hits["path"])), {name})
                moves = spots @ rate(lambda t: poses(t)[name][:3], time).T
                np.testing.assert_allclose(hits["velocity"], moves, atol=1e-4)
                np.testing.assert_allclose(hits["radial_velocity"], -moves[:, 1], atol=1e-4)
        for morph in (False, True):
            gltf, expected, faces = self.skinned(morph)
            scene = self.load(gltf, "strip")
            for time in (.25, 1.375, 2.0):
                corners, moves = expected(time)[faces], rate(expected, time)[faces]
                normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                normals /= np.linalg.norm(normals, axis=1, keepdims=True)
                shares = RNG.dirichlet((3, 3, 3), len(faces))[..., None]
                hits = scene.trace(rays_at((shares * corners).sum(1), normals), fields=("prim", "velocity"), time=time)
                np.testing.assert_array_equal(hits["prim"], np.arange(len(faces)))
                np.testing.assert_allclose(hits["velocity"], (shares * moves).sum(1), atol=1e-4)
            self.assertFalse(scene.trace(RAIN, fields=("velocity",))["velocity"].any())  # no time, no motion

    def test_an_edit_stays_on_what_the_animation_moves(self):
        """Moved, turned and scaled: also how fast it goes, and beside a node that stands still."""
        scene = self.load(travelling(), "drive")
        turned = np.array([[0, 0, 1.5, 2], [0, 1.5, 0, 3], [-1.5, 0, 0, -1]])
        with scene.edit() as edit:
            edit.move("arm", turned)
            edit.move("still", (0, 5, 0))
        spots = np.pad(RNG.uniform(-.3, .3, (20, 3)) * [1, 0, 1] + [0, .8, 0], ((0, 0), (0, 1)), constant_values=1)
        at = lambda t: np.vstack([turned, [0, 0, 0, 1]]) @ poses(t)["arm/box"]
        for time in (0.0, .25, .5, 1.375):
            rays = rays_at(spots @ at(time)[:3].T, np.tile([0, 1., 0], (20, 1)))
            hits = scene.trace(rays, fields=("t", "path", "velocity"), time=time)
            np.testing.assert_allclose(hits["t"], .25, atol=2e-5)
            self.assertEqual(set(scene.path_of(hits["path"])), {"arm/box"})
            before = max(time - 1e-6, 0)
            moves = spots @ (at(time + 1e-6)[:3] - at(before)[:3]).T / (time + 1e-6 - before)
            np.testing.assert_allclose(hits["velocity"], moves, atol=2e-4)
            still = scene.trace(rays_at(np.array([[-4, 5.8, 0.]]), np.array([[0, 1., 0]])), fields=("t", "velocity"), time=time)
            self.assertAlmostEqual(float(still["t"][0]), .25, delta=1e-5)
            self.assertFalse(still["velocity"].any())
        with scene.edit() as edit:  # back to where it was
            edit.move("arm", np.linalg.inv(np.vstack([turned, [0, 0, 0, 1]])))
            edit.move("still", (0, -5, 0))
        wanted = self.load(travelling(), "fresh").info_at(.5)
        np.testing.assert_allclose(scene.info_at(.5)["box_max"], wanted["box_max"], atol=1e-5)

    def test_rays_have_times_of_their_own(self):
        scene = self.load(travelling(), "drive")
        times = RNG.choice([0, .25, .5, 1.1, 2], len(RAIN))
        for kind in ("closest", "all", "any"):
            fields = ("hit",) if kind == "any" else ("t", "path", "hit", "direction")
            made = scene.trace(RAIN, kind=kind, fields=fields, time=times, mask=np.arange(len(RAIN)) % 2)
            told = dict(self.client.outcome)
            self.assertEqual((told["rays"], told["rows"], told["hits"] > 20), (len(RAIN), len(RAIN), True))
            for number in range(0, len(RAIN), 97):
                alone = scene.trace(RAIN[number:number + 1], kind=kind, fields=fields, time=times[number], mask=number % 2)
                first, end = (made["ray_splits"][number:number + 2] if kind == "all" else (number, number + 1))
                for name in fields:
                    part = made[name][first:end] if name in ("t", "path") else made[name][number:number + 1]
                    np.testing.assert_array_equal(part, alone[name], name)
        # A step has one time, in its middle.
        some, ends = np.array([0, .1, .2, .9, .98]), [scene.trace(RAIN, time=t, fields=("t",))["t"] for t in (0, .1, .9, .94)]
        five = RAIN[[*np.flatnonzero(ends[0] != ends[1])[:3], *np.flatnonzero(ends[2] != ends[3])[:2]]]
        news = []
        made = scene.trace(five[:, :3], five[:, 4:7], time=some, time_step=.5, fields=("t",), progress=lambda *each: news.append(each))["t"]
        self.assertEqual(news, [(1, 2, "tracing"), (2, 2, "tracing")])
        wanted = [scene.trace(five[i:i + 1], time=t, fields=("t",))["t"][0] for i, t in enumerate((.1, .1, .1, .94, .94))]
        np.testing.assert_array_equal(made, wanted)
        self.assertEqual(len(scene.trace(np.zeros((0, 6)), time=[], fields=("t",))["t"]), 0)
        some = RAIN[:6].copy()
        some[[2, 5], 4:7] = 0
        with self.assertWarns(raynest.RayWarning):
            scene.trace(some, time=[2, 2, 1, 0, 0, 0], fields=("t",))
        self.assertEqual([self.client.outcome[name] for name in ("invalid", "first_invalid")], [2, 2])
        sweep = raynest.generators.lidar([0], (0, 360, 4))
        for rays, options, says in ((RAIN[:3], {"time": [0, 1]}, "for 3 rays"), (RAIN[:3], {"time": [0, 1, np.nan]}, "finite"),
                                    (RAIN[:3], {"time": [0, 1, 2], "time_step": 0}, "above 0"), (sweep, {"time": [0] * 4}, "its sensor"),
                                    (RAIN[:3], {"time": [0, 1, 2], "detach": True}, "detach")):
            with self.assertRaisesRegex(raynest.UsageError, says):
                scene.trace(rays, **options)
        # One ray may lack its brackets, and masked rows are invalid rays.
        down, way = RAIN[0, :3].tolist(), RAIN[0, 4:7].tolist()
        alone = scene.trace(RAIN[:1], time=1, fields=("t",))["t"]
        for one in ((down + way,), (down, way), ([down], way)):
            np.testing.assert_array_equal(scene.trace(*one, time=[1], fields=("t",))["t"], alone)
        for none in (([],), ([], way), (down, [])):
            self.assertEqual(scene.trace(*none, time=[], fields=("t",))["t"].shape, (0,))
        with self.assertWarns(raynest.RayWarning):
            scene.trace(np.ma.array(RAIN[:2], mask=[[False] * 8, [True] * 8]), time=[0, 1], fields=("t",))
        self.assertEqual([self.client.outcome[name] for name in ("invalid", "first_invalid")], [1, 1])
        with self.assertRaisesRegex(raynest.UsageError, "rays must be numbers, in rows of one length"):
            scene.trace([[1, 2, 3, 4, 5, 6], [1, 2]], time=[0, 1])
        for call in (scene.render, scene.heatmap, scene.blame, lambda **job: next(scene.render_stream(**job)), lambda **job: scene.explain(RAIN[0], **job),
                     lambda **job: scene.occluded(RAIN[:2, :3], RAIN[2:4, :3], **job), lambda **job: next(scene.stream(RAIN, **job))):
            with self.assertRaisesRegex(raynest.UsageError, "time must be one number here"):
                call(time=[0, 1])
            for job in ({}, {"time": 1.0}, {"time": None}):
                with self.assertRaisesRegex(raynest.UsageError, "^time_step is for rays with times of their own: "):
                    call(**job, time_step=.1)
        for job in ({}, {"time": 1.0}, {"time": None}):
            with self.assertRaisesRegex(raynest.UsageError, "^time_step is for rays with times of their own: "):
                scene.trace(RAIN, **job, time_step=.1)
            with self.assertRaisesRegex(raynest.UsageError, "^time_step is for rays with times of their own: "):
                raynest.returns.measure(scene, sweep, **job, time_step=.1)

    def test_a_lidar_measures_returns_and_velocities_of_what_moves_meanwhile(self):
        gltf = animation_test.Gltf()
        box = gltf.node(name="box", mesh=gltf.mesh(animation_test.CORNERS, animation_test.FACES))
        gltf.animate("Go", (box, "translation", [0, 1], [[5, -.4, 0], [15, -.4, 0]], "LINEAR"))
        scene = self.load(gltf, "goes")
        poses = np.tile(np.eye(3, 4), (2, 1, 1))
        poses[:, :, 1], poses[:, :, 2] = (0, 0, -1), (0, 1, 0)
        poses[1, 0, 3] = 2
        sweep = raynest.sweeps.lidar([0], np.zeros(40), end=1, trajectory=([0, 1], poses))
        for step, off in ((None, 2e-5), (.1, .5)):
            made = raynest.returns.measure(scene, sweep, divergence=1e-3, footprint=7, time=sweep.time, time_step=step)
            self.assertEqual(len(made["t"]), 40)
            np.testing.assert_allclose(made["t"], 4.5 + 8 * sweep.time, atol=off)
            np.testing.assert_allclose(made["radial_velocity"], 8, atol=1e-3)
            made = raynest.returns.measure(scene, sweep, time=sweep.time, time_step=step, fields=("velocity", "ng"))
            np.testing.assert_allclose(made["velocity"], np.tile([10, 0, 0], (40, 1)), atol=1e-3)
        with self.assertRaisesRegex(raynest.UsageError, "one for each beam"):
            raynest.returns.measure(scene, sweep, time=sweep.time[1:])


if __name__ == "__main__":
    main()
