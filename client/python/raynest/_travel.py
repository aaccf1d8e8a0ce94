"""Pieces of what only the client's machine has, as they travel between the workers of a cluster.

A piece has a key that says what it is: the digest of its file and its number, or the name of a scene's changes and the
numbers of some. The client gives each piece to one worker, from which the others fetch it: the more hosts there are, up to
the number of pieces, the more give. Copies of a piece would not last, as Dask's memory manager drops them.
"""
from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import hashlib
import itertools
import weakref
from typing import Any, Iterator, NamedTuple, Optional, Protocol, Sequence

import numpy as np

from ._net.control import Message
from ._net.frame import Array
from ._requests.loads import Load, load_of_file
from .errors import Error

PIECE_BYTES = 8 << 20       # no message of a cluster is larger, whatever the scene
AHEAD = 3                   # pieces that a host fetches at once
PACK = 32                   # changes of a scene that travel together once there are so many: each piece takes some 7 ms
PACK_BYTES = 1 << 18        # of a pack, at most
PIECE_SECONDS = 60.0        # after which whoever has a piece counts as lost
LOST = (Exception, asyncio.CancelledError)  # no Exception: a key was dropped, as it died with what it was made of


class Holder(Protocol):
    """The client's own program, which has all pieces of a scene."""

    def piece(self, key: str) -> Optional[Array]: ...


# The holders of this process's own program: several may have the same piece. A daemon of this machine needs no cluster.
own: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()


def own_piece(key: str) -> Optional[Array]:
    holders: list[Optional[Holder]] = [holder() for holder in own.valuerefs()]
    found = (holder.piece(key) for holder in holders if holder is not None)
    return next((piece for piece in found if piece is not None), None)


class Missing(Exception):
    """No worker has these pieces, or whoever has them is `silent`. Travels as the answer of an item: the client then
    sends them."""

    def __init__(self, keys: Sequence[str], silent: bool = False) -> None:
        super().__init__(list(keys), silent)
        self.keys, self.silent = list(keys), silent


def keys_of_file(digest: bytes, size: int, piece_bytes: int) -> list[str]:
    return [f"raynest-{digest.hex()}-{i}of{piece_bytes}" for i in range(-(-size // piece_bytes))]


def key_of_changes(log: str, first: int, last: int) -> str:
    """That of the changes that have these numbers."""
    return f"raynest-{log}-{first}to{last}"


def look_up(pieces: Sequence[str], sending: int) -> Any:
    """Returns the cluster that has the pieces; raises Missing with all that are nowhere."""
    import distributed
    keys = [f"{key}~{sending}" for key in pieces]
    try:
        cluster: Any = distributed.get_client()
    except ValueError:
        raise Missing(keys) from None
    places = cluster.sync(cluster.scheduler.who_has, keys=keys)
    if missing := [key for key in keys if not places.get(key)]:
        raise Missing(missing)
    return cluster


def held(cluster: Any, key: str) -> Any:
    """A Future of what another client, or another part of this one, has made."""
    import distributed
    future: Any = distributed.Future(key, cluster)  # type: ignore[no-untyped-call]
    # Newer releases of Dask do not ask for it.
    cluster._send_to_scheduler({"op": "client-desires-keys", "keys": [key], "client": cluster.id})
    return future


def fetch(pieces: Sequence[str], patience: float, sending: int) -> Iterator[Array]:
    """Yields the pieces, the next of which come meanwhile; raises Missing at once where one is nowhere. `sending` is
    how often the client has sent them anew."""
    keys = [f"{key}~{sending}" for key in pieces]
    found = [own_piece(key) for key in pieces]
    if not any(piece is None for piece in found):
        yield from filter(lambda piece: piece is not None, found)
        return
    cluster = look_up(pieces, sending)

    def one(key: str) -> Array:
        try:
            return np.asarray(held(cluster, key).result(timeout=patience))
        except LOST:            # its holder died, or is stuck
            raise Missing([key], True) from None
    with concurrent.futures.ThreadPoolExecutor(AHEAD) as pool:
        coming = collections.deque(pool.submit(one, key) for key in keys[:AHEAD])
        for key in [*keys[AHEAD:], *[""] * min(AHEAD, len(keys))]:
            piece = coming.popleft().result()
            if key:
                coming.append(pool.submit(one, key))
            yield piece


# ---- a scene as workers load it ------------------------------------------------------------------

class Source(NamedTuple):
    """A scene as workers load it, and what its digest must be."""

    path: str                               # where a worker may have the same files; "": nowhere
    load: dict[str, Any] = {}               # more arguments of Client.load()
    message: Optional[Message] = None       # a Load with the files' digests; None: the files at `path` say them
    digest: str = ""
    log: str = ""                           # of its changes
    changes: int = 0                        # how many of them have happened
    packs: tuple[int, ...] = (0,)           # where those begin and end which travel together
    refused: tuple[int, ...] = ()           # the numbers of those that no daemon makes
    piece_bytes: int = PIECE_BYTES
    piece_seconds: float = PIECE_SECONDS
    sending: int = 0                        # of the pieces: counts when whoever has some of them is silent

    @property
    def name(self) -> str:
        """On the daemons."""
        assert self.message is not None
        return str(self.message["name"])

    def files(self) -> list[tuple[bytes, int]]:
        """Digests and sizes."""
        assert self.message is not None
        digests = self.message["file_digests"]
        return [(digests[32 * i:32 * i + 32], size) for i, size in enumerate(self.message["file_bytes"])]

    def changes_since(self, made: int) -> list[tuple[str, int]]:
        """The pieces that have the changes from number `made` on: their keys, and the number of the first change in each."""
        bounds = [*self.packs, *range(self.packs[-1] + 1, self.changes + 1)]
        return [(key_of_changes(self.log, first, last), first) for first, last in zip(bounds, bounds[1:])
                if last > made and first < self.changes]


class Carried(NamedTuple):
    """A file of the client's machine that a command or a picture names."""

    prefix: str         # of the command's word, as "points="
    name: str           # the same on all hosts, as the parts must say the same request
    digest: bytes
    size: int


def named(message: Message) -> Message:
    """The message with a name that says what it loads; the scene goes with the connections that hold it."""
    content = {**message, "name": "", "replace": False, "share": [], "temporary": True}
    return {**content, "name": "dask-" + hashlib.sha256(repr(sorted(content.items())).encode()).hexdigest()[:16]}


class Files:
    """The files of a scene that a daemon lacks: from the same path, if that has the same bytes, else from the cluster."""

    def __init__(self, source: Source, elsewhere: set[str]) -> None:
        self._source, self._elsewhere = source, elsewhere
        self._here: Optional[Load] = None
        self._pieces: Iterator[Array] = iter(())

    def need(self, numbers: Sequence[int]) -> None:
        """The files that will be read, in this order. Raises Missing with all that is nowhere, before any is read: each
        time the client sends what is missing, the load begins anew."""
        source = self._source
        if source.path and source.name not in self._elsewhere:
            here = read_at(source)
            if here is not None and here.message["file_digests"] == (source.message or {})["file_digests"]:
                self._here = here
                return
            self._elsewhere.add(source.name)
        keys = [key for number in numbers for key in self._keys(number)]
        if any(own_piece(key) is None for key in keys):
            look_up(keys, source.sending)
        self._pieces = fetch(keys, source.piece_seconds, source.sending)

    def read(self, number: int) -> Iterator[Array]:
        if self._here is not None:
            yield from self._here.read(number)
        else:
            yield from itertools.islice(self._pieces, len(self._keys(number)))

    def _keys(self, number: int) -> list[str]:
        return keys_of_file(*self._source.files()[number], self._source.piece_bytes)


def read_at(source: Source) -> Optional[Load]:
    """A Load of the files at a source's path on this machine; None where they cannot be read."""
    try:
        return load_of_file(source.path, "", **source.load)
    except (Error, OSError):
        return None
