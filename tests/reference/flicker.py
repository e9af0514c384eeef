"""Naive twin of flicker: plain loops, straight from the definition."""

from __future__ import annotations

import numpy as np

from tests.reference.gather import gather_bilinear
from tests.reference.quality import srgb_255


def displayed(pixels: np.ndarray) -> np.ndarray:
    """Return display levels, 0 to 255, of the first three channels."""
    return np.vectorize(srgb_255)(pixels[..., :3].astype(np.float64))


def transition(
    frames: tuple[np.ndarray, np.ndarray],
    truths: tuple[np.ndarray, np.ndarray],
    field: np.ndarray,
    hidden: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what changes at each pixel that the truth does not change, and where that counts.

    `frames` and `truths` are the earlier and the later one, scene-linear. The test's temporal
    difference and the truth's are taken apart from each other, each against its own frame before.
    """
    differences = []
    unseen = hidden
    for before, now in (frames, truths):
        moved, outside = gather_bilinear(displayed(before), field)
        differences.append(displayed(now) - moved)
        unseen = unseen | outside
    return np.abs(differences[0] - differences[1]).mean(axis=-1), ~unseen
