"""Planes as networks take them, from interleaved pixels and back."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.compiled.shares import WHOLE, Share, turns
from exwarp_cli.kernels.gather import clamp
from exwarp_cli.kernels.jit import inlined, parallel, serial

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
Frame = tuple[F32, B8]

NEAREST = np.float32(np.finfo(np.float32).tiny)
"""Least median of the depths that anything is divided by."""


@inlined
def within(value: np.float32, low: float, high: float, unknown: float) -> np.float32:
    """Return a value held within bounds; `unknown` for NaN."""
    if math.isnan(value):
        return np.float32(unknown)
    return np.float32(low) if value < low else np.float32(high) if value > high else value


@inlined
def direction(value: np.float32) -> np.float32:
    """Return a normal's component, -1 to 1; 0 where it is not finite."""
    return np.float32(0) if math.isinf(value) else within(value, -1.0, 1.0, 0.0)


def spread_text(
    frames: tuple[Frame, Frame, Frame],
    filled: F32,
    surface: tuple[F32, F32, F32, F32],
    defaults: tuple[float, float, float],
    median: np.float32,
    corner: tuple[int, int],
    out: F32,
    share: Share = WHOLE,
) -> None:
    """Write a part of a slot's planes, colour still linear.

    Parameters
    ----------
    frames
        F_k, F_k-1 and F_k-2 moved to the slot: colour float32 [H, W, C] and bool [H, W], where they
        show it.
    filled
        float32 [H, W, C]: the first of them with its holes filled.
    surface
        Depth [H, W], normal [H, W, 3], roughness and metallic [H, W] of the slot, float32; [0, 0]
        and [0, 0, 3] for what is not known.
    defaults
        Relative depth, roughness and metallic where they are not known.
    median
        Of the depth where it is finite: becomes 0.5.
    corner
        Row and column of the part's first pixel. What lies beyond the frame repeats its edge.
    out
        float32 [25, h, w], written: `warped`, `mask`, `features` and `history` of
        `exwarp_cli.domain.extrapolator.NetworkInputs`.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, _ = filled.shape
    depth, normal, roughness, metallic = surface
    middle = max(median, NEAREST)
    (now, visible), before, oldest = frames
    for y in turns(out.shape[1], share):
        i = clamp(corner[0] + y, 0, height - 1)
        for x in range(out.shape[2]):
            j = clamp(corner[1] + np.int64(x), 0, width - 1)
            seen = np.float32(visible[i, j])
            for c in range(3):
                out[c, y, x] = now[i, j, c] * seen
                out[3 + c, y, x] = filled[i, j, c]
                out[13 + c, y, x] = now[i, j, c]
                out[17 + c, y, x] = before[0][i, j, c]
                out[21 + c, y, x] = oldest[0][i, j, c]
                out[7 + c, y, x] = direction(normal[i, j, c]) if normal.size else np.float32(0)
            out[6, y, x] = out[16, y, x] = seen
            out[20, y, x] = np.float32(before[1][i, j])
            out[24, y, x] = np.float32(oldest[1][i, j])
            out[10, y, x] = np.float32(defaults[0])
            if depth.size:
                away = np.float32(0) if depth[i, j] < 0 else depth[i, j]
                near = np.float32(median / np.float32(away + middle))
                out[10, y, x] = within(np.float32(np.float32(1) - near), 0.0, 1.0, defaults[0])
            out[11, y, x] = (
                within(roughness[i, j], 0.0, 1.0, defaults[1])
                if roughness.size
                else np.float32(defaults[1])
            )
            out[12, y, x] = (
                within(metallic[i, j], 0.0, 1.0, defaults[2])
                if metallic.size
                else np.float32(defaults[2])
            )


spread = parallel(spread_text)
spread_serial = serial(spread_text)


def join_text(colour: F32, modulation: F32, filled: F32, out: F32, share: Share = WHOLE) -> None:
    """Write a network's answer as a frame.

    Parameters
    ----------
    colour
        float32 [3, H, W], linear.
    modulation
        float32 [H, W, 3] that it is multiplied with; [0, 0, 3] for nothing.
    filled
        float32 [H, W, C]: the filled warp, whose further channels are taken over. Where it has some
        and all is 0, so is the frame.
    out
        float32 [H, W, C], written.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, channels = filled.shape
    for i in turns(height, share):
        for j in range(width):
            empty = channels > 3
            for c in range(channels):
                empty = empty and filled[i, j, c] == 0
            for c in range(3):
                value = colour[c, i, j]
                if modulation.size:
                    value *= modulation[i, j, c]
                out[i, j, c] = np.float32(0) if empty else value
            for c in range(3, channels):
                out[i, j, c] = filled[i, j, c]


join = parallel(join_text)
join_serial = serial(join_text)


def demodulate_text(
    pixels: F32,
    albedo: F32,
    specular: F32,
    bounds: tuple[float, float],
    out: F32,
    share: Share = WHOLE,
) -> None:
    """Divide a frame's colour by its surface colour; further channels are copied.

    Parameters
    ----------
    pixels
        float32 [H, W, C], scene-linear.
    albedo, specular
        float32 [H, W, 3]; their sum, held within `bounds`, is the surface colour.
    bounds
        Least and greatest.
    out
        float32 [H, W, C], written.
    share
        Which turns are taken: those of :func:`~exwarp_cli.compiled.shares.turns`.
    """
    height, width, channels = pixels.shape
    for i in turns(height, share):
        for j in range(width):
            for c in range(3):
                total = np.float32(albedo[i, j, c] + specular[i, j, c])
                total = within(total, bounds[0], bounds[1], np.nan)
                out[i, j, c] = pixels[i, j, c] / total
            for c in range(3, channels):
                out[i, j, c] = pixels[i, j, c]


demodulate = parallel(demodulate_text)
demodulate_serial = serial(demodulate_text)
