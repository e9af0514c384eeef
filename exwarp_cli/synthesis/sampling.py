"""What measuring motion vectors keeps of a frame: samples of them, and what points are sought in.

A frame is reduced as soon as it is read: of six frames of a sequence 150 MB stay at 1080p and not
440, and what is drawn from a frame is drawn once for all its channels and both its neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer
from exwarp_cli.domain.motion import STILL_MIDDLE, STILL_TOLERANCE

Index = npt.NDArray[np.intp]

SAMPLES = 6000
"""Pixels looked up of each frame, out of GRID times as many on a regular grid."""

GRID = 5

LEAST = 100
"""Samples below which a frame says nothing."""

AT_REST, NOTHING = 0.01, 1e-6
"""Vectors up to this share of the frame's longest, or up to this value, count as no motion."""

FEW_MOVE = 0.5
"""Share of moving pixels below which these are sampled more densely than the frame."""

MOST_NOISE, FARTHEST = 0.05, 3
"""Noise between two frames' colours above which they are smoothed, and how many pixels around."""

MOST_VECTORS = 1 << 20
"""Vectors that are kept of a frame between two key frames, on a coarser grid if needed."""


@dataclass(frozen=True)
class Instant:
    """A frame of a pair: geometry, raw motion channels, and colour where there is some."""

    number: int
    gbuffer: GBuffer
    motion: Float32
    colour: Float32 | None


@dataclass(frozen=True)
class Sampled:
    """A frame of a pair, reduced to what tells what its vectors mean.

    Attributes
    ----------
    number
        Of the frame.
    y, x
        Pixels of a regular grid [G].
    motion
        float32 [G, C]: the motion channels there.
    usable, still
        bool [G]: pixels that show a surface, off the frame's rim, and of those the ones that do not
        move by themselves; `still` is None where that is not known, or does not matter.
    regular, moving
        bool [G]: pixels of the regular grid, and pixels whose vectors are not at rest. Where few
        move, the pixels beyond the regular grid are further moving ones.
    position, depth, perceived
        float32 [H, W, ...]: what identifies a point; None without. Where there are positions, they
        alone identify it.
    noise
        How far two frames' colours are apart by noise alone.
    size
        Width and height.
    empty
        Whether the motion channels hold no number anywhere in the frame.
    """

    number: int
    y: Index
    x: Index
    motion: Float32
    usable: Bool
    regular: Bool
    moving: Bool
    still: Bool | None
    position: Float32 | None
    depth: Float32 | None
    perceived: Float32 | None
    noise: float
    size: tuple[int, int]
    empty: bool


def sampled(frame: Instant) -> Sampled:
    """Reduce a frame."""
    height, width, _ = frame.motion.shape
    buffer = frame.gbuffer
    step = max(1, height * width // (GRID * SAMPLES))
    grid, moving = _with_movers(frame.motion.reshape(height * width, -1), step)
    y, x = np.divmod(grid, width)
    motion = frame.motion[y, x]
    usable = (y > 0) & (y < height - 1) & (x > 0) & (x < width - 1)
    if buffer.depth is not None:
        usable &= np.isfinite(buffer.depth[y, x])
    if buffer.position is not None:
        usable &= np.isfinite(buffer.position[y, x]).all(axis=-1)
    still = None
    if buffer.stencil is not None and buffer.position is not None:
        # World positions of what moves are not found again. In leaves that move over
        # half of the frame no reading was better than none.
        still = usable & (buffer.stencil[y, x] == 0)
    positioned = buffer.position is not None
    seen = None if positioned or frame.colour is None else _perceived(frame.colour)
    return Sampled(
        frame.number,
        y,
        x,
        motion,
        usable,
        grid % step == 0,
        moving,
        still,
        buffer.position,
        None if positioned else buffer.depth,
        None if seen is None else seen[0],
        0.0 if seen is None else seen[1],
        (width, height),
        not np.isfinite(motion).any() and not np.isfinite(frame.motion).any(),
    )


def _with_movers(vectors: Float32, step: int) -> tuple[Index, Bool]:
    """Return the regular grid, with further moving pixels where few move, and which pixels move.

    A mover of a thousandth of the frame has 30 pixels on the regular grid: too few to measure by.
    """
    regular = np.arange(0, len(vectors), step)
    moving = is_moving(vectors[regular])
    if step == 1 or np.mean(moving) >= FEW_MOVE:
        return regular, moving
    every = is_moving(vectors)
    movers = np.flatnonzero(every)
    grid = np.union1d(regular, movers[:: max(1, len(movers) // SAMPLES)])
    return grid, every[grid]


def is_moving(vectors: Float32) -> Bool:
    """Return which vectors [N, C] are not at rest, bool [N].

    Rest is 0, or about 0.5 if most vectors have just one such value. The last of an odd number of
    channels is not part of a vector.
    """
    used = vectors[:, : 2 * (vectors.shape[1] // 2)]
    if not used.size:
        return np.zeros(len(vectors), bool)
    samples = used[:: max(1, len(used) // SAMPLES)]
    usual = np.median(np.where(np.isfinite(samples), samples, 0), axis=0)
    middle = (np.abs(usual - STILL_MIDDLE) < STILL_TOLERANCE) & (
        np.mean(samples == usual, axis=0) > FEW_MOVE
    )
    away = np.abs(used - np.where(middle, usual, 0).astype(np.float32))
    away[~np.isfinite(away)] = 0
    lengths = away.max(axis=1)
    return np.asarray(lengths > max(AT_REST * lengths.max(), NOTHING))


@dataclass(frozen=True)
class Interval:
    """Two neighbouring key frames with colour, and the vectors of all frames on the way.

    Attributes
    ----------
    numbers
        Of the two key frames.
    before, after
        Their colours, float32 [H, W, 3], as the eye sees them.
    noise
        How far these are apart by noise alone.
    vectors
        Motion channels of the frames from the earlier key frame to the later one, both included,
        float32 [h, w, C]: of every `stride`-th pixel.
    stride
        Distance of the pixels that vectors are kept of.
    """

    numbers: tuple[int, int]
    before: Float32
    after: Float32
    noise: float
    vectors: tuple[Float32, ...]
    stride: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames."""
        height, width, _ = self.before.shape
        return width, height


def interval(
    numbers: tuple[int, int], before: Float32, after: Float32, vectors: Iterable[Float32]
) -> Interval:
    """Reduce two key frames' colours and the vectors between to what tells a convention."""
    height, width, _ = before.shape
    stride = max(1, math.ceil(math.sqrt(height * width / MOST_VECTORS)))
    kept = tuple(np.ascontiguousarray(field[::stride, ::stride]) for field in vectors)
    (earlier, noise), (later, _) = _perceived(before), _perceived(after)
    return Interval(numbers, earlier, later, noise, kept, stride)


def _perceived(colour: Float32) -> tuple[Float32, float]:
    """Scene-linear RGB compressed roughly as the eye does, without much noise; and what is left.

    Noise that is as large as the tolerance makes every reading as bad as no motion.
    """
    seen = np.sqrt(np.maximum(np.nan_to_num(colour[..., :3], posinf=0, neginf=0), 0))
    noise = _noise(seen)
    reach = min(math.ceil((noise / MOST_NOISE - 1) / 2), FARTHEST)
    return (_smoothed(seen, reach), noise / (2 * reach + 1)) if reach > 0 else (seen, noise)


def _noise(image: Float32) -> float:
    """Return the standard deviation of two images' difference by noise, over all channels.

    By the median of what a mask leaves that takes no notice of edges and slopes (Immerkær,
    "Fast Noise Variance Estimation", 1996); its coefficients' squares sum to 36.
    """
    height, width, channels = image.shape
    if min(height, width) < 3:
        return 0.0
    step = max(1, height * width // (GRID * SAMPLES))
    y, x = np.divmod(np.arange(0, (height - 2) * (width - 2), step), width - 2)
    mask = ((1, -2, 1), (-2, 4, -2), (1, -2, 1))
    left = np.zeros((len(y), channels), np.float32)
    for i, j in np.ndindex(3, 3):
        left += mask[i][j] * image[y + i, x + j]
    per_channel = float(np.median(np.abs(left))) / 0.6745 / 6
    return per_channel * math.sqrt(2 * channels)


def _smoothed(image: Float32, reach: int) -> Float32:
    """Return the mean over squares of 2 reach + 1 pixels; the rim is repeated outward."""
    height, width, _ = image.shape
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), "edge")
    size = 2 * reach + 1
    rows, out = np.zeros_like(padded[:height]), np.zeros_like(image)
    for i in range(size):
        rows += padded[i : i + height]
    for j in range(size):
        out += rows[:, j : j + width]
    return out / np.float32(size * size)
