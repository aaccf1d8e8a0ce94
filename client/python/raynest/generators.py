"""Rays that the daemon makes, so that none travel: trace() and stream() take these in their place.

    from raynest import generators

    sweep = generators.lidar([-15, -5, 5, 15], azimuths=(0, 360, 2048), camera="overview")
    hits = scene.trace(sweep, fields=("t", "direction"))

Images go row by row from the top, pixel (x, y) has its centre at (x + 0.5, y + 0.5). A sensor looks
along -Z, +X to the right, +Y up; a lidar's x is ahead, y left, z up. A pose takes that frame to the
world, and without a pose, camera or look_at it is the identity. A camera or look_at makes a lidar
look where a camera would, upright. Angles are degrees. The formulas are in PROTOCOL.md, 6; the
columns `origin` and `direction` tell what they gave.
"""
from __future__ import annotations

import math
import reprlib
from typing import Any, Optional, Sequence, TypedDict, Union, cast

import numpy as np

from . import _limits
from ._arguments import Unpack, float32, none_is_default, numbers, real, whole
from ._control import Message
from ._frame import Array
from ._picture import camera_message, size_message
from ._rays import Rays, Source, pair, vector
from .errors import UsageError


class Mount(TypedDict, total=False):
    """Keyword arguments of all sensors: where they stand, and which hits count. None is as good as
    leaving one away."""

    pose: Any                   # sensor to world, (3, 4) or (4, 4); without it as
    camera: Union[str, int, None]       # this camera of the scene, by name or index, or as
    look_at: Optional[Sequence[Any]]    # (eye, at) or (eye, at, up); else the pose is the identity
    tmin: Optional[float]
    tmax: Optional[float]       # in units of t


class Generator:
    """Made by the functions below; `count` is its number of rays."""

    def __init__(self, message: Message, count: int, points: Optional[Array] = None,
                 mount: Optional[Mount] = None, fov: float = 0.0) -> None:
        self.count = count
        self._points = points       # (N, 8): point, tmin, normal, tmax
        self._mount = _given(mount or {})
        self._message = message if mount is None else {**message, **_limits_of(self._mount)}
        self._pose = _pose(self._mount["pose"]) if "pose" in self._mount else None
        self._fov = fov

    def __repr__(self) -> str:
        return f"<raynest.generators.{self._message['kind']}, {self.count} rays>"

    def source(self, origin: Any) -> Source:
        """What travels of it; points and places are shifted by `origin` as rays are."""
        if self._points is not None:
            return Source(Rays(self._points, origin=origin), self.count, self._message)
        shift = np.zeros(3) if origin is None else vector("origin", origin)
        message = dict(self._message)
        look_at, camera = self._mount.get("look_at"), self._mount.get("camera")
        camera = "" if camera is None else camera
        pose = self._pose
        if pose is None and message["kind"] != "camera" and camera == "" and look_at is None:
            pose = np.eye(3, 4)
        if pose is not None:
            message["pose"] = _floats("pose", pose - np.pad(shift[:, None], ((0, 0), (3, 0))))
        if camera != "" or look_at is not None or self._fov:
            message["camera"] = camera_message(camera, look_at, self._fov, shift)
        return Source(Rays(np.empty((0, 8), np.float32)), self.count, message)


# ---- sensors ------------------------------------------------------------------------------------

@none_is_default
def camera(*, fov: float = 0.0, size: tuple[int, int] = (960, 540),
           **mount: Unpack[Mount]) -> Generator:
    """The rays of a picture: `camera` is one of the scene, by default the first, or `look_at`;
    `fov` is vertical. t is depth along the axis."""
    if mount.get("pose") is not None:
        raise UsageError("camera() takes no pose: pass camera= or look_at=, or use pinhole()")
    return _image("camera", size, mount, fov=real("fov", fov))


@none_is_default
def pinhole(fx: float, fy: Optional[float] = None, cx: Optional[float] = None,
            cy: Optional[float] = None, *, size: tuple[int, int] = (960, 540),
            **mount: Unpack[Mount]) -> Generator:
    """A calibrated camera: focal lengths and principal point in pixels, by default square pixels
    and the middle. t is depth along the axis."""
    image = size_message(size)
    return _image("pinhole", size, mount, fx=fx, fy=fx if fy is None else fy,
                  cx=image["width"] / 2 if cx is None else cx,
                  cy=image["height"] / 2 if cy is None else cy)


@none_is_default
def orthographic(window: tuple[float, float], *, size: tuple[int, int] = (960, 540),
                 **mount: Unpack[Mount]) -> Generator:
    """Parallel rays through a window of this width and height in the scene."""
    sides = numbers("window", window)
    if sides.shape != (2,):
        raise UsageError(f"window of {reprlib.repr(window)}: it must be (width, height)")
    width, height = sides.tolist()
    return _image("orthographic", size, mount, window_width=width, window_height=height)


@none_is_default
def equirectangular(*, size: tuple[int, int] = (960, 480), **mount: Unpack[Mount]) -> Generator:
    """All directions: 360 degrees wide, ahead in the middle, 180 high."""
    return _image("equirectangular", size, mount)


@none_is_default
def lidar(elevations: Any, azimuths: tuple[float, float, int] = (0.0, 360.0, 2048), *,
          azimuth_offsets: Any = (), origin_offsets: Any = (), **mount: Unpack[Mount]) -> Generator:
    """A head that turns: a channel for each of `elevations`, `azimuths` is (start, stop, count),
    counter-clockwise, without stop. Channels may be turned by `azimuth_offsets` (C,) and sit at
    `origin_offsets` (C, 3) of the head. Ray c * count + j is channel c at azimuth j."""
    try:
        start, stop, azimuth_count = azimuths
    except (TypeError, ValueError):
        raise UsageError(f"azimuths of {reprlib.repr(azimuths)}: they must be (start, stop, count)"
                         ) from None
    count = whole("azimuths", azimuth_count, _limits.azimuths_max)
    message: Message = {
        "kind": "lidar", "elevations": _floats("elevations", elevations),
        "azimuth_offsets": _floats("azimuth_offsets", azimuth_offsets),
        "origin_offsets": _offsets(origin_offsets), "azimuth_start": start,
        "azimuth_stop": stop, "azimuth_count": count}
    channels = len(message["elevations"])
    if not 0 < channels <= _limits.list_items_max:
        raise UsageError(f"a lidar of {channels} channels: it has 1 to {_limits.list_items_max}; "
                         "trace more in several sweeps")
    for name in ("azimuth_offsets", "origin_offsets"):
        if len(message[name]) not in (0, channels):
            raise UsageError(f"{name} must be one for each of the {channels} elevations, or none")
    return Generator(message, channels * count, mount=mount)


# ---- points -------------------------------------------------------------------------------------

@none_is_default
def hemisphere(points: Any, normals: Any, *, samples: int = 64, seed: int = 0, tmin: float = 0.0,
               tmax: float = math.inf) -> Generator:
    """`samples` cosine-weighted rays from each of the points (N, 3) to the side of its normal: what
    trace(..., reduce="hit_fraction") averages. Ray p * samples + s is sample s of point p."""
    low, high = _range(tmin, tmax)
    places, ways = pair(points, normals)
    rows = np.empty((len(places), 8), np.result_type(places, ways, np.float32))
    rows[:, :3], rows[:, 3], rows[:, 4:7], rows[:, 7] = places, low, ways, high
    message: Message = {"kind": "hemisphere",
                        "seed": whole("seed", seed, 2**64 - 1, least=0),
                        "samples": whole("samples", samples, _limits.samples_max)}
    return Generator(message, len(rows) * message["samples"], rows)


def _image(kind: str, size: tuple[int, int], mount: Mount, fov: float = 0.0,
           **fields: float) -> Generator:
    image = size_message(size)
    return Generator({"kind": kind, **image, **fields}, image["width"] * image["height"],
                     mount=mount, fov=fov)


def _given(mount: Mount) -> Mount:
    unknown = mount.keys() - Mount.__annotations__.keys()
    if unknown:
        raise TypeError(f"a sensor has no option {', '.join(sorted(unknown))}; there are "
                        f"{', '.join(Mount.__annotations__)}")
    given = {name: value for name, value in mount.items() if value is not None}
    places = [name for name in ("pose", "camera", "look_at") if name in given]
    if len(places) > 1:
        raise UsageError(f"{' and '.join(places)} each say where the sensor stands: pass one of "
                         "them")
    return cast(Mount, given)


def _limits_of(mount: Mount) -> Message:
    tmin, tmax = _range(mount.get("tmin", 0.0), mount.get("tmax", math.inf))
    return {"tmin": tmin, "tmax": 0.0 if math.isinf(tmax) else tmax}


def _range(tmin: Any, tmax: Any) -> tuple[float, float]:
    """As float32 has them, in which they travel: there a tmax of 0 would be no end."""
    low, high = float32((real("tmin", tmin), real("tmax", tmax))).tolist()
    if not 0 <= low < high:
        raise UsageError(f"tmin {tmin} and tmax {tmax}: it must be 0 <= tmin < tmax, in float32")
    return low, high


def _pose(value: Any) -> Array:
    pose = numbers("pose", value).astype(np.float64)
    if pose.shape == (4, 4) and (pose[3] == (0, 0, 0, 1)).all():
        pose = pose[:3]
    if pose.shape != (3, 4):
        raise UsageError(f"a pose of shape {pose.shape}: it must be (3, 4), or (4, 4) with a last "
                         "row of 0 0 0 1")
    return pose


def _floats(what: str, value: Any) -> list[float]:
    """What float32 cannot hold becomes infinite, and the daemon refuses it."""
    out: list[float] = float32(numbers(what, value)).ravel().tolist()
    return out


def _offsets(value: Any) -> list[tuple[float, ...]]:
    rows = float32(numbers("origin_offsets", value))
    if rows.size and (rows.ndim != 2 or rows.shape[1] != 3):
        raise UsageError(f"origin_offsets of shape {rows.shape}: they must be (C, 3)")
    return [tuple(row) for row in rows.reshape(-1, 3).tolist()]
