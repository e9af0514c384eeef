"""Cameras, recovered from what the G-buffer shows.

EXR headers seldom hold a camera matrix, but points of known position that are seen at known pixels
determine the 3x4 projection by a linear fit (the direct linear transform). With world positions
the points are those; with only depth along the camera's axis, the frame's own camera serves as the
world: the point at pixel (x, y) and depth z is (x, y, 1, 1/z) up to scale. Either way the fit to
the neighbouring frame, through the renderer's vectors, gives that frame's camera, and with it the
motion of everything static and of the sky, whose vectors are 0 even while the camera turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Float32, GBuffer, Int32
from exwarp_cli.kernels import project

F64 = npt.NDArray[np.float64]

MAX_SAMPLES = 4000
MIN_SAMPLES = 60
GRID = 5
"""How many pixels are looked at for each sample."""

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


@dataclass(frozen=True)
class Scene:
    """The points of a frame, in whatever world is at hand.

    Attributes
    ----------
    position
        float32 [H, W, 3], world space; [0, 0, 3] where depth places the points instead.
    depth
        float32 [H, W], +inf background.
    to_ray
        float64 [3, 3]: takes (x, y, 1) of a pixel to the direction of its ray in that world.
    camera
        The frame's own projection, from world positions; None where depth places the points.
    """

    position: Float32
    depth: Float32
    to_ray: F64
    camera: Camera | None = None

    def points(self, index: npt.NDArray[np.intp]) -> F64:
        """Homogeneous points float64 [N, 4] of pixels given by flat index."""
        if self.position.shape[0]:
            chosen = self.position.reshape(-1, 3)[index].astype(np.float64)
            return np.concatenate([chosen, np.ones((len(index), 1))], axis=1)
        inverse = 1.0 / self.depth.ravel()[index].astype(np.float64)
        grid = pixels_at(index, self.depth.shape[1])
        return np.column_stack([grid, np.ones(len(index)), inverse])


def pixels_at(index: npt.NDArray[np.intp], width: int) -> F64:
    """Pixel coordinates (x, y) float64 [N, 2] of flat indices."""
    y, x = np.divmod(index, width)
    return np.stack([x, y], axis=1).astype(np.float64)


def scene_of(gbuffer: GBuffer) -> Scene | None:
    """Return a frame's points: from world positions if they fit a camera, else from depth.

    None when neither is there.
    """
    depth = gbuffer.depth
    if gbuffer.position is not None:
        position = np.ascontiguousarray(gbuffer.position)
        if depth is None:
            depth = np.where(gbuffer.background, np.inf, 1.0).astype(np.float32)
        index = sample(depth)
        scene = Scene(position, depth, np.eye(3))
        own = fit(scene.points(index), pixels_at(index, depth.shape[1]))
        if own is not None:
            to_ray = np.asarray(np.linalg.inv(own.matrix[:, :3]), dtype=np.float64)
            return Scene(position, depth, to_ray, own)
    if gbuffer.depth is None:
        return None
    return Scene(np.zeros((0, 0, 3), np.float32), gbuffer.depth, np.eye(3))


def sample(depth: Float32, stencil: Int32 | None = None) -> npt.NDArray[np.intp]:
    """Return flat indices of about MAX_SAMPLES pixels that show surfaces, always the same ones.

    Static ones where ids are known and there are enough. A regular grid, some times finer than
    needed, is looked at, as looking at every pixel takes longer than the fit.
    """
    grid = np.arange(0, depth.size, max(1, depth.size // (GRID * MAX_SAMPLES)))
    index = grid[np.isfinite(depth.ravel()[grid])]
    if stencil is not None:
        static = index[stencil.ravel()[index] == 0]
        index = static if len(static) >= MIN_SAMPLES else index
    return index[:: max(1, len(index) // MAX_SAMPLES)]


def camera_after(scene: Scene, vectors: Float32, stencil: Int32 | None) -> Camera | None:
    """Return the camera of another instant, which the motion to it implies.

    Parameters
    ----------
    scene
        The frame's points.
    vectors
        float32 [H, W, 2], pixels, displacement to the other frame.
    stencil
        int32 [H, W], 0 static; None when unknown. Used to find points for the fit.

    Returns
    -------
    Camera or None
        In the scene's own world; None when none can be found.
    """
    index = sample(scene.depth, stencil)
    seen_at = pixels_at(index, scene.depth.shape[1]) + vectors.reshape(-1, 2)[index]
    return fit(scene.points(index), seen_at, movers=stencil is None)


def rigid_motion(scene: Scene, vectors: Float32, stencil: Int32 | None) -> Float32 | None:
    """Return the motion that static points and the sky have, by the camera of `camera_after`.

    Returns
    -------
    float32 [H, W, 2] or None
        NaN where unknown. None when no camera can be found.
    """
    camera = camera_after(scene, vectors, stencil)
    return None if camera is None else seen_by(scene, camera)


def seen_by(scene: Scene, camera: Camera) -> Float32:
    """Return the displacement of each pixel to another camera's frame, if its point stands still.

    Returns
    -------
    float32 [H, W, 2]
        Pixels; NaN for what lies behind the camera.
    """
    out = np.empty((*scene.depth.shape, 2), np.float32)
    at_infinity = camera.matrix[:, :3] @ scene.to_ray
    project.rigid(scene.position, scene.depth, camera.matrix, at_infinity, out)
    return out


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
    weights = np.ones(len(points))
    if movers:
        weights = _least_median(unit_points, unit_pixels)
    inliers = np.ones(len(points), np.bool_)
    camera = None
    for _ in range(ROUNDS):
        unit = _solve(unit_points, unit_pixels, weights)
        if unit is None:
            return None
        matrix = from_unit @ unit @ to_unit
        error = np.linalg.norm(Camera(matrix, 0).project(points) - pixels, axis=1)
        error[~np.isfinite(error)] = np.inf
        before, middle = inliers, float(np.median(error))
        inliers = error <= max(4.0 * middle, INLIER_FLOOR)
        if np.count_nonzero(inliers) < MIN_SAMPLES or not np.isfinite(middle):
            return None
        settled = camera is not None and bool((inliers == before).all())
        camera = Camera(matrix, float(np.median(error[inliers])))
        if settled:
            break
        scale = np.maximum(np.abs(unit_points @ unit[2]), 1e-9)
        # Without this doubt an object on a sixth of the points drags the camera with it: it pulls
        # the first fit so far that it stays within four median errors.
        doubt = 1.0 + (error / max(middle, INLIER_FLOOR)) ** 2
        weights = np.where(inliers, 1.0 / (scale * doubt), 0.0)
    assert camera is not None
    return camera if camera.median_error <= MAX_MEDIAN_ERROR else None


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


def _solve(points: F64, pixels: F64, weights: F64) -> F64 | None:
    """Return the 3x4 matrix of least algebraic error, None when it is not determined."""
    used = weights > 0
    scaled = points[used] * weights[used, None]
    flat = _rows(scaled, pixels[used]).reshape(-1, 12)
    if len(flat) < 2 * MIN_SAMPLES:
        return None
    squares, directions = np.linalg.eigh(flat.T @ flat)
    if squares[1] < DEGENERATE**2 * squares[-1]:
        return None
    matrix = directions[:, 0].reshape(3, 4)
    signs = scaled @ matrix[2]
    oriented: F64 = matrix * (1.0 if np.median(signs) > 0 else -1.0)
    return oriented
