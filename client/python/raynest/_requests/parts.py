"""Scenes made of parts: named meshes and where they stand, as a .glb."""
from __future__ import annotations

import json
import struct
from typing import Any, Optional

import numpy as np

from .. import _limits
from .arguments import float32
from .._net.frame import Array
from .gltf import APART_BYTES, BIN, FLOAT, GLB, JSON, JSON_BYTES_MAX, UINT, box_of, in_use, triangles
from .materials import Mesh, distinct
from .places import Place, matrices_of
from .upload import File
from ..errors import UsageError


# A part whose points are farther from zero than this many times its size is moved nearer before they are rounded.
_FAR = 16


def parts_glb(meshes: dict[str, Mesh], places: dict[str, Place], origin: Optional[Array] = None) -> tuple[File, ...]:
    """Returns the scene as a .glb, with files that it names: a mesh for each part, and a node for each place, in their
    order. In a scene with an origin far vertices keep their digits: what is taken from them stands in the nodes."""
    body: list[bytes] = []      # meshes without a file of their own
    files: list[File] = []
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "meshes": [], "accessors": [],
                                "bufferViews": []}
    materials = distinct(meshes.values())
    if materials:
        document["materials"] = [material.as_gltf() for material in materials]
    number_of = {material: number for number, material in enumerate(materials)}
    shifts = []
    made = {name: in_use(*triangles(mesh.vertices, mesh.faces, f"the part {name!r}: ")) for name, mesh in meshes.items()}
    apart = largest({name: 4 * (points.size + corners.size) for name, (points, corners) in made.items()},
                    _limits.upload_files_max - 1)
    for name, (points, corners) in made.items():
        shift = shift_of(points, origin)
        positions = _add_mesh(document, name, points - shift if shift.any() else points, corners)
        buffers = [positions.tobytes(), corners.astype("<u4").tobytes()]
        start = 0
        if name in apart:
            files.append(File(f"{len(files) + 1}.bin", b"".join(buffers)))
        else:
            start = sum(map(len, body))
            body.extend(buffers)
        document["bufferViews"] += [
            {"buffer": len(files) if name in apart else 0, "byteOffset": offset, "byteLength": len(data)}
            for data, offset in zip(buffers, (start, start + len(buffers[0])))]
        shifts.append(shift)
        material = meshes[name].material
        if material:
            document["meshes"][-1]["primitives"][0]["material"] = number_of[material]
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
    # The BIN chunk is the first buffer. A file cannot have one of no bytes.
    own: list[dict[str, Any]] = [{"byteLength": len(file.data), "uri": file.name} for file in files]
    if not data:
        for view in document["bufferViews"]:
            view["buffer"] -= 1
    document.update(nodes=nodes, scenes=[{"nodes": list(range(len(nodes)))}],
                    buffers=[{"byteLength": len(data)}] * bool(data) + own)
    text = json.dumps(document, separators=(",", ":")).encode()
    text = text.ljust((len(text) + 3) // 4 * 4)
    if len(text) > JSON_BYTES_MAX:
        raise UsageError(f"{len(nodes)} places take {len(text)} bytes, at most {JSON_BYTES_MAX} are "
                         "taken: put them into a group, as {'cars': {'car': ('car', matrices)}}")
    end = struct.pack("<2I", len(data), BIN) + data if data else b""
    size = 20 + len(text) + len(end)
    return (File("parts.glb", struct.pack("<5I", GLB, 2, size, len(text), JSON) + text + end), *files)


def largest(sizes: dict[str, int], room: int) -> set[str]:
    """Names the meshes that are files of their own: the largest ones, of APART_BYTES or more."""
    by_size = sorted((name for name, size in sizes.items() if size >= APART_BYTES), key=lambda name: -sizes[name])
    return set(by_size[:max(room, 0)])


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


def _add_mesh(document: dict[str, Any], name: str, points: Array, corners: Array) -> Array:
    """Adds the mesh of the next two bufferViews. Returns its vertices as float32."""
    positions = float32(points)
    low, high = box_of(positions)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise UsageError(f"the part {name!r} has vertices that are not finite in float32")
    view = len(document["bufferViews"])
    document["accessors"] += [
        {"bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": len(positions),
         "min": low.tolist(), "max": high.tolist()},
        {"bufferView": view + 1, "componentType": UINT, "type": "SCALAR", "count": corners.size}]
    document["meshes"].append({"name": name, "primitives": [
        {"attributes": {"POSITION": view}, "indices": view + 1}]})
    return positions
