"""Looking scattered points up in an image, all at once."""

from __future__ import annotations

import numpy as np


def look_up(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Sample an image [H, W, C] at (x, y) positions [N, 2]; NaN outside it."""
    height, width = image.shape[:2]
    with np.errstate(invalid="ignore"):
        corner = np.floor(target)
        inside = ((target >= 0) & (target <= (width - 1, height - 1))).all(axis=1)
        x = np.where(inside, corner[:, 0], 0).astype(np.intp)
        y = np.where(inside, corner[:, 1], 0).astype(np.intp)
        x1, y1 = np.minimum(x + 1, width - 1), np.minimum(y + 1, height - 1)
        fx, fy = (target - corner)[:, :1], (target - corner)[:, 1:]
        upper = image[y, x] * (1 - fx) + image[y, x1] * fx
        lower = image[y1, x] * (1 - fx) + image[y1, x1] * fx
        found = np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float64)
    found[~inside] = np.nan
    return found


def misses(found: np.ndarray, wanted: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    """Return the distance in tolerances, [N]; 1 where it is greater or not known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(found - wanted, axis=1) / tolerance
    return np.where(np.isfinite(distance), np.minimum(distance, 1.0), 1.0)
