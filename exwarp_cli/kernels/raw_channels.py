"""Depths and ids from the raw channels of a file.

Serial: each takes 5 to 20 ms for 1080p, and several frames are read at once.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.kernels._compile import inline, kernel
from exwarp_cli.kernels.array_types import F32, I32, U32
from exwarp_cli.kernels.silhouettes import SAME_DEPTH


@kernel
def write_depths(
    depth: F32,  # [N]
    normals: F32,  # [3 N]; [0] if unknown
    far: np.float32,
    out: F32,  # [N], written: depths above 0 and below `far`; else, and where NaN, +inf
) -> None:
    """Write depths, +inf where the normal is (-1, -1, -1)."""
    infinite, mark = np.float32(np.inf), np.float32(-1)
    for n in range(out.size):
        is_valid = (np.float32(0) < depth[n]) & (depth[n] < far)
        if normals.size > 0:
            x, y, z = normals[3 * n], normals[3 * n + 1], normals[3 * n + 2]
            is_valid &= (x != mark) | (y != mark) | (z != mark)
        out[n] = depth[n] if is_valid else infinite


MIN_ID, MAX_ID = np.float32(-1), np.float32(2**31 - 128)
MAX_FRACTION = np.float32(0.02)  # from here on an id is a mixture of two


@kernel
def round_ids(ids: F32, out: I32) -> None:
    """Round ids [N] to integers within int32; -1 for NaN and for mixed ids (fractions)."""
    infinite = np.float32(np.inf)
    for n in range(out.size):
        value = ids[n] if abs(ids[n]) < infinite else MIN_ID
        rounded = min(max(np.rint(value), MIN_ID), MAX_ID)
        out[n] = np.int32(rounded) if abs(value - rounded) < MAX_FRACTION else np.int32(-1)


AMBIGUOUS = -1  # id of pixels without a dominant surface

MAGNITUDE, EXPONENT = np.uint32(0x7FFFFFFF), np.uint32(0x7F800000)
HALF_STEP, TAIL_BITS = np.uint32(0x80), np.uint32(0xFF)


@inline
def decode_id(bits: np.uint32, rounded: bool) -> np.int32:
    """Return an id without its sign; `rounded`: as PXR24 compression leaves it, of 24 bits."""
    # PXR24: the nearest multiple of 256, half way up, unless that is infinite.
    magnitude = np.uint32(bits & MAGNITUDE)
    if rounded:
        up = np.uint32(magnitude + (magnitude & HALF_STEP))
        if up < EXPONENT:
            magnitude = up
        magnitude = np.uint32(magnitude & ~TAIL_BITS)
    return np.int32(magnitude)


@inline
def _dominant_id(
    first: np.int32, second: np.int32, share: np.float32, second_share: np.float32, lead: np.float32
) -> np.int32:
    """Return the dominant id, 0 if it is the background, AMBIGUOUS if there is none.

    The shares are those of the two ids. The remainder of 1 is background or surfaces of lower rank;
    a file holds four more, and none exceeds the lesser of the two.
    """
    if second_share > share:
        first, share, second_share = second, second_share, share
    remainder = max(np.float32(1) - share - second_share, np.float32(0))
    if share - max(second_share, remainder) > lead:
        return first
    if remainder - np.float32(4) * second_share - share > lead:
        return np.int32(0)
    return np.int32(AMBIGUOUS)


@inline
def _is_listed(ident: np.int32, ids: I32) -> bool:
    low, high = 0, ids.size  # np.searchsorted takes 4 s more to compile
    while low < high:
        middle = (low + high) // 2
        if ids[middle] < ident:
            low = middle + 1
        else:
            high = middle
    return bool(low < ids.size and ids[low] == ident)


@kernel
def write_dominant_ids(
    bits: U32,  # [H, W, 4], the same array as `shares`: id, share, id, share, in any order of rank
    shares: F32,
    lead: np.float32,  # margin of the greatest share over every other one
    rounded: bool,  # ids have 24 bits
    moving: I32,  # [N], ids, ascending
    every: bool,  # all ids count, not only the moving ones
    # out: [H, W], written: the dominant id if it counts; 0 for the background and where no id that
    # counts has a share; else AMBIGUOUS
    out: I32,
) -> None:
    """Write the id of the surface that each pixel shows, of those that count."""
    height, width, _ = bits.shape
    # Neighbours mostly have the same ids: looking each up again took ten times as long.
    ids, counts = np.zeros(2, np.int32), np.zeros(2, np.bool_)
    clamped, zero, one = np.zeros(2, np.float32), np.float32(0), np.float32(1)
    for i in range(height):
        for j in range(width):
            for rank in range(2):
                ident = decode_id(bits[i, j, 2 * rank], rounded)
                if ident != ids[rank]:
                    ids[rank], counts[rank] = ident, every or _is_listed(ident, moving)
                share = shares[i, j, 2 * rank + 1]
                clamped[rank] = min(share, one) if ident != 0 and share > zero else zero
            first, second = ids[0], ids[1]
            first_counts = counts[0] and clamped[0] > zero
            second_counts = counts[1] and clamped[1] > zero
            out[i, j] = np.int32(0)
            if first_counts or second_counts:
                dominant = _dominant_id(first, second, clamped[0], clamped[1], lead)
                is_counted = (first_counts and dominant == first) or (
                    second_counts and dominant == second
                )
                if dominant < 0 or is_counted:
                    out[i, j] = dominant


@inline
def _nearest_id_in_depth(ids: I32, depth: F32, i: int, j: int) -> np.int32:
    least, best_id = np.float32(np.inf), ids[i, j]
    for y in range(max(i - 1, 0), min(i + 2, ids.shape[0])):
        for x in range(max(j - 1, 0), min(j + 2, ids.shape[1])):
            if ids[y, x] < 0 or (y == i and x == j):
                continue
            own, neighbour = depth[i, j], depth[y, x]
            difference = abs(own - neighbour) / max(abs(own), abs(neighbour))
            difference = np.float32(0) if own == neighbour else difference  # background is one
            if not difference <= SAME_DEPTH:  # nor NaN
                continue
            if ids[y, x] == ids[i, j]:
                return np.int32(ids[i, j])
            if difference < least:
                least, best_id = difference, ids[y, x]
    return np.int32(best_id)


@kernel
def write_ids_by_depth(
    ids: I32,  # [H, W], negative where ambiguous
    depth: F32,  # [H, W], +inf background
    out: I32,  # [H, W], written
) -> None:
    """Give each pixel the id of its surface by depth.

    A pixel keeps its id if a neighbour of that id is at its depth. Otherwise it takes that of the
    neighbour nearest in depth, if the difference is at most SAME_DEPTH.
    """
    height, width = ids.shape
    for i in range(height):
        for j in range(width):
            out[i, j] = _nearest_id_in_depth(ids, depth, i, j)
