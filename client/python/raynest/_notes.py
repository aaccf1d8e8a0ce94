"""Warnings and notes of items: the user gets them once, as from one daemon that makes all of the items."""
from __future__ import annotations

import math
import operator
import re
from typing import Any, Callable, Iterable, Mapping, NamedTuple, Optional, Sequence

from ._requests.film import warn_if_incomplete
from ._requests.job import Outcome
from ._wording import localize_message
from .errors import RayWarning, Warning, warn, warnings_taken

# Counts that stand in warnings, by the method of Scene that was called.
COUNTED = {"trace": ("invalid", "first_invalid", "truncated"), "render": ("incomplete", "samples")}


def _spread_of(whole: float, notes: Sequence[tuple[float, re.Match[str]]]) -> str:
    asked = int(notes[0][1][3])
    told = [(weight, int(note[1]), int(note[2]), float(note[4])) for weight, note in notes]
    complete = whole - sum(weight for weight, _ in notes)
    weights, least, most, means = zip(*told, *([(complete, asked, asked, asked)] if complete else []))
    mean = sum(map(operator.mul, weights, means)) / whole
    return f"pixels have {min(least)} to {max(most)} of {asked} samples, {mean:.3g} on average"


def _noise_of(whole: float, notes: Sequence[tuple[float, re.Match[str]]]) -> str:
    """All parts are about as large; the error of those that do not tell it is at most what was asked for."""
    of = sum(weight for weight, _ in notes)
    noisy, parts = (sum(int(note[i]) for _, note in notes) for i in (2, 3))
    squares = sum(weight * float(note[4]) ** 2 for weight, note in notes) + (whole - of) * float(re.split("[ =]", notes[0][1][1])[-1]) ** 2
    return (f"the error is still above {notes[0][1][1]} in {noisy} of {round(parts * whole / of)} parts of the picture, "
            f"{math.sqrt(squares / whole):.3g} in all of it: {notes[0][1][5]}")


def _dropped_of(_whole: float, notes: Sequence[tuple[float, re.Match[str]]]) -> str:
    return f"{sum(int(note[1]) for _, note in notes)} {notes[0][1][2]}"


# A daemon's notes that count, and what makes one of those of all parts, each with its part of the whole.
_COUNTING: dict[re.Pattern[str], Callable[[float, Sequence[tuple[float, re.Match[str]]]], str]] = {
    re.compile(r"pixels have (\d+) to (\d+) of (\d+) samples, (\S+) on average\Z"): _spread_of,
    re.compile(r"the error is still above (\S+[ =]\S+) in (\d+) of (\d+) parts of the picture, (\S+) in all of it: (.*)"): _noise_of,
    re.compile(r"(\d+) (samples were not finite .*)"): _dropped_of}


def notes_of(parts: Iterable[tuple[float, Sequence[str]]]) -> list[str]:
    """The notes of all parts of a request, each once. With those of a part stands how much of the whole it is."""
    plain: dict[str, None] = {}
    counting: dict[re.Pattern[str], list[tuple[float, re.Match[str]]]] = {}
    whole = 0.0
    for weight, told in parts:
        whole += weight
        for note in told:
            form = next(filter(None, (pattern.match(note) for pattern in _COUNTING)), None)
            if form is None:
                plain[note] = None
            else:
                counting.setdefault(form.re, []).append((weight, form))
    return [*plain, *(_COUNTING[pattern](whole, notes) for pattern, notes in counting.items())]


def note_of_all(parts: Iterable[str]) -> list[str]:
    """The note that each part of a picture has, such as that the camera sees nothing, if there is one: a part does not know
    what the camera sees elsewhere."""
    found = set(parts)
    return list(found) if len(found) == 1 and found != {""} else []


def note_of_none(samples: int) -> str:
    """The note of pixels that have none of so many samples."""
    return f"pixels have 0 to 0 of {samples} samples, 0 on average"


class Told(NamedTuple):
    """Warnings of an item, and how the processor rounds that has traced its rays. `counts` is None where nothing of it is
    worth a warning."""

    warned: Sequence[tuple[str, type[Warning]]] = ()
    counts: Optional[Outcome] = None
    rounding: str = ""
    of_all: str = ""        # a warning, if all items have it


def rounding_of(outcome: Mapping[str, Any]) -> str:
    """By the pack that has traced: without FMA a product is rounded before it is added to."""
    return "" if "target" not in outcome else "twice" if outcome["target"] == "v2" else "once"


def told_of(method: str, warned: Sequence[tuple[str, type[Warning]]], outcome: Outcome) -> Told:
    """Takes what a method of Scene has warned of: as a daemon's own client does, and how many
    samples its pixels have, as each part has its share of a deadline."""
    counts = Outcome({key: outcome[key] for key in COUNTED.get(method, ()) if key in outcome})
    counts["rays"] = outcome.rays
    counts.rays_per_point, counts.rounding = outcome.rays_per_point, outcome.rounding
    with warnings_taken() as counted:
        _warn_of(counts)
    notes: list[tuple[str, type[Warning]]] = [(note, RayWarning) for note in outcome.get("notes", ()) if note.startswith("pixels ")]
    return Told(tuple(each for each in dict.fromkeys([*warned, *notes]) if each not in counted), counts if counted else None, rounding_of(outcome),
                localize_message(outcome.get("note_of_all", "")))


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
    for text in note_of_all(item.of_all for _, item in told):
        warn(text, RayWarning)
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
