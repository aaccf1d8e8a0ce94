"""Scenes made of parts: named meshes and where they stand, as a .glb."""
from __future__ import annotations

import json
import reprlib
import struct
from typing import Any, Mapping, Optional

import numpy as np

from .arguments import numbers
from .._net.frame import Array
from .gltf import BIN, FLOAT, GLB, JSON, JSON_BYTES_MAX, UINT, box_of, triangles
from ..errors import UsageError


# A part whose vertices are farther from zero than this many times its size is moved nearer before they are rounded.
_FAR = 16


def parts_glb(parts: Mapping[str, Any], places: Optional[Mapping[str, Any]], has_origin: bool = False) -> bytes:
    """Returns the scene as a .glb: a mesh for each part, and a node for each place, in their order. In a scene with an
    origin far float64 vertices keep their digits: what is taken from them stands in the nodes."""
    if not isinstance(parts, Mapping) or not parts:
        raise TypeError("parts must be a dict of meshes: {'car': (vertices, faces), ...}")
    body: list[bytes] = []
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "meshes": [], "accessors": [],
                                "bufferViews": []}
    shifts = [_add_mesh(document, body, _name("a part", name), part, has_origin) for name, part in parts.items()]
    numbers_of = {name: number for number, name in enumerate(parts)}
    nodes: list[dict[str, Any]] = []
    for name, place in (places if places is not None else {part: part for part in parts}).items():
        part, matrices = place if isinstance(place, tuple) and len(place) == 2 else (place, None)
        if not isinstance(part, str) or part not in numbers_of:
            raise UsageError(f"the place {name!r} is of {reprlib.repr(part)}, which is no part; there are "
                             + ", ".join(map(repr, parts)))
        node = {"name": _name("a place", name), "mesh": numbers_of[part]}
        shift = shifts[numbers_of[part]]
        if matrices is None and not shift.any():
            nodes.append(node)
            continue
        placed = matrices_of(f"the place {name!r}", np.zeros(3) if matrices is None else matrices)
        by_columns = (placed @ matrices_of("a shift", shift)).swapaxes(-1, -2)
        nodes.extend({**node, "matrix": matrix} for matrix in by_columns.reshape(-1, 16).tolist())
    data = b"".join(body)
    document.update(nodes=nodes, scenes=[{"nodes": list(range(len(nodes)))}],
                    buffers=[{"byteLength": len(data)}])
    text = json.dumps(document, separators=(",", ":")).encode()
    text = text.ljust((len(text) + 3) // 4 * 4)
    if len(text) > JSON_BYTES_MAX:
        raise UsageError(f"{len(nodes)} places take {len(text)} bytes, at most {JSON_BYTES_MAX} are "
                         "taken: make groups of them, each a scene of its own")
    size = 28 + len(text) + len(data)
    return b"".join((struct.pack("<5I", GLB, 2, size, len(text), JSON), text,
                     struct.pack("<2I", len(data), BIN), data))


def matrices_of(what: str, value: Any) -> Array:
    """Returns a (4, 4) or (N, 4, 4) of float64: from offsets (3,) and (N, 3), or matrices (3, 4), (4, 4),
    (N, 3, 4) and (N, 4, 4)."""
    given = numbers(what, value).astype(np.float64)
    shape = given.shape
    rows, columns = shape[-2:] if len(shape) >= 2 else (0, 0)
    if shape == (3,) or (len(shape) == 2 and columns == 3):
        made = np.zeros(shape[:-1] + (4, 4))
        made[...] = np.eye(4)
        made[..., :3, 3] = given
    elif len(shape) in (2, 3) and columns == 4 and rows in (3, 4):
        made = np.zeros(shape[:-2] + (4, 4))
        made[..., 3, 3] = 1
        made[..., :rows, :] = given
    else:
        raise UsageError(f"{what} has shape {shape}: it must be (3,), (3, 4) or (4, 4), or (N, 3), (N, 3, 4) "
                         "or (N, 4, 4) for several")
    if not (made[..., 3, :] == (0, 0, 0, 1)).all():
        raise UsageError(f"{what}: the last row of a 4x4 matrix must be 0 0 0 1")
    if not np.isfinite(made).all():
        raise UsageError(f"{what} has numbers that are not finite")
    return made


def _name(what: str, name: Any) -> str:
    if not isinstance(name, str) or not name:
        raise TypeError(f"{reprlib.repr(name)} is no name of {what}: it must be a text")
    return name


def _add_mesh(document: dict[str, Any], body: list[bytes], name: str, part: Any, may_shift: bool) -> Array:
    """Returns what was taken from its vertices, (3,)."""
    if hasattr(part, "vertices") and hasattr(part, "faces"):
        part = part.vertices, part.faces
    if not isinstance(part, (tuple, list)) or len(part) != 2:
        raise TypeError(f"the part {name!r} must be (vertices, faces), or have both")
    points, corners = triangles(*part)
    shift = np.zeros(3)
    if may_shift and points.dtype == np.float64:
        box = np.array(box_of(points))
        size = float(np.linalg.norm(box[1] - box[0]))
        if np.isfinite(box).all() and np.abs(box).max() > _FAR * size:
            shift = np.round(box.mean(axis=0))
            points = points - shift
    with np.errstate(over="ignore", invalid="ignore"):
        positions = points.astype("<f4")
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
