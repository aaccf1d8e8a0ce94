"""Answers in columns: rays are sent as credit allows, chunks come back in any order."""
from __future__ import annotations

import contextlib
import reprlib
from typing import Callable, Generator, Iterable, Optional, Sequence, Union

import numpy as np

from .. import _limits, _lists
from .._net.connection import Connection
from .._net.control import Message
from .._net.frame import ALIGNMENT, Array, Block, padding
from ..errors import ProtocolError, UsageError
from .arguments import whole
from .columns import REDUCED, Answered, Chunk
from .job import JobOptions, Outcome, SceneMoved, job_message
from .rays import Source
from .upload import FileSender

# Returns the arrays that receive the columns of a chunk, one for each of its blocks.
PlaceChunk = Callable[[Chunk], Sequence[Array]]


class Answer:
    """The answer to a request that is answered by chunks. A query knows which fields and rows to
    expect. For a fetched job, the chunks themselves tell the fields and DONE the number of rows."""

    fields: Sequence[str] = ()
    csr: Optional[bool] = None
    rows: Optional[int] = None

    def __init__(self, connection: Connection, request: str, message: Message,
                 seconds: float = 0.0) -> None:
        self.outcome = Outcome()
        self.origin: Optional[Array] = None
        """The point that was subtracted from the rays; None if unknown."""
        self._connection = connection
        self._seconds = seconds
        self._request, self._message = request, message
        self._answered = Answered()
        self._names: set[str] = set()

    @property
    def answered(self) -> int:
        return self._answered.count

    def chunks(self, place: PlaceChunk, streams: bool = False) -> Generator[Chunk, None, None]:
        """Runs the request; `streams` as in Connection.exchange(). Closing the generator before its end cancels the rest."""
        arrived: list[Chunk] = []

        def place_blocks(name: str, message: Message, blocks: Sequence[Block]) -> Sequence[Array]:
            chunk = self._check(name, message, blocks)
            arrays = place(chunk)
            chunk.columns = {block.name: array for block, array in zip(blocks, arrays)}
            arrived.append(chunk)
            return arrays

        hidden: Sequence[str] = ()  # columns that users did not ask for
        frames = self._connection.exchange(self._request, self._message, self._seconds,
                                           place_blocks, self.feed, streams)
        with contextlib.closing(frames):
            for name, message in frames:
                self.outcome.take(name, message)
                if name == "Started":
                    hidden = message["hidden"]
                    self._check_origin(np.array(self.outcome["origin"]))
                if name == "Chunk":
                    chunk = arrived.pop()
                    if chunk.csr:
                        chunk.check_splits()
                    chunk.to_world(np.zeros(3) if self.origin is None else self.origin)
                    for column in set(hidden).difference(self.fields):
                        chunk.columns.pop(column, None)
                    yield chunk
        self.outcome.check_started()
        if self.answered != (self.outcome.get("rows") if self.rows is None else self.rows):
            raise ProtocolError("the daemon ended a query before its last answer")

    def _check_origin(self, origin: Array) -> None:
        """Takes the origin of the scene that answers."""
        self.origin = origin

    def feed(self) -> None:
        """Sends what the daemon still lacks, as far as credit allows."""

    def rows_max(self) -> int:
        """Returns the maximum number of rows for the rays sent so far."""
        return _limits.rays_max

    def _check(self, name: str, message: Message, blocks: Sequence[Block]) -> Chunk:
        if name != "Chunk":
            raise ProtocolError(f"the daemon answered a query with {name}")
        chunk = Chunk(message, blocks, self.fields, self.csr)
        names = {block.name for block in blocks}
        if self._names and names != self._names:
            raise ProtocolError("the daemon sent other columns than in the chunk before")
        self._names = names
        self._answered.add(chunk, self.rows_max())
        return chunk


def query_message(scene: str, kind: Optional[str], fields: Union[str, Sequence[str], None],
                  max_hits: Optional[int], job: JobOptions, reduce: str) -> Message:
    """Returns the schema's message, without its rays."""
    if kind is None:
        kind = _lists.REDUCED_KIND.get(reduce, "closest")
    if isinstance(fields, str):
        fields = (fields,)
    if fields is None:
        fields = () if reduce else _lists.SHOWN["any" if kind == "any" else "hits"]
    if not isinstance(fields, Iterable):
        raise UsageError(f"fields of {reprlib.repr(fields)}: it must be the names of columns, "
                         "as ('t', 'prim')")
    fields = list(fields)
    for name in fields:
        if fields.count(name) > 1:
            raise UsageError(f"fields name {name!r} twice")
    if max_hits is not None and kind not in _lists.CSR:
        raise UsageError(f"max_hits is of the kinds {' and '.join(_lists.CSR)}, not of {kind}")
    most = _limits.hits_max if kind == "multi" else _limits.all_hits_max
    return {"job": job_message(scene, job), "kind": kind, "fields": fields,
            "max_hits": 0 if max_hits is None else whole("max_hits", max_hits, most), "reduce": reduce}


class Query(Answer):
    """A query. `message` is the schema's without its rays, from which `origin` was subtracted. With
    `expects_origin` SceneMoved is raised if the scene has another one."""

    def __init__(self, connection: Connection, message: Message, source: Source, origin: Array,
                 expects_origin: bool) -> None:
        # The position of a miss is 0 on its way, and stays 0.
        hidden: list[str] = []
        if origin.any() and message["kind"] in ("closest", "null") and \
                "position" in message["fields"] and "hit" not in message["fields"]:
            hidden = ["hit"]
        super().__init__(connection, "Query", {
            **message, "fields": [*message["fields"], *hidden], "hidden": hidden,
            "ray_count": source.sent.count, "generator": source.generator,
            "part_first": source.part[0], "part_count": source.part[1]},
            message["job"]["deadline_ms"] / 1000)
        self.origin, self._expects_origin = origin, expects_origin
        if source.generator and source.sent.count:
            self.outcome.rays_per_point = source.count // source.sent.count
        reduce = message["reduce"]
        self.fields = message["fields"] or tuple(REDUCED.get(reduce, ()))
        self.csr = message["kind"] in _lists.CSR
        self._source = source
        self._sent = 0
        self._file = None if source.upload is None else FileSender(source.upload, 0)
        if not reduce or reduce in _lists.REDUCED_TO_POINTS:
            self.rows = source.sent.count if reduce else source.count

    def _check_origin(self, origin: Array) -> None:
        if self._expects_origin and (origin != self.origin).any():
            raise SceneMoved(origin)

    def rows_max(self) -> int:
        most = self._source.count if self.rows is None else self.rows
        sent = self._source.sent.count
        return most * self._sent // sent if sent else most

    def feed(self) -> None:
        if self._file is not None:
            self._file.feed(self._connection)
        daemon, rays, masks = self._connection.daemon, self._source.sent, self._source.masks
        widths = (rays.width,) if masks is None else (rays.width, 1)
        room = daemon.bulk_bytes_max - ALIGNMENT * (len(widths) - 1)    # each block is padded
        while self._sent < rays.count:
            first = self._sent
            count = min(rays.count - first, daemon.chunk_rays_max, max(1, room // (4 * sum(widths))))
            sizes = [4 * count * width for width in widths]
            if self._connection.credit < sum(size + padding(size) for size in sizes):
                return
            blocks = [("rays", rays.frame(first, count), rays.width)]
            if masks is not None:
                blocks.append(("masks", masks[first:first + count], 1))
            self._connection.queue("QueryRays", {"first_ray": first, **rays.common}, *blocks)
            self._sent += count

    def detach(self) -> int:
        """Runs the query as a detached job; returns the job's number."""
        self._message["job"]["detach"] = True
        number: int = self._connection.ask("Query", self._message, "Detached", self.feed)["job"]
        return number
