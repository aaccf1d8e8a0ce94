"""trimesh.ray.ray_pyembree.RayMeshIntersector, on a RayNest daemon.

    from raynest.compat.trimesh import RayMeshIntersector
    mesh.ray = RayMeshIntersector(mesh)

Signatures and shapes of the answers are those of trimesh's class. trimesh itself is not needed: any
object with `vertices` (N, 3) and `faces` (M, 3) will do. What differs is that no ray slips between
triangles, and that all hits come from one traversal instead of one query per hit.
"""
from __future__ import annotations

import contextlib
import hashlib
import sys
from types import TracebackType
from typing import Any, Hashable, NamedTuple, Optional, Union

import numpy as np

from .. import _limits
from .._net.frame import Array
from .._requests.columns import Columns
from .._requests.gltf import triangles
from ..client import Client, connect
from ..errors import InvalidError, UsageError
from ..scene import Scene

# The mesh is moved to the origin and, with scale_to_box, brought to this size, which suits float32.
BOX_SIZE = 100.0
# Hits of one side of the surface that are this close, as a share of the box and of t, are one
# crossing of an edge or a vertex, found by each triangle that meets there.
SAME_CROSSING = 1e-6

# Where rays for contains_points() go: nowhere special.
_DIRECTIONS = np.array([[0.4395, 0.6176, 0.6522], [-0.7239, 0.3307, 0.6055],
                        [0.2113, -0.8731, 0.4395]])


class Crossings(NamedTuple):
    """By ray, and along each ray."""

    triangles: Array
    rays: Array
    t: Array


class RayMeshIntersector:
    """The mesh is uploaded at the first query, and again when it has changed: its hash, as of
    trimesh's own, else its vertices and faces, which each query then reads once.

    `connection` is a Client or the URI of a daemon, by default that of raynest.connect(). close()
    and the end of the program unload the mesh.
    """

    def __init__(self, geometry: Any, scale_to_box: bool = True,
                 connection: Union[Client, str, None] = None) -> None:
        self.mesh = geometry
        self._scale_to_box = scale_to_box
        self._own = not isinstance(connection, Client)
        self._client = connection if isinstance(connection, Client) else connect(connection)
        self._key: Hashable = None
        self._scene: Optional[Scene] = None
        self._corners = np.empty((0, 3, 3))  # all triangles', in the mesh's coordinates
        self._shift = np.zeros(3)
        self._scale = self._size = 1.0

    def close(self) -> None:
        if not self._client.connection.closed:
            self._drop()
        if self._own:
            self._client.close()

    def __enter__(self) -> RayMeshIntersector:
        return self

    def __exit__(self, kind: Optional[type[BaseException]], error: Optional[BaseException],
                 traceback: Optional[TracebackType]) -> None:
        self.close()

    # ---- trimesh's methods ----------------------------------------------------------------------

    def intersects_location(self, ray_origins: Any, ray_directions: Any,
                            multiple_hits: bool = True) -> tuple[Array, Array, Array]:
        """Where rays cross the surface: locations (m, 3), index_ray (m,), index_tri (m,); of each
        ray the first 20, as in trimesh. For more ask intersects_id()."""
        triangles, rays, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, return_locations=True)
        return locations, rays, triangles

    def intersects_id(self, ray_origins: Any, ray_directions: Any, multiple_hits: bool = True,
                      max_hits: int = 20, return_locations: bool = False) -> Any:
        """The triangles that rays cross: index_tri (m,), index_ray (m,) and, if asked for,
        locations (m, 3); by ray, and along each ray the first `max_hits`. A crossing at an edge or
        a vertex counts once."""
        origins, directions = _rays(ray_origins, ray_directions)
        found = self._crossings(origins, directions, max_hits if multiple_hits else 1)
        if not return_locations:
            return found.triangles, found.rays
        return found.triangles, found.rays, self._locations(found, origins, directions)

    def intersects_first(self, ray_origins: Any, ray_directions: Any) -> Array:
        """The first triangle that each ray hits (n,), -1 for none."""
        hits = self._trace(*_rays(ray_origins, ray_directions), fields=("prim", "hit"))
        return np.where(hits["hit"], hits["prim"].astype(np.int64), -1)

    def intersects_any(self, ray_origins: Any, ray_directions: Any) -> Array:
        """Does each ray hit anything? (n,) bool."""
        return self._trace(*_rays(ray_origins, ray_directions), kind="any", fields=("hit",))["hit"]

    def contains_points(self, points: Any) -> Array:
        """Is each point inside of the closed mesh? (n,) bool; undefined on the surface.

        A point is inside if rays both ways cross the surface an odd number of times. Where both
        ways differ, another direction decides.
        """
        places = _numbers(points)
        if places.ndim != 2 or places.shape[1] != 3:
            raise UsageError("points must be (n, 3)")
        self._upload()
        low, high = self._corners.min((0, 1)), self._corners.max((0, 1))
        inside = np.zeros(len(places), bool)
        open_ = np.flatnonzero(((low <= places) & (places <= high)).all(1))
        for direction in _DIRECTIONS:
            if not len(open_):
                break
            both = np.repeat([direction, -direction], len(open_), axis=0)
            crossings = self._crossings(np.tile(places[open_], (2, 1)), both, sys.maxsize)
            ahead, behind = np.bincount(crossings.rays, minlength=2 * len(open_)).reshape(2, -1)
            odd = ahead % 2 == 1
            inside[open_] = odd & (ahead > 0) & (behind > 0)
            open_ = open_[(odd != (behind % 2 == 1)) & (ahead > 0) & (behind > 0)]
        return inside

    # ---- on RayNest -----------------------------------------------------------------------------

    def _crossings(self, origins: Array, directions: Array, max_hits: int) -> Crossings:
        """The first `max_hits` of each ray; InvalidError where that takes more hits than there can
        be of a ray."""
        if max_hits == 1:
            hits = self._trace(origins, directions, fields=("t", "prim", "hit"))
            rays = np.flatnonzero(hits["hit"])
            return Crossings(hits["prim"][rays].astype(np.int64), rays, hits["t"][rays])
        # A crossing may be several hits. Where they used up the budget, all of them are asked.
        budgets = [("all", _limits.all_hits_max)]
        if max_hits <= _limits.hits_max:
            budgets.insert(0, ("multi", max_hits))
        for kind, budget in budgets:
            hits = self._trace(origins, directions, kind=kind, fields=("t", "prim", "front"),
                               max_hits=budget)
            counts = np.diff(hits["ray_splits"]).astype(np.int64)
            rays = np.repeat(np.arange(len(origins)), counts)
            near = SAME_CROSSING * (self._size + hits["t"])
            kept = np.flatnonzero(~_seen_before(rays, hits["front"], hits["t"], near))
            crossings = np.bincount(rays[kept], minlength=len(origins))
            short = (counts == budget) & (crossings < max_hits)
            if not short.any():
                break
        else:
            if self._client.outcome["truncated"]:
                raise InvalidError(f"ray {short.argmax()} has more than {budget} hits: cut it in "
                                   "pieces, or pass a lower max_hits", "LIMIT_EXCEEDED")
        place = np.arange(len(kept)) - np.repeat(np.cumsum(crossings) - crossings, crossings)
        kept = kept[place < max_hits]
        return Crossings(hits["prim"][kept].astype(np.int64), rays[kept], hits["t"][kept])

    def _trace(self, origins: Array, directions: Array, **options: Any) -> Columns:
        scene = self._upload()
        origins = (origins - self._shift) * self._scale
        try:
            hits: Columns = scene.trace(origins, directions, intersector="opaque", **options)
        except InvalidError as error:
            if error.name != "SCENE_UNKNOWN":
                raise
            self._scene = None  # somebody has unloaded it
            hits = self._upload().trace(origins, directions, intersector="opaque", **options)
        return hits

    def _upload(self) -> Scene:
        key = _key(self.mesh)
        if self._scene is not None and key == self._key:
            return self._scene
        self._drop()
        points, faces = triangles(self.mesh.vertices, self.mesh.faces)
        vertices = points.astype(np.float64)
        self._corners = vertices[faces]  # vertices that no face uses are nowhere
        low, high = self._corners.min((0, 1)), self._corners.max((0, 1))
        size = float(np.max(high - low))
        self._shift = (low + high) / 2
        self._scale = BOX_SIZE / size if self._scale_to_box and size > 0 else 1.0
        self._size = size * self._scale
        self._scene = self._client.mesh((vertices - self._shift) * self._scale, faces)
        self._key = key
        return self._scene

    def _drop(self) -> None:
        """Unloads the scene, unless another user of the same mesh has it still."""
        scene, self._scene = self._scene, None
        if scene is not None:
            scene.close()

    def _locations(self, found: Crossings, origins: Array, directions: Array) -> Array:
        """Where rays meet the planes of their triangles, in float64; in a plane, where t says."""
        starts, ways = origins[found.rays], directions[found.rays]
        corner, second, third = np.moveaxis(self._corners[found.triangles], 1, 0)
        normal = np.cross(second - corner, third - corner)
        slope = (ways * normal).sum(1)
        t = np.divide(((corner - starts) * normal).sum(1), slope, where=slope != 0,
                      out=found.t.astype(np.float64) / self._scale)
        return np.asarray(starts + t[:, None] * ways)


def _key(mesh: Any) -> Hashable:
    """Differs where the mesh does. A hash that an object has for being itself says nothing of it,
    and one of its arrays, as of a tuple or a frozen dataclass, there is none."""
    if isinstance(mesh, Hashable) and type(mesh).__hash__ is not object.__hash__:
        with contextlib.suppress(TypeError):
            return hash(mesh)
    arrays = [np.ascontiguousarray(each) for each in triangles(mesh.vertices, mesh.faces)]
    content = hashlib.blake2b(digest_size=16)
    for array in arrays:
        content.update(array.reshape(-1).view(np.uint8).data)
    return content.digest(), *((array.dtype.str, array.shape) for array in arrays)


def _numbers(values: Any) -> Array:
    """As float64; what is masked is not a number, so that its ray hits nothing."""
    masked: Any = np.ma  # has no types in older versions
    numbers: Array = masked.filled(masked.asarray(values, np.float64), np.nan)
    return numbers


def _rays(origins: Any, directions: Any) -> tuple[Array, Array]:
    """As float64, directions of unit length."""
    starts, ways = _numbers(origins), _numbers(directions)
    if starts.shape != ways.shape or starts.ndim != 2 or starts.shape[1] != 3:
        raise UsageError(f"ray origins {starts.shape} and directions {ways.shape} must be (n, 3)")
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return starts, np.divide(ways, lengths, out=np.zeros_like(ways), where=lengths > 0)


def _seen_before(rays: Array, sides: Array, t: Array, near: Array) -> Array:
    """For hits along rays: is there one before it, of the same ray and side, that is `near`?"""
    order = np.lexsort((t, sides, rays))
    before, after = order[:-1], order[1:]
    seen = np.zeros(len(order), bool)
    seen[after] = ((rays[before] == rays[after]) & (sides[before] == sides[after])
                   & (t[after] - t[before] <= near[after]))
    return seen
