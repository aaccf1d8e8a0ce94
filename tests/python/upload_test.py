#!/usr/bin/env python3
"""Scene files by way of the Python client become what the command line makes of them. Exit code 77
(skipped) where the shared scenes are not there.

  upload_test.py RAYNESTD RAYNEST FLATC
"""
import hashlib
import json
import pathlib
import tempfile
import types
from unittest import mock

import numpy as np

import raynest
from raynest import _limits
from raynest._requests.gltf import mesh_glb
from raynest._requests.loads import load_of_mesh
from raynest._requests.upload import gather
from daemon import SHARED_SCENES
from with_daemon import WithDaemon, main


class Upload(WithDaemon):
    def test_files_come_with_what_they_name(self):
        if not SHARED_SCENES.is_dir():
            self.skipTest(f"skipped: {SHARED_SCENES} is not there")
        loaded = 0
        for path in sorted(SHARED_SCENES.rglob("small/**/*.gl*")):
            with self.subTest(path=str(path)):
                expected = self.cli.run("--json", "load", path, "--name", "by-cli", "--replace")
                news = []
                scene = self.client.load(path, "by-python", replace=True,
                                         progress=lambda *item: news.append(item))
                self.assertEqual(scene.info["hash"], json.loads(expected.stdout)["hash"])
                self.assertTrue(news)
                loaded += 1
        self.assertGreater(loaded, 2)

    def test_the_name_of_a_file_becomes_one_that_the_daemon_takes(self):
        """Names with other blanks look alike, and are refused."""
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / " two  cars .obj"
            path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
            self.assertEqual(self.client.load(path).name, "two cars")
            with self.assertRaisesRegex(raynest.UsageError, "has a blank at an end"):
                self.client.load(path, "two cars ")

    def stages(self, load):
        """Returns the stages of a load, without those that repeat, and its scene."""
        seen = []
        scene = load(lambda _done, _total, stage: seen.append(stage))
        return list(dict.fromkeys(seen)), scene

    def test_equal_content_is_not_sent_again(self):
        corners = np.random.default_rng(5).uniform(-1, 1, (900, 3))
        faces = np.arange(900).reshape(-1, 3)
        (self.out / "a.glb").write_bytes(mesh_glb(corners, faces))
        (self.out / "b.glb").write_bytes(mesh_glb(corners + 1, faces))
        other = raynest.connect(self.daemon.uri)
        self.addCleanup(other.close)
        for load, again in (
                (lambda told: self.client.mesh(corners, faces, progress=told),
                 lambda told: other.mesh(corners, faces, progress=told)),
                (lambda told: self.client.load(self.out / "a.glb", "first", progress=told),
                 lambda told: other.load(self.out / "a.glb", "second", progress=told))):
            stages, scene = self.stages(load)
            self.assertIn("uploading", stages)
            stages, twin = self.stages(again)
            self.assertEqual(stages, ["loaded"])
            self.assertEqual(twin.info["hash"], scene.info["hash"])
            self.assertEqual(twin.trace([0, 0, 9, 0, 0, -1])["t"], scene.trace([0, 0, 9, 0, 0, -1])["t"])
        # A name that is taken is taken, whether the content is there or not.
        with self.assertRaisesRegex(raynest.Error, "NAME_TAKEN|another scene is called"):
            other.load(self.out / "b.glb", "first")
        # The question includes all that the import depends on.
        for options in ({"build": "high"}, {"masks": {"mesh": 1}}, {"origin": (1, 2, 3)}):
            stages, _ = self.stages(lambda told: other.load(self.out / "a.glb", "third", replace=True,
                                                            progress=told, **options))
            self.assertIn("uploading", stages, options)
        # Nothing is made of it any more once nobody holds it.
        with raynest.connect(self.daemon.uri) as short:
            short.mesh(corners * 3, faces)
        stages, _ = self.stages(lambda told: other.mesh(corners * 3, faces, progress=told))
        self.assertIn("uploading", stages)

    def test_the_digest_of_a_large_mesh_is_that_of_its_file(self):
        """It is begun while the file is written, and again where vertices that no face uses lose what they were."""
        points = np.random.default_rng(7).random((20_000, 3))
        faces = np.random.default_rng(8).integers(0, len(points), (20_000, 3))
        for unused in ([1.0, 2.0, 3.0], [np.nan, np.inf, 0.0]):
            for shift in (None, [1e6, 0, 0]):
                load = load_of_mesh(np.vstack([points, unused]), faces, "mesh", origin=shift)
                body = np.concatenate(list(load.read(1)))
                self.assertEqual(hashlib.sha256(body).digest(), load.message["file_digests"][32:])
                self.assertTrue(np.isfinite(body[:12 * len(points) + 12].view("<f4")).all())

    def test_all_files_of_a_scene_have_one_limit(self):
        scene = self.out / "two.gltf"
        scene.write_text('{"buffers": [{"uri": "first.bin"}, {"uri": "second.bin"}]}')
        for name in ("first.bin", "second.bin"):
            (self.out / name).write_bytes(bytes(100))
        size = scene.stat().st_size + 200
        for most in (size, size - 1):
            with mock.patch.object(_limits, "upload_bytes_max", most):
                if most == size:
                    self.assertEqual(len(gather(str(scene), "", "").files), 3)
                else:
                    with self.assertRaisesRegex(raynest.InvalidError, "second.bin: has 100 bytes; at most 99 are taken"):
                        gather(str(scene), "", "")

    def test_a_digest_must_be_that_of_the_bytes(self):
        """Otherwise one client could put its scene in the place of another's."""
        (self.out / "honest.glb").write_bytes(mesh_glb(np.eye(3), [[0, 1, 2]]))
        lie = types.SimpleNamespace(sha256=lambda _data: hashlib.sha256(b"another file"))
        with mock.patch.object(raynest._requests.upload, "hashlib", lie):
            with self.assertRaisesRegex(raynest.Error, "'honest.glb' was damaged on its way"):
                self.client.load(self.out / "honest.glb")


if __name__ == "__main__":
    main()
