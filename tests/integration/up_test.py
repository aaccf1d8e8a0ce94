#!/usr/bin/env python3
"""Tests the axis that points up as a property of a scene: hits stay in the file's own coordinates; the
camera that is chosen, the sky and its sun follow the axis; and a restart, edits, exports and
compositions keep it.

  up_test.py RAYNESTD RAYNEST
"""
import json
import pathlib
import sys
import warnings

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_state import WithState

# A ground of 8 x 8 with a tall box on it, z up: east is +x and north is +y.
CORNERS = np.array([[x, y, z] for z in (0, 3) for y in (0.5, 1.5) for x in (-1, 1)], float)
SIDES = [(0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6),
         (1, 3, 5), (3, 7, 5)]
GROUND = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], float)
VERTICES = np.concatenate([GROUND, CORNERS])
FACES = np.concatenate([[[0, 1, 2], [0, 2, 3]], np.array(SIDES) + 4])
DOWN = [[0, 1, 9, 0, 0, -1], [3, -3, 9, 0, 0, -1], [0, 1, 9, 0, -0.2, -1]]


def y_up(points):
    points = np.asarray(points, float)
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1)


def obj(vertices, name="tower"):
    lines = [f"o {name}"] + ["v {!r} {!r} {!r}".format(*v) for v in vertices.tolist()]
    return "\n".join(lines + ["f {} {} {}".format(*(f + 1)) for f in FACES]) + "\n"


class Up(WithState):
    def setUp(self):
        super().setUp()
        self.start()
        self.connect()
        self.map = self.folder / "map.obj"
        self.map.write_text(obj(VERTICES))
        self.turned = self.folder / "turned.obj"
        self.turned.write_text(obj(y_up(VERTICES)))

    def connect(self):
        self.python = raynest.connect(self.daemon.uri)
        self.addCleanup(self.python.close)

    def check(self, scene, up="z"):
        """The scene is that of the map, in its own coordinates."""
        self.assertEqual(scene.info["up"], up)
        rays = np.array(DOWN, float)
        rays = rays if up == "z" else np.hstack([y_up(rays[:, :3]), y_up(rays[:, 3:])])
        np.testing.assert_allclose(scene.trace(rays, fields=("t",))["t"][:2], [6, 9], rtol=1e-6)

    def picture(self, scene, **settings):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.asarray(scene.render(size=(96, 72), encode="raw", **settings), float)

    def check_same_picture(self, scene, other, **settings):
        """Rounding differs, and so a few pixels on edges may."""
        ours, theirs = self.picture(scene, **settings), self.picture(other, **settings)
        self.assertGreater(theirs[..., :3].std(), 10)
        self.assertLess((np.abs(ours - theirs).max(-1) > 3).mean(), 0.02, settings)

    def test_hits_stay_in_the_files_coordinates(self):
        scene = self.python.load(self.map, up="z")
        self.check(scene)
        np.testing.assert_array_equal(scene.info["box_max"], [4, 4, 3])
        told = self.client.json("info", "map")
        self.assertEqual(told["up"], "z")
        self.assertRegex(self.client.run("info", "map").stdout, r"(?m)^up +z$")
        # Without the word they are the same numbers, and another scene.
        plain = self.python.load(self.map, "plain")
        self.assertEqual(plain.info["up"], "y")
        np.testing.assert_array_equal(plain.info["box_max"], [4, 4, 3])
        self.assertNotEqual(plain.info["hash"], scene.info["hash"])
        self.assertNotRegex(self.client.run("info", "plain").stdout, r"(?m)^up ")

    def test_camera_sky_and_sun_follow_it(self):
        scene, turned = self.python.load(self.map, up="z"), self.python.load(self.turned)
        self.check_same_picture(scene, turned)
        for settings in ({"integrator": "direct", "spp": 16}, {"integrator": "path", "spp": 16, "sun": (100, 20)}):
            self.check_same_picture(scene, turned, **settings)
        view = np.array([[5, -6, 4], [0, 0, 1]])
        ours = self.picture(scene, look_at=view, integrator="direct", spp=32)
        theirs = self.picture(turned, look_at=y_up(view), integrator="direct", spp=32)
        self.assertLess((np.abs(ours - theirs).max(-1) > 3).mean(), 0.02)
        # A picture of the surroundings: its upper half is bright. The same scene lit from -z is not the same.
        plain = self.python.load(self.map, "plain")
        ours = self.picture(scene, look_at=[*view, [0, 0, 1]], integrator="direct", spp=4)
        theirs = self.picture(plain, look_at=[*view, [0, 0, 1]], integrator="direct", spp=4)
        self.assertGreater((np.abs(ours - theirs).max(-1) > 3).mean(), 0.2)

    def test_a_lidar_stands_upright(self):
        scene, turned = self.python.load(self.map, up="z"), self.python.load(self.turned)
        view = np.array([[3, -3, 2], [0, 1, 0.5]])
        settings = dict(elevations=np.linspace(-40, 10, 8), azimuths=(0, 360, 90))
        ours = scene.trace(raynest.generators.lidar(look_at=view, **settings), fields=("t",))["t"]
        theirs = turned.trace(raynest.generators.lidar(look_at=y_up(view), **settings), fields=("t",))["t"]
        self.assertGreater(np.isfinite(theirs).sum(), 100)
        self.assertLess((~np.isclose(ours, theirs, rtol=1e-4)).sum(), 5)

    def test_a_restart_an_edit_and_exports_keep_it(self):
        scene = self.python.load(self.map, up="z")
        digest, hits = scene.info["hash"], self.hits("map")
        out = self.folder / "out"
        out.mkdir()
        for file in ("one.glb", "two.rnscene.json"):
            done = self.client.run("export", "map", "-o", out / file)
            self.assertEqual(done.returncode, 0, done.stderr)
            copy = self.python.load(out / file)
            self.check(copy)
            np.testing.assert_array_equal(np.frombuffer(self.hits(copy.name)["t"], np.float32),
                                          np.frombuffer(hits["t"], np.float32))
        self.assertEqual(json.loads((out / "two.rnscene.json").read_text())["up"], "z")
        # Other programs see the file upright, as glTF has it.
        size = int.from_bytes((out / "one.glb").read_bytes()[12:16], "little")
        document = json.loads((out / "one.glb").read_bytes()[20:20 + size])
        self.assertEqual(document["scenes"][0]["extras"]["raynest"]["up"], "z")
        matrix = np.reshape(document["nodes"][0]["matrix"], (4, 4)).T[:3, :3]
        np.testing.assert_array_equal(matrix @ [1, 2, 3], y_up([1, 2, 3]))
        self.again()
        self.connect()
        kept = self.python.scene("map")
        self.assertEqual(kept.info["hash"], digest)
        self.check(kept)
        with kept.edit(keep=True) as edit:
            edit.set_mask("tower", 0x1)
        self.assertEqual(self.python.scene("map").info["up"], "z")
        self.again()
        self.connect()
        self.assertEqual(self.python.scene("map").info["up"], "z")

    def test_compositions_turn_what_has_another_axis(self):
        def town(name, up, **objects):
            path = self.folder / f"{name}.rnscene.json"
            path.write_text(json.dumps({"rnscene": 1, **({"up": up} if up else {}), "objects": objects,
                                        "instances": [{"object": each} for each in objects]}))
            return self.python.load(path)

        self.client.run("load", self.map, "--up", "z", "--name", "glb")
        self.client.run("export", "glb", "-o", self.folder / "map.glb")
        # In a z-up one, a file that says nothing has the composition's axis; built-ins and glTF have their own.
        for number, (up, file) in enumerate((("z", {"file": "map.obj"}), ("z", {"file": "map.obj", "up": "z"}),
                                             ("z", {"file": "turned.obj", "up": "y"}), ("z", {"file": "map.glb"}),
                                             ("y", {"file": "map.obj", "up": "z"}), ("y", {"file": "turned.obj"}),
                                             ("", {"file": "map.glb"}), ("", {"file": "t0.rnscene.json"}),
                                             ("z", {"file": "t5.rnscene.json"}))):
            with self.subTest(composition=up, file=file):
                self.check(town(f"t{number}", up, a=file), up or "y")
        flake = town("grown", "z", a={"file": "builtin:flake?depth=1"}).info
        plain = self.python.load("builtin:flake?depth=1").info
        np.testing.assert_allclose(flake["box_max"][2], plain["box_max"][1], rtol=1e-6)
        camera = self.folder / "camera.rnscene.json"
        camera.write_text(json.dumps({
            "rnscene": 1, "up": "z", "objects": {"a": {"file": "map.obj"}}, "instances": [{"object": "a"}],
            "cameras": [{"eye": [5, -6, 4], "target": [0, 0, 1]}]}))
        scene = self.python.load(camera)
        ours = self.picture(scene)
        theirs = self.picture(scene, look_at=[[5, -6, 4], [0, 0, 1], [0, 0, 1]])
        self.assertLess((np.abs(ours - theirs).max(-1) > 3).mean(), 0.02)
        # Edits turn what they add.
        with self.python.load(self.turned, "other").edit() as edit:
            edit.add(self.python.load(self.map, "guest", up="z"), [30, 0, 0])
        rays = np.array(DOWN, float)[:2]
        rays = np.hstack([y_up(rays[:, :3]) + [30, 0, 0], y_up(rays[:, 3:])])
        np.testing.assert_allclose(self.python.scene("other").trace(rays, fields=("t",))["t"], [6, 9], rtol=1e-5)

    def test_who_takes_it(self):
        for source, said in (("builtin:flake?depth=1", "y points up in a built-in scene: leave out up="),):
            with self.assertRaisesRegex(raynest.Error, said):
                self.python.load(source, up="z")
        heights = self.folder / "heights.npy"
        np.save(heights, np.arange(12.0).reshape(3, 4))
        scene = self.python.load(heights, primitive="heights", up="z")
        hit = scene.trace([[1.001, -1.001, 99, 0, 0, -1]], fields=("position",))["position"][0]
        np.testing.assert_allclose(hit, [1.001, -1.001, 5.005], atol=1e-3)
        spheres = self.folder / "spheres.npy"
        np.save(spheres, np.array([[0, 0, 0, 1], [0, 0, 5, 1]], np.float32))
        self.assertEqual(self.python.load(spheres, primitive="sphere", up="z").info["up"], "z")


if __name__ == "__main__":
    main()
