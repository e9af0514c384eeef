"""Which surface prevails in a pixel, of those that are ranked by their share of it.

Serial: each takes 5 to 20 ms for 1080p, and frames are read beside one another.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled, inlined
from exwarp_cli.kernels.edges import SAME_DEPTH

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
U32 = npt.NDArray[np.uint32]

MIXED = -1
"""Id of pixels in which no surface prevails."""

MAGNITUDE, EXPONENT = np.uint32(0x7FFFFFFF), np.uint32(0x7F800000)
HALF_STEP, TAIL = np.uint32(0x80), np.uint32(0xFF)


@inlined
def identity(bits: np.uint32, rounded: bool) -> np.int32:
    """Return an id without its sign; `rounded`: as PXR24 compression leaves it, of 24 bits.

    That format's rule: the nearest multiple of 256, half way up, unless that is infinite.
    """
    kept = np.uint32(bits & MAGNITUDE)
    if rounded:
        up = np.uint32(kept + (kept & HALF_STEP))
        if up < EXPONENT:
            kept = up
        kept = np.uint32(kept & ~TAIL)
    return np.int32(kept)


@inlined
def usable(share: np.float32, ident: np.int32) -> np.float32:
    """Return a share, at most 1; 0 where it belongs to no surface or is NaN."""
    if ident == 0 or not share > np.float32(0):
        return np.float32(0)
    return min(share, np.float32(1))


@inlined
def prevailing(
    first: np.int32, second: np.int32, share: np.float32, other: np.float32, lead: np.float32
) -> np.int32:
    """Return the id that leads, 0 if the background does, `MIXED` if nothing does.

    `share` and `other` are those of the two ids. What they leave of 1 is background or surfaces of
    lower rank; none of those has more than the lesser of the two, and a file holds four of them.
    """
    if other > share:
        first, share, other = second, other, share
    left = max(np.float32(1) - share - other, np.float32(0))
    if share - max(other, left) > lead:
        return first
    if left - np.float32(4) * other - share > lead:
        return np.int32(0)
    return np.int32(MIXED)


@inlined
def is_among(ident: np.int32, ids: I32) -> bool:
    """Whether an id is one of some, which ascend."""
    low, high = 0, ids.size
    while low < high:
        middle = (low + high) // 2
        if ids[middle] < ident:
            low = middle + 1
        else:
            high = middle
    return bool(low < ids.size and ids[low] == ident)


@compiled
def write_surfaces(bits: U32, shares: F32, lead: np.float32, rounded: bool, out: I32) -> None:
    """Write the id of the surface that each pixel shows.

    Parameters
    ----------
    bits, shares
        The same array [H, W, 4], as uint32 and as float32: id, share, id, share, in any order of
        rank.
    lead
        By how much the greatest share must exceed every other one.
    rounded
        Whether ids are rounded to 24 bits.
    out
        int32 [H, W], written: id above 0, 0 background, `MIXED` where nothing leads.
    """
    height, width, _ = bits.shape
    for i in range(height):
        for j in range(width):
            first = identity(bits[i, j, 0], rounded)
            second = identity(bits[i, j, 2], rounded)
            share, other = usable(shares[i, j, 1], first), usable(shares[i, j, 3], second)
            out[i, j] = prevailing(first, second, share, other, lead)


@compiled
def write_moving(
    bits: U32, shares: F32, lead: np.float32, rounded: bool, moving: I32, out: I32
) -> None:
    """Write the ids of the surfaces that move.

    Parameters
    ----------
    bits, shares, lead, rounded
        As in :func:`write_surfaces`.
    moving
        int32 [N], ids, ascending.
    out
        int32 [H, W], written: id of a moving surface that prevails; 0 where a still one does, the
        background does, or nothing that moves has a share; else `MIXED`.
    """
    height, width, _ = bits.shape
    # Neighbours mostly have the same ids: looking each up anew took ten times as long.
    ids, found = np.zeros(2, np.int32), np.zeros(2, np.bool_)
    for i in range(height):
        for j in range(width):
            for rank in range(2):
                ident = identity(bits[i, j, 2 * rank], rounded)
                if ident != ids[rank]:
                    ids[rank], found[rank] = ident, is_among(ident, moving)
            first, second = ids[0], ids[1]
            share, other = usable(shares[i, j, 1], first), usable(shares[i, j, 3], second)
            one = found[0] and share > np.float32(0)
            two = found[1] and other > np.float32(0)
            out[i, j] = np.int32(0)
            if one or two:
                shown = prevailing(first, second, share, other, lead)
                moves = (one and shown == first) or (two and shown == second)
                if shown < 0 or moves:
                    out[i, j] = shown


@inlined
def apart(one: np.float32, other: np.float32) -> np.float32:
    """Return how far two depths are apart, relative to the farther; background is one surface."""
    if one == other:  # infinite too
        return np.float32(0)
    return abs(one - other) / max(abs(one), abs(other))


@inlined
def nearest_in_depth(ids: I32, depth: F32, i: int, j: int) -> np.int32:
    """Return a pixel's id, or its nearest neighbour's in depth where none shares both."""
    best, found = np.float32(np.inf), ids[i, j]
    for y in range(max(i - 1, 0), min(i + 2, ids.shape[0])):
        for x in range(max(j - 1, 0), min(j + 2, ids.shape[1])):
            if ids[y, x] < 0 or (y == i and x == j):
                continue
            away = apart(depth[i, j], depth[y, x])
            if not away <= SAME_DEPTH:  # nor NaN
                continue
            if ids[y, x] == ids[i, j]:
                return np.int32(ids[i, j])
            if away < best:
                best, found = away, ids[y, x]
    return np.int32(found)


@compiled
def write_by_depth(ids: I32, depth: F32, out: I32) -> None:
    """Give pixels the id of the surface that their depth is of.

    Parameters
    ----------
    ids
        int32 [H, W], negative where none prevails.
    depth
        float32 [H, W], +inf background.
    out
        int32 [H, W], written: where no neighbour of the pixel's own id is at its depth, the id of
        the one of eight that is nearest in depth, if that is `SAME_DEPTH` or less.
    """
    height, width = ids.shape
    for i in range(height):
        for j in range(width):
            out[i, j] = nearest_in_depth(ids, depth, i, j)
