#!/usr/bin/env python3
"""Cameras of a file, and what a user hears whose camera sees nothing of the scene.

  cameras_test.py RAYNESTD RAYNEST FLATC
"""
import json
import re
import struct

import numpy as np

import raynest
from raynest._requests.gltf import mesh_glb
from with_daemon import WithDaemon, main

# A cube of 2 metres around the origin, its surfaces facing outwards.
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]


def with_cameras(glb, cameras, nodes):
    """The same .glb with cameras: nodes name them, and stand behind its own."""
    size = struct.unpack_from("<I", glb, 12)[0]
    document = json.loads(glb[20:20 + size])
    document["cameras"] = cameras
    document["scenes"][0]["nodes"] += list(range(1, 1 + len(nodes)))
    document["nodes"] += nodes
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = glb[20 + size:]
    return (struct.pack("<3I", 0x46546C67, 2, 20 + len(text) + len(rest)) +
            struct.pack("<2I", len(text), 0x4E4F534A) + text + rest)


class Cameras(WithDaemon):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cameras = [{"type": "orthographic",
                    "orthographic": {"xmag": 2, "ymag": 1, "znear": 0.1, "zfar": 100}},
                   {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}]
        nodes = [{"name": "flat", "camera": 0, "translation": [0, 0, 10]},
                 {"name": "away", "camera": 1, "translation": [0, 0, -10]},
                 {"name": "inside", "camera": 1}]
        file = cls.out / "cube.glb"
        file.write_bytes(with_cameras(bytes(mesh_glb(CORNERS, FACES)), cameras, nodes))
        cls.cube = cls.client.load(file, "cube")

    def notes(self):
        return " ".join(self.client.outcome["notes"])

    def test_an_orthographic_camera_shows_its_xmag_and_ymag(self):
        self.assertEqual(self.cube.info["cameras"], ["flat", "away", "inside"])
        pixels = self.cube.render(size=(40, 20))
        # 4 x 2 metres, of which the cube fills the middle half.
        hit = pixels[:, :, 3] == 255
        self.assertTrue(hit[:, 10:30].all())
        self.assertFalse(hit[:, :10].any() or hit[:, 30:].any())
        answer = self.cube.trace(raynest.generators.camera(size=(40, 20)), fields=["t", "position"])
        t = answer["t"].reshape(20, 40)
        np.testing.assert_allclose(t[:, 10:30], 9, rtol=1e-6)
        self.assertTrue(np.isinf(t[:, :10]).all())
        position = answer["position"].reshape(20, 40, 3)
        np.testing.assert_allclose(position[0, 10], [-0.95, 0.95, 1], atol=1e-6)
        np.testing.assert_allclose(position[19, 29], [0.95, -0.95, 1], atol=1e-6)
        with self.assertRaisesRegex(raynest.Error, "orthographic: it has no field of view"):
            self.cube.render(size=(40, 20), fov=30)
        self.cli.run("query", "cube", "--generate", "camera", "size=40x20", "--fields", "t",
                     "-o", self.out / "t.npz")
        np.testing.assert_array_equal(np.load(self.out / "t.npz")["t"].reshape(20, 40), t)

    def test_a_camera_that_sees_nothing_gets_a_view_that_frames_the_scene(self):
        for show in (self.cube.render, self.cube.heatmap):
            for camera, why in (("away", "sees nothing"), ("inside", "sees only backs of surfaces")):
                with self.assertWarnsRegex(raynest.RayWarning, "to frame the scene take look_at="):
                    show(size=(32, 18), camera=camera)
                self.assertIn(f"camera '{camera}' {why}", self.notes())
                show(size=(32, 18), camera=camera, tile=(0, 8, 32, 8))
                self.assertNotIn(why, self.notes())     # it does not know the other tiles
                self.assertIn(f"camera '{camera}' {why}", self.client.outcome["note_of_all"])
            show(size=(32, 18))
            self.assertNotIn("look_at", self.notes())
        seen = self.cli.run("render", "cube", "--size", "32x18", "--camera", "away",
                            "-o", self.out / "a.png").stderr
        words = re.search(r"take (--lookat \S+)", seen).group(1).split()
        framed = self.cli.run("render", "cube", *words, "--size", "32x18", "-o", self.out / "b.png")
        self.assertNotIn("--lookat", framed.stderr)
        numbers = [float(number) for number in words[-1].split(",")]
        self.cube.render(size=(32, 18), look_at=(numbers[:3], numbers[3:]))
        self.assertGreater(self.client.outcome["hits"], 32 * 18 / 4)


if __name__ == "__main__":
    main()
