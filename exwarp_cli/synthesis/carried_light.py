"""Light carried on: how it moved against the surfaces before a key frame, it goes on moving after.

A warp from one key frame has no later picture to tell where shadows, reflections and highlights go.
The key frame before tells where they came from: what is left of motion between that picture, moved
to the key frame, and the key frame itself. Light keeps that velocity through the slots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, KeyFrame, nonfinite_pixels
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.kernels.silhouettes import find_edges
from exwarp_cli.synthesis.coverage import Coverage
from exwarp_cli.synthesis.geometry import SlotField, depth_of, moved_on, reproject, unmatched
from exwarp_cli.synthesis.history import Past, lit_alike
from exwarp_cli.synthesis.residual import LEAST, agreement, along, disagreement, flow_of
from exwarp_cli.synthesis.trajectory import stencil_of
from exwarp_cli.synthesis.warp import Mover, Warped, as_light, as_shown, fill_holes, sampled

SHORTEST = np.float32(0.25)
"""Pixels a key interval from which on light counts as moving: what is less is the search's noise,
and worth less than 0.01 dB either way."""


@dataclass(frozen=True)
class LightFlow:
    """How light moves against the surfaces of a key frame.

    Attributes
    ----------
    flow
        float32 [H, W, 2], pixels a key interval: what the light at each pixel moves by.
    weight
        float32 [H, W], 0 to 1: how well the flow explains what changed on the surfaces.
    surface
        G-buffer of the key frame, motion, depth and ids alone.
    """

    flow: Float32
    weight: Float32
    surface: GBuffer

    def shifted(self, back: SlotField, time: float) -> tuple[SlotField, Float32]:
        """Return where a slot's light comes from, and how far that is to be followed.

        Parameters
        ----------
        back
            From the slot to the key frame.
        time
            Of the slot, in key intervals after the key frame.

        Returns
        -------
        SlotField
            From the slot to the place in the key frame that had its light.
        float32 [H, W]
            0 to 1; 0 where no moving light arrives, or only that of another surface.
        """
        motion = np.float32(time) * self.flow
        motion[self.weight == 0] = np.nan
        # Of light that meets, that which is better explained counts. To go by the flow at the place
        # alone left the front of a shadow where it was, with twice the error.
        order = GBuffer(self.surface.window, depth=np.float32(2) - self.weight)
        arrived = moved_on(order, motion)
        share, _ = sampled(self.weight[..., None], arrived.field)
        # Where light has left and none arrives, what lies behind it shows: of shadows that move by
        # more than their width, too. It is worth 0.03 dB on the scene lab.
        gap = arrived.hole[..., None]
        way = np.where(gap, np.float32(-time) * self.flow, arrived.field)
        share = np.where(gap, self.weight[..., None], share)
        share[unmatched(self.surface, self.surface, way, FACTOR)] = 0
        found, lost = sampled(np.concatenate([way, share], axis=-1), back.field)
        weight = np.ascontiguousarray(found[..., 2])
        weight[lost | back.hole] = 0
        field = np.where(weight[..., None] > 0, back.field + found[..., :2], np.float32(np.nan))
        return SlotField(field, back.depth, back.hole), weight


def light_flow(key: KeyFrame, older: Past) -> LightFlow | None:
    """Find how light moves against the surfaces of a key frame; None where nothing tells.

    Parameters
    ----------
    key, older
        F_k and F_k-1, on one window, with settled motion and a G-buffer each.
    """
    before, surface = older.frame.gbuffer, key.gbuffer
    if before is None or surface is None:
        return None
    surface = surface.bare().without("normal")
    source = _way_back(surface, before.bare().without("normal"), older)
    if source is None:
        return None
    now, codes = _as_it_is(key), as_shown(older.frame.image.pixels)
    then = Mover(source).warp(codes)
    apart = disagreement(then, now)
    if not (apart >= LEAST).any():
        return None
    both = ~(then.hole | now.hole)
    if not lit_alike(key.image.pixels, as_light(then.pixels.copy()), both):
        return None
    flow = flow_of(then, now, linear=False)
    moved = Mover(along(then, source, -flow, apart)).warp(codes)
    weight = agreement(apart, moved, now)
    weight[np.abs(flow).max(axis=-1) < SHORTEST] = 0
    # There colour is mixed. What was found at a lamp post's edge went into the hole that it left.
    weight[_silhouettes(surface)] = 0
    return LightFlow(flow, weight, surface) if weight.any() else None


def _way_back(surface: GBuffer, before: GBuffer, older: Past) -> SlotField | None:
    """Return the motion field from a key frame to the one before it; None where none is known."""
    if not older.guessed:
        hole = unmatched(surface, before, older.motion, FACTOR)
        return SlotField(older.motion, depth_of(surface), hole)
    return None if before.to_next is None else reproject(before, 1)


def _silhouettes(surface: GBuffer) -> Bool:
    """bool [H, W]: pixels beside another surface."""
    out = np.empty(surface.window.shape, np.bool_)
    find_edges(depth_of(surface), stencil_of(surface), out)
    return out


def _as_it_is(key: KeyFrame) -> Warped:
    """Return a key frame as if it had been warped to its own instant."""
    pixels = key.image.pixels
    broken = nonfinite_pixels(pixels)
    codes = as_shown(np.where(broken[..., None], np.float32(0), pixels))
    return Warped(codes, np.zeros(broken.shape, np.float32), broken, np.zeros_like(broken))


class CarriedLight:
    """Makes the colour of a slot from the key frame before it: its beauty, then its layers.

    Parameters
    ----------
    back
        Motion field from the slot to the key frame.
    time
        Of the slot, in key intervals after the key frame.
    light
        How light moves; None where it stays on its surfaces.
    linear
        As for `Mover`.
    coverage
        Of the pixels beside edges; None where each has the surface of its centre.
    """

    def __init__(
        self,
        back: SlotField,
        time: float,
        light: LightFlow | None,
        linear: bool = False,
        coverage: Coverage | None = None,
    ) -> None:
        self._mover = Mover(back, linear)
        self._coverage = coverage
        self._shifted: Mover | None = None
        if light is not None:
            source, self._weight = light.shifted(back, time)
            self._shifted = Mover(source, linear) if self._weight.any() else None

    @property
    def has_beauty(self) -> bool:
        """Whether the beauty was made, if layers need that first."""
        return self._mover.has_beauty

    def make(self, pixels: Float32) -> Float32:
        """Make a layer of the slot; the first is the beauty.

        Parameters
        ----------
        pixels
            float32 [H, W, C], scene-linear, of the key frame.

        Returns
        -------
        float32 [H, W, C]
            Scene-linear; holes are filled as by `fill_holes`.
        """
        mover = self._mover
        codes = mover.codes(pixels)
        warped = mover.warp(codes)
        hole = warped.hole
        out = fill_holes(warped.pixels, warped.depth, hole)
        if self._coverage is not None:
            self._coverage.cover((codes,), out)
        if self._shifted is not None:
            moving, unseen = self._shifted.move(codes)
            weight = np.where(hole | unseen, np.float32(0), self._weight)[..., None]
            # Only there: of the largest floats the difference may be infinite.
            moving = np.where(weight > 0, moving, out)
            moving -= out
            moving *= weight
            out += moving
        return mover.light(out)
