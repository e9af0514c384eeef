"""The passes over all points of fitting a camera: its equations, how far it misses, who counts.

Their sums are left to BLAS, whose order of additions no loop here would keep. In numpy the same
passes took four times as long, most of it between them.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import compiled

F64 = npt.NDArray[np.float64]
B8 = npt.NDArray[np.bool_]


@compiled
def write_equations(points: F64, pixels: F64, weights: F64, scaled: F64, rows: F64) -> int:
    """Write the weighted equations of the direct linear transform; return of how many points.

    Parameters
    ----------
    points
        float64 [N, 4], homogeneous.
    pixels
        float64 [N, 2].
    weights
        float64 [N]: points without a weight above 0 are left out.
    scaled
        float64 [4 N], the first M points written: the others times their weight.
    rows
        float64 [24 N], 2 M rows of 12 written: those of x, then those of y. Flat, as of a length of
        rows that is known here: else it took twice as long.
    """
    count = 0
    for n in range(len(weights)):
        if weights[n] > 0:
            for c in range(4):
                scaled[4 * count + c] = points[n, c] * weights[n]
            count += 1
    at = 0
    for n in range(len(weights)):
        if weights[n] > 0:
            right, down, first = 12 * at, 12 * (count + at), 4 * at
            for c in range(4):
                value = scaled[first + c]
                rows[right + c], rows[right + 4 + c] = value, 0.0
                rows[right + 8 + c] = -pixels[n, 0] * value
                rows[down + c], rows[down + 4 + c] = 0.0, value
                rows[down + 8 + c] = -pixels[n, 1] * value
            at += 1
    return count


@compiled
def write_errors(image: F64, pixels: F64, errors: F64) -> None:
    """Write how far points are projected from where they are seen.

    Parameters
    ----------
    image
        float64 [N, 3], homogeneous; behind the camera where the last is not above 0.
    pixels
        float64 [N, 2].
    errors
        float64 [N], written, in pixels: +inf behind the camera and where it is not finite.
    """
    for n in range(len(errors)):
        errors[n] = np.inf
        if image[n, 2] > 0:
            dx = image[n, 0] / image[n, 2] - pixels[n, 0]
            dy = image[n, 1] / image[n, 2] - pixels[n, 1]
            away = math.sqrt(dx * dx + dy * dy)
            errors[n] = away if away < np.inf else np.inf


@compiled
def mark_inliers(errors: F64, limit: float, inliers: B8) -> tuple[int, bool]:
    """Mark errors up to a limit; return how many there are, and whether the same were before."""
    count, same = 0, True
    for n in range(len(errors)):
        inside = errors[n] <= limit
        same &= inside == inliers[n]
        inliers[n] = inside
        count += inside
    return count, same


@compiled
def write_weights(errors: F64, inliers: B8, depths: F64, unit: float, weights: F64) -> None:
    """Write the weights of the next round.

    Parameters
    ----------
    errors, inliers
        float64 and bool [N].
    depths
        float64 [N]: third homogeneous coordinates; divided by them, an algebraic error is one of
        pixels.
    unit
        Of the errors, in which Geman and McClure's weights doubt them.
    weights
        float64 [N], written; 0 for outliers.
    """
    for n in range(len(weights)):
        weights[n] = 0.0
        if inliers[n]:
            ratio = errors[n] / unit
            scale = np.maximum(abs(depths[n]), 1e-9)
            weights[n] = 1.0 / (scale * (1.0 + ratio * ratio))
