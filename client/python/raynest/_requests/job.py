"""Options and outcome of a job: the parts that queries, pictures and heat maps share."""
from __future__ import annotations

import difflib
import reprlib
from typing import Any, Callable, Mapping, Optional, TypedDict, Union

import numpy as np

from .. import _limits
from .._lists import INTEGRATOR_SETTINGS, Worker
from .._net.control import Message
from .._net.frame import Array
from .._wording import localize_message
from ..errors import ProtocolError, RayWarning, UsageError, warn
from .arguments import is_several, milliseconds
from .selection import selection_lists

# Called with (done, total, stage).
Progress = Optional[Callable[[int, int, str], object]]


class JobOptions(TypedDict, total=False):
    """Keyword arguments of trace(), stream(), occluded(), render() and heatmap(). None means the
    default."""

    intersector: Optional[str]      # a variant's name; "auto" masks by alpha where the scene does
    params: Optional[Mapping[str, object]]  # the intersector's: {"cutoff": 0.3}, a table as an array
    traversal: Optional[str]        # "auto", or one of those that `raynest query --help` lists
    mask: Any                       # rays see instances that share a bit with it; of rays that are sent also (N,)
    epoch: Optional[int]            # the scene's; 0 is the current one, others only while a request reads them
    deadline: Optional[float]       # seconds; 0 is none
    priority: Optional[str]         # "normal", "low" or "high"
    worker: Optional[Worker]        # "auto" lets the daemon choose
    hide: Any                       # what no ray enters: 3, "inst=3", "object=2", "car#3/wheel*", or a list of them
    only: Any                       # the same: if any, rays enter nothing else
    time: Any                       # seconds within the scene's animation; None: the scene as it is. trace() takes (N,)
    time_step: Optional[float]      # seconds within which it takes the rays' times for one; None: all times are exact
    animation: Union[str, int, None]  # its name or number; the first one
    skip_hidden_boxes: Optional[bool]  # boxes that lead to what is hidden alone are not tested, nor counted


# These add up over several requests, in their outcome.
SUMS = ("rays", "hits", "misses", "invalid", "truncated", "rows", "seconds")


class Outcome(dict[str, Any]):
    """Describes the job that ran, with the keys of `raynest --json`: intersector, target, traversal,
    epoch, rays, hits, misses, seconds, notes, ... A heat map adds metric, min, mean, p50, p99, max
    and clipped, which are also in the dict `heat`."""

    def take(self, name: str, message: Message) -> None:
        if name not in ("Started", "Done"):
            return
        if name == "Started" and "origin" in self:
            raise ProtocolError("the daemon sent Started twice")
        notes = [*self.get("notes", []), *map(localize_message, message.get("notes", []))]
        if message["worker"] not in ("", self.get("worker", message["worker"])):
            self["worker_reason"] = ""  # it explains the choice of another worker
        # Done repeats only the words that have changed.
        self.update({key: value for key, value in message.items()
                     if value is not None and (name == "Started" or value != "")})
        if self.get("heat"):
            self["heat"] = signed_statistics(self["heat"])
            self.update(self["heat"])
        self["notes"] = notes
        if not self.get("invalid"):
            self.pop("first_invalid", None)
        # Only pictures have samples; one that its deadline ended may have pixels without one.
        if not self.get("samples") and not self.get("incomplete"):
            for key in ("samples", "noise", "dropped", "incomplete"):
                self.pop(key, None)
        if name == "Started":
            self["origin"] = origin_of(self)
            del self["hidden"]

    def check_started(self) -> None:
        """The answers to a job begin with one that says what runs."""
        if "origin" not in self:
            raise ProtocolError("the daemon ended a request that it had not started")

    rays_per_point = 0
    """Rays per point of a generator that starts from points, else 0."""
    rounding: Any = None
    """A Rounding of its rays, if that was worth a warning."""

    def warn_of_view(self) -> None:
        for note in self.get("notes", ()):
            if note.startswith("camera "):
                warn(note, RayWarning)

    @property
    def rays(self) -> int:
        return int(self.get("rays", 0))

    def following(self, earlier: Outcome) -> Outcome:
        """The outcome of a stream, of which this is that of the last block."""
        whole = Outcome(self)
        for key in SUMS:
            if key in earlier:
                whole[key] = earlier[key] + self.get(key, 0)
        if "first_invalid" in earlier:
            whole["first_invalid"] = earlier["first_invalid"]
        elif "first_invalid" in self:
            whole["first_invalid"] += earlier.rays
        return whole

    def warn_of_rays(self, before: int = 0) -> None:
        """`before` rays were streamed before these."""
        if self.get("invalid"):
            first = f"ray {before + self['first_invalid']}"
            if self.rays_per_point:
                first += f", of point {self['first_invalid'] // self.rays_per_point}"
            told = (f"{first} is not valid and counts as a miss" if self["invalid"] == 1 else
                    f"{self['invalid']} of {self['rays']} rays are not valid and count as misses, "
                    f"the first is {first}")
            warn(f"{told}: something in it is not finite, its direction is zero, or tmin is "
                 "negative or beyond tmax", RayWarning)
        if self.get("truncated"):
            warn(f"{self['truncated']} of {self['rays']} rays have more hits than max_hits, of "
                 "which the nearest were kept; raise it", RayWarning)


def signed_statistics(heat: dict[str, Any]) -> dict[str, Any]:
    """Differences, whose range alone begins below zero, travel as the u32 of the same bits."""
    if heat["range_low"] >= 0:
        return heat
    heat = {**heat, "difference": True}
    return {key: value - 2**32 if key in ("min", "p50", "p90", "p99", "max") and value >= 2**31 else value
            for key, value in heat.items()}


class SceneMoved(Exception):
    """The scene's name now means a scene with another origin."""

    def __init__(self, origin: Array) -> None:
        super().__init__("the scene was replaced by one with another origin")
        self.origin = origin


def origin_of(message: dict[str, Any]) -> list[float]:
    """Replaces the message's three origin fields by one list, which it returns."""
    origin = [message.pop(f"origin_{axis}") for axis in "xyz"]
    if not np.isfinite(origin).all():
        raise ProtocolError("the daemon sent an origin that is not finite")
    return origin


def job_message(scene: str, options: JobOptions) -> Message:
    unknown = options.keys() - JobOptions.__annotations__.keys()
    if unknown:
        raise TypeError(_no_option(sorted(unknown)[0]))
    message: Message = {key: value for key, value in options.items()
                        if key not in ("params", "deadline", "hide", "only", "time_step")}
    message["scene"] = scene
    if is_several("mask", options.get("mask")):
        raise UsageError("mask must be one number here: rays that trace(), stream() and occluded() send have one each")
    if is_several("time", options.get("time")):
        raise UsageError("time must be one number here: trace() takes one for each ray that it sends")
    if options.get("time_step") is not None:
        raise UsageError("time_step is for rays with times of their own: pass trace() a time for each ray that it sends, "
                         "or leave time_step out")
    if options.get("time") is not None:
        message["timed"] = True
    if isinstance(options.get("animation"), (int, np.integer)) and not isinstance(options["animation"], bool):
        message["animation"] = str(options["animation"])
    for key, prefix in (("hide", "hidden"), ("only", "only")):
        message.update(selection_lists(key, prefix, options.get(key)))
    params = options.get("params")
    if not isinstance(params, (Mapping, type(None))):
        raise UsageError(f"params of {reprlib.repr(params)}: it must be a dict, for example "
                         "{'cutoff': 0.3}")
    message["settings"] = [f"{key}={value}" for key, value in (params or {}).items()
                           if value is not None and not _is_table(value)]
    message["tables"] = [{"name": key, "values": _table(key, value)}
                         for key, value in (params or {}).items() if _is_table(value)]
    message["deadline_ms"] = milliseconds(options.get("deadline"))
    return message


def _is_table(value: object) -> bool:
    return isinstance(value, (list, tuple)) or isinstance(value, np.ndarray) and value.ndim > 0


def _table(name: str, value: Any) -> list[float]:
    """Returns the values of a parameter that is a table, as float32 has them."""
    try:
        values = np.asarray(value, np.float32)
    except (TypeError, ValueError):
        values = np.empty((0, 0), np.float32)
    if values.ndim != 1:
        raise UsageError(f"params['{name}'] of {reprlib.repr(value)}: a table is a list or an array "
                         "of numbers, of one dimension")
    if len(values) > _limits.table_values_max:
        raise UsageError(f"params['{name}'] has {len(values)} values: the tables of a job have at most "
                         f"{_limits.table_values_max}")
    return [float(each) for each in values]


_RANGES = ("rays (N, 8) have a range each: ox oy oz tmin dx dy dz tmax; a generator takes tmin= and tmax= "
           "itself")
# Options of the calls themselves, for those who misspell one.
_OWN = ("kind", "fields", "max_hits", "reduce", "origin", "progress", "detach", "camera", "look_at", "fov",
        "size", "encode", "integrator", "spp", "seed", "noise", "environment", "environment_rotate", "sun", "metric", "diff",
        "pixel", "steps", "top")
# Words of the command line and of other libraries.
_MEANT = {"env": "render() has environment=", "samples": "render() has spp=",
          "lookat": "look_at= is of pictures, and of raynest.generators for rays",
          "tmin": _RANGES, "tmax": _RANGES,
          "set": "params={'cutoff': 0.3}", "level": "metric='boxes.1' is that of a level",
          "palette": "heatmap() has it, and png() of its answer"}


def _no_option(name: str) -> str:
    near = _MEANT.get(name) or next(iter(difflib.get_close_matches(
        name, [*JobOptions.__annotations__, *_OWN, *INTEGRATOR_SETTINGS], 1)), "")
    meant = f": {near}." if name in _MEANT else f": did you mean {near}=?" if near not in ("", name) else "."
    return (f"this call has no option {name}{meant} Besides its own, which help() shows, it has "
            f"{', '.join(JobOptions.__annotations__)}")


def other_message(scene: str, job: JobOptions, diff: Any) -> Optional[Message]:
    """The job that a difference subtracts: `diff` is another Scene, or the options that differ."""
    if diff is None:
        return None
    name = getattr(diff, "name", None)
    if isinstance(name, str):
        of_other = job.copy()
        of_other["epoch"], of_other["hide"], of_other["only"] = 0, None, None
        return job_message(name, of_other)
    if not isinstance(diff, Mapping):
        raise UsageError(f"diff of {reprlib.repr(diff)}: it must be a Scene, or a dict of the options "
                         "that differ, as {'intersector': 'opaque'}")
    options = {**job, **diff}
    if diff.get("intersector", job.get("intersector")) == job.get("intersector"):
        # The parameters of one intersector are not those of another.
        options["params"] = {**(job.get("params") or {}), **(diff.get("params") or {})}
    else:
        options["params"] = diff.get("params")
    return job_message(scene, options)  # type: ignore[arg-type]
