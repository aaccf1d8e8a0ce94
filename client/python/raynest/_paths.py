"""The paths of a scene: ids in the column path, and their texts."""
from __future__ import annotations

import re
import reprlib
from collections import Counter
from typing import Any, Callable, Collection, Iterable, Optional, Sequence, Union, overload

import numpy as np

from . import _limits
from ._net.control import Message
from ._net.frame import Array
from ._requests.arguments import whole, whole_numbers
from ._requests.columns import MISS
from ._requests.explain import receive_document
from ._requests.words import path_info
from ._session import Session
from .errors import ProtocolError, UsageError


# Placements of a scene that find() looks at, at most, as many as the daemon's own searches do.
_SEARCHED_MAX = 1 << 20


class Paths:
    """The part of a scene that knows its paths."""

    name: str
    _client: Session

    @overload
    def path_of(self, ids: int, *, epoch: int = 0) -> str: ...
    @overload
    def path_of(self, ids: Union[Sequence[int], Array], *, epoch: int = 0) -> list[str]: ...

    def path_of(self, ids: Any, *, epoch: int = 0) -> Any:
        """Returns the texts of path ids, such as "stand-3/birch-17/leaves": a text for one id, a
        list for many; "" for a miss. An id belongs to its epoch."""
        paths = whole_numbers("a path id", ids)
        unique, index = np.unique(paths, return_inverse=True)
        most = _limits.structure_paths_max
        names = [name for first in range(0, len(unique), most)
                 for name in self._names(unique[first:first + most], epoch)]
        return names[0] if paths.ndim == 0 else [names[i] for i in index.ravel()]

    @overload
    def path_ids(self, texts: str, *, epoch: int = 0) -> int: ...
    @overload
    def path_ids(self, texts: Union[list[str], tuple[str, ...], Array], *, epoch: int = 0) -> Array: ...

    def path_ids(self, texts: Any, *, epoch: int = 0) -> Any:
        """Returns the ids of path texts: a number for one text, an array of u64 for many. The id of
        "" is that of a miss, as path_of() gives it."""
        if isinstance(texts, str):
            return MISS if texts == "" else self.path(texts, epoch=epoch)["path"]
        if isinstance(texts, (bytes, bytearray)) or not isinstance(texts, Iterable):
            raise TypeError(f"path texts of type {type(texts).__name__}: pass a str, or several; path_of() takes ids")
        texts = list(texts)
        ids = {text: self.path_ids(text, epoch=epoch) for text in dict.fromkeys(texts)}
        return np.array([ids[text] for text in texts], np.uint64)

    def path(self, which: Union[int, str], *, epoch: int = 0) -> dict[str, Any]:
        """Describes a path, given by its id or text: path (the id), name (the text) and steps,
        outermost first. A step has name, instance (its place among its parent's steps), uid, and
        node, its index in a glTF file or None."""
        if isinstance(which, str):
            if not which:
                raise UsageError("a path must not be empty: pass an id or a text")
            message = self._path({"text": which}, epoch)
        else:
            message = self._path({"path": whole("a path id", which, 2**64 - 1, 0)}, epoch)
        return path_info(message)

    def find(self, glob: str, *, epoch: int = 0) -> list[str]:
        """Returns the texts that are of the form of `glob`, in the order of their paths. '*' stands for any text:
        find("car#3/wheel*") gives the wheels of that car. What lies within a part that is found is left out."""
        return list(self._find(glob, epoch)[0])

    def _find(self, glob: str, epoch: int) -> tuple[dict[str, Optional[int]], int]:
        """Returns these texts, each with the number of the outermost instance that it names, or with None where it
        names less or more than one; and the epoch."""
        if not isinstance(glob, str) or not glob:
            raise TypeError(f"{reprlib.repr(glob)} is no text of paths: pass one as 'car#3/wheel*', where '*' is any text")
        form = form_of(glob)

        def texts_of(name: str) -> list[str]:
            match = form.fullmatch(name)
            return [match[1]] if match else []
        found, epoch = self._instances(texts_of, epoch, glob)
        if not found:
            raise UsageError(f"no path is of the form {glob!r}")
        return found, epoch

    def _numbers(self, texts: Collection[str], epoch: int) -> tuple[dict[str, int], int]:
        """Returns the numbers of the outermost instances that one of these texts names as a whole, and the epoch."""
        sought = frozenset(texts)

        def texts_of(name: str) -> list[str]:
            ends = [at for at, letter in enumerate(name) if letter == "/"]
            return [name[:end] for end in (*ends, len(name)) if name[:end] in sought]
        found, epoch = self._instances(texts_of, epoch, next(iter(texts)))
        return {text: number for text, number in found.items() if number is not None}, epoch

    def _instances(self, texts_of: Callable[[str], list[str]], epoch: int,
                   sought: str) -> tuple[dict[str, Optional[int]], int]:
        """Returns the texts that `texts_of` finds in the names of placements, each with the number of the outermost instance
        that it names, or with None where it names less or more than one; and the epoch."""
        connection = self._client.connection
        within: dict[str, Counter[Optional[int]]] = {}  # how many of its placements lie in which outermost instance
        of: Counter[Optional[int]] = Counter()          # how many those have
        first, total = 0, 1
        while first < total:
            message = {"scene": self.name, "kind": "placements", "first": first, "count": _limits.structure_rows_max,
                       "epoch": epoch}
            document, _ = connection.again(lambda: receive_document(connection, "Structure", message, None, 0.0, None))
            rows, total, epoch = _placements(document)
            if total > _SEARCHED_MAX:
                raise UsageError(f"the scene has {total} placements, and {reprlib.repr(sought)} is looked for among at most "
                                 f"{_SEARCHED_MAX}: give the texts themselves, or numbers of outermost instances")
            for name, instance in rows:
                of[instance] += 1
                for text in texts_of(name):
                    within.setdefault(text, Counter())[instance] += 1
            if not rows:
                break
            first += len(rows)
        return {text: next(iter(instances)) if len(instances) == 1 and of.items() >= instances.items() else None
                for text, instances in within.items()}, epoch

    def _names(self, unique: Array, epoch: int) -> list[str]:
        """Returns the texts of ids, as many as one request may name."""
        asked = unique[unique != MISS].tolist()
        rows: list[str] = []
        if asked:
            message = {"scene": self.name, "kind": "paths", "paths": asked, "epoch": epoch}
            connection = self._client.connection
            document, _ = connection.again(lambda: receive_document(connection, "Structure", message,
                                                                    None, 0.0, None))
            rows = document.get("rows", rows)
        if not isinstance(rows, list) or len(rows) != len(asked) or not all(isinstance(row, str) for row in rows):
            raise ProtocolError("the daemon named other paths than it was asked for")
        texts = dict(zip(asked, rows))
        return [texts.get(path, "") for path in unique.tolist()]

    def _path(self, which: Message, epoch: int) -> Message:
        message = {"scene": self.name, "epoch": epoch, **which}
        return self._client.connection.ask("Path", message, "PathName")


def form_of(glob: str) -> re.Pattern[str]:
    """A pattern of the texts of this form, as the first group, and all that lies below them. The group is the shortest
    text of the form."""
    return re.compile(f"({'.*?'.join(map(re.escape, glob.split('*')))})(?:/.*)?", re.DOTALL)


def _placements(document: dict[str, Any]) -> tuple[list[tuple[str, Optional[int]]], int, int]:
    """Returns name and outermost instance of each row, how many rows there are in all, and the epoch."""
    total, epoch = document.get("total"), document.get("epoch")
    try:
        rows = [(row["name"], row["instance"]) for row in document["rows"]]
    except (KeyError, TypeError):
        rows = [(None, None)]
    if type(total) is not int or type(epoch) is not int or not all(
            isinstance(name, str) and type(instance) in (int, type(None)) for name, instance in rows):
        raise ProtocolError("the daemon lists placements in another form")
    return rows, total, epoch
