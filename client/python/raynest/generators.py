"""Rays that the daemon makes, so that none need be sent: pass a generator to trace() or stream().

    from raynest import generators

    sweep = generators.lidar([-15, -5, 5, 15], azimuths=(0, 360, 2048), camera="overview")
    hits = scene.trace(sweep, fields=("t", "direction"))

Images go row by row from the top; the centre of pixel (x, y) is at (x + 0.5, y + 0.5). A sensor
looks along -Z with +X to the right and +Y up; a lidar has x ahead, y left, z up. A pose maps that
frame to the world, and may only turn and move it; without a pose, camera or look_at it is the
identity. With a camera or look_at a lidar faces where that view does, but stands upright, whatever
the view's pitch. Angles are in degrees. Section 6 of PROTOCOL.md has the formulas; the columns
`origin` and `direction` show the rays.
"""
from __future__ import annotations

import copy
import dataclasses
import functools
import math
import reprlib
from typing import Any, Callable, NamedTuple, Optional, Sequence, TypedDict, Union, cast

import numpy as np

from . import _limits, sweeps
from ._lists import GENERATORS
from ._net.control import Message
from ._net.frame import Array
from ._requests.arguments import Call, Unpack, count_of, float32, none_is_default, numbers, real, whole
from ._requests.picture import camera_message, size_message
from ._requests.rays import Rays, Source, Starts, pair, vector
from .errors import UsageError
from .sweeps import angles_of, elevations_of, finite, known_poses, swept, turn_of, turn_or_angles


class SensorPose(TypedDict, total=False):
    """Keyword arguments of all sensors: their pose and range. None means the default."""

    pose: Any                   # sensor to world, (3, 4) or (4, 4); without it as
    camera: Union[str, int, None]       # this camera of the scene, by name or index, or as
    look_at: Optional[Sequence[Any]]    # (eye, at) or (eye, at, up); else the pose is the identity
    tmin: Optional[float]
    tmax: Optional[float]       # in units of t


def of_sensor(function: Call) -> Call:
    """none_is_default() of a function that takes the arguments of all sensors."""
    return none_is_default(function, tuple(SensorPose.__annotations__))


class Generator:
    """A generator, made by the functions below; `count` is its number of rays."""

    _fields: tuple[str, ...] = ()   # columns of this object, which the daemon does not know
    _starts = "points"              # what says where its rays start

    def __init__(self, kind: str, settings: dict[str, str], count: int,
                 points: Optional[Array] = None, sensor: Optional[SensorPose] = None,
                 fov: float = 0.0, start: Optional[Array] = None) -> None:
        self.count = count
        self._kind = kind
        self._points = points       # (N, 8): point, tmin, normal, tmax
        self._start = start         # where the rays start, of the dtype that it was passed in
        self._sensor = _given(sensor or {})
        self._settings = {**settings, **_range_of(self._sensor)}
        self._pose = _pose(self._sensor["pose"]) if "pose" in self._sensor else None
        if self._pose is not None:
            self._start = self._pose[None, :, 3]
        elif "look_at" in self._sensor:
            self._start = np.atleast_1d(numbers("look_at", self._sensor["look_at"]))[:1]
        self._fov = fov
        self._part = (0, 0)

    def part(self, first: int, count: int) -> Generator:
        """Returns rays [first, first + count) of these; for hemisphere() it counts points. Rows of the answer
        have the same bytes as in the answer for all rays. Parts of a part count from the part's first ray."""
        all_of = self.count if self._points is None else len(self._points)
        first, count = whole("first", first, all_of - 1, 0), whole("count", count, all_of)
        if first + count > all_of:
            raise UsageError(f"a part of {count} from number {first} on: there are {all_of}")
        part = copy.copy(self)
        part._part = (self._part[0] + first, count)
        part.count = self.count // all_of * count
        if self._points is not None:
            part._points = self._points[first:first + count]
            part._start = None if self._start is None else self._start[first:first + count]
        return part

    def __repr__(self) -> str:
        return f"<raynest.generators.{self._kind}, {self.count} rays>"

    def source(self, origin: Any) -> Source:
        """Returns the generator's message, and its points if it has any, relative to `origin`."""
        shift = np.zeros(3) if origin is None else vector("origin", origin)
        given = next((name for name in ("pose", "look_at") if name in self._sensor), self._starts)
        stands = None if self._start is None else Starts(self._start, self.count, shift, given)
        own = {name: functools.partial(getattr, self, name) for name in self._fields}
        if self._points is not None:
            return Source(Rays(self._points, origin=origin), self.count, self._message({}), stands,
                          self._part)
        look_at, camera = self._sensor.get("look_at"), self._sensor.get("camera")
        camera = "" if camera is None else camera
        pose, place = self._pose, {}
        if pose is None and "pose" in GENERATORS[self._kind] and camera == "" and look_at is None:
            pose = np.eye(3, 4)
        if pose is not None:
            place["pose"] = _exact_text("pose", pose - np.pad(shift[:, None], ((0, 0), (3, 0))))
        if camera != "" or look_at is not None or self._fov:
            message = camera_message(camera, look_at, self._fov, shift)
            if message["name"]:
                place["camera"] = message["name"]
            if look_at is not None:
                place["lookat"] = _exact_text("look_at", [message[at] for at in ("eye", "at", "up") if at in message])
            if self._fov:
                place["fov"] = _text("fov", self._fov)
        return Source(Rays(np.empty((0, 8), np.float32)), self.count, self._message(place), stands,
                      self._part, own=own)

    def _numbers(self) -> Array:
        return self._part[0] + np.arange(self.count)

    def _message(self, place: dict[str, str]) -> Message:
        settings = {**self._settings, **place}
        return {"kind": self._kind, "settings": [f"{name}={text}" for name, text in settings.items()]}


def one_sample(generator: Message) -> Message:
    """Returns the same generator with one ray per point."""
    settings = [each for each in generator["settings"] if not each.startswith("samples=")]
    return {**generator, "settings": [*settings, "samples=1"]}


# ---- sensors ------------------------------------------------------------------------------------

@of_sensor
def camera(*, fov: float = 0.0, size: tuple[int, int] = (960, 540),
           **sensor: Unpack[SensorPose]) -> Generator:
    """The rays of a picture: `camera` is one of the scene, by default the first, or `look_at`;
    `fov` is vertical. t is depth along the axis."""
    if sensor.get("pose") is not None:
        raise UsageError("camera() takes no pose: pass camera= or look_at=, or use pinhole()")
    return _image("camera", size, sensor, {}, fov=real("fov", fov))


@of_sensor
def pinhole(fx: float, fy: Optional[float] = None, cx: Optional[float] = None,
            cy: Optional[float] = None, *, size: tuple[int, int] = (960, 540),
            **sensor: Unpack[SensorPose]) -> Generator:
    """A calibrated camera, with focal lengths and principal point in pixels. By default pixels are
    square, and the principal point is the middle. t is depth along the axis."""
    return _image("pinhole", size, sensor, _lens(fx, fy, cx, cy))


@of_sensor
def orthographic(window: tuple[float, float], *, size: tuple[int, int] = (960, 540),
                 **sensor: Unpack[SensorPose]) -> Generator:
    """Parallel rays through a window of this width and height in the scene."""
    sides = numbers("window", window)
    if sides.shape != (2,):
        raise UsageError(f"window of {reprlib.repr(window)}: it must be (width, height)")
    width, height = sides.tolist()
    window_text = f"{_text('window', width)}x{_text('window', height)}"
    return _image("orthographic", size, sensor, {"window": window_text})


@of_sensor
def equirectangular(*, size: tuple[int, int] = (960, 480), **sensor: Unpack[SensorPose]) -> Generator:
    """All directions: 360 degrees wide with ahead in the middle, and 180 degrees high."""
    return _image("equirectangular", size, sensor, {})


@of_sensor
def lidar(elevations: Any, azimuths: Any = (0.0, 360.0, 2048), *,
          azimuth_offsets: Any = (), origin_offsets: Any = (), trajectory: Any = None, begin: Optional[float] = None,
          end: Optional[float] = None, scans: Optional[int] = None, step_error: Optional[float] = None,
          **sensor: Unpack[SensorPose]) -> Union[Lidar, Sweep]:
    """A rotating head with a channel for each of `elevations`. `azimuths` is (start, stop, count),
    counter-clockwise; stop itself is left out. `azimuth_offsets` (C,) turn channels, `origin_offsets`
    (C, 3) move them within the head. Ray c * count + j is channel c at azimuth j; `ring` of this object is the
    channel of each ray, and as one of `fields` a column of the answer.

    With a `trajectory` it moves while it turns, as sweep() has it, which takes begin, end, scans and step_error too. With
    these alone it stands at `pose`, while the scene may move.

    `azimuths` may also be an array of other than three angles, in any order, also clockwise, and `elevations` more than
    fit into a text: that is a sweep() which stands still at `pose`. A sweep goes without camera and look_at."""
    motion: dict[str, Any] = {name: value for name, value in (("begin", begin), ("end", end), ("scans", scans),
                                                              ("step_error", step_error)) if value is not None}
    turn = turn_of(azimuths) if isinstance(azimuths, tuple) or np.shape(azimuths) in ((3,), ()) else None
    if trajectory is not None or motion or turn is None or np.size(elevations) > _limits.list_items_max:
        is_moving = trajectory is not None
        if given := [name for name, value in (("pose", is_moving and sensor.get("pose") is not None),
                                              *((key, sensor.get(key) is not None) for key in ("camera", "look_at"))) if value]:
            kind = "in motion" if is_moving else f"with {next(iter(motion))}" if motion else "whose angles are a list"
            raise UsageError(f"a lidar {kind} goes without "
                             f"{' and '.join(given)}; `{'trajectory' if is_moving else 'pose'}` says where it stands")
        if not is_moving:
            pose = sensor.get("pose")
            trajectory = [0.0], (np.eye(3, 4) if pose is None else numbers("pose", pose))[None]
            motion = motion or {"begin": 0.0, "end": 0.0}
        return sweep(elevations, turn or azimuths, azimuth_offsets=azimuth_offsets, origin_offsets=origin_offsets,
                     trajectory=trajectory, tmin=sensor.get("tmin"), tmax=sensor.get("tmax"), **motion)
    columns = turn[2]
    channels = len(elevations_of(elevations, _limits.list_items_max))
    settings = {"elevations": _text("elevations", elevations), "azimuths": _turn_text(turn),
                **_offset_settings(channels, azimuth_offsets, origin_offsets)}
    made = Lidar("lidar", settings, channels * columns, sensor=sensor)
    made._columns = columns
    return made


def _offset_settings(channels: int, azimuth_offsets: Any, origin_offsets: Any) -> dict[str, str]:
    settings = {}
    for name, offsets, count in (("azimuth_offsets", azimuth_offsets, numbers("azimuth_offsets", azimuth_offsets).size),
                                 ("origin_offsets", _offsets(origin_offsets), len(_offsets(origin_offsets)))):
        if count not in (0, channels):
            raise UsageError(f"{name} must be one for each of the {channels} elevations, or none")
        if count > _limits.list_items_max:
            raise UsageError(f"{name} of {count} channels: at most {_limits.list_items_max} channels have some; trace more "
                             "in several sweeps")
        if count:
            settings[name] = _text(name, offsets)
    return settings


class Lidar(Generator):
    """The rays of a lidar that stands still, from lidar()."""

    _columns: int
    _fields: tuple[str, ...] = ("ring",)

    @property
    def ring(self) -> Array:
        """The channel of each ray, uint16."""
        return (self._numbers() // self._columns).astype(np.uint16)


@none_is_default
def sweep(elevations: Any, azimuths: Any = (0.0, 360.0, 2048), *, azimuth_offsets: Any = (), origin_offsets: Any = (),
          trajectory: Any, begin: float = 0.0, end: float = 0.1, scans: int = 1, step_error: Optional[float] = None,
          tmin: Optional[float] = None, tmax: Optional[float] = None) -> Sweep:
    """A lidar in motion, like sweeps.lidar(), but the daemon makes its rays: those of each column start where the
    sensor is at the column's time. Scans follow each other in time: column j of A of scan n is measured at
    begin + (end - begin) (n A + j) / A, and ray (n C + c) A + j is channel c of C there. `ring` and `time` of this
    object have a row per ray; as `fields` they are columns of the answer. The offsets of channels are those of lidar().

    A trajectory of one pose is a sensor that stands there at all times.

    With `step_error` an animated scene moves during the sweep, in steps. In each step the scene stands where it is
    in the middle of the step, so that no part is further than `step_error`, in the scene's units, from where it is
    at the time of a ray. The trajectory's times are those of the animation, or, with `time` of trace(), that is the
    animation's time at `begin`."""
    heights = elevations_of(elevations)
    settings = {"channels": str(len(heights)), **_offset_settings(len(heights), azimuth_offsets, origin_offsets)}
    turn, around = turn_or_angles(azimuths)
    if turn is not None:
        columns = turn[2]
        settings["azimuths"] = _turn_text(turn)
    else:
        columns = len(around)
        settings["columns"] = str(columns)
    scans = count_of("scans", scans, _limits.sweep_columns_max)
    if scans * columns > _limits.sweep_columns_max:
        raise UsageError(f"{scans} scans of {columns} columns: all have at most {_limits.sweep_columns_max}; ask for fewer "
                         "at a time")
    settings["scans"] = str(scans)
    way = _Way.of("sweep", trajectory, begin, end, step_error, columns, scans)
    made = Sweep("sweep", {**settings, **way.settings}, len(heights) * len(way.times),
                 sensor=SensorPose(tmin=tmin, tmax=tmax), start=way.start)
    made._way, made._angles = way, np.concatenate([heights, around])
    made._channels, made._columns = len(heights), columns
    made._head = heights, around if turn is None else angles_of(turn)
    return made


@none_is_default
def rolling_shutter(fx: float, fy: Optional[float] = None, cx: Optional[float] = None, cy: Optional[float] = None, *,
                    size: tuple[int, int] = (960, 540), trajectory: Any, begin: float = 0.0, end: float = 0.1,
                    step_error: Optional[float] = None, tmin: Optional[float] = None,
                    tmax: Optional[float] = None) -> RollingShutter:
    """A camera like pinhole(), but in motion while it reads its picture row by row: row i of H is measured at
    begin + (end - begin) i / H, from where the camera is then. `trajectory` is like that of sweep(), but a camera
    looks along -z, with x to the right and y up. `time` of this object has a row per ray; as one of `fields` it is
    a column of the answer. With `step_error` an animated scene moves meanwhile, as in sweep()."""
    message = size_message(size)
    width, height = message["width"], message["height"]
    way = _Way.of("rolling_shutter", trajectory, begin, end, step_error, height)
    settings = {"size": f"{width}x{height}", **_lens(fx, fy, cx, cy), **way.settings}
    made = RollingShutter("rolling_shutter", settings, width * height, sensor=SensorPose(tmin=tmin, tmax=tmax),
                          start=way.start)
    made._way, made._columns = way, width
    return made


def _lens(fx: float, fy: Optional[float], cx: Optional[float], cy: Optional[float]) -> dict[str, str]:
    given = {"fx": fx, "fy": fy, "cx": cx, "cy": cy}
    return {name: _text(name, real(name, value)) for name, value in given.items() if value is not None}


class _Way(NamedTuple):
    """Where a sensor is, and when it measures its lines: columns of scans, or rows of a picture."""

    settings: dict[str, str]
    rows: Array         # (K, 13): time, and pose row by row
    start: Array        # the first pose's, as it was passed in
    times: Array        # each line's

    @classmethod
    def of(cls, kind: str, trajectory: Any, begin: float, end: float, step_error: Optional[float], lines: int,
           scans: int = 1) -> _Way:
        known, poses = known_poses(trajectory)
        begin, end = real("begin", begin), real("end", end)
        if not -math.inf < begin <= end < math.inf:
            raise UsageError(f"a {kind} from {begin} to {end}: both must be finite, and it must end after it begins")
        settings = {"poses": str(len(known)), "begin": _exact_text("begin", begin), "end": _exact_text("end", end)}
        if step_error is not None:
            if not 0 < real("step_error", step_error) < math.inf:
                raise UsageError(f"a step_error of {step_error}: it must be finite and above 0")
            settings["step_error"] = _exact_text("step_error", step_error)
        times = begin + (end - begin) * np.arange(scans * lines) / lines
        if len(known) == 1:     # it stands there at all times
            known = np.unique(times[[0, -1]])
            poses = np.repeat(poses, len(known), axis=0)
            settings["poses"] = str(len(known))
        if times[0] < known[0] or times[-1] > known[-1]:
            raise UsageError(f"the {kind} lasts from {times[0]} to {times[-1]}, the trajectory from {known[0]} to {known[-1]}: "
                             "give poses for all of it")
        start = numbers("the trajectory's poses", trajectory[1])[:1, :3, 3]
        return cls(settings, np.column_stack([known, poses.reshape(-1, 12)]), start, times)


class Moving(Generator):
    """The rays of a sensor in motion."""

    _way: _Way
    _angles: Array = np.empty(0)    # that follow the poses
    _columns: int                   # rays of a row
    _fields: tuple[str, ...] = ("time",)
    _starts = "poses"

    @property
    def time(self) -> Array:
        """The time of each ray, float64."""
        return self._way.times[self._lines(self._numbers())]

    def _lines(self, of: Array) -> Array:
        """The lines of rays, by their numbers."""
        return of // self._columns

    def source(self, origin: Any) -> Source:
        rows = self._way.rows.copy()
        if origin is not None:
            rows[:, [4, 8, 12]] -= vector("origin", origin)
        sent = np.concatenate([rows.ravel(), self._angles]).view(np.uint8)
        return dataclasses.replace(super().source(origin), upload=sent)


class RollingShutter(Moving):
    """The rays of a camera in motion, from rolling_shutter()."""


class Sweep(Moving):
    """The rays of a lidar in motion, from sweep()."""

    _channels: int
    _head: tuple[Array, Array]      # elevations and azimuths
    _fields = ("ring", "time")

    @property
    def ring(self) -> Array:
        """The channel of each ray, uint16."""
        return (self._numbers() // self._columns % self._channels).astype(np.uint16)

    def _lines(self, of: Array) -> Array:
        return of // (self._columns * self._channels) * self._columns + of % self._columns

    def beams(self) -> sweeps.Sweep:
        """These rays as sweeps.lidar() makes them here, scan after scan."""
        trajectory = self._way.rows[:, 0], self._way.rows[:, 1:].reshape(-1, 3, 4)
        scans = [swept(*self._head, times, trajectory) for times in self._way.times.reshape(-1, self._columns)]
        whole = sweeps.Sweep(*(np.concatenate(columns) for columns in zip(*scans)))
        return whole.where(slice(self._part[0], self._part[0] + self.count))


# ---- points -------------------------------------------------------------------------------------

@none_is_default
def hemisphere(points: Any, normals: Any, *, samples: int = 64, seed: int = 0, tmin: float = 0.0,
               tmax: float = math.inf, margin: Optional[float] = None) -> Generator:
    """`samples` cosine-weighted rays from each point (N, 3), around its normal. Average them with
    trace(..., reduce="hit_fraction"). Ray p * samples + s is sample s of point p. Rays start at a
    distance of `margin` along the normal, so that the surface on which a point lies does not hide it:
    by default a millionth of the scene's size, or the step of float32 there if that is more."""
    low, high = _range(tmin, tmax)
    places, ways = pair(points, normals)
    rows = np.empty((len(places), 8), np.result_type(places, ways, np.float32))
    rows[:, :3], rows[:, 3], rows[:, 4:7], rows[:, 7] = places, low, ways, high
    seed, samples = whole("seed", seed, 2**64 - 1, 0), count_of("samples", samples, _limits.samples_max)
    settings = {"seed": str(seed), "samples": str(samples)}
    if margin is not None:
        settings["margin"] = _text("margin", real("margin", margin))
    return Generator("hemisphere", settings, len(rows) * samples, rows, start=places)


# ---- others -------------------------------------------------------------------------------------

def __getattr__(kind: str) -> Callable[..., Generator]:
    """Returns a function for any other image of protocol/lists/generators.def. Its settings are keyword
    arguments, texts or numbers; `size` is as above."""
    if "size" not in GENERATORS.get(kind, ()):
        raise AttributeError(f"module {__name__!r} has no attribute {kind!r}")

    def image(*, size: tuple[int, int] = (960, 540), pose: Any = None,
              camera: Union[str, int, None] = None, look_at: Optional[Sequence[Any]] = None,
              tmin: Optional[float] = None, tmax: Optional[float] = None,
              **settings: Any) -> Generator:
        texts = {name: value if isinstance(value, str) else _text(name, value)
                 for name, value in settings.items()}
        return _image(kind, size, SensorPose(pose=pose, camera=camera, look_at=look_at, tmin=tmin,
                                        tmax=tmax), texts)
    return image


def _image(kind: str, size: tuple[int, int], sensor: SensorPose, settings: dict[str, str],
           fov: float = 0.0) -> Generator:
    image = size_message(size)
    width, height = image["width"], image["height"]
    return Generator(kind, {"size": f"{width}x{height}", **settings}, width * height, sensor=sensor,
                     fov=fov)


def _given(sensor: SensorPose) -> SensorPose:
    given = {name: value for name, value in sensor.items() if value is not None}
    places = [name for name in ("pose", "camera", "look_at") if name in given]
    if len(places) > 1:
        raise UsageError(f"{' and '.join(places)} each say where the sensor stands: pass one of "
                         "them")
    return cast(SensorPose, given)


def _range_of(sensor: SensorPose) -> dict[str, str]:
    if "tmin" not in sensor and "tmax" not in sensor:
        return {}
    tmin, tmax = _range(sensor.get("tmin", 0.0), sensor.get("tmax", math.inf))
    return {"range": f"{_text('tmin', tmin)}:{_text('tmax', tmax)}"}


def _range(tmin: Any, tmax: Any) -> tuple[float, float]:
    """Checks the range in float32, the type on the wire."""
    low, high = float32((real("tmin", tmin), real("tmax", tmax))).tolist()
    if not 0 <= low < high:
        raise UsageError(f"tmin {tmin} and tmax {tmax}: it must be 0 <= tmin < tmax, in float32")
    return low, high


def _pose(value: Any) -> Array:
    pose = numbers("pose", value)
    if pose.shape == (4, 4) and (pose[3] == (0, 0, 0, 1)).all():
        pose = pose[:3]
    if pose.shape == (4, 4):
        raise UsageError(f"a pose whose last row is {pose[3].tolist()}: it must be 0 0 0 1")
    if pose.shape != (3, 4):
        raise UsageError(f"a pose of shape {pose.shape}: it must be (3, 4), or (4, 4) with a last "
                         "row of 0 0 0 1")
    return pose


def _text(what: str, value: Any) -> str:
    """Returns numbers with the digits of float32, which keeps long lists short. Larger ones become
    infinite, which the daemon refuses."""
    return ",".join(map(str, float32(numbers(what, value)).ravel()))


def _exact_text(what: str, value: Any) -> str:
    """Returns numbers with all their digits: the daemon computes in float64 and rounds the ray."""
    return ",".join(map(repr, numbers(what, value).astype(np.float64).ravel().tolist()))


def _turn_text(turn: tuple[float, float, int]) -> str:
    return f"{turn[0]!r}:{turn[1]!r}:{turn[2]}"


def _offsets(value: Any) -> Array:
    rows = numbers("origin_offsets", value)
    if rows.size and (rows.ndim != 2 or rows.shape[1] != 3):
        raise UsageError(f"origin_offsets of shape {rows.shape}: they must be (C, 3)")
    return rows.reshape(-1, 3)
