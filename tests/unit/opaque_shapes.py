"""Opaque shapes on nothing or over ground, whose frames are known exactly at any time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.synthesis.motion_fields import settle_motion

HEIGHT, WIDTH, FINE = 64, 96, 8
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]
Pair = tuple[float, float]


@dataclass(frozen=True)
class View:
    """A picture float32 [H, W, C], its G-buffer, and the share of each pixel that is covered."""

    pixels: np.ndarray
    gbuffer: GBuffer
    cover: np.ndarray


def grid(fine: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return y and x of the centres of pixels, or of so many parts of them along each axis."""
    y, x = np.mgrid[: HEIGHT * fine, : WIDTH * fine]
    return (y + 0.5) / fine - 0.5, (x + 0.5) / fine - 0.5


def mean(values: np.ndarray) -> np.ndarray:
    """Return the means over pixels of what is known of their parts."""
    fine = len(values) // HEIGHT
    parts = values.reshape(HEIGHT, fine, WIDTH, fine, -1)
    return parts.mean(axis=(1, 3)).astype(np.float32)


def disc(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x * x + y * y < 14.3**2


def bar(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    along, across = 0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x
    return (np.abs(across) < 2.6) & (np.abs(along) < 20)


def paint(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    colour = np.stack([0.5 + 0.3 * np.sin(x / 2), 0.5 + 0.3 * np.sin(y / 3)], -1)
    return np.concatenate([colour, 0.4 + 0 * colour[..., :1]], axis=-1)


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    colour = np.stack([0.06 + 0.02 * np.sin(x / 4), 0.05 + 0.02 * np.sin(y / 5)], -1)
    return np.concatenate([colour, 0.9 + 0 * colour[..., :1]], axis=-1)


def cut_out(shape: Shape, at: Pair, motion: Pair) -> View:
    """Return an opaque shape on nothing, which moves along."""
    y, x = grid(FINE)
    cover = mean(shape(x - at[0], y - at[1]))
    y, x = grid()
    inside, colour = shape(x - at[0], y - at[1]), paint(x - at[0], y - at[1])
    pixels = np.concatenate([colour * cover, cover], axis=-1).astype(np.float32)
    return View(pixels, _geometry(inside, motion, (0, 0), np.inf), cover[..., 0])


def over_ground(
    shape: Shape, at: Pair, motion: Pair, drift: Pair, time: float, fine: int = FINE
) -> View:
    """Return an opaque shape that moves along over textured ground, which drifts.

    With `fine` of 1 pixels are not antialiased: each has the colour at its centre.
    """
    y, x = grid(fine)
    inside = shape(x - at[0], y - at[1])
    behind = ground(x - time * drift[0], y - time * drift[1])
    pixels = mean(np.where(inside[..., None], paint(x - at[0], y - at[1]), behind))
    y, x = grid()
    centres = shape(x - at[0], y - at[1])
    return View(pixels, _geometry(centres, motion, drift, 20), mean(inside)[..., 0])


def _geometry(inside: np.ndarray, motion: Pair, drift: Pair, far: float) -> GBuffer:
    vectors = np.where(inside[..., None], motion, drift).astype(np.float32)
    gbuffer = GBuffer(
        Window(0, 0, WIDTH, HEIGHT),
        depth=np.where(inside, 5, far).astype(np.float32),
        stencil=inside.astype(np.int32),
        to_next=vectors,
        to_previous=-vectors,
    )
    return settle_motion(gbuffer)
