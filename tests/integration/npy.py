""".npy files, for tests without numpy."""
import ast
import struct


def npy(shape, data):
    """Returns the file of an array of float32, from its bytes."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(64 * ((len(header) + 74) // 64) - 11).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def read_npy(data):
    """Returns dtype, shape and values of a .npy."""
    assert data[:6] == b"\x93NUMPY", data[:6]
    size = struct.unpack("<H", data[8:10])[0]
    header = ast.literal_eval(data[10:10 + size].decode())
    letter = {"<f4": "f", "<u4": "I", "<u8": "Q", "|u1": "B", "|b1": "B", "<i8": "q"}[header["descr"]]
    body = data[10 + size:]
    values = struct.unpack(f"<{len(body) // struct.calcsize(letter)}{letter}", body)
    return header["descr"], header["shape"], values
