"""Scenes made of parts as a composition: a .rnscene.json and, in memory, the files that it names."""
from __future__ import annotations

import io
import json
from typing import Any, Iterator, Optional, Union

import numpy as np

from .. import _limits
from .._net.frame import Array
from ..errors import UsageError
from .arguments import float32
from .gltf import JSON_BYTES_MAX, mesh_files, triangles
from .npz import write_npz
from .parts import largest, shift_of
from .places import Parts, Place, Spheres
from .upload import File

_TABLE_ROWS = 1000  # more matrices are a file of their own
_ARCHIVE_MESHES, _ARCHIVE_BYTES = 100, 64 << 20  # for one file, where not each mesh has its own


def composition_of(parts: Parts, origin: Optional[Array], up: str) -> tuple[File, ...]:
    """Returns the files, the composition first. In a scene with an origin, far coordinates keep their digits."""
    files = [File("parts.rnscene.json", b"")]
    objects: dict[str, Any] = {}
    # First all that must have a file of its own: of the others so many have one as there is room for.
    for name, records in parts.records.items():
        rows = records.rows
        rows, shift = _kept(rows, rows[:, :3], origin if isinstance(records, Spheres) else None)
        objects[name] = {"file": _keep(files, _npy(rows), ".npy"), "primitive": records.primitive, **shift}
    for name, group in parts.groups.items():
        objects[name] = {"instances": _instances(files, group)}
    instances = _instances(files, parts.places)
    # A large mesh with a material has two, where there is room for those and for the others.
    has_room = len(files) + 2 * len(parts.meshes) <= _limits.upload_files_max
    plain: dict[str, tuple[Array, Array]] = {}  # float32 vertices and faces
    for name, mesh in parts.meshes.items():
        points, corners = triangles(mesh.vertices, mesh.faces, f"the part {name!r}: ")
        if not np.isfinite(float32(points)).all():
            raise UsageError(f"the part {name!r} has vertices that are not finite in float32")
        if mesh.material:
            moved = shift_of(points, origin)
            glb, body = mesh_files(points, corners, f"{len(files) + 1}.bin" if has_room else "", moved, mesh.material, name)
            objects[name] = {"file": _keep(files, glb, ".glb"), "up": up, **({"origin": moved.tolist()} if moved.any() else {})}
            if body is not None:
                files.append(File(f"{len(files)}.bin", *body))
            continue
        points, objects[name] = _kept(points, points, origin)
        plain[name] = points, corners.astype("<u4")
    for name, entry in _stored(files, plain).items():
        objects[name] = {**entry, **objects[name]}
    document = {"rnscene": 1, "up": up, "objects": objects, "instances": instances}
    text = json.dumps(document, separators=(",", ":")).encode()
    if len(text) > JSON_BYTES_MAX:
        raise UsageError(f"the places take {len(text)} bytes of text, at most {JSON_BYTES_MAX} are taken: make groups of them, "
                         "or leave out masks and user ids that differ from place to place")
    if len(files) > _limits.upload_files_max:
        raise UsageError(f"these parts make {len(files) - 1} files, at most {_limits.upload_files_max - 1} are taken: spheres and "
                         f"other records, meshes with materials, and tables of over {_TABLE_ROWS} matrices have one each, and "
                         f"other meshes one for {_ARCHIVE_MESHES}. Join parts that stand together")
    return (files[0]._replace(data=text), *files[1:])


def _stored(files: list[File], meshes: dict[str, tuple[Array, Array]]) -> dict[str, dict[str, str]]:
    """Keeps meshes, each in a file of its own if there is room for so many, else the largest ones. Returns where each is."""
    left = _limits.upload_files_max - len(files)
    sizes = {name: points.nbytes + corners.nbytes for name, (points, corners) in meshes.items()}
    apart = set(meshes) if len(meshes) <= left else largest(sizes, left - 1 - len(meshes) // _ARCHIVE_MESHES -
                                                            sum(sizes.values()) // _ARCHIVE_BYTES)
    found = {name: {"file": _keep(files, _ply(*meshes[name]), ".ply")} for name in meshes if name in apart}
    archives: list[list[str]] = []
    size = _ARCHIVE_BYTES
    for name in meshes:
        if name in apart:
            continue
        size += sizes[name]
        if size > _ARCHIVE_BYTES or len(archives[-1]) == _ARCHIVE_MESHES:
            archives.append([])
            size = sizes[name]
        archives[-1].append(name)
    for names in archives:
        # By number: names of parts may hold what no name of an array may.
        file = _keep(files, _npz({f"{i}/{word}": array for i, name in enumerate(names)
                                  for word, array in zip(("vertices", "faces"), meshes[name])}), ".npz")
        found.update((name, {"file": file, "mesh": str(i)}) for i, name in enumerate(names))
    return found


def _kept(rows: Array, points: Array, origin: Optional[Array]) -> tuple[Array, dict[str, Any]]:
    """Rows as float32, whose points are less what the second value says."""
    shift = shift_of(points, origin)
    if not shift.any():
        return float32(rows), {}
    moved = rows.astype(np.float64)
    moved[:, :3] -= shift
    return float32(moved), {"at": shift.tolist()}


def _instances(files: list[File], places: dict[str, Place]) -> list[dict[str, Any]]:
    return [entry for name, place in places.items() for entry in _entries(files, name, place)]


def _entries(files: list[File], name: str, place: Place) -> Iterator[dict[str, Any]]:
    """An entry for each stretch of places with one mask and one user id. Paths are numbered through all of them."""
    matrices = place.matrices
    count = len(matrices) if matrices is not None and matrices.ndim == 3 else 1
    columns = {word: np.broadcast_to(values, count)
               for word, values in (("mask", place.mask), ("uid", place.uid)) if values is not None}
    differs = np.zeros(max(count - 1, 0), bool)
    for column in columns.values():
        differs |= column[1:] != column[:-1]
    starts = [0, *(np.flatnonzero(differs) + 1).tolist(), count]
    for first, end in zip(starts, starts[1:]):
        if first == end:
            continue
        entry: dict[str, Any] = {"object": place.part, "name": name,
                                 **{word: int(column[first]) for word, column in columns.items()}}
        if matrices is not None:
            rows = matrices.reshape(-1, 4, 4)[first:end, :3]
            if len(rows) > _TABLE_ROWS:
                entry["matrices"] = _keep(files, _npy(rows), ".npy")
            else:
                entry["matrices"] = rows.reshape(-1, 12).tolist()
        yield entry


def _keep(files: list[File], data: Union[bytes, memoryview], ending: str) -> str:
    files.append(File(f"{len(files)}{ending}", data))
    return files[-1].name


def _ply(points: Array, corners: Array) -> bytes:
    """As the daemon makes it again of a mesh that it has (engine/assets/formats/part_file.h)."""
    faces = np.empty(len(corners), [("count", "u1"), ("corners", "<u4", 3)])
    faces["count"], faces["corners"] = 3, corners
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}element face {len(corners)}\n"
            "property list uchar uint vertex_indices\nend_header\n")
    return b"".join((head.encode(), points.astype("<f4").tobytes(), faces.tobytes()))


def _npz(arrays: dict[str, Array]) -> bytes:
    file = io.BytesIO()
    write_npz(file, arrays)
    return file.getvalue()


def _npy(rows: Array) -> bytes:
    file = io.BytesIO()
    np.save(file, rows, allow_pickle=False)
    return file.getvalue()
