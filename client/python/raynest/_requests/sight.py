"""Lines of sight: segments between points that may lie on surfaces, which do not hide them."""
from __future__ import annotations

import contextlib
import math
from typing import Any, Callable, Mapping, Optional

import numpy as np

from .._net.frame import Array
from ..errors import RayWarning, UsageError, warn, warnings_taken
from .arguments import float32, real
from .rays import Rays, pair, vector

# Default part of a line of sight that is left out at each end, in steps between float32 numbers: the
# end and the surface on which it lies are rounded, and the ray meets that at an angle.
SEGMENT_STEPS = 4.0
OWN_SURFACES_MAX = 64       # that a line meets and that hold one of its ends, before it counts as hidden


class Segments:
    """Rays from a to b whose t is in units of their distance. A share `margin`, or `margin_distance`, is left out at each
    end; by default what float32 does not tell from the end in a scene of this `size`, whose triangles may be as large."""

    def __init__(self, a: Any, b: Any, margin: Optional[float], margin_distance: Optional[float], origin: Any,
                 size: float = 0.0) -> None:
        if margin is not None and margin_distance is not None:
            raise UsageError("margin is a share and margin_distance a distance: pass one of them")
        if margin is not None and not 0 <= real("margin", margin) < 0.5:
            raise UsageError(f"margin of {margin!r}: it must be a share from 0 to less than 0.5")
        if margin_distance is not None and not 0 <= real("margin_distance", margin_distance) < math.inf:
            raise UsageError(f"margin_distance of {margin_distance!r}: it must be a distance, 0 or more")
        self._start, self._end = start, end = pair(a, b)
        # Subtract in a signed type: the dtype of the points may be unsigned.
        with np.errstate(over="ignore", invalid="ignore"):
            ways = np.subtract(end, start, dtype=np.result_type(start, end, np.float32))
        unseen = ~(np.isfinite(float32(start)) & np.isfinite(float32(ways))).all(axis=1)
        if unseen.any():
            warn(f"{np.count_nonzero(unseen)} of {len(unseen)} lines of sight have an end that is not "
                 f"finite in float32, and count as free; the first is {unseen.argmax()}", RayWarning)
        self._origin, self._step = origin, float(np.spacing(np.float32(size)))
        self.rows: Optional[Array] = None       # (n, 8); None where the caller chose the margin
        if margin is not None:
            self.rays = Rays(a if np.shape(a) == (3,) else start, ways, origin, tmin=margin, tmax=1 - margin)
            return
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            self._lengths = lengths = np.linalg.norm(ways.astype(np.float64), axis=1)
            if margin_distance is None:
                along = ways / lengths[:, None]
                near = self._steps(start, along)
                far = self._steps(end, along) + SEGMENT_STEPS * np.spacing(float32(lengths))
            else:
                near = far = np.full(len(ways), float(margin_distance))
            # A segment shorter than both margins keeps an empty interval, which has no hit.
            low, high = (np.minimum(0.5, np.divide(part, lengths, out=np.full(len(ways), 0.5),
                                                   where=lengths > 0)) for part in (near, far))
        rows = np.column_stack([start, low, ways, 1 - high]).astype(ways.dtype)
        self.rays = Rays(rows, origin=origin)
        if margin_distance is None:
            self.rows = rows

    def hidden(self, nearest: Callable[[Array, Rays], Mapping[str, Array]]) -> Array:
        """Returns which lines meet something on which neither of their ends lies. A line that grazes the surface of its end
        meets it, as it is rounded, far beyond the margin. `nearest` takes numbers of lines and their rays, and returns t
        and ng of their closest hits."""
        assert self.rows is not None
        left, rows = np.arange(len(self.rows)), self.rows
        hidden = np.zeros(len(rows), bool)
        for turn in range(OWN_SURFACES_MAX):
            with warnings_taken() if turn else contextlib.nullcontext():    # the first answer tells all
                found = nearest(left, Rays(rows, origin=self._origin))
            own = self._hold_an_end(left, rows[:, 4:7], found["t"], found["ng"])
            hidden[left] = np.isfinite(found["t"])
            left, rows = left[own], rows[own]
            if not left.size:
                break
            rows[:, 3] = np.minimum(np.nextafter(found["t"][own], np.float32(1)), rows[:, 7])
        return hidden

    def _hold_an_end(self, lines: Array, ways: Array, t: Array, ng: Array) -> Array:
        """True where the plane of a hit does, as far as float32 tells: a line meets such a plane at that end only."""
        lengths, last_digit = self._lengths[lines], SEGMENT_STEPS * float(np.finfo(np.float32).eps)
        across = np.abs((ng.astype(np.float64) * ways).sum(1))
        with np.errstate(invalid="ignore"):     # of what was not met
            near = t * across <= self._steps(self._start[lines], ng) + last_digit * t * lengths
            far = (1 - t) * across <= self._steps(self._end[lines], ng) + last_digit * (across + (1 - t) * lengths)
        holds: Array = np.isfinite(t) & (near | far)
        return holds

    def _steps(self, points: Array, ways: Array) -> Array:
        """The distance along unit vectors that steps of float32 explain: in each coordinate of the points less the origin,
        and of float32 points as they are, whose digits are lost already; and in the scene."""
        steps = np.abs(np.spacing(float32(points - vector("origin", self._origin))))
        if points.dtype == np.float32:
            steps = np.maximum(steps, np.abs(np.spacing(points)))
        explained: Array = SEGMENT_STEPS * ((steps * np.abs(ways)).sum(1) + self._step)
        return explained
