"""Numbers that users pass, checked where the schema alone would say less, or too late."""
from __future__ import annotations

import math
import operator

from .errors import UsageError


def whole(what: str, value: int, most: int, least: int = 1) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise UsageError(f"{what} of {value!r}: it must be a whole number from {least} to {most}")
    return number


def milliseconds(deadline: float) -> int:
    """Of a deadline in seconds, 0 is none."""
    if not 0 <= deadline < 1 << 22:
        raise UsageError(f"deadline of {deadline!r}: it must be a number of seconds from 0 to "
                         f"{1 << 22}")
    return math.ceil(1000 * deadline)
