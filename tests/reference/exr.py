"""Scan lines of OpenEXR's compressions, byte after byte, from the pixels that they stand for."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

Planes = list[np.ndarray]


def lines(planes: Planes) -> bytes:
    """Return channels [H, W] as they are in memory: in each line a channel after the other."""
    height = len(planes[0])
    return b"".join(plane[y].tobytes() for y in range(height) for plane in planes)


def halves(data: bytes) -> bytes:
    """Return what ZIP deflates: even bytes, then odd ones, each less the one before, plus 128."""
    order = data[::2] + data[1::2]
    rises = [order[0]]
    for before, byte in pairwise(order):
        rises.append((byte - before + 128) % 256)
    return bytes(rises)


def singles(planes: Planes) -> np.ndarray:
    """Return bits, uint32 [H, W, C]: values as floats, NaN with its bits; integers as such."""
    return np.stack([_bits(plane) for plane in planes], -1)


def _bits(plane: np.ndarray) -> np.ndarray:
    if plane.dtype == np.float16:
        half = plane.view(np.uint16).astype(np.uint32)
        found = plane.astype(np.float32).view(np.uint32)
        unusual = (half >> 16 - 1 << 31) | 0x7F800000 | (half & 0x3FF) << 13
        return np.where(half >> 10 & 31 == 31, unusual, found).astype(np.uint32)
    return plane.view(np.uint32)
