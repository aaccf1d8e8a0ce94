"""Reads the pixels of a PNG: 8 bits per channel, RGBA, not interlaced.

The filters: https://www.w3.org/TR/png-3/#9Filters
"""
from __future__ import annotations

import numpy as np

from .._net.frame import Array


def unfiltered(rows: bytes, width: int) -> Array:
    """The pixels (height, width, 4) of rows that each begin with the kind of their filter. A pixel needs those to its
    left and above it, so all of a diagonal are made at once."""
    lines = np.frombuffer(rows, np.uint8).reshape(-1, 1 + 4 * width)
    height = len(lines)
    kinds, given = lines[:, 0], lines[:, 1:].reshape(height, width, 4)
    pixels = np.empty((height, width, 4), np.uint8)
    # The diagonal before, and that before it, by rows; nothing is left of a picture, nor above.
    last, before = (np.zeros((height + 1, 4), np.int16) for _ in range(2))
    for diagonal in range(width + height - 1):
        first, end = max(0, diagonal - width + 1), min(height, diagonal + 1)
        at = np.arange(first, end)
        left, up, corner = last[first + 1:end + 1], last[first:end], before[first:end]
        of = up + left - corner
        far = np.abs([of - left, of - up, of - corner])
        paeth = np.where((far[0] <= far[1]) & (far[0] <= far[2]), left, np.where(far[1] <= far[2], up, corner))
        guess = np.choose(kinds[first:end, None], (np.zeros_like(left), left, up, (left + up) // 2, paeth))
        made = (given[at, diagonal - at] + guess) & 255
        pixels[at, diagonal - at] = made
        last, before = np.zeros_like(last), last
        last[first + 1:end + 1] = made
    return pixels
