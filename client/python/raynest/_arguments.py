"""What users pass, checked where the schema alone would say less, or too late."""
from __future__ import annotations

import functools
import inspect
import math
import operator
import reprlib
from typing import TYPE_CHECKING, Any, Callable, Iterable, Mapping, Optional, TypeVar, Union, cast

import numpy as np

from ._frame import Array
from .errors import UsageError

if TYPE_CHECKING:
    from typing_extensions import Unpack as Unpack
else:
    try:
        from typing import Unpack
    except ImportError:  # before Python 3.11
        class Unpack:
            """Says as much to typing.get_type_hints() that it goes on."""

            def __class_getitem__(cls, _options: object) -> type:
                return cls

Call = TypeVar("Call", bound=Callable[..., Any])


def none_is_default(function: Call) -> Call:
    """`function`, to which None says the default of an argument that has one: so that programs can
    hand on what they were not told."""
    parameters = inspect.signature(function).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items()
                if parameter.default is not parameter.empty}
    names = tuple(parameters)

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        first = (defaults.get(name) if value is None else value
                 for name, value in zip(names, arguments))
        options = {name: defaults.get(name) if value is None else value
                   for name, value in options.items()}
        return function(*first, *arguments[len(names):], **options)
    return cast(Call, call)


def whole(what: str, value: Any, most: int, least: int = 1) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise UsageError(f"{what} of {reprlib.repr(value)}: it must be a whole number from {least} "
                         f"to {most}")
    return number


# What placements are seen by, by patterns of their paths.
Masks = Union[Mapping[str, int], Iterable[tuple[str, int]]]


def mask_rules(masks: Masks) -> list[str]:
    """As Load has them, "GLOB=HEX"."""
    rules = []
    for pair in masks.items() if isinstance(masks, Mapping) else masks:
        if not isinstance(pair, (tuple, list)) or len(pair) != 2 or \
                not isinstance(pair[0], str) or not pair[0]:
            raise UsageError(f"masks of {reprlib.repr(masks)}: it must be a dict of patterns and "
                             "masks, as {'stand-*': 0x1}, or a list of such pairs")
        rules.append(f"{pair[0]}={whole('a mask', pair[1], 2**32 - 1, 0):X}")
    return rules


def whole_numbers(what: str, values: Any) -> Array:
    """As 64 bits without a sign, in the shape that they came in."""
    items = np.asarray(values)
    if items.dtype.kind not in "iu":  # Python's integers, too, where some need all 64 bits
        items = np.asarray(values, object)
    for item in items.ravel() if items.dtype == object else items[items < 0]:
        whole(what, item, 2**64 - 1, least=0)
    return items.astype(np.uint64)


def numbers(what: str, value: Any) -> Array:
    """As an array. What a masked array hides becomes NaN: no number, rather than one that was to be
    left out."""
    try:
        if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
            value = value.astype(np.promote_types(value.dtype, np.float32)).filled(np.nan)
        out = np.asarray(value)
    except ValueError:
        raise UsageError(f"{what} must be numbers, in rows of one length") from None
    if out.dtype.kind not in "fiu":
        raise UsageError(f"{what} must be numbers, not {out.dtype}")
    return out


def real(what: str, value: Any) -> float:
    number = numbers(what, value)
    if number.ndim:
        raise UsageError(f"{what} of {reprlib.repr(value)}: it must be one number")
    return float(number)


def float32(value: Any) -> Array:
    """As numbers travel; what that cannot hold becomes infinite, or 0."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(value).astype(np.float32)


def milliseconds(time: Optional[float], name: str = "deadline") -> int:
    """Of a time in seconds, None and 0 are none."""
    seconds = 0.0 if time is None else real(name, time)
    if not 0 <= seconds < 1 << 22:
        raise UsageError(f"{name} of {time!r}: it must be a number of seconds from 0 to "
                         f"{1 << 22}")
    return math.ceil(1000 * seconds)
