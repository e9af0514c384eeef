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

FAR = 1e9
"""Depth from which on a pixel counts as background."""

SAMPLES, LEAST = 3000, 200
"""Pixels that a camera is fitted to, and below which nothing is said."""

FITS = 0.01
"""Relative error of distances, in the median, up to which a kind explains the values."""

REPROJECTED = 1.0
"""Pixels by which positions may miss their own pixel, in the median."""

CHANGED = 2.0
"""Pixels, at their distance, by which positions in the median differ if the camera moved."""

FLAT = 1e-4
"""Share of the largest singular value below which positions do not fix a camera: all in a plane."""


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

    Attributes
    ----------
    kind
        What the values are.
    offset, scale
        Of the values d at distance z: ``d = offset + scale / z`` for the inverse (a graphics
        card's depth has a scale below 0, and 1 for background), ``d = offset + scale z`` for
        normalised and reversed ones. Not used for the others.
    measured
        Whether world positions showed this, rather than a name or a person.
    evidence
        What a user should know of how it is read, or why it is left out; "" for nothing.
    """

    kind: DepthKind = DepthKind.UNKNOWN
    offset: float = 0.0
    scale: float = 1.0
    measured: bool = False
    evidence: str = field(default="", compare=False)

    @classmethod
    def of(cls, kind: DepthKind) -> DepthReading:
        """Return how values of a kind are read where nothing else is known: by their order."""
        offset, scale = (1.0, -1.0) if kind is DepthKind.REVERSED else (0.0, 1.0)
        return cls(kind, offset, scale)

    def distance(self, depth: Float32) -> Float32:
        """Turn values into distances that grow away from the camera.

        Parameters
        ----------
        depth
            float32 [...], as written; not changed.

        Returns
        -------
        Float32
            The same array where values are distances already, along the axis or the ray. Else
            float32 [...], with +inf where the value stands for background: 0 of an inverse, the far
            end of a normalised range, what is not below 0 of negative distances.
        """
        if self.kind in (DepthKind.AXIS, DepthKind.RAY, DepthKind.UNKNOWN):
            return depth
        if self.kind is DepthKind.NEGATIVE:
            return np.where(depth < 0, -depth, np.float32(np.inf)).astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.kind is DepthKind.INVERSE:
                out = self.scale / (depth - np.float64(self.offset))
                out = np.where(depth >= 1 if self.scale < 0 else depth <= 0, np.inf, out)
            else:
                out = (depth - np.float64(self.offset)) / self.scale
                ends = depth >= 1 if self.kind is DepthKind.NORMALISED else depth <= 0
                out = np.where(ends, np.inf, out)
            return np.where(out > 0, out, np.inf).astype(np.float32)


def named(channels: Iterable[str]) -> DepthReading:
    """Return what the names of depth channels (with their layers) say."""
    for name in channels:
        if re.search(r"disparity|(^|[._\s])inv(erse)?[._\s]?(depth|z)|depth[._\s]?inv", name, re.I):
            return DepthReading.of(DepthKind.INVERSE)
        if re.search(r"(^|[._:])(hitPz|SceneDepth|WorldDepth)", name, re.I):
            return DepthReading.of(DepthKind.AXIS)
    return DepthReading()


def measured(depth: Float32, position: Float32) -> DepthReading | None:
    """Find out what depth values are from the world positions of the same pixels.

    Parameters
    ----------
    depth
        float32 [H, W] as written.
    position
        float32 [H, W, 3], world space, scene units; 0 or non-finite on background.

    Returns
    -------
    DepthReading or None
        None where positions do not tell: too few, all in a plane, or no camera explains them.
    """
    y, x = _surfaces(depth, position)
    if len(y) < LEAST:
        return None
    points, values = position[y, x].astype(np.float64), depth[y, x].astype(np.float64)
    found = _camera(points, np.stack([x, y], axis=1).astype(np.float64))
    if found is None:
        return None
    axis, ray, inside = found
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return _kind(values[inside], axis[inside], ray[inside])


def is_negative(depth: Float32) -> bool:
    """Return whether depth values are distances below 0, as along a camera's -z axis.

    Parameters
    ----------
    depth
        float32 [H, W] as written. Of what is finite and no background more must lie below 0 than
        above: filters that ring leave a few such pixels in any depth.
    """
    with np.errstate(invalid="ignore"):
        surface = depth[np.isfinite(depth) & (np.abs(depth) < FAR)]
    return int(np.count_nonzero(surface < 0)) > int(np.count_nonzero(surface > 0))


def relative_to_camera(first: Float32, other: Float32) -> bool:
    """Whether positions are relative to the camera that sees them, and not to the world.

    Then x / z and y / z lead to a pixel's column and row, by the same factors and offsets in every
    frame; in the world they do so for a camera at the origin alone, and while nothing moves.

    Parameters
    ----------
    first, other
        float32 [H, W, 3] of two frames; 0 or non-finite on background.

    Returns
    -------
    bool
        False also for a camera that stands: then positions relative to it are as good as any.
    """
    camera = _lens(first)
    if camera is None or not _seen_by(camera, other):
        return False
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        change = np.linalg.norm(other - first, axis=-1) / np.linalg.norm(first, axis=-1)
    change = change[np.isfinite(change)]
    focal = max(abs(factor) for _, factor in camera)
    return len(change) >= LEAST and float(np.median(change)) * focal > CHANGED


def _lens(position: Float32) -> tuple[tuple[float, float], ...] | None:
    """Fit a camera at the origin that looks along z: offset and factor of columns and of rows."""
    slopes, pixels, z = _slopes(position)
    # Over a wall alone the same holds in the world.
    if len(z) < LEAST or np.ptp(np.percentile(z, (10, 90))) < 0.05 * np.median(abs(z)):
        return None
    camera = tuple(_line(slope, pixel) for slope, pixel in zip(slopes, pixels, strict=True))
    return camera if _seen_by(camera, position) else None


def _seen_by(camera: tuple[tuple[float, float], ...], position: Float32) -> bool:
    """Whether positions lie where a camera of `_lens` sees them."""
    for (start, factor), slope, pixel in zip(camera, *_slopes(position)[:2], strict=True):
        if not len(slope) or np.median(np.abs(pixel - start - factor * slope)) > REPROJECTED:
            return False
    return True


def _slopes(position: Float32) -> tuple[F64, F64, F64]:
    """Return x / z and y / z, the columns and rows, [2, N] each, and z, of some surface pixels."""
    row, column = _surfaces(np.ones(position.shape[:2], np.float32), position)
    point = position[row, column].astype(np.float64)
    ahead = point[:, 2] != 0
    point, pixels = point[ahead], np.stack([column, row])[:, ahead].astype(np.float64)
    return (point[:, :2] / point[:, 2:]).T, pixels, point[:, 2]


def _surfaces(depth: Float32, position: Float32) -> tuple[npt.NDArray[np.intp], ...]:
    """Return rows and columns of some pixels that show a surface."""
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(depth) & (np.abs(depth) < FAR)
    usable &= np.isfinite(position).all(axis=-1) & (position != 0).any(axis=-1)
    chosen = np.flatnonzero(usable)
    chosen = chosen[:: max(1, len(chosen) // SAMPLES)]
    return np.unravel_index(chosen, depth.shape)


def _camera(points: F64, pixels: F64) -> tuple[F64, F64, npt.NDArray[np.bool_]] | None:
    """Fit a pinhole camera to points [N, 3] seen at pixels [N, 2].

    Returns each point's distance along the axis and along the ray, and which points agree with the
    camera: at silhouettes a pixel's position is a mixture.
    """
    middle, spread = points.mean(axis=0), points.std() + 1e-30
    local = np.concatenate([(points - middle) / spread, np.ones((len(points), 1))], axis=1)
    centre, reach = pixels.mean(axis=0), pixels.std()
    seen = (pixels - centre) / reach
    weight = np.ones(len(points))
    for _ in range(6):
        rows = np.concatenate(
            [
                np.concatenate([local, 0 * local, -seen[:, :1] * local], axis=1),
                np.concatenate([0 * local, local, -seen[:, 1:] * local], axis=1),
            ]
        )
        rows *= np.tile(weight, 2)[:, None]
        # Squared, they are twelve by twelve: the smallest eigenvector is the camera.
        size, vectors = np.linalg.eigh(rows.T @ rows)
        matrix = vectors[:, 0].reshape(3, 4)
        image = local @ matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            miss = np.linalg.norm(image[:, :2] / image[:, 2:] - seen, axis=1) * reach
        miss = np.where(np.isfinite(miss), miss, np.inf)
        # Algebraic rows weigh near points less; dividing by the depth makes them pixels.
        weight = 1 / (np.maximum(np.abs(image[:, 2]), 1e-12) * (1 + miss**2))
        weight /= max(weight.max(), 1e-300)
    inside = miss < 2 * REPROJECTED
    if size[1] < FLAT**2 * size[-1] or np.median(miss) > REPROJECTED:
        return None
    # Least squares, as an orthographic camera has no eye; then no kind fits what follows.
    eye = -np.linalg.lstsq(matrix[:, :3], matrix[:, 3], rcond=None)[0]
    axis = image[:, 2] / np.linalg.norm(matrix[2, :3]) * spread
    if np.median(axis) < 0:
        axis = -axis
    ray = np.linalg.norm(local[:, :3] - eye, axis=1) * spread
    return axis, ray, inside & (axis > 0)


def _kind(values: F64, axis: F64, ray: F64) -> DepthReading | None:
    """Return what values at known distances are."""
    if len(values) < LEAST:
        return None
    if np.median(values) < 0 and _apart(values / np.median(values / axis), axis) < FITS:
        return DepthReading(DepthKind.NEGATIVE, measured=True)
    along = {kind: _apart(values / np.median(values / z), z)
             for kind, z in ((DepthKind.AXIS, axis), (DepthKind.RAY, ray))}  # fmt: skip
    if min(along.values()) < FITS and np.median(values) > 0:
        # In a narrow view both fit; then the axis' is by far the more usual.
        slanted = along[DepthKind.RAY] < 0.5 * along[DepthKind.AXIS]
        return DepthReading(DepthKind.RAY if slanted else DepthKind.AXIS, measured=True)
    offset, scale = _line(1 / axis, values)
    inverse = _apart(scale / (values - offset), axis)
    start, slope = _line(axis, values)
    if inverse < FITS:
        return DepthReading(DepthKind.INVERSE, offset, scale, True)
    if _apart((values - start) / slope, axis) < FITS:
        kind = DepthKind.NORMALISED if slope > 0 else DepthKind.REVERSED
        return DepthReading(kind, start, slope, True)
    if np.corrcoef(_ranks(values), _ranks(axis))[0, 1] < -0.9 and (values > 0).all():
        return DepthReading(DepthKind.INVERSE, measured=True)  # in the right order, at least
    return None


def _apart(distance: F64, truth: F64) -> float:
    """Return the relative error in the median."""
    found = np.abs(distance / truth - 1)
    return float(np.median(np.where(np.isfinite(found), found, np.inf)))


def _line(x: F64, y: F64) -> tuple[float, float]:
    """Fit y = a + b x, robustly."""
    weight = np.ones_like(x)
    a = b = 0.0
    terms = np.stack([np.ones_like(x), x], axis=1)
    for _ in range(10):
        a, b = np.linalg.lstsq(terms * weight[:, None], y * weight, rcond=None)[0]
        away = np.abs(y - a - b * x)
        weight = 1 / (np.median(away) + 1e-12 * np.abs(y).max() + away)
    return float(a), float(b)


def _ranks(values: F64) -> F64:
    return np.argsort(np.argsort(values)).astype(np.float64)
