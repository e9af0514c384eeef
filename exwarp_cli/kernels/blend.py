"""Blending two warped key frames by depth and time."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
Side = tuple[F32, F32, B8, B8]
Row = tuple[F32, B8, B8]
Seen = tuple[F32, B8, B8]

NEARNESS = 10
"""Exponent of the depth weight: a surface twice as near outweighs the other 1000 to 1."""

LEAST_RATIO = np.float32(1e-3)

SAME_DEPTH = np.float32(0.1)
"""Relative difference of depth below which two places may lie on one surface."""

FRINGE_WEIGHT = np.float32(0.02)
"""Weight of a ghost outline: used where the other side sees nothing (worth 0.2 dB)."""


@part
def importance(depth: np.float32, nearest: np.float32, hole: bool, fringe: bool) -> np.float32:
    """Return (nearest / depth) ** NEARNESS, less for a fringe, 0 for a hole.

    Without branches, so that several pixels are taken at once.
    """
    ratio = max(nearest / depth, LEAST_RATIO)
    ratio = ratio if depth != nearest else np.float32(1)
    weight = np.float32(1)
    for _ in range(NEARNESS):
        weight *= ratio
    weight = weight * FRINGE_WEIGHT if fringe else weight
    return np.float32(0) if hole | math.isnan(depth) else weight


@inlined
def same_depth(first: np.float32, second: np.float32) -> bool:
    """Whether two depths may be those of one surface; background is one, NaN is none."""
    return bool((first == second) | (abs(first - second) <= SAME_DEPTH * min(first, second)))


@part
def shows_beside(depth: F32, hole: B8, at: tuple[int, int], wanted: np.float32) -> bool:
    """Return True if one of the 3x3 pixels of [H, W] about a place is seen and so far away."""
    height, width = depth.shape
    found = False
    for i in range(max(at[0] - 1, 0), min(at[0] + 2, height)):
        for j in range(max(at[1] - 1, 0), min(at[1] + 2, width)):
            found |= (not hole[i, j]) & same_depth(depth[i, j], wanted)
    return found


@part
def mark_shared_edges(i: int, before: tuple[F32, B8], after: tuple[F32, B8], shared: B8) -> None:
    """Mark pixels of row i where the sides show two surfaces whose common edge passes by.

    Each key frame's pixels have the surface of their centre, so moved to the slot its edges are off
    by up to half a pixel. Where one side shows the nearer surface and the other one the surface
    behind it, and each has the other surface beside that pixel, the edge passes through the pixel.

    Parameters
    ----------
    before, after
        Depth float32 [H, W] and hole bool [H, W].
    shared
        bool [W], written.
    """
    first, first_hole = before
    second, second_hole = after
    for j in range(shared.size):
        a, b = first[i, j], second[i, j]
        both = not (first_hole[i, j] | second_hole[i, j] | math.isnan(a) | math.isnan(b))
        shared[j] = both and not same_depth(a, b)
        if shared[j]:
            shared[j] = shows_beside(first, first_hole, (i, j), b)
            shared[j] &= shows_beside(second, second_hole, (i, j), a)


@part
def write_shares(
    before: Row, after: Row, shared: B8, time: np.float32, share: F32, depth: F32, hole: B8
) -> None:
    """Write how much of a row's colour comes from the key frame after it.

    Parameters
    ----------
    before, after
        Depth float32 [W], hole and fringe bool [W] of the row.
    shared
        bool [W], of :func:`mark_shared_edges`: there time alone decides, so that an edge that one
        side has a pixel further covers a share of the pixel.
    time
        As in :func:`blend`.
    share
        float32 [W], written; 0 in holes.
    depth, hole
        float32 and bool [W], written.
    """
    first, first_hole, first_fringe = before
    second, second_hole, second_fringe = after
    for j in range(share.size):
        near = second[j]
        near = first[j] if (first[j] < near) | math.isnan(near) else near
        a = importance(first[j], near, first_hole[j], first_fringe[j])
        b = importance(second[j], near, second_hole[j], second_fringe[j])
        a = np.float32(1) - time if shared[j] else a * (np.float32(1) - time)
        b = time if shared[j] else b * time
        seen = a + b > 0
        depth[j], hole[j] = near, not seen
        share[j] = b / (a + b) if seen else np.float32(0)


@inlined
def spread(share: F32, channels: int, out: F32) -> None:
    """Write each value of `share`, float32 [W], once a channel to `out` [W C]."""
    for j in range(share.size):
        for c in range(channels):
            out[j * channels + c] = share[j]


@part
def mix_row(first: F32, second: F32, share: F32, out: F32) -> None:
    """Mix two rows of values; `share` is that of the second.

    From the heavier side: exact where it counts alone, whatever stands in the other.
    """
    for k in range(out.size):
        one, other, rest = first[k], second[k], np.float32(1) - share[k]
        forth, back = one + share[k] * (other - one), other + rest * (one - other)
        out[k] = forth if share[k] < np.float32(0.5) else back


@part
def blend_row(before: F32, after: F32, share: F32, out: F32) -> None:
    """Mix two rows of pixels, float32 [W, C]; `share` of the second is float32 [W]."""
    channels = out.shape[1]
    shares = np.empty(out.size, np.float32)
    # Written out, as the compiler unrolls the loop over channels for constants only. Pixel by pixel
    # the mixing itself took three times as long as value by value.
    if channels == 4:
        spread(share, 4, shares)
    elif channels == 3:
        spread(share, 3, shares)
    else:
        spread(share, channels, shares)
    first, second = (
        np.ascontiguousarray(before).reshape(-1),
        np.ascontiguousarray(after).reshape(-1),
    )
    mixed, whole = np.empty(out.size, np.float32), out.reshape(-1)
    mix_row(first, second, shares, mixed)  # `out` may be `before`, for which loops are slow
    for k in range(out.size):
        whole[k] = mixed[k]


@part
def weigh_row(
    i: int, before: Seen, after: Seen, time: np.float32, share: F32, depth: F32, hole: B8
) -> None:
    """Write the shares of row i; `share`, `depth` and `hole` are its own, as for `write_shares`.

    `before` and `after` are depth, hole and fringe of the frame, [H, W].
    """
    shared = np.empty(share.size, np.bool_)
    mark_shared_edges(i, (before[0], before[1]), (after[0], after[1]), shared)
    first = before[0][i], before[1][i], before[2][i]
    second = after[0][i], after[1][i], after[2][i]
    write_shares(first, second, shared, time, share, depth, hole)


@parallel
def weigh(
    before: Seen, after: Seen, time: np.float32, later: F32, depth: F32, hole: B8, share: Share
) -> None:
    """Write how much of a slot's colour comes from the key frame after it.

    Parameters
    ----------
    before, after
        Depth, hole and fringe, as for :func:`blend`.
    time, depth, hole
        As for :func:`blend`.
    later
        float32 [H, W], written, 0 to 1; 0 in holes.
    """
    for i in turns(later.shape[0], share):
        weigh_row(i, before, after, time, later[i], depth[i], hole[i])


@parallel
def mix(before: F32, after: F32, later: F32, out: F32, share: Share) -> None:
    """Mix two pictures.

    Parameters
    ----------
    before, after
        float32 [H, W, C].
    later
        float32 [H, W], 0 to 1: weight of `after`.
    out
        float32 [H, W, C], written; may be `before`.
    """
    for i in turns(later.shape[0], share):
        blend_row(before[i], after[i], later[i], out[i])


@parallel
def blend(
    before: Side,
    after: Side,
    time: np.float32,
    out: F32,
    depth: F32,
    hole: B8,
    share: Share,
) -> None:
    """Blend what two key frames show at a slot.

    Parameters
    ----------
    before, after
        Pixels float32 [H, W, C], depth float32 [H, W] (+inf background, NaN unknown), hole and
        fringe bool [H, W] of the key frames on both sides, warped to the slot.
    time
        Of the slot in the key interval, 0 < time < 1.
    out
        float32 [H, W, C], written; in holes that of `before`, whose pixels it may be.
    depth
        float32 [H, W], written: the nearer of both depths.
    hole
        bool [H, W], written: neither side sees the surface.

    Notes
    -----
    Niklaus and Liu, Softmax Splatting, CVPR 2020, equation 14, with log depth for importance. Where
    an edge is shared, the nearer surface would always win, and every moving thing would be up to a
    pixel too wide: of town's pixels 1.5 % showed it wrongly, and 0.2 % what is behind it. There
    the mean of both sides is 1.1 to 1.6 dB better on three scenes.
    """
    height, width, _ = out.shape
    for i in turns(height, share):
        later = np.empty(width, np.float32)
        first, second = (before[1], before[2], before[3]), (after[1], after[2], after[3])
        weigh_row(i, first, second, time, later, depth[i], hole[i])
        blend_row(before[0][i], after[0][i], later, out[i])
