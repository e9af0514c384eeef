"""Cameras, recovered from what the G-buffer shows.

EXR headers seldom hold a camera matrix, but points of known position that are seen at known pixels
determine the 3x4 projection by a linear fit (the direct linear transform). With world positions
the points are those; with only depth along the camera's axis, the frame's own camera serves as the
world: the point at pixel (x, y) and depth z is (x, y, 1, 1/z) up to scale. Either way the fit to
the neighbouring frame, through the renderer's vectors, gives that frame's camera, and with it the
motion of everything static and of the sky, whose rendered vectors are 0 even while the camera turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer

F64 = npt.NDArray[np.float64]

MAX_SAMPLES = 6000
MIN_SAMPLES = 60
ROUNDS = 12
MAX_MEDIAN_ERROR = 0.25
"""A fit whose median error on its inliers is above this, in pixels, is no camera."""

INLIER_FLOOR = 0.02
"""Pixels below which an error is never an outlier: the rounding of half-float passes."""


@dataclass(frozen=True)
class ScenePoints:
    """Homogeneous points of a frame, in whatever world is at hand.

    Attributes
    ----------
    points
        float64 [H, W, 4]; the last coordinate is 0 for background, which lies at infinity.
    valid
        bool [H, W]: the pixel shows a surface of known place.
    background
        bool [H, W]: the pixel shows none.
    """

    points: F64
    valid: Bool
    background: Bool


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


def pixel_grid(shape: tuple[int, int]) -> F64:
    """Pixel coordinates float64 [H, W, 2] as (x, y)."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
    return np.stack([x, y], axis=-1)


def scene_points(gbuffer: GBuffer) -> ScenePoints | None:
    """Return a frame's points, from world positions if they fit a camera, else from depth.

    None when neither is there.
    """
    if gbuffer.depth is None and gbuffer.position is None:
        return None
    background = background_of(gbuffer)
    grid = pixel_grid(background.shape)
    if gbuffer.position is not None:
        valid = ~background & np.isfinite(gbuffer.position).all(axis=-1)
        points = np.concatenate(
            [np.where(valid[..., None], gbuffer.position, 0), np.ones((*valid.shape, 1))], axis=-1
        ).astype(np.float64)
        own = fit(points[valid], grid[valid])
        if own is not None:
            directions = np.concatenate([grid, np.ones((*valid.shape, 1))], axis=-1)
            rays = directions @ np.linalg.inv(own.matrix[:, :3]).T
            points[background, :3] = rays[background]
            points[background, 3] = 0.0
            return ScenePoints(points, valid, background)
    if gbuffer.depth is None:
        return None
    valid = np.isfinite(gbuffer.depth) & (gbuffer.depth > 0)
    inverse = np.where(valid, 1.0 / np.where(valid, gbuffer.depth, 1.0), 0.0)
    points = np.concatenate(
        [grid, np.ones((*valid.shape, 1)), inverse[..., None].astype(np.float64)], axis=-1
    )
    return ScenePoints(points, valid, background)


def background_of(gbuffer: GBuffer) -> Bool:
    """bool [H, W]: pixels that show no surface."""
    if gbuffer.depth is not None:
        return np.asarray(np.isinf(gbuffer.depth))
    assert gbuffer.position is not None
    return np.asarray((gbuffer.position == 0).all(axis=-1))


def fit(points: F64, pixels: F64) -> Camera | None:
    """Fit a projection to points and the pixels that they are seen at, most of them rightly.

    Parameters
    ----------
    points
        float64 [N, 4], homogeneous.
    pixels
        float64 [N, 2].

    Returns
    -------
    Camera or None
        None when there are too few points, when they do not determine a camera (all on one plane),
        or when no camera explains half of them.

    Notes
    -----
    Direct linear transform on normalised coordinates, reweighted to pixel error, with points beyond
    four median errors left out round by round. Points are taken at a fixed stride, so the same
    input always gives the same camera.
    """
    usable = np.isfinite(points).all(axis=1) & np.isfinite(pixels).all(axis=1)
    points, pixels = points[usable], pixels[usable]
    stride = max(1, len(points) // MAX_SAMPLES)
    points, pixels = points[::stride], pixels[::stride]
    if len(points) < MIN_SAMPLES:
        return None
    to_unit, unit_points = _normalise(points)
    from_unit, unit_pixels = _normalise_pixels(pixels)
    weights = np.ones(len(points))
    camera = None
    for _ in range(ROUNDS):
        unit = _solve(unit_points, unit_pixels, weights)
        if unit is None:
            return None
        matrix = from_unit @ unit @ to_unit
        error = np.linalg.norm(Camera(matrix, 0).project(points) - pixels, axis=1)
        error[~np.isfinite(error)] = np.inf
        middle = float(np.median(error))
        inliers = error <= max(4.0 * middle, INLIER_FLOOR)
        scale = np.abs(unit_points @ unit[2])
        weights = np.where(inliers, 1.0 / np.maximum(scale, 1e-9), 0.0)
        camera = Camera(matrix, float(np.median(error[inliers])) if inliers.any() else np.inf)
        if inliers.sum() < MIN_SAMPLES:
            return None
    assert camera is not None
    return camera if camera.median_error <= MAX_MEDIAN_ERROR else None


def rigid_motion(
    scene: ScenePoints, vectors: Float32, stencil: npt.NDArray[np.int32] | None
) -> Float32 | None:
    """Return the motion that static points and the sky have, from the camera that `vectors` imply.

    Parameters
    ----------
    scene
        The frame's points.
    vectors
        float32 [H, W, 2], pixels, displacement to the other frame as rendered.
    stencil
        int32 [H, W], 0 static; None when unknown. Used to find points for the fit.

    Returns
    -------
    float32 [H, W, 2] or None
        NaN where unknown. None when no camera can be found.
    """
    grid = pixel_grid(scene.valid.shape)
    chosen = scene.valid & np.isfinite(vectors).all(axis=-1)
    if stencil is not None and (chosen & (stencil == 0)).sum() >= MIN_SAMPLES:
        chosen &= stencil == 0
    camera = fit(scene.points[chosen], (grid + vectors)[chosen])
    if camera is None:
        return None
    motion = (camera.project(scene.points) - grid).astype(np.float32)
    motion[~(scene.valid | scene.background)] = np.nan
    return motion


def _normalise(points: F64) -> tuple[F64, F64]:
    """Return a 4x4 transform and the points under it: finite ones centred, of unit spread."""
    finite = points[:, :3] / points[:, 3:]
    centre = np.median(finite, axis=0)
    spread = float(np.median(np.abs(finite - centre))) or 1.0
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


def _solve(points: F64, pixels: F64, weights: F64) -> F64 | None:
    """Return the 3x4 matrix of least algebraic error, None when it is not determined."""
    x, y = pixels[:, :1], pixels[:, 1:]
    zero = np.zeros_like(points)
    rows = (
        np.concatenate(
            [
                np.concatenate([points, zero, -x * points], axis=1),
                np.concatenate([zero, points, -y * points], axis=1),
            ]
        )
        * np.concatenate([weights, weights])[:, None]
    )
    used = rows[np.abs(rows).sum(axis=1) > 0]
    if len(used) < 2 * MIN_SAMPLES:
        return None
    _, values, directions = np.linalg.svd(np.linalg.qr(used, mode="r"))
    if values[-2] < 1e-5 * values[0]:
        return None
    matrix = directions[-1].reshape(3, 4)
    signs = points[weights > 0] @ matrix[2]
    oriented: F64 = matrix * (1.0 if np.median(signs) > 0 else -1.0)
    return oriented
