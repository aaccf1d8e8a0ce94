"""The daemon's properties and limits, from its Welcome."""
from __future__ import annotations

from typing import NamedTuple

from .. import _limits, errors
from .control import Message


class Daemon(NamedTuple):
    name: str
    version: int
    window_bytes: int
    chunk_rays_max: int
    bulk_bytes_max: int  # for one frame: credit for so much always comes back
    principal: str       # the name under which the daemon knows this client
    role: str            # viewer, user or admin


def read_welcome(welcome: Message) -> Daemon:
    # A daemon may be configured to accept less than this client could send, never more.
    window = min(welcome["window_bytes"], _limits.window_bytes_max)
    frame = min(welcome["frame_bytes_max"], _limits.frame_bytes_max)
    daemon = Daemon(welcome["server"], welcome["version"], window,
                    min(welcome["chunk_rays_max"], _limits.chunk_rays_max),
                    min(window, frame) // 2 & -64, welcome["principal"], welcome["role"])
    if daemon.chunk_rays_max == 0 or daemon.bulk_bytes_max == 0:
        raise errors.FailedError("the daemon takes no data: its limits are too small")
    return daemon
