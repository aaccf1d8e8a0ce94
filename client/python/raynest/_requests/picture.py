"""Pictures: a camera in the schema's words, and the pieces of a payload put together."""
from __future__ import annotations

import contextlib
from typing import Any, Callable, Iterator, Optional, Sequence, Union

import numpy as np

from .. import _limits
from .._net.connection import Connection
from .._net.control import Message
from .._net.frame import DTYPES, Array, Block
from ..errors import ProtocolError, UsageError
from ..images import Image, with_view
from .arguments import count_of, float32, has_shape, numbers, real, whole
from .job import Outcome, Progress, SceneMoved

# Maximum bytes of an encoded pixel: an EXR of four floats. Legend and header come on top.
ENCODED_PIXEL_BYTES_MAX = 16
# The same of a lit picture's EXR, of 20 channels of four bytes.
LIT_PIXEL_BYTES_MAX = 80
# The same of an EXR with a channel of four bytes for every counter of every level.
HEAT_PIXEL_BYTES_MAX = 2048
LEGEND_BYTES_MAX = 4 << 20
# The format of a .glb ends there.
FILE_BYTES_MAX = 1 << 32
DOCUMENT_BYTES_MAX = 64 << 20


def camera_message(camera: Union[str, int], look_at: Optional[Sequence[Any]], fov: float,
                   origin: Optional[Array] = None) -> Message:
    """`camera` is a name or an index; `look_at` is (eye, at) or (eye, at, up), whose places are
    shifted by `origin` as rays are."""
    if camera != "" and look_at is not None:
        raise UsageError("camera and look_at both say where to look from: pass one of them")
    if real("fov", fov) != 0 == float32(fov):
        raise UsageError(f"fov of {fov!r}: in float32 that is 0, which is the camera's own")
    if not 0 <= fov < 180:
        raise UsageError(f"fov of {fov!r}: it must be degrees from 0 (the camera's own) to below 180")
    message: Message = {"name": str(camera), "fov_degrees": fov}
    if look_at is not None:
        rows = numbers("look_at", look_at).astype(np.float64)
        if rows.shape not in ((2, 3), (3, 3)):
            raise UsageError("look_at is (eye, at) or (eye, at, up), of three numbers each")
        named = dict(zip(("eye", "at", "up"), rows))
        if origin is not None:
            named["eye"], named["at"] = named["eye"] - origin, named["at"] - origin
        message["look_at"] = True
        message.update({name: tuple(value.tolist()) for name, value in named.items()})
    return message


class Payload:
    """A "render", "heatmap", "json" document or "file", whose pieces come in order. `shape` is its width, height and encode;
    when a job is fetched, the first piece says them. SceneMoved ends it if the scene's origin is not
    `origin`, where that was subtracted from the camera's place. A payload that is not the last one
    is replaced by a later one."""

    def __init__(self, kind: str, shape: Optional[Message] = None,
                 origin: Optional[Array] = None) -> None:
        self.outcome = Outcome()
        self._origin = origin
        self._kind = kind
        self._shape = shape
        self._payload: Optional[Array] = None
        self._received = 0
        self._last = False
        self._part = (0, 0)

    def receive(self, connection: Connection, request: str, message: Message, progress: Progress,
                seconds: float = 0.0, feed: Callable[[], object] = lambda: None) -> Any:
        """Raw pixels as an array (height, width, 4) of u8, of a heat map (height, width) of u32, of a
        difference i32; bytes of a picture file otherwise."""
        with connection.interrupts:
            for _ in self.passes(connection, request, message, progress, seconds, feed):
                pass
        return self.result()

    def passes(self, connection: Connection, request: str, message: Message, progress: Progress,
               seconds: float = 0.0, feed: Callable[[], object] = lambda: None,
               streams: bool = False) -> Iterator[None]:
        """Yields after each payload that a later one replaces; result() is that one. Reads the
        answer to its end."""
        frames = connection.exchange(request, message, seconds, self._place, feed, streams)
        with contextlib.closing(frames):
            for kind, news in frames:
                self.outcome.take(kind, news)
                if kind == "Started" and self._origin is not None \
                        and self.outcome["origin"] != self._origin.tolist():
                    raise SceneMoved(np.array(self.outcome["origin"]))
                if kind == "Progress" and progress:
                    progress(news["done"], news["total"], news["stage"])
                if kind == "Payload" and not self._last and self._is_whole() \
                        and self._part == self._size():
                    yield
        if self._kind != "json":
            self.outcome.check_started()
        if not self._is_whole():
            raise ProtocolError("the daemon ended a picture before its last piece")

    def result(self) -> Any:
        """The latest whole payload."""
        assert self._shape is not None and self._payload is not None
        if self._shape["encode"] != "raw":
            return self._payload.tobytes()
        width, height = self._size()
        if self._kind == "render":
            return self._payload.reshape(height, width, 4).view(Image)
        differs = self.outcome.get("range_low", 0) < 0
        return with_view(self._payload.view(np.int32 if differs else np.uint32).reshape(height, width), None)

    def _size(self) -> tuple[int, int]:
        assert self._shape is not None
        return self._shape["width"], self._shape["height"]

    def _is_whole(self) -> bool:
        return self._payload is not None and self._received == len(self._payload)

    def _begin(self, name: str, message: Message, total: int) -> None:
        """Makes room for a payload: of the whole picture, or of a part that came before it."""
        if self._shape is None:
            self._shape = {key: message.get(key, 0) for key in ("width", "height", "encode")}
        self._last = bool(message.get("last", 1))
        self._part = self._size()
        raw = self._shape["encode"] == "raw"
        if raw and not self._last:
            self._part = message["width"], message["height"]
        pixels = self._part[0] * self._part[1]
        encoded = {"heatmap": HEAT_PIXEL_BYTES_MAX, "render": LIT_PIXEL_BYTES_MAX}.get(
            self._kind, ENCODED_PIXEL_BYTES_MAX)
        most = 4 * pixels if raw else encoded * pixels + LEGEND_BYTES_MAX
        most = {"json": DOCUMENT_BYTES_MAX, "file": FILE_BYTES_MAX}.get(self._kind, most)
        if (name != "Payload" or pixels > _limits.picture_pixels_max or total > most
                or (raw and total != most)):
            raise ProtocolError(f"the daemon sent a picture of {total} bytes")
        self._payload = np.empty(total, np.uint8)
        self._received = 0

    def _place(self, name: str, message: Message, blocks: Sequence[Block]) -> Sequence[Array]:
        if self._payload is None or (self._is_whole() and not self._last):
            self._begin(name, message, message.get("total", 0))
        assert self._payload is not None
        block = blocks[0]
        end = self._received + block.bytes
        if (len(blocks) > 1 or (block.name, block.dtype, block.width) != ("data", DTYPES[0], 1)
                or message["offset"] != self._received or end > len(self._payload)):
            raise ProtocolError("the daemon sent pieces of a picture that do not fit together")
        piece = self._payload[self._received:end]
        self._received = end
        return [piece]


def tile_message(tile: Optional[Sequence[int]], shape: Message) -> tuple[Message, Message]:
    """The fields of a tile (x, y, width, height) of the picture, and the shape of its payload."""
    if tile is None:
        return {}, shape
    if not has_shape(tile, 4):
        raise UsageError(f"tile of {tile!r}: it must be (x, y, width, height)")
    x, y, width, height = (whole("a number in tile", each, _limits.picture_side_max, 0) for each in tile)
    if not (0 < width <= shape["width"] - x and 0 < height <= shape["height"] - y):
        raise UsageError(f"tile of {tile!r}: it must lie within {shape['width']}x{shape['height']}")
    return ({"tile_x": x, "tile_y": y, "tile_width": width, "tile_height": height},
            {**shape, "width": width, "height": height})


def size_message(size: tuple[int, int]) -> Message:
    if not has_shape(size, 2):
        raise UsageError(f"size of {size!r}: it must be (width, height)")
    width, height = (count_of("a side of size", side, _limits.picture_side_max) for side in size)
    if width * height > _limits.picture_pixels_max:
        raise UsageError(f"size of {width}x{height}: it must be at most picture_pixels_max = "
                         f"{_limits.picture_pixels_max} pixels in all")
    return {"width": width, "height": height}
