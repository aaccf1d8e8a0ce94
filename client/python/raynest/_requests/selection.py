"""hide= and only= of a job: what of a scene rays do not enter, or enter alone."""
from __future__ import annotations

import numbers
import reprlib
from typing import Any, Iterable

import numpy as np

from .. import _limits
from .._net.control import Message
from ..errors import UsageError
from .arguments import whole

# By what stands before "=": the list of a Job behind its prefix, and the largest number.
_KINDS = {"inst": ("instances", 2**32 - 1), "object": ("objects", 2**32 - 1), "path": ("path_ids", 2**64 - 1)}
_NOUNS = {"instances": "number", "objects": "their objects", "path_ids": "the numbers of their paths", "paths": "text"}


def selection_lists(key: str, prefix: str, chosen: Any) -> Message:
    """The lists of a Job that stand for `chosen`: numbers of instances, "inst=3", "object=2", "path=7",
    texts of paths, or several of them."""
    lists: Message = {f"{prefix}_{name}": [] for name in ("paths", *(name for name, _ in _KINDS.values()))}
    for item in _items(key, chosen):
        name, value = _entry(key, item)
        lists[f"{prefix}_{name}"].append(value)
    for name, items in lists.items():
        if len(items) > _limits.list_items_max:
            raise UsageError(f"{key} names {len(items)} parts by {_NOUNS[name.removeprefix(prefix + '_')]}, and one request "
                             f"takes at most list_items_max = {_limits.list_items_max}: let * stand for several in texts "
                             "of paths, or hide them by an edit")
    # The daemon takes an empty list for "everything", which a list that came out empty does not mean.
    if key == "only" and chosen is not None and not any(lists.values()):
        raise UsageError("only names no part, so that nothing is left to hit: name some, or pass None for all")
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


def _entry(key: str, item: Any) -> tuple[str, Any]:
    if isinstance(item, numbers.Integral) and not isinstance(item, bool):
        return "instances", whole(f"an instance in {key}", item, 2**32 - 1, 0)
    if not isinstance(item, str) or not item:
        raise _wrong(key, item)
    kind, equals, digits = item.partition("=")
    if kind not in _KINDS or not equals:
        return "paths", str(item)
    name, most = _KINDS[kind]
    if not (digits.isascii() and digits.isdigit() and len(digits) < 30 and int(digits) <= most):
        raise UsageError(f"{key} of {reprlib.repr(item)}: there must be a whole number from 0 to {most} behind its '='")
    return name, int(digits)


def _wrong(key: str, value: Any) -> TypeError:
    return TypeError(f"{key} of {reprlib.repr(value)}: it must be the number of an instance as in the column "
                     "inst, 'inst=3', 'object=2', the text of a path as 'stand-3/birch-17' or 'car#3/wheel*', "
                     "'path=7', or a list or array of them")
