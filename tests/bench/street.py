"""A synthetic shot for timing: ground, walls, a moving block and sky, seen by a moving camera.

Everything is exact and seeded: world positions, ids, normals and vectors to both neighbours, as a
renderer writes them; motion is up to some 60 pixels at 1920x1080.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer, Image, KeyFrame, Window

SIZE = (1080, 1920)
FOCAL = 0.9
"""In frame widths."""

# left, right, bottom, top, distance, id: upright panels facing +z.
PANELS = (
    (-30.0, -2.0, -2.0, 6.0, 40.0, 0),
    (4.0, 9.0, -2.0, 9.0, 30.0, 0),
    (-7.0, -5.0, -2.0, 4.0, 14.0, 0),
    (-1.5, 1.0, -2.0, 0.5, 8.0, 1),
    (2.2, 2.4, -2.0, 3.0, 6.0, 0),
)
BLOCK_STEP = 0.14
GROUND = -2.0


def key_frame(instant: int, channels: int = 4, size: tuple[int, int] = SIZE) -> KeyFrame:
    """Render one key frame, number `instant`, with motion not yet settled."""
    rays = _rays(instant, size)
    depth = np.full(size, np.inf)
    stencil = np.zeros(size, np.int32)
    normal = np.zeros((*size, 3))
    eye = _eye(instant)
    down = rays[..., 1] < -1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(down, (GROUND - eye[1]) / rays[..., 1], np.inf)
    ground = far < 200
    depth[ground], normal[ground] = far[ground], (0, 1, 0)
    for left, right, bottom, top, distance, number in PANELS:
        shift = BLOCK_STEP * instant if number else 0.0
        t = (distance - eye[2]) / rays[..., 2]
        x, y = eye[0] + t * rays[..., 0], eye[1] + t * rays[..., 1]
        hit = (x > left + shift) & (x < right + shift) & (y > bottom) & (y < top) & (t < depth)
        depth[hit], stencil[hit], normal[hit] = t[hit], number, (0, 0, -1)
    visible = np.isfinite(depth)
    position = np.where(visible[..., None], eye + np.where(visible, depth, 0)[..., None] * rays, 0)
    window = Window(0, 0, size[1], size[0])
    gbuffer = GBuffer(
        window,
        depth.astype(np.float32),
        normal.astype(np.float32),
        position.astype(np.float32),
        stencil,
        _vectors(position, visible, stencil, instant, -1),
        _vectors(position, visible, stencil, instant, 1),
    )
    pixels = _colour(position, visible, stencil, instant, channels)
    return KeyFrame(instant, Image(pixels, window, window), gbuffer)


def _eye(instant: int) -> np.ndarray:
    return np.array([0.12 * instant, 0.02 * instant, 0.1 * instant])


def _turn(instant: int) -> float:
    """Angle to the right, radians."""
    return 0.006 * instant


def _grid(size: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float64)
    return np.stack([x, y], axis=-1)


def _rays(instant: int, size: tuple[int, int]) -> np.ndarray:
    """Directions in the world, float64 [H, W, 3], of unit length along the camera's axis."""
    plane = (_grid(size) - (size[1] / 2, size[0] / 2)) / (FOCAL * size[1])
    x, y = plane[..., 0], -plane[..., 1]
    c, s = np.cos(_turn(instant)), np.sin(_turn(instant))
    return np.stack([c * x + s, y, c - s * x], axis=-1)


def _vectors(
    position: np.ndarray, visible: np.ndarray, stencil: np.ndarray, instant: int, step: int
) -> Float32:
    """Pixels from here to where points are seen a frame later or earlier; 0 for sky."""
    size = visible.shape
    moved = position - _eye(instant + step)
    moved[..., 0] += BLOCK_STEP * step * (stencil > 0)
    c, s = np.cos(_turn(instant + step)), np.sin(_turn(instant + step))
    x, y = c * moved[..., 0] - s * moved[..., 2], moved[..., 1]
    z = np.where(visible, s * moved[..., 0] + c * moved[..., 2], 1.0)
    scale = FOCAL * size[1] / z
    seen = np.stack([size[1] / 2 + x * scale, size[0] / 2 - y * scale], axis=-1)
    return np.where(visible[..., None], seen - _grid(size), 0).astype(np.float32)


def _colour(
    position: np.ndarray, visible: np.ndarray, stencil: np.ndarray, instant: int, channels: int
) -> Float32:
    """Stripes that stick to the surfaces, with a renderer's grain."""
    seeded = np.random.default_rng(instant)
    at = position.copy()
    at[..., 0] -= BLOCK_STEP * instant * (stencil > 0)
    pixels = np.ones((*visible.shape, channels))
    for c in range(3):
        waves = np.sin(at * (3.0 + c)).prod(axis=-1) + np.sin(11 * at).sum(axis=-1) / 3
        pixels[..., c] = np.where(visible, 0.4 + 0.25 * waves, 0.8 + 0.1 * c)
    pixels[..., :3] *= 1 + 0.05 * seeded.standard_normal((*visible.shape, 1))
    return np.ascontiguousarray(pixels, dtype=np.float32)
