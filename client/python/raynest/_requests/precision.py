"""Warns of the precision that float64 meshes and rays lose in float32."""
from __future__ import annotations

import math
from typing import Any, Mapping, NamedTuple, Optional

import numpy as np

from .._net.frame import Array
from .arguments import array_of
from .rays import Starts, half_step

# A shift above this share of the size is worth a warning: of vertices, of the mesh's size; of rays,
# of the scene's.
NOTABLE_SHARE = 1e-5
NOTABLE_SHARE_OF_RAYS = 1e-4

# In each of the daemon's warnings of rounding.
ROUNDING_WORDS = "float32"

_RAYS_AT_ONCE = 1 << 16
_FACES_OF_A_SAMPLE = 1000


def rounding_warning(vertices: Any, faces: Any, info: Mapping[str, Any]) -> str:
    """Returns how far float32 moved the vertices and an origin that avoids it, or "" if it moved
    them little and no triangle vanished. `info` is of the scene that they became.
    float32 vertices have moved already: by half a step, where they use their last digit. The mesh was loaded, so it is
    not checked."""
    points, corners = array_of("vertices", vertices), array_of("faces", faces)
    origin, degenerate = np.asarray(info["origin"]), info["degenerate_triangles"]
    box = np.array([info["box_min"] or origin, info["box_max"] or origin], np.float64)
    if not degenerate and _is_near_zero(points, corners, box, origin):
        return ""
    exact = points.astype(np.float64) - origin
    used = np.zeros(len(exact), bool)
    used[corners] = True
    exact[~used] = exact[corners[0, 0]]  # what no face uses is nowhere
    moved = _longest(exact.astype(np.float32) - exact)
    before = _longest(_half_steps(points[used])) if points.dtype == np.float32 else 0.0
    is_float32 = before > moved
    moved = max(moved, before)
    low, high = exact.min(0), exact.max(0)
    size = float(np.linalg.norm(high - low))
    vanished = degenerate - _flat(exact, corners) if degenerate and moved and not is_float32 else 0
    if moved <= NOTABLE_SHARE * size and vanished <= 0:
        return ""
    if moved <= NOTABLE_SHARE * size:
        return (f"{vanished} of {len(corners)} triangles are so small that they have no area in "
                f"float32; the mesh's size is {size:.3g}: scale it up, or make small parts scenes of "
                "their own")
    near = _near((low + high) / 2 + origin, max(size, moved))
    if is_float32:
        return (f"the vertices are float32, whose rounding has moved them by up to {moved:.2g}; the mesh's "
                f"size is {size:.3g}. Pass them as float64" +
                ("" if origin.any() else f", with an origin near them, for example origin={near}"))
    gone = f" and leaves {vanished} of {len(corners)} triangles without area" if vanished > 0 else ""
    return (f"rounding to float32 moves vertices by up to {moved:.2g}{gone}; the mesh's size is "
            f"{size:.3g}. Pass an origin near it, for example origin={near}")


class Rounding(NamedTuple):
    """Rays that rounding moves far: how many, out of how many, and the first of them."""

    rays: int
    of: int
    first: int
    farthest: float
    size: float
    remedy: str

    @property
    def text(self) -> str:
        return (f"{self.rays} of {self.of} rays start so far from the scene's origin that float32 moves them by up to "
                f"{self.farthest:.3g}, and the scene's size is {self.size:.3g}; the first is ray {self.first}. To keep "
                f"their digits {self.remedy}")

    def with_others(self, others: Optional[Rounding], of: int) -> Rounding:
        """Together with others out of so many rays."""
        rays, first, farthest = (others.rays, others.first, others.farthest) if others else (0, self.first, 0.0)
        return self._replace(rays=self.rays + rays, of=of, first=min(self.first, first),
                             farthest=max(self.farthest, farthest))


def rounded_rays(starts: Starts, box: Optional[Array], origin: Array) -> Optional[Rounding]:
    """Tells whether rounding moves rays by a notable share of the size of the scene with this box and origin."""
    size = 0.0 if box is None else float(np.linalg.norm(box[1] - box[0]))
    if box is None or not size:
        return None
    notable = NOTABLE_SHARE_OF_RAYS * size
    centre = box.mean(0)
    is_far = half_step((centre - origin)[None])[0] > notable
    is_float32 = starts.points.dtype == np.float32
    # Around a scene at its origin float32 rays are what they say: nothing is lost here.
    if is_float32 and not is_far and not origin.any():
        return None
    count, first, farthest = 0, 0, 0.0
    for begin in range(0, len(starts.points), _RAYS_AT_ONCE):
        moved = starts.moved(begin, _RAYS_AT_ONCE)
        lost = np.flatnonzero(np.isfinite(moved) & (moved > notable))
        if lost.size:
            first = first if count else begin + int(lost[0])
            count += lost.size
            farthest = max(farthest, float(moved[lost].max()))
    if not count:
        return None
    count = starts.count if len(starts.points) == 1 else count
    remedy = [f"load the scene with origin={_near(centre, size)}"] if is_far else []
    if is_float32:
        remedy.append(f"pass the {starts.given} as float64")
    return Rounding(count, starts.count, first, farthest, size, " and ".join(remedy) or "start them nearer to the scene")


def _near(centre: Array, size: float) -> tuple[float, ...]:
    """Returns a point with few digits near the centre of something of this size."""
    step = 10.0 ** math.ceil(math.log10(size))
    return tuple((np.round(centre / step) * step + 0.0).tolist())


def _is_near_zero(points: Array, corners: Array, box: Array, origin: Array) -> bool:
    """True if no rounding of these vertices can be worth a warning. It looks at their box and at the size of a part of the
    mesh only, which takes a tenth of the time of an exact answer."""
    sample = points[corners[::1 + len(corners) // _FACES_OF_A_SAMPLE].ravel()].astype(np.float64)
    size = float(np.linalg.norm(sample.max(0) - sample.min(0)))
    reach = float(np.abs([box - origin, box if points.dtype == np.float32 else box - origin]).max())
    if not reach <= np.finfo(np.float32).max:
        return False
    return math.sqrt(3) * float(np.spacing(np.float32(reach))) / 2 <= NOTABLE_SHARE * size


def _half_steps(points: Array) -> Array:
    """Returns half a step of each float32 number that uses its last digit, 0 of the others: those are
    taken for exact."""
    last = np.ascontiguousarray(points).view(np.uint32) & 1
    steps: Array = np.where(last, np.spacing(np.abs(points)).astype(np.float64) / 2, 0.0)
    return steps


def _longest(rows: Array) -> float:
    return float(np.sqrt((rows * rows).sum(1).max()))


def _flat(points: Array, corners: Array) -> int:
    """Counts triangles that have no area in float64 either."""
    a, b, c = (points[corners[:, corner]] for corner in range(3))
    return int((np.cross(b - a, c - a) == 0).all(1).sum())
