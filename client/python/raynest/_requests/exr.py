"""Reads the EXR files of a daemon as arrays: one part, scan lines, ZIP, 32 bits per value.

The layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""
from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .._net.frame import Array
from ..errors import ProtocolError, shown_text

MAGIC = 20000630
LINES = 16  # in a block
ZIP = 3
CHANNELS_MAX = 512  # every counter of every level
DTYPES: dict[int, np.dtype[Any]] = {0: np.dtype("<u4"), 2: np.dtype("<f4")}


def read_exr(data: bytes, pixels_max: int, channels_max: int = CHANNELS_MAX) -> tuple[dict[str, Array], dict[str, str]]:
    """Returns (channels by name, each (height, width), and the texts of the header). What it makes is larger than the
    file: the limits are those of what was asked for."""
    try:
        return _read(memoryview(data), pixels_max, channels_max)
    except (struct.error, zlib.error, ValueError, IndexError, KeyError) as error:
        raise ProtocolError(f"the daemon sent an EXR that cannot be read: {error}") from None


def _word(data: memoryview, at: int) -> tuple[str, int]:
    end = bytes(data[at:at + 256]).index(0)
    return bytes(data[at:at + end]).decode(), at + end + 1


def header_of(data: memoryview) -> tuple[list[tuple[str, str, bytes]], int]:
    """Returns the attributes of a file, (name, type, value) each, and where they end."""
    fields, at = [], 8
    while data[at]:
        name, at = _word(data, at)
        kind, at = _word(data, at)
        size, = struct.unpack_from("<I", data, at)
        fields.append((name, kind, bytes(data[at + 4:at + 4 + size])))
        at += 4 + size
    return fields, at + 1


def blocks_of(data: memoryview, at: int, top: int, height: int) -> Iterator[tuple[int, memoryview]]:
    """Yields each block, as it is packed, behind the number of its rows. `at` is the end of the header."""
    for number, offset in enumerate(struct.unpack_from(f"<{-(-height // LINES)}Q", data, at)):
        first, packed = struct.unpack_from("<iI", data, offset)
        if first != top + number * LINES or packed > len(data) - offset - 8:
            raise ValueError("a block is elsewhere")
        yield min(LINES, height - number * LINES), data[offset + 8:offset + 8 + packed]


def _read(data: memoryview, pixels_max: int, channels_max: int) -> tuple[dict[str, Array], dict[str, str]]:
    if struct.unpack_from("<I", data)[0] != MAGIC or struct.unpack_from("<I", data, 4)[0] & 0xFF != 2:
        raise ValueError("it is none")
    fields, at = header_of(data)
    header = {shown_text(name): value for name, _, value in fields}
    texts = {shown_text(name): shown_text(value.decode(errors="replace"))
             for name, kind, value in fields if kind == "string"}
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if header["compression"][0] != ZIP or min(width, height) < 1 or width * height > pixels_max:
        raise ValueError("its size or compression is another")
    names = _channels(header["channels"])
    if len(names) > channels_max:
        raise ValueError(f"it has {len(names)} channels")
    planes = {name: np.empty((height, width), dtype) for name, dtype in names}
    row = 0
    for rows, packed in blocks_of(data, at, top, height):
        block = unpacked(packed, rows * width * 4 * len(names))
        # Line by line, and in each line channel by channel.
        lines = block.reshape(rows, len(names), 4 * width)
        for index, (name, dtype) in enumerate(names):
            planes[name][row:row + rows] = np.ascontiguousarray(lines[:, index]).view(dtype)
        row += rows
    return planes, texts


def _channels(attribute: bytes) -> list[tuple[str, np.dtype[Any]]]:
    names: list[tuple[str, np.dtype[Any]]] = []
    rest, place = memoryview(attribute), 0
    while rest[place]:
        name, place = _word(rest, place)
        names.append((shown_text(name), DTYPES[struct.unpack_from("<I", rest, place)[0]]))
        place += 16
    return names


def channel_count(attribute: bytes) -> int:
    """How many channels the attribute `channels` of a file lists."""
    return len(_channels(attribute))


def block_of(attribute: bytes, width: int, rows: int, values: Mapping[str, Any]) -> bytes:
    """A packed block of pixels that all have these values, 0 where there is none. The attribute lists the channels."""
    line = b"".join(np.full(width, values.get(name, 0), dtype).tobytes() for name, dtype in _channels(attribute))
    plain = np.frombuffer(line * rows, np.uint8)
    split = np.concatenate([plain[0::2], plain[1::2]])
    return zlib.compress(np.concatenate([split[:1], np.diff(split) + np.uint8(128)]).tobytes())


def unpacked(data: memoryview, size: int) -> Array:
    """Decompresses a block. Before compression its bytes were split into even and odd ones, and each
    replaced by its difference from the previous one."""
    if len(data) == size:
        return np.frombuffer(data, np.uint8)
    inflater = zlib.decompressobj()
    deltas = np.frombuffer(inflater.decompress(data, size + 1), np.uint8)
    if len(deltas) != size or not inflater.eof:  # its checksum stands at the end
        raise ValueError("a block has another size")
    steps = deltas - np.uint8(128)
    steps[0] = deltas[0]
    values = np.cumsum(steps, dtype=np.uint8)
    plain = np.empty(size, np.uint8)
    half = (size + 1) // 2
    plain[0::2], plain[1::2] = values[:half], values[half:]
    return plain
