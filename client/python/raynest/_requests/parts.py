"""Scenes made of parts: named meshes and where they stand, as a .glb."""
from __future__ import annotations

import json
import struct
from typing import Any, Optional

import numpy as np

from .arguments import float32
from .._net.frame import Array
from .gltf import BIN, FLOAT, GLB, JSON, JSON_BYTES_MAX, UINT, box_of, triangles
from .materials import Mesh, distinct
from .places import Place, matrices_of
from ..errors import UsageError


# A part whose points are farther from zero than this many times its size is moved nearer before they are rounded.
_FAR = 16


def parts_glb(meshes: dict[str, Mesh], places: dict[str, Place], origin: Optional[Array] = None) -> bytes:
    """Returns the scene as a .glb: a mesh for each part, and a node for each place, in their order. In a scene with an
    origin far vertices keep their digits: what is taken from them stands in the nodes."""
    body: list[bytes] = []
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "meshes": [], "accessors": [],
                                "bufferViews": []}
    materials = distinct(meshes.values())
    if materials:
        document["materials"] = [material.as_gltf() for material in materials]
    number_of = {material: number for number, material in enumerate(materials)}
    shifts = []
    for name, mesh in meshes.items():
        shifts.append(_add_mesh(document, body, name, mesh, origin))
        if mesh.material:
            document["meshes"][-1]["primitives"][0]["material"] = number_of[mesh.material]
    numbers_of = {name: number for number, name in enumerate(meshes)}
    nodes: list[dict[str, Any]] = []
    for name, place in places.items():
        node = {"name": name, "mesh": numbers_of[place.part]}
        shift = shifts[numbers_of[place.part]]
        if place.matrices is None and not shift.any():
            nodes.append(node)
            continue
        placed = np.eye(4) if place.matrices is None else place.matrices
        by_columns = (placed @ matrices_of("a shift", shift)).swapaxes(-1, -2)
        nodes.extend({**node, "matrix": matrix} for matrix in by_columns.reshape(-1, 16).tolist())
    data = b"".join(body)
    document.update(nodes=nodes, scenes=[{"nodes": list(range(len(nodes)))}],
                    buffers=[{"byteLength": len(data)}])
    text = json.dumps(document, separators=(",", ":")).encode()
    text = text.ljust((len(text) + 3) // 4 * 4)
    if len(text) > JSON_BYTES_MAX:
        raise UsageError(f"{len(nodes)} places take {len(text)} bytes, at most {JSON_BYTES_MAX} are "
                         "taken: put them into a group, as {'cars': {'car': ('car', matrices)}}")
    size = 28 + len(text) + len(data)
    return b"".join((struct.pack("<5I", GLB, 2, size, len(text), JSON), text,
                     struct.pack("<2I", len(data), BIN), data))


def shift_of(points: Array, origin: Optional[Array]) -> Array:
    """Returns what is to be taken from the points of a part before they are rounded, (3,): about the origin, as in
    Client.mesh(), if that is within the part's size of it; else 0 where they are near for their size, and in a scene without an origin."""
    if origin is not None:
        box = np.array(box_of(points), np.float64)
        size = float(np.linalg.norm(box[1] - box[0]))
        if np.isfinite(box).all():
            if np.linalg.norm(origin - np.clip(origin, *box)) <= size:
                return np.round(origin)
            if np.abs(box).max() > _FAR * size:
                middle: Array = np.round(box.mean(axis=0))
                return middle
    return np.zeros(3)


def _add_mesh(document: dict[str, Any], body: list[bytes], name: str, mesh: Mesh, origin: Optional[Array]) -> Array:
    """Returns what was taken from its vertices, (3,)."""
    points, corners = triangles(mesh.vertices, mesh.faces, f"the part {name!r}: ")
    shift = shift_of(points, origin)
    positions = float32(points - shift if shift.any() else points)
    low, high = box_of(positions)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise UsageError(f"the part {name!r} has vertices that are not finite in float32")
    view = len(document["bufferViews"])
    for data in (positions.tobytes(), corners.astype("<u4").tobytes()):
        before = document["bufferViews"][-1] if body else {"byteOffset": 0, "byteLength": 0}
        document["bufferViews"].append({"buffer": 0, "byteLength": len(data), "byteOffset":
                                        before["byteOffset"] + before["byteLength"]})
        body.append(data)
    document["accessors"] += [
        {"bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": len(positions),
         "min": low.tolist(), "max": high.tolist()},
        {"bufferView": view + 1, "componentType": UINT, "type": "SCALAR", "count": corners.size}]
    document["meshes"].append({"name": name, "primitives": [
        {"attributes": {"POSITION": view}, "indices": view + 1}]})
    return shift
