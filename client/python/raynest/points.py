"""Point clouds as files: PLY, PCD and LAS, binary."""
from __future__ import annotations

import math
import os
import re
import struct
from typing import Any, Collection, Mapping, Union

import numpy as np

from ._net.frame import Array
from ._requests.arguments import numbers
from .errors import UsageError

ENDINGS = (".ply", ".pcd", ".las")
_PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint",
              "f4": "float", "f8": "double"}
# float32 tells millimetres apart up to here.
_FLOAT32_MOST = 1e4
_LAS_HEADER_BYTES = 227
_LAS_POINT = [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("classification", "u1"),
              ("angle", "i1"), ("user", "u1"), ("source", "<u2"), ("time", "<f8")]
_RGB = ("red", "green", "blue")
_LAS_COLUMNS = ("time", "intensity", "reflectance", "return", "returns", "ring", "classification", "base_colour")


def save(path: Union[str, os.PathLike[str]], position: Any, /, *, where: Any = None, **columns: Any) -> int:
    """Writes points (N, 3) to a .ply, .pcd or .las, with columns beside them: (N,), or (N, k), which become name_0,
    name_1, ... But `normal` and `base_colour` (N, 3) have the names under which other programs read them: nx ny nz and
    red green blue in a PLY, normal_x normal_y normal_z and a packed rgb in a PCD. `base_colour` is linear, as in an answer,
    and sRGB of 8 bits in the file. `where` (N,) chooses the points, such as the column hit. Points that are not finite are
    left out. LAS has room for the columns time (GPS time), intensity or reflectance (0 to 1), return (from 0, at most
    4), returns (of the same pulse), ring (as user data), classification (0 to 31) and base_colour (of 16 bits); other
    columns are refused for it. Returns the number of points."""
    name = os.fspath(path)
    ending = os.path.splitext(name)[1].lower()
    if ending not in ENDINGS:
        raise UsageError(f"'{name}' is no point cloud that can be written: the name must end with .ply, .pcd or .las")
    data, count = formatted(ending, position, where, columns)
    with open(path, "wb") as file:
        file.write(data)
    return count


def place_of(columns: Collection[str]) -> str:
    """Which of these columns is where the points stand; "" if none is."""
    return next((name for name in ("position", "sensor_position") if name in columns), "")


def formatted(ending: str, position: Any, where: Any, columns: Mapping[str, Any]) -> tuple[bytes, int]:
    """The file of this ending that save() writes, and the number of its points."""
    points = numbers("position", position).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise UsageError(f"position has shape {points.shape}: it must be (N, 3)")
    chosen = np.isfinite(points).all(axis=1)
    if where is not None:
        mask = np.asarray(where)
        if mask.shape != (len(points),):
            raise UsageError(f"where has shape {mask.shape}: it must be ({len(points)},)")
        chosen &= mask.astype(bool)
    flat: dict[str, Array] = {}
    for key, values in columns.items():
        column = np.asarray(values)
        if not re.fullmatch(r"\w+", key, re.ASCII):
            raise UsageError(f"a column cannot be called {key!r}: its name must be of letters, digits and _")
        if column.ndim not in (1, 2) or len(column) != len(points) or column.dtype.kind not in "biuf":
            raise UsageError(f"{key} has shape {column.shape} and type {column.dtype}: it must be numbers, "
                             f"({len(points)},) or ({len(points)}, k)")
        if ending == ".las" and (key not in _LAS_COLUMNS or column.shape[1:] != ((3,) if key == "base_colour" else ())):
            raise UsageError(f"a .las has no room for the column '{key}': save it as .ply or .pcd, or leave it away")
        parts = _parts(ending, key, column[chosen])
        if taken := [part for part in parts if part in ("x", "y", "z") or part in flat]:
            raise UsageError(f"a column cannot be called {taken[0]!r}: there is one already")
        flat.update((part, _plain(part, values)) for part, values in parts.items())
    write = {".ply": _write_ply, ".pcd": _write_pcd, ".las": _write_las}[ending]
    return write(points[chosen], flat), int(chosen.sum())


def _parts(ending: str, key: str, column: Array) -> dict[str, Array]:
    """The columns of one number each that a file of this ending has for a column."""
    if column.ndim == 1:
        # Readers take an intensity as float32 alone.
        return {key: column.astype("<f4") if key == "intensity" and column.dtype.kind == "f" else column}
    if key == "normal" and column.shape[1] == 3:
        names = ("normal_x", "normal_y", "normal_z") if ending == ".pcd" else ("nx", "ny", "nz")
        return dict(zip(names, column.T.astype("<f4")))
    if key == "base_colour" and column.shape[1] == 3:
        most = 65535 if ending == ".las" else 255
        shades = np.rint(_srgb(column) * most).astype("<u2" if ending == ".las" else "u1").T
        if ending != ".pcd":
            return dict(zip(_RGB, shades))
        red, green, blue = shades.astype("<u4")
        return {"rgb": (red << 16 | green << 8 | blue).view("<f4")}
    return {f"{key}_{i}": column[:, i] for i in range(column.shape[1])}


def _srgb(linear: Array) -> Array:
    share = np.clip(np.nan_to_num(linear.astype(np.float64)), 0, 1)
    encoded: Array = np.where(share <= 0.0031308, share * 12.92, 1.055 * share ** (1 / 2.4) - 0.055)
    return encoded


def _plain(name: str, column: Array) -> Array:
    """A column in a type that all formats know."""
    if column.dtype.kind == "b":
        return column.astype("u1")
    if column.dtype.itemsize == 8 and column.dtype.kind in "iu":
        small = column.astype("<u4" if column.dtype.kind == "u" else "<i4")
        if (small != column).any():
            raise UsageError(f"{name} has numbers beyond 32 bits, which these files cannot hold")
        return small
    return column.astype(column.dtype.newbyteorder("<")) if column.dtype != np.float16 else column.astype("<f4")


def _table(points: Array, columns: dict[str, Array], real: str) -> Array:
    table = np.empty(len(points), [(axis, real) for axis in "xyz"]
                     + [(name, column.dtype.str) for name, column in columns.items()])
    for axis, values in zip("xyz", points.T):
        table[axis] = values
    for name, column in columns.items():
        table[name] = column
    return table


def _write_ply(points: Array, columns: dict[str, Array]) -> bytes:
    table = _table(points, columns, "<f8")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    for name in table.dtype.names or ():
        kind = table.dtype[name]
        lines.append(f"property {_PLY_TYPES[kind.kind + str(kind.itemsize)]} {name}")
    return "\n".join((*lines, "end_header\n")).encode() + table.tobytes()


def _write_pcd(points: Array, columns: dict[str, Array]) -> bytes:
    # Many readers take float32 alone.
    far = len(points) and np.abs(points).max() > _FLOAT32_MOST
    table = _table(points, columns, "<f8" if far else "<f4")
    kinds = [table.dtype[name] for name in table.dtype.names or ()]
    letter = {"f": "F", "u": "U", "i": "I"}
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7",
             "FIELDS " + " ".join(table.dtype.names or ()),
             "SIZE " + " ".join(str(kind.itemsize) for kind in kinds),
             "TYPE " + " ".join(letter[kind.kind] for kind in kinds),
             "COUNT " + " ".join("1" for _ in kinds), f"WIDTH {len(table)}", "HEIGHT 1",
             "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(table)}", "DATA binary\n"]
    return "\n".join(lines).encode() + table.tobytes()


def _within(name: str, column: Array, most: int) -> Array:
    """The column in float64, if all of it lies in 0 to `most`."""
    values = column.astype(np.float64)
    if not ((values >= 0) & (values <= most)).all():
        raise UsageError(f"a .las holds the column '{name}' from 0 to {most} alone: save it as .ply or .pcd, or leave it away")
    return values


def _write_las(points: Array, columns: dict[str, Array]) -> bytes:
    """LAS 1.2, point format 1, or with colours 3."""
    colours = [(name, "<u2") for name in _RGB if name in columns]
    table = np.zeros(len(points), [*_LAS_POINT, *colours])
    low = points.min(axis=0) if len(points) else np.zeros(3)
    high = points.max(axis=0) if len(points) else np.zeros(3)
    offset = np.floor(low)
    # As the command does: numpy's powers may differ in the last bit.
    scale = np.array([math.pow(10.0, math.ceil(math.log10(max(1e-9, step / 2**30)))) for step in high - offset])
    for axis, values in zip("xyz", np.rint((points - offset) / scale).T):
        table[axis] = values
    number = _within("return", columns.get("return", np.zeros(len(points))), 4).astype("u1") + np.uint8(1)
    # Where it is not said which points are of one pulse, each is said to have as many as any has.
    of_pulse = _within("returns", columns.get("returns", np.full(len(points), number.max(initial=1))), 5).astype("u1")
    if (of_pulse < number).any():
        raise UsageError("a point has a 'return' beyond the number of 'returns' of its pulse")
    table["returns"] = number | of_pulse << 3
    if {"intensity", "reflectance"} <= columns.keys():
        raise UsageError("a .las holds one of the columns 'intensity' and 'reflectance'")
    for name, column in columns.items():
        if name == "time":
            table["time"] = column
        elif name in ("intensity", "reflectance"):
            table["intensity"] = np.rint(_within(name, column, 1) * 65535)
        elif name == "classification":
            table["classification"] = _within(name, column, 31)
        elif name == "ring":
            table["user"] = _within(name, column, 255)
        elif name in _RGB:
            table[name] = column
    by_return = np.bincount((table["returns"] & 7) - 1, minlength=5)[:5] if len(table) else np.zeros(5, int)
    header = struct.pack("<4sHH16sBB32s32sHHHIIBHI5I", b"LASF", 0, 0, bytes(16), 1, 2, b"RayNest", b"RayNest", 0, 0,
                         _LAS_HEADER_BYTES, _LAS_HEADER_BYTES, 0, 3 if colours else 1, table.dtype.itemsize, len(table),
                         *(int(count) for count in by_return))
    header += struct.pack("<12d", *scale, *offset, high[0], low[0], high[1], low[1], high[2], low[2])
    return header + table.tobytes()
