"""hide= and only= of a job: instances and objects that rays do not enter, or enter alone."""
from __future__ import annotations

import numbers
import reprlib
from typing import Any, Callable, Iterable

import numpy as np

from .._net.control import Message
from ..errors import UsageError
from .arguments import whole

# Returns the number, as in the column inst, of the outermost instance on the way to a path.
InstanceOf = Callable[[str], int]

_KINDS = {"inst": "instances", "object": "objects"}


def selection_lists(key: str, prefix: str, chosen: Any, instance_of: InstanceOf) -> Message:
    """The lists of a Job that stand for `chosen`: numbers of instances, "inst=3", "object=2", texts of
    paths, or several of them."""
    lists: Message = {f"{prefix}_{kind}": [] for kind in _KINDS.values()}
    for item in _items(key, chosen):
        kind, number = _number(key, item, instance_of)
        lists[f"{prefix}_{_KINDS[kind]}"].append(number)
    return lists


def _items(key: str, chosen: Any) -> Iterable[Any]:
    if chosen is None:
        return ()
    if isinstance(chosen, np.ndarray):
        return chosen.ravel()
    if isinstance(chosen, (str, numbers.Number)):
        return (chosen,)
    if isinstance(chosen, Iterable) and not isinstance(chosen, (bytes, dict)):
        return chosen
    raise _wrong(key, chosen)


def _number(key: str, item: Any, instance_of: InstanceOf) -> tuple[str, int]:
    if isinstance(item, numbers.Integral) and not isinstance(item, bool):
        return "inst", whole(f"an instance of {key}", item, 2**32 - 1, 0)
    if not isinstance(item, str) or not item:
        raise _wrong(key, item)
    kind, equals, digits = item.partition("=")
    if kind not in _KINDS or not equals:
        return "inst", instance_of(str(item))
    if not (digits.isascii() and digits.isdigit()):
        raise UsageError(f"{key} of {reprlib.repr(item)}: there must be a whole number behind its '='")
    return kind, min(int(digits), 2**32 - 1)


def _wrong(key: str, value: Any) -> TypeError:
    return TypeError(f"{key} of {reprlib.repr(value)}: it must be the number of an instance as in the column "
                     "inst, 'inst=3', 'object=2', the text of a path as 'stand-3/birch-17', or a list or "
                     "array of them")
