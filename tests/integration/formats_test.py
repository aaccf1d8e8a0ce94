#!/usr/bin/env python3
"""Tests files of other formats than glTF, written and read here by NumPy alone: counts, bounds and
hits of each against NumPy's own; and hostile files.

  formats_test.py RAYNESTD RAYNEST
"""
import io
import json
import pathlib
import struct
import subprocess
import sys
import warnings
import zipfile
import zlib

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "client/python"))

import raynest
from daemon import main
from with_files import WithFiles

NONE = 0xFFFFFFFF
RANDOM = np.random.default_rng(41)


def hills(side=24):
    """A wavy mesh with no two vertices alike: vertices (N, 3), faces (M, 3)."""
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    height = np.sin(i * 0.7) + np.cos(j * 0.9) + RANDOM.uniform(-0.2, 0.2, i.shape)
    vertices = np.stack([i + RANDOM.uniform(-0.2, 0.2, i.shape), j + RANDOM.uniform(-0.2, 0.2, i.shape), height], -1)
    a = (i * side + j)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([a, a + side, a + 1], 1), np.stack([a + 1, a + side, a + side + 1], 1)])
    return vertices.reshape(-1, 3).astype(np.float32).astype(np.float64), faces.astype(np.int64)


VERTICES, FACES = hills()


def first_hits(vertices, faces, rays):
    """Möller and Trumbore over all pairs in float64: distances, inf for a miss."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    e1, e2 = b - a, c - a
    nearest = np.full(len(rays), np.inf)
    for number, ray in enumerate(rays):
        p = np.cross(ray[3:], e2)
        det = (e1 * p).sum(1)
        s = ray[:3] - a
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (s * p).sum(1) / det
            q = np.cross(s, e1)
            v = (ray[3:] * q).sum(1) / det
            t = (e2 * q).sum(1) / det
        inside = (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (det != 0)
        if inside.any():
            nearest[number] = t[inside].min()
    return nearest


def rays_at(vertices, count=200):
    """Rays from above the box's middle to points within it."""
    low, high = vertices.min(0), vertices.max(0)
    eye = (low + high) / 2 + [0.1, 0.2, 2 * (high - low).max()]
    aim = RANDOM.uniform(low, high, (count, 3))
    return np.hstack([np.broadcast_to(eye, aim.shape), (aim - eye) / np.linalg.norm(aim - eye, axis=1)[:, None]])


# ---- writers ------------------------------------------------------------------------------------

def ply_mesh(kind, vertices=VERTICES, faces=FACES, number="<f4"):
    """`kind`: ascii, binary_little_endian or binary_big_endian."""
    type_name = {"f4": "float", "f8": "double"}[number[1:]]
    head = (f"ply\nformat {kind} 1.0\ncomment a test\nelement vertex {len(vertices)}\n"
            + "".join(f"property {type_name} {axis}\n" for axis in "xyz")
            + f"property uchar red\nproperty uchar green\nproperty uchar blue\nelement face {len(faces)}\n"
            "property list uchar int vertex_indices\nproperty uchar flags\nend_header\n").encode()
    if kind == "ascii":
        return head + "".join([*(f"{x!r} {y!r} {z!r} 9 8 7\n" for x, y, z in vertices.tolist()),
                               *(f"3 {a} {b} {c} 0\n" for a, b, c in faces.tolist())]).encode()
    order = "<" if kind == "binary_little_endian" else ">"
    points = np.zeros(len(vertices), [("p", order + number[1:], 3), ("c", "u1", 3)])
    points["p"] = vertices
    rows = np.zeros(len(faces), [("n", "u1"), ("f", order + "i4", 3), ("o", "u1")])
    rows["n"], rows["f"] = 3, faces
    return head + points.tobytes() + rows.tobytes()


def stl_binary(title=b"solid but binary"):
    facets = np.zeros(len(FACES), [("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")])
    facets["p"] = VERTICES[FACES]
    return title.ljust(80) + struct.pack("<I", len(FACES)) + facets.tobytes()


def stl_ascii():
    lines = ["solid a b"]
    for corners in VERTICES[FACES].tolist():
        lines += ["facet normal 0 0 0", " outer loop", *("  vertex {!r} {!r} {!r}".format(*p) for p in corners),
                  " endloop", "endfacet"]
    return "\n".join([*lines, "endsolid a b", ""]).encode()


def obj(negative=False):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in VERTICES.tolist()]
    half = len(FACES) // 2
    for number, (name, faces) in enumerate((("left", FACES[:half]), ("right", FACES[half:]))):
        lines.append(f"o {name}")
        rows = faces - len(VERTICES) if negative else faces + 1
        lines += [f"f {a} {b} {c}" for a, b, c in rows.tolist()]
    return "\n".join(lines).encode()


def off(colours=False):
    tail = " 255 0 0 255" if colours else ""
    return "\n".join([("C" if colours else "") + "OFF # a comment", f"{len(VERTICES)} {len(FACES)} 0",
                      *(f"{x!r} {y!r} {z!r}{tail}" for x, y, z in VERTICES.tolist()), "",
                      *(f"3 {a} {b} {c} 0.5 0.5 0.5" for a, b, c in FACES.tolist())]).encode()


def npz(compressed=False, **arrays):
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return file.getvalue()


def las(points, minor=2, scale=0.001, offset=(0, 0, 0), more=0):
    """Format 0 of LAS 1.2, or format 6 of 1.4."""
    head = bytearray(375 if minor == 4 else 227)
    head[:4] = b"LASF"
    head[24:26] = bytes([1, minor])
    size, kind = (30, 6) if minor == 4 else (20, 0)
    struct.pack_into("<HIIBHI", head, 94, len(head), len(head), 0, kind, size, 0 if minor == 4 else len(points) + more)
    struct.pack_into("<6d", head, 131, scale, scale, scale, *offset)
    if minor == 4:
        struct.pack_into("<Q", head, 247, len(points) + more)
    rows = np.zeros(len(points), [("p", "<i4", 3), ("rest", "u1", size - 12)])
    with np.errstate(all="ignore"):
        rows["p"] = np.round((points - offset) / scale)
    return bytes(head) + rows.tobytes()


# Windows programs write it before UTF-8.
MARK = b"\xef\xbb\xbf"

MESHES = {
    "ascii.ply": ply_mesh("ascii"), "little.ply": ply_mesh("binary_little_endian"),
    "big.ply": ply_mesh("binary_big_endian"), "double.ply": ply_mesh("binary_little_endian", number="<f8"),
    "WINDOWS.PLY": ply_mesh("ascii").replace(b"\n", b"\r\n"),
    "binary.stl": stl_binary(), "plain.stl": stl_binary(b"exported"), "ascii.stl": stl_ascii(),
    "windows.stl": stl_ascii().replace(b"\n", b"\r\n"), "upper.STL": stl_binary(),
    "plain.obj": obj(), "negative.obj": obj(negative=True), "windows.obj": obj().replace(b"\n", b"\r\n"),
    "slashes.obj": obj().replace(b"\no ", b"\nvn 0 0 1\no ").replace(b"f ", b"f  ") + b"\n# end",
    "joined.obj": obj().replace(b"f ", b"f \\\n"),
    "plain.off": off(), "colours.off": off(colours=True), "windows.off": off().replace(b"\n", b"\r\n"),
    "plain.npz": npz(vertices=VERTICES, faces=FACES),
    "loud.stl": stl_ascii().upper().replace(b"NORMAL 0 0 0", b"NORMAL -1.#IND 1.#QNAN -NAN(IND)"),
    "marked.stl": MARK + stl_ascii(), "marked.off": MARK + off(), "marked.ply": MARK + ply_mesh("ascii"),
    "marked.obj": MARK + obj(),
    "packed.npz": npz(compressed=True, vertices=VERTICES.astype(np.float32), faces=FACES.astype(np.uint16)),
    "short.npz": npz(v=np.asfortranarray(VERTICES), f=FACES.astype(np.int32)),
}


class Formats(WithFiles):
    def refusal(self, name, data, *options):
        """Returns the message that the command line gives; it has one line."""
        done = self.client.run("load", self.write(name, data), *options)
        self.assertNotEqual(done.returncode, 0, name)
        line, = done.stderr.splitlines()
        return line

    def check(self, scene, vertices, faces):
        info = scene.info
        used = vertices[np.unique(faces)]
        self.assertEqual(info["unique_triangles"], len(faces))
        np.testing.assert_allclose(info["box_min"], used.min(0), atol=1e-5)
        np.testing.assert_allclose(info["box_max"], used.max(0), atol=1e-5)
        rays = rays_at(vertices)
        hit = scene.trace(rays, fields=("t", "prim"))
        own = first_hits(vertices, faces, rays)
        self.assertGreater(np.isfinite(own).sum(), 100)
        np.testing.assert_allclose(np.where(hit["prim"] == NONE, np.inf, hit["t"]), own, rtol=2e-5)

    def test_each_format_gives_numpys_mesh(self):
        for name, data in MESHES.items():
            with self.subTest(name):
                self.check(self.load(name, data), VERTICES, FACES)

    def test_the_command_line_and_the_daemons_folder_load_them_too(self):
        for name in ("little.ply", "binary.stl", "plain.obj", "plain.off", "packed.npz"):
            made = self.client.json("load", self.write(name, MESHES[name]), "--name", "cli", "--replace")
            self.assertEqual(made["unique_triangles"], len(FACES), name)
            # A pipe is known by its first bytes.
            with open(self.scenes / name, "rb") as file:
                done = subprocess.run([self.client.program, "load", "-", "--name", "piped", "--replace"], stdin=file,
                                      env=self.client.environment, capture_output=True)
            self.assertEqual(done.returncode, 0, (name, done.stderr))

    def test_objects_of_an_obj_are_paths(self):
        scene = self.load("named.obj", obj())
        rays = rays_at(VERTICES)
        paths = {path.split("/")[0] for path in scene.path_of(scene.trace(rays, fields=("path",))["path"]) if path}
        self.assertEqual(paths, {"left", "right"})
        masked = self.load("named.obj", obj(), masks={"left": 0x2})
        hit = masked.trace(rays, mask=0x1, fields=("path",))["path"]
        self.assertEqual({path for path in masked.path_of(hit) if path}, {"right"})

    def test_names_that_are_no_utf_8(self):
        scene = self.load("odd.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib b\xe4um\x01.mtl\nusemtl b\xe4um\no B\xe4um/\x07\nf 1 2 3\n"
                          b"o two\nf 1 2 3\n")
        path = scene.path_of(scene.trace([[0.2, 0.2, 1, 0, 0, -1]], fields=("path",))["path"])[0]
        self.assertRegex(path, "B.um")
        self.assertEqual(len(scene.materials), 1)
        self.assertEqual(self.client.json("info", "odd")["unique_triangles"], 2)

    def test_polygons_of_any_size(self):
        # A star with five tips, which a fan from its first corner would not cover.
        turn = np.arange(10) * np.pi / 5
        star = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * np.where(np.arange(10) % 2, 0.3, 1)[:, None]
        star = np.roll(star, -1, 0)
        body = "".join("v {!r} {!r} {!r}\n".format(*p) for p in star.tolist())
        scenes = [self.load("star.obj", body + "f " + " ".join(str(i + 1) for i in range(10))),
                  self.load("turned.obj", body + "f " + " ".join(str(10 - i) for i in range(10))),
                  self.load("star.off", "OFF\n10 1 0\n" + body.replace("v ", "") + "10 " + " ".join(map(str, range(10)))),
                  self.load("star.ply", "ply\nformat ascii 1.0\nelement vertex 10\nproperty float x\nproperty float y\n"
                            "property float z\nelement face 1\nproperty list int uint vertex_index\nend_header\n"
                            + body.replace("v ", "") + "10 " + " ".join(map(str, range(10))))]
        aim = RANDOM.uniform(-1, 1, (2000, 2))
        following = np.roll(star, -1, 0)
        crosses = ((star[:, 1] > aim[:, 1:]) != (following[:, 1] > aim[:, 1:])) & (
            aim[:, :1] < (following[:, 0] - star[:, 0]) * (aim[:, 1:] - star[:, 1])
            / (following[:, 1] - star[:, 1]) + star[:, 0])
        inside = crosses.sum(1) % 2 == 1
        rays = np.hstack([aim, np.ones((2000, 1)), np.broadcast_to([0, 0, -1], (2000, 3))])
        for scene in scenes:
            self.assertEqual(scene.info["unique_triangles"], 8)
            np.testing.assert_array_equal(scene.trace(rays, fields=("prim",))["prim"] != NONE, inside)

    def test_a_polygon_of_many_corners_that_is_not_convex(self):
        # A gear: 1500 corners on two radii, so that a fan would cover what lies between its teeth.
        turn = np.arange(1500) * 2 * np.pi / 1500
        gear = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * np.where(np.arange(1500) % 2, 0.5, 1)[:, None]
        scene = self.load("gear.obj", "".join("v {!r} {!r} {!r}\n".format(*p) for p in gear.tolist())
                          + "f " + " ".join(str(i + 1) for i in range(1500)))
        between = (np.arange(1, 1500, 2)) * 2 * np.pi / 1500
        for radius, is_hit in ((0.49, True), (0.51, False), (0.99, False)):
            rays = np.zeros((750, 6))
            rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 5] = radius * np.cos(between), radius * np.sin(between), 1, -1
            hit = scene.trace(rays, fields=("prim",))["prim"] != NONE
            self.assertEqual(hit.mean(), float(is_hit), radius)

    def test_time_grows_with_the_file(self):
        """Each of these took minutes: a position with many texture coordinates, an MTL named again and again."""
        corner = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
        count = 60_000
        chain = self.load("chain.obj", corner + "".join(f"vt {i} 0\n" for i in range(count))
                          + "".join(f"f 1/{i} 2/{i} 3/{i}\n" for i in range(1, count + 1)))
        self.assertEqual(chain.info["unique_triangles"], count)
        self.write("many.mtl", "".join(f"newmtl m{i}\nKd 1 0 0\n" for i in range(20_000)))
        many = self.load("many.obj", "mtllib many.mtl\n" * 3000 + corner + "usemtl m7\nf 1 2 3\n")
        self.assertEqual(many.info["unique_triangles"], 1)

    def test_points_are_spheres(self):
        points = RANDOM.uniform(-5, 5, (300, 3)).astype(np.float32).astype(np.float64)
        radii = RANDOM.uniform(0.1, 0.4, 300).astype(np.float32)
        head = "ply\nformat binary_little_endian 1.0\nelement vertex 300\n" + "".join(
            f"property float {name}\n" for name in ("x", "y", "z", "radius")) + "end_header\n"
        cloud = self.load("cloud.ply", head.encode() + np.hstack([points, radii[:, None]]).astype("<f4").tobytes())
        fixed = self.load("fixed.ply", head.replace("radius", "reflectance").encode()
                          + np.hstack([points, radii[:, None]]).astype("<f4").tobytes(), radius=0.25)
        survey = self.load("survey.las", las(np.round(points, 3)), radius=0.25)
        newer = self.load("newer.las", las(np.round(points, 3), minor=4), radius=0.25)
        older = bytearray(las(np.round(points, 3), minor=4))  # with the count of LAS 1.3 alone
        struct.pack_into("<I", older, 107, len(points))
        struct.pack_into("<Q", older, 247, 0)
        older = self.load("older.las", bytes(older), radius=0.25)
        rays = rays_at(points)
        for scene, centres, radius in ((cloud, points, radii), (fixed, points, 0.25),
                                       (survey, np.round(points, 3), 0.25), (newer, np.round(points, 3), 0.25),
                                       (older, np.round(points, 3), 0.25)):
            off_centre = rays[:, None, :3] - centres
            b = (off_centre * rays[:, None, 3:]).sum(2)
            root = b * b - (off_centre ** 2).sum(2) + np.asarray(radius, np.float64) ** 2
            with np.errstate(invalid="ignore"):
                own = np.nanmin(np.where(root > 0, -b - np.sqrt(root), np.inf), axis=1)
            hit = scene.trace(rays, fields=("t", "prim"))
            found = np.where(hit["prim"] == NONE, np.inf, hit["t"])
            self.assertGreater(np.isfinite(own).sum(), 20)
            # A ray may graze a sphere either way.
            self.assertLess((~np.isclose(found, own, rtol=1e-4)).sum(), 2)
        self.assertIn("--radius", self.refusal("survey.las", las(points)))

    def test_points_have_colours(self):
        points = np.array([[3.0 * i, 0, 0] for i in range(6)])
        colours = np.array([[255, 0, 0], [0, 255, 0], [10, 20, 200], [128, 128, 128], [0, 0, 0], [1, 2, 3]])
        points[2] = np.nan  # left out, with its colour
        head = "ply\nformat ascii 1.0\nelement vertex 6\n" + "".join(
            f"property {kind}\n" for kind in ("float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"))
        rows = "".join("{} {} {} {} {} {}\n".format(*p, *c) for p, c in zip(points, colours))
        there = np.flatnonzero(np.isfinite(points[:, 0]))
        linear = np.where(colours <= 10, colours / 255 / 12.92, ((colours / 255 + 0.055) / 1.055) ** 2.4)
        rays = np.hstack([points[there] + [0, 0, 9], np.broadcast_to([0, 0, -1], (len(there), 3))])

        def las_of(colours, kind=2, size=26, place=20):
            file = bytearray(las(points[there]))
            rows = np.zeros((len(there), size), "u1")
            rows[:, :20] = np.frombuffer(file[227:], "u1").reshape(-1, 20)
            rows[:, place:place + 6] = colours[there].astype("<u2").view("u1").reshape(-1, 6)
            file[104] = kind
            struct.pack_into("<H", file, 105, size)
            return bytes(file[:227]) + rows.tobytes()

        for name, data, told in (("colours.ply", head + "end_header\n" + rows, ["left out"]),
                                 ("colours.las", las_of(colours * 257), []),
                                 ("format3.las", las_of(colours * 257, 3, 34, 28), []),
                                 ("short.las", las_of(colours), ["taken to have 8 bits"])):
            with self.subTest(name), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                scene = self.load(name, data, radius=1)
                said = [str(warning.message) for warning in caught]
                self.assertEqual(len(said), len(told), said)
                self.assertTrue(all(text in words for text, words in zip(told, said)), said)
                np.testing.assert_allclose(scene.trace(rays, fields=("base_colour",))["base_colour"], linear[there], atol=1e-6)
                # The same in pictures, lit ones too, and where the cloud is placed by a composition or added.
                view = {"look_at": [[6, 0, 20], [6, 0, 0]], "size": (201, 41), "fov": 10.0, "encode": "raw"}
                plain = np.asarray(scene.render(**view), int)
                self.assertEqual(plain[20, 15:185, :3].max(0).tolist() > [100, 100, 60], True)
                lit = np.asarray(scene.render(integrator="direct", spp=4, **view), int)
                self.assertGreater((lit[..., 0] - lit[..., 1]).max(), 60)
                self.assertGreater((lit[..., 1] - lit[..., 0]).max(), 60)
        self.write("town.rnscene.json", json.dumps({
            "rnscene": 1, "objects": {"a": {"file": "colours.las", "radius": 1}, "b": {"file": "short.las", "radius": 1}},
            "instances": [{"object": "b", "translation": [0, 0, -50]}, {"object": "a"}]}))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            town = self.python.load(self.scenes / "town.rnscene.json")
        np.testing.assert_allclose(town.trace(rays, fields=("base_colour",))["base_colour"], linear[there], atol=1e-6)
        black = self.load("black.las", las_of(0 * colours), radius=1)
        np.testing.assert_array_equal(black.trace(rays, fields=("base_colour",))["base_colour"], 1)

    def test_colours_of_text_files_go_to_1_or_to_255_in_the_whole_file(self):
        # The first triangle is dark: alone it would look like one of shades up to 1.
        points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]]
        for colours in ([[1, 1, 0]] * 3 + [[200, 100, 50]] * 3, [[1, 0.5, 0]] * 3 + [[1.01, 0.2, 0]] * 3):
            rows = [" ".join(map(str, [*point, *colour])) for point, colour in zip(points, colours)]
            share = np.minimum(np.round(np.array(colours) * (1 if np.max(colours) > 2 else 255)), 255) / 255
            linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
            for name, text in (("shades.obj", "".join(f"v {row}\n" for row in rows) + "f 1 2 3\nf 4 5 6\n"),
                               ("shades.off", "COFF\n6 2 0\n" + "\n".join(rows) + "\n3 0 1 2\n3 3 4 5\n")):
                hit = self.load(name, text).trace([[0.2, 0.2, 1, 0, 0, -1], [5.2, 0.2, 1, 0, 0, -1]], fields=("base_colour",))
                np.testing.assert_allclose(hit["base_colour"][:, :3], linear[[0, 3]], atol=2e-3, err_msg=name)

    def test_heights(self):
        heights = RANDOM.uniform(0, 3, (9, 12))
        heights[4, 4] = np.nan
        np.save(self.scenes / "grid.npy", heights)
        with self.assertWarnsRegex(raynest.SceneWarning, "holes"):
            scene = self.python.load(self.scenes / "grid.npy", primitive="heights", spacing=2, unit="ft")
        self.assertEqual(scene.info["unique_triangles"], 2 * (8 * 11 - 4))
        # Down onto a vertex, into the hole, and onto the diagonal of a cell, which joins (3, 3) and (4, 2).
        down = np.array([[18.0002, 99, 6.0002, 0, -1, 0], [8.2, 99, 8.2, 0, -1, 0], [5, 99, 7.001, 0, -1, 0]])
        hit = scene.trace(down * ([0.3048] * 3 + [1] * 3), fields=("position", "prim"))
        self.assertEqual(hit["prim"][1], NONE)
        self.assertAlmostEqual(hit["position"][0, 1] / 0.3048, heights[3, 9], delta=1e-3)
        self.assertAlmostEqual(hit["position"][2, 1] / 0.3048, (heights[3, 3] + heights[4, 2]) / 2, delta=2e-3)

    def test_materials_and_pictures_of_an_obj(self):
        picture = b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
            for kind, data in ((b"IHDR", struct.pack(">IIBBBBB", 1, 2, 8, 2, 0, 0, 0)),
                               (b"IDAT", zlib.compress(b"\0\xff\0\0\0\0\0\xff")), (b"IEND", b"")))
        text = ("mtllib sub/a b.mtl\nmtllib ../../etc/passwd\nmtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
                "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl red\nf 1/1 2/2 3/3\nusemtl glass\nf 1/1 3/3 4/4\nusemtl none\nf -4 -3 -1\n")
        self.write("sub/a b.mtl", "newmtl red\nKd 1 0.5 0\nmap_Kd -s 1 1 1 -clamp on wood 50%.png\nnewmtl glass\nKd 0.2 0.2 0.9\nd 0.5\n"
                   "map_Kd ../../secret.png\n")
        self.write("sub/wood 50%.png", picture)
        (self.scenes.parent / "secret.png").write_bytes(picture)
        path = self.write("house.obj", text)
        for source in (path, "root:house.obj"):
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                scene = self.python.load(source, "house", replace=True)
            told = " ".join(str(warning.message) for warning in told)
            self.assertEqual(told.count("leaves the scene's folder"), 3, told)
            self.assertIn("no MTL file has the material 'none'", told)
            materials = {material["name"]: material for material in scene.materials}
            self.assertEqual(set(materials), {"red", "glass", "none"}, materials)
            self.assertEqual({name: material["alpha_mode"] for name, material in materials.items()},
                             {"red": "OPAQUE", "glass": "BLEND", "none": "OPAQUE"})
        done = self.client.run("load", path, "--name", "house", "--replace")
        self.assertEqual((done.returncode, done.stdout.count("leaves the scene's folder")), (0, 3), done)

    def test_units_axes_and_origins(self):
        metres = self.load("unit.stl", stl_binary(), unit="mm")
        np.testing.assert_allclose(metres.info["box_max"], VERTICES.max(0) / 1000, rtol=1e-6)
        self.check(self.load("up.obj", obj(), up="z", unit=2), 2 * VERTICES, FACES)
        # UTM: float32 has steps of half a metre there.
        far = VERTICES / 8 + [460_000.125, 5_400_000.25, 100]
        survey = self.load("utm.ply", ply_mesh("ascii", far), origin="auto")
        self.assertGreater(np.abs(survey.origin).max(), 1e5)
        self.check(survey, far, FACES)
        with self.assertWarnsRegex(raynest.SceneWarning, "origin"):
            self.load("lost.ply", ply_mesh("ascii", far))
        made = self.client.json("load", self.scenes / "utm.ply", "--name", "utm2", "--origin", "auto", "--up", "z", "--unit", "ft")
        self.assertLess(abs(made["origin"][1] - 0.3048 * 5_400_003), 2)
        near = self.load("near.ply", ply_mesh("ascii"), origin="auto")
        self.assertEqual(near.origin.tolist(), [0, 0, 0])
        with self.assertRaisesRegex(raynest.Error, "unknown up 'x'"):
            self.load("near.ply", ply_mesh("ascii"), up="x")
        with self.assertRaisesRegex(raynest.Error, "unit"):
            self.python.load("builtin:flake?depth=2", unit="mm")
        with self.assertWarnsRegex(raynest.SceneWarning, "radius= changes nothing: the file has no points"):
            self.load("near.ply", ply_mesh("ascii"), radius=0.5)
        with self.assertRaisesRegex(raynest.Error, "spacing= lies between the heights of a grid: leave it out"):
            self.load("near.ply", ply_mesh("ascii"), spacing=2)
        for options in (("--unit", "km"), ("--up", "x"), ("--radius", "-1"), ("--origin", "auto,1,2")):
            self.assertTrue(self.refusal("near.ply", ply_mesh("ascii"), *options))

    def test_hostile_files(self):
        ply = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n" \
              "property list {} int vertex_indices\nend_header\n"
        point = struct.pack("<3f", 0, 0, 0)
        square = npz(vertices=np.eye(3), faces=np.array([[0, 1, 2]]))
        bomb = io.BytesIO()
        with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
            with archive.open("vertices.npy", "w", force_zip64=True) as member:
                header = io.BytesIO()
                np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (50 << 20, 3)})
                member.write(header.getvalue())
                for _ in range(1200):
                    member.write(bytes(1 << 20))
        at = square.index(b"PK\1\2") + 24
        flipped = bytearray(square)
        flipped[square.index(struct.pack("<d", 1)) + 5] ^= 0x10
        lying = square[:at] + b"\xff\xff\xff\x7f" + square[at + 4:]
        for name, data, words in (
                ("a.ply", "plx\n", "does not begin"), ("b.ply", "ply\nformat ascii 1.0\n", "end_header"),
                ("c.ply", ply.format("ascii", 4 << 30, 0, "uchar"), "cut short"),
                ("d.ply", ply.format("binary_little_endian", (1 << 63) - 1, 0, "uchar"), "cut short"),
                ("e.ply", ply.format("ascii", "9" * 30, 0, "uchar"), "no count"),
                ("f.ply", ply.format("binary_little_endian", 1, 1, "int").encode() + point + struct.pack("<I", 0x7fffffff), "cut short"),
                ("g.ply", ply.format("ascii", 1, 1, "uchar") + "0 0 0\n3 0 0 9\n", "vertex 9 of 1"),
                ("h.ply", ply.format("ascii", 1, 1, "uchar") + "nan 0 0\n3 0 0 0\n", "not finite"),
                ("i.ply", ply.format("ascii", 1, 1, "uchar") + "0 x 0\n", "vertex 0 of 1"),
                ("j.ply", "ply\nformat ascii 1.0\nelement vertex 9000000000\nend_header\n", "cut short"),
                ("k.ply", "ply\n" + "x" * (2 << 20), "PLY header"),
                ("a.stl", b"x" * 80 + struct.pack("<I", 0xffffffff) + bytes(50), "cut short"),
                ("b.stl", b"short", "cut short"), ("c.stl", "solid\nfacet normal 0 0 1\nvertex 1 2\n", "line 3"),
                ("d.stl", "solid\nfacet\nouter loop\nvertex 1 2 3\nendloop\nendfacet\n", "1 vertex"),
                ("e.stl", stl_binary(b"solid")[:-20], "cut short"), ("f.stl", stl_ascii()[:1000], "line"),
                ("g.stl", b"x" * 80 + struct.pack("<I12fH", 1, *[float("inf")] * 12, 0), "not finite"),
                ("a.obj", "v 1 2\n", "line 1"), ("b.obj", "v 0 0 0\nf 1 2 3\n", "line 2"), ("c.obj", "v 0 0 0\nf 1 1 0\n", "from 1"),
                ("d.obj", "v 0 0 0\nf 1 1 99999999999999999999\n", "line 2"), ("e.obj", "v 0 0 0\nf 2/1/1 1 1\n", "vertex 2"),
                ("f.obj", "v 0 0 0\nf -1 -2 -1\n", "vertex -2"), ("g.obj", "v nan 0 0\nf 1 1 1", "not finite"),
                ("h.obj", "x" * (4 << 20), "no triangle"), ("i.obj", "v 1e999 0 0\nf 1 1 1", "not finite"),
                ("j.obj", "v 0 0 0\nf 1 1\n", "no triangle"), ("k.obj", "v 0 0 0\nf 1 1 1x\n", "no corner"),
                ("a.off", "OFF\n99999999999 1 0\n", "cut short"), ("b.off", "OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "from 0 to 0"),
                ("c.off", "OFF\n3 1 0\n0 0 0\n", "cut short"), ("d.off", "OFF BINARY\n", "binary OFF"), ("e.off", "4OFF\n1 1 1\n", "OFF"),
                ("f.off", "OFF\n1 1 0\n0 0 0\n4000000000 0 0", "4000000000"),
                ("a.npz", b"PK\x03\x04", "no whole"), ("b.npz", square[:-30], "no whole"), ("c.npz", npz(x=np.eye(3)), "x.npy"),
                ("d.npz", npz(vertices=np.eye(3), faces=np.array([[0, 1, 3]])), "vertex 3 of 3"),
                ("e.npz", npz(vertices=np.eye(3), faces=np.array([[0, 1, -1]])), "vertex -1 of 3"),
                ("f.npz", npz(vertices=np.eye(4), faces=np.array([[0, 1, 2]])), "(N, 3)"),
                ("g.npz", npz(vertices=np.eye(3), faces=np.eye(3)), "whole numbers"),
                ("h.npz", bomb.getvalue(), "unpacks to over 1024 MiB"), ("i.npz", lying, "limit|longer|MiB|beyond"),
                ("j.npz", bytes(flipped), "checksum"),
                ("a.las", b"LASF" + bytes(100), "cut short"), ("b.las", las(np.eye(3), more=5) , "cut short"),
                ("c.las", las(np.eye(3), minor=4, more=1 << 60), "cut short"),
                ("e.las", las(np.eye(3), scale=0), "scale"), ("f.las", las(np.eye(3), scale=np.nan), "scale"),
                ("g.las", las(np.eye(3), offset=(np.inf, 0, 0)), "scale"),
                ("h.las", las(np.eye(3))[:104] + b"\x0b" + las(np.eye(3))[105:], "format 11"),
                ("i.las", las(np.eye(3))[:104] + b"\x01" + las(np.eye(3))[105:], "too short"),
                ("d.las", las(np.eye(3))[:104] + b"\x83" + las(np.eye(3))[105:], "LAZ"), ("a.laz", b"LASF", "laszip"),
                ("a.ply", b"", "empty")):
            with self.subTest(name + " " + words):
                options = ("--radius", "1") if name.endswith(".las") else ()
                self.assertRegex(self.refusal(name, data, *options), words)
        self.assertTrue(self.daemon.alive())

    def test_a_file_cut_anywhere(self):
        """Each beginning of a small file loads or is refused with a line; nothing ends the daemon."""
        triangle = np.array([[0, 1, 2]])
        for name, data in (("x.ply", ply_mesh("binary_little_endian", np.eye(3), triangle)),
                           ("x.npz", npz(compressed=True, vertices=np.eye(3), faces=triangle)),
                           ("x.las", las(np.eye(3)))):
            for end in range(1, len(data), max(1, len(data) // 25)):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    try:
                        self.load(name, data[:end], radius=1 if name == "x.las" else 0)
                    except raynest.Error as error:
                        self.assertNotIn("ended the import process", str(error), (name, end))


if __name__ == "__main__":
    main()
