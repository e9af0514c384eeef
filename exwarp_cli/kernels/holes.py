"""Finding holes: pixels whose source is another surface."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]
B8 = npt.NDArray[np.bool_]

FOOTPRINTS = np.float32(2.0)
"""How many pixel footprints two world positions may lie apart and still be the same surface: the
nearest source pixel is up to 0.71 pixels off, and its own sample as much again."""

DEPTH_TOLERANCE = np.float32(0.1)
"""Relative change of depth up to which two pixels may be the same surface, without positions."""

ROUNDINGS = np.float32(1.1)
"""Steps that rounded depths of one point lie apart at most: one, as far as it can be measured."""

Steps = tuple[np.float32, np.float32]
"""To which values were rounded: a depth's step in scene units, and that of its inverse."""

Limits = tuple[np.float32, np.float32, np.float32, np.float32]


@inlined
def same_depth(a: np.float32, b: np.float32, tolerance: np.float32, steps: Steps) -> bool:
    """Whether two depths, neither of background, differ by no more than a share of the larger.

    Rounded depths of one point lie up to a step apart; of the inverse that is |1/a - 1/b|. Added to
    the share instead of as another bound, the step hid holes at near outlines: 0.1 dB lost.
    """
    rounding = steps[0] + steps[1] * a * b
    return not abs(a - b) > max(tolerance * max(a, b), ROUNDINGS * rounding)


@inlined
def apart(position: F32, i: int, j: int, other: F32, y: int, x: int) -> np.float32:
    """Squared distance of the positions at (i, j) and, in another frame, at (y, x)."""
    squared = np.float32(0.0)
    # Unsigned indices need no test for counting from the end.
    p, q, r, s = np.uint64(i), np.uint64(j), np.uint64(y), np.uint64(x)
    for c in range(3):
        squared += (position[p, q, c] - other[r, s, c]) ** 2
    return squared


@inlined
def spacing(position: F32, i: int, j: int, down: int, right: int) -> np.float32:
    """Squared distance to the nearer of the two neighbours on an axis; infinite without any.

    The nearer, so that a silhouette beside the pixel does not enlarge it.
    """
    height, width, _ = position.shape
    best = np.float32(np.inf)
    if i >= down and j >= right:
        best = min(best, apart(position, i - down, j - right, position, i, j))
    if i + down < height and j + right < width:
        best = min(best, apart(position, i + down, j + right, position, i, j))
    return best


@inlined
def beyond_footprint(
    position: F32, i: int, j: int, squared: np.float32, rounded: np.float32
) -> bool:
    """Whether a squared distance is more than FOOTPRINTS of the pixel at (i, j).

    The footprint is its size in world space, which grows with distance and at grazing angles: the
    sum of its spacing on both axes. What is within that of one axis needs no roots. `rounded` is
    the step of the positions as a share of each; both ends together are off by up to a step.
    """
    total, many = np.float32(0.0), FOOTPRINTS * FOOTPRINTS
    for axis in range(2):
        step = spacing(position, i, j, 1 - axis, axis)
        if step < np.float32(np.inf):
            if squared <= many * step:
                return False
            total += np.float32(math.sqrt(step))
    size, p, q = np.float32(0), np.uint64(i), np.uint64(j)
    for c in range(3):
        size += abs(position[p, q, c])
    return bool(math.sqrt(squared) > FOOTPRINTS * total + rounded * size)


@inlined
def is_background(depth: F32, i: int, j: int) -> bool:
    """Whether a pixel shows no surface."""
    return math.isinf(depth[np.uint64(i), np.uint64(j)])


@inlined
def other_surface(
    i: int,
    j: int,
    y: int,
    x: int,
    positions: tuple[F32, F32],
    normals: tuple[F32, F32],
    least_cosine: np.float32,
    rounded: np.float32,
) -> bool:
    """Whether position (static) or normal (dynamic) at (i, j) now and (y, x) then disagree.

    `least_cosine` is that of the normals of one dynamic surface, -2 for a static one.
    """
    if least_cosine > -2:
        now, then = normals
        if now.shape[0] == 0:
            return False
        dot, a, b = np.float32(0), np.float32(0), np.float32(0)
        p, q, r, s = np.uint64(i), np.uint64(j), np.uint64(y), np.uint64(x)
        for c in range(3):
            dot += now[p, q, c] * then[r, s, c]
            a += now[p, q, c] ** 2
            b += then[r, s, c] ** 2
        return bool(dot < least_cosine * math.sqrt(a * b))
    here, there = positions
    if here.shape[0] == 0:
        return False
    return bool(beyond_footprint(here, i, j, apart(here, i, j, there, y, x), rounded))


@parallel
def mark(
    field: F32,
    depths: tuple[F32, F32],
    stencils: tuple[I32, I32],
    positions: tuple[F32, F32],
    normals: tuple[F32, F32],
    limits: Limits,
    hole: B8,
    share: Share,
) -> None:
    """Mark pixels whose source along a motion field is not the same surface point.

    Parameters
    ----------
    field
        float32 [H, W, 2], from the target instant to the source instant; NaN is a hole.
    depths
        float32 [H, W] at target and source; +inf background.
    stencils
        int32 [H, W] or [0, 0] when unknown; negative where ids mix.
    positions, normals
        float32 [H, W, 3] or [0, 0, 3] when unknown.
    limits
        The cosine of the angle by which the normal of one dynamic surface may turn on the way, and
        the steps to which values were rounded, 0 if not at all: depths in scene units, their
        inverse, and positions as a share of each.
    hole
        bool [H, W], written.

    Notes
    -----
    ExtraNet's tests: ids differ; a static pixel's world positions lie further apart than a bias
    that grows with depth and grazing angle; a dynamic pixel's normal turned. Without positions the
    depths stand in. What rounding alone can do is no difference.
    """
    height, width, _ = field.shape
    known_ids = stencils[0].shape[0] > 0
    known_positions = positions[0].shape[0] > 0
    least_cosine, linear, inverse, rounded = limits
    for i in turns(height, share):
        for j in range(width):
            fx, fy = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            hole[i, j] = True
            if not (fx >= -0.5 and fy >= -0.5 and fx <= width - 0.5 and fy <= height - 0.5):
                continue
            # None is below 0, where whole numbers are cut off otherwise than down.
            x = min(int(fx + np.float32(0.5)), width - 1)
            y = min(int(fy + np.float32(0.5)), height - 1)
            sky = is_background(depths[0], i, j)
            if sky != is_background(depths[1], y, x):
                continue
            if sky:
                hole[i, j] = False
                continue
            now, then = (stencils[0][i, j], stencils[1][y, x]) if known_ids else (0, 0)
            if now >= 0 and then >= 0 and now != then:
                continue
            cosine = least_cosine if now > 0 else np.float32(-2)
            if other_surface(i, j, y, x, positions, normals, cosine, rounded):
                continue
            if not known_positions and now <= 0:
                a, b = depths[0][i, j], depths[1][y, x]
                if not same_depth(a, b, DEPTH_TOLERANCE, (linear, inverse)):
                    continue
            hole[i, j] = False
