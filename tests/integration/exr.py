"""Just enough of OpenEXR to read what the daemon writes: one part, scan lines, zip or no compression, 32 bits a value.

The layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""
import struct
import zlib

LINES_OF_A_BLOCK = {0: 1, 2: 1, 3: 16}  # by compression: none, zips, zip
FORMATS = {0: "I", 2: "f"}


def unpacked(data, size):
    """A block as it was before compression: bytes were split into even and odd ones, each then written as what it
    differs by from the one before."""
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


def read_exr(data):
    """(width, height, {channel: its values, row by row from the top})"""
    if struct.unpack_from("<II", data) != (20000630, 2):
        raise ValueError("no plain OpenEXR file")
    header, at = {}, 8
    while data[at]:
        end = data.index(0, at)
        name, at = data[at:end].decode(), end + 1
        at = data.index(0, at) + 1  # past its type
        size, = struct.unpack_from("<I", data, at)
        header[name], at = data[at + 4:at + 4 + size], at + 4 + size
    at += 1

    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    channels, rest = [], header["channels"]
    while rest[0]:
        name, rest = rest.split(b"\0", 1)
        channels.append((name.decode(), FORMATS[struct.unpack_from("<I", rest)[0]]))
        rest = rest[16:]

    lines = LINES_OF_A_BLOCK[header["compression"][0]]
    columns = {name: [] for name, _ in channels}
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        first, packed = struct.unpack_from("<iI", data, offset)
        rows = min(lines, bottom + 1 - first)
        block = unpacked(data[offset + 8:offset + 8 + packed], rows * width * 4 * len(channels))
        for row in range(rows):
            for number, (name, form) in enumerate(channels):
                columns[name] += struct.unpack_from(f"<{width}{form}", block, 4 * width * (row * len(channels) + number))
    return width, height, columns
