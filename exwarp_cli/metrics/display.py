"""From scene-linear colour to the display values that the metrics are defined on."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32, UInt8

PEAK = 255.0  # largest display value: the metrics' constants are those of 8-bit images


def encode_display(pixels: Float32) -> Float32:
    """Clip to [0, 1], apply the sRGB curve (IEC 61966-2-1) and scale to 0 … 255.

    Pixels are float32 [H, W, 3 or more], scene-linear with sRGB primaries; alpha is dropped. NaN
    counts as 0 and infinities as the nearer end, so that a broken pixel costs quality instead of
    turning the score into NaN.
    """
    # Not rounded to integers: that would hide errors below half a step.
    linear = np.clip(pixels[..., :3].astype(np.float32), 0, 1)
    linear[np.isnan(linear)] = 0
    # The scale is inside the constants, so that white comes out as 255 and not one ulp below.
    curve = np.float32(1.055 * PEAK) * linear ** np.float32(1 / 2.4) - np.float32(0.055 * PEAK)
    toe = np.float32(12.92 * PEAK) * linear
    display: Float32 = np.where(linear <= np.float32(0.0031308), toe, curve)
    return np.clip(display, 0, np.float32(PEAK))


def round_display(pixels: Float32) -> UInt8:
    """Encode as `encode_display`, and round half up to the 8-bit steps of a PNG."""
    steps: UInt8 = np.floor(encode_display(pixels) + np.float32(0.5)).astype(np.uint8)
    return steps
