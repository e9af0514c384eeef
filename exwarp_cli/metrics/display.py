"""From scene-linear colour to the display values that the metrics are defined on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, UInt8

PEAK = 255.0
"""Largest display value: the metrics' constants are those of 8-bit images."""


def encode(pixels: Float32) -> Float32:
    """Clip to [0, 1], apply the sRGB curve (IEC 61966-2-1) and scale to 8-bit range.

    The values are *not* rounded to integers: rounding would hide errors below half a step, and
    quantise two nearly equal frames into equal ones.

    Parameters
    ----------
    pixels
        float32 [H, W, 3] or more channels, scene-linear with sRGB primaries; channels after the
        third (alpha) are left out. NaN counts as 0 (black), infinities as the nearer end of the
        range, so that a broken pixel costs quality instead of turning the score into NaN.

    Returns
    -------
    float32 [H, W, 3]
        0 to 255, finite.
    """
    linear = np.clip(pixels[..., :3].astype(np.float32), 0, 1)
    linear[np.isnan(linear)] = 0
    # The scale is inside the constants, so that white comes out as 255 and not one ulp below.
    curve = np.float32(1.055 * PEAK) * linear ** np.float32(1 / 2.4) - np.float32(0.055 * PEAK)
    toe = np.float32(12.92 * PEAK) * linear
    shown: Float32 = np.where(linear <= np.float32(0.0031308), toe, curve)
    return np.clip(shown, 0, np.float32(PEAK))


def rounded(pixels: Float32) -> UInt8:
    """Encode as `encode` does, and round half up to the 8-bit steps of a PNG: uint8 [H, W, 3]."""
    steps: UInt8 = np.floor(encode(pixels) + np.float32(0.5)).astype(np.uint8)
    return steps


@dataclass(frozen=True)
class Measured:
    """A metric's map for one pair of images.

    Attributes
    ----------
    per_pixel
        float [H, W], finite: what is averaged.
    margin
        Pixels left out at every edge when all pixels are averaged; a mask's pixels all count.
    finish
        Turns the average into the metric's value.
    """

    per_pixel: npt.NDArray[np.floating]
    margin: int = 0
    finish: Callable[[float], float] = float

    def overall(self) -> float:
        """Value over all pixels."""
        height, width = self.per_pixel.shape
        m = self.margin
        inner = self.per_pixel[m : height - m, m : width - m]
        return self.finish(float(inner.mean(dtype=np.float64)))

    def within(self, mask: Bool) -> float:
        """Value over the pixels where `mask`, bool [H, W], is true; at least one must be."""
        return self.finish(float(self.per_pixel[mask].mean(dtype=np.float64)))
