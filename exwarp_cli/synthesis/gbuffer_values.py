"""What a G-buffer's values tell of themselves: their rounding, and the direction of depth.

Where two surfaces of a frame land on one pixel of its neighbour, the nearer one is visible there.
Its own depth value tells which it is, whatever the channel's direction. How fast points move with
the camera tells more: it is linear in the inverse of the distance (Hartley and Zisserman, Multiple
View Geometry, 2nd edition, section 13.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.synthesis.camera import F64, fit, pixels_at, projection_errors, sample_surfaces

# Step of a depth in scene units, and of its inverse; one of them is 0, both if depth is exact.
DepthStep = tuple[np.float32, np.float32]

EXACT: DepthStep = (np.float32(0), np.float32(0))

# Values that are examined, spread evenly over the frame; the first few suffice for exact values.
SAMPLES, FIRST_SAMPLES = 2**16, 2**10

# Pixels per distinct value from which on values count as rounded; exact ones hardly repeat.
PER_LEVEL = 8

# Fewer distinct values decide nothing: a few flat cards have as many depths as cards.
MIN_LEVELS = 8

# Pixels at which a value must occur to count, and the minimal share of such values. At outlines a
# filter mixes the other values.
REPEATED, MOSTLY = 4, 0.9

# Gaps up to so many times the smallest are one step; half floats move levels by a tenth.
SMALLEST = 1.5

# How far from a multiple of the step a gap may be, and the share of gaps that must be so near.
EVEN, USUAL = 0.2, 0.75

# Relative steps: of half floats, of floats that PXR24 compressed, of single-precision floats.
HALF, PXR24, SINGLE = 2.0**-10, 2.0**-15, 2.0**-23

# Share of all depth values between two surfaces that count as apart.
APART = 0.1

# Shares of the gap between two surfaces: a value closer than the first to one of them, and farther
# than the second from the other one, belongs to the former.
ALIKE, UNLIKE = 0.25, 0.5

# Depth values among which others are ranked.
RANKED = 20000

# Pixels that are examined, in whole rows; all of 1920x1080 took a second.
EXAMINED = 400_000

# Rows that are splatted at a time, which bounds memory.
BAND = 64

# Where the camera may be beyond the largest value, in ranges of the values, and the ratio of
# neighbouring candidates of the finer search.
ENDS, FINER = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0), 1.35

# The best error decides if it is below this share of the worst, and so many pixels below it.
DECISIVE, CLEAR = 0.7, 0.01


def depth_step(
    # float32 [H, W], scene units, +inf background. Nothing but this frame counts, so that every
    # split of a sequence measures the same.
    depth: Float32,
) -> DepthStep:
    """Measure the step to which distances were rounded, themselves or as their inverse.

    The same surface point has two depths up to one step apart in two frames.
    """
    levels = _repeated_levels(depth)
    if levels is None:
        return EXACT
    values, counts = levels
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
    largest = 0.0
    for component in range(3):
        levels = _repeated_levels(normal[..., component])
        if levels is not None:
            step, share = _even_step(*levels)
            largest = max(largest, step if share >= USUAL else 0.0)
    return largest


def relative_step(values: Float32) -> float:
    """Return the step of float32 values as a share of each; half floats show by their bits."""
    bits = _spread(values, SAMPLES).view(np.uint32)
    used = int(np.bitwise_or.reduce(bits & np.uint32(0x7FFFFF), initial=0))
    if used & 0x1FFF == 0:
        return HALF
    return PXR24 if used & 0xFF == 0 else SINGLE


def _spread(values: Float32, count: int) -> Float32:
    """Return up to `count` of the values, evenly spread."""
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    return np.ascontiguousarray(flat[:: max(1, -(-flat.size // count))])


def _repeated_levels(values: Float32) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the distinct values, ascending, and how often each occurs; None if they are exact."""
    for count in (FIRST_SAMPLES, SAMPLES):
        samples = _spread(values, count)
        samples = samples[np.isfinite(samples)].astype(np.float64)
        levels, counts = np.unique(samples, return_counts=True)
        if levels.size * 2 > samples.size:
            return None
    repeated = counts >= REPEATED
    levels, counts = levels[repeated], counts[repeated]
    if levels.size < MIN_LEVELS or levels.size * PER_LEVEL > samples.size:
        return None
    return None if counts.sum() < MOSTLY * samples.size else (levels, counts)


def _even_step(levels: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """Return the step of ascending values, and the share of pixels that it holds for."""
    gaps = np.diff(levels)
    step = float(np.median(gaps[gaps <= SMALLEST * gaps.min()]))
    multiples = gaps / step
    fits = np.abs(multiples - np.round(multiples)) <= EVEN
    # A large flat surface says little about the gap beside it.
    weights = np.minimum(counts[1:], counts[:-1]).astype(np.float64)
    return step, float(weights[fits].sum() / weights.sum())


@dataclass(frozen=True)
class OrderVotes:
    """Numbers of pixels where a surface covers one of larger depth value, or of smaller value."""

    near_small: int = 0
    near_large: int = 0

    def __add__(self, other: OrderVotes) -> OrderVotes:
        small, large = self.near_small + other.near_small, self.near_large + other.near_large
        return OrderVotes(small, large)

    @property
    def count(self) -> int:
        """All votes."""
        return self.near_small + self.near_large

    @property
    def small_share(self) -> float:
        """Share of votes for small values nearby; a half without any."""
        return self.near_small / self.count if self.count else 0.5


def occlusion_votes(
    # [H, W]: depth values of both frames; not finite on background.
    here: Float32,
    there: Float32,
    # [H, W, 2], pixels: displacement from `here` to `there`; NaN where unknown.
    motion: Float32,
) -> OrderVotes:
    """Count which of two surfaces covers the other in a neighbouring frame."""
    finite = np.concatenate([depth[np.isfinite(depth)] for depth in (here, there)])
    if not finite.size:
        return OrderVotes()
    # Ranks, because the distribution of values depends on the channel's kind.
    table = np.sort(finite[:: max(1, finite.size // RANKED)])
    height, width = here.shape
    low = np.full(height * width, np.inf, np.float32)
    high = np.full(height * width, -np.inf, np.float32)
    row_step = max(1, height * width // EXAMINED)
    for top in range(0, height, BAND):
        depth, vectors = here[top : top + BAND], motion[top : top + BAND]
        with np.errstate(invalid="ignore"):
            landing = np.rint(vectors[..., 1] + np.arange(top, top + len(depth))[:, None])
            used = np.isfinite(depth) & (landing % row_step == 0)
        y, x = np.nonzero(used)
        column, row = np.rint(x + vectors[y, x, 0]), landing[y, x]
        # Comparisons leave out NaN as well.
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        target = (row[inside] * width + column[inside]).astype(np.intp)
        rank = _ranks(depth[y, x][inside], table)
        np.minimum.at(low, target, rank)
        np.maximum.at(high, target, rank)
    with np.errstate(invalid="ignore"):
        counts = np.isfinite(there.reshape(-1)) & (high - low > APART)
    visible, low, high = _ranks(there.reshape(-1)[counts], table), low[counts], high[counts]
    gap, from_low, from_high = high - low, np.abs(visible - low), np.abs(visible - high)
    small = (from_low < ALIKE * gap) & (from_high > UNLIKE * gap)
    large = (from_high < ALIKE * gap) & (from_low > UNLIKE * gap)
    return OrderVotes(int(small.sum()), int(large.sum()))


def _ranks(values: Float32, table: Float32) -> Float32:
    """Return the share of the sorted table below each value; half of its equals count as below."""
    first, last = (np.searchsorted(table, values, side) for side in ("left", "right"))
    return ((first + last) / (2 * len(table))).astype(np.float32)


def camera_end(
    values: Float32,  # [H, W]; not finite on background
    motion: Float32,  # [H, W, 2], pixels: displacement to a neighbouring frame
) -> float | None:
    """Find the value at the camera, for values that grow towards it.

    Infinity where values are the inverse of the distance. None where no camera explains the motion
    by either, or all do alike because the camera only turns, or stands.
    """
    index = sample_surfaces(values)
    if not index.size:
        return None
    depth = values.reshape(-1)[index].astype(np.float64)
    pixels = pixels_at(index, values.shape[1])
    target = pixels + motion.reshape(-1, 2)[index]
    span, most = float(np.ptp(depth)) or 1.0, float(depth.max())

    def misses(shares: Iterable[float]) -> dict[float, float]:
        # At the largest value itself the inverse is not finite.
        ends = [most + max(share, 1e-4) * span for share in shares]
        return {end: _camera_miss(1 / (end - depth), pixels, target) for end in ends}

    errors = misses(ENDS)
    best = min(errors, key=errors.__getitem__)
    share = (best - most) / span
    errors |= misses(share * FINER**step for step in (-3, -2, -1, 1, 2, 3))
    errors[np.inf] = _camera_miss(depth, pixels, target)
    best, worst = min(errors, key=errors.__getitem__), max(errors.values())
    return best if errors[best] < min(DECISIVE * worst, worst - CLEAR) else None


def _camera_miss(nearness: F64, pixels: F64, target: F64) -> float:
    """Return the median miss, in pixels, of a camera fitted to points of these inverse distances.

    Infinite without a camera.
    """
    points = np.column_stack([pixels, np.ones(len(pixels)), nearness])
    camera = fit(points, target, movers=True)
    if camera is None:
        return np.inf
    # Points that move by themselves are few, and hardly change the median.
    return float(np.median(projection_errors(camera, points, target)))
