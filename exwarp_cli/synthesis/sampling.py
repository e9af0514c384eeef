"""What measuring motion vectors keeps of a frame: samples of them, and what points are sought in.

A frame is reduced as soon as it is read: of six frames of a sequence 150 MB stay at 1080p and not
440, and what is drawn from a frame is drawn once for all its channels and both its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer

Index = npt.NDArray[np.intp]

SAMPLES = 6000
"""Pixels looked up of each frame, out of GRID times as many on a regular grid."""

GRID = 5

LEAST = 100
"""Samples below which a frame says nothing."""


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
    position, depth, perceived
        float32 [H, W, ...]: what a point is told by; None without. Where there are positions they
        tell it alone.
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
    still: Bool | None
    position: Float32 | None
    depth: Float32 | None
    perceived: Float32 | None
    size: tuple[int, int]
    empty: bool


def sampled(frame: Instant) -> Sampled:
    """Reduce a frame."""
    height, width, _ = frame.motion.shape
    buffer = frame.gbuffer
    grid = np.arange(0, height * width, max(1, height * width // (GRID * SAMPLES)))
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
    told = buffer.position is not None
    return Sampled(
        frame.number,
        y,
        x,
        motion,
        usable,
        still,
        buffer.position,
        None if told else buffer.depth,
        None if told or frame.colour is None else _perceived(frame.colour),
        (width, height),
        not np.isfinite(motion).any() and not np.isfinite(frame.motion).any(),
    )


def _perceived(colour: Float32) -> Float32:
    """Scene-linear RGB compressed roughly as the eye does, float32 [H, W, 3]."""
    return np.sqrt(np.maximum(np.nan_to_num(colour[..., :3], posinf=0, neginf=0), 0))
