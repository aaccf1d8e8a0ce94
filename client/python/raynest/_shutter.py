"""Pictures of a camera that moves while it reads its rows, made here of what generators.rolling_shutter() sees."""
from __future__ import annotations

import math
from typing import Any, Callable, Iterable, Iterator, Mapping, Optional, Union

import numpy as np

from . import generators
from ._net.frame import Array
from ._requests.arguments import Unpack, real
from ._requests.job import JobOptions, Progress
from ._requests.picture import size_message
from .errors import UsageError
from .images import Image

_FOV = 40.0     # as that of look_at
_BACKGROUND = 0.18
# Rays that are traced at once: their columns take some 40 bytes each.
_RAYS = 1 << 20


def picture_in_motion(seen: Callable[[generators.RollingShutter], Iterable[tuple[int, Array]]], trajectory: Any, begin: float,
                      readout: float, step_error: Optional[float], fov: float, size: tuple[int, int], encode: str,
                      progress: Progress, refused: Mapping[str, Any]) -> Union[Image, bytes]:
    """The picture that the integrator primary makes, each row of it seen from where the camera is then. `seen` yields the
    number of the first of some rays, and their pixels_of() a scene at one epoch; `refused` are the arguments of render()
    that do not go with it."""
    if given := [name for name, value in refused.items() if value]:
        raise UsageError("a camera in motion makes the picture of the integrator primary: leave "
                         f"{' and '.join(given)} out")
    if encode not in ("", "raw", "png"):
        raise UsageError(f"encode={encode!r}: a camera in motion makes 'raw' or 'png'")
    if not 0 <= real("readout", readout) < math.inf:
        raise UsageError(f"a readout of {readout}: it must be finite seconds, and not negative")
    if not 0 <= real("fov", fov) < 180:
        raise UsageError(f"fov of {fov!r}: it must be degrees from 0 (which are {_FOV:.0f}) to below 180")
    shape = size_message(size)
    width, height = shape["width"], shape["height"]
    rays = generators.rolling_shutter(height / 2 / math.tan(math.radians(fov or _FOV) / 2), size=(width, height),
                                      trajectory=trajectory, begin=begin, end=begin + readout, step_error=step_error)
    made = np.empty((height * width, 4), np.uint8)
    done = 0
    for first, pixels in seen(rays):
        made[first:first + len(pixels)] = pixels
        done += len(pixels)
        if progress:
            progress(done, len(made), "tracing")
    image: Image = made.reshape(height, width, 4).view(Image)
    return image.png() if encode == "png" else image


def pieces_of(rays: generators.RollingShutter) -> Iterator[tuple[int, Any]]:
    """Rays that are traced at once, whole rows, behind the number of the first."""
    rows = max(1, _RAYS // rays._columns) * rays._columns
    for first in range(0, rays.count, rows):
        yield first, rays.part(first, min(rows, rays.count - first))


def pixels_of(scene: Any, rays: Any, **job: Unpack[JobOptions]) -> Array:
    """The pixels (N, 4) of rays."""
    return _shade(scene.trace(rays, fields=("hit", "base_colour", "ng", "direction"), **job))


def _shade(seen: Mapping[str, Array]) -> Array:
    """Base colours, darker where a surface turns away, in sRGB; alpha says what was hit."""
    normal, way = seen["ng"].astype(np.float64), seen["direction"].astype(np.float64)
    facing = np.abs((normal * way).sum(axis=1)) / np.linalg.norm(way, axis=1)
    facing[~normal.any(axis=1)] = 1     # a primitive without a normal
    colour = seen["base_colour"] * facing[:, None].astype(np.float32)
    linear = np.clip(np.where(seen["hit"][:, None], colour, np.float32(_BACKGROUND)), 0, None)
    encoded = np.where(linear <= 0.0031308, linear * np.float32(12.92),
                       np.float32(1.055) * linear ** np.float32(1 / 2.4) - np.float32(0.055))
    return np.column_stack([np.minimum(encoded, 1) * 255 + 0.5, np.where(seen["hit"], 255, 0)]).astype(np.uint8)
