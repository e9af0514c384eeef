"""What a depth channel holds, and how it is turned into a distance from the camera.

Renderers write the distance along the camera's axis or along the ray, its inverse, or either of
them squeezed into 0 … 1, with near or far at 1. World positions of the same frame tell which: they
fix the camera, by the direct linear transformation (Hartley and Zisserman, Multiple View Geometry,
2nd edition, algorithm 7.1), and the camera each pixel's distance. Else the channel's name counts,
and what that leaves open is taken for a distance.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32

F64 = npt.NDArray[np.float64]

FAR = 1e9  # depth from which on a pixel counts as background: Blender writes 1e10 there

# Pixels that a camera is fitted to, and below which nothing is concluded.
SAMPLES, LEAST = 3000, 200

# Largest relative error of distances, in the median, of a kind that explains the values.
MAX_ERROR = 0.01

MAX_REPROJECTION = 1.0  # pixels by which positions may miss their own pixel, in the median

# Pixels, at their distance, by which positions in the median differ if the camera moved.
MIN_CHANGE = 2.0

# Share of the largest singular value below which positions, all in a plane, do not fix a camera.
FLAT = 1e-4


class DepthKind(Enum):
    """What a depth channel's values are."""

    AXIS = "axis"
    RAY = "ray"
    NEGATIVE = "negative"
    INVERSE = "inverse"
    NORMALISED = "normalised"
    REVERSED = "reversed"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class DepthReading:
    """How distances are read from a depth channel.

    Values d at distance z are ``offset + scale / z`` for the inverse (a graphics card's depth has a
    scale below 0, and 1 for background), ``offset + scale z`` for normalised and reversed ones. The
    other kinds do not use offset and scale.
    """

    kind: DepthKind = DepthKind.UNKNOWN
    offset: float = 0.0
    scale: float = 1.0
    measured: bool = False  # True if world positions showed this, rather than a name or a person
    # What a user should know of how it is read, or why it is left out; "" for nothing.
    evidence: str = field(default="", compare=False)

    def distance(self, depth: Float32) -> Float32:
        """Turn values, float32 [...], into distances that grow away from the camera.

        The same array if values are distances already, along the axis or the ray. Else float32
        [...], with +inf where a value stands for background: 0 of an inverse, the far end of a
        normalised range, what is not below 0 of negative distances.
        """
        if self.kind in (DepthKind.AXIS, DepthKind.RAY, DepthKind.UNKNOWN):
            return depth
        if self.kind is DepthKind.NEGATIVE:
            return np.where(depth < 0, -depth, np.float32(np.inf)).astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.kind is DepthKind.INVERSE:
                distance = self.scale / (depth - np.float64(self.offset))
                is_background = depth >= 1 if self.scale < 0 else depth <= 0
            else:
                distance = (depth - np.float64(self.offset)) / self.scale
                is_background = depth >= 1 if self.kind is DepthKind.NORMALISED else depth <= 0
            distance = np.where(is_background, np.inf, distance)
            return np.where(distance > 0, distance, np.inf).astype(np.float32)


# How values of a kind are read where nothing else is known: by their order.
DEFAULT_READINGS = {kind: DepthReading(kind) for kind in DepthKind}
DEFAULT_READINGS[DepthKind.REVERSED] = DepthReading(DepthKind.REVERSED, offset=1.0, scale=-1.0)


def depth_reading_by_name(channels: Iterable[str]) -> DepthReading:
    """Return the reading that the names of depth channels, with their layers, suggest."""
    for name in channels:
        if re.search(r"disparity|(^|[._\s])inv(erse)?[._\s]?(depth|z)|depth[._\s]?inv", name, re.I):
            return DepthReading(DepthKind.INVERSE)
        if re.search(r"(^|[._:])(hitPz|SceneDepth|WorldDepth)", name, re.I):
            return DepthReading(DepthKind.AXIS)
    return DepthReading()


def measure_depth_reading(depth: Float32, position: Float32) -> DepthReading | None:
    """Find out what depth values are from the world positions of the same pixels.

    `depth` is float32 [H, W] as written, `position` float32 [H, W, 3], world space, scene units; 0
    or non-finite on background. None if positions do not tell: too few, all in a plane, or no
    camera explains them.
    """
    y, x = _sample_surfaces(depth, position)
    if len(y) < LEAST:
        return None
    points, values = position[y, x].astype(np.float64), depth[y, x].astype(np.float64)
    distances = _fit_camera(points, np.stack([x, y], axis=1).astype(np.float64))
    if distances is None or np.count_nonzero(distances[2]) < LEAST:
        return None
    # At points of these distances along the axis and the ray.
    values, axis, ray = (array[distances[2]] for array in (values, *distances[:2]))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along_axis = _median_error(values / np.median(values / axis), axis)
        if np.median(values) < 0 and along_axis < MAX_ERROR:
            return DepthReading(DepthKind.NEGATIVE, measured=True)
        along_ray = _median_error(values / np.median(values / ray), ray)
        if min(along_axis, along_ray) < MAX_ERROR and np.median(values) > 0:
            # In a narrow view both fit; then the axis' is by far the more usual.
            is_ray = along_ray < 0.5 * along_axis
            return DepthReading(DepthKind.RAY if is_ray else DepthKind.AXIS, measured=True)
        offset, scale = _fit_line(1 / axis, values)
        if _median_error(scale / (values - offset), axis) < MAX_ERROR:
            return DepthReading(DepthKind.INVERSE, offset, scale, True)
        offset, scale = _fit_line(axis, values)
        if _median_error((values - offset) / scale, axis) < MAX_ERROR:
            kind = DepthKind.NORMALISED if scale > 0 else DepthKind.REVERSED
            return DepthReading(kind, offset, scale, True)
        ranks = [np.argsort(np.argsort(array)).astype(np.float64) for array in (values, axis)]
        if np.corrcoef(ranks[0], ranks[1])[0, 1] < -0.9 and (values > 0).all():
            return DepthReading(DepthKind.INVERSE, measured=True)  # in the right order, at least
    return None


def is_relative_to_camera(first: Float32, other: Float32) -> bool:
    """Return True if positions are relative to the camera that sees them, and not to the world.

    `first` and `other` are float32 [H, W, 3] of two frames; 0 or non-finite on background. Relative
    to the camera, x / z and y / z lead to a pixel's column and row, by the same factors and offsets
    in every frame. In the world they do so only for a camera at the origin while nothing moves.

    False also for a camera that stands: then positions relative to it are as good as any.
    """
    # A camera at the origin that looks along z: offset and factor of columns and of rows.
    camera: list[tuple[float, float]] = []
    for position in (first, other):
        row, column = _sample_surfaces(np.ones(position.shape[:2], np.float32), position)
        point = position[row, column].astype(np.float64)
        is_off_plane = point[:, 2] != 0
        x, y, z = point[is_off_plane].T
        pixels = np.stack([column, row])[:, is_off_plane].astype(np.float64)
        slopes = x / z, y / z
        if not camera:
            # Over a wall alone the same holds in the world.
            if len(z) < LEAST or np.ptp(np.percentile(z, (10, 90))) < 0.05 * np.median(abs(z)):
                return False
            camera = [_fit_line(*line) for line in zip(slopes, pixels, strict=True)]
        for (offset, factor), slope, pixel in zip(camera, slopes, pixels, strict=True):
            error = np.abs(pixel - offset - factor * slope)
            if not len(slope) or np.median(error) > MAX_REPROJECTION:
                return False
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        change = np.linalg.norm(other - first, axis=-1) / np.linalg.norm(first, axis=-1)
    change = change[np.isfinite(change)]
    focal = max(abs(factor) for _, factor in camera)
    return len(change) >= LEAST and float(np.median(change)) * focal > MIN_CHANGE


def _sample_surfaces(depth: Float32, position: Float32) -> tuple[npt.NDArray[np.intp], ...]:
    """Return rows and columns of about `SAMPLES` pixels that show a surface."""
    with np.errstate(invalid="ignore"):
        is_surface = np.isfinite(depth) & (np.abs(depth) < FAR)
    is_surface &= np.isfinite(position).all(axis=-1) & (position != 0).any(axis=-1)
    indices = np.flatnonzero(is_surface)
    indices = indices[:: max(1, len(indices) // SAMPLES)]
    return np.unravel_index(indices, depth.shape)


def _fit_camera(points: F64, pixels: F64) -> tuple[F64, F64, npt.NDArray[np.bool_]] | None:
    """Fit a pinhole camera to points [N, 3] seen at pixels [N, 2].

    Returns each point's distance along the axis and along the ray, and which points are inliers: at
    silhouettes a pixel's position is a mixture.
    """
    middle, spread = points.mean(axis=0), points.std() + 1e-30
    local = np.concatenate([(points - middle) / spread, np.ones((len(points), 1))], axis=1)
    centre, extent = pixels.mean(axis=0), pixels.std()
    target = (pixels - centre) / extent
    weight = np.ones(len(points))
    for _ in range(6):
        rows = np.concatenate(
            [
                np.concatenate([local, 0 * local, -target[:, :1] * local], axis=1),
                np.concatenate([0 * local, local, -target[:, 1:] * local], axis=1),
            ]
        )
        rows *= np.tile(weight, 2)[:, None]
        # Squared, they are twelve by twelve: the smallest eigenvector is the camera.
        eigenvalues, vectors = np.linalg.eigh(rows.T @ rows)
        matrix = vectors[:, 0].reshape(3, 4)
        image = local @ matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.linalg.norm(image[:, :2] / image[:, 2:] - target, axis=1) * extent
        error = np.where(np.isfinite(error), error, np.inf)
        # Algebraic rows weigh near points less; dividing by the depth makes them pixels.
        weight = 1 / (np.maximum(np.abs(image[:, 2]), 1e-12) * (1 + error**2))
        weight /= max(weight.max(), 1e-300)
    if eigenvalues[1] < FLAT**2 * eigenvalues[-1] or np.median(error) > MAX_REPROJECTION:
        return None
    # Least squares, as an orthographic camera has no eye; then no kind fits what follows.
    eye = -np.linalg.lstsq(matrix[:, :3], matrix[:, 3], rcond=None)[0]
    axis = image[:, 2] / np.linalg.norm(matrix[2, :3]) * spread
    if np.median(axis) < 0:
        axis = -axis
    ray = np.linalg.norm(local[:, :3] - eye, axis=1) * spread
    return axis, ray, (error < 2 * MAX_REPROJECTION) & (axis > 0)


def _median_error(distance: F64, truth: F64) -> float:
    error = np.abs(distance / truth - 1)
    return float(np.median(np.where(np.isfinite(error), error, np.inf)))


def _fit_line(x: F64, y: F64) -> tuple[float, float]:
    """Fit y = a + b x, robustly."""
    weight = np.ones_like(x)
    a = b = 0.0
    terms = np.stack([np.ones_like(x), x], axis=1)
    for _ in range(10):
        a, b = np.linalg.lstsq(terms * weight[:, None], y * weight, rcond=None)[0]
        error = np.abs(y - a - b * x)
        weight = 1 / (np.median(error) + 1e-12 * np.abs(y).max() + error)
    return float(a), float(b)
