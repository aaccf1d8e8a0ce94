"""The columns of answers: their types, their checks, and the arrays that receive them."""
from __future__ import annotations

import bisect
import dataclasses
from typing import Any, Optional, Sequence

import numpy as np

from .. import _lists
from .._net.control import Message
from .._net.frame import Array, Block
from ..errors import ProtocolError

Columns = dict[str, Array]

MISS = 2**64 - 1  # in the column path

_DTYPES: dict[str, np.dtype[Any]] = {"u8": np.dtype(np.uint8), "u32": np.dtype(np.uint32), "u64": np.dtype(np.uint64),
                                      "f32": np.dtype(np.float32)}


def _typed(columns: dict[str, tuple[str, int]]) -> dict[str, tuple[np.dtype[Any], int]]:
    return {name: (_DTYPES[kind], width) for name, (kind, width) in columns.items()}


# Columns with a row per hit: in answers of a CSR kind, a ray has several. PROTOCOL.md, 7.
OF_HITS = _typed(_lists.OF_HITS)
# Columns with a row per ray. An intersector's outputs come on top, under names of its own.
OF_RAYS = {**_typed(_lists.OF_RAYS), "ray_splits": (_DTYPES["u64"], 1)}
# Columns of reducers.
REDUCED = {name: _typed(columns) for name, columns in _lists.REDUCED.items()}

_KNOWN = {**OF_HITS, **OF_RAYS}
for _columns in REDUCED.values():
    _KNOWN.update(_columns)


class Chunk:
    """Rows [first, first + count) of an answer. The constructor checks that the chunk has the
    requested columns and, if that is known, that its hits are CSR. `columns` is filled when the
    chunk has arrived."""

    def __init__(self, message: Message, blocks: Sequence[Block], fields: Sequence[str],
                 csr: Optional[bool]) -> None:
        self.first: int = message["first_ray"]
        self.count: int = message["count"]
        self.blocks = blocks
        self.columns: Columns = {}
        counts = {block.name: block.count for block in blocks}
        self.hits = next((count for name, count in counts.items() if name in OF_HITS), 0)
        self.csr = "ray_splits" in counts
        if not counts.keys() >= set(fields) or csr not in (None, self.csr):
            raise ProtocolError("the daemon sent other columns than those that were asked")
        for block in blocks:
            known = _KNOWN.get(block.name)
            if known and known != (block.dtype, block.width):
                raise ProtocolError(f"the daemon sent a column '{block.name}' of a wrong type")
            rows = self.count + 1 if block.name == "ray_splits" else self.count
            if block.count != (self.hits if self.csr and block.name in OF_HITS else rows):
                raise ProtocolError(f"the daemon sent a column '{block.name}' of a wrong length")

    def to_world(self, origin: Array) -> None:
        """Moves an arrived chunk's points to the world. The position of a miss stays 0."""
        for name in _lists.POINTS:
            if name not in self.columns:
                continue
            points = self.columns[name].astype(np.float64)
            hit = self.columns.get("hit") if name == "position" and not self.csr else None
            points[slice(None) if hit is None else hit != 0] += origin
            self.columns[name] = points

    def check_splits(self) -> None:
        """Checks that an arrived CSR chunk's splits rise from 0 to the number of hits."""
        splits = self.columns["ray_splits"]
        has_hits = any(name in OF_HITS for name in self.columns)
        rise = splits[0] == 0 and (splits[1:] >= splits[:-1]).all()
        if not rise or (has_hits and splits[-1] != self.hits):
            raise ProtocolError("the daemon sent ray_splits that do not rise to the number of hits")


class Answered:
    """The set of answered rays: chunks come in any order, each ray once."""

    def __init__(self) -> None:
        self.count = 0
        self._chunks: list[tuple[int, int]] = []  # first and end, sorted; neighbours are merged

    def add(self, chunk: Chunk, asked: int) -> None:
        first, end = chunk.first, chunk.first + chunk.count
        at = bisect.bisect(self._chunks, (first, end))
        before = self._chunks[at - 1] if at else (0, 0)
        after = self._chunks[at] if at < len(self._chunks) else (asked, asked)
        if chunk.count == 0 or first < before[1] or end > after[0]:
            raise ProtocolError("the daemon answered rays twice, or rays that were not asked")
        self.count += chunk.count
        begin, stop = at, at
        if at and before[1] == first:
            first, begin = before[0], at - 1
        if at < len(self._chunks) and after[0] == end:
            end, stop = after[1], at + 1
        self._chunks[begin:stop] = [(first, end)]


class Whole:
    """All rows of an answer. Columns of known length are allocated once and filled in place. CSR
    hits, whose number is known only at the end, and points, which arrive as another type, stay in
    their chunks until then."""

    def __init__(self, rows: Optional[int], reduce: str = "") -> None:
        self._rows = rows
        self._reduce = reduce or (REDUCED.keys() - _lists.REDUCED_TO_POINTS).pop()
        self._columns: Columns = {}
        self._chunks: list[Chunk] = []

    def place(self, chunk: Chunk) -> list[Array]:
        self._chunks.append(chunk)
        return [block.array() if self._rows is None or block.name in _lists.POINTS or (
                    chunk.csr and (block.name in OF_HITS or block.name == "ray_splits"))
                else self._column(block, self._rows)[chunk.first:chunk.first + chunk.count]
                for block in chunk.blocks]

    def _column(self, block: Block, rows: int) -> Array:
        whole = self._columns.get(block.name)
        if whole is None:
            whole = self._columns[block.name] = dataclasses.replace(block, count=rows).array()
        if (whole.dtype, whole.size) != (block.dtype, block.width * rows):
            raise ProtocolError(f"the daemon changed the type of the column '{block.name}'")
        return whole

    def columns(self) -> Columns:
        pieces = [chunk.columns for chunk in sorted(self._chunks, key=lambda chunk: chunk.first)]
        if not pieces:  # a reducer may find no rows: no path was seen
            return {name: np.empty(0, dtype)
                    for name, (dtype, _) in REDUCED.get(self._reduce, {}).items()}
        for name in pieces[0].keys() - self._columns.keys():
            if name == "ray_splits":
                counts = [np.diff(piece[name]) for piece in pieces]
                self._columns[name] = np.cumsum(np.concatenate([np.zeros(1, np.uint64), *counts]))
            else:
                self._columns[name] = np.concatenate([piece[name] for piece in pieces])
        return as_usual({name: self._columns[name] for name in pieces[0]})


def as_usual(columns: Columns) -> Columns:
    """Makes bool of the columns that travel as 1 or 0, so that they select rows, and int64 of
    ray_splits, with which numpy counts and repeats."""
    def usual(name: str, column: Array) -> Array:
        if name in _lists.TRUTHS:
            column = column != 0
        elif name == "ray_splits":
            column = column.view(np.int64)
        return column
    return {name: usual(name, column) for name, column in columns.items()}


# The types and shapes of rows that as_usual() and to_world() make of what is known, and those of a sensor's own columns.
USUAL: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {
    **{name: (np.dtype(bool) if name in _lists.TRUTHS else np.dtype(np.float64) if name in _lists.POINTS else
              np.dtype(np.int64) if name == "ray_splits" else dtype, () if width == 1 else (width,))
       for name, (dtype, width) in _KNOWN.items()},
    "ring": (np.dtype(np.uint16), ()), "time": (np.dtype(np.float64), ())}


def anywhere(chunk: Chunk) -> list[Array]:
    """Allocates arrays for each chunk."""
    return [block.array() for block in chunk.blocks]
