"""The parts of glTF that a client needs: the files that one names, and a mesh as a .glb.

The daemon validates scenes. This module reads names from files that may be hostile, so it checks
lengths, sizes and names before it opens anything.
"""
from __future__ import annotations

import json
import re
import struct
from typing import Any, NamedTuple, NoReturn, Optional

import numpy as np

from .._net.frame import Array
from ..errors import InvalidError, UsageError
from .arguments import array_of, is_masked
from .digest import Digest
from .materials import Material

JSON_BYTES_MAX = 64 << 20
NAME_BYTES_MAX = 1024

GLB, JSON, BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_ESCAPE = re.compile(rb"%([0-9A-Fa-f]{2})?")
FLOAT, UINT = 5126, 5125
_HEAD_BYTES = 2048  # a mesh's .glb before its vertices, without names: two headers, the JSON and a third header


def _refuse(why: str) -> NoReturn:
    raise InvalidError(why, "FILE_INVALID")


# ---- reading ------------------------------------------------------------------------------------

def file_names(data: bytes, is_glb: bool = False) -> dict[str, bool]:
    """Returns the files that buffers and images of a .gltf or .glb name: True for pictures, which only
    images name, and which a scene can do without. Names outside the scene's folder are left out: the
    daemon complains if it needs them."""
    if data.startswith(b"version https://git-lfs"):
        _refuse("is a Git LFS pointer, not the file itself: run git lfs pull")
    if is_glb and data[:4] != b"glTF":
        _refuse(f"is no GLB file: it begins with {data[:24]!r}")
    text = _glb_json(data).rstrip(b"\0") if data[:4] == b"glTF" else data   # some pad with zeros
    if len(text) > JSON_BYTES_MAX:
        _refuse(f"has {len(text)} bytes of JSON; at most {JSON_BYTES_MAX} are read")
    try:
        root = json.loads(text)
    except RecursionError:
        _refuse("is nested too deeply")
    except ValueError as error:
        _refuse(f"is not valid JSON ({error})")
    if not isinstance(root, dict):
        _refuse("is not a JSON object")
    names: dict[str, bool] = {}
    for key in ("buffers", "images"):
        items = root.get(key)
        for item in items if isinstance(items, list) else []:
            uri = item.get("uri") if isinstance(item, dict) else None
            name = file_of_uri(uri) if isinstance(uri, str) else None
            if name is not None:
                names.setdefault(name, key == "images")
    return names


def _glb_json(data: bytes) -> bytes:
    if len(data) < 20:
        _refuse("is cut within its GLB header")
    _, version, length, json_bytes, kind = struct.unpack_from("<5I", data)
    if version != 2:
        _refuse(f"is GLB version {version}; only version 2 can be read")
    if length > len(data):
        _refuse(f"says that it has {length} bytes, but has {len(data)}")
    if kind != JSON or json_bytes > length - 20:
        _refuse("does not begin with a JSON chunk that it holds")
    return data[20:20 + json_bytes]


def file_of_uri(uri: str) -> str | None:
    """Returns the file of a URI: percent-decoded once, with / for \\, without empty parts and "./",
    with "a/.." cancelled. None if the URI has a scheme, is absolute, leaves the scene's folder,
    hides a separator, "." or "..", or is not printable. The daemon applies the same rule
    (tests/golden/gltf_uris.json)."""
    encoded = re.split(rb"[/\\]", uri.encode("utf-8", "surrogatepass"))
    if not encoded[0] or not encoded[-1]:
        return None
    components: list[str] = []
    for part in encoded:
        if part == b"..":
            if not components:
                return None
            components.pop()
        elif part not in (b"", b"."):
            if b"" in _ESCAPE.findall(part):
                return None
            try:
                name = _ESCAPE.sub(lambda match: bytes.fromhex(match[1].decode()), part).decode()
            except UnicodeDecodeError:
                return None
            if not name.isprintable() or re.search(r"[/\\:]|^\.\.?$", name):
                return None
            components.append(name)
    name = "/".join(components)
    return name if 0 < len(name.encode()) <= NAME_BYTES_MAX else None


# ---- writing ------------------------------------------------------------------------------------

def triangles(vertices: Any, faces: Any, whose: str = "") -> tuple[Array, Array]:
    """Returns both as checked arrays: vertices (N, 3), and faces (M, 3) of indices. `whose` is before each error."""
    if is_masked(faces):
        raise UsageError(f"{whose}some faces are masked: pass numpy.ma.compress_rows(faces)")
    if is_masked(vertices):
        raise UsageError(f"{whose}some vertices are masked: leave out the faces that use them, as "
                         "faces[~vertices.mask.any(1)[faces].any(1)], and pass vertices.data")
    points, corners = array_of(f"{whose}vertices", vertices), array_of(f"{whose}faces", faces)
    if not corners.size:
        raise UsageError(f"{whose}the mesh has no triangles")
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise UsageError(f"{whose}vertices must be numbers of shape (N, 3), not {points.dtype} "
                         f"{points.shape}")
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise UsageError(f"{whose}faces must be integers of shape (M, 3), not {corners.dtype} "
                         f"{corners.shape}")
    # As unsigned numbers, of which negative ones are the largest: the faces are read once.
    if corners.view(corners.dtype.str.replace("i", "u")).max() >= len(points):
        raise UsageError(f"{whose}faces go from {corners.min()} to {corners.max()}: they must be indices "
                         f"of the {len(points)} vertices, counted from 0")
    return points, corners


_ABREAST = 1024     # points that numpy compares at once

# A mesh of so many bytes is a file of its own: the daemon asks for it only if it has it in no scene.
APART_BYTES = 1 << 16


def in_use(points: Array, corners: Array) -> tuple[Array, Array]:
    """A mesh without vertices that no face uses, where it has more of them than its faces have corners. The daemon leaves
    them out as well, so the file would not be known again."""
    if len(points) <= corners.size:
        return points, corners
    used, numbers = np.unique(corners, return_inverse=True)
    if not np.isfinite(points[used]).all():     # an error names them by their numbers
        return points, corners
    return points[used], numbers.reshape(corners.shape)


def mesh_glb(vertices: Any, faces: Any, origin: Array = np.zeros(3), material: Optional[Material] = None,
             name: str = "") -> memoryview:
    """Returns a mesh as a .glb: vertices (N, 3), faces (M, 3) of indices. `origin` is subtracted
    before the vertices become float32 and is the position of their node, so that they stay in
    place. Triangle i of the scene is row i of `faces`."""
    return _mesh_files(*in_use(*triangles(vertices, faces)), origin, material, name, "")[0]


class Body(NamedTuple):
    """A file of vertices and faces."""

    data: memoryview
    digest: Digest


def mesh_files(vertices: Any, faces: Any, apart: str, origin: Array = np.zeros(3), material: Optional[Material] = None,
               name: str = "") -> tuple[memoryview, Optional[Body]]:
    """Returns a mesh as mesh_glb() does. If it is large, its vertices and faces are a file of the name `apart`, the second
    value."""
    points, corners = in_use(*triangles(vertices, faces))
    is_apart = bool(apart) and 4 * (points.size + corners.size) >= APART_BYTES
    return _mesh_files(points, corners, origin, material, name, apart if is_apart else "")


def _mesh_files(points: Array, corners: Array, origin: Array, material: Optional[Material], name: str,
                apart: str) -> tuple[memoryview, Optional[Body]]:
    moves = bool(origin.any())
    named: dict[str, Any] = {"name": name} if name else {}
    painted: dict[str, Any] = {"materials": [material.as_gltf()]} if material else {}
    head_bytes = _HEAD_BYTES + (len(json.dumps([named, painted])) + 3) // 4 * 4 if named or painted else _HEAD_BYTES
    position_bytes, index_bytes = 4 * points.size, 4 * corners.size
    # Written in place: copies of a large mesh would take as long as all the rest.
    whole = np.empty(head_bytes + position_bytes + index_bytes, np.uint8)
    body = whole[head_bytes:]
    positions = body[:position_bytes].view("<f4").reshape(points.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        positions[...] = points - origin if moves else points
    digest = Digest()
    if apart:
        digest.add(body[:position_bytes].data)
    body[position_bytes:].view("<u4")[...] = corners.ravel()
    if apart:
        digest.add(body[position_bytes:].data)
    low, high = box_of(positions)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        lost = np.flatnonzero(~np.isfinite(positions).all(1))
        used = lost[np.isin(lost, corners)]
        if len(used):
            raise UsageError(f"{len(used)} vertices that faces use are not finite in float32, the "
                             f"first is {used[0]}: leave out those faces, as "
                             "faces[np.isfinite(vertices[faces]).all((1, 2))]")
        digest.value()      # of what was there
        positions[lost] = 0
        low, high = box_of(positions)
        digest = Digest()
        digest.add(body.data)
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "mesh",
                   **({"translation": origin.tolist()} if moves else {})}],
        "meshes": [{**named, "primitives": [{"attributes": {"POSITION": 0}, "indices": 1,
                                             **({"material": 0} if material else {})}]}], **painted,
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "type": "VEC3", "count": len(positions),
             "min": low.tolist(), "max": high.tolist()},
            {"bufferView": 1, "componentType": UINT, "type": "SCALAR", "count": corners.size}],
        "bufferViews": [
            {"buffer": 0, "byteLength": position_bytes},
            {"buffer": 0, "byteOffset": position_bytes, "byteLength": index_bytes}],
        "buffers": [{"byteLength": len(body), **({"uri": apart} if apart else {})}]}
    end = b"" if apart else struct.pack("<2I", len(body), BIN)
    text = json.dumps(document).encode()
    text = text.ljust(head_bytes - 20 - len(end))  # blanks to the chunk's end
    head = struct.pack("<5I", GLB, 2, head_bytes if apart else len(whole), len(text), JSON) + text + end
    whole[:head_bytes] = np.frombuffer(head, np.uint8)
    return (whole[:head_bytes].data, Body(body.data, digest)) if apart else (whole.data, None)


def box_of(points: Array) -> tuple[Array, Array]:
    """Returns the corners of the box of (N, 3) points; NaN where one of them has it."""
    whole = len(points) // _ABREAST * _ABREAST

    def end(of: np.ufunc) -> Array:     # of rows of three numbers at once: numpy takes four times as long over short ones
        rows = of.reduce(points[:whole].reshape(-1, 3 * _ABREAST)).reshape(-1, 3) if whole else points[:0]
        reduced: Array = of.reduce(np.concatenate([rows, points[whole:]]))
        return reduced
    return end(np.minimum), end(np.maximum)
