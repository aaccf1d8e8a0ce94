"""Returns of a lidar: what it reports of the surfaces that its beams meet.

    points = raynest.returns.measure(s, sweep, divergence=0.003, returns=3, noise=0.02, seed=1)
    raynest.points.save("sweep.las", points["position"], **{k: points[k] for k in ("ring", "time", "intensity", "return")})
"""
from __future__ import annotations

import inspect
from typing import Any, Iterable, Literal, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import _limits, generators
from ._net.frame import Array
from ._paths import form_of
from ._requests.arguments import count_of, is_several, numbers, real, unknown_argument, whole
from ._requests.columns import OF_HITS
from ._requests.job import JobOptions
from ._timed import moments
from .errors import UsageError
from .scene import Scene
from .sweeps import Sweep

# Rays that are traced at once: their answers take some 70 bytes each.
_TRACED_MAX = 1 << 20
_RETURNS_MAX = 16
_FOOTPRINT_MAX = 1024
# Luminance of red, green and blue, by ITU-R BT.709.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_ROUNDING = 1e-9  # for a share, a sum of powers
_CHOSEN = ("kind", "reduce", "max_hits", "detach")
_IDS = ("prim", "geom", "path", "uid")
# Those of an answer whose `fields` are not named.
_COLUMNS = ("beam", "t", "share", "intensity", *_IDS, "return", "returns", "position", "ring", "time", "radial_velocity")


class Beam(NamedTuple):
    """Rays that a beam is traced by, and which returns their hits become."""

    offsets: Array      # tangents (K, 2) across it
    power: Array        # (K,)
    near: float
    far: float
    resolution: float
    threshold: float
    returns: int
    prefer: str
    of_hits: tuple[str, ...]

    def measured(self, scene: Any, beams: Array, **job: Any) -> dict[str, Array]:
        """The returns of beams (N, 6), without noise. Each may have a mask and a time of its own."""
        count = len(self.power)
        cast = np.empty((len(beams), count, 8))
        cast[..., :3], cast[..., 3], cast[..., 7] = beams[:, None, :3], self.near, self.far
        cast[..., 4:7] = _spread(beams[:, 3:], self.offsets)
        of_rays = {name: np.repeat(job[name], count) for name in _several(job)}
        hits = scene.trace(cast.reshape(-1, 8), fields=tuple(dict.fromkeys(("t", "normal", "base_colour", *self.of_hits))),
                           **{**job, **of_rays})
        return _returns_of(hits, cast[..., 4:7].reshape(-1, 3), self.power, self.resolution, self.threshold, self.returns,
                           self.prefer, self.of_hits)


class Tracer:
    """A scene as measure() traces it, in one epoch."""

    def __init__(self, scene: Any, epoch: Optional[int] = None) -> None:
        self._scene = scene
        self._epoch = {"epoch": epoch} if epoch else {}

    def trace(self, rays: Any, **options: Any) -> dict[str, Array]:
        seen: dict[str, Array] = self._scene.trace(rays, **options, **self._epoch)
        self._epoch = {"epoch": self._scene._client.outcome["epoch"]}
        return seen

    def path_of(self, ids: Array) -> list[str]:
        found: list[str] = self._scene.path_of(ids, **self._epoch)
        return found

    def measured(self, beam: Beam, beams: Array, job: dict[str, Any]) -> dict[str, Array]:
        """The returns of all beams, in their order."""
        order = np.arange(len(beams))
        if "time" in _several(job):     # each part is of few moments
            order = np.argsort(job["time"], kind="stable")
        each = max(1, self._rays_max() // len(beam.power))
        cuts = [order[first:first + each] for first in range(0, max(1, len(order)), each)]
        pieces = [(beams[cut], {**job, **{name: np.asarray(job[name])[cut] for name in _several(job)}}) for cut in cuts]
        parts = list(self._of(beam, pieces))
        made = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        made["beam"] = np.concatenate([cut[part["beam"]] for cut, part in zip(cuts, parts)])
        if "time" not in _several(job):
            return made
        back = np.argsort(made["beam"], kind="stable")
        return {name: column[back] for name, column in made.items()}

    def _rays_max(self) -> int:
        return _TRACED_MAX

    def _of(self, beam: Beam, pieces: Sequence[tuple[Array, dict[str, Any]]]) -> Iterable[dict[str, Array]]:
        return (beam.measured(self, beams, **job) for beams, job in pieces)


def _several(job: Mapping[str, Any]) -> list[str]:
    """Those of the options that each beam has for itself."""
    return [name for name in ("mask", "time") if is_several(name, job.get(name))]


def measure(scene: Union[Scene, Tracer], sweep: Union[Sweep, generators.Sweep, generators.Lidar], *, divergence: float = 0.0,
            footprint: int = 19, returns: int = 1, prefer: Literal["nearest", "strongest"] = "nearest",
            resolution: float = 0.3, threshold: float = 0.0, range: Optional[tuple[float, float]] = None,
            noise: float = 0.0, seed: int = 0, velocities: Optional[Mapping[str, Any]] = None,
            fields: Union[str, Sequence[str], None] = None, **job: Any) -> dict[str, Array]:
    """Measures a sweep and returns columns with a row per return, beam by beam, near ones first. `sweep` is one of
    raynest.sweeps, or a lidar() or sweep() of raynest.generators, whose rays are then made here.

    A beam spreads by `divergence` (radians, the full angle in which its power falls to 1/e^2). It is traced by
    `footprint` rays, each of which ends at the first surface. Rays whose distances differ by less than `resolution`
    from the next make one return. Of the returns with a share of the beam of at least `threshold`, a beam keeps at
    most `returns`, and those that `prefer` names. `range` is the range in which the sensor measures, by default
    that of the generator. Distances get Gaussian noise with the standard deviation `noise`, the same for the same
    `seed`; the returns of a beam are in the order that they have without noise.

    Columns: beam (row of the sweep), ring, time, return (from 0) and returns (how many the beam has); t and position,
    along the beam's middle, with noise; share (of the beam's power that met this surface) and intensity (share times
    the base colour's luminance times the cosine to the surface's normal: 1 is a white wall seen at right angles);
    prim, geom, path and uid of the hit that reflected most; radial_velocity (away from the sensor is positive). `fields`
    names those that are wanted, of these and of the columns of hits that trace() has: normal, base_colour, texcoord,
    reflectance, material, ... are of the hit that reflected most, and velocity is that of the point.

    `velocities` says what moves, by texts of paths, with * as in edits: {"car-*": v} moves the cars and all their
    parts. If several texts match, the first counts. v is a velocity (3,), or (3, 3): the velocity, the angular
    velocity in radians, and a point of the axis at the earliest time of the sweep's rays. Everything else stands still,
    or with `time` moves as the animation does then: at one time, or with time=sweep.time at that of each beam, and
    perhaps a `time_step` (see Scene.trace()). `job` has more options of that: epoch, hide, origin, ..., and `mask`, one
    for all beams or one for each. All is measured in one epoch of the scene: InvalidError says that it
    has gone, if others edit the scene meanwhile."""
    check_sweep(sweep)
    offsets, power = _footprint(divergence, footprint)
    returns = count_of("returns", returns, _RETURNS_MAX)
    resolution, threshold, noise = real("resolution", resolution), real("threshold", threshold), real("noise", noise)
    seed = whole("seed", seed, 2**64 - 1, 0)
    if not (0 < resolution < np.inf and 0 <= threshold <= 1 and 0 <= noise < np.inf):
        raise UsageError("resolution must be above 0, threshold from 0 to 1, and noise not negative, all of them finite")
    if prefer not in ("nearest", "strongest"):
        raise UsageError(f"prefer={prefer!r}: it is 'nearest' or 'strongest'")
    ends = numbers("range", _range_of(sweep) if range is None else range).astype(np.float64)
    if ends.shape != (2,) or not 0 <= ends[0] < ends[1]:
        raise UsageError(f"range={range!r}: it is (near, far), and must begin at 0 or above, and end after that")
    near, far = ends
    if unknown := job.keys() - JobOptions.__annotations__.keys() - {"origin", "progress", *_CHOSEN}:
        raise unknown_argument("measure", min(unknown), (*(name for name in inspect.signature(measure).parameters if name != "job"),
                                                         *JobOptions.__annotations__))
    if taken := job.keys() & set(_CHOSEN):
        raise UsageError(f"measure() chooses {', '.join(sorted(taken))} itself: leave it out")
    if velocities is not None and not isinstance(velocities, Mapping):
        raise UsageError("velocities are by the texts of paths: {'car-3': (12, 0, 0)}")
    names, of_hits = _asked(fields)
    moves = {text: _motion(text, motion) for text, motion in (velocities or {}).items()}
    texts = list(moves)
    epoch = job.pop("epoch", None)
    tracer = scene if isinstance(scene, Tracer) else Tracer(scene, epoch)
    for first in np.arange(0, len(texts), _limits.list_items_max):  # a text that names nothing is refused
        tracer.trace(np.zeros((0, 6)), hide=texts[first:first + _limits.list_items_max])
    if not isinstance(sweep, Sweep):
        sweep = _beams_of(tracer, sweep, job)
    for name in _several(job):
        if np.shape(job[name]) != (len(sweep.rays),):
            raise UsageError(f"{name} of shape {np.shape(job[name])} for {len(sweep.rays)} beams: it must be one number, or one for each beam")
    if "time" in _several(job):     # as they are for all beams
        job["time"] = moments(job["time"], job.pop("time_step", None), len(sweep.rays))
    if "time" in job:
        of_hits = (*of_hits, "velocity")
    made = tracer.measured(Beam(offsets, power, near, far, resolution, threshold, returns, prefer, of_hits), sweep.rays, job)
    beam = made["beam"]
    made["t"] = made["t"] + np.random.default_rng(seed).normal(0, noise, len(beam)) if noise else made["t"]
    made["position"] = sweep.rays[beam, :3] + made["t"][:, None] * sweep.rays[beam, 3:]
    made["ring"], made["time"] = sweep.ring[beam], sweep.time[beam]
    moving = made.pop("velocity", np.zeros((len(beam), 3))).astype(np.float64)
    part_of = _parts_of(tracer, made["path"], texts)
    for number, (along, turning, pivot) in enumerate(moves.values()):
        of = part_of == number
        since = (made["time"][of] - sweep.time.min(initial=np.inf))[:, None]
        moving[of] = along + np.cross(turning, made["position"][of] - pivot - along * since)
    made["radial_velocity"] = ((moving - sweep.velocity[beam]) * sweep.rays[beam, 3:]).sum(axis=1)
    made["velocity"] = moving
    return {name: made[name] for name in names}


# Arguments of measure() by which a function that also traces knows that it is to measure.
OF_RETURNS = {name for name in inspect.signature(measure).parameters if name not in ("scene", "sweep", "fields", "job")}


def check_sweep(sweep: Any) -> None:
    if not isinstance(sweep, (Sweep, generators.Sweep, generators.Lidar)):
        raise TypeError(f"sweep of type {type(sweep).__module__}.{type(sweep).__name__}: measure() takes what "
                        "raynest.sweeps.lidar() makes, or lidar() or sweep() of raynest.generators")


def _asked(fields: Union[str, Sequence[str], None]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the columns of the answer, and those of hits that are needed for it."""
    names = _COLUMNS if fields is None else (fields,) if isinstance(fields, str) else tuple(fields)
    for name in names:
        if name not in _COLUMNS and name not in OF_HITS:
            raise UsageError(f"there is no column {name}: there are {', '.join(_COLUMNS)}, and of hits "
                             f"{', '.join(each for each in OF_HITS if each not in _COLUMNS)}")
    return names, (*_IDS, *(name for name in names if name not in (*_COLUMNS, "velocity")))


def _range_of(sweep: Any) -> tuple[float, float]:
    sensor = {} if isinstance(sweep, Sweep) else sweep._sensor
    return sensor.get("tmin", 0.0), sensor.get("tmax", np.inf)


def _beams_of(tracer: Tracer, sensor: Union[generators.Sweep, generators.Lidar], job: dict[str, Any]) -> Sweep:
    """The rays of a generator. Of a lidar that stands still the daemon makes them: it may stand at a camera of the scene."""
    if isinstance(sensor, generators.Sweep):
        if "step_error" in sensor._settings:
            raise UsageError("measure() goes without the sweep's step_error: pass time=sweep.time and a time_step to it")
        return sensor.beams()
    found = tracer.trace(sensor, fields=("origin", "direction"), **{name: job[name] for name in ("origin",) if name in job})
    ways = found["direction"].astype(np.float64)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return Sweep(np.hstack([found["origin"], ways]), sensor.ring, np.zeros(sensor.count), np.zeros((sensor.count, 3)))


def _footprint(divergence: Any, count: Any) -> tuple[Array, Array]:
    """Tangents (K, 2) across a beam, evenly over its footprint along a spiral, and the power (K,) of each, 1 in all."""
    divergence = real("divergence", divergence)
    count = count_of("footprint", count, _FOOTPRINT_MAX)
    if not 0 <= divergence < np.pi / 2:
        raise UsageError(f"divergence={divergence}: it is an angle in radians from 0 to below pi/2")
    if divergence == 0 or count == 1:
        return np.zeros((1, 2)), np.ones(1)
    number = np.arange(count)
    radius = np.sqrt(number / (count - 1))
    angle = number * np.pi * (3 - np.sqrt(5))
    power = np.exp(-2 * radius**2)
    ring = np.tan(divergence / 2) * radius
    return np.stack([ring * np.cos(angle), ring * np.sin(angle)], -1), power / power.sum()


def _spread(ways: Array, offsets: Array) -> Array:
    """Unit directions (N, K, 3) around unit `ways` (N, 3). One whose offset is 0 keeps its bits."""
    helper = np.eye(3)[np.argmin(np.abs(ways), axis=1)]
    right = np.cross(ways, helper)
    right /= np.linalg.norm(right, axis=1)[:, None]
    up = np.cross(right, ways)
    spread: Array = ways[:, None] + offsets[:, :1] * right[:, None] + offsets[:, 1:] * up[:, None]
    aside = offsets.any(axis=1)
    spread[:, aside] /= np.linalg.norm(spread[:, aside], axis=2)[..., None]
    return spread


def _returns_of(hits: dict[str, Array], ways: Array, power: Array, resolution: float, threshold: float, most: int,
                prefer: str, of_hits: Sequence[str]) -> dict[str, Array]:
    """Joins the hits of K rays per beam to returns, with these columns of the hit that reflected most."""
    rays = len(power)
    t = hits["t"].astype(np.float64).reshape(-1, rays)
    order = np.argsort(t, axis=1, kind="stable")
    with np.errstate(invalid="ignore"):  # inf - inf
        begins = np.diff(np.take_along_axis(t, order, 1), axis=1, prepend=-np.inf) > resolution
    of_beam = np.arange(len(t))[:, None]
    row = (of_beam * rays + order).ravel()
    met = np.isfinite(t.ravel()[row])
    row = row[met]
    # Numbers returns from 0, over all beams.
    number = np.cumsum(begins.ravel()[met]) - 1
    count = int(number[-1]) + 1 if len(number) else 0
    normal = hits["normal"][row].astype(np.float64)
    length = np.linalg.norm(normal, axis=1)
    cosine = np.minimum(np.abs((normal * ways[row]).sum(axis=1)) / np.where(length > 0, length, 1), 1)
    weight = power[row % rays]
    light = weight * cosine * (hits["base_colour"][row] @ _LUMINANCE)
    def total(values: Array) -> Array:
        return np.bincount(number, values, minlength=count).astype(np.float64)
    share = np.minimum(total(weight), 1)
    # The last of each return's hits, weakest first, is the one that reflected most.
    strongest = np.zeros(count, np.int64)
    by_light = np.lexsort((weight, light))
    strongest[number[by_light]] = row[by_light]
    beam = np.zeros(count, np.int64)
    beam[number] = row // rays
    made: dict[str, Array] = {"beam": beam, "t": total(weight * t.ravel()[row]) / np.where(share > 0, share, 1), "share": share,
            "intensity": np.minimum(total(light), 1), **{name: hits[name][strongest] for name in of_hits}}
    kept = np.flatnonzero(share >= threshold - _ROUNDING)
    if prefer == "strongest":
        kept = kept[np.lexsort((-made["intensity"][kept], beam[kept]))]
    kept = np.sort(kept[_place_in_beam(beam[kept]) < most])
    made = {name: column[kept] for name, column in made.items()}
    made["return"] = _place_in_beam(made["beam"]).astype(np.uint8)
    made["returns"] = np.bincount(made["beam"], minlength=len(t)).astype(np.uint8)[made["beam"]]
    return made


def _place_in_beam(beam: Array) -> Array:
    """For ascending beams, the how-manieth each row is in its own."""
    first = np.flatnonzero(np.diff(beam, prepend=-1))
    return np.arange(len(beam)) - np.repeat(first, np.diff(first, append=len(beam)))


def _parts_of(tracer: Tracer, paths: Array, texts: list[str]) -> Array:
    """For each path, the first of `texts` that names it or what it is part of; -1 for none."""
    if not texts or not len(paths):
        return np.full(len(paths), -1)
    ids, where = np.unique(paths, return_inverse=True)
    patterns = [form_of(text) for text in texts]
    found = [next((number for number, pattern in enumerate(patterns) if pattern.fullmatch(path)), -1)
             for path in tracer.path_of(ids)]
    return np.array(found)[where]


def _motion(text: Any, motion: Any) -> Array:
    if not isinstance(text, str):
        raise UsageError(f"velocities are by the texts of paths, such as 'car-3', not by {text!r}")
    given = numbers(f"the velocity of '{text}'", motion).astype(np.float64)
    if given.shape not in ((3,), (3, 3)) or not np.isfinite(given).all():
        raise UsageError(f"the velocity of '{text}' has shape {given.shape}: it is three finite numbers, or (3, 3): "
                         "velocity, angular velocity, and a point of the axis")
    return np.concatenate([given[None], np.zeros((2, 3))]) if given.ndim == 1 else given
