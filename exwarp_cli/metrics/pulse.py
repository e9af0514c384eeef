"""Pulse: how much sharper or softer a new frame is than its reference, in per cent.

With y the luma 0.2126 R + 0.7152 G + 0.0722 B (Rec. 709) of the frame as displayed, sRGB-encoded,
in levels of 0 to 255, the mean gradient of a frame is the mean of |y(i, j + 1) - y(i, j)| over all
neighbours in a row plus the mean of |y(i + 1, j) - y(i, j)| over all neighbours in a column.

    pulse = 100 (mean gradient of the new frame / reference - 1)

The reference is the mean gradient of the true frame. Without one it is that of the two key frames
around, weighted by time. 0 is best; a softer frame has a negative pulse, a sharper one a positive.
New frames that are softer than key frames make textures shimmer at the key rate.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.metrics.display import encode

REC_709 = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue."""

MOST = 1000.0
"""Per cent at most: a frame without any gradient has no finite multiple."""

BAND = 64
"""Rows that are encoded at a time, so that large frames take little memory."""


def mean_gradient(pixels: Float32) -> float:
    """Return the mean gradient of a frame, in display levels of 0 to 255 a pixel.

    Parameters
    ----------
    pixels
        float32 [H, W, 3] or more, scene-linear; see `exwarp_cli.metrics.display.encode` for what
        becomes of values that a display cannot show. Alpha and holes do not count.

    Returns
    -------
    float
        0 or more, finite; 0 for a constant frame and for a single pixel.
    """
    height, width = pixels.shape[:2]
    across = down = 0.0
    for top in range(0, height, BAND):
        luma = _luma(pixels[top : top + BAND + 1])  # one row more, to reach into the next band
        across += float(np.abs(np.diff(luma[:BAND], axis=1)).sum(dtype=np.float64))
        down += float(np.abs(np.diff(luma, axis=0)).sum(dtype=np.float64))
    found: float = across / max(height * (width - 1), 1) + down / max((height - 1) * width, 1)
    return found


def pulse(gradient: float, reference: float) -> float:
    """Return the pulse of a frame with this mean gradient, in per cent: -100 to `MOST`.

    0 where both gradients are 0; `MOST` where only the reference is.
    """
    if gradient == reference:
        return 0.0
    return MOST if reference == 0 else min(100 * (gradient / reference - 1), MOST)


def measure(reference: Float32, test: Float32) -> float:
    """Return the pulse of a frame against the true one, both scene-linear; see `mean_gradient`."""
    return pulse(mean_gradient(test), mean_gradient(reference))


def between(before: float, after: float | None, time: float) -> float:
    """Return the reference gradient between two key frames.

    Parameters
    ----------
    before, after
        Mean gradients of the key frames; None where no next one of the shot exists.
    time
        Of the new frame, as a share of the way to the next key frame, 0 to 1.
    """
    return before if after is None else (1 - time) * before + time * after


def _luma(pixels: Float32) -> Float32:
    shown = encode(pixels)
    red, green, blue = (np.float32(weight) for weight in REC_709)
    luma: Float32 = red * shown[..., 0] + green * shown[..., 1] + blue * shown[..., 2]
    return luma
