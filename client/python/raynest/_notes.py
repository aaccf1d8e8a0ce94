"""Warnings and notes of items: the user gets them once, as from one daemon that makes all of the items."""
from __future__ import annotations

import operator
import re
from typing import Iterable, NamedTuple, Optional, Sequence

from ._requests.film import warn_if_incomplete
from ._requests.job import Outcome
from .errors import RayWarning, Warning, warn, warnings_taken

# Counts that stand in warnings, by the method of Scene that was called.
COUNTED = {"trace": ("invalid", "first_invalid", "truncated"), "render": ("incomplete", "samples")}


# A daemon's note of a picture whose pixels have not all the same number of samples.
_SPREAD = re.compile(r"pixels have (\d+) to (\d+) of (\d+) samples, (\S+) on average\Z")


def notes_of(parts: Iterable[tuple[float, Sequence[str]]]) -> list[str]:
    """The notes of all parts of a request, each once. With those of a part stands how much of the whole it is."""
    notes: dict[str, None] = {}
    spread: list[tuple[float, int, int, float]] = []
    complete, asked = 0.0, 0
    for weight, told in parts:
        forms = [_SPREAD.match(note) for note in told]
        notes.update((note, None) for note, form in zip(told, forms) if not form)
        for form in filter(None, forms):
            asked = int(form[3])
            spread.append((weight, int(form[1]), int(form[2]), float(form[4])))
        complete += 0 if any(forms) else weight
    if spread:
        weights, least, most, means = zip(*spread, *([(complete, asked, asked, asked)] if complete else []))
        mean = sum(map(operator.mul, weights, means)) / sum(weights)
        notes[f"pixels have {min(least)} to {max(most)} of {asked} samples, {mean:.3g} on average"] = None
    return list(notes)


def note_of_none(samples: int) -> str:
    """The note of pixels that have none of so many samples."""
    return f"pixels have 0 to 0 of {samples} samples, 0 on average"


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
    told, whole = list(told), Outcome()
    ends = [*(first for first, _ in told[1:]), rays]
    for category in dict.fromkeys(category for _, item in told for _, category in item.warned):
        for text in notes_of((end - first, [text for text, its in item.warned if its is category])
                             for (first, item), end in zip(told, ends)):
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
