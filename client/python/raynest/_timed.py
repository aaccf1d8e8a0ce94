"""Rays that have times of their own: each meets the scene as its animation has it then."""
from __future__ import annotations

from typing import Any, Callable, Mapping

import numpy as np

from ._net.frame import Array
from ._requests.arguments import array_of, is_several, numbers, real
from ._requests.columns import OF_HITS
from ._requests.job import SUMS
from .errors import UsageError


def trace_at_times(trace: Callable[..., dict[str, Array]], outcome: Callable[[], dict[str, Any]], rays: Any,
                   directions: Any, options: Mapping[str, Any]) -> dict[str, Array]:
    """Calls `trace` with the rays of each time of options["time"], (N,), or of each stretch of options["time_step"]
    seconds at its middle, and returns the answer for all in their order."""
    given = {name: value for name, value in options.items() if name not in ("time", "time_step", "progress", "mask")}
    progress, mask = options.get("progress"), options.get("mask")
    if options.get("reduce") or options.get("detach"):
        raise UsageError("a time for each ray goes without reduce= and detach=")
    if hasattr(rays, "source"):
        raise UsageError("a generator's rays have the times of its sensor: pass one time, or step_error= to the generator")
    # Masked rows stay so.
    rays, directions = (each if each is None or isinstance(each, np.ndarray) else array_of(what, each)
                        for what, each in (("rays", rays), ("directions", directions)))
    sent = [each for each in (rays, directions) if each is not None]
    count = max((len(each) for each in sent if each.ndim == 2), default=int(all(each.size for each in sent)))
    at, of = _stretches(_checked(options["time"], count), options.get("time_step"))
    parts: list[tuple[Array, dict[str, Array]]] = []
    sums: dict[str, Any] = {}
    invalid: list[int] = []
    for number, time in enumerate(at):
        rows = np.flatnonzero(of == number)
        some = [each if each is None or each.ndim == 1 else each[rows] for each in (rays, directions)]
        more = {} if mask is None else {"mask": np.asarray(mask)[rows] if is_several("mask", mask) else mask}
        parts.append((rows, trace(*some, time=float(time), **given, **more)))
        given["epoch"] = outcome()["epoch"]  # all meet one epoch
        if outcome().get("invalid"):
            invalid.append(int(rows[outcome()["first_invalid"]]))
        for name in SUMS:
            sums[name] = sums.get(name, 0) + outcome().get(name, 0)
        if progress:
            progress(number + 1, len(at), "tracing")
    if not parts:
        return trace(rays, directions, **given)
    outcome().update({name: total for name, total in sums.items() if name in outcome()})
    if invalid:
        outcome()["first_invalid"] = min(invalid)
    return _joined(parts, count)


def moments(time: Any, step: Any, count: int) -> Array:
    """The moment at which each of so many rays meets the scene."""
    at, of = _stretches(_checked(time, count), step)
    return at[of]


def _checked(time: Any, count: int) -> Array:
    times = numbers("time", time).astype(np.float64)
    if times.shape != (count,) or not np.isfinite(times).all():
        raise UsageError(f"time of shape {times.shape} for {count} rays: it must be one number, or a finite one for each ray")
    return times


def _stretches(times: Array, step: Any) -> tuple[Array, Array]:
    """Returns the moments, ascending, and the number of that of each ray."""
    if step is None:
        at, of = np.unique(times, return_inverse=True)
        return at, of
    step = real("time_step", step)
    if not 0 < step < np.inf:
        raise UsageError(f"a time_step of {step}: it must be finite and above 0")
    _, of = np.unique(np.floor((times - times.min(initial=np.inf)) / step), return_inverse=True)
    first, last = (np.full(of.max(initial=-1) + 1, end) for end in (np.inf, -np.inf))
    np.minimum.at(first, of, times)
    np.maximum.at(last, of, times)
    return (first + last) / 2, of


def _joined(parts: list[tuple[Array, dict[str, Array]]], count: int) -> dict[str, Array]:
    """The columns of all rays, from those of some, whose numbers stand beside them."""
    first = parts[0][1]
    counts = np.ones(count, np.int64)
    has_splits = "ray_splits" in first
    for rows, columns in parts if has_splits else ():
        counts[rows] = np.diff(columns["ray_splits"].astype(np.int64))
    splits = np.concatenate([[0], np.cumsum(counts)])
    made: dict[str, Array] = {}
    for name, column in first.items():
        if name == "ray_splits":
            made[name] = splits.astype(column.dtype)
            continue
        of_hits = has_splits and name in OF_HITS
        made[name] = np.empty((splits[-1] if of_hits else count, *column.shape[1:]), column.dtype)
        for rows, columns in parts:
            if of_hits:
                places = np.repeat(splits[rows], counts[rows]) + np.arange(counts[rows].sum()) - \
                    np.repeat(np.cumsum(counts[rows]) - counts[rows], counts[rows])
                made[name][places] = columns[name]
            else:
                made[name][rows] = columns[name]
    return made
