"""One key interval: what is known of it, and the motion fields of its slots."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from exwarp_cli.domain.extrapolator import Extrapolator
from exwarp_cli.domain.frame import Float32, GBuffer, KeyFrame
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import LayoutError
from exwarp_cli.synthesis.geometry import SlotField, compose_back, compose_forward, reproject


@dataclass(frozen=True)
class Past:
    """An older key frame.

    Attributes
    ----------
    frame
        F_k-1 or F_k-2, on the window of F_k; its motion is settled.
    motion
        float32 [H, W, 2], pixels: where the points of the key frame after it (F_k for F_k-1) are
        in this one, minus where they are there; NaN where unknown.
    """

    frame: KeyFrame
    motion: Float32


@dataclass
class Interval:
    """A key frame, what follows it, and lazily the motion fields of its slots.

    Attributes
    ----------
    key
        The key frame F_k; its motion is settled.
    following
        F_k+1 on the same window, for look-ahead methods; None for causal ones and at the end.
    slots
        G-buffers of slots 1 to 3 with settled motion between neighbouring slots; empty when only
        the key frames have G-buffers.
    past
        F_k-1 and F_k-2, the newer first, as far as they exist; only for extrapolation.
    extrapolator
        The network that extrapolates; None for methods that only warp.
    """

    key: KeyFrame
    following: KeyFrame | None = None
    slots: tuple[GBuffer, ...] = ()
    past: tuple[Past, ...] = ()
    extrapolator: Extrapolator | None = None
    _back: dict[int, SlotField] = field(default_factory=dict)
    _forward: dict[int, SlotField] = field(default_factory=dict)

    @property
    def has_motion(self) -> bool:
        """Whether slots can be warped from the key frame."""
        return bool(self.slots) or (self.key.gbuffer is not None and self.key.gbuffer.has_motion)

    def back(self, slot: int) -> SlotField:
        """Motion field from a slot, 1 to 3, to the key frame before it.

        Raises
        ------
        LayoutError
            Without motion vectors.
        """
        if slot not in self._back:
            if self.slots and self.key.gbuffer is not None:
                self._back = dict(enumerate(compose_back(self.slots, self.key.gbuffer), start=1))
            else:
                self._back[slot] = reproject(_moving(self.key), slot / FACTOR)
        return self._back[slot]

    def forward(self, slot: int) -> SlotField:
        """Motion field from a slot, 1 to 3, to the key frame after it.

        With slot G-buffers their to-next vectors are followed; where a renderer writes none, the
        next key frame's own geometry is moved back, as with key G-buffers only.
        """
        assert self.following is not None
        if slot not in self._forward:
            composable = self.slots and all(s.to_next is not None for s in self.slots)
            if composable and self.following.gbuffer is not None:
                fields = compose_forward(self.slots, self.following.gbuffer)
                self._forward = dict(enumerate(fields, start=1))
            else:
                self._forward[slot] = reproject(_moving(self.following), slot / FACTOR - 1)
        return self._forward[slot]

    def hole_mask(self, slot: int) -> np.ndarray | None:
        """bool [H, W]: what the warp from the key frame cannot see; None without motion."""
        return self.back(slot).hole if self.has_motion else None


def _moving(frame: KeyFrame) -> GBuffer:
    """Return a frame's G-buffer, which must have motion."""
    if frame.gbuffer is None or not frame.gbuffer.has_motion:
        raise LayoutError(
            f"frame {frame.number} has no motion vectors, which this method needs; "
            "render the motion pass, or use --method hold or blend"
        )
    return frame.gbuffer
