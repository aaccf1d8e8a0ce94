"""Pieces of what only the client's machine has, as they travel between the workers of a cluster.

A piece has a key that says what it is: the digest of its file and its number, or the name of a scene's changes and the
number of one. The client gives each piece to one worker, from which the others fetch it: the more hosts there are, up to
the number of pieces, the more give. Copies of a piece would not last, as Dask's memory manager drops them.
"""
from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import weakref
from typing import Any, Iterator, Optional, Protocol, Sequence

import numpy as np

from ._net.frame import Array

PIECE_BYTES = 8 << 20       # no message of a cluster is larger, whatever the scene
AHEAD = 3                   # pieces that a host fetches at once
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


def keys_of_changes(log: str, first: int, last: int) -> list[str]:
    """Those of the changes that have these numbers."""
    return [f"raynest-{log}-{i}" for i in range(first, last)]


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
