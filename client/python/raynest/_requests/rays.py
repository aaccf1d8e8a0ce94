"""Converts rays from the forms that users have to the forms on the wire.

On the wire rays are float32 rows: (n, 8) [ox oy oz tmin dx dy dz tmax], (n, 6) [ox oy oz dx dy dz]
with a common range, or (n, 3) [dx dy dz] with a common origin too. Arrays in one of these forms are
sent without a copy. All others are converted frame by frame while they are sent, so that no second
copy of all rays ever exists.
"""
from __future__ import annotations

import dataclasses
import math
import reprlib
from typing import Any, Callable, Iterable, Mapping, Optional

import numpy as np

from .._net.control import Message
from .._net.frame import Array
from ..errors import UsageError
from .arguments import float32, is_several, numbers, whole_numbers
from .job import JobOptions


@dataclasses.dataclass(frozen=True)
class Starts:
    """Where rays start, of the dtype in which the caller has it: (n, 3), or (1, 3) for all rays."""

    points: Array
    count: int                          # number of rays
    shift: Optional[Array]              # is subtracted from them, in float64
    given: str = "rays"                 # what the caller passes them in

    def moved(self, first: int, count: int) -> Array:
        """Returns how far float32 moves each of the points; for float32 input, half a step of it."""
        points = self.points[first:first + count]
        with np.errstate(over="ignore", invalid="ignore"):
            if points.dtype == np.float32:
                return half_step(points)
            exact = points - (0.0 if self.shift is None else self.shift)
            off: Array = exact.astype(np.float32) - exact
        steps: Array = np.sqrt((off * off).sum(1))
        return steps


class Rays:
    """Rays, checked for their shape only: the daemon answers an invalid ray with a miss and flag 1.
    `tmin` and `tmax` hold for rays without a range of their own."""

    def __init__(self, rays: Any, directions: Any = None, origin: Any = None, *, tmin: float = 0.0,
                 tmax: float = math.inf) -> None:
        # Without an origin to subtract, float32 is sent without a copy.
        shift = np.zeros(3) if origin is None else vector("origin", origin)
        self._shift = shift if shift.any() else None
        self._origins: Optional[Array]          # per ray; None if all have one
        self._rows: Optional[Array] = None      # the array, if rays came as one
        self.common: Message = {"tmin": tmin, "tmax": 0.0 if math.isinf(tmax) else tmax}
        first = numbers("rays", rays)
        if directions is None and first.ndim == 1:  # one ray, or []
            first = first[None] if first.size else np.empty((0, 6), np.float32)
        if directions is not None:
            self._origins, self._rest = pair(first, directions)
            if first.shape == (3,):
                self._origins, self._rows = None, self._rest
                self.common["origin"] = float32(self._shifted(first)).tolist()
        elif first.ndim == 2 and first.shape[1] in (6, 8):
            self._origins, self._rest = first[:, :3], first[:, 3:]
            self._rows = first if self._shift is None else None
            if first.shape[1] == 8:
                self.common = {}
        else:
            raise UsageError(f"rays of shape {np.shape(rays)}: they must be (N, 6) [ox oy oz dx dy "
                             "dz], (N, 8) [ox oy oz tmin dx dy dz tmax], or origins and directions")
        self.count = len(self._rest)
        self.starts = Starts(first[None] if "origin" in self.common else (
            self._rest[:0] if self._origins is None else self._origins), self.count, self._shift)
        self.width = self._rest.shape[1] + (0 if self._origins is None else 3)

    def frame(self, first: int, count: int) -> Array:
        """Returns rays [first, first + count) in their form on the wire."""
        part = slice(first, first + count)
        rows = None if self._rows is None else self._rows[part]
        if rows is not None and rows.dtype == np.float32 and rows.flags.c_contiguous:
            return rows
        out = np.empty((count, self.width), np.float32)
        # Values beyond float32 become infinite; the daemon then flags the ray.
        with np.errstate(over="ignore", invalid="ignore"):
            if self._origins is not None:
                out[:, :3] = self._shifted(self._origins[part])
            out[:, self.width - self._rest.shape[1]:] = self._rest[part]
        return out

    def _shifted(self, points: Array) -> Array:
        """Subtracts the origin in float64, before digits are lost."""
        if self._shift is None:
            return points
        with np.errstate(over="ignore", invalid="ignore"):
            shifted: Array = points - self._shift
        return shifted


@dataclasses.dataclass(frozen=True)
class Source:
    """The rays of a query: sent, or made by the daemon."""

    sent: Rays                              # the rays, or the points that rays start from
    count: int                              # number of rays that will be traced
    generator: Optional[Message] = None     # makes the rays in the daemon
    stands: Optional[Starts] = None         # where it stands, if the caller says it
    part: tuple[int, int] = (0, 0)          # the generator's rays, a hemisphere's points: first, count
    upload: Optional[Array] = None          # bytes of a trajectory, which follow the request
    masks: Optional[Array] = None           # for each ray or point that is sent, uint32
    # Columns that follow from the rays' numbers.
    own: Mapping[str, Callable[[], Array]] = dataclasses.field(default_factory=dict)

    @property
    def starts(self) -> Starts:
        return self.stands or self.sent.starts

    def own_columns(self, fields: Any) -> tuple[Any, dict[str, Array]]:
        """Returns the fields that the daemon is asked for, and those of `own` that were among them."""
        names = (fields,) if isinstance(fields, str) else fields
        if not self.own or not isinstance(names, Iterable):
            return fields, {}
        asked = list(names)
        rest = [name for name in asked if name not in self.own]
        if not rest and asked:
            raise UsageError(f"{' and '.join(asked)} follow from the rays alone: ask for a column of the scene too")
        return rest, {name: self.own[name]() for name in asked if name in self.own}


def masked(source: Source, job: JobOptions) -> tuple[Source, JobOptions]:
    """Returns both with the mask of each ray in the source, if the options have an array of them."""
    given = job.get("mask")
    if not is_several("mask", given):
        return source, job
    if source.count and not source.sent.count:
        raise UsageError("the daemon makes these rays, which have one mask: pass a number")
    if np.asarray(given).dtype == bool:
        raise UsageError("mask of bools: it must be the bits of each ray, as whole numbers")
    masks = whole_numbers("mask", given, 2**32 - 1)
    if masks.shape != (source.sent.count,):
        raise UsageError(f"mask of shape {masks.shape} for {source.sent.count} rays: it must be one number, or "
                         "one for each ray")
    return (dataclasses.replace(source, masks=masks.astype(np.uint32)),
            {key: value for key, value in job.items() if key != "mask"})  # type: ignore[return-value]


def half_step(points: Array) -> Array:
    """Returns half a step between float32 numbers as large as each point's largest coordinate: the
    most by which rounding may have moved it."""
    steps: Array = np.spacing(np.abs(points.astype(np.float32)).max(1)) / 2
    return steps


def vector(what: str, value: Any) -> Array:
    """Returns three finite float64."""
    out = numbers(what, value).astype(np.float64)
    if out.shape != (3,):
        raise UsageError(f"{what} has the shape {out.shape}: it must be three numbers")
    if not np.isfinite(out).all():
        raise UsageError(f"{what} of {reprlib.repr(value)}: it must be three finite numbers")
    return out


def flat_pairs(first: Any, second: Any) -> tuple[Array, Array, tuple[int, ...]]:
    """Returns both, and the shape of the answer. Points of more than two dimensions are broadcast
    and become (N, 3)."""
    a, b = numbers("points", first), numbers("points", second)
    if max(a.ndim, b.ndim) <= 2:
        return a, b, (-1,)
    try:
        a, b = np.broadcast_arrays(a, b, subok=True)
    except ValueError:
        raise UsageError(f"shapes {a.shape} and {b.shape} do not fit together") from None
    if a.shape[-1] != 3:
        raise UsageError(f"points must be (..., 3), not {a.shape}")
    return a.reshape(-1, 3), b.reshape(-1, 3), a.shape[:-1]


def spread(what: str, values: Any, shape: tuple[int, ...]) -> Array:
    """Returns a value for each of the pairs, as flat_pairs() orders them."""
    try:
        return np.broadcast_to(np.asarray(values), shape).reshape(-1)
    except ValueError:
        raise UsageError(f"{what} of shape {np.shape(values)}: it must be one number, or fit {shape}") from None


def pair(first: Any, second: Any) -> tuple[Array, Array]:
    """Returns both as (N, 3). One of them may be a single (3,), which is used for all rows of the
    other; [] has no rows."""
    a, b = (out if out.shape != (0,) else out.reshape(0, 3)
            for out in (numbers("points", first), numbers("directions", second)))
    try:
        a, b = np.broadcast_arrays(a, b)
    except ValueError:
        raise UsageError(f"shapes {a.shape} and {b.shape} do not fit together") from None
    if a.ndim == 1:
        a, b = a[None], b[None]
    if a.ndim != 2 or a.shape[1] != 3:
        raise UsageError(f"points and directions must be (N, 3), not {a.shape}")
    return a, b
