"""The steps to which a G-buffer's values were rounded before they reached the file."""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32

DepthStep = tuple[np.float32, np.float32]
"""Step of a depth in scene units, and of its inverse; one of them is 0, both if it is exact."""

EXACT: DepthStep = (np.float32(0), np.float32(0))

SAMPLES = 2**16
"""Values that are looked at, spread evenly over the frame."""

FIRST = 2**10
"""Values that are looked at first: exact values show themselves by those."""

PER_LEVEL = 8
"""Pixels per distinct value from which on values count as rounded; exact ones hardly repeat."""

LEAST_LEVELS = 8
"""Distinct values below which nothing is said: a few flat cards have as many depths as cards."""

REPEATED, MOSTLY = 4, 0.9
"""Pixels that a value occurs at to count, and the least share of all that such values make up.

A filter mixes the other values at outlines.
"""

SMALLEST = 1.5
"""Gaps up to so many times the smallest are one step; half floats move levels by a tenth."""

EVEN, USUAL = 0.2, 0.75
"""How far from a whole number of steps a gap may be, and the share of gaps that must be so."""

HALF, PXR24 = 2.0**-10, 2.0**-15
"""Relative steps of half floats, and of floats that PXR24 compressed."""

SINGLE = 2.0**-23
"""Relative step of single-precision floats."""


def depth_step(depth: Float32) -> DepthStep:
    """Measure the step to which distances were rounded, themselves or as their inverse.

    The same surface point has two depths up to one step apart in two frames.

    Parameters
    ----------
    depth
        float32 [H, W], scene units, +inf background.

    Returns
    -------
    DepthStep
        From the values of this frame alone, so that every split of a sequence finds the same.
    """
    found = _levels(depth)
    if found is None:
        return EXACT
    values, counts = found
    linear, share = _even_step(values, counts)
    inverse, inverse_share = _even_step(1 / values[::-1], counts[::-1])
    if max(share, inverse_share) < USUAL:
        return EXACT
    if share >= inverse_share:
        return np.float32(linear), np.float32(0)
    return np.float32(0), np.float32(inverse)


def coarser(a: DepthStep, b: DepthStep) -> DepthStep:
    """Return the larger steps of two frames whose depths are compared."""
    return max(a[0], b[0]), max(a[1], b[1])


def normal_step(normal: Float32) -> float:
    """Measure the step of the components of normals, float32 [H, W, 3]; 0 if they are exact."""
    steps = []
    for component in range(3):
        found = _levels(normal[..., component])
        step, share = (0.0, 0.0) if found is None else _even_step(*found)
        steps.append(step if share >= USUAL else 0.0)
    return max(steps)


def relative_step(values: Float32) -> float:
    """Return the step of floating-point values, as a share of each: that of their type.

    Parameters
    ----------
    values
        float32 [...], as read; halfs are recognised by their bits.
    """
    bits = _spread(values, SAMPLES).view(np.uint32)
    used = int(np.bitwise_or.reduce(bits & np.uint32(0x7FFFFF), initial=0))
    if used & 0x1FFF == 0:
        return HALF
    return PXR24 if used & 0xFF == 0 else SINGLE


def _spread(values: Float32, count: int) -> Float32:
    """Return up to `count` of some values, evenly spread."""
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    return np.ascontiguousarray(flat[:: max(1, -(-flat.size // count))])


def _levels(values: Float32) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the distinct values, ascending, and how often each occurs; None if they are exact."""
    for count in (FIRST, SAMPLES):
        some = _spread(values, count)
        some = some[np.isfinite(some)].astype(np.float64)
        levels, counts = np.unique(some, return_counts=True)
        if levels.size * 2 > some.size:
            return None
    known = counts >= REPEATED
    levels, counts = levels[known], counts[known]
    few = levels.size < LEAST_LEVELS or levels.size * PER_LEVEL > some.size
    return None if few or counts.sum() < MOSTLY * some.size else (levels, counts)


def _even_step(levels: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """Return the step of values, ascending, and the share of pixels that it holds for."""
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps <= SMALLEST * gaps.min()]))
    multiples = gaps / step
    fits = np.abs(multiples - np.round(multiples)) <= EVEN
    # A large flat surface says little about the gap beside it.
    weights = np.minimum(counts[1:], counts[:-1]).astype(np.float64)
    return step, float(weights[fits].sum() / weights.sum())
