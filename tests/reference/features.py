"""Naive twins of the features: plain loops and sorted lists, straight from the definitions."""

from __future__ import annotations

import numpy as np


def block_means(motion: np.ndarray, size: int, shown: np.ndarray | None = None) -> np.ndarray:
    """Mean motion of each block, float64 [rows, columns, 2]; NaN without any."""
    height, width = motion.shape[:2]
    rows = []
    for top in range(0, height, size):
        row = []
        for left in range(0, width, size):
            part = (slice(top, top + size), slice(left, left + size))
            vectors = motion[part].reshape(-1, 2).astype(np.float64)
            usable = np.isfinite(vectors).all(axis=1)
            if shown is not None:
                usable &= shown[part].ravel()
            row.append(vectors[usable].mean(axis=0) if usable.any() else np.full(2, np.nan))
        rows.append(row)
    return np.array(rows)


def distance(before: np.ndarray, after: np.ndarray, bins: int = 256) -> float:
    """Earth mover's distance of two lists of numbers over histograms of `bins` bins."""
    first, second = (
        np.asarray(values, np.float64)[np.isfinite(values)] for values in (before, after)
    )
    if not (len(first) and len(second)):
        return 0.0
    both = np.concatenate([first, second])
    if both.min() == both.max():
        return 0.0
    work, carried = 0.0, 0.0
    ends = (both.min(), both.max())
    shares = [np.histogram(values, bins, range=ends)[0] / len(values) for values in (first, second)]
    for k in range(bins):
        carried += shares[0][k] - shares[1][k]
        work += abs(carried) * (ends[1] - ends[0]) / bins
    return work


def components(stencil: np.ndarray) -> list[set[tuple[int, int]]]:
    """Connected pixels of one id above 0, by flooding from each pixel in raster order."""
    left = {(i, j) for i, j in np.ndindex(*stencil.shape) if stencil[i, j] > 0}
    found = []
    for start in sorted(left):
        if start not in left:
            continue
        left.remove(start)
        component, edge = {start}, [start]
        while edge:
            i, j = edge.pop()
            for near in np.ndindex(3, 3):
                other = (i + near[0] - 1, j + near[1] - 1)
                if other in left and stencil[other] == stencil[start]:
                    left.remove(other)
                    component.add(other)
                    edge.append(other)
        found.append(component)
    return found


def features(
    now: dict[str, np.ndarray], before: dict[str, np.ndarray], span: int
) -> tuple[float, ...]:
    """N_d, EMD_Wn, EMD_Wp, Var_x, Var_y and R of instants that have everything."""
    height, width = now["depth"].shape
    least = max(4, height * width / 10000)
    objects = sum(len(component) >= least for component in components(now["stencil"]))
    moved = []
    for name in ("normal", "position"):
        sides = [
            [one[name][..., c][np.isfinite(one["depth"])] for c in range(3)]
            for one in (before, now)
        ]
        moved.append(np.mean([distance(a, b) for a, b in zip(*sides, strict=True)]) / span)
    means = block_means(now["to_previous"], 16, np.isfinite(now["depth"])).reshape(-1, 2)
    spread = means[~np.isnan(means[:, 0])]
    variances = ((spread - spread.mean(axis=0)) ** 2).mean(axis=0) / span**2
    return (objects, *moved, *variances, height * width)
