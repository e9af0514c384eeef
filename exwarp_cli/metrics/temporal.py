"""Changes in time and in sharpness: flicker and pulse.

Flicker is change in time that the ground truth does not have, followed along its motion.

With e_t = encode(test_t) - encode(truth_t), in display levels of 0 to 255, and m the motion from
frame t to the one before it, the transition into frame t is the mean over the pixels that both
frames show, and over the channels, of |e_t(x) - e_t-1(x + m(x))|. Written out that is
|(test_t - W test_t-1) - (truth_t - W truth_t-1)|, the test's motion-compensated temporal difference
against that of the truth: 0 where the test changes in time exactly as the truth does, whether right
or wrong, and large where an error comes and goes. The idea of comparing an output with the one
before it, moved, is the temporal loss of Lai et al., "Learning Blind Video Temporal Consistency",
ECCV 2018; taking the truth's own change off is what makes moving light no flicker.

Pulse says how much sharper or softer a new frame is than its reference, in per cent.

With y the luma 0.2126 R + 0.7152 G + 0.0722 B (Rec. 709) of the frame as displayed, sRGB-encoded,
in levels of 0 to 255, the mean gradient of a frame is the mean of |y(i, j + 1) - y(i, j)| over all
neighbours in a row plus the mean of |y(i + 1, j) - y(i, j)| over all neighbours in a column.

    pulse = 100 (mean gradient of the new frame / reference - 1)

The reference is the mean gradient of the true frame. Without one it is that of the two key frames
around, weighted by time. 0 is best; a softer frame has a negative pulse, a sharper one a positive.
New frames that are softer than key frames make textures shimmer at the key rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import gather


@dataclass(frozen=True)
class Transition:
    """The change from one frame to the next that the truth does not have."""

    per_pixel: Float32  # [H, W], display levels, at the pixels of the later frame; finite
    counted: Bool  # [H, W]: both frames show this surface point

    def mean(self, mask: Bool | None = None) -> float | None:
        """Return the value over the pixels that count, or those of them in a mask; None without."""
        chosen = self.counted if mask is None else self.counted & mask
        return float(self.per_pixel[chosen].mean(dtype=np.float64)) if chosen.any() else None


def display_error(reference: Float32, test: Float32) -> Float32:
    """Return the signed difference of a frame from the truth, float32 [H, W, 3], display levels."""
    difference: Float32 = encode_display(test) - encode_display(reference)
    return difference


def compare_with_previous(
    now: Float32,  # [H, W, 3], `display_error` of the frame
    before: Float32 | None,  # of the frame before; None for a rendered one, whose error is 0
    field: Float32,  # [H, W, 2] px, +x right, +y down, to the frame before; NaN where unknown
    hidden: Bool,  # [H, W]: the frame before does not show the surface point
) -> Transition:
    """Compare a frame's error with that of the frame before it."""
    source = np.zeros_like(now) if before is None else before
    moved, unseen = np.empty(now.shape, now.dtype), np.empty(hidden.shape, np.bool_)
    gather.gather_bilinear(source, field, moved, unseen)
    return Transition(np.abs(now - moved).mean(axis=-1), ~(unseen | hidden))


def frame_flicker(transitions: Sequence[float | None]) -> list[float | None]:
    """Return each frame's flicker: the mean of the transitions into it and out of it.

    Transitions are one more than frames: into the first, from it to the second …, out of the last.
    None where there is none; a frame with only one has the value of that one.
    """
    values: list[float | None] = []
    for around in pairwise(transitions):
        existing = [value for value in around if value is not None]
        values.append(sum(existing) / len(existing) if existing else None)
    return values


REC_709 = (0.2126, 0.7152, 0.0722)  # weights of red, green and blue

MAX_PULSE = 1000.0  # per cent; a frame without any gradient has no finite multiple

ROWS_AT_ONCE = 64  # rows that are encoded together, so that large frames take little memory


def mean_gradient(pixels: Float32) -> float:
    """Return the mean gradient of a frame, in display levels of 0 to 255 a pixel.

    Pixels are float32 [H, W, 3 or more], scene-linear; alpha does not count. 0 for a constant frame
    and for a single pixel.
    """
    height, width = pixels.shape[:2]
    red, green, blue = (np.float32(weight) for weight in REC_709)
    across = down = 0.0
    for top in range(0, height, ROWS_AT_ONCE):
        # One row more, to reach into the next strip.
        display = encode_display(pixels[top : top + ROWS_AT_ONCE + 1])
        luma: Float32 = red * display[..., 0] + green * display[..., 1] + blue * display[..., 2]
        across += float(np.abs(np.diff(luma[:ROWS_AT_ONCE], axis=1)).sum(dtype=np.float64))
        down += float(np.abs(np.diff(luma, axis=0)).sum(dtype=np.float64))
    gradient: float = across / max(height * (width - 1), 1) + down / max((height - 1) * width, 1)
    return gradient


def pulse(gradient: float, reference: float) -> float:
    """Return the pulse of a mean gradient against a reference, in per cent: -100 to MAX_PULSE.

    0 where both gradients are 0; MAX_PULSE where only the reference is.
    """
    if gradient == reference:
        return 0.0
    return MAX_PULSE if reference == 0 else min(100 * (gradient / reference - 1), MAX_PULSE)
