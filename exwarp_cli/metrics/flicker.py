"""Flicker: change in time that the ground truth does not have, followed along its motion.

With e_t = encode(test_t) - encode(truth_t), in display levels of 0 to 255, and m the motion from
frame t to the one before it, the transition into frame t is the mean over the pixels that both
frames show, and over the channels, of |e_t(x) - e_t-1(x + m(x))|. Written out that is
|(test_t - W test_t-1) - (truth_t - W truth_t-1)|, the test's motion-compensated temporal difference
against that of the truth: 0 where the test changes in time exactly as the truth does, whether right
or wrong, and large where an error comes and goes. The idea of comparing an output with the one
before it, moved, is the temporal loss of Lai et al., "Learning Blind Video Temporal Consistency",
ECCV 2018; taking the truth's own change off is what makes moving light no flicker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.kernels import gather
from exwarp_cli.metrics.display import encode


@dataclass(frozen=True)
class Transition:
    """What changes from one frame to the next that the truth does not change.

    Attributes
    ----------
    per_pixel
        float32 [H, W], display levels, at the pixels of the later frame; finite.
    counted
        bool [H, W]: both frames show this surface point.
    """

    per_pixel: Float32
    counted: Bool

    def mean(self) -> float | None:
        """Value over the pixels that count; None where none does."""
        return self.within(np.ones_like(self.counted))

    def within(self, mask: Bool) -> float | None:
        """Value over those of a mask, bool [H, W], that count; None where none does."""
        chosen = self.counted & mask
        return float(self.per_pixel[chosen].mean(dtype=np.float64)) if chosen.any() else None


def error(reference: Float32, test: Float32) -> Float32:
    """Return how a frame differs from the truth, float32 [H, W, 3], display levels, signed.

    Both are float32 [H, W, 3] or more, scene-linear; see `exwarp_cli.metrics.display.encode` for
    what becomes of values that a display cannot show.
    """
    difference: Float32 = encode(test) - encode(reference)
    return difference


def transition(now: Float32, before: Float32 | None, field: Float32, hidden: Bool) -> Transition:
    """Compare a frame's error with that of the frame before it.

    Parameters
    ----------
    now, before
        float32 [H, W, 3], `error` of both; None before where that frame is a rendered one, whose
        error is 0.
    field
        float32 [H, W, 2], pixels, +x right, +y down: from the frame to the one before it; NaN where
        nothing is known.
    hidden
        bool [H, W]: the frame before does not show the surface point.
    """
    source = np.zeros_like(now) if before is None else before
    moved, unseen = np.empty(now.shape, now.dtype), np.empty(hidden.shape, np.bool_)
    gather.gather_bilinear(source, field, moved, unseen)
    return Transition(np.abs(now - moved).mean(axis=-1), ~(unseen | hidden))


def landing(last: Float32) -> Transition:
    """Return the transition from a frame with this error to a rendered one, which has none.

    It is taken at the frame's own pixels, all of them, and needs no motion.
    """
    return Transition(np.abs(last).mean(axis=-1), np.ones(last.shape[:2], np.bool_))


def of_frames(transitions: Sequence[float | None]) -> list[float | None]:
    """Return each frame's flicker: the mean of the transition into it and the one out of it.

    Parameters
    ----------
    transitions
        Into the first frame, from it to the second …, and out of the last one: one more than
        there are frames; None where there is none. A frame with only one of them has that one.
    """
    found: list[float | None] = []
    for around in pairwise(transitions):
        known = [value for value in around if value is not None]
        found.append(sum(known) / len(known) if known else None)
    return found


def flicker(
    transitions: Sequence[Transition | None], masks: Sequence[Bool | None]
) -> list[tuple[float | None, float | None]]:
    """Return the flicker of successive frames, as those of one key interval: overall, in holes.

    Parameters
    ----------
    transitions
        As `of_frames` takes them.
    masks
        bool [H, W] of each frame's holes; None without.

    Returns
    -------
    list of (float or None, float or None)
        In holes only the transition into the frame counts, as what fills a hole was not there
        before or after; None where no pixel of the mask was seen in the frame before.
    """
    overall = of_frames([None if step is None else step.mean() for step in transitions])
    inside = [
        None if step is None or mask is None else step.within(mask)
        for step, mask in zip(transitions, masks, strict=False)
    ]
    return list(zip(overall, inside, strict=True))
