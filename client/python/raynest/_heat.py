"""Numbers of a heat map as a whole, computed here of its parts as the daemon does: the range of its
colours, and the statistics that --fail-if limits."""
from __future__ import annotations

import operator
import re
from decimal import Decimal
from typing import Any, Mapping, NamedTuple, Sequence

import numpy as np

from ._told import fail
from .errors import Error, UsageError

_OF_SCENE = ("levels", "bytes", "triangles")
_FORM = re.compile(r" *(\w+(?:\.\d+)?)\.(min|mean|p50|p90|p99|max) *(>=?|<=?) *([-+.\w]+) *\Z")
_WORDS = {">": (operator.gt, "above"), ">=": (operator.ge, "at or above"), "<": (operator.lt, "below"),
          "<=": (operator.le, "at or below")}


class LimitError(Error):
    """A limit of --fail-if is exceeded."""

    exit_code = 9


class Limit(NamedTuple):
    text: str           # as it was given
    metric: str         # total, or boxes.1
    statistic: str
    comparison: str
    number: float


def limit_of(text: str) -> Limit:
    """Reads METRIC[.LEVEL].STATISTIC OP NUMBER."""
    if re.split("[<>]", text)[0].strip() in _OF_SCENE:
        raise UsageError(f"'{text}': that is a number of the scene, which raynest info tells, and not one of its pixels")
    form = _FORM.match(text)
    try:
        if form is not None and np.isfinite(number := float(form[4])):
            return Limit(text, form[1], form[2], form[3], number)
    except ValueError:
        pass
    raise UsageError(f"'{text}' is not METRIC[.LEVEL].STATISTIC OP NUMBER, as total.p99>120; statistics are min mean p50 p90 "
                     "p99 max, OP is one of > >= < <=")


def check(limits: Sequence[Limit], channels: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compares the limits with the counts of a heat map's .exr, by their names there. Returns the rows `checks` of the
    document of --json."""
    checks = []
    for limit in limits:
        metric, _, level = limit.metric.partition(".")
        counts = channels.get(f"L{level}.{metric}" if level else metric)
        if counts is None:
            raise UsageError(f"'{limit.text}': the heat map has no {limit.metric}")
        value = _statistic(limit.statistic, counts.ravel())
        checks.append({"check": limit.text, "value": value, "limit": limit.number,
                       "exceeded": _WORDS[limit.comparison][0](value, limit.number)})
    return checks


def line_of(row: Mapping[str, Any]) -> str:
    """A row of `checks` in words."""
    limit = limit_of(row["check"])
    return (f"{limit.metric}.{limit.statistic} is {row['value']:.10g}, {'' if row['exceeded'] else 'not '}"
            f"{_WORDS[limit.comparison][1]} {limit.number:.10g}: {'exceeded' if row['exceeded'] else 'ok'}")


def tell_exceeded(document: Mapping[str, Any], as_json: bool) -> int:
    """Fails with the limits of a document that are exceeded, if any. Returns the exit code."""
    checks = document.get("checks", ())
    exceeded = [line_of(row) for row in checks if row["exceeded"]]
    if not exceeded:
        return 0
    return fail(LimitError(f"{len(exceeded)} of {len(checks)} limit{'s' * (len(checks) > 1)} exceeded: {'; '.join(exceeded)}",
                           "THRESHOLD"), LimitError.exit_code, as_json)


def _statistic(name: str, counts: Any) -> float:
    if name == "mean":
        return float(counts.sum(dtype=np.float64) / len(counts))
    return percentile(counts, int(name[1:])) if name.startswith("p") else float(getattr(counts, name)())


def percentile(values: Any, percent: int) -> float:
    rank = max(1, (len(values) * percent + 99) // 100)
    return float(np.partition(values, rank - 1)[rank - 1])


def range_text(asked: str, counts: Any, is_difference: bool) -> str:
    """The range of a heat map's colours, as the daemon makes it of what was asked for: p99, auto or LOW:HIGH."""
    if asked not in ("p99", "auto"):
        low, high = (float(number) for number in asked.split(":"))
        if not np.isfinite([low, high]).all():
            raise ValueError(f"it is {asked}")
        return f"{_shortest(low)}:{_shortest(high)}"
    values = np.abs(counts.astype(np.float64))
    most, high = float(values.max()), percentile(values, 99)
    least = 0.0 if is_difference else float(values.min())
    if is_difference and high < 0.01 * most:
        values = values[values != 0]
        high = percentile(values, 99)
    # Where many pixels have the percentile, a range that ended there would draw them as all that exceed them.
    if asked == "auto" or 20 * np.count_nonzero(values == high) >= np.count_nonzero(values > least):
        high = most
    if not is_difference and high == least:
        high *= 2
    high = max(1.0, high)
    return f"{_shortest(-high if is_difference else 0)}:{_shortest(high)}"


def _shortest(value: float) -> str:
    """A number as C++'s std::to_chars() writes it."""
    sign, digits, exponent = Decimal(repr(float(value))).normalize().as_tuple()
    assert isinstance(exponent, int)
    text = "".join(map(str, digits))
    power = exponent + len(text) - 1
    plain = format(Decimal((0, digits, exponent)), "f")
    scientific = text[0] + ("." + text[1:] if text[1:] else "") + f"e{'-' if power < 0 else '+'}{abs(power):02}"
    return "-" * sign + min(plain, scientific, key=len)
