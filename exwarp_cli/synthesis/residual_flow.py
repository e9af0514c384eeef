"""Residual flow: motion of shadows, reflections and highlights against the surfaces.

Motion vectors are those of surfaces. A shadow on still ground has none, so both key frames show it
where it was, and their mixture shows two of half its darkness. The motion that is left between the
two warped pictures is searched as optical flow, and followed as far as it makes them agree.

A warp from one key frame alone has no later picture. The key frame before it, moved to the key
frame, shows where light came from. Light keeps that velocity through the slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame, nonfinite_pixels
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.synthesis import motion_fields, warp
from exwarp_cli.synthesis.history import OlderKeyFrame, is_lit_alike
from exwarp_cli.synthesis.optical_flow import box_mean, flow_between, grey_of, mean_difference

# Side of the square, pixels, over which two pictures are compared; 9 gained nothing.
SIDE = 5

# The flow counts in full where it removes one in so many of the disagreement.
GAIN = np.float32(2)

# A flow is followed from this disagreement on: less is noise, or invisible.
MIN_DISAGREEMENT = np.float32(4 / 255)

# Pixels a key interval from which on light counts as moving: less is the search's noise, and worth
# less than 0.01 dB either way.
MIN_MOTION = np.float32(0.25)


def disagreement(before: warp.Warped, after: warp.Warped) -> Float32:
    """Return the mean difference of two warped key frames around each pixel, float32 [H, W]."""
    mean = mean_difference(before.pixels, after.pixels)
    mean[before.hole | after.hole] = 0
    return box_mean(mean, SIDE)


def search_flow(
    # The key frames, warped to the slot; scene-linear if `linear`, else as shown.
    before: warp.Warped,
    after: warp.Warped,
    linear: bool,
) -> Float32:
    """Search the motion of light against the surfaces at a slot.

    Returns float32 [H, W, 2] in pixels, from the picture of `before` to that of `after`.
    """
    first, second = (
        grey_of(warp.linear_to_srgb(side.pixels) if linear else side.pixels)
        for side in (before, after)
    )
    # Where one side sees nothing, it has the colour of the other.
    return flow_between(np.where(before.hole, second, first), np.where(after.hole, first, second))


def add_flow(
    plain: warp.Warped,  # a key frame warped without the flow
    source: motion_fields.SlotField,  # from the slot to the key frame
    flow: Float32,  # [H, W, 2], pixels: from the slot's picture to that of `plain`
    apart: Float32,  # from `disagreement`; where it is small, nothing is followed
) -> motion_fields.SlotField:
    """Return the motion field of a slot whose light moves along a flow as well."""
    motion, _ = warp.sample_bilinear(source.field, flow)
    motion += flow
    motion[apart < MIN_DISAGREEMENT] = np.nan
    hidden, _ = warp.sample_bilinear(plain.hole.astype(np.float32)[..., None], flow)
    hole: Bool = plain.hole | (hidden[..., 0] > 0)
    return motion_fields.SlotField(motion, source.depth, hole)


def flow_weight(
    apart: Float32,  # from `disagreement`, of the key frames warped without the flow
    # The key frames warped along it.
    before: warp.Warped,
    after: warp.Warped,
) -> Float32:
    """Return how much a flow makes two pictures agree, float32 [H, W], 0 to 1."""
    gain = (apart - disagreement(before, after)) / np.maximum(apart, MIN_DISAGREEMENT)
    weight: Float32 = np.clip(GAIN * gain, np.float32(0), np.float32(1))
    weight[before.hole | after.hole] = 0
    return weight


@dataclass(frozen=True)
class LightFlow:
    """How light moves against the surfaces of a key frame."""

    flow: Float32  # [H, W, 2], pixels a key interval: what the light at each pixel moves by
    weight: Float32  # [H, W], 0 to 1: how well the flow explains what changed on the surfaces
    surface: GBuffer  # of the key frame: motion, depth and ids alone

    def shifted(
        self,
        back: motion_fields.SlotField,  # from the slot to the key frame
        time: float,  # of the slot, in key intervals after the key frame
    ) -> tuple[motion_fields.SlotField, Float32]:
        """Return where a slot's light comes from, and how far that is to be followed.

        A field from the slot to the place in the key frame that had its light, and float32 [H, W],
        0 to 1; 0 where no moving light arrives, or only that of another surface.
        """
        motion = np.float32(time) * self.flow
        motion[self.weight == 0] = np.nan
        # Of light that meets, the better explained counts. To use the flow at the place alone left
        # the front of a shadow where it was, with twice the error.
        order = GBuffer(self.surface.window, depth=np.float32(2) - self.weight)
        arrived = motion_fields.splat_motion(order, motion)
        share, _ = warp.sample_bilinear(self.weight[..., None], arrived.field)
        # Where light has left and none arrives, what lies behind it shows: of shadows that move by
        # more than their width, too. It is worth 0.03 dB on the scene lab.
        gap = arrived.hole[..., None]
        motion = np.where(gap, np.float32(-time) * self.flow, arrived.field)
        share = np.where(gap, self.weight[..., None], share)
        share[motion_fields.find_holes(self.surface, self.surface, motion, FACTOR)] = 0
        sampled, lost = warp.sample_bilinear(np.concatenate([motion, share], axis=-1), back.field)
        weight = np.ascontiguousarray(sampled[..., 2])
        weight[lost | back.hole] = 0
        field = np.where(weight[..., None] > 0, back.field + sampled[..., :2], np.float32(np.nan))
        return motion_fields.SlotField(field, back.depth, back.hole), weight


def find_light_flow(key: KeyFrame, older: OlderKeyFrame) -> LightFlow | None:
    """Find how light moves against the surfaces of F_k; None if it does not, or is unknown.

    Both key frames are on one window, with settled motion.
    """
    before, surface = older.frame.gbuffer, key.gbuffer
    if before is None or surface is None:
        return None
    surface = surface.bare().without("normal")
    before = before.bare().without("normal")
    if not older.guessed:
        hole = motion_fields.find_holes(surface, before, older.motion, FACTOR)
        source = motion_fields.SlotField(older.motion, motion_fields.depth_of(surface), hole)
    elif before.to_next is not None:
        source = motion_fields.reproject(before, 1)
    else:
        return None
    pixels = key.image.pixels
    broken = nonfinite_pixels(pixels)
    codes = warp.linear_to_srgb(np.where(broken[..., None], np.float32(0), pixels))
    now = warp.Warped(codes, np.zeros(broken.shape, np.float32), broken, np.zeros_like(broken))
    codes = warp.linear_to_srgb(older.frame.image.pixels)
    then = warp.Mover(source).warp(codes)
    apart = disagreement(then, now)
    if not (apart >= MIN_DISAGREEMENT).any():
        return None
    both = ~(then.hole | now.hole)
    if not is_lit_alike(pixels, warp.srgb_to_linear(then.pixels.copy()), both):
        return None
    flow = search_flow(then, now, linear=False)
    moved = warp.Mover(add_flow(then, source, -flow, apart)).warp(codes)
    weight = flow_weight(apart, moved, now)
    weight[np.abs(flow).max(axis=-1) < MIN_MOTION] = 0
    # At silhouettes colour is mixed: what was found at a lamp post's edge went into its hole.
    weight[motion_fields.edges_of(surface)] = 0
    return LightFlow(flow, weight, surface) if weight.any() else None


@dataclass(frozen=True, eq=False)
class CarriedLight:
    """Makes the colour of a slot from the key frame before it: its beauty, then its layers."""

    mover: warp.Mover  # along the motion field from the slot to the key frame
    # What moves the light, and how far that is followed, [H, W]; None where light stays on its
    # surfaces.
    light: tuple[warp.Mover, Float32] | None = None
    # Of the pixels beside edges; None where each has the surface of its centre.
    coverage: warp.Coverage | None = None

    def make(self, pixels: Float32, beauty: Float32 | None = None) -> Float32:
        """Make a layer of the slot, scene-linear float32 [H, W, C]; the first is the beauty.

        `pixels` are the key frame's. Holes are filled as by `fill_holes`. A layer that may be the
        first names the key frame's `beauty`, which is made before it where layers need that.
        """
        if beauty is not None and self.mover.linear and self.mover.limit is None:
            self.make(beauty)
        codes = self.mover.codes(pixels)
        warped = self.mover.warp(codes)
        out = warp.fill_holes(warped.pixels, warped.depth, warped.hole)
        if self.coverage is not None:
            self.coverage.cover((codes,), out)
        if self.light is not None:
            moving, unseen = self.light[0].move(codes)
            weight = np.where(warped.hole | unseen, np.float32(0), self.light[1])[..., None]
            # Only there: of the largest floats the difference may be infinite.
            moving = np.where(weight > 0, moving, out)
            moving -= out
            moving *= weight
            out += moving
        return self.mover.light(out)
