"""Resection: the camera that sees points of known position at known pixels.

A linear fit, the direct linear transform, on normalised coordinates, made robust round by round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels import projection

F64 = npt.NDArray[np.float64]

MIN_SAMPLES = 60
ROUNDS = 12
SUBSETS, SUBSET_SIZE, JUDGES = 200, 6, 500
"""How many cameras are tried, through how many points, and how many points judge them: with two
fifths of the points moving, 200 samples of six miss the right one once in ten thousand."""

LEAST_LIMIT = 1e-3
"""Error that never makes an outlier of a point, in units of the spread of the pixels."""

MAX_MEDIAN_ERROR = 0.25
"""A fit whose median error on its inliers is above this, in pixels, is no camera."""

INLIER_FLOOR = 0.02
"""Pixels below which an error is never an outlier: the rounding of half-float passes."""

DEGENERATE = 1e-5
"""Ratio of singular values below which points do not determine a camera: all on one plane."""


@dataclass(frozen=True)
class Camera:
    """A 3x4 projection from homogeneous scene points to pixels (+x right, +y down).

    Attributes
    ----------
    matrix
        float64 [3, 4].
    median_error
        Median distance on the fit's inliers, pixels.
    """

    matrix: F64
    median_error: float

    def project(self, points: F64) -> F64:
        """Project points [..., 4] to pixels [..., 2]; NaN for what lies behind the camera."""
        image = points @ self.matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels: F64 = image[..., :2] / image[..., 2:]
        pixels[image[..., 2] <= 0] = np.nan
        return pixels


def fit(points: F64, pixels: F64, movers: bool = False) -> Camera | None:
    """Fit a projection to points and the pixels that they are seen at, most of them rightly.

    Parameters
    ----------
    points
        float64 [N, 4], homogeneous.
    pixels
        float64 [N, 2].
    movers
        Whether points may be among them that move alike and differently from the rest; then the
        fit starts from the least median of small samples, which bears nearly half of them.

    Returns
    -------
    Camera or None
        None when there are too few points, when they do not determine a camera (all on one plane),
        or when no camera explains half of them.

    Notes
    -----
    Direct linear transform on normalised coordinates, reweighted to pixel error and by Geman and
    McClure's weights, with points beyond four median errors left out round by round, until the same
    points stay.
    """
    usable = np.isfinite(points).all(axis=1) & np.isfinite(pixels).all(axis=1)
    points, pixels = points[usable], pixels[usable]
    if len(points) < MIN_SAMPLES:
        return None
    to_unit, unit_points = _normalise(points)
    from_unit, unit_pixels = _normalise_pixels(pixels)
    system = _System(unit_points, unit_pixels)
    weights = np.ones(len(points))
    if movers:
        weights = _least_median(unit_points, unit_pixels)
    errors, inliers = np.empty(len(points)), np.ones(len(points), np.bool_)
    for count in range(ROUNDS):
        unit = system.solve(weights)
        if unit is None:
            return None
        matrix = from_unit @ unit @ to_unit
        projection.write_projection_errors(points @ matrix.T, pixels, errors)
        middle = _median(errors)
        limit = max(4.0 * middle, INLIER_FLOOR)
        inside, same = projection.mark_inliers(errors, limit, inliers)
        if inside < MIN_SAMPLES or not math.isfinite(middle):
            return None
        if count and same:
            break
        # Without this doubt an object on a sixth of the points drags the camera with it: it pulls
        # the first fit so far that it stays within four median errors.
        depths = unit_points @ unit[2]
        projection.write_inlier_weights(errors, inliers, depths, max(middle, INLIER_FLOOR), weights)
    camera = Camera(matrix, _median(errors[inliers]))
    return camera if camera.median_error <= MAX_MEDIAN_ERROR else None


def _median(values: F64) -> float:
    """Return the median of values that are no NaN, as numpy does, which asks for those as well."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float((low + high) / 2)


def _normalise(points: F64) -> tuple[F64, F64]:
    """Return a 4x4 transform and the points under it: finite ones centred, of unit spread."""
    finite = points[:, :3] / points[:, 3:]
    centre = np.array([_median(column) for column in np.ascontiguousarray(finite.T)])
    spread = _median(np.abs(finite - centre).ravel()) or 1.0
    transform = np.eye(4)
    transform[:3, 3] = -centre
    transform[:3] /= spread
    moved = points @ transform.T
    return transform, moved / moved[:, 3:]


def _normalise_pixels(pixels: F64) -> tuple[F64, F64]:
    """Return the 3x3 transform back to pixels, and the pixels centred and of unit spread."""
    centre = pixels.mean(axis=0)
    spread = float(pixels.std()) or 1.0
    back = np.diag([spread, spread, 1.0])
    back[:2, 2] = centre
    return back, (pixels - centre) / spread


def _least_median(points: F64, pixels: F64) -> F64:
    """Return weights 1 for points near the best of many cameras through six points each, else 0.

    Rousseeuw, Least Median of Squares Regression, 1984; the samples are always the same ones.
    """
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(points), (SUBSETS, SUBSET_SIZE))
    rows = _rows(points[chosen], pixels[chosen]).reshape(SUBSETS, -1, 12)
    _, directions = np.linalg.eigh(rows.transpose(0, 2, 1) @ rows)
    matrices = directions[..., 0].reshape(SUBSETS, 3, 4)
    judges = slice(None, None, max(1, len(points) // JUDGES))

    def errors(matrix: F64, where: slice) -> F64:
        image = points[where] @ matrix.swapaxes(-1, -2)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = np.linalg.norm(image[..., :2] / image[..., 2:] - pixels[where], axis=-1)
        return np.asarray(np.where(np.isfinite(away), away, np.inf))

    medians = np.median(errors(matrices, judges), axis=-1)
    best = int(np.argmin(medians))
    # In units of the spread of the pixels: as an outlier counts what is far off for this camera.
    limit = max(4.0 * float(medians[best]), LEAST_LIMIT)
    return (errors(matrices[best], slice(None)) <= limit).astype(np.float64)


def _rows(points: F64, pixels: F64) -> F64:
    """Return the equations of the direct linear transform: [..., N, 4] to [..., 2, N, 12]."""
    x, y = pixels[..., :1], pixels[..., 1:]
    rows = np.zeros((*points.shape[:-2], 2, points.shape[-2], 12))
    rows[..., 0, :, :4], rows[..., 0, :, 8:] = points, -x * points
    rows[..., 1, :, 4:8], rows[..., 1, :, 8:] = points, -y * points
    return rows


class _System:
    """The equations of all points, float64 [N, 4] seen at pixels [N, 2], with room for them."""

    def __init__(self, points: F64, pixels: F64) -> None:
        self._points, self._pixels = points, pixels
        self._scaled, self._rows = np.empty(4 * len(points)), np.empty(24 * len(points))

    def solve(self, weights: F64) -> F64 | None:
        """Return the 3x4 matrix of least algebraic error, None when it is not determined."""
        used = projection.write_equations(
            self._points, self._pixels, weights, self._scaled, self._rows
        )
        if used < MIN_SAMPLES:
            return None
        scaled = self._scaled[: 4 * used].reshape(used, 4)
        rows = self._rows[: 24 * used].reshape(2 * used, 12)
        squares, directions = np.linalg.eigh(rows.T @ rows)
        if squares[1] < DEGENERATE**2 * squares[-1]:
            return None
        matrix = directions[:, 0].reshape(3, 4)
        oriented: F64 = matrix * (1.0 if _mostly_positive(scaled @ matrix[2]) else -1.0)
        return oriented


def _mostly_positive(values: F64) -> bool:
    """Whether the median is above 0: mostly decided by counting alone."""
    above = int(np.count_nonzero(values > 0))
    if 2 * above in (len(values) - 1, len(values), len(values) + 1):
        return bool(np.median(values) > 0)
    return 2 * above > len(values)
