"""A query under way: rays go out as credit allows, chunks of columns come back in any order."""
from __future__ import annotations

import contextlib
from typing import Callable, Generator, Sequence

from ._columns import Answered, Chunk
from ._connection import Connection
from ._control import Message
from ._frame import Array, Block, padding
from ._job import Outcome
from ._rays import RAY_BYTES, Rays
from .errors import ProtocolError

# Says where the columns of a chunk go: one array for each of its blocks.
PlaceChunk = Callable[[Chunk], Sequence[Array]]


class Query:
    """`message` as in the schema, but for its number of rays."""

    def __init__(self, connection: Connection, message: Message, rays: Rays) -> None:
        self.outcome = Outcome()
        self._connection = connection
        self._message: Message = {**message, "ray_count": rays.count}
        self._multi = message["kind"] == "multi"
        self._rays = rays
        self._sent = 0
        self._answered = Answered()
        self._names: set[str] = set()

    @property
    def answered(self) -> int:
        return self._answered.count

    def chunks(self, place: PlaceChunk) -> Generator[Chunk, None, None]:
        """Runs the query. Closing the generator before its end cancels the rest."""
        arrived: list[Chunk] = []

        def place_blocks(name: str, message: Message, blocks: Sequence[Block]) -> Sequence[Array]:
            chunk = self._check(name, message, blocks)
            arrays = place(chunk)
            chunk.columns = {block.name: array for block, array in zip(blocks, arrays)}
            arrived.append(chunk)
            return arrays

        frames = self._connection.exchange(
            "Query", self._message, self._message["job"]["deadline_ms"] / 1000, place_blocks,
            self._send_rays)
        with contextlib.closing(frames):
            for name, message in frames:
                self.outcome.take(name, message)
                if name == "Chunk":
                    chunk = arrived.pop()
                    if self._multi:
                        chunk.check_splits()
                    yield chunk
        if self.answered != self._rays.count:
            raise ProtocolError("the daemon ended a query before its last answer")

    def _send_rays(self) -> None:
        daemon = self._connection.daemon
        while self._sent < self._rays.count:
            count = min(self._rays.count - self._sent, daemon.chunk_rays_max,
                        daemon.bulk_bytes_max // RAY_BYTES)
            size = count * RAY_BYTES
            if self._connection.credit < size + padding(size):
                return
            self._connection.queue("QueryRays", {"first_ray": self._sent}, "rays",
                                   self._rays.frame(self._sent, count), width=8)
            self._sent += count

    def _check(self, name: str, message: Message, blocks: Sequence[Block]) -> Chunk:
        if name != "Chunk":
            raise ProtocolError(f"the daemon answered a query with {name}")
        chunk = Chunk(message, blocks, self._message["fields"], self._multi)
        names = {block.name for block in blocks}
        if self._names and names != self._names:
            raise ProtocolError("the daemon sent other columns than in the chunk before")
        self._names = names
        self._answered.add(chunk, self._sent)
        return chunk
