"""Frames: a header of 32 bytes, a control message, blocks of bulk data (PROTOCOL.md, 3 and 7)."""
from __future__ import annotations

import dataclasses
import os
import struct
from typing import Any, NamedTuple

import numpy as np

from .. import _limits
from ..errors import ProtocolError
from .schema import SCHEMA

HEADER = struct.Struct("<4sHHIIQQ")
MAGIC = b"RYN1"
ALIGNMENT = 64
STRIDES = {1, 2, 3, 4, 8, 12, 16, 24, 32}

Array = np.ndarray[Any, np.dtype[Any]]

# In the order of the schema's Dtype.
DTYPES = tuple(np.dtype({"u8": np.uint8, "u32": np.uint32, "u64": np.uint64,
                         "f32": np.float32}[name]) for name in SCHEMA.enums["Dtype"])


def first_request_id() -> int:
    """Returns the id before a connection's first request, as protocol/request_id.h makes it: random, so
    that a log has an id once."""
    return int.from_bytes(os.urandom(4), "little") << 16


class Header(NamedTuple):
    type: int
    control_bytes: int
    block_count: int
    bulk_bytes: int
    request_id: int


@dataclasses.dataclass(frozen=True)
class Block:
    """One column: `count` elements of `width` values each."""

    name: str
    dtype: np.dtype[Any]
    width: int
    count: int

    @property
    def bytes(self) -> int:
        return self.count * self.width * self.dtype.itemsize

    def array(self) -> Array:
        shape = (self.count,) if self.width == 1 else (self.count, self.width)
        return np.empty(shape, self.dtype)


def padding(count: int) -> int:
    """Bytes of zeros that follow a block of `count` bytes."""
    return -count % ALIGNMENT


def write_header(header: Header) -> bytes:
    return HEADER.pack(MAGIC, header.type, 0, *header[1:])


def read_header(data: bytes) -> Header:
    magic, kind, flags, control_bytes, block_count, bulk_bytes, request_id = HEADER.unpack(data)
    if magic != MAGIC:
        raise ProtocolError("a frame starts with RYN1; this is not the RayNest protocol")
    if (flags or control_bytes > _limits.control_bytes_max or block_count > _limits.blocks_max
            or HEADER.size + control_bytes + bulk_bytes > _limits.frame_bytes_max
            or bulk_bytes % ALIGNMENT or (bulk_bytes and not block_count)):
        raise ProtocolError("the daemon sent a frame header that breaks the protocol's limits")
    return Header(kind, control_bytes, block_count, bulk_bytes, request_id)


def describe(name: str, data: Array, width: int, offset: int) -> dict[str, Any]:
    """Describes `data` as a block of a frame, as the schema's Block."""
    return {"name": name, "dtype": DTYPES.index(data.dtype), "count": data.size // width,
            "stride": width * data.itemsize, "offset": offset, "bytes": data.nbytes}


def read_blocks(header: Header, described: list[dict[str, Any]]) -> list[Block]:
    """Checks the blocks of a frame: they must fill its bulk part without gaps."""
    if len(described) != header.block_count:
        raise ProtocolError("the daemon sent a frame whose blocks are not those of its header")
    blocks: list[Block] = []
    end = 0
    for fields in described:
        stride, dtype = fields["stride"], fields["dtype"]
        if dtype >= len(DTYPES) or stride not in STRIDES or stride % DTYPES[dtype].itemsize:
            raise ProtocolError("the daemon sent a block of an unknown dtype or stride")
        block = Block(fields["name"], DTYPES[dtype], stride // DTYPES[dtype].itemsize,
                      fields["count"])
        if (block.bytes != fields["bytes"] or fields["offset"] != end
                or any(block.name == other.name for other in blocks)):
            raise ProtocolError(f"the daemon sent a block '{block.name}' that does not fit")
        blocks.append(block)
        end += block.bytes + padding(block.bytes)
    if end != header.bulk_bytes:
        raise ProtocolError("the daemon sent blocks that do not fill their frame")
    return blocks
