"""Naive twins of the splatting kernels: every source pixel is tried on every target pixel."""

from __future__ import annotations

import numpy as np

F = np.float32


def slopes(line: np.ndarray, limit: float) -> np.ndarray:
    """Change per pixel along the last axis, from neighbours that differ by less than `limit`."""
    out = np.zeros_like(line)
    count = line.shape[-1]
    for index in np.ndindex(line.shape):
        j = index[-1]
        steps = [
            line[(*index[:-1], k + 1)] - line[(*index[:-1], k)]
            for k in (j - 1, j)
            if 0 <= k < count - 1
        ]
        steps = [step for step in steps if abs(step) < limit]
        if steps:
            out[index] = F(0.5) * (steps[0] + steps[1]) if len(steps) == 2 else steps[0]
    return out


def splat(
    displacement: np.ndarray, depth: np.ndarray, limit: float, overlap: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the field [H, W, 2] and the depth [H, W] of what lands, NaN where nothing does.

    `limit` is the largest slope on one surface, `overlap` half the side of a patch.
    """
    height, width, _ = displacement.shape
    across = [slopes(displacement[..., c], limit) for c in range(2)]
    down = [slopes(displacement[..., c].T, limit).T for c in range(2)]
    rows, columns = (grid.astype(F) for grid in np.mgrid[0:height, 0:width])
    field = np.full((height, width, 2), np.nan, F)
    near = np.full((height, width), np.nan, F)
    for i in range(height):
        for j in range(width):
            a, b = F(1) + across[0][i, j], down[0][i, j]
            c, d = across[1][i, j], F(1) + down[1][i, j]
            determinant = a * d - b * c
            if not determinant > F(0.05):
                continue
            rx = columns - (F(j) + displacement[i, j, 0])
            ry = rows - (F(i) + displacement[i, j, 1])
            u, v = (d * rx - b * ry) / determinant, (a * ry - c * rx) / determinant
            lands = (abs(u) <= F(overlap)) & (abs(v) <= F(overlap))
            lands &= np.isnan(near) | (depth[i, j] < near)
            near[lands] = depth[i, j]
            field[lands, 0] = (F(j) + u - columns)[lands]
            field[lands, 1] = (F(i) + v - rows)[lands]
    return field, near


def row_span(displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest row that each row's pixel centres land on, [H]."""
    y = np.arange(len(displacement), dtype=F)[:, None] + displacement[..., 1]
    low = np.array([np.min(line[~np.isnan(line)], initial=np.inf) for line in y])
    high = np.array([np.max(line[~np.isnan(line)], initial=-np.inf) for line in y])
    return low, high
