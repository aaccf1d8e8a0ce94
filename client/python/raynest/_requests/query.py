"""Answers in columns: rays are sent as credit allows, chunks come back in any order."""
from __future__ import annotations

import contextlib
from typing import Callable, Generator, Optional, Sequence

import numpy as np

from .. import _limits, _lists
from .._net.connection import Connection
from .._net.control import Message
from .._net.frame import Array, Block, padding
from ..errors import ProtocolError
from .columns import REDUCED, Answered, Chunk
from .job import Outcome, SceneMoved
from .rays import Source

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
                    for column in hidden:
                        chunk.columns.pop(column, None)
                    yield chunk
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
        daemon, rays = self._connection.daemon, self._source.sent
        ray_bytes = 4 * rays.width
        while self._sent < rays.count:
            count = min(rays.count - self._sent, daemon.chunk_rays_max,
                        daemon.bulk_bytes_max // ray_bytes)
            size = count * ray_bytes
            if self._connection.credit < size + padding(size):
                return
            self._connection.queue("QueryRays", {"first_ray": self._sent, **rays.common}, "rays",
                                   rays.frame(self._sent, count), width=rays.width)
            self._sent += count

    def detach(self) -> int:
        """Runs the query as a detached job; returns the job's number."""
        self._message["job"]["detach"] = True
        number: int = self._connection.ask("Query", self._message, "Detached", self.feed)["job"]
        return number
