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


def planes24(planes: Planes) -> bytes:
    """Return what PXR24 deflates; the lowest byte of floats is left out."""
    found = bytearray()
    for y in range(len(planes[0])):
        for plane in planes:
            count = {"e": 2, "f": 3, "I": 4}[plane.dtype.char]
            values = plane[y].view(f"u{plane.itemsize}").tolist()
            if count == 3:
                values = [value >> 8 for value in values]
            pairs = zip([0, *values], values, strict=False)
            rises = [(value - before) % 256**count for before, value in pairs]
            for place in reversed(range(count)):
                found += bytes(rise >> 8 * place & 255 for rise in rises)
    return bytes(found)


def runs(data: bytes) -> bytes:
    """Return run lengths: up to 128 equal bytes, or up to 127 of any kind."""
    found, at = bytearray(), 0
    while at < len(data):
        count = 1
        while at + count < len(data) and data[at + count] == data[at] and count < 128:
            count += 1
        if count > 1:
            found += bytes([count - 1, data[at]])
        else:
            while (
                at + count < len(data) and count < 127 and data[at + count] != data[at + count - 1]
            ):
                count += 1
            found += bytes([256 - count]) + data[at : at + count]
        at += count
    return bytes(found)


def singles(planes: Planes, drop: bool = False) -> np.ndarray:
    """Return bits, uint32 [H, W, C]: values as floats, NaN with its bits; whole numbers as such.

    `drop` leaves out the lowest byte of floats, as PXR24 does.
    """
    return np.stack([_bits(plane, drop) for plane in planes], -1)


def _bits(plane: np.ndarray, drop: bool) -> np.ndarray:
    if plane.dtype == np.float16:
        half = plane.view(np.uint16).astype(np.uint32)
        found = plane.astype(np.float32).view(np.uint32)
        unusual = (half >> 16 - 1 << 31) | 0x7F800000 | (half & 0x3FF) << 13
        return np.where(half >> 10 & 31 == 31, unusual, found).astype(np.uint32)
    bits = plane.view(np.uint32)
    return bits & np.uint32(0xFFFFFF00) if drop and plane.dtype == np.float32 else bits
