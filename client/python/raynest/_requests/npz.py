"""Writes .npz files."""
from __future__ import annotations

import zipfile
from typing import Any, Mapping

import numpy as np

from .._net.frame import Array


def write_npz(file: Any, columns: Mapping[str, Array]) -> None:
    """As numpy.savez() does, in which no column may be called "file" and whose files have the date of today in some
    versions of Python."""
    write: Any = np.lib.format.write_array  # has no types in older versions
    with zipfile.ZipFile(file, "w") as archive:
        for name, column in columns.items():
            with archive.open(zipfile.ZipInfo(name + ".npy"), "w", force_zip64=True) as member:
                write(member, column, allow_pickle=False)
