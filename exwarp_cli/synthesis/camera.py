"""Cameras, recovered from what the G-buffer shows.

EXR headers seldom hold a camera matrix, but points of known position that are seen at known pixels
determine the 3x4 projection by a linear fit (the direct linear transform). With world positions
the points are those; with only depth along the camera's axis, the frame's own camera serves as the
world: the point at pixel (x, y) and depth z is (x, y, 1, 1/z) up to scale. Either way the fit to
the neighbouring frame, through the renderer's vectors, gives that frame's camera, and with it the
motion of everything static and of the sky, whose vectors are 0 even while the camera turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels import projection
from exwarp_cli.synthesis.resection import Camera as Camera
from exwarp_cli.synthesis.resection import fit

Index = npt.NDArray[np.intp]
F64 = npt.NDArray[np.float64]

MotionAt = Callable[[Index], Float32]
"""Returns float32 [N, 2], pixels, the displacement of the pixels with N flat indices."""

MAX_SAMPLES = 4000
GRID = 5
"""How many pixels are looked at for each sample."""


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

    Static ones where ids are known, none where these are too few: what moves by itself tells no
    camera. A regular grid, some times finer than needed, is looked at, as looking at every pixel
    takes longer than the fit.
    """
    grid = np.arange(0, depth.size, max(1, depth.size // (GRID * MAX_SAMPLES)))
    index = grid[np.isfinite(depth.ravel()[grid])]
    if stencil is not None:
        index = index[stencil.ravel()[index] == 0]
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
    return camera_by(scene, _found_in(vectors), stencil)


def camera_by(scene: Scene, motion_at: MotionAt, stencil: Int32 | None) -> Camera | None:
    """Return a camera as `camera_after` does, by the motion of the points it looks at alone."""
    return _cameras(scene, (motion_at,), stencil)[0]


def cameras_around(
    scene: Scene | None, vectors: Sequence[Float32 | None], stencil: Int32 | None
) -> F64:
    """Return the cameras of several instants, as the kernel that settles motion has them.

    Parameters
    ----------
    scene
        The frame's points; None where nothing tells.
    vectors
        As in `camera_after`, to each of the instants; None where there are none.
    stencil
        As there.

    Returns
    -------
    float64 [N, 2, 3, 4]
        Of each instant for points, and for background, at infinity; NaN where there is none.
    """
    out = np.full((len(vectors), 2, 3, 4), np.nan)
    if scene is None:
        return out
    motions = [None if motion is None else _found_in(motion) for motion in vectors]
    for found, camera in zip(out, _cameras(scene, motions, stencil), strict=True):
        if camera is not None:
            found[0], found[1, :, :3] = camera.matrix, _at_infinity(scene, camera)
            found[1, :, 3] = 1.0
    return out


def _found_in(vectors: Float32) -> MotionAt:
    """Return what finds displacements in a field of them, float32 [H, W, 2]."""
    return vectors.reshape(-1, 2).__getitem__


def _cameras(
    scene: Scene, motions: Sequence[MotionAt | None], stencil: Int32 | None
) -> list[Camera | None]:
    """Return the cameras of several instants, all by the same points."""
    index = sample(scene.depth, stencil)
    points, pixels = scene.points(index), pixels_at(index, scene.depth.shape[1])
    return [
        None
        if motion_at is None
        else fit(points, pixels + motion_at(index), movers=stencil is None)
        for motion_at in motions
    ]


def seen_by(scene: Scene, camera: Camera) -> Float32:
    """Return the displacement of each pixel to another camera's frame, if its point stands still.

    Returns
    -------
    float32 [H, W, 2]
        Pixels; NaN for what lies behind the camera.
    """
    out = np.empty((*scene.depth.shape, 2), np.float32)
    projection.write_rigid_motion(*_sight(scene, camera), np.zeros((0, 0), np.bool_), False, out)
    return out


def place_still(
    scene: Scene, camera: Camera, still: Bool, motion: Float32, kept: bool = False
) -> None:
    """Write what `seen_by` returns to the pixels of a motion field that stand still.

    Parameters
    ----------
    scene, camera
        As there.
    still
        bool [H, W].
    motion
        float32 [H, W, 2], changed.
    kept
        Whether it is kept for what lies behind the camera.
    """
    projection.write_rigid_motion(*_sight(scene, camera), still, kept, motion)


def standing(scene: Scene, camera: Camera, step: Float32, tolerance: float) -> Bool:
    """bool [H, W]: pixels whose motion is what `seen_by` returns, but for a tolerance in pixels.

    Parameters
    ----------
    scene, camera
        As there.
    step
        float32 [H, W, 2], pixels: motion to the camera's frame; NaN where unknown.
    tolerance
        Of either component.
    """
    out = np.empty(scene.depth.shape, np.bool_)
    projection.mark_static(*_sight(scene, camera), step, np.float32(tolerance), out)
    return out


def _sight(scene: Scene, camera: Camera) -> tuple[Float32, Float32, F64, F64]:
    """Return what kernels need of a scene and another camera."""
    return scene.position, scene.depth, camera.matrix, _at_infinity(scene, camera)


def _at_infinity(scene: Scene, camera: Camera) -> F64:
    """Return the homography float64 [3, 3] of the background."""
    return camera.matrix[:, :3] @ scene.to_ray
