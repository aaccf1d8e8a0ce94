"""Warns of the precision that a float64 mesh loses in float32."""
from __future__ import annotations

import math
from typing import Any

import numpy as np

from ._frame import Array
from ._gltf import triangles

# A shift of vertices above this share of the mesh's size is worth a warning.
NOTABLE_SHARE = 1e-5


def rounding_warning(vertices: Any, faces: Any, origin: Array, degenerate: int) -> str:
    """Returns how far float32 moved the vertices and an origin that avoids it, or "" if it moved
    them little and no triangle vanished. `degenerate` counts triangles without area in float32."""
    points, corners = triangles(vertices, faces)
    exact = points.astype(np.float64) - origin
    moved = _longest(exact.astype(np.float32) - exact)
    low, high = exact.min(0), exact.max(0)
    size = float(np.linalg.norm(high - low))
    vanished = degenerate - _flat(exact, corners) if degenerate and moved else 0
    if moved <= NOTABLE_SHARE * size and vanished <= 0:
        return ""
    if moved <= NOTABLE_SHARE * size:
        return (f"{vanished} of {len(corners)} triangles are so small that they have no area in "
                f"float32; the mesh's size is {size:.3g}: scale it up, or make small parts scenes of "
                "their own")
    step = 10.0 ** math.ceil(math.log10(max(size, moved)))
    near = tuple((np.round(((low + high) / 2 + origin) / step) * step + 0.0).tolist())
    gone = f" and leaves {vanished} of {len(corners)} triangles without area" if vanished > 0 else ""
    return (f"rounding to float32 moves vertices by up to {moved:.2g}{gone}; the mesh's size is "
            f"{size:.3g}. Pass an origin near it, for example origin={near}")


def _longest(rows: Array) -> float:
    return float(np.sqrt((rows * rows).sum(1).max()))


def _flat(points: Array, corners: Array) -> int:
    """Counts triangles that have no area in float64 either."""
    a, b, c = (points[corners[:, corner]] for corner in range(3))
    return int((np.cross(b - a, c - a) == 0).all(1).sum())
