"""The paths of a scene: ids in the column path, and their texts."""
from __future__ import annotations

from typing import Any, Iterable, Sequence, Union, overload

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
