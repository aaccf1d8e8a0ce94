"""The arguments of Client.scene_of(): parts of several kinds, and the places where they stand."""
from __future__ import annotations

import difflib
import graphlib
import itertools
import reprlib
from typing import Any, Mapping, NamedTuple, Optional

import numpy as np

from .arguments import array_of, check_name, float32, numbers, user_ids, whole_numbers
from .materials import Mesh, distinct
from .._net.frame import Array
from ..errors import UsageError

_ALL = 2**32 - 1    # the mask of what every ray may enter
_EXAMPLES = 5       # names of parts in an error


class Records:
    """A part of scene_of() whose primitives are no triangles: `rows` (N, M) are records of the type `primitive`, as in
    load(). The column prim is a row of them."""

    def __init__(self, primitive: str, rows: Any) -> None:
        if not isinstance(primitive, str) or not primitive:
            raise TypeError(f"primitive of {reprlib.repr(primitive)}: it must be the name of a record type, as 'sphere'")
        self.primitive = primitive
        self.rows = _rows("rows", rows)

    def __repr__(self) -> str:
        return f"<raynest.{type(self).__name__}: {len(self.rows)} of {self.primitive!r}>"


class Spheres(Records):
    """A part of scene_of(): spheres about `centres` (N, 3), with one of `radii` for all, or one for each (N,). The column
    prim is a row of them."""

    def __init__(self, centres: Any, radii: Any) -> None:
        points, sizes = _rows("centres", centres, 3), numbers("radii", radii)
        if sizes.shape not in ((), points.shape[:1]):
            raise UsageError(f"radii has shape {sizes.shape}: it must be one number, or ({len(points)},), one for each of the "
                             "centres")
        sent = float32(sizes)
        if not (np.isfinite(sent).all() and (sent > 0).all()):
            raise UsageError("radii must be finite numbers above 0, also in float32")
        rows = np.empty((len(points), 4), np.result_type(points, np.float32))
        rows[:, :3], rows[:, 3] = points, sizes
        super().__init__("sphere", rows)


class Place:
    """Where a part of scene_of() stands, with more than ("car", matrices) can say. `matrices` are those, by default none.
    `mask`, `uid` and `visible` are one value for all of several places, or (N,), one for each: rays whose mask shares
    no bit with `mask` do not enter; hits inside report the `uid` of the outermost place; what is not visible has the
    mask 0, as after Edit.hide()."""

    def __init__(self, part: str, matrices: Any = None, *, mask: Any = None, uid: Any = None, visible: Any = True) -> None:
        self.part = part
        self.matrices = None if matrices is None else matrices_of("matrices", matrices)
        count = len(self.matrices) if self.matrices is not None and self.matrices.ndim == 3 else 1
        self.mask = None if mask is None else _each("mask", whole_numbers("mask", mask, _ALL), count)
        self.uid = None if uid is None else _each("uid", user_ids("uid", uid), count)
        seen = array_of("visible", visible)
        if seen.dtype != bool:
            raise TypeError(f"visible of {reprlib.repr(visible)}: it must be True or False, or one of these for each place")
        if not _each("visible", seen, count).all():
            self.mask = np.where(seen, _ALL if self.mask is None else self.mask, 0)

    def __repr__(self) -> str:
        return f"<raynest.Place of {self.part!r}>"


class Parts(NamedTuple):
    """The makings of a scene, checked."""

    meshes: dict[str, Mesh]
    records: dict[str, Records]
    groups: dict[str, dict[str, Place]]
    places: dict[str, Place]    # in the scene itself

    @property
    def are_meshes(self) -> bool:
        """True if there is nothing but triangles at places that say only where they are."""
        return (not self.groups and not self.records and
                all(place.mask is None and place.uid is None for place in self.places.values()))


def read_parts(parts: Mapping[str, Any], places: Optional[Mapping[str, Any]]) -> Parts:
    if not isinstance(parts, Mapping) or not parts:
        raise TypeError("parts must be a dict of meshes, spheres, records and groups: {'car': (vertices, faces), ...}")
    if places is not None and not isinstance(places, Mapping):
        raise TypeError(f"places of {reprlib.repr(places)}: it must be a dict: {{'ground': 'ground', 'car': ('car', matrices)}}")
    made = Parts({}, {}, {}, {})
    for name, part in parts.items():
        check_name("a part", name)
        if isinstance(part, Records):
            made.records[name] = part
        elif not isinstance(part, Mapping):
            made.meshes[name] = _mesh(name, part)
        else:
            made.groups[name] = {
                text: _place(f"{text!r} in the group {name!r}", text, place, parts) for text, place in part.items()}
            if not part:
                raise UsageError(f"the group {name!r} is empty: give it places, as {{'wheel': ('wheel', matrices)}}")
    distinct(made.meshes.values())
    held = {name: [place.part for place in group.values()] for name, group in made.groups.items()}
    try:
        graphlib.TopologicalSorter(held).prepare()
    except graphlib.CycleError as error:
        way = " > ".join(map(repr, reversed(error.args[1])))
        raise UsageError(f"the group {error.args[1][0]!r} holds itself: {way}") from None
    if places is None:
        placed = {part for group in held.values() for part in group}
        places = {part: part for part in parts if part not in placed}
    made.places.update({text: _place(repr(text), text, place, parts) for text, place in places.items()})
    return made


_IDENTITY = np.eye(4)


def matrices_of(what: str, value: Any, offsets: bool = True) -> Array:
    """Returns a (4, 4) or (N, 4, 4) of float64: from offsets (3,) and (N, 3), where these are taken, or matrices (3, 4),
    (4, 4), (N, 3, 4) and (N, 4, 4)."""
    given = numbers(what, value).astype(np.float64)
    shape = given.shape
    rows, columns = shape[-2:] if len(shape) >= 2 else (0, 0)
    if offsets and (shape == (3,) or (len(shape) == 2 and columns == 3)):
        made = np.empty(shape[:-1] + (4, 4))
        made[...] = _IDENTITY
        made[..., :3, 3] = given
    elif len(shape) in (2, 3) and columns == 4 and rows in (3, 4):
        made = np.zeros(shape[:-2] + (4, 4))
        made[..., 3, 3] = 1
        made[..., :rows, :] = given
    else:
        one, each = ("(3,), ", "(N, 3), ") if offsets else ("", "")
        raise UsageError(f"{what} has shape {shape}: it must be {one}(3, 4) or (4, 4), or {each}(N, 3, 4) "
                         f"or (N, 4, 4) for several{'' if offsets else '; move() takes offsets'}")
    if rows == 4 and not (made[..., 3, :] == (0, 0, 0, 1)).all():
        raise UsageError(f"{what}: the last row of a 4x4 matrix must be 0 0 0 1")
    if not np.isfinite(given).all():
        raise UsageError(f"{what} has numbers that are not finite")
    return made


def _mesh(name: str, part: Any) -> Mesh:
    if isinstance(part, Mesh):
        return part
    if hasattr(part, "vertices") and hasattr(part, "faces"):
        return Mesh(part.vertices, part.faces)
    if not isinstance(part, (tuple, list)) or len(part) != 2:
        raise TypeError(f"the part {name!r} must be (vertices, faces), or have both; raynest.Mesh, Spheres or Records; or a "
                        "group, a dict of places")
    return Mesh(part[0], part[1])


def _place(where: str, name: Any, place: Any, parts: Mapping[str, Any]) -> Place:
    check_name("a place", name)
    if isinstance(place, Place):
        made = place
    else:
        part, matrices = place if isinstance(place, tuple) and len(place) == 2 else (place, None)
        made = Place(part, None if matrices is None else matrices_of(f"the place {where}", matrices))
    if not isinstance(made.part, str) or made.part not in parts:
        raise UsageError(f"the place {where} is of {reprlib.repr(made.part)}, which is no part{_instead(made.part, parts)}")
    if made.matrices is not None:
        lost = np.flatnonzero(_singular(made.matrices))
        if lost.size:
            which = f"number {lost[0]} of the place {where}" if made.matrices.ndim == 3 else f"the place {where}"
            raise UsageError(f"{which} is singular: a scale of 0 leaves no way to bring rays into its space")
    return made


def _instead(part: Any, parts: Mapping[str, Any]) -> str:
    near = difflib.get_close_matches(part, parts, 1) if isinstance(part, str) else []
    if near:
        return f": did you mean {near[0]!r}?"
    more = f" and {len(parts) - _EXAMPLES} more" if len(parts) > _EXAMPLES else ""
    return "; there are " + ", ".join(map(repr, itertools.islice(parts, _EXAMPLES))) + more


def _singular(matrices: Array) -> Array:
    """True for matrices (..., 4, 4) that the daemon cannot invert: as float32, their determinant is not above the
    rounding of its terms."""
    first, second, third = np.moveaxis(float32(matrices[..., :3, :3]).astype(np.float64), -2, 0)
    plus = first * np.roll(second, -1, -1) * np.roll(third, -2, -1)
    minus = first * np.roll(second, -2, -1) * np.roll(third, -1, -1)
    size = (np.abs(plus) + np.abs(minus)).sum(-1)
    with np.errstate(invalid="ignore"):
        fits: Array = np.abs((plus - minus).sum(-1)) > 4 * np.finfo(np.float64).eps * size
    return ~fits


def _rows(what: str, rows: Any, width: Optional[int] = None) -> Array:
    found = numbers(what, rows)
    if found.ndim != 2 or not found.size or width not in (None, found.shape[1]):
        raise UsageError(f"{what} has shape {found.shape}: it must be (N, {width or 'M'}), with a row or more")
    if not np.isfinite(float32(found)).all():
        raise UsageError(f"{what} has numbers that are not finite in float32")
    return found


def _each(what: str, values: Array, count: int) -> Array:
    if values.shape not in ((), (count,)):
        raise UsageError(f"{what} has shape {values.shape}: for {count} place{'s' * (count != 1)} it must be one value, or "
                         f"({count},)")
    return values
