"""Checks of arguments whose errors the schema alone would report late or in fewer words."""
from __future__ import annotations

import difflib
import functools
import inspect
import math
import operator
import re
import reprlib
from typing import TYPE_CHECKING, Any, Callable, Iterable, Mapping, Optional, TypeVar, Union, cast

import numpy as np

from .._net.frame import Array
from ..errors import UsageError

if TYPE_CHECKING:
    from typing_extensions import Unpack as Unpack
else:
    try:
        from typing import Unpack
    except ImportError:  # before Python 3.11
        class Unpack:
            """A stand-in that is just enough for typing.get_type_hints()."""

            def __class_getitem__(cls, _options: object) -> type:
                return cls

# Control characters, which paths cannot show, and halves of a character, which no UTF-8 has.
_UNFIT = re.compile("[\0-\x1f\x7f-\x9f\ud800-\udfff]")

Call = TypeVar("Call", bound=Callable[..., Any])


def unknown_argument(function: str, name: str, known: Iterable[str]) -> TypeError:
    """The error of an argument that a function has not, with the nearest that it has."""
    known = [each for each in known if each != "self"]
    near = difflib.get_close_matches(name, known, 1)
    meant = f": did you mean {near[0]}=?" if near else "."
    return TypeError(f"{function}() has no argument {name}{meant} It has {', '.join(known)}")


def none_is_default(function: Call, more: Iterable[str] = ()) -> Call:
    """Returns `function`, changed so that None means an argument's default: programs can then pass
    on options that their own users left out. A misspelt argument is answered with the nearest one, of
    its own and of `more` where it takes any."""
    parameters = inspect.signature(function).parameters
    known = [name for name, parameter in parameters.items() if parameter.kind is not parameter.VAR_KEYWORD]
    checks = len(known) == len(parameters) or bool(more)
    known += more
    defaults = {name: parameter.default for name, parameter in parameters.items()
                if parameter.default is not parameter.empty}
    names = tuple(parameters)

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        if checks and (unknown := options.keys() - set(known)):
            raise unknown_argument(function.__name__, min(unknown), known)
        first = (defaults.get(name) if value is None else value
                 for name, value in zip(names, arguments))
        options = {name: defaults.get(name) if value is None else value
                   for name, value in options.items()}
        return function(*first, *arguments[len(names):], **options)
    return cast(Call, call)


def check_name(what: str, name: Any) -> None:
    if not isinstance(name, str) or not name:
        raise TypeError(f"{reprlib.repr(name)} is no name of {what}: it must be a text")
    if found := _UNFIT.search(name):
        raise UsageError(f"{reprlib.repr(name)} is no name of {what}: leave {found[0]!r} out, which is no visible character")


def whole(what: str, value: Any, most: int, least: int = 1) -> int:
    try:
        number = least - 1 if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise UsageError(f"{what} of {reprlib.repr(value)}: it must be a whole number from {least} "
                         f"to {most}")
    return number


def count_of(what: str, value: Any, most: int) -> int:
    """The same for a number of things, which arithmetic and arrays may have made a float: 1000.0."""
    is_float = isinstance(value, (float, np.floating)) and float(value).is_integer()
    return whole(what, int(value) if is_float else value, most)


# Masks of placements, by patterns of their paths.
Masks = Union[Mapping[str, int], Iterable[tuple[str, int]]]


def mask_rules(masks: Masks) -> list[str]:
    """Returns the rules as Load expects them, "GLOB=HEX"."""
    rules = []
    pairs = masks.items() if isinstance(masks, Mapping) else masks
    for pair in pairs if isinstance(pairs, Iterable) else (None,):
        if not isinstance(pair, (tuple, list)) or len(pair) != 2 or \
                not isinstance(pair[0], str) or not pair[0]:
            raise UsageError(f"masks of {reprlib.repr(masks)}: it must be a dict of patterns and "
                             "masks, as {'stand-*': 0x1}, or a list of such pairs")
        rules.append(f"{pair[0]}={whole('a mask', pair[1], 2**32 - 1, 0):X}")
    return rules


def array_of(what: str, value: Any) -> Array:
    try:
        return np.asarray(value)
    except ValueError:
        raise UsageError(f"{what} must be numbers, in rows of one length") from None


def is_several(what: str, value: Any) -> bool:
    """False for one value, and for None."""
    return array_of(what, value).ndim > 0


def whole_numbers(what: str, values: Any, most: int = 2**64 - 1) -> Array:
    """Returns the values as uint64, in their own shape; none is above `most`."""
    items = array_of(what, values)
    if items.dtype.kind not in "iu":  # or Python integers, some of which need all 64 bits
        items = np.asarray(values, object)
    if items.dtype == object:
        wrong = items.ravel()
    else:
        wrong = items[(items < 0) | (items > most if most < 2**64 - 1 else False)]
    for item in wrong:
        whole(what, item, most, least=0)
    return items.astype(np.uint64)


def is_masked(value: Any) -> bool:
    """Whether it is an array with masked elements."""
    return isinstance(value, np.ma.MaskedArray) and bool(np.any(value.mask))


def numbers(what: str, value: Any) -> Array:
    """Returns the value as an array. Masked elements become NaN, so that their values are not used."""
    if hasattr(value, "rays"):
        raise TypeError(f"{what} is a sweep: pass sweep.rays")
    if is_masked(value):
        value = value.astype(np.promote_types(value.dtype, np.float32)).filled(np.nan)
    out = array_of(what, value)
    if out.dtype.kind not in "fiu":
        given = {"U": "text", "S": "bytes", "O": "Python objects"}.get(out.dtype.kind, str(out.dtype))
        raise UsageError(f"{what} must be numbers, not {given}")
    return out


def user_ids(name: str, uids: Any) -> Array:
    found = numbers(name, uids)
    if found.shape == (0,):     # any type will do
        return found.astype("<u4")
    if found.ndim > 1 or found.dtype.kind not in "iu" or (found < 0).any() or (found > 2**32 - 2).any():
        raise UsageError(f"{name} of {reprlib.repr(uids)}: user ids are whole numbers from 0 to 4294967294: give one, or "
                         "a list of them")
    return found


def has_shape(value: Any, *shape: int) -> bool:
    """False also for rows of several lengths, which have no shape."""
    try:
        return np.shape(value) == shape
    except ValueError:
        return False


def real(what: str, value: Any) -> float:
    number = numbers(what, value)
    if number.ndim:
        raise UsageError(f"{what} of {reprlib.repr(value)}: it must be one number")
    return float(number)


def float32(value: Any) -> Array:
    """Returns the value as float32, the type on the wire; overflow gives infinity, underflow 0."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(value).astype(np.float32)


def milliseconds(time: Optional[float], name: str = "deadline") -> int:
    """Converts seconds; 0 means no limit, and so does None."""
    seconds = 0.0 if time is None else real(name, time)
    if not 0 <= seconds < 1 << 22:
        raise UsageError(f"{name} of {time!r}: it must be a number of seconds from 0 to "
                         f"{1 << 22}")
    return math.ceil(1000 * seconds)
