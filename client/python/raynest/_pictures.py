"""Parts of pictures, .png and .exr, as `raynest merge` reads and joins them."""
from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import zlib
from typing import Any, NamedTuple, Sequence

import numpy as np

from ._heat import range_text
from ._requests.exr import LINES, MAGIC, ZIP, block_of, blocks_of, channel_count, header_of, read_exr, unpacked
from ._requests.film import UNSAMPLED
from ._requests.png import unfiltered
from .errors import FailedError, InvalidError, ProtocolError

EXACT = 1 << 24             # below it float32 has all whole numbers
PNG = b"\x89PNG\r\n\x1a\n"
EXR = struct.pack("<II", MAGIC, 2)
SIDE_MAX = 1 << 20
PIXELS_MAX = 1 << 30
# Attributes that the header of a part has and that of the whole has not.
OF_PARTS = ("raynest:tile", "raynest:request", "raynest:arithmetic", "raynest:range_asked", "raynest:palette",
            "raynest:scale", "raynest:view")
_FILTERS = range(5)          # filters for a PNG's row
TILE = re.compile(r"(\d{1,7}) (\d{1,7}) (\d{1,7}) (\d{1,7}) of (\d{1,7})x(\d{1,7})\Z")


class Part(NamedTuple):
    """A file of rows [first, first + rows) of `of`, made by `request`."""

    path: str
    first: int
    rows: int
    of: int
    request: dict[str, Any]
    body: Any


def _placed(path: str, texts: dict[str, str], width: int, height: int, body: Any) -> Part:
    """A picture's part by its header; parts are as wide as the whole."""
    match = TILE.match(texts.pop("raynest:tile", ""))
    if match is None:
        raise ValueError("it does not say which tile it is")
    x, y, tile_width, tile_height, whole_width, whole_height = map(int, match.groups())
    if (tile_width, tile_height) != (width, height) or x != 0 or width != whole_width:
        raise ValueError("it is no row of tiles from edge to edge")
    if not 0 < y + height <= whole_height <= SIDE_MAX:
        raise ValueError("its range is none")
    return Part(path, y, height, whole_height, {**texts, "width": whole_width}, body)


def read_png(path: str, data: bytes) -> Part:
    if not data.startswith(PNG):
        raise ValueError("it is no PNG")
    at, texts, packed, head, keep = len(PNG), {}, [], b"", []
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        if len(body) != size or zlib.crc32(kind + body) != struct.unpack_from(">I", data, at + 8 + size)[0]:
            raise ValueError("a chunk is damaged")
        at += 12 + size
        if kind == b"IHDR":
            head = body
        elif kind == b"IDAT":
            packed.append(body)
        elif kind in (b"tEXt", b"iTXt", b"zTXt"):
            key, _, rest = body.partition(b"\0")
            text = rest if kind == b"tEXt" else rest[1:]
            if kind == b"zTXt":
                text = zlib.decompressobj().decompress(text, 1 << 20)
            texts[key.decode("latin-1")] = text.decode("latin-1")
            if key.decode("latin-1") not in OF_PARTS:
                keep.append((kind, body))
        elif kind != b"IEND":
            keep.append((kind, body))
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", head)
    if (depth, colour, interlaced) != (8, 6, 0) or not (0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX):
        raise ValueError("its pixels have another form")
    size = height * (1 + 4 * width)
    rows = zlib.decompressobj().decompress(b"".join(packed), size)
    if len(rows) != size:
        raise ValueError("it is too short")
    if not set(rows[::1 + 4 * width]).issubset(_FILTERS):
        raise ValueError("a row has an unknown filter")
    return _placed(path, texts, width, height, (head, keep, rows))


def _rows_of_pixels(parts: Sequence[Part]) -> str:
    return f"{parts[0].of:,} rows of pixels"


def join_png(parts: Sequence[Part]) -> tuple[bytes, str]:
    head, keep, _ = parts[0].body
    width = struct.unpack_from(">I", head)[0]
    packer = zlib.compressobj(6)
    packed = b""
    for part in parts:
        rows = part.body[2]
        # The filter of a row looks at the row above it, and a part's first row had none.
        packed += packer.compress(_unfiltered(rows[:1 + 4 * width])) + packer.compress(rows[1 + 4 * width:])
    packed += packer.flush()
    blocks = [(b"IHDR", struct.pack(">II", width, parts[0].of) + head[8:]), *keep, (b"IDAT", packed), (b"IEND", b"")]
    return PNG + b"".join(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
                          for kind, body in blocks), _rows_of_pixels(parts)


def _unfiltered(row: bytes) -> bytes:
    """A picture's first row of RGBA without its filter: what lies above it is 0."""
    kind, values = row[0], np.frombuffer(row, np.uint8, offset=1).reshape(-1, 4)
    if kind in (0, 2):
        plain = values
    elif kind in (1, 4):
        plain = np.cumsum(values, axis=0, dtype=np.uint8)
    else:
        plain = np.empty_like(values)
        before = np.zeros(4, np.uint8)
        for i, value in enumerate(values):
            before = plain[i] = value + before // 2
    return b"\0" + plain.tobytes()


def read_exr_part(path: str, data: bytes) -> Part:
    if data[:8] != EXR:
        raise ValueError("it is no EXR of a daemon")
    fields, at = header_of(memoryview(data))
    texts = {name: value.decode(errors="replace") if kind == "string" else value.hex() for name, kind, value in fields
             if kind == "string" or name not in ("dataWindow", "displayWindow")}
    known = {name: value for name, _, value in fields}
    left, top, right, bottom = struct.unpack("<4i", known["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if (left, top) != (0, 0) or not (0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX):
        raise ValueError("its window is another")
    if known["compression"] != bytes([ZIP]):
        raise ValueError("its compression is another")
    blocks, values = [], width * channel_count(known["channels"])
    for rows, packed in blocks_of(memoryview(data), at, 0, height):
        unpacked(packed, 4 * values * rows)  # a damaged one is found out
        blocks.append(bytes(packed))
    return _placed(path, texts, width, height, (fields, blocks))


def join_exr(parts: Sequence[Part]) -> tuple[bytes, str]:
    fields = parts[0].body[0]
    asked = parts[0].request.get("raynest:range_asked", "")
    if not asked:
        return _exr_of(parts, fields), _rows_of_pixels(parts)
    counts = _counted(parts).ravel()    # the range needs all of them
    try:
        made = range_text(asked, counts, _differs(parts)).encode()
    except (LookupError, ValueError) as error:
        raise InvalidError(f"{parts[0].path}: has no range: {error}", "FILE_INVALID") from None
    return _exr_of(parts, [("raynest:range", kind, made) if name == "raynest:range_asked" else (name, kind, value)
                           for name, kind, value in fields]), _rows_of_pixels(parts)


def _differs(parts: Sequence[Part]) -> bool:
    return "raynest:other_scene" in parts[0].request


def counts_of(parts: Sequence[Part]) -> dict[str, Any]:
    """All that a heat map counts, by its names there."""
    if "raynest:metric" not in parts[0].request:
        raise InvalidError(f"{parts[0].path} is of a picture, and no heat map", "FILE_INVALID")
    try:
        return read_exr(_exr_of(parts, parts[0].body[0]), PIXELS_MAX)[0]
    except ProtocolError as error:
        raise InvalidError(f"{parts[0].path}: {error}", "FILE_INVALID") from None


def _counted(parts: Sequence[Part]) -> Any:
    """The counts that a heat map shows."""
    metric, _, level = parts[0].request.get("raynest:metric", "").partition(".")
    counts = counts_of(parts).get(f"L{level}.{metric}" if level else metric)
    if counts is None:
        raise InvalidError(f"{parts[0].path}: it is damaged: it says that it shows {parts[0].request['raynest:metric']}, and "
                           "has no such counts", "FILE_INVALID")
    return counts


def join_npy(parts: Sequence[Part]) -> tuple[Any, str]:
    """The pixels of a picture, or the counts of a heat map, as `raynest render` and `raynest heatmap` write them."""
    if parts[0].path.lower().endswith(".png"):
        made = np.concatenate([unfiltered(part.body[2], part.request["width"]) for part in parts])
    else:
        made = _counted(parts)
        if _differs(parts):
            made = _exact(parts, made)
    return lambda file: np.save(file, made), _rows_of_pixels(parts)


def filled(parts: Sequence[Part]) -> tuple[list[Part], int]:
    """The parts, with pixels that have no sample in place of those that are missing, and how many rows these have."""
    whole: list[Part] = []
    end = missing = 0
    for part in [*parts, parts[0]._replace(first=parts[0].of)]:
        if part.first > end:
            whole.append(_unsampled(parts[0], end, part.first - end))
            missing += part.first - end
        whole.append(part)
        end = part.first + part.rows
    return whole[:-1], missing


def _unsampled(like: Part, first: int, rows: int) -> Part:
    width = like.request["width"]
    if isinstance(like.body[0], bytes):     # the head of a .png
        return like._replace(first=first, rows=rows, body=(*like.body[:2], bytes(rows * (1 + 4 * width))))
    channels = next(value for name, _, value in like.body[0] if name == "channels")
    blocks = [block_of(channels, width, min(LINES, rows - row), UNSAMPLED) for row in range(0, rows, LINES)]
    return like._replace(first=first, rows=rows, body=(like.body[0], blocks))


def join_drawn(parts: Sequence[Part]) -> tuple[bytes, str]:
    """The picture of a heat map, as `raynest heatmap` makes it: raynestd draws it."""
    counts, asked = _counted(parts), parts[0].request
    if _differs(parts):
        counts = _exact(parts, counts)
    first = dict((name, value) for name, kind, value in parts[0].body[0] if kind == "string")
    try:
        attributes = {name: value.decode(errors="replace") for name, value in first.items()
                      if name == "Software" or name.startswith("raynest:") and name not in OF_PARTS}
        attributes["raynest:range"] = range_text(asked["raynest:range_asked"], counts.ravel(), _differs(parts))
        words = {"width": asked["width"], "height": parts[0].of, "differs": _differs(parts),
                 **{name: asked["raynest:" + name] for name in ("metric", "palette", "scale", "count")},
                 "range": asked["raynest:range_asked"], "view": asked["raynest:view"].split("\n"), "attributes": attributes}
    except (LookupError, ValueError) as error:
        raise InvalidError(f"{parts[0].path}: does not say how it is drawn: {error}", "FILE_INVALID") from None
    named = os.environ.get("RAYNESTD") or "raynestd"
    try:
        done = subprocess.run([named, "draw"], input=json.dumps(words).encode() + b"\n" + counts.tobytes(), capture_output=True)
    except OSError as error:
        raise FailedError(f"cannot start {named}, which draws heat maps: {error.strerror}; install raynest here, or write an "
                          ".exr or .npy") from None
    if done.returncode:
        raise FailedError(f"{named} cannot draw it: {done.stderr.decode(errors='replace').strip()}")
    return done.stdout, _rows_of_pixels(parts)


def _exact(parts: Sequence[Part], differences: Any) -> Any:
    if (np.abs(differences) >= EXACT).any():
        raise InvalidError(f"{parts[0].path}: an .exr has differences of {EXACT} or more rounded: let one machine make the whole",
                           "FILE_INVALID")
    return differences.astype("<i4")


def _exr_of(parts: Sequence[Part], fields: Sequence[tuple[str, str, bytes]]) -> bytes:
    window = struct.pack("<4i", 0, 0, parts[0].request["width"] - 1, parts[0].of - 1)
    head = EXR
    for name, kind, value in fields:
        if name in OF_PARTS:
            continue
        value = window if name in ("dataWindow", "displayWindow") else value
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value
    head += b"\0"
    if any(part.first % LINES for part in parts):
        raise InvalidError(f"parts of an EXR begin at multiples of {LINES} rows, as those of --part do", "FILE_INVALID")
    blocks = [block for part in parts for block in part.body[1]]
    place = len(head) + 8 * len(blocks)
    table, body = [], []
    for number, block in enumerate(blocks):
        table.append(place)
        body.append(struct.pack("<iI", number * LINES, len(block)) + block)
        place += 8 + len(block)
    return head + struct.pack(f"<{len(table)}Q", *table) + b"".join(body)
