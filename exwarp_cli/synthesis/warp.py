"""W: a slot's frame as key frames' colour, moved from one side or both (paper, II-B and III-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, Int32, nonfinite_pixels
from exwarp_cli.domain.network_api import Interpolator
from exwarp_cli.kernels import blend, gather, holes, resample
from exwarp_cli.runtime.frame_pool import pool
from exwarp_cli.synthesis.geometry import SlotField

FILL_REACH = 0.25
"""How far to look for background, as a share of the frame's longer side."""

LANCZOS = resample.lanczos_weights()
"""Weights of the kernel that colour is sampled by.

Colour is sampled, filled and blended as a display shows it, not in linear light. PSNR in dB,
SSIM and sharpness (mean gradient over truth's) of 24 frames of the scene market by `softsplat`:
bilinear in linear light 26.98, .927, .88; Lanczos-3 in linear light 27.42, .938, 1.00; in log
light 27.58; as shown 27.67, and blended as shown 27.73, .940, 1.00. Catmull-Rom in log light has
27.53 and .97, Lanczos-4 what Lanczos-3 has.
"""

BEYOND = 2.0
"""The sky counts as this many times as far as the furthest surface when holes are filled."""


@dataclass(frozen=True)
class Warped:
    """A warped frame before its holes are filled.

    Attributes
    ----------
    pixels
        float32 [H, W, C], as `Mover.codes` has them; 0 or the frame's edge colour in holes.
    depth
        float32 [H, W] of the surface shown.
    hole
        bool [H, W]: no source, another surface, outside the source, a non-finite source pixel, or
        the outline that a surface leaves beside its hole.
    fringe
        bool [H, W]: colour mixed with a nearer surface that has moved on.
    """

    pixels: Float32
    depth: Float32
    hole: Bool
    fringe: Bool


class Mover:
    """Moves colour along one motion field, that of the beauty first and of its layers after it.

    Parameters
    ----------
    source
        Where the slot's pixels come from.
    linear
        Whether colour stays scene-linear, so that layers which add up to the beauty still do. It is
        0.2 dB worse than colour as shown.
    """

    def __init__(self, source: SlotField, linear: bool = False) -> None:
        self.source = source
        self._linear = linear
        self._limit: Float32 | None = None

    @property
    def has_beauty(self) -> bool:
        """Whether the beauty was moved, if layers need that first."""
        return not self._linear or self._limit is not None

    def codes(self, pixels: Float32) -> Float32:
        """Return scene-linear colour as it is moved."""
        return pixels if self._linear else as_shown(pixels)

    def light(self, codes: Float32) -> Float32:
        """Invert `codes`, in place."""
        return codes if self._linear else as_light(codes)

    def move(self, codes: Float32) -> tuple[Float32, Bool]:
        """Return moved colour by Lanczos-3.

        Parameters
        ----------
        codes
            float32 [H, W, C], from `codes`.

        Returns
        -------
        float32 [h, w, C], of the motion field's size
            Each channel of the beauty is within the range of the 3x3 pixels around; 0 where nothing
            finite lies there, the edge's colour outside the frame.
        bool [H, W]
            Both of these, and where the source shows another surface.
        """
        field = self.source.field
        out: Float32 = pool.empty((*field.shape[:2], codes.shape[2]), np.float32)
        unseen: Bool = pool.empty(field.shape[:2], np.bool_)
        if self._linear:
            leads = self._limit is None
            if self._limit is None:
                self._limit = pool.empty(field.shape[:2], np.float32)
            resample.resample_alike(codes, field, LANCZOS, self._limit, leads, out, unseen)
        else:
            resample.resample(codes, field, LANCZOS, out, unseen)
        np.logical_or(unseen, self.source.hole, out=unseen)
        return out, unseen

    def warp(self, codes: Float32) -> Warped:
        """Return moved colour with what is known of it; ghosts are holes."""
        out, hole = self.move(codes)
        np.logical_or(hole, self.source.ghosts, out=hole)
        return Warped(out, self.source.depth, hole, self.source.fringe)

    def warp_alone(self, pixels: Float32) -> Float32:
        """Return a frame, scene-linear, moved and its holes filled as by `fill_holes`."""
        out, hole = self.move(self.codes(pixels))
        return self.light(fill_holes(out, self.source.depth, hole))


def sampled(pixels: Float32, field: Float32) -> tuple[Float32, Bool]:
    """Return what lies at the end of a motion field, bilinearly; for data, not for colour.

    Parameters
    ----------
    pixels
        float32 [H, W, C].
    field
        float32 [H, W, 2], pixels; NaN where there is no end.

    Returns
    -------
    out
        float32 [H, W, C]; 0 where nothing finite lies there, the edge's colour outside the frame.
    unseen
        bool [H, W]: both of these.
    """
    out: Float32 = pool.empty(pixels.shape, np.float32)
    unseen: Bool = pool.empty(pixels.shape[:2], np.bool_)
    gather.gather_bilinear(pixels, field, out, unseen)
    return out, unseen


def repair(pixels: Float32) -> Float32:
    """Return a frame whose non-finite pixels are filled from around them; itself if it has none."""
    broken = nonfinite_pixels(pixels)
    if not broken.any():
        return pixels
    clean = np.where(broken[..., None], np.float32(0), pixels)
    flat = np.ones(broken.shape, np.float32)
    return fill_holes(clean, flat, broken)


def fill_holes(pixels: Float32, depth: Float32, hole: Bool) -> Float32:
    """Return a frame with its holes filled from what is visible around them.

    Where the surface in a hole is known (slot G-buffers, or a source outside the frame) it is
    filled from the same surface, else from the background.

    Parameters
    ----------
    pixels
        float32 [H, W, C], changed and returned, which spares a copy of the frame; in another layout
        than C's a copy is.
    depth
        float32 [H, W] of the surface shown, +inf background; NaN where nothing is known.
    hole
        bool [H, W].
    """
    depth = np.ascontiguousarray(depth)
    around = look_around(depth, hole)
    if around is None:
        return pixels
    out = np.ascontiguousarray(pixels)
    holes.fill_holes(out, depth, around.first, around.column, around.cap, around.steps)
    return out


class Around(NamedTuple):
    """The holes of a frame, and what is visible around them.

    Attributes
    ----------
    first
        int32 [H + 1]: how many holes there are in all rows above each.
    column
        int32 [N]: their columns, row by row.
    cap
        Depth at which everything further counts as equally far, scene units.
    steps
        int16 [8, N], from :func:`exwarp_cli.kernels.holes.ray_march_visible`.
    """

    first: Int32
    column: Int32
    cap: np.float32
    steps: npt.NDArray[np.int16]


def look_around(depth: Float32, hole: Bool) -> Around | None:
    """Look for what is visible around holes; None without any.

    Parameters
    ----------
    depth
        float32 [H, W] of the surface shown, +inf background; NaN where nothing is known.
    hole
        bool [H, W].
    """
    hole = np.ascontiguousarray(hole)
    counts, bits = np.empty(len(hole), np.int32), np.empty(len(hole), np.int32)
    holes.count_holes(hole, depth.view(np.int32), counts, bits)
    first = np.zeros(len(hole) + 1, np.int32)
    np.cumsum(counts, out=first[1:])
    if first[-1] == 0:
        return None
    column = np.empty(first[-1], np.int32)
    holes.list_holes(hole, first, column)
    furthest = float(bits.max(keepdims=True).view(np.float32)[0])
    cap = BEYOND * furthest if furthest > 0 else 1.0
    reach = min(int(FILL_REACH * max(hole.shape)) + 1, 32000)
    steps = np.empty((len(holes.DIRECTIONS), len(column)), np.int16)
    holes.ray_march_visible(hole, first, column, reach, steps)
    return Around(first, column, np.float32(cap), steps)


def blend_by_depth(before: Warped, after: Warped, time: float) -> Float32:
    """Blend two warped key frames as softmax splatting does, with the renderer's exact motion.

    Parameters
    ----------
    before, after
        The key frames on both sides, warped to the slot. The pixels of the first are changed and
        returned: three frames of 1920x1080 in several threads are memory.
    time
        Of the slot in the key interval, 0 < time < 1.

    Returns
    -------
    float32 [H, W, C]
        As of `mix_by_depth`; what neither side sees is filled from the background.
    """
    return fill_holes(*mix_by_depth(before, after, time))


def mix_by_depth(before: Warped, after: Warped, time: float) -> tuple[Float32, Float32, Bool]:
    """Blend two warped key frames as `blend_by_depth` does, without filling anything.

    Returns
    -------
    float32 [H, W, C]
        Each side weighs by its nearness in time, times a softmax over its depth; a side that does
        not see the surface weighs nothing, so disocclusions come from the side that sees them.
    float32 [H, W]
        Depth of the nearer side.
    bool [H, W]
        What neither side sees.
    """
    depth: Float32 = pool.empty(before.depth.shape, np.float32)
    hole: Bool = pool.empty(before.hole.shape, np.bool_)
    sides = [(side.pixels, side.depth, side.hole, side.fringe) for side in (before, after)]
    blend.blend(*sides, np.float32(time), before.pixels, depth, hole)
    return before.pixels, depth, hole


def cross_fade(before: Float32, after: Float32, time: float) -> Float32:
    """Mix two layers [H, W, C] at a time, 0 to 1; what is not finite is filled from around."""
    first, second = repair(before), repair(after)
    with np.errstate(over="ignore", invalid="ignore"):  # of the largest floats
        return (first + np.float32(time) * (second - first)).astype(np.float32)


def as_shown(pixels: Float32) -> Float32:
    """Return scene-linear colour [H, W, 3 or more] by the sRGB curve, alpha as it is.

    The curve goes on below 0 and above 1.
    """
    out: Float32 = pool.empty(pixels.shape, np.float32)
    resample.encode_srgb(pixels, out)
    return out


def as_light(codes: Float32) -> Float32:
    """Invert `as_shown`, in place."""
    resample.decode_srgb(codes, codes)
    return codes


def between(before: Float32, after: Float32, time: float, network: Interpolator) -> Float32:
    """Have a network make the frame of a slot from the colour of both key frames.

    Parameters
    ----------
    before, after
        float32 [H, W, 3 or 4], scene-linear; pixels that are not finite are filled from around.
    time
        Of the slot in the key interval, 0 < time < 1.
    network
        It sees no motion vectors.

    Returns
    -------
    float32 [H, W, 3 or 4]
        Scene-linear, premultiplied alpha; a new array.
    """
    return pool.copy(network(repair(before), repair(after), time))
