"""Cameras, recovered from what the G-buffer shows.

EXR headers seldom hold a camera matrix, but points of known position at known pixels determine the
3x4 projection by the direct linear transform. A camera is this matrix, float64 [3, 4], from
homogeneous scene points to pixels (+x right, +y down); what it maps to a negative third component
lies behind it. With world positions the points are those. With only
depth along the camera's axis, the frame's own camera serves as the world: the point at pixel (x, y)
and depth z is (x, y, 1, 1/z) up to scale. Either way the fit to the neighbouring frame, through the
renderer's vectors, gives that frame's camera. With it comes the motion of everything static and of
the sky, whose vectors are 0 even while the camera turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels import point_motion

Index = npt.NDArray[np.intp]
F64 = npt.NDArray[np.float64]

# Points that a camera is fitted to, and how many pixels are examined for each.
MAX_SAMPLES, GRID = 4000, 5
MIN_SAMPLES = 60
ROUNDS = 12

# Cameras that are tried, points that determine each, and points that judge it: with two fifths of
# the points moving, 200 samples of six miss the right camera once in ten thousand.
SUBSETS, SUBSET_SIZE, JUDGES = 200, 6, 500

# An error below this is no outlier, in units of the spread of the pixels.
MIN_OUTLIER = 1e-3

# Pixels: a fit whose median error on its inliers is larger is no camera.
MAX_MEDIAN_ERROR = 0.25

# Pixels: a smaller error is never an outlier, because half-float passes are rounded.
INLIER_FLOOR = 0.02

# Ratio of singular values below which points lie on one plane and determine no camera.
DEGENERATE = 1e-5


@dataclass(frozen=True)
class Scene:
    """The points of a frame: in world space, or in that of the frame's own camera."""

    position: Float32  # [H, W, 3], world space; [0, 0, 3] where depth places the points
    depth: Float32  # [H, W], +inf background
    to_ray: F64  # [3, 3]: takes (x, y, 1) of a pixel to the direction of its ray
    camera: F64 | None = None  # from world positions; None where depth places the points

    def points(self, index: Index) -> F64:
        """Return homogeneous points float64 [N, 4] of pixels with these flat indices."""
        if self.position.shape[0]:
            position = self.position.reshape(-1, 3)[index].astype(np.float64)
            return np.concatenate([position, np.ones((len(index), 1))], axis=1)
        inverse = 1.0 / self.depth.ravel()[index].astype(np.float64)
        grid = pixels_at(index, self.depth.shape[1])
        return np.column_stack([grid, np.ones(len(index)), inverse])


def pixels_at(index: Index, width: int) -> F64:
    """Return pixel coordinates (x, y) float64 [N, 2] of flat indices."""
    y, x = np.divmod(index, width)
    return np.stack([x, y], axis=1).astype(np.float64)


def scene_of(gbuffer: GBuffer) -> Scene | None:
    """Place a frame's points by world positions if these fit a camera, else by depth.

    None without either.
    """
    depth = gbuffer.depth
    if gbuffer.position is not None:
        position = np.ascontiguousarray(gbuffer.position)
        if depth is None:
            depth = np.where(gbuffer.background, np.inf, 1.0).astype(np.float32)
        index = sample_surfaces(depth)
        scene = Scene(position, depth, np.eye(3))
        camera = fit(scene.points(index), pixels_at(index, depth.shape[1]))
        if camera is not None:
            to_ray = np.asarray(np.linalg.inv(camera[:, :3]), dtype=np.float64)
            return Scene(position, depth, to_ray, camera)
    if gbuffer.depth is None:
        return None
    return Scene(np.zeros((0, 0, 3), np.float32), gbuffer.depth, np.eye(3))


def sample_surfaces(depth: Float32, stencil: Int32 | None = None) -> Index:
    """Choose about MAX_SAMPLES pixels that show surfaces, always the same, as flat indices.

    With ids, static pixels only: what moves by itself determines no camera.
    """
    # A regular grid, finer than needed: examining every pixel takes longer than the fit.
    grid = np.arange(0, depth.size, max(1, depth.size // (GRID * MAX_SAMPLES)))
    index = grid[np.isfinite(depth.ravel()[grid])]
    if stencil is not None:
        index = index[stencil.ravel()[index] == 0]
    return index[:: max(1, len(index) // MAX_SAMPLES)]


def camera_after(
    scene: Scene,
    vectors: Float32,  # [H, W, 2], pixels, displacement to the other frame
    stencil: Int32 | None,  # [H, W], 0 static; None when unknown
) -> F64 | None:
    """Recover the camera of another instant from the motion to it.

    In the scene's own world; None if no camera explains the motion.
    """
    index = sample_surfaces(scene.depth, stencil)
    pixels = pixels_at(index, scene.depth.shape[1])
    ends = pixels + vectors.reshape(-1, 2)[index]
    return fit(scene.points(index), ends, movers=stencil is None)


def seen_by(scene: Scene, camera: F64) -> Float32:
    """Return the displacement of each pixel to another camera's frame, if its point stands still.

    float32 [H, W, 2] in pixels; NaN for what lies behind the camera.
    """
    out = np.empty((*scene.depth.shape, 2), np.float32)
    place_still(scene, camera, np.zeros((0, 0), np.bool_), out)
    return out


def place_still(
    scene: Scene, camera: F64, still: Bool, motion: Float32, kept: bool = False
) -> None:
    """Write what `seen_by` returns into `motion` where `still` is True; everywhere if it is [0, 0].

    With `kept`, what lies behind the camera keeps its motion.
    """
    at_infinity = camera[:, :3] @ scene.to_ray
    points = scene.position, scene.depth
    point_motion.write_rigid_motion(*points, camera, at_infinity, still, kept, motion)


def standing(scene: Scene, camera: F64, step: Float32, tolerance: float) -> Bool:
    """Mark pixels, bool [H, W], whose motion `step` to the camera's frame is that of still points.

    `tolerance` is in pixels, for either component; unknown motion (NaN) is not still.
    """
    near = np.abs(step - seen_by(scene, camera)) <= np.float32(tolerance)
    return np.asarray(near[..., 0] & near[..., 1])


def fit(
    points: F64,  # [N, 4], homogeneous
    pixels: F64,  # [N, 2]
    # Whether points may be among them that move alike and differently from the rest. The fit then
    # starts from the least median of small samples, which tolerates nearly half of them.
    movers: bool = False,
) -> F64 | None:
    """Fit a projection to points at pixels, most of which match.

    None with too few points, with points on one plane, or if no camera explains half of them.
    Direct linear transform on normalised coordinates, reweighted to pixel error and by Geman and
    McClure's weights. Points beyond four median errors are left out round by round, until the same
    points stay.
    """
    usable = np.isfinite(points).all(axis=1) & np.isfinite(pixels).all(axis=1)
    points, pixels = points[usable], pixels[usable]
    if len(points) < MIN_SAMPLES:
        return None
    finite = points[:, :3] / points[:, 3:]
    middle = np.median(finite, axis=0)
    to_unit = np.eye(4)
    to_unit[:3, 3] = -middle
    to_unit[:3] /= float(np.median(np.abs(finite - middle))) or 1.0
    unit_points = points @ to_unit.T
    unit_points = unit_points / unit_points[:, 3:]
    centre, spread = pixels.mean(axis=0), float(pixels.std()) or 1.0
    unit_pixels = (pixels - centre) / spread
    from_unit = np.diag([spread, spread, 1.0])
    from_unit[:2, 2] = centre
    weights = np.ones(len(points))
    if movers:
        weights = _least_median_weights(unit_points, unit_pixels)
    inliers = np.ones(len(points), np.bool_)
    for count in range(ROUNDS):
        unit = _least_algebraic_error(unit_points, unit_pixels, weights)
        if unit is None:
            return None
        matrix = from_unit @ unit @ to_unit
        errors = projection_errors(matrix, points, pixels)
        median = float(np.median(errors))
        limit = max(4.0 * median, INLIER_FLOOR)
        before, inliers = inliers, errors <= limit
        if np.count_nonzero(inliers) < MIN_SAMPLES or not math.isfinite(median):
            return None
        if count and np.array_equal(inliers, before):
            break
        # Without these weights an object on a sixth of the points drags the camera with it: it
        # pulls the first fit so far that it stays within four median errors.
        with np.errstate(over="ignore"):  # of outliers
            doubt = 1 + (errors / max(median, INLIER_FLOOR)) ** 2
        # By depth an algebraic error becomes one of pixels.
        depths = np.maximum(np.abs(unit_points @ unit[2]), 1e-9)
        weights = np.where(inliers, 1 / (depths * doubt), 0)
    return matrix if np.median(errors[inliers]) <= MAX_MEDIAN_ERROR else None


def projection_errors(camera: F64, points: F64, pixels: F64) -> F64:
    """Return by how many pixels points [N, 4] miss, float64 [N]; infinite behind the camera."""
    image = points @ camera.T
    return np.asarray(np.where(image[:, 2] > 0, _distances(image, pixels), np.inf))


def _distances(image: F64, pixels: F64) -> F64:
    """Return how far homogeneous points [..., N, 3] are from pixels [N, 2]; inf if unknown."""
    with np.errstate(all="ignore"):  # points behind the camera, and at infinity
        distances = np.linalg.norm(image[..., :2] / image[..., 2:] - pixels, axis=-1)
    return np.asarray(np.where(np.isfinite(distances), distances, np.inf))


def _least_median_weights(points: F64, pixels: F64) -> F64:
    """Return weight 1 for points near the best of many cameras through six points each, else 0.

    Rousseeuw, Least Median of Squares Regression, 1984; the samples are always the same ones.
    """
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(points), (SUBSETS, SUBSET_SIZE))
    rows = _equations(points[chosen], pixels[chosen])
    _, directions = np.linalg.eigh(rows.transpose(0, 2, 1) @ rows)
    matrices = directions[..., 0].reshape(SUBSETS, 3, 4)
    judges = slice(None, None, max(1, len(points) // JUDGES))
    images = points[judges] @ matrices.swapaxes(-1, -2)
    medians = np.median(_distances(images, pixels[judges]), axis=-1)
    best = int(np.argmin(medians))
    limit = max(4.0 * float(medians[best]), MIN_OUTLIER)
    return (_distances(points @ matrices[best].T, pixels) <= limit).astype(np.float64)


def _equations(points: F64, pixels: F64) -> F64:
    """Return the equations of the direct linear transform, [..., 2 N, 12]: those of x, then of y.

    Of points [..., N, 4] at pixels [..., N, 2].
    """
    x, y = np.moveaxis(pixels, -1, 0)[..., None]
    *subsets, count, _ = points.shape
    rows = np.zeros((*subsets, 2, count, 12))
    rows[..., 0, :, :4], rows[..., 0, :, 8:] = points, -x * points
    rows[..., 1, :, 4:8], rows[..., 1, :, 8:] = points, -y * points
    return rows.reshape(*subsets, 2 * count, 12)


def _least_algebraic_error(points: F64, pixels: F64, weights: F64) -> F64 | None:
    """Return the 3x4 matrix that fits best, None if points do not determine it."""
    used = weights > 0
    if np.count_nonzero(used) < MIN_SAMPLES:
        return None
    scaled = points[used] * weights[used, None]
    rows = _equations(scaled, pixels[used])
    squares, directions = np.linalg.eigh(rows.T @ rows)
    if squares[1] < DEGENERATE**2 * squares[-1]:
        return None
    matrix = directions[:, 0].reshape(3, 4)
    oriented: F64 = matrix * (1.0 if np.median(scaled @ matrix[2]) > 0 else -1.0)
    return oriented
