"""A minimal OpenEXR reader for the daemon's files: one part, scan lines, zip or no compression,
32 bits per value.

The layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""
import struct
import zlib

LINES_OF_A_BLOCK = {0: 1, 2: 1, 3: 16}  # lines per block, by compression: none, zips, zip
FORMATS = {0: "I", 2: "f"}
LONG_NAMES = 0x400  # a flag beside the version


def unpacked(data, size):
    """Decompresses a block. Before compression its bytes were split into even and odd ones, and
    each replaced by its difference from the previous one."""
    if len(data) == size:
        return data
    deltas = zlib.decompress(data)
    total, values = 0, bytearray()
    for number, delta in enumerate(deltas):
        total = (delta if number == 0 else total + delta - 128) & 0xFF
        values.append(total)
    plain = bytearray(size)
    plain[0::2], plain[1::2] = values[:(size + 1) // 2], values[(size + 1) // 2:]
    return bytes(plain)


def read_header(data):
    """Returns ({attribute: (type, bytes)}, where the header ends)."""
    magic, version = struct.unpack_from("<II", data)
    if magic != 20000630 or version & ~LONG_NAMES != 2:
        raise ValueError("not a plain OpenEXR file")
    header, at = {}, 8
    while data[at]:
        end = data.index(0, at)
        name, at = data[at:end].decode(), end + 1
        end = data.index(0, at)
        kind, at = data[at:end].decode(), end + 1
        size, = struct.unpack_from("<I", data, at)
        header[name], at = (kind, data[at + 4:at + 4 + size]), at + 4 + size
    return header, at + 1


def read_texts(data):
    """Returns the header's texts by name."""
    return {name: value.decode() for name, (kind, value) in read_header(data)[0].items() if kind == "string"}


def blocks(data):
    """Returns (width, height, [(channel, format)], [(first row, rows, plain bytes)])."""
    attributes, at = read_header(data)
    header = {name: value for name, (_, value) in attributes.items()}
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    channels, rest = [], header["channels"]
    while rest[0]:
        name, rest = rest.split(b"\0", 1)
        channels.append((name.decode(), FORMATS[struct.unpack_from("<I", rest)[0]]))
        rest = rest[16:]
    lines = LINES_OF_A_BLOCK[header["compression"][0]]
    found = []
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        first, packed = struct.unpack_from("<iI", data, offset)
        rows = min(lines, bottom + 1 - first)
        plain = unpacked(data[offset + 8:offset + 8 + packed], rows * width * 4 * len(channels))
        found.append((first, rows, plain))
    return width, height, channels, found


def read_exr(data):
    """Returns (width, height, {channel: values, row by row from the top})."""
    width, height, channels, found = blocks(data)
    columns = {name: [] for name, _ in channels}
    for _, rows, plain in found:
        for row in range(rows):
            for number, (name, form) in enumerate(channels):
                columns[name] += struct.unpack_from(f"<{width}{form}", plain, 4 * width * (row * len(channels) + number))
    return width, height, columns


def with_values(data, channel, values):
    """Returns the file with other values of a channel: {pixel: four bytes}. Its blocks are not compressed."""
    width, _, channels, found = blocks(data)
    number = [name for name, _ in channels].index(channel)
    file = bytearray(data[:read_header(data)[1]])
    packed = []
    for first, rows, plain in found:
        changed = bytearray(plain)
        for pixel, value in values.items():
            y, x = divmod(pixel, width)
            if first <= y < first + rows:
                at = 4 * (width * ((y - first) * len(channels) + number) + x)
                changed[at:at + 4] = value
        packed.append(struct.pack("<iI", first, len(changed)) + changed)
    at = len(file) + 8 * len(packed)
    for block in packed:
        file += struct.pack("<Q", at)
        at += len(block)
    return bytes(file) + b"".join(packed)
