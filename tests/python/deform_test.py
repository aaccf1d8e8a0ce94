#!/usr/bin/env python3
"""Edits that move the vertices of meshes, with and without normals.

  deform_test.py RAYNESTD RAYNEST FLATC
"""
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np

import raynest
from raynest import _limits
from edits_test import box
from with_daemon import WithDaemon, main


def grid(n):
    """The unit square by n x n vertices: their x, their z, and faces."""
    x, z = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij"))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return x, z, np.concatenate([np.stack([corner, corner + 1, corner + n], 1),
                                 np.stack([corner + 1, corner + n + 1, corner + n], 1)])


def write_ply(file, points, normals, faces):
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *(f"property float {name}" for name in (
        "x", "y", "z", "nx", "ny", "nz")), f"element face {len(faces)}", "property list uchar int vertex_indices",
            "end_header"]
    rows = [" ".join(map(repr, map(float, (*point, *normal)))) for point, normal in zip(points, normals)]
    file.write_text("\n".join((*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces), "")))


class Deform(WithDaemon):
    def test_a_mesh_deforms_by_the_path_of_its_hits_however_it_came(self):
        points, faces = np.float32([[0, 0, 0], [1, 0, 0], [0, 0, 1]]), [[0, 2, 1]]
        red = raynest.Material("red", (1, 0, 0))
        sole = self.client.mesh(points, faces, name="sole")
        self.client.mesh(points, faces, name="red", material=red)
        with tempfile.TemporaryDirectory() as folder:
            for ending in ("glb", "npz"):
                file = Path(folder) / f"file.{ending}"
                if ending == "glb":
                    sole.export(file)
                else:
                    np.savez(file, vertices=points, faces=np.array(faces))
                self.client.load(file, name=ending)
        scene = self.client.scene_of(
            {"sheet": (points, faces), "red": raynest.Mesh(points, faces, red), "group": {"a": ("sheet", (0, -1, 0)), "b": "red"}},
            {"sheet": "sheet", "red": ("red", (2, 0, 0)), "group": ("group", (4, 0, 0))})
        with scene.edit() as edit:
            for number, name in enumerate(("sole", "red", "glb", "npz")):
                edit.add(name, (6 + 2 * number, 0, 0), f"added-{name}")
        rays = [(2 * i + 0.2, 9, 0.2, 0, -1, 0) for i in range(7)]
        paths = scene.path_of(scene.trace(rays, fields=("path",))["path"])
        for path, ray in zip(paths, rays):
            with scene.edit() as edit:
                edit.set_vertices(path, points + np.float32([0, 3, 0]))
            self.assertEqual((edit.instances, scene.trace([ray], fields=("t",))["t"].tolist()), (1, [6]), path)
        with self.assertRaisesRegex(raynest.UsageError, "has no triangles of its own"), scene.edit() as edit:
            edit.set_vertices("group", points)

    def test_meshes_deform_where_they_are_named(self):
        n = 40
        x, z, faces = grid(n)
        sheet = lambda height: np.stack([x, height, z], 1)
        wave = sheet(0.2 * np.sin(9 * x) + 0.1 * z)
        flat = self.client.scene_of({"sheet": (sheet(0 * x), faces)}, {"sheet": ("sheet", [(0, 0, 0), (2, 0, 0)])},
                                    name="flat")
        bent = self.client.scene_of({"sheet": (sheet(0 * x), faces), "wave": (wave, faces)},
                                    {"flat": "sheet", "bent": ("wave", (2, 0, 0))}, name="bent")
        rays = np.zeros((3000, 6))
        rays[:, :3] = np.random.default_rng(5).uniform((-0.2, 3, -0.2), (3.2, 3, 1.2), (3000, 3))
        rays[:, 3:] = np.random.default_rng(6).normal((0, -1, 0), 0.2, (3000, 3))
        fields = ("t", "prim", "uv", "ng", "position")
        with flat.edit() as edit:
            edit.set_vertices("sheet#1", wave)
        self.assertEqual(edit.instances, 1)
        self.same(dict(flat.trace(rays, fields=fields)), dict(bent.trace(rays, fields=fields)))
        self.same(dict(flat.trace(rays, fields=("prim",), kind="all", max_hits=4)),
                  dict(bent.trace(rays, fields=("prim",), kind="all", max_hits=4)))
        # Both of them at once stay one mesh; and back to where they were.
        size = flat.info["bytes"]
        with flat.edit() as edit:
            edit.set_vertices("sheet#*", sheet(0 * x))
        self.assertLessEqual(flat.info["bytes"], size)
        self.assertEqual(flat.trace([[0.5, 1, 0.5, 0, -1, 0], [2.5, 1, 0.5, 0, -1, 0]], fields=("t",))["t"].tolist(),
                         [1, 1])
        self.assertEqual(flat.info["epoch"], 3)
        for change, words in (
                (lambda edit: edit.set_vertices("sheet#0", wave[:-1]), f"'sheet#0' has {n * n} vertices, "),
                (lambda edit: edit.set_vertices("sheet#0", np.full((n * n, 3), np.nan)), "vertex 0 of 'sheet#0'"),
                (lambda edit: edit.set_vertices("sheet#0", wave * 1e16), "beyond 1e15"),
                (lambda edit: edit.set_vertices("sheet#0", wave[0]), "shape")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words):
                with flat.edit() as edit:
                    edit.hide("sheet#1")
                    change(edit)
        self.assertEqual(flat.info["epoch"], 3)

    def test_a_mesh_deforms_with_normals_as_if_it_had_been_loaded_so(self):
        n = 12
        chance = np.random.default_rng(8)
        x, z, faces = grid(n)
        still = np.stack([x, 0 * x, z], 1)
        wave = np.stack([x, 0.2 * np.sin(9 * x), z], 1).astype("f4")
        normals = chance.normal((0, 3, 0), 1, wave.shape).astype("f4")
        rays = np.zeros((2000, 6))
        rays[:, :3] = chance.uniform((0, 3, 0), (1, 3, 1), (2000, 3))
        rays[:, 4] = -1
        fields = ("t", "prim", "uv", "ng", "normal")

        def scene(name, points, directions):
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "sheet.ply"
                write_ply(file, points, directions, faces)
                self.client.load(str(file), name + "-sheet", replace=True)
            made = self.client.scene_of({"ground": box(400, 0.1, 40)}, {"ground": ("ground", (0, -5, 0))}, name=name)
            made.add(name + "-sheet", name="sheet")
            return made

        deformed, fresh = scene("deformed", still, np.full_like(wave, (0, 1, 0))), scene("fresh", wave, normals)
        with deformed.edit() as edit:
            edit.set_vertices("sheet", wave, normals=normals)
        theirs = dict(fresh.trace(rays, fields=fields))
        self.same(dict(deformed.trace(rays, fields=fields)), theirs)
        self.assertGreater(np.abs(theirs["normal"] - theirs["ng"]).max(), 0.1)
        with mock.patch.object(_limits, "edit_vertices_max", 2 * len(wave) - 1), \
                self.assertRaisesRegex(raynest.UsageError, f"{2 * len(wave)} vertices in one edit"), deformed.edit() as edit:
            edit.set_vertices("sheet", wave).set_vertices("sheet", wave)
        # Without normals they are made of the triangles, and differ from these.
        with deformed.edit() as edit:
            edit.set_vertices("sheet", wave)
        made = deformed.trace(rays, fields=fields)
        self.assertLess(np.abs(made["normal"] - made["ng"]).max(), np.abs(theirs["normal"] - theirs["ng"]).max())
        for points, given, words in (
                (wave, normals[:-1], f"{n * n - 1} normals for {n * n} vertices: give one for each"),
                (wave, normals.ravel(), r"normals has shape \(432,\): it must be \(N, 3\)"),
                (wave, np.where(np.arange(n * n)[:, None] == 7, np.inf, normals), "that of vertex 7 is not"),
                (wave[1:], normals[1:], f"'sheet' has {n * n} vertices, {n * n - 1} are given")):
            with self.subTest(words=words), self.assertRaisesRegex(raynest.UsageError, words) as caught:
                with deformed.edit() as edit:
                    edit.set_vertices("sheet", points, given)
            self.assertNotIn("\n", str(caught.exception))
        corners = box(400, 0.1, 40)[0]
        with self.assertRaisesRegex(raynest.UsageError, "gives normals to a mesh that has none"):
            with deformed.edit() as edit:
                edit.set_vertices("ground", corners, corners)
        self.assertEqual(deformed.info["epoch"], 4)


if __name__ == "__main__":
    main()
