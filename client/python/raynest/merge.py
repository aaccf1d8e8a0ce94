"""Joins the files of `raynest query|render|heatmap --part I/N`: `raynest merge OUT PARTS...`.

Each part says which scene (digest, epoch) and request it is of, and which rows it has. An .exr is the file of the
whole picture, byte by byte; a .png has its pixels, and a .npz its columns. Parts in .npz with the column position, or
sensor_position, also become a point cloud: a .ply, .pcd or .las. Parts in .png, and those of heat maps, also become a
.npy. Those of heat maps become a .png too, which raynestd draws. With --fail-if the limits of a heat map are checked.
"""
from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import re
import struct
import sys
import tempfile
import tokenize
import zipfile
import zlib
from typing import Any, Callable, Optional, Sequence

import numpy as np

from ._heat import check, limit_of, line_of, tell_exceeded
from ._pictures import Part, counts_of, filled, join_drawn, join_exr, join_npy, join_png, read_exr_part, read_png
from ._requests.columns import OF_HITS, REDUCED, USUAL
from ._requests.npz import write_npz
from ._told import carry_out, fail
from .errors import Error, FailedError, InvalidError, UsageError
from .points import ENDINGS, formatted, place_of

# Endings of files, and those of the parts that become one.
PARTS_OF = {".npz": (".npz",), ".png": (".png", ".exr"), ".exr": (".exr",), ".npy": (".png", ".exr"),
            **dict.fromkeys(ENDINGS, (".npz",))}
# Words for what parts may differ in, and the order in which that is told; the last one comes after all other keys.
FOREIGN = {"hash": ("scene", "its digest"), "epoch": ("epoch of the scene", "it"),
           "arithmetic": ("CPU, which rounds otherwise,", "its arithmetic"), "request": ("request", "the options' digest")}


def merge(out: str, paths: Sequence[str], limits: Sequence[str] = (), late: bool = False) -> tuple[str, dict[str, Any]]:
    """Joins parts into `out`; returns a line that says what it is, and one for each of the `limits` of --fail-if, and the
    document of --json. Raises InvalidError, which names the part, if one is missing, is there twice, or is of another
    request. `late` are parts of a lit picture: rows that none has are pixels without a sample, and the document counts
    them as `late`."""
    ending = os.path.splitext(out)[1].lower()
    if ending not in PARTS_OF:
        raise UsageError(f"{out}: parts become a .npz, a .png, an .exr, a .npy of pixels or counts, or a point cloud: a .ply, "
                         ".pcd or .las")
    if not paths:
        raise UsageError("name the parts behind the file that they become")
    of_parts = os.path.splitext(paths[0])[1].lower()
    if of_parts not in PARTS_OF[ending]:
        of_parts = PARTS_OF[ending][0]
    asked = [limit_of(text) for text in limits]
    if asked and of_parts != ".exr":
        raise UsageError("--fail-if is for the parts of a heat map, which are .exr")
    read, join, rows = _KINDS[of_parts]
    if ending in ENDINGS:
        join = functools.partial(_join_points, ending)
    elif ending == ".npy":
        join = join_npy
    elif ending == ".png" and of_parts == ".exr":
        join = join_drawn
    parts = []
    for path in paths:
        with contextlib.suppress(OSError):
            if os.path.samefile(path, out):
                raise UsageError(f"{out} is one of the parts: name another file for the whole")
        if os.path.splitext(path)[1].lower() != of_parts:
            raise InvalidError(f"{path}: does not end in {of_parts}, as " + (
                f"{out} does" if of_parts == ending else f"the parts of a {ending} do"), "FILE_INVALID")
        try:
            with open(path, "rb") as file:
                parts.append(read(path, file.read()))
        except OSError as error:
            raise InvalidError(f"{path}: {error.strerror}", "FILE_INVALID") from None
        except MemoryError:
            raise InvalidError(f"{path}: has more than fits into memory", "FILE_INVALID") from None
        except _DAMAGED as error:
            raise InvalidError(f"{path}: is no part, made with --part: {_why(error)}", "FILE_INVALID") from None
    parts.sort(key=lambda part: part.first)
    parts, missing = filled(parts) if late else (parts, 0)
    _check(parts, rows)
    folder, name = os.path.split(os.path.abspath(out))
    try:
        whole, what = join(parts)
        with tempfile.NamedTemporaryFile(dir=folder, prefix="." + name, delete=False) as file:
            try:
                whole(file) if callable(whole) else file.write(whole)
                file.flush()
                os.chmod(file.name, 0o666 & ~_umask())
                os.replace(file.name, out)
            except BaseException:
                os.unlink(file.name)
                raise
    except Error:
        raise
    except OSError as error:
        raise UsageError(f"cannot write {out}: {error.strerror}") from None
    except MemoryError:
        raise InvalidError(f"{out}: has more than fits into memory", "FILE_INVALID") from None
    except _DAMAGED as error:
        raise InvalidError(f"{parts[0].path} and the other parts become no {ending}: {_why(error)}", "FILE_INVALID") from None
    checks = check(asked, counts_of(parts)) if asked else []
    said = [f"{out}: {what} of {len(paths)} parts", *map(line_of, checks)]
    return "\n".join(said), {"file": out, "parts": len(paths), **({"checks": checks} if asked else {}),
                             **({"late": missing} if late else {})}


# The errors of what reads and joins files that were damaged, or made by others.
_DAMAGED = (struct.error, zlib.error, zipfile.BadZipFile, EOFError, ValueError, LookupError, TypeError, AttributeError,
            ArithmeticError, RuntimeError, tokenize.TokenError)


def _why(error: Exception) -> str:
    """Others than our own and numpy's say where in the file they were found, and not what is wrong with it."""
    return str(error) if type(error) is ValueError else "it is damaged, or has been cut"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _check(parts: Sequence[Part], rows: str) -> None:
    first = before = parts[0]
    end = 0
    for part in parts:
        differing = [key for key in first.request.keys() | part.request.keys()
                     if first.request.get(key) != part.request.get(key)]
        if [key.removeprefix("raynest:") for key in differing] == ["request"] and part.of != first.of:
            differing = []      # as a picture of another size has
        if differing:
            key = min(differing, key=_place)
            what, named = FOREIGN.get(key.removeprefix("raynest:"), ("request", key.removeprefix("raynest:")))
            raise InvalidError(f"{part.path} is of another {what} than {first.path}: {named} is "
                               f"{_short(part.request.get(key))}, not {_short(first.request.get(key))}", "FILE_INVALID")
        if part.of != first.of:
            raise InvalidError(f"{part.path} is of another range than {first.path}: of {part.of} {rows}, not {first.of}",
                               "FILE_INVALID")
        if part.first < end:
            raise InvalidError(f"{part.path} has {rows} that {before.path} has too: {part.first} to "
                               f"{min(end, part.first + part.rows) - 1}", "FILE_INVALID")
        before = part
        if part.first > end:
            raise InvalidError(f"a part is missing: {rows} {end} to {part.first - 1} of {part.of}", "FILE_INVALID")
        end = part.first + part.rows
    if end != first.of:
        raise InvalidError(f"a part is missing: {rows} {end} to {first.of - 1} of {first.of}", "FILE_INVALID")


def _place(key: str) -> tuple[int, str]:
    """Scenes are compared before requests: what differs first says most. A digest says no more than that they differ."""
    key = key.removeprefix("raynest:")
    order = list(FOREIGN)
    return (order.index(key) - len(order) if key in order[:-1] else key == order[-1]), key


def _short(value: Any) -> str:
    if value is None:
        return "left out"
    text = json.dumps(value) if not isinstance(value, str) else value
    if re.fullmatch("[0-9a-f]{64}", text):
        return text[:12]
    return text if len(text) <= 60 else text[:57] + "..."


# ---- columns ------------------------------------------------------------------------------------

def _read_npz(path: str, data: bytes) -> Part:
    if not data.startswith(b"PK"):
        raise ValueError("it is empty, or no .npz")
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        columns = {name: file[name] for name in file.files}
    if "part" not in columns:
        raise ValueError("it does not say which part it is")
    said = json.loads(columns.pop("part").tobytes().decode())
    first, count, of = (int(said.pop(key)) for key in ("first", "count", "of"))
    if not 0 <= first <= first + count <= of:
        raise ValueError("its range is none")
    fields = said.get("fields", [])
    if not (isinstance(said.get("reduce", ""), str) and isinstance(fields, list)
            and all(isinstance(name, str) for name in fields)):
        raise ValueError("its request has fields or a reduce that are none")
    if said.get("reduce") == "visible_pixels":
        if not columns:     # no ray of the part has hit anything
            columns = {name: np.zeros(0, dtype) for name, (dtype, _) in REDUCED["visible_pixels"].items()}
        if set(columns) != set(REDUCED["visible_pixels"]):
            raise ValueError(f"its columns are not {' and '.join(REDUCED['visible_pixels'])}")
        each = _check_rows(columns, columns["path"].size)
    else:
        each = _check_rows(columns, count)
    return Part(path, first, count, of, said, (columns, each if count else None))


def _check_rows(columns: dict[str, Any], count: int) -> int:
    """Returns how many rows there are for each of so many rays, or points with several rays. A part that was cut or
    altered would move the rows of all parts behind it."""
    splits = columns.get("ray_splits")
    if splits is not None and (splits.ndim != 1 or splits.dtype.kind not in "iu" or not splits.size or splits[0] != 0
                               or (splits[1:] < splits[:-1]).any()):
        raise ValueError("its ray_splits do not rise")
    if not columns:
        raise ValueError("it has no columns")
    rows = _row_count(columns)
    if rows % max(1, count) or (rows and not count):
        raise ValueError(f"it has {rows} rows for {count} rays or points")
    for name, column in columns.items():
        most = rows + 1 if name == "ray_splits" else rows if splits is None or name not in OF_HITS else int(splits[-1])
        if column.shape[:1] != (most,) or column.dtype not in _TYPES:
            raise ValueError(f"its column {name} has not {most} rows of numbers")
        dtype, shape = USUAL.get(name, (column.dtype, column.shape[1:]))
        if (column.dtype, column.shape[1:]) != (dtype, shape):
            raise ValueError(f"its column {name} has rows of {column.dtype} {column.shape[1:]}, and not of {dtype} {shape}")
    return rows // max(1, count)


_TYPES = {dtype for dtype, _ in USUAL.values()}


def _row_count(columns: dict[str, Any]) -> int:
    return len(columns["ray_splits"]) - 1 if "ray_splits" in columns else len(next(iter(columns.values())))


def _join_npz(parts: Sequence[Part]) -> tuple[Any, str]:
    columns = _joined_columns(parts)
    rows = _row_count(columns)
    if "hit" not in parts[0].request.get("fields", ["hit"]):
        columns.pop("hit", None)    # which parts have for those that make points of them
    return lambda file: write_npz(file, columns), f"{rows:,} rows"


def _join_points(ending: str, parts: Sequence[Part]) -> tuple[bytes, str]:
    """The points that were hit, as `raynest query` would have written them for all rays."""
    columns, fields = _joined_columns(parts), parts[0].request.get("fields", ())
    place = place_of(columns)
    if not place:
        raise UsageError("these parts are no point cloud: each needs position, or sensor_position, among its --fields")
    if not columns.keys() & {"hit", "ray_splits"}:
        raise UsageError("these parts do not say which rays have hit: make them again, with hit among their --fields")
    splits, where = columns.pop("ray_splits", None), columns.get("hit")
    if "hit" not in fields:
        columns.pop("hit", None)
    if splits is not None:
        counts = np.diff(splits)
        columns = {name: column if name in OF_HITS else np.repeat(column, counts, axis=0) for name, column in columns.items()}
        columns["return"] = (np.arange(splits[-1]) - np.repeat(splits[:-1], counts)).astype(np.uint16)
        columns["returns"] = np.repeat(counts, counts).astype(np.uint16)
    # The sensor's columns stand behind those of the daemon.
    order = sorted(columns, key=lambda name: (
        name not in fields, name in ("ring", "time"), name in fields and fields.index(name)))
    data, count = formatted(ending, columns[place], where, {name: columns[name] for name in order if name != place})
    return data, f"{count:,} points"


def _joined_columns(parts: Sequence[Part]) -> dict[str, Any]:
    found = [part.body[0] for part in parts]
    forms = [{name: (column.dtype, column.shape[1:]) for name, column in columns.items()} for columns in found]
    rows = next((part.body[1] for part in parts if part.rows), None)
    for part, form in zip(parts, forms):
        if form != forms[0] or part.body[1] not in (None, rows) and parts[0].request.get("reduce") != "visible_pixels":
            raise InvalidError(f"{part.path} has other columns than {parts[0].path}", "FILE_INVALID")
    return joined(found, str(parts[0].request.get("reduce", "")))


def joined(found: Sequence[dict[str, Any]], reduce: str = "") -> dict[str, Any]:
    """The columns of all parts of a request, in the order of its rays."""
    names = set(found[0])
    if any(set(columns) != names for columns in found):
        raise InvalidError("the parts have other columns", "FILE_INVALID")
    if reduce == "visible_pixels":
        return summed(found, reduce)
    whole = {}
    for name in found[0]:
        pieces = [columns[name] for columns in found]
        if name == "ray_splits":
            steps = np.concatenate([np.diff(piece) for piece in pieces])
            if sum(int(piece[-1]) for piece in pieces) > np.iinfo(steps.dtype).max:
                raise InvalidError("the parts have more hits than are counted", "LIMIT_EXCEEDED")
            whole[name] = np.concatenate([np.zeros(1, steps.dtype), np.cumsum(steps)])
        else:
            whole[name] = np.concatenate(pieces)
    return whole


def summed(found: Sequence[dict[str, Any]], reduce: str) -> dict[str, Any]:
    """Rows of one key are added up, and sorted by it, as the daemon does."""
    key, value = REDUCED[reduce]
    keys, where = np.unique(np.concatenate([columns[key] for columns in found]), return_inverse=True)
    sums = np.zeros(len(keys), np.uint64)
    np.add.at(sums, where, np.concatenate([columns[value] for columns in found]).astype(np.uint64))
    most = np.iinfo(REDUCED[reduce][value][0]).max
    if sums.size and sums.max() > most:
        raise InvalidError(f"the parts have {sums.max()} {value} of one {key} in all, and at most {most} are counted",
                           "LIMIT_EXCEEDED")
    return {key: keys, value: sums.astype(REDUCED[reduce][value][0])}


# By the ending of parts: how one is read; how they are joined, which returns the file's bytes or what writes them, and
# what it has; and what parts have rows of.
_KINDS: dict[str, tuple[Callable[[str, bytes], Part], Callable[[Sequence[Part]], tuple[Any, str]], str]] = {
    ".npz": (_read_npz, _join_npz, "rows"), ".png": (read_png, join_png, "rows of pixels"),
    ".exr": (read_exr_part, join_exr, "rows of pixels")}


def main(words: Optional[Sequence[str]] = None) -> int:
    """The command `raynest merge [--json] [--fail-if LIMIT]... OUT PARTS...`. Returns its exit code."""
    given = list(sys.argv[1:] if words is None else words)
    as_json = given[:1] == ["--json"]
    del given[:as_json]
    limits = []
    while given[:1] == ["--fail-if"]:
        limits.append(given[1])
        del given[:2]
    out, *paths = given

    done: list[tuple[str, dict[str, Any]]] = []

    def work() -> list[tuple[str, dict[str, Any]]]:
        done.append(merge(out, paths, limits))
        return done
    try:
        code = carry_out(work, as_json)
        sys.stdout.flush()
        return code or tell_exceeded(done[0][1], as_json)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the end of Python would try again
        return fail(FailedError(f"cannot write to stdout: {error.strerror}"), 1, as_json)


if __name__ == "__main__":
    sys.exit(main())
