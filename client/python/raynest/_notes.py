"""Warnings and notes of items: the user gets them once, as from one daemon that makes all of the items."""
from __future__ import annotations

from typing import Iterable, NamedTuple, Optional, Sequence

from ._requests.film import warn_if_incomplete
from ._requests.job import Outcome
from .errors import RayWarning, Warning, warn, warnings_taken

# Counts that stand in warnings, by the method of Scene that was called.
COUNTED = {"trace": ("invalid", "first_invalid", "truncated"), "render": ("incomplete", "samples")}


class Told(NamedTuple):
    """Warnings of an item. `counts` is None where nothing of it is worth one."""

    warned: Sequence[tuple[str, type[Warning]]] = ()
    counts: Optional[Outcome] = None


def told_of(method: str, warned: Sequence[tuple[str, type[Warning]]], outcome: Outcome) -> Told:
    """Takes what a method of Scene has warned of, and its outcome says."""
    counts = Outcome({key: outcome[key] for key in COUNTED.get(method, ()) if key in outcome})
    counts["rays"] = outcome.rays
    counts.rays_per_point, counts.rounding = outcome.rays_per_point, outcome.rounding
    with warnings_taken() as counted:
        _warn_of(counts)
    notes: list[tuple[str, type[Warning]]] = [(note, RayWarning) for note in outcome.get("notes", ())]
    said = dict.fromkeys([*warned, *notes])
    return Told(tuple(each for each in said if each not in counted), counts if counted else None)


def _warn_of(counts: Outcome) -> None:
    if counts.rounding:
        warn(counts.rounding.text, RayWarning)
    counts.warn_of_rays()
    warn_if_incomplete(counts)


def tell(told: Iterable[tuple[int, Told]], rays: int) -> None:
    """Warns of what the items of a request tell, each with the number of its first ray of so many."""
    whole = Outcome()
    for text, category in dict.fromkeys(each for _, item in told for each in item.warned):
        warn(text, category)
    for first, counts in ((first, item.counts) for first, item in told if item.counts is not None):
        for key in ("invalid", "truncated"):
            whole[key] = whole.get(key, 0) + counts.get(key, 0)
        if "first_invalid" in counts:
            invalid = first + counts["first_invalid"]
            whole["first_invalid"] = min(whole.get("first_invalid", invalid), invalid)
        if counts.get("incomplete"):
            whole.update(incomplete=True, samples=min(whole.get("samples", counts["samples"]), counts["samples"]))
        whole.rays_per_point = counts.rays_per_point
        if counts.rounding:
            found = counts.rounding._replace(first=first + counts.rounding.first)
            whole.rounding = found.with_others(whole.rounding, rays)
    whole["rays"] = rays
    _warn_of(whole)
