""".npy files, for tests that do without numpy."""
import struct


def npy(shape, data):
    """The file of an array of float32, from its bytes."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(64 * ((len(header) + 74) // 64) - 11).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data
