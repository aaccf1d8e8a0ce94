#!/usr/bin/env python3
"""raynest.compat.trimesh against Moeller-Trumbore in numpy and on the meshes of trimesh's issues
about rays that slip through edges and vertices.

  trimesh_test.py RAYNESTD RAYNEST FLATC
"""
import collections
import dataclasses
import pickle
import sys
import types
import warnings

import numpy as np

import raynest
from daemon import Daemon, Programs
from raynest.compat.trimesh import RayMeshIntersector
from with_daemon import main


class Mesh:
    """As much of a trimesh.Trimesh as is needed."""

    def __init__(self, vertices, faces):
        self.vertices, self.faces = np.array(vertices, float), np.array(faces)

    def __hash__(self):
        return hash((self.vertices.tobytes(), self.faces.tobytes()))

    @property
    def triangles(self):
        return self.vertices[self.faces]


def box(extent):
    """Twelve triangles around the origin, normals outward."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * extent / 2
    faces = []
    for axis in range(3):
        for side in (0, 1):
            quad = [i for i in range(8) if (i >> (2 - axis)) & 1 == side]
            a, b, c, d = quad[0], quad[1], quad[3], quad[2]
            for face in ((a, b, c), (a, c, d)):
                normal = np.cross(corners[face[1]] - corners[face[0]],
                                  corners[face[2]] - corners[face[0]])
                faces.append(face if normal @ corners[face[0]] > 0 else face[::-1])
    return Mesh(corners, faces)


def subdivided(mesh, edge_max):
    """Each triangle cut in four until no edge is longer; vertices are shared."""
    while True:
        triangles = mesh.triangles
        if np.linalg.norm(triangles - np.roll(triangles, 1, 1), axis=2).max() <= edge_max:
            return mesh
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], 1).reshape(-1, 3)
        vertices, faces = np.unique(corners, axis=0, return_inverse=True)
        mesh = Mesh(vertices, faces.reshape(-1, 3))


def ball(extent=2.0):
    """A subdivided box whose vertices were moved onto a sphere."""
    mesh = subdivided(box(extent), extent / 8)
    mesh.vertices *= extent / 2 / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return mesh


def brute_force(mesh, origins, directions):
    """t of every ray and triangle, inf where they do not meet. In float64."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    e1, e2 = b - a, c - a
    p = np.cross(directions[:, None], e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / (p * e1).sum(2)
        s = origins[:, None] - a
        q = np.cross(s, e1)
        u, v = (s * p).sum(2) * inverse, (directions[:, None] * q).sum(2) * inverse
        t = (e2 * q).sum(2) * inverse
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)


def unit(count, seed=1):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


class Trimesh(Programs):
    @classmethod
    def setUpClass(cls):
        cls.daemon = Daemon(cls.raynestd)
        cls.addClassCleanup(cls.daemon.stop)
        cls.client = cls.enterClassContext(raynest.connect(cls.daemon.uri))

    def rays(self, mesh, **options):
        return RayMeshIntersector(mesh, connection=self.client, **options)

    def some_rays(self, count=1000):
        """From around the ball, most of them through it, no two alike."""
        chance = np.random.default_rng(2)
        origins = 3 * unit(count, 3) * chance.uniform(0, 1, (count, 1))
        return origins, unit(count, 4)

    def test_hits_are_those_of_brute_force(self):
        mesh = ball()
        origins, directions = self.some_rays()
        t = brute_force(mesh, origins, directions)
        first = np.where(np.isfinite(t.min(1)), t.argmin(1), -1)
        rays = self.rays(mesh)
        np.testing.assert_array_equal(rays.intersects_first(origins, 5 * directions), first)
        np.testing.assert_array_equal(rays.intersects_any(origins, directions), first >= 0)

        index_tri, index_ray, locations = rays.intersects_id(origins, directions,
                                                             return_locations=True)
        expected_ray, expected_tri = np.nonzero(np.isfinite(t))
        self.assertEqual(set(zip(index_ray, index_tri)), set(zip(expected_ray, expected_tri)))
        self.assertEqual(len(index_ray), len(expected_ray))
        np.testing.assert_allclose(
            locations, origins[index_ray] + t[index_ray, index_tri, None] * directions[index_ray],
            atol=1e-9)
        along = ((locations - origins[index_ray]) * directions[index_ray]).sum(1)
        same = index_ray[1:] == index_ray[:-1]
        self.assertTrue((along[1:] >= along[:-1])[same].all())

        only, ray = rays.intersects_id(origins, directions, multiple_hits=False)
        np.testing.assert_array_equal(ray, np.flatnonzero(first >= 0))
        np.testing.assert_array_equal(only, first[ray])
        where, ray, tri = rays.intersects_location(origins, directions, multiple_hits=False)
        np.testing.assert_array_equal(tri, only)
        np.testing.assert_allclose(np.linalg.norm(where, axis=1), 1, atol=0.02)

    def test_max_hits_bounds_each_ray(self):
        mesh = ball()
        origins, directions = self.some_rays()
        rays = self.rays(mesh)
        every = np.bincount(rays.intersects_id(origins, directions)[1], minlength=len(origins))
        one = np.bincount(rays.intersects_id(origins, directions, max_hits=1)[1],
                          minlength=len(origins))
        self.assertEqual(every.max(), 2)
        np.testing.assert_array_equal(one, np.minimum(every, 1))

    def test_shapes_and_types_of_nothing(self):
        rays = self.rays(box(2))
        for n in (0, 3):
            up, away = np.tile([9.0, 9, 9], (n, 1)), np.tile([1.0, 0, 0], (n, 1))
            tri, ray, where = rays.intersects_id(up, away, return_locations=True)
            self.assertEqual((tri.shape, ray.shape, where.shape), ((0,), (0,), (0, 3)))
            self.assertEqual((tri.dtype.kind, ray.dtype.kind), ("i", "i"))
            self.assertEqual(rays.intersects_first(up, away).tolist(), [-1] * n)
            any_hit = rays.intersects_any(up, away)
            self.assertEqual((any_hit.dtype, any_hit.tolist()), (bool, [False] * n))
            self.assertEqual(rays.contains_points(up).tolist(), [False] * n)
        with self.assertRaises(ValueError):
            rays.intersects_any(np.zeros((2, 3)), np.zeros((3, 3)))
        with self.assertRaises(ValueError):
            rays.contains_points([1, 2, 3])

    def test_what_is_masked_hits_nothing(self):
        mesh = box(1)
        with RayMeshIntersector(mesh, connection=self.client) as rays, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            masked = np.ma.masked_array(np.zeros((2, 3)), [[True] * 3, [False] * 3])
            self.assertEqual(rays.intersects_any(masked, [[0, 0, 1]] * 2).tolist(), [False, True])
            self.assertEqual(rays.contains_points(masked).tolist(), [False, True])

    def test_no_ray_slips_through_edges_and_vertices(self):
        """From the middle to each vertex of a box: all of them meet vertices and edges of the one
        within. trimesh issue #1496."""
        missed = asked = 0
        for inner, outer, edge in ((40, 60, 20), (40, 60, 5), (1, 3, 0.1), (1e-3, 1, 1e-4)):
            small, big = subdivided(box(inner), edge), subdivided(box(outer), edge * outer / inner)
            edges = (small.triangles + np.roll(small.triangles, 1, 1)).reshape(-1, 3)
            targets = np.concatenate([big.vertices, small.vertices, small.triangles.mean(1), edges])
            origins = np.zeros_like(targets)
            for scaled in (True, False):
                rays = self.rays(small, scale_to_box=scaled)
                hit = rays.intersects_any(origins, targets)
                np.testing.assert_array_equal(rays.intersects_first(origins, targets) >= 0, hit)
                for options in ({"multiple_hits": False}, {}):
                    _, index_ray = rays.intersects_id(origins, targets, **options)
                    # A ray out of a convex body crosses it once, be it through a vertex.
                    np.testing.assert_array_equal(index_ray, np.flatnonzero(hit))
                missed += np.count_nonzero(~hit)
                asked += 4 * len(hit)
        self.assertEqual(missed, 0)
        print(f"#1496: {missed} of {asked:,} rays to vertices, edges and middles missed",
              file=sys.stderr)

    def test_a_sphere_of_rays_loses_none(self):
        """1024 x 512 rays from within: trimesh issue #1180 found 524,287 hits."""
        longitude, latitude = np.meshgrid(np.linspace(0, 2 * np.pi, 1024),
                                          np.linspace(-np.pi / 2, np.pi / 2, 512))
        directions = np.stack([np.cos(latitude) * np.cos(longitude), np.sin(latitude),
                               np.cos(latitude) * np.sin(longitude)], -1).reshape(-1, 3)
        for name, mesh in (("box", subdivided(box(2), 0.1)), ("ball", ball())):
            for origin in ([0, 0, 0], [0.3, -0.2, 0.1]):
                locations, _, _ = self.rays(mesh).intersects_location(
                    np.tile(np.array(origin, float), (len(directions), 1)), directions,
                    multiple_hits=False)
                self.assertEqual(len(locations), 524288, (name, origin))
        print("#1180: 524,288 of 524,288 rays hit, each of 4 times", file=sys.stderr)

    def test_points_are_within_or_without(self):
        points = np.random.default_rng(6).uniform(-1.4, 1.4, (4000, 3))
        radius = np.linalg.norm(points, axis=1)
        clear = (radius < 0.95) | (radius > 1)
        np.testing.assert_array_equal(self.rays(ball()).contains_points(points)[clear],
                                      (radius < 1)[clear])
        # A shell: a ball with a smaller one of the other orientation within.
        outer, inner = ball(2), ball(1)
        shell = Mesh(np.concatenate([outer.vertices, inner.vertices]),
                     np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)]))
        clear &= (radius < 0.47) | (radius > 0.5)
        np.testing.assert_array_equal(self.rays(shell).contains_points(points)[clear],
                                      ((radius < 1) & (radius > 0.5))[clear])

    def test_points_of_a_grid_align_with_vertices(self):
        grid = np.stack(np.meshgrid(*[np.linspace(-1.25, 1.25, 11)] * 3), -1).reshape(-1, 3)
        inside = (np.abs(grid) < 0.999).all(1)
        surface = np.isclose(np.abs(grid).max(1), 1)
        np.testing.assert_array_equal(
            self.rays(subdivided(box(2), 0.25)).contains_points(grid)[~surface], inside[~surface])

    def test_many_crossings_through_edges_do_not_use_up_the_budget(self):
        """Twenty squares in a row, hit where their two triangles meet: 40 hits, 20 crossings."""
        square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        vertices = np.concatenate([square + [0, 0, z] for z in range(20)])
        faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(20)])
        rays = self.rays(Mesh(vertices, faces))
        where, _, _ = rays.intersects_location([[0.0, 0, -5]], [[0.0, 0, 1]])
        np.testing.assert_allclose(where[:, 2], np.arange(20), atol=1e-9)
        tri, _ = rays.intersects_id([[0.0, 0, -5]], [[0.0, 0, 1]], max_hits=7)
        self.assertEqual((tri // 2).tolist(), list(range(7)))

    def test_vertices_that_no_face_uses_are_nowhere(self):
        cube = box(2)
        stray = self.rays(Mesh(np.vstack([cube.vertices, [[1e9, 0, 0]]]), cube.faces))
        self.assertEqual(stray.contains_points([[0.0, 0, 0], [3, 0, 0]]).tolist(), [True, False])

    def layers(self, count):
        """Triangles one above the other, at z = 0, 1, ..."""
        corners = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
        vertices = corners + np.arange(count)[:, None, None] * [0, 0, 1]
        return self.rays(Mesh(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)))

    def test_crossings_are_as_many_as_asked_for_or_an_error(self):
        rays, up = self.layers(600), ([[0.0, 0, -5]], [[0.0, 0, 1]])
        for asked in (2, 256, 257, 600, 1000, 10**6):
            tri, _ = rays.intersects_id(*up, max_hits=asked)
            self.assertEqual(tri.tolist(), list(range(min(asked, 600))))
        self.assertEqual(len(rays.intersects_location(*up)[0]), 20)
        many = self.layers(65537)
        self.assertEqual(len(many.intersects_id(*up, max_hits=65536)[0]), 65536)
        with self.assertRaisesRegex(raynest.InvalidError, "ray 0 has more than 65536 hits"):
            many.intersects_id(*up, max_hits=65537)
        self.assertEqual(many.intersects_first(*up).tolist(), [0])

    def test_points_within_hundreds_of_nested_boxes(self):
        for count in (255, 256, 257, 400):
            boxes = [box(2 + 0.02 * i) for i in range(count)]
            nested = Mesh(np.concatenate([each.vertices for each in boxes]),
                          np.concatenate([each.faces + 8 * i for i, each in enumerate(boxes)]))
            self.assertEqual(self.rays(nested).contains_points([[0, 0, 0.1], [9, 9, 9]]).tolist(),
                             [count % 2 == 1, False], count)

    def test_far_away_and_tiny_meshes_are_as_good(self):
        for scale, shift in ((1e-6, 0), (1e6, 0), (1, 1e6), (1e-3, 1e3)):
            mesh = ball()
            mesh.vertices = mesh.vertices * scale + shift
            origins, directions = self.some_rays(300)
            origins = origins * scale + shift
            t = brute_force(mesh, origins, directions)
            np.testing.assert_array_equal(self.rays(mesh).intersects_any(origins, directions),
                                          np.isfinite(t).any(1), (scale, shift))

    def test_a_changed_mesh_is_uploaded_again(self):
        mesh = box(2)
        rays = self.rays(mesh)
        ray = [[0, 0, 5.0]], [[0, 0, -1.0]]
        self.assertEqual(rays.intersects_location(*ray)[0][0].tolist(), [0, 0, 1])
        mesh.vertices *= 2
        self.assertEqual(rays.intersects_location(*ray)[0][0].tolist(), [0, 0, 2])
        # Without a hash, or with that of being itself, the contents tell.
        for kind in (types.SimpleNamespace, type("Plain", (), {})):
            plain = kind()
            plain.vertices, plain.faces = box(2).vertices, box(2).faces
            others = self.rays(plain)
            self.assertTrue(others.intersects_any(*ray)[0])
            plain.vertices += [10, 0, 0]
            self.assertFalse(others.intersects_any(*ray)[0])
            plain.vertices -= [10, 0, 0]
            plain.faces = plain.faces[:1].tolist()
            self.assertFalse(others.intersects_any(*ray)[0])
        # Two of the same content share a scene, of which each lets go.
        pair = [types.SimpleNamespace(vertices=3 * box(2).vertices, faces=box(2).faces)
                for _ in range(2)]
        users = [self.rays(each) for each in pair]
        self.assertTrue(all(user.intersects_any(*ray)[0] for user in users))
        for each, user in zip(pair, users):
            each.vertices = each.vertices * [1, 1, 2] + [10, 0, 0]
            self.assertFalse(user.intersects_any(*ray)[0])
        # Somebody else unloads it meanwhile.
        for scene in self.client.scenes():
            self.client.scene(scene["name"]).unload()
        self.assertTrue(rays.intersects_any(*ray)[0])

    def test_meshes_whose_hash_is_one_of_arrays_are_known_by_content(self):
        pair = collections.namedtuple("Pair", "vertices faces")
        frozen = dataclasses.make_dataclass("Frozen", ["vertices", "faces"], frozen=True)
        ray = [[0, 0, 5.0]], [[0, 0, -1.0]]
        for kind in (pair, frozen):
            mesh = kind(box(2).vertices, box(2).faces)
            rays = self.rays(mesh)
            self.assertTrue(rays.intersects_any(*ray)[0])
            mesh.vertices[:] += [10, 0, 0]
            self.assertFalse(rays.intersects_any(*ray)[0])

    def test_what_is_no_mesh_is_said(self):
        vertices = np.eye(3)
        for says, mesh in (("integers", Mesh(vertices, [[0, 1, 2.0]])),
                           ("counted from 0", Mesh(vertices, [[0, 1, 3]])),
                           ("counted from 0", Mesh(vertices, [[0, 1, -1]])),
                           ("no triangles", Mesh(vertices, [])),
                           ("shape", Mesh(np.eye(2), [[0, 1, 2]])),
                           ("integers", types.SimpleNamespace(vertices=vertices, faces=None))):
            with self.assertRaisesRegex(raynest.UsageError, says):
                self.rays(mesh).intersects_any([[0, 0, 0.0]], [[0, 0, 1.0]])

    def test_it_is_not_for_another_process(self):
        with self.assertRaisesRegex(raynest.UsageError, "connect in each process"):
            pickle.dumps(self.rays(types.SimpleNamespace(vertices=np.eye(3), faces=[[0, 1, 2]])))

    def test_it_closes_what_it_opened(self):
        mesh = types.SimpleNamespace(vertices=np.eye(3), faces=[[0, 1, 2]])  # has no hash
        with RayMeshIntersector(mesh, connection=self.daemon.uri) as rays:
            self.assertTrue(rays.intersects_any([[1.0, 1, 1]], [[-1.0, -1, -1]])[0])
            own, scenes = rays._client, len(self.client.scenes())
        self.assertTrue(own.connection.closed)
        self.assertEqual(len(self.client.scenes()), scenes - 1)
        with self.assertRaises(raynest.UsageError):
            self.rays(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))).intersects_any([[0, 0, 0.]],
                                                                                    [[0, 0, 1.]])


if __name__ == "__main__":
    main()
